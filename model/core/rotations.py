"""Affine matrices, and rotations as URDF and SDF write them: roll, pitch, yaw, radians."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation


def affine(
    linear: npt.ArrayLike | None = None, shift: npt.ArrayLike | None = None
) -> npt.NDArray[np.float64]:
    """(4, 4) of a (3, 3) linear map and a (3,) shift; the identity's where one is None."""
    out = np.eye(4)
    if linear is not None:
        out[:3, :3] = linear
    if shift is not None:
        out[:3, 3] = shift
    return out


def axis_scales(linear: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """(3,) scales above 0 along the axes in a (3, 3) map that then turns; to 12 digits, so that
    they come back as somebody asked for them, on every processor."""
    return np.array([float(f"{v:.12g}") for v in np.linalg.norm(linear, axis=0)])


def uniform_scale(linear: npt.NDArray[np.floating]) -> float:
    """The scale above 0 of a (3, 3) rotation and uniform scale, as :func:`axis_scales`."""
    return float(np.median(axis_scales(linear)))


def quaternion_wxyz(pose: npt.NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Unit quaternion of a (3, 3) rotation or (4, 4) rigid pose; its first number but 0 is > 0."""
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
    exact = np.round([w, x, y, z], 12)
    w, x, y, z = (exact * np.sign(exact[exact != 0][0]) + 0.0).tolist()
    return w, x, y, z


def about(axis: int, angle: float) -> npt.NDArray[np.float64]:
    """(3, 3) turn about an axis, 0 to 2 for x to z, by radians."""
    c, s = math.cos(angle), math.sin(angle)
    out = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out[i, i], out[i, j], out[j, i], out[j, j] = c, -s, s, c
    return out


def rotation_from_rpy(rpy: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """(3, 3) from URDF's roll, pitch, yaw: fixed axes x, then y, then z, radians."""
    roll, pitch, yaw = (float(v) for v in np.asarray(rpy))
    return about(2, yaw) @ about(1, pitch) @ about(0, roll)


def rpy_from_rotation(rotation: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(3,) roll, pitch, yaw of (3, 3); the inverse of :func:`rotation_from_rpy`."""
    r = np.where(np.abs(rotation) < 1e-15, 0.0, rotation)  # a residue's sign would turn pi round
    flat = float(np.hypot(r[0, 0], r[1, 0]))
    pitch = np.arctan2(-r[2, 0], flat)
    if flat < 1e-9:  # roll and yaw turn about the same line
        return np.array([np.arctan2(-r[1, 2], r[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(r[2, 1], r[2, 2]), pitch, np.arctan2(r[1, 0], r[0, 0])])
