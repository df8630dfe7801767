"""Poses in scene files → (4, 4) in metres, right-handed, +z up."""

from __future__ import annotations

import math

import numpy as np

from model.core.rotations import affine, rotation_from_rpy
from model.scenes.scene import FloatArray, SceneObjectError

_SWAP = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]])
"""Unity's (x, y up, z), left-handed, to (x, y, z up), right-handed: its own inverse."""


def pose(position: FloatArray, rotation: FloatArray | None = None) -> FloatArray:
    """(4, 4) from (3,) metres and a (3, 3) rotation."""
    return affine(rotation, position)


def from_rpy(values: FloatArray) -> FloatArray:
    """(4, 4) from (6,) x y z roll pitch yaw, radians, as URDF and SDF have them."""
    return pose(values[:3], rotation_from_rpy(values[3:]))


def rotation_from_quaternion(xyzw: FloatArray) -> FloatArray:
    """(3, 3) from a quaternion x, y, z, w of any length but zero.

    Raises:
        SceneObjectError: for one of zeros, which turns nothing.
    """
    length = float(np.linalg.norm(xyzw))
    if length < 1e-9:
        raise SceneObjectError(
            f"its quaternion {xyzw.tolist()} (x y z w) is zero; one of length 1 is needed"
        )
    x, y, z, w = xyzw / length
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def from_unity(position: FloatArray, degrees: FloatArray) -> FloatArray:
    """(4, 4) from Unity: metres, y up, left-handed; Euler angles applied z, then x, then y."""
    x, y, z = np.radians(degrees)
    turn = _about(1, y) @ _about(0, x) @ _about(2, z)
    return pose(_SWAP @ position, _SWAP @ turn @ _SWAP)


def about_z(angle: float) -> FloatArray:
    """(3, 3) turn about +z by radians."""
    return _about(2, angle)


def _about(axis: int, angle: float) -> FloatArray:
    c, s = math.cos(angle), math.sin(angle)
    out = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out[i, i], out[i, j], out[j, i], out[j, j] = c, -s, s, c
    return out
