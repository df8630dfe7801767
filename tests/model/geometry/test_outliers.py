"""Points that float alone are found, sparse surfaces stay, and no click lands on them by chance."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from model.core.asset import Asset
from model.core.geometry import PointCloud
from model.geometry.cleaning import OutlierTest, outlier_points
from model.geometry.picking import Picker

WALL = 20_000


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    """A square wall at y = 0, and 60 points in the air on both sides of it."""
    rng = np.random.default_rng(0)
    wall = np.c_[rng.random(WALL), rng.normal(0, 1e-3, WALL), rng.random(WALL)]
    air = rng.uniform((0, -0.5, 0), (1, 0.5, 1), (90, 3))
    air = air[np.abs(air[:, 1]) > 0.1][:60]
    return np.concatenate([wall, air]).astype(np.float32)


def test_all_and_one_by_one(points) -> None:
    tree = KDTree(points)
    found = outlier_points(points, tree)
    assert np.isin(found, np.arange(WALL, len(points))).all() and len(found) >= 55
    one = OutlierTest(points, tree)
    assert all(one.is_outlier(int(i)) for i in found)
    assert not any(one.is_outlier(i) for i in range(0, WALL, 97))


def test_a_group_is_no_stray(points) -> None:
    """A ball that a camera hardly saw, though nothing joins it to the wall."""
    ball = np.random.default_rng(1).normal(size=(40, 3))
    ball *= 0.08 / np.linalg.norm(ball, axis=1, keepdims=True)
    both = np.concatenate([points, ball + (0.5, -0.4, 0.5)]).astype(np.float32)
    assert outlier_points(both, KDTree(both)).max() < len(points)


@pytest.mark.parametrize("same", [np.zeros((50, 3)), np.tile(np.eye(3), (20, 1))])
def test_points_at_one_place_are_no_strays(same) -> None:
    tree = KDTree(same)
    assert len(outlier_points(same, tree)) == 0
    assert not OutlierTest(same, tree).is_outlier(0)


def test_where_no_distance_is_usual_nothing_is_stray() -> None:
    rng = np.random.default_rng(0)
    twice = np.concatenate([np.repeat(rng.random((100, 3)), 12, axis=0), rng.random((90, 3))])
    dense = np.concatenate([rng.random((900, 3)) * 1e-3, rng.random((300, 3))])
    for points in (twice, dense):
        tree = KDTree(points)
        one = OutlierTest(points, tree)
        assert len(outlier_points(points, tree)) == 0
        assert not any(one.is_outlier(i) for i in range(0, len(points), 7))


def test_a_click_passes_strays_to_what_is_behind(points) -> None:
    pick = Picker(Asset("wall", cloud=PointCloud(points))).pick
    eye = np.array([0.5, -3.0, 0.5])
    for place in points[WALL:][points[WALL:, 1] < 0]:
        found = pick(eye, place - eye)
        aim = eye + (place - eye) * (3 / (3 + place[1]))
        if (np.abs(aim[[0, 2]] - 0.5) < 0.45).all():
            assert found is not None and found.element < WALL
            assert np.linalg.norm(found.position - aim) < 0.05
    # Where nothing else is, a stray is what is meant.
    above = np.concatenate([points, [[0.5, 0.0, 2.0]]]).astype(np.float32)
    found = Picker(Asset("wall", cloud=PointCloud(above))).pick(eye, (0.0, 3.0, 1.5))
    assert found is not None and found.element == len(points)
