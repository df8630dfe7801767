"""What the scorers of clicks on moving parts learn from."""

from dataclasses import replace

import numpy as np
import pytest

from model.data.simulated.scans import build, ornamented
from model.segmentation.models import load_scorer
from model.segmentation.object_features import MOVING_FEATURE_NAMES, OBJECT_FEATURE_NAMES
from model.segmentation.scores import MOVING_SCORERS, SCORERS
from model.training.segmentation.clicks import ClickTraining, CloudTraining, train_clouds
from model.training.segmentation.rows import Boosting
from model.training.segmentation.visible_objects import (
    CorrectiveClickTraining,
    MovingPartTraining,
    play,
    play_sessions,
    train_corrective,
    train_moving,
)

FEW = Boosting(trees=8, leaves=4, least=5, forests=2)
SMALL = MovingPartTraining(
    parts=2, clicks=2, networks=1, held_out=2, workers=1, points=(10_000, 10_000, 10_000)
)


def test_ornaments_stand_out_of_the_parts_that_they_are_on() -> None:
    richer = 0
    for seed in range(300, 306):
        shape = build(seed)
        made = ornamented(shape, np.random.default_rng(seed))
        old, new = len(shape.mesh.faces), len(made.mesh.faces)
        assert np.array_equal(made.part[:old], shape.part)
        assert np.array_equal(made.mesh.faces[:old], shape.mesh.faces)
        richer += new > old
        low, high = shape.mesh.bounds
        reach = 0.1 * np.linalg.norm(high - low)
        for part in np.unique(made.part[old:]):
            relief = made.mesh.vertices[made.mesh.faces[old:][made.part[old:] == part]]
            own = shape.mesh.vertices[shape.mesh.faces[shape.part == part]].reshape(-1, 3)
            assert (relief.reshape(-1, 3) > own.min(0) - reach).all(), "at its own part"
            assert (relief.reshape(-1, 3) < own.max(0) + reach).all()
    assert richer >= 2


def test_ornaments_are_the_same_for_the_same_seed() -> None:
    shape = build(304)
    one, two = (ornamented(shape, np.random.default_rng(1)) for _ in range(2))
    assert np.array_equal(one.mesh.vertices, two.mesh.vertices)


@pytest.mark.parametrize("share", ["camera", "one_sided", "mesh"])
def test_clicks_on_moving_parts_are_played(share: str) -> None:
    none = {"camera": 0.0, "one_sided": 0.0, "mesh": 0.0}
    config = replace(SMALL, **{**none, share: 1.0})
    seed = 200_004  # two parts that move
    rows = play(seed, config)
    assert rows.features.shape[1] == len(MOVING_FEATURE_NAMES)
    assert np.isfinite(rows.features).all() and (rows.overlap <= 1).all()
    clicks = len(rows.share)
    assert clicks > 0 and rows.click.max() == clicks - 1
    assert (rows.share < 0.9).all(), "never what nobody clicks"
    if share == "mesh":
        assert np.array_equal(rows.features, play(seed, config).features)


def test_the_scorer_is_fitted_measured_and_written(tmp_path) -> None:
    config = replace(SMALL, mesh=1.0, camera=0.0, seeds=((200_000, 200_004, 1),))
    scores = train_moving(config, tmp_path)
    assert 0 <= scores["moving_iou"] <= scores["moving_best_possible"] <= 1
    assert scores["moving_clicks"] > 1
    scorer = load_scorer(tmp_path / MOVING_SCORERS[0], MOVING_FEATURE_NAMES)
    x = np.random.default_rng(0).normal(size=(5, len(MOVING_FEATURE_NAMES)))
    assert np.isfinite(scorer(x.astype(np.float32))).all()


def test_sessions_are_clicks_on_what_is_still_wrong() -> None:
    config = CorrectiveClickTraining(objects=replace(SMALL, camera=1.0, mesh=0.0), later=3)
    rows = play_sessions(200_004, config)
    clicks = len(rows.share)
    assert 0 < clicks <= 3 * 2 * 2, "at most three later ones of each of two on two parts"
    assert np.isfinite(rows.features).all() and (rows.overlap <= 1).all()
    named = dict(zip(MOVING_FEATURE_NAMES, rows.features.T, strict=True))
    assert (named["positives"] + named["negatives"] >= 2).all(), "none is the first"
    assert named["front"].any(), "some are on fronts"
    assert np.array_equal(rows.features, play_sessions(200_004, config).features)


def test_the_scorer_of_later_clicks_is_fitted_measured_and_written(tmp_path) -> None:
    few = {"held_out": 2, "networks": 1, "workers": 1}
    small = replace(SMALL, camera=0.0, mesh=0.0)
    config = CorrectiveClickTraining(((200_000, 200_004, 1),), small, **few)
    scores = train_corrective(config, tmp_path)
    assert 0 <= scores["mending_iou"] <= scores["mending_best_possible"] <= 1
    scorer = load_scorer(tmp_path / MOVING_SCORERS[1], MOVING_FEATURE_NAMES)
    x = np.random.default_rng(0).normal(size=(5, len(MOVING_FEATURE_NAMES)))
    assert np.isfinite(scorer(x.astype(np.float32))).all()


def test_clicks_on_clouds_learn_from_rounds_of_all_kinds(tmp_path) -> None:
    rounds = (("drawers", 90_000, 90_002), ("small", 70_000, 70_002))
    clicks = ClickTraining(parts=2, first_clicks=2, clicks=4, mesh_share=0.0, points=10_000)
    config = CloudTraining(rounds, clicks, held_out=2, first=FEW, later=FEW)
    scores = train_clouds(config, tmp_path)
    for kind, file in zip(("first", "later"), SCORERS["cloud"], strict=True):
        assert 0 <= scores[f"{kind}_iou"] <= scores[f"{kind}_best_possible"] <= 1
        assert scores[f"{kind}_clicks"] > 1
        scorer = load_scorer(tmp_path / file, OBJECT_FEATURE_NAMES)
        x = np.random.default_rng(0).normal(size=(5, len(OBJECT_FEATURE_NAMES)))
        assert np.isfinite(scorer(x.astype(np.float32))).all()
