"""Colors over an object: parts are seen on every surface."""

import numpy as np
import pytest

from app.viewer.picture import palette
from app.viewer.picture.object_nodes import overlay_colors

SURFACES = ((20, 20, 22), (120, 80, 50), (214, 118, 46), (250, 214, 10), (245, 245, 245))


@pytest.mark.parametrize("own", SURFACES)
def test_every_part_is_seen_on_a_surface_and_lets_it_through(own: tuple[int, int, int]) -> None:
    for part in range(1, 25):
        color, opacity = palette.tint(part, own)
        mixed = (1 - opacity) * np.array(own) + opacity * np.array(color)
        assert np.linalg.norm(mixed - own) > 45 and opacity <= 0.8
    dark_or_light = np.random.default_rng(0).integers(-9, 9, (400, 3)) + np.array(own)
    colors = np.clip(dark_or_light, 0, 255).astype(np.uint8)
    labels = np.repeat([0, 3], 200).astype(np.int16)
    tinted = overlay_colors(colors, labels)
    np.testing.assert_array_equal(tinted[:200], colors[:200])
    shift = tinted[200:].mean(0) - colors[200:].mean(0)
    assert np.linalg.norm(shift) > 45
