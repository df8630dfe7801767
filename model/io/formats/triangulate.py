"""Polygons to triangles without losing area."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

_MOST_TESTS = 150_000  # of ears in one file, some seconds; beyond, polygons stay fans


def triangulate(
    corners: Array, sizes: Array, points: Array
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Triangles of many polygons.

    Args:
        corners: (C,) position of each corner in ``points``, polygon after polygon.
        sizes: (P,) corners of each polygon; those under 3 give nothing.
        points: (V, 3).

    Returns:
        ``(T, 3)`` indices into ``corners`` (not into points) and ``(T,)`` polygon of each
        triangle, in the polygons' order. Convex polygons become fans, others are ear-clipped.
    """
    sizes = np.asarray(sizes, np.int64)
    starts = np.cumsum(sizes) - sizes
    if len(sizes) and (sizes == 3).all():
        polygon = np.arange(len(sizes))
        return np.arange(3 * len(sizes)).reshape(-1, 3), polygon
    fans = np.clip(sizes - 2, 0, None)
    polygon = np.repeat(np.arange(len(sizes)), fans)
    step = np.arange(len(polygon)) - np.repeat(np.cumsum(fans) - fans, fans)
    first = starts[polygon]
    out = np.stack([first, first + step + 1, first + step + 2], axis=1)
    bad = _concave(out, polygon, sizes, corners, points)
    # The other diagonal of a concave quadrilateral is inside it.
    four = bad[sizes[bad] == 4]
    at, corner = np.searchsorted(polygon, four), starts[four]
    out[at] = np.stack([corner + 1, corner + 2, corner + 3], axis=1)
    out[at + 1] = np.stack([corner + 1, corner + 3, corner], axis=1)
    budget = _MOST_TESTS
    for p in bad[sizes[bad] > 4]:
        loop = starts[p] + np.arange(int(sizes[p]))
        ears, budget = _ear_clip(points[corners[loop]], budget)
        if ears is not None:
            at = int(np.searchsorted(polygon, p))
            out[at : at + len(ears)] = loop[ears]
    return out, polygon


def _concave(out: Array, polygon: Array, sizes: Array, corners: Array, points: Array) -> Array:
    """Polygons whose fan has a triangle that is turned the wrong way."""
    many = np.flatnonzero(sizes[polygon] > 3)
    if not len(many):
        return many
    t = points[corners[out[many]]].astype(np.float64)
    cross = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    total = np.zeros((len(sizes), 3))
    np.add.at(total, polygon[many], cross)
    against = np.einsum("ij,ij->i", cross, total[polygon[many]]) < 0
    return np.unique(polygon[many[against]])


def _ear_clip(loop: Array, budget: int) -> tuple[Array | None, int]:
    """(n-2, 3) triangles of one planar polygon (n, 3), or None where no ear is found.

    Stops after ``budget`` tests, and returns how many are left, so that no file takes for ever.
    """
    p = loop.astype(np.float64) - loop.mean(axis=0)
    normal = np.cross(p, np.roll(p, -1, axis=0)).sum(axis=0)
    drop = int(np.argmax(np.abs(normal)))
    flat = np.delete(p, drop, axis=1)
    sign = np.sign(normal[drop]) * (-1.0 if drop == 1 else 1.0)
    left = list(range(len(flat)))
    out = []
    while len(left) > 3:
        for i in range(len(left)):
            if budget <= 0:
                return None, 0
            budget -= 1
            a, b, c = left[i - 1], left[i], left[(i + 1) % len(left)]
            if _turn(flat[a], flat[b], flat[c]) * sign <= 0:
                continue
            others = flat[[k for k in left if k not in (a, b, c)]]
            if _inside(flat[[a, b, c]], others, sign).any():
                continue
            out.append((a, b, c))
            left.pop(i)
            break
        else:
            return None, budget
    return np.array([*out, tuple(left)]), budget


def _turn(a: Array, b: Array, c: Array) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _inside(triangle: Array, points: Array, sign: float) -> Array:
    out = np.ones(len(points), bool)
    for i in range(3):
        a, b = triangle[i], triangle[(i + 1) % 3]
        out &= (
            sign * ((b[0] - a[0]) * (points[:, 1] - a[1]) - (b[1] - a[1]) * (points[:, 0] - a[0]))
            > 0
        )
    return out
