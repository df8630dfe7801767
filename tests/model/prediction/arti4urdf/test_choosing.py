"""The evidence by which joints are chosen: what the rules and accepted objects add."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed")

from model.core.articulated_object import SegmentedObject
from model.data.procedural.generate import make
from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.choosing import geometric_prior, parents
from model.prediction.arti4urdf.structure import MECHANISMS, RANKS, read_structure
from model.prediction.experience import Recalled
from tests.model.prediction.geometric.archetypes import cooktop


def test_accepted_parents_replace_geometry_s_unless_locked_or_in_a_circle() -> None:
    obj = make("StorageFurniture", 11, 1).object
    structure = read_structure(SegmentedObject(obj.name, obj.parts, obj.category))
    root = structure.assembly.root
    names = [s.name or "" for s in structure.sampled.shapes]
    part = next(i for i, name in enumerate(names) if i != root and name)
    other = next(i for i, name in enumerate(names) if i not in (part, root) and name)

    def known(name: str) -> Recalled:
        return Recalled(3, np.zeros(0), {}, {name: 1.0}, np.zeros((0, 5)))

    assert parents(structure, {}, {part: known("")})[part] == root
    found = parents(structure, {}, {part: known(names[other].lower())})
    assert names[found[part]] == names[other] and found[part] != part
    both = {part: known(names[other].lower()), other: known(names[part].lower())}
    if names[part] != names[other]:
        assert parents(structure, {}, both)[other] != part or found[part] != other
    assert parents(structure, {part: root}, {part: known(names[other].lower())})[part] == root


def test_what_a_wrong_name_leaves_open_is_decided_by_the_shape() -> None:
    """A knob that somebody calls a button is likelier to spin than to be a lever or a rocker."""
    thing = cooktop().segmented()
    parts = tuple(replace(p, name="button" if p.name == "knob" else p.name) for p in thing.parts)
    structure = read_structure(SegmentedObject("cooktop", parts))
    prior = geometric_prior(structure)
    knob = next(i for i, p in enumerate(parts) if p.name == "button")
    slots = dict(zip(MECHANISMS, prior[knob][v.SLOT_IDS][::RANKS], strict=True))
    assert max(slots, key=lambda m: slots[m]) == "press"
    assert slots["spin"] > max(slots["lever"], slots["toggle"]) + 0.5
