"""The evidence by which joints are chosen: what the rules and accepted objects add."""

from dataclasses import replace

import pytest

pytest.importorskip("torch", reason="torch is not installed")

from model.core.articulated_object import SegmentedObject
from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.choosing import geometric_prior
from model.prediction.arti4urdf.structure import MECHANISMS, RANKS, read_structure
from model.prediction.lessons import Lesson, taught_tree
from tests.model.prediction.geometric.archetypes import cooktop


def test_accepted_carriers_replace_geometry_s_unless_locked_or_in_a_circle() -> None:
    def about(part: int, base: float = 0.0) -> Lesson:
        return Lesson(3, 3.0, 0.0, (), {part: 1.0}, base)

    assert taught_tree(0, [-1, 0, 0], {2: about(1)}, {}) == [-1, 0, 1]
    assert taught_tree(0, [-1, 0, 0], {2: about(1)}, {2: 0}) == [-1, 0, 0], "a person fixed it"
    assert taught_tree(0, [-1, 0, 1], {1: about(2)}, {}) == [-1, 0, 1], "no circle"
    assert taught_tree(0, [-1, 0, 0], {1: about(0, 1.0)}, {}) == [1, -1, 0], "another base"


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
