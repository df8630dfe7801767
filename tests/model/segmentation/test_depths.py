"""The largest ball in a mask, and clicks that lie in the middle of something."""

import numpy as np
import pytest

from model.segmentation.mask_features import bits_of
from model.segmentation.object_features import Depths
from model.segmentation.prompts import central, deepest


@pytest.fixture(scope="module")
def plane() -> np.ndarray:
    """10,000 points of a unit square, a hundredth apart."""
    side = np.arange(100) / 100
    x, y = np.meshgrid(side, side)
    return np.stack([x.ravel(), y.ravel(), np.zeros(10_000)], axis=1)


@pytest.mark.parametrize("radius", [0.04, 0.09, 0.2, 0.35])
def test_largest_ball_of_a_disc_is_nearly_the_disc(plane: np.ndarray, radius: float) -> None:
    disc = np.linalg.norm(plane[:, :2] - 0.5, axis=1) < radius
    (found,) = Depths(plane)(bits_of(disc[None]), 1)
    assert 0.5 * radius <= found <= 1.3 * radius


def test_many_masks_at_once_are_as_each_alone(plane: np.ndarray) -> None:
    rng = np.random.default_rng(0)
    centers, radii = rng.random((150, 2)), rng.uniform(0, 0.5, 150)
    apart = np.linalg.norm(plane[None, :, :2] - centers[:, None], axis=2)
    masks = apart < radii[:, None]
    depths = Depths(plane)
    alone = [float(depths(bits_of(m[None]), 1)[0]) for m in masks]
    assert depths(bits_of(masks), len(masks)).tolist() == alone
    assert np.corrcoef(alone, np.minimum(radii, 0.5))[0, 1] > 0.7


def test_a_long_strip_is_shallow_and_nothing_holds_no_ball(plane: np.ndarray) -> None:
    strip = np.abs(plane[:, 1] - 0.5) < 0.05
    masks = np.stack([strip, np.zeros(len(plane), bool), np.ones(len(plane), bool)])
    thin, none, whole = Depths(plane)(bits_of(masks), 3)
    assert 0.02 <= thin <= 0.07
    assert none == 0
    assert whole > 0.2


@pytest.mark.parametrize("number", [0, 1, 5])
def test_a_handful_of_points_has_no_depth(number: int) -> None:
    found = Depths(np.random.default_rng(0).random((number, 3)))(
        np.full((number, 1), 3, np.uint64), 2
    )
    assert found.tolist() == [0, 0]


def test_clicks_in_a_hurry_lie_between_random_and_deepest(plane: np.ndarray) -> None:
    region = (np.abs(plane[:, :2] - 0.5) < 0.3).all(1)
    rng = np.random.default_rng(1)

    def depth(index: int) -> float:
        return float(0.3 - np.abs(plane[index, :2] - 0.5).max())

    hurried = np.mean([depth(central(plane, region, rng)) for _ in range(60)])
    random = np.mean([depth(int(i)) for i in rng.choice(np.nonzero(region)[0], 60)])
    assert random + 0.03 < hurried < depth(deepest(plane, region))


def test_a_click_on_what_is_everything_lies_on_it(plane: np.ndarray) -> None:
    chosen = central(plane, np.ones(len(plane), bool), np.random.default_rng(0))
    assert 0 <= chosen < len(plane)
