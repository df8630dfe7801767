"""Boxes between planes: what they hold, how a click ranks them, and which ones clicks leave."""

import numpy as np
import pytest

from model.core.asset import Asset
from model.segmentation.boxes import (
    BOX_SCORE_FEATURES,
    BoxDescriber,
    BoxRanker,
    RankedBoxes,
    shipped_box_model,
    volume_overlap,
)
from model.segmentation.encoding import encode_superpoints
from model.segmentation.graph import shipped_edge_model
from model.segmentation.models import load_mlp
from model.segmentation.plane_boxes import SIDE_FEATURES, BoxGrid, PlaneBoxes
from model.training.segmentation.networks import BoxTraining, rows_of, train_boxes
from tests.builders import cabinet_cloud


@pytest.fixture(scope="module")
def cabinet():
    data = cabinet_cloud()
    nodes, _, _, superpoints = encode_superpoints(data.asset, shipped_edge_model())
    grid = BoxGrid(superpoints)
    return nodes, superpoints, grid, grid.between_planes(superpoints), data.labels


def test_sums_are_what_the_boxes_hold(cabinet) -> None:
    _, superpoints, grid, boxes, _ = cabinet
    held = boxes.sums(grid.place, superpoints.size)
    assert np.allclose(held / superpoints.size.sum(), boxes.share, atol=1e-6)
    some = np.linspace(0, len(held) - 1, 50).astype(int)
    inside = grid.contents(boxes.low[:, some].T, boxes.high[:, some].T, 0)
    assert np.allclose(inside @ superpoints.size, held[some])


def test_a_side_along_a_gap_is_strong_and_one_on_a_wall_is_lined(cabinet) -> None:
    """The left door: a box that ends between the doors and one that cuts the right one in two."""
    _, _, grid, boxes, _ = cabinet
    at = (boxes.high[0] + 1) * grid.step[0]
    whole = (boxes.low[0] <= 2) & (boxes.low[2] <= 20) & (boxes.high[2] >= 235)
    gap = whole & (abs(at - 0.5) < 0.02)
    strength = boxes.sides[:, 0, 1, SIDE_FEATURES.index("strength")]
    elsewhere = whole & (abs(at - 0.5) > 0.1) & (at < 0.9)
    assert gap.any()
    if elsewhere.any():
        assert strength[gap].max() > strength[elsewhere].mean()
    all_ = (boxes.low[0] <= 2) & (boxes.high[0] >= 253) & (boxes.low[2] <= 2)
    with_fronts = boxes.sides[all_, 0, :, SIDE_FEATURES.index("lined")]
    assert len(with_fronts) and with_fronts.max() > 0.5


def mirrored(boxes: PlaneBoxes, axis: int) -> PlaneBoxes:
    from dataclasses import replace

    low, high, sides = boxes.low.copy(), boxes.high.copy(), boxes.sides.copy()
    low[axis], high[axis] = 255 - boxes.high[axis], 255 - boxes.low[axis]
    sides[:, axis] = boxes.sides[:, axis, ::-1]
    return replace(boxes, low=low, high=high, sides=sides)


def test_features_are_the_same_for_mirrored_objects_and_turned_ones(cabinet) -> None:
    from dataclasses import replace

    _, _, grid, boxes, _ = cabinet
    spot, faces = grid.place[:, 100].astype(int), grid.facing[:, 100]
    found = boxes.holding(spot)
    assert len(found) > 10
    features = BoxDescriber(boxes, grid.step)(found, spot, faces)
    assert features.shape == (len(found), len(BOX_SCORE_FEATURES))
    assert np.isfinite(features).all()
    for axis in (0, 1):
        other = spot.copy()
        other[axis] = 255 - other[axis]
        again = BoxDescriber(mirrored(boxes, axis), grid.step)(found, other, faces)
        # In the very middle either side is the near one.
        same = np.isclose(again, features, atol=1e-5).all(1)
        assert same.mean() > 0.9
    turn = [1, 0, 2]
    turned = replace(boxes, low=boxes.low[turn], high=boxes.high[turn], sides=boxes.sides[:, turn])
    again = BoxDescriber(turned, grid.step[turn])(found, spot[turn], faces[turn])
    assert np.isclose(again, features, atol=1e-5).all(1).mean() > 0.9


def test_clicks_leave_boxes_that_hold_them_the_likeliest_first(cabinet) -> None:
    _, superpoints, grid, boxes, labels = cabinet
    beliefs = BoxRanker(boxes, grid.place, grid.facing, grid.step, shipped_box_model())
    left, right = (int(superpoints.of_node[np.nonzero(labels == p)[0][50]]) for p in (1, 2))
    before, after = beliefs((left,), ()), beliefs((left,), (right,))
    assert 0 < len(after.score) < len(before.score)
    for left_over in (before, after):
        assert (np.diff(left_over.score) <= 0).all()
        inside = grid.contents(left_over.low.T, left_over.high.T, 0)
        assert inside[:, left].all()
    assert not grid.contents(after.low.T, after.high.T, 0)[:, right].any()
    apart = before.apart(6)
    assert apart[0] == 0 and len(set(apart.tolist())) == len(apart)
    low, high = before.low[:, apart].T, before.high[:, apart].T
    overlap = volume_overlap(low, high, low, high) - np.eye(len(apart))
    assert overlap.max() < 0.66
    sizes = before.of_all_sizes(6)
    assert len(set(np.floor(np.log(before.share[sizes]) / 0.3).tolist())) == len(sizes)


def test_overlap_of_volumes() -> None:
    low, high = np.array([[0, 0, 0]], np.int16), np.array([[9, 9, 9]], np.int16)
    others = (
        np.array([[0, 0, 0], [5, 0, 0], [20, 0, 0]], np.int16),
        np.array([[9, 9, 9], [14, 9, 9], [29, 9, 9]], np.int16),
    )
    assert np.allclose(volume_overlap(low, high, *others), [[1, 1 / 3, 0]])


def test_without_boxes_none_are_offered() -> None:
    zero = np.zeros(0, np.float32)
    none = RankedBoxes(np.zeros((3, 0), np.int16), np.zeros((3, 0), np.int16), zero, zero)
    box = np.zeros((1, 3), np.int16)
    assert (
        not len(none.apart(3))
        and not len(none.of_all_sizes(3))
        and not len(none.alike(box, box, 0.5))
    )


def test_an_object_without_planes_has_no_boxes_and_is_answered() -> None:
    """A ball: nothing faces along a direction for long."""
    from model.core.geometry import PointCloud
    from model.segmentation.default import DefaultSegmenter
    from model.segmentation.prompts import Click, Prompts

    rng = np.random.default_rng(0)
    points = rng.normal(size=(3000, 3))
    points = (points / np.linalg.norm(points, axis=1, keepdims=True)).astype(np.float32)
    session = DefaultSegmenter().encode(Asset("ball", cloud=PointCloud(points)))
    assert (session.segment(Prompts((Click(points[0], 1, True, 0),))).labels == 1).any()


def test_training_measures_and_writes_what_the_segmenter_reads(tmp_path) -> None:
    config = BoxTraining(objects=4, held_out=2, parts=2, networks=1)
    rows = rows_of(config.first_seed + 1, config)
    assert rows and all(len(f) == len(o) and best >= o.max() - 1e-6 for f, o, best in rows)
    scores = train_boxes(config, tmp_path / "boxes.npz")
    assert 0 < scores["iou"] <= scores["best_possible"] <= 1
    model = load_mlp(tmp_path / "boxes.npz", BOX_SCORE_FEATURES)
    assert np.isfinite(model(rows[0][0])).all()
