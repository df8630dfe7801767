"""Polygons to triangles without losing area."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mapbox_earcut
import numpy as np
import numpy.typing as npt

from model.core.errors import InputFileError

Array = npt.NDArray[Any]

MOST_CORNERS = 10_000
"""Most corners of a concave face: half a second if well-formed, more if it crosses itself."""
MOST_SQUARES = 1e9
"""Sum over the concave faces of a file of their corners squared: some seconds."""


def triangulate(
    path: Path, corners: Array, sizes: Array, points: Array
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Triangles of many polygons.

    Args:
        path: the file, for messages.
        corners: (C,) position of each corner in ``points``, polygon after polygon.
        sizes: (P,) corners of each polygon; those under 3 give nothing.
        points: (V, 3).

    Returns:
        ``(T, 3)`` indices into ``corners`` (not into points) and ``(T,)`` polygon of each
        triangle, in the polygons' order. Convex polygons become fans, others are ear-clipped.

    Raises:
        InputFileError: for concave faces with absurdly many corners.
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
    clipped = bad[sizes[bad] > 4]
    _check_budget(path, sizes[clipped])
    kept = np.ones(len(out), bool)
    for p in clipped:
        loop = starts[p] + np.arange(int(sizes[p]))
        ears = _ear_cut(points[corners[loop]])
        if ears is not None:
            at = int(np.searchsorted(polygon, p))
            out[at : at + len(ears)] = loop[ears]
            kept[at + len(ears) : at + int(sizes[p]) - 2] = False
    return (out, polygon) if kept.all() else (out[kept], polygon[kept])


def _check_budget(path: Path, sizes: Array) -> None:
    """Refuse concave faces that may take minutes: no object has such."""
    largest = int(sizes.max(initial=0))
    if largest > MOST_CORNERS or float((sizes.astype(np.float64) ** 2).sum()) > MOST_SQUARES:
        raise InputFileError(
            path,
            f"{len(sizes):,} concave face{'s'[: len(sizes) != 1]} with up to {largest:,} "
            "corners can take minutes to triangulate",
            "triangulate them in a modelling program",
        )


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


def _ear_cut(loop: Array) -> Array | None:
    """(T, 3) triangles of one planar polygon (n, 3), turned like it; None where it crosses itself.

    Corners on a straight line may be left out, so that T ≤ n - 2.
    """
    p = loop.astype(np.float64) - loop.mean(axis=0)
    normal = np.cross(p, np.roll(p, -1, axis=0)).sum(axis=0)
    flat = np.ascontiguousarray(np.delete(p, int(np.argmax(np.abs(normal))), axis=1))
    ends = np.array([len(flat)], np.uint32)
    ears = mapbox_earcut.triangulate_float64(flat, ends).reshape(-1, 3).astype(np.int64)
    t = p[ears]
    areas = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]) @ normal
    whole = float(normal @ normal)
    if not abs(np.abs(areas).sum() - whole) <= 1e-3 * whole:
        return None
    ears[areas < 0] = ears[areas < 0][:, ::-1]
    return ears
