from __future__ import annotations

import numpy as np

from app.viewer.picture.palette import PART_COLORS, part_color


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
