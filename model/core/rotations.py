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
    """(3,) scales above 0 along the axes, before a rotation, in a (3, 3) map; to 12 digits.

    So scales that somebody asked for come back as they were, on every processor.
    """
    return np.array([float(f"{v:.12g}") for v in np.linalg.norm(linear, axis=0)])


def uniform_scale(linear: npt.NDArray[np.floating]) -> float:
    """The scale above 0 of a (3, 3) rotation and uniform scale, as :func:`axis_scales`."""
    return float(np.median(axis_scales(linear)))


def quaternion_wxyz(pose: npt.NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Unit quaternion of a (3, 3) rotation or a (4, 4) rigid pose; its first number that isn't 0
    is positive, as the signs of halves of turns would differ between processors.
    """
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
    exact = np.round([w, x, y, z], 12)
    w, x, y, z = (exact * np.sign(exact[exact != 0][0]) + 0.0).tolist()
    return w, x, y, z


def rotation_from_rpy(rpy: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """(3, 3) from URDF's roll, pitch, yaw: fixed axes x, then y, then z, radians."""
    roll, pitch, yaw = (float(v) for v in np.asarray(rpy))
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def rpy_from_rotation(rotation: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(3,) roll, pitch, yaw of (3, 3); the inverse of :func:`rotation_from_rpy`."""
    r = np.where(np.abs(rotation) < 1e-15, 0.0, rotation)  # a residue's sign would turn pi round
    flat = float(np.hypot(r[0, 0], r[1, 0]))
    pitch = np.arctan2(-r[2, 0], flat)
    if flat < 1e-9:  # roll and yaw turn about the same line
        return np.array([np.arctan2(-r[1, 2], r[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(r[2, 1], r[2, 2]), pitch, np.arctan2(r[1, 0], r[0, 0])])
