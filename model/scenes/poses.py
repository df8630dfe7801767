"""Poses in scene files → (4, 4) in metres, right-handed, +z up."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from model.core.geometry import about, affine, rotation_from_rpy
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
    if np.linalg.norm(xyzw) < 1e-9:
        raise SceneObjectError(
            f"its quaternion {xyzw.tolist()} (x y z w) is zero; one of length 1 is needed"
        )
    return Rotation.from_quat(xyzw).as_matrix()


def from_unity(position: FloatArray, degrees: FloatArray) -> FloatArray:
    """(4, 4) from Unity: metres, y up, left-handed; Euler angles applied z, then x, then y."""
    x, y, z = np.radians(degrees)
    turn = about(1, y) @ about(0, x) @ about(2, z)
    return pose(_SWAP @ position, _SWAP @ turn @ _SWAP)


def about_z(angle: float) -> FloatArray:
    """(3, 3) turn about +z by radians."""
    return about(2, angle)
