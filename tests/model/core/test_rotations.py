"""Scales and rotations that come out of a matrix as they went in."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from model.core.geometry import affine, axis_scales, quaternion_wxyz, uniform_scale
from model.core.shapes import Primitive, moved_shape
from sessions.document import ObjectFrame

SCALES = (1.5, 0.1, 0.001, 0.0254, 0.3, 2.7, 1 / 3, 1000.0)


@pytest.mark.parametrize("scale", SCALES)
def test_a_scale_comes_back_as_it_was(scale: float) -> None:
    exact = float(f"{scale:.12g}")
    for turn in (np.eye(3), *Rotation.random(50, np.random.default_rng(0)).as_matrix()):
        assert uniform_scale(scale * turn) == exact
        assert axis_scales(turn * [scale, 1.0, 2 * exact]).tolist()[:2] == [exact, 1.0]
        sphere = moved_shape(Primitive("sphere", np.eye(4), (0.03,)), affine(scale * turn))
        assert isinstance(sphere, Primitive) and sphere.sizes == (exact * 0.03,)


def test_a_frame_keeps_the_scale_that_was_asked_for() -> None:
    frame = ObjectFrame(scale=0.001)
    for turn in Rotation.random(20, np.random.default_rng(1)).as_matrix():
        frame = frame.then(affine(turn))
        assert frame.scale == 0.001
    assert frame.then(affine(1.5 * np.eye(3))).scale == 0.001 * 1.5


def test_a_quaternion_has_one_sign() -> None:
    """Half and quarter turns, of which two quaternions are equally good, with a residue."""
    rng = np.random.default_rng(0)
    for wxyz in ((0, 1, 0, 0), (0, 0, -1, 0), (0.5**0.5, -(0.5**0.5), 0, 0), (0, 0, 0.6, -0.8)):
        turn = Rotation.from_quat([*wxyz[1:], wxyz[0]]).as_matrix()
        found = {quaternion_wxyz(turn + rng.uniform(-1e-16, 1e-16, (3, 3))) for _ in range(20)}
        (one,) = found
        assert next(v for v in one if v) > 0 and "-0.0" not in map(str, one)
        assert np.allclose(Rotation.from_quat([*one[1:], one[0]]).as_matrix(), turn, atol=1e-12)
