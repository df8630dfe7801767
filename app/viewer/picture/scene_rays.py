"""Ray casting in a scene, on the shapes that the browser draws."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from model.geometry.picking import DEFAULT_PIXEL_ANGLE, TOLERANCE, rings_around

Array = npt.NDArray[np.float64]
NEAR_RAY = 0.015
"""Share of a cloud's diagonal: points nearer than this to the ray are hit."""
_WIDE = float(np.tan((TOLERANCE + 1) * DEFAULT_PIXEL_ANGLE))
"""Share of the distance: points farther than this from a ray are beyond the tolerance."""


def hit_distance(
    origin: Array,
    direction: Array,
    vertices: npt.NDArray[np.float32],
    faces: npt.NDArray[np.uint32] | None,
) -> float:
    """Multiples of ``direction`` up to the first hit; infinity where there is none.

    Args:
        vertices: (V, 3), of a cloud its points.
        faces: (F, 3), or None for a cloud.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    reach = 0.0 if faces is not None else NEAR_RAY * float(np.linalg.norm(high - low))
    if not meets_boxes(origin, direction, np.array([[low - reach, high + reach]]))[0]:
        return np.inf
    if faces is None:
        return _cloud_hit(origin, direction, vertices.astype(np.float64), reach)
    return _mesh_hit(origin, direction, vertices.astype(np.float64)[faces])


def nearly_hit(
    origin: Array,
    direction: Array,
    vertices: npt.NDArray[np.float32],
    faces: npt.NDArray[np.uint32] | None,
) -> tuple[int, float]:
    """By how many pixels a ray passes a mesh at most, and multiples of it up to there.

    Both are infinite (and beyond the tolerance) where it passes farther away; clouds have a
    tolerance in :func:`hit_distance`.
    """
    missed = TOLERANCE + 1, np.inf
    if faces is None:
        return missed
    triangles = vertices.astype(np.float64)[faces]
    middle = triangles.mean(axis=1)
    reach = np.linalg.norm(triangles - middle[:, None], axis=2).max(axis=1)
    unit = direction / np.linalg.norm(direction)
    away = middle - origin
    along = away @ unit
    off = np.linalg.norm(away - along[:, None] * unit, axis=1)
    near = triangles[off <= 1.01 * reach + _WIDE * np.maximum(along + reach, 0.0)]
    if not len(near):
        return missed
    for pixels, ring in enumerate(rings_around(direction), start=1):
        distance = min(_mesh_hit(origin, d, near) for d in ring)
        if np.isfinite(distance):
            return pixels, distance
    return missed


def meets_boxes(origin: Array, direction: Array, boxes: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """(N,) which of the (N, 2, 3) axis-parallel boxes a ray goes through."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (boxes[:, 0] - origin) / direction, (boxes[:, 1] - origin) / direction
    enter, leave = np.fmax.reduce(np.fmin(a, b), axis=1), np.fmin.reduce(np.fmax(a, b), axis=1)
    return leave >= np.maximum(enter, 0.0)


def within_tolerance(origin: Array, boxes: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """(N, 2, 3) boxes that are wider by what a ray from ``origin`` may pass them by."""
    far = np.abs(boxes - origin).max(axis=1)  # (N, 3) to the farther side
    wide = _WIDE * np.linalg.norm(far, axis=1)[:, None]
    return np.stack([boxes[:, 0] - wide, boxes[:, 1] + wide], axis=1)


def _mesh_hit(origin: Array, direction: Array, triangles: Array) -> float:
    """Möller and Trumbore, 1997, both sides of every triangle."""
    a = triangles[:, 0]
    e1, e2 = triangles[:, 1] - a, triangles[:, 2] - a
    p = np.cross(direction, e2)
    det = (e1 * p).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / det
        s = origin - a
        u = (s * p).sum(axis=1) * inverse
        q = np.cross(s, e1)
        v = (q @ direction) * inverse
        t = (e2 * q).sum(axis=1) * inverse
    hit = (np.abs(det) > 1e-14) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    return float(t[hit].min()) if hit.any() else np.inf


def _cloud_hit(origin: Array, direction: Array, points: Array, reach: float) -> float:
    length = float(np.linalg.norm(direction))
    unit = direction / length
    along = (points - origin) @ unit
    off = np.linalg.norm(points - origin - along[:, None] * unit, axis=1)
    hit = (off < reach) & (along > 0)
    return float(along[hit].min()) / length if hit.any() else np.inf
