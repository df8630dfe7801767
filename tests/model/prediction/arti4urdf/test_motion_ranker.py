"""The learned choice among candidates: what it reads, when it overrules, and its training."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed")

from model.core.articulated_object import SegmentedObject
from model.core.errors import InputFileError
from model.core.joint import same_motion
from model.data.procedural.generate import make
from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.choosing import (
    NAMES,
    HybridSettings,
    MotionRanker,
    geometric_prior,
    load_motion_ranker,
    log_share,
    motion_features,
    network_odds,
    other_motions,
)
from model.prediction.arti4urdf.decoding import Answer
from model.prediction.arti4urdf.decoding import same_motion as same_motions
from model.prediction.arti4urdf.network import ArtiModel
from model.prediction.arti4urdf.predictor import Arti4UrdfPredictor, make_prompt
from model.prediction.arti4urdf.structure import RANKS, read_structure
from model.segmentation.models import Trees
from model.training.arti4urdf import motions
from model.training.arti4urdf.motions import Part


def stump(name: str, at: float, low: float, high: float) -> Trees:
    """Log-odds by one feature: ``low`` up to ``at``, ``high`` above."""
    which = NAMES.index(name)
    used, left, roots = (np.array(v, np.int32) for v in ([which, 0, 0], [1, 1, 2], [0]))
    ends, values = (np.array(v, np.float32) for v in ([at, np.inf, np.inf], [0, low, high]))
    return Trees(NAMES, used, ends, left, values, roots, 1)


@pytest.fixture(scope="module")
def oven():
    obj = make("Oven", 11, 0).object
    segmented = SegmentedObject(obj.name, obj.parts, obj.category)
    structure = read_structure(segmented)
    prompt = make_prompt(structure, segmented, 0)
    return structure, prompt, geometric_prior(structure), same_motions(prompt)


def _answer(predictor: Arti4UrdfPredictor, thing) -> Answer:
    structure, prompt, rules, _ = thing
    return predictor.answer(prompt, structure, {}, predictor.prior(rules))


def test_features_do_not_change_when_the_object_is_turned_about_the_vertical(oven) -> None:
    _, prompt, rules, same = oven
    network = np.zeros((2, v.SIZE))
    turned = prompt.arrays.turned(1, mirrored=False)
    for part in range(len(prompt.arrays)):
        slots, found = motion_features(prompt.arrays, part, network, rules[part], same[part])
        _, other = motion_features(turned, part, network, rules[part], same[part])
        assert found.shape == (len(slots), len(NAMES)) and np.isfinite(found).all()
        np.testing.assert_allclose(found, other, atol=2e-3)


def test_a_clear_preference_overrules_and_a_locked_part_stays(oven, tiny_model: ArtiModel) -> None:
    structure, prompt, rules, same = oven
    answer = _answer(Arti4UrdfPredictor(tiny_model, hybrid=HybridSettings()), oven)
    moving = [i for i, d in enumerate(answer.decisions) if d.slot >= 0]
    slides = MotionRanker(stump("turns", 0.5, 4.0, -4.0))
    assert any(v.TYPES[answer.decisions[i].type] != "prismatic" for i in moving)
    after = slides(answer, structure, prompt.arrays, rules, same)
    for i in moving:
        decision = after.decisions[i]
        chosen = structure.slots[i][decision.slot]
        assert v.TYPES[decision.type] == chosen.type == "prismatic"
        assert decision.parent == answer.decisions[i].parent
    kept = slides(answer, structure, prompt.arrays, rules, same, frozenset(moving))
    assert kept.decisions == answer.decisions


def test_other_motions_come_by_their_odds_and_differ(oven, tiny_model: ArtiModel) -> None:
    structure, prompt, rules, same = oven
    predictor = Arti4UrdfPredictor(tiny_model, hybrid=HybridSettings())
    answer = _answer(predictor, oven)
    after = MotionRanker(stump("turns", 0.5, 0.1, -0.1))(
        answer, structure, prompt.arrays, rules, same
    )
    part = next(i for i, d in enumerate(answer.decisions) if d.slot >= 0)
    found = list(other_motions(after, structure, part, rules[part], same[part]))
    turns = [v.TYPES[d.type] != "prismatic" for d in found]
    assert turns == sorted(turns), "what the ranker prefers comes first"
    assert {True, False} == set(turns)
    assert all(d.parent == answer.decisions[part].parent for d in found)
    assert not list(other_motions(answer, structure, part, rules[part], same[part]))

    obj = make("Oven", 11, 0).object
    whole = SegmentedObject(obj.name, obj.parts, obj.category)
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


def test_a_faint_preference_and_another_candidate_with_the_same_motion_change_nothing(
    oven, tiny_model: ArtiModel
) -> None:
    structure, prompt, rules, same = oven
    answer = _answer(Arti4UrdfPredictor(tiny_model, hybrid=HybridSettings()), oven)
    faint = MotionRanker(stump("turns", 0.5, 0.1, -0.1))
    assert faint(answer, structure, prompt.arrays, rules, same).decisions == answer.decisions
    ranks = MotionRanker(stump("rank", 0.5, 0.0, 0.0))
    assert ranks(answer, structure, prompt.arrays, rules, same).decisions == answer.decisions


def test_of_one_motion_the_candidate_is_taken_that_the_rules_prefer() -> None:
    same = np.array([[1, 0, 0], [0, 1, 1], [0, 1, 1]], bool)
    rank = MotionRanker(stump("rank", 0.5, 0, 0))
    likely = log_share(np.array([-3, 2, 1], np.float32))
    assert rank.chosen(0, likely, np.array([0.0, -5.0, -1.0]), same) == 2
    assert rank.chosen(1, likely, np.array([0.0, -5.0, -1.0]), same) == 1
    votes = np.log([1.0, 0.05, 0.05])
    assert rank.chosen(1, likely + votes, np.array([0.0, -5.0, -1.0]), same) == 1, "one is too few"
    assert rank.chosen(1, likely + 3 * votes, np.array([0.0, -5.0, -1.0]), same) == 0


def test_the_shipped_weights_read_these_features_and_others_are_refused(tmp_path: Path) -> None:
    ranker = load_motion_ranker()
    assert set(ranker.trees.names) <= set(NAMES)
    path = tmp_path / "motions.npz"
    other = replace(ranker.trees, names=("something else", *ranker.trees.names[1:]))
    motions.save_trees(other, path, {})
    with pytest.raises(InputFileError, match="made for other features"):
        load_motion_ranker(path)


def _parts(count: int, seed: int) -> list[Part]:
    """Parts whose sliding candidate is right, though the rules prefer the first."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(count):
        features = rng.normal(size=(3, len(NAMES))).astype(np.float32)
        turns = features[:, NAMES.index("turns")] = [1, 1, 0]
        right = np.array(turns) == 0, np.eye(3, dtype=bool)
        name = "" if k % 2 else "thing"
        rest = np.array([0.0, -1, -1]), 0
        out.append(Part(f"object_{k}", name, bool(k % 3), True, features, *right, *rest))
    return out


def test_training_learns_which_candidates_are_right() -> None:
    pytest.importorskip("lightgbm")
    parts = _parts(120, 0)
    found = motions.accuracy(parts, motions.folds(parts, "object_id"), 0)
    assert found["names, before"] == found["no names, before"] == 0
    assert found["names, after"] == found["no names, after"] == 1


def test_parts_of_a_procedural_object_hold_its_true_motions() -> None:
    parts = motions.parts_of(None, 4242, ("3", False, 3))
    assert parts and all(p.features.shape == (len(p.right), len(NAMES)) for p in parts)
    assert any(p.right.any() for p in parts if p.moves)
    assert all(0 <= p.present < len(p.right) for p in parts if p.moves and p.present != -1)


def test_the_network_s_odds_exclude_what_was_not_asked(oven, tiny_model: ArtiModel) -> None:
    structure = oven[0]
    answer = _answer(Arti4UrdfPredictor(tiny_model), oven)
    odds = network_odds(answer, answer.root)
    assert not np.isfinite(odds).any()
    moving = next(i for i, d in enumerate(answer.decisions) if d.slot >= 0)
    slots = np.flatnonzero(np.isfinite(network_odds(answer, moving)[1, v.SLOT_IDS]))
    assert len(slots) and (slots < len(structure.slots[moving])).all() and RANKS == 2
