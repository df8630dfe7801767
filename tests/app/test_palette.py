from __future__ import annotations

import numpy as np
import pytest

from app.viewer.picture.palette import BASE_COLOR, DIRECTIONS, PART_COLORS, SELECTED, part_color


def test_many_parts_have_colours_that_can_be_told_apart():
    colors = np.array([part_color(part) for part in range(1, 37)], float)
    np.testing.assert_array_equal(colors[:12], PART_COLORS)
    assert colors.min() >= 0 and colors.max() <= 255
    lab = _lab(colors)
    apart = np.linalg.norm(lab[:, None] - lab[None], axis=2)
    assert apart[~np.eye(36, dtype=bool)].min() > 12


def _lab(rgb: np.ndarray) -> np.ndarray:
    """CIELAB of sRGB colours 0..255: equal distances look equally far apart."""
    c = rgb / 255
    linear = np.where(c > 0.04045, ((c + 0.055) / 1.055) ** 2.4, c / 12.92)
    to_xyz = np.array(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    )
    xyz = linear @ to_xyz.T / (0.9505, 1.0, 1.089)
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    x, y, z = f.T
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=1)


_SIGHT = {
    "normal": np.eye(3),
    "protan": [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
    "deutan": [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
    "tritan": [[1.256, -0.077, -0.179], [-0.078, 0.931, 0.148], [0.005, 0.691, 0.304]],
}
"""What is seen of linear RGB, severity 1; Machado, Oliveira and Fernandes, 2009, table 1."""


@pytest.mark.parametrize("sight", _SIGHT)
def test_parts_are_told_apart_by_color_blind_people_and_from_marks(sight) -> None:
    axes = DIRECTIONS if sight == "normal" else ()  # letters name them, too
    own, others = (
        _lab_seen(np.array(c, float), np.array(_SIGHT[sight]))
        for c in (PART_COLORS, (SELECTED, BASE_COLOR, *axes))
    )
    apart = np.linalg.norm(own[:, None] - own[None], axis=2)
    assert apart[~np.eye(len(own), dtype=bool)].min() > 10, "two parts look alike"
    assert np.linalg.norm(own[:, None] - others[None], axis=2).min() > 10, "a mark looks alike"


def _lab_seen(rgb: np.ndarray, seen_from_linear: np.ndarray) -> np.ndarray:
    """CIELAB of sRGB colors as somebody sees them."""
    c = rgb / 255
    linear = np.where(c > 0.04045, ((c + 0.055) / 1.055) ** 2.4, c / 12.92) @ seen_from_linear.T
    linear = linear.clip(0, 1)
    srgb = np.where(linear > 0.0031308, 1.055 * linear ** (1 / 2.4) - 0.055, 12.92 * linear)
    return _lab(255 * srgb)
