"""Replace polyhedra by similar primitives, which simulators collide faster."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.core.rotations import affine
from model.core.shapes import Hull, Kind, Primitive

BOX = 0.97
"""Smallest share of its box that a box-like hull fills."""
ROUND = 0.03
"""Largest deviation of vertices from a round surface, over its radius."""
CORNERS = 20
"""Fewest vertices of a round hull."""

FloatArray = npt.NDArray[np.float64]


def primitive_of(hull: Hull) -> Primitive | None:
    """Fit a box, sphere, cylinder or capsule; None where none is similar enough."""
    found = _box(hull)
    if found is not None or len(hull.vertices) < CORNERS:
        return found
    found = _sphere(hull)
    if found is not None:
        return found
    for axis in _axes(hull):
        found = _cylinder(hull, axis) or _capsule(hull, axis)
        if found is not None:
            return found
    return None


def _box(hull: Hull) -> Primitive | None:
    a, b, c = np.moveaxis(hull.vertices[hull.faces], 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    normals = hull.planes[:, :3]
    first = normals[_heaviest(normals, areas)]
    flat = normals - np.outer(normals @ first, first)
    length = np.linalg.norm(flat, axis=1)
    beside = areas * (length > 0.99)
    if not beside.any():
        return None
    second = flat[_heaviest(normals, beside)]
    second = second / np.linalg.norm(second)
    rotation = np.stack([first, second, np.cross(first, second)], axis=1)
    local = hull.vertices @ rotation
    low, high = local.min(axis=0), local.max(axis=0)
    if hull.volume < BOX * float(np.prod(high - low)):
        return None
    return _placed("box", rotation, rotation @ ((low + high) / 2), tuple(high - low))


def _heaviest(normals: FloatArray, areas: FloatArray) -> int:
    """Face whose normal, up to sign, has the largest total area."""
    same = np.abs(normals @ normals.T) > 0.999
    return int((same @ areas * (areas > 0)).argmax())


def _axes(hull: Hull) -> list[FloatArray]:
    """Candidate axes of revolution: of the largest flat faces, then the principal axes."""
    a, b, c = np.moveaxis(hull.vertices[hull.faces], 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    flat = hull.planes[_heaviest(hull.planes[:, :3], areas), :3]
    centred = hull.vertices - hull.vertices.mean(axis=0)
    return [flat, *np.linalg.svd(centred, full_matrices=False)[2]]


def _sphere(hull: Hull) -> Primitive | None:
    at = hull.vertices
    system = np.column_stack([2 * at, np.ones(len(at))])
    answer = np.linalg.lstsq(system, (at**2).sum(axis=1), rcond=None)[0]
    center = answer[:3]
    radii = np.linalg.norm(at - center, axis=1)
    radius = float(radii.max())
    whole = hull.volume > 0.8 * 4 / 3 * np.pi * radius**3
    if not whole or np.ptp(radii) > ROUND * radius:
        return None
    return _placed("sphere", np.eye(3), center, (radius,))


def _along(hull: Hull, axis: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Frame (3, 3) with z along the axis, a point on it, and the vertices' heights and radii."""
    helper = np.eye(3)[np.abs(axis).argmin()]
    x = np.asarray(np.cross(axis, helper), np.float64)
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(axis, x), axis], axis=1)
    local = hull.vertices @ rotation
    system = np.column_stack([2 * local[:, :2], np.ones(len(local))])
    answer = np.linalg.lstsq(system, (local[:, :2] ** 2).sum(axis=1), rcond=None)[0]
    radii = np.linalg.norm(local[:, :2] - answer[:2], axis=1)
    return rotation, np.array([*answer[:2], 0.0]), local[:, 2], radii


def _cylinder(hull: Hull, axis: FloatArray) -> Primitive | None:
    rotation, middle, height, radii = _along(hull, axis)
    low, high, radius = float(height.min()), float(height.max()), float(radii.max())
    ends = np.minimum(height - low, high - height).max()
    whole = hull.volume > 0.9 * np.pi * radius**2 * (high - low)
    if np.ptp(radii) > ROUND * radius or ends > ROUND * (high - low) or not whole:
        return None
    middle[2] = (low + high) / 2
    return _placed("cylinder", rotation, rotation @ middle, (radius, high - low))


def _capsule(hull: Hull, axis: FloatArray) -> Primitive | None:
    rotation, middle, height, radii = _along(hull, axis)
    low, high, radius = float(height.min()), float(height.max()), float(radii.max())
    length = high - low - 2 * radius
    if length < 0.2 * radius:
        return None
    beyond = np.maximum(np.maximum(low + radius - height, height - (high - radius)), 0.0)
    away = np.hypot(beyond, radii)
    volume = np.pi * radius**2 * (length + 4 / 3 * radius)
    if np.ptp(away) > ROUND * radius or hull.volume < 0.8 * volume:
        return None
    middle[2] = (low + high) / 2
    return _placed("capsule", rotation, rotation @ middle, (radius, length))


def _placed(
    kind: Kind, rotation: FloatArray, center: FloatArray, sizes: tuple[float, ...]
) -> Primitive:
    pose = affine(rotation, center)
    return Primitive(kind, pose, tuple(float(s) for s in sizes))
