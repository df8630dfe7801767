"""Noise comes off surfaces; clean clouds are known as such."""

import numpy as np

from model.geometry.cleaning import NOISY, denoised, noise_level


def _plane(noise: float) -> np.ndarray:
    rng = np.random.default_rng(0)
    points = np.c_[rng.random((8000, 2)), np.zeros(8000)]
    return (points + rng.normal(0, noise, points.shape)).astype(np.float32)


def test_a_noisy_plane_becomes_flat() -> None:
    noisy = _plane(0.01)
    assert noise_level(noisy) > NOISY
    before, after = np.abs(noisy[:, 2]).mean(), np.abs(denoised(noisy)[:, 2]).mean()
    assert after < 0.7 * before


def test_a_clean_plane_counts_as_clean_and_stays() -> None:
    clean = _plane(0.0)
    assert noise_level(clean) < 0.05
    np.testing.assert_allclose(denoised(clean), clean, atol=1e-5)


def test_few_points_stay() -> None:
    few = _plane(0.02)[:10]
    assert noise_level(few[:5]) == 0.0
    assert denoised(few) is few
