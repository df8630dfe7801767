"""Which masks are proposed as parts before any click."""

from dataclasses import replace

import numpy as np
import pytest

from model.segmentation import all_parts
from model.segmentation.all_parts import (
    PART_FEATURE_NAMES,
    PART_SCORER,
    WORTH,
    exclusive_parts,
    shipped_part_scorer,
    vote_for_masks,
)
from model.segmentation.default import DefaultSession
from model.segmentation.models import load_mlp
from model.segmentation.object_features import HISTORY_FEATURES
from model.segmentation.similar import MaskExample, MaskTable, by_examples, telling, within_counts
from model.segmentation.solver import overlaps
from model.training.segmentation.networks import PartMaskTraining, play_masks, train_part_masks
from model.training.segmentation.visible_objects import MovingPartTraining

SMALL = PartMaskTraining(asked=6, spread=40, networks=1, held_out=2, workers=1)


@pytest.fixture
def session(cloud_session) -> DefaultSession:
    return cloud_session


@pytest.fixture(scope="module")
def proposed(cloud_session) -> np.ndarray:
    return all_parts.propose_parts(cloud_session).labels


def test_parts_exclude_each_other_but_small_ones_may_sit_on_large_ones() -> None:
    masks = np.zeros((6, 20), bool)
    masks[0, :10] = True  # a door
    masks[1, :9] = True  # nearly the same one
    masks[2, 2:4] = True  # its handle
    masks[3, 8:14] = True  # across its border
    masks[4, 14:] = True  # another door
    masks[5, :6] = True  # half of it
    common, _ = overlaps(masks, np.ones(20))
    worth = np.array([2.0, 1.9, 1.0, 1.5, -0.5, 1.8], np.float32)
    assert exclusive_parts(worth, common, -1.0) == [0, 2, 4]
    assert exclusive_parts(worth, common, 0.0) == [0, 2]
    assert exclusive_parts(worth, common, 3.0) == []
    assert exclusive_parts(worth[:0], common[:0, :0], -1.0) == []


def test_voted_masks_are_described(session: DefaultSession) -> None:
    solver, superpoints = session.solver, session.encoding.superpoints
    voters = all_parts.spread(superpoints.center, 12)
    assert len(set(voters.tolist())) == 12
    voted = vote_for_masks(solver, voters)
    assert voted.masks.shape == (len(voted.features), len(superpoints))
    assert len(np.unique(np.packbits(voted.masks, axis=1), axis=0)) == len(voted.masks)
    assert voted.masks[:, voters].any(1).all(), "some superpoint within votes for each"
    assert np.isfinite(voted.features).all()
    named = dict(zip(PART_FEATURE_NAMES, voted.features.T, strict=True))
    for share in ("said", "likely", "agreed", "agreed_most", "asked"):
        assert (named[share] >= 0).all() and (named[share] <= 1 + 1e-5).all(), share
    np.testing.assert_allclose(named["asked"], voted.masks[:, voters].mean(1), atol=1e-6)
    assert (named["score_most"] >= named["score"] - 1e-5).all()
    assert (named["behind_least"] <= 1e-6).all() and (named["behind_least"] == 0).any()
    again = vote_for_masks(solver, voters)
    assert np.array_equal(voted.features, again.features)
    # Who is voters first does not matter.
    turned = vote_for_masks(solver, voters[::-1])
    assert len(turned.masks) == len(voted.masks)


def test_proposed_parts_are_doors_and_not_the_body(cloud_cabinet, proposed) -> None:
    labels, true = proposed, cloud_cabinet.labels
    found = [labels == part for part in np.unique(labels[labels > 0])]
    assert found
    best = [
        max(float((m & (true == p)).sum() / (m | (true == p)).sum()) for m in found)
        for p in np.unique(true[true > 0])
    ]
    assert np.mean(np.array(best) > 0.7) >= 0.5
    assert not any((m & (true == 0)).sum() > 0.5 * (true == 0).sum() for m in found)


def test_without_a_scorer_cells_agree_on_parts(
    cloud_cabinet, session: DefaultSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(all_parts, "shipped_part_scorer", lambda: None)
    labels = all_parts.propose_parts(session).labels
    assert len(labels) == len(cloud_cabinet.labels) and labels.max() > 0


def test_the_shipped_scorer_says_how_it_was_made() -> None:
    scorer = shipped_part_scorer()
    voters = tuple(n for n in PART_FEATURE_NAMES if n not in HISTORY_FEATURES)
    assert scorer is not None and scorer.names == voters, "nothing was clicked before"


def test_masks_of_a_made_object_are_worth_their_overlap_with_what_moves() -> None:
    config = replace(SMALL, objects=MovingPartTraining(mesh=1.0, camera=0.0, one_sided=0.0))
    rows = play_masks(200_004, config)
    assert rows.features.shape == (len(rows.masks), len(PART_FEATURE_NAMES))
    assert rows.overlap.shape[0] == len(rows.masks) and rows.overlap.shape[1] >= 1
    assert (rows.overlap >= 0).all() and (rows.overlap <= 1 + 1e-6).all()
    assert rows.share.max() > 0.5, "some mask is a part"
    again = play_masks(200_004, config)
    assert np.array_equal(rows.features, again.features)


def test_the_scorer_is_fitted_measured_and_written(tmp_path) -> None:
    config = replace(
        SMALL,
        seeds=((200_000, 200_004, 1),),
        objects=MovingPartTraining(mesh=1.0, camera=0.0, one_sided=0.0),
    )
    scores = train_part_masks(config, tmp_path)
    assert 0 <= scores["parts_right"] <= 1 and 0 <= scores["parts_found"] <= 1
    assert scores["parts_objects"] >= 3
    scorer = load_mlp(tmp_path / PART_SCORER, PART_FEATURE_NAMES)
    x = np.random.default_rng(0).normal(size=(5, len(PART_FEATURE_NAMES)))
    assert np.isfinite(scorer(x.astype(np.float32))).all()


def masks_of(drawers: int, faults: int = 0) -> tuple[MaskExample, ...]:
    """A chest's masks: drawers that fill its front, each whole and by half, and its sides."""
    rows = [(-0.5 + (k + 0.5) / drawers, 0.3 / drawers) for k in range(drawers)]
    whole = [MaskExample(-2.0, (0, -0.5, z), (0.4, 0.01, half), "drawer") for z, half in rows]
    half = [MaskExample(-1.9, (0.25, -0.5, z), (0.2, 0.01, half)) for z, half in rows]
    sides = [MaskExample(0.5, (x, 0, 0), (0.01, 0.3, 0.5)) for x in (-0.5, 0.5)]
    return (*whole[faults:], *(replace(m, part=None) for m in whole[:faults]), *half, *sides)


def test_masks_of_accepted_objects_tell_which_are_parts_whatever_their_count_and_turn() -> None:
    known = telling([MaskTable.of(masks_of(n)) for n in (3, 4, 5)])
    assert len(known) == 3
    for turn in (np.eye(3), np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])):
        own = MaskTable.of(masks_of(4))
        own = replace(own, place=own.place @ turn.T, half=own.half @ np.abs(turn).T)
        worth, names = by_examples(own, known)
        assert (worth[own.right].min() > WORTH > worth[~own.right].max()).all()
        assert {names[k] for k in np.flatnonzero(own.right)} == {"drawer"}


def test_accepted_objects_that_tell_nothing_about_each_other_are_not_followed() -> None:
    def elsewhere(turn: int) -> tuple[MaskExample, ...]:
        right = MaskExample(1.0, (0.4 - 0.4 * turn, 0.0, 0.3), (0.1, 0.1, 0.1 + turn), "lid")
        return (right, *(replace(right, worth=0.0, part=None, place=(x, 0.0, 0.3)) for x in X))

    X = (0.4, 0.0, -0.4)
    own = MaskTable.of(masks_of(3))
    assert telling([MaskTable.of(elsewhere(k)) for k in range(3)]) == [] == telling([own])
    assert telling([]) == []
    assert by_examples(own, [])[0] is own.worth


def test_there_are_as_many_of_a_name_as_accepted_objects_have_unless_more_are_likely() -> None:
    known = [MaskTable.of(masks_of(3), names) for names in (["door"], ["door", "drawer", "drawer"])]
    names = ["door", "drawer", "drawer", "drawer", "door", "lid"]
    worth = np.array([-1.2, -0.5, -1.4, -0.2, -1.1, -0.1])
    assert within_counts(range(6), worth, names, known) == [3, 1, 4]
    assert within_counts(range(6), worth + 1.15, names, known) == [5, 3, 1, 4]
