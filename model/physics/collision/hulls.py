"""Convex hulls grown to a minimal thickness or cut by a plane."""

from __future__ import annotations

import numpy as np

from model.core.shapes import FloatArray, Hull, hull_of

DUST = 1e-6
"""Extent, as a share of the thickness, up to which points count as a single one."""


def thick_hull(points: FloatArray, thickness: float) -> Hull:
    """Return the hull of (N, 3) points, grown to ``thickness`` metres where it is thinner."""
    # Far smaller points have no reliable directions to grow in.
    if float(np.ptp(points, axis=0).max()) < DUST * thickness:
        return _box_around(points, thickness)
    found = hull_of(points)
    if found is not None and found.thickness >= 0.99 * thickness:
        return found
    middle = points.mean(axis=0)
    axes = np.linalg.svd(points - middle, full_matrices=True)[2] if len(points) > 1 else np.eye(3)
    if found is not None:  # the thinnest direction is a face normal, not a principal axis
        reach = found.vertices @ found.planes[:, :3].T
        axes = found.planes[np.ptp(reach, axis=0).argmin(), None, :3]
    grown = points
    for axis in axes:
        half = (thickness - float(np.ptp(grown @ axis))) / 2
        if half > 0:
            grown = np.concatenate([grown - half * axis, grown + half * axis])
    return hull_of(grown) or found or _box_around(grown, thickness)


def _box_around(points: FloatArray, thickness: float) -> Hull:
    low, high = points.min(axis=0) - thickness / 2, points.max(axis=0) + thickness / 2
    box = hull_of(np.array([[x, y, z] for x, y, z in np.ndindex(2, 2, 2)]) * (high - low) + low)
    assert box is not None
    return box


def clipped(hull: Hull, normal: FloatArray, offset: float) -> Hull | None:
    """Return the half where ``normal·x <= offset``; None where it has no volume."""
    height = hull.vertices @ normal - offset
    if (height <= 0).all():
        return hull
    kept = height < 0
    if not kept.any():
        return None
    pairs = np.stack([hull.faces.reshape(-1), np.roll(hull.faces, -1, axis=1).reshape(-1)], 1)
    edges = pairs[kept[pairs[:, 0]] & ~kept[pairs[:, 1]]]
    a, b = hull.vertices[edges[:, 0]], hull.vertices[edges[:, 1]]
    ha, hb = height[edges[:, 0], None], height[edges[:, 1], None]
    cut = a + (b - a) * (ha / (ha - hb))
    return hull_of(np.concatenate([hull.vertices[kept], cut]))
