"""The evidence by which joints are chosen: what examples add, and the motions that come next."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed")

from model.core.articulated_object import SegmentedObject
from model.core.joint import same_motion
from model.data.procedural.generate import make
from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.choosing import (
    HybridSettings,
    geometric_prior,
    other_motions,
    parents,
)
from model.prediction.arti4urdf.decoding import same_motion as same_motions
from model.prediction.arti4urdf.network import ArtiModel
from model.prediction.arti4urdf.predictor import Arti4UrdfPredictor, make_prompt
from model.prediction.arti4urdf.structure import MECHANISMS, RANKS, read_structure
from model.prediction.experience import Recalled
from tests.model.prediction.geometric.archetypes import cooktop


def test_other_motions_come_by_their_odds_and_differ(tiny_model: ArtiModel) -> None:
    obj = make("Oven", 11, 0).object
    whole = SegmentedObject(obj.name, obj.parts, obj.category)
    structure = read_structure(whole)
    prompt = make_prompt(structure, whole, 0)
    same = same_motions(prompt)
    predictor = Arti4UrdfPredictor(tiny_model, hybrid=HybridSettings())
    prior = predictor.prior(structure, geometric_prior(structure), {})
    answer = predictor.answer(prompt, structure, {}, prior)
    part = next(i for i, d in enumerate(answer.decisions) if d.slot >= 0)
    found = list(other_motions(answer, structure, part, prior[part], same[part]))
    assert same[part][found[0].slot, answer.decisions[part].slot], "the chosen motion comes first"
    assert {True, False} == {v.TYPES[d.type] == "prismatic" for d in found}
    assert all(d.parent == answer.decisions[part].parent for d in found)
    assert not list(other_motions(answer, structure, answer.root, prior[part], same[part]))

    prediction = predictor.predict(whole)
    assert prediction.tree is not None and prediction.alternatives
    diagonal = float(np.linalg.norm(np.ptp(whole.bounds, axis=0)))
    for link in prediction.alternatives:
        likely = prediction.likely(link)
        assert 2 <= len(likely) <= 3
        for k, joint in enumerate(likely):
            assert (joint.name, joint.child) == (likely[0].name, link)
            assert not any(same_motion(joint, j, 0.15, 0.06 * diagonal) for j in likely[:k])
    locked = (prediction.tree.joints[0],)
    assert locked[0].child not in predictor.predict(whole, locked=locked).alternatives


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
