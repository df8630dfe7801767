"""Noise of clouds: its measurement and removal."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from model.core.articulated_object import Part
from model.core.geometry import PointCloud
from model.data.procedural.generate import ProceduralSet
from model.prediction.geometric.predictor import GeometricPredictor
from model.prediction.geometric.sampled_object import (
    Noise,
    cloud_normals,
    denoised,
    outliers,
    part_surface,
)


def _box(size, count: int = 1024) -> np.ndarray:
    """Points on the surface of a box about the origin."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.5, 0.5, (count, 3))
    area = np.prod(size) / np.asarray(size)
    face = rng.choice(3, count, p=area / area.sum())
    points[np.arange(count), face] = rng.choice([-0.5, 0.5], count)
    return points * size


def _sampled(points: np.ndarray, sigma: float):
    noisy = points + sigma * np.random.default_rng(1).standard_normal(points.shape)
    return part_surface(Part("link_0", cloud=PointCloud(noisy.astype(np.float32))), 6000, 0)


@pytest.mark.parametrize("sigma", [0.002, 0.01, 0.02])
def test_the_noise_of_a_surface_is_measured(sigma: float) -> None:
    """Below the points' spacing (here .02) and above it."""
    noise = _sampled(_box((0.7, 0.6, 0.5), 4000), sigma).noise
    assert noise.measured
    assert noise.sigma == pytest.approx(sigma, rel=0.45)


def test_noise_of_small_parts_and_rods_is_not_measured() -> None:
    button = _sampled(_box((0.04, 0.04, 0.02)), 0.01).noise
    assert button.coarse and not button.measured
    rod = np.zeros((500, 3))
    rod[:, 0] = np.linspace(0, 1, 500)
    assert not _sampled(rod, 0.0005).noise.measured
    assert cloud_normals(np.zeros((3, 3)))[2] == Noise()


def test_a_clean_cloud_stays_as_it_is() -> None:
    sampled = _sampled(_box((0.5, 0.4, 0.02)), 0.0)
    after = denoised(sampled, sampled.noise.sigma)
    assert after.points is sampled.points and after.outline is sampled.outline
    assert after.noise == sampled.noise


def test_outliers_are_removed() -> None:
    rng = np.random.default_rng(3)
    panel = _box((0.6, 0.5, 0.02))
    floating = rng.uniform(-0.5, 0.5, (20, 3)) + (0, 0, 1.0)
    sampled = _sampled(np.concatenate([panel, floating]), 0.001)
    assert len(sampled.points) == len(sampled.outline) == len(panel)
    assert np.ptp(sampled.outline, axis=0) == pytest.approx((0.6, 0.5, 0.02), abs=0.02)
    dense = rng.random((2000, 3)) * 0.05
    assert not outliers(np.concatenate([dense, panel])).any()  # a sparse region


def test_surfaces_are_smoothed() -> None:
    """A noisy panel loses at least a third of its noise."""
    flat = _box((0.6, 0.5, 1e-6))
    sampled = _sampled(flat, 0.02)
    assert sampled.noise.measured and sampled.noise.coarse
    after = denoised(sampled, sampled.noise.sigma).points
    assert np.abs(after[:, 2]).mean() < 0.65 * np.abs(sampled.points[:, 2]).mean()
    assert len(after) == len(flat)


def test_a_button_gets_its_size_back() -> None:
    clean = _box((0.05, 0.05, 0.03))
    sampled = _sampled(clean, 0.01)
    after = denoised(sampled, 0.01)
    spread, wanted, found = (p.std(0) for p in (sampled.points, clean, after.points))
    assert np.abs(found - wanted).max() < 0.15 * np.abs(spread - wanted).max()
    assert np.median(KDTree(after.points).query(clean)[0]) < 0.01


def test_noisy_keys_are_pressed_not_turned() -> None:
    """Small parts look like balls under noise."""
    truth = ProceduralSet(seed=2, families=("Remote",), fault="noise").load("Remote_2_0")
    predicted = GeometricPredictor().predict(truth.segmented(names=False)).tree
    assert predicted is not None
    right = [predicted.joint_of[j.child].type == j.type for j in truth.object.tree.joints]
    assert np.mean(right) > 0.8
