"""Depth of overlap of convex bodies by the separating axis theorem (Gottschalk, 1996)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.core.shapes import Hull

MOST_EDGES = 24
"""Most edge directions of a body: products of more cost time and change nothing."""

BATCH = 32
"""Poses per batch: the arrays fit the processor's cache."""

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Overlap:
    """Two bodies that overlap.

    Attributes:
        depth: metres that the second must move along ``axis`` to be free; minus the gap if apart.
        axis: (3,) unit.
        begin, end: of the overlap along the axis: start of the second body, end of the first.
    """

    depth: float
    axis: FloatArray
    begin: float
    end: float


def overlap(a: Hull, b: Hull, least: float = 0.0) -> Overlap | None:
    """Return the overlap of two bodies; None where it is ``least`` metres or less.

    A negative ``least`` also finds bodies with a smaller gap between them.
    """
    apart = np.maximum(a.bounds[0] - b.bounds[1], b.bounds[0] - a.bounds[1])
    if (apart >= -least).any():
        return None
    found = _along(a, b, np.concatenate([a.normals, b.normals]), least)
    if found is None or found.depth <= 0:
        return found
    one, other = _few(a.edges), _few(b.edges)
    cross = np.cross(one[:, None], other[None]).reshape(-1, 3)
    length = np.linalg.norm(cross, axis=1)
    cross = cross[length > 1e-3] / length[length > 1e-3, None]
    if not len(cross):
        return found
    edges = _along(a, b, cross, least)
    if edges is None:
        return None
    return edges if edges.depth < 0.95 * found.depth else found


def _few(edges: FloatArray, axis: int = 0) -> FloatArray:
    step = -(-edges.shape[axis] // MOST_EDGES)
    return edges[::step] if axis == 0 else edges[:, ::step]


def _along(a: Hull, b: Hull, axes: FloatArray, least: float) -> Overlap | None:
    """The smallest overlap along (N, 3) unit axes; None where that is ``least`` or less."""
    one, other = a.vertices @ axes.T, b.vertices @ axes.T
    forward = one.max(axis=0) - other.min(axis=0)
    backward = other.max(axis=0) - one.min(axis=0)
    depth = np.minimum(forward, backward)
    i = int(depth.argmin())
    if depth[i] <= least:
        return None
    if forward[i] <= backward[i]:
        return Overlap(float(depth[i]), axes[i], float(other[:, i].min()), float(one[:, i].max()))
    return Overlap(float(depth[i]), -axes[i], float(-other[:, i].max()), float(-one[:, i].min()))


def depths(a: Hull, b: Hull, a_from_b: FloatArray, least: float = 0.0) -> FloatArray:
    """(S,) depths of :func:`overlap` of ``a`` and ``b`` under (S, 4, 4) motions; -inf for None."""
    parts = range(0, len(a_from_b), BATCH)
    return np.concatenate([_depths(a, b, a_from_b[k : k + BATCH], least) for k in parts])


def _depths(a: Hull, b: Hull, a_from_b: FloatArray, least: float) -> FloatArray:
    turned = a_from_b[:, :3, :3].swapaxes(1, 2)
    corners = b.vertices @ turned + a_from_b[:, None, :3, 3]
    out = np.full(len(a_from_b), -np.inf)
    low, high = corners.min(axis=1), corners.max(axis=1)
    on = np.flatnonzero((np.maximum(a.bounds[0] - high, low - a.bounds[1]) < -least).all(axis=1))
    if not len(on):
        return out
    own = np.broadcast_to(a.normals, (len(on), *a.normals.shape))
    faces = np.concatenate([own, b.normals @ turned[on]], axis=1)
    out[on] = _least_along(a.vertices, corners[on], faces)
    out[out <= least] = -np.inf
    on = np.flatnonzero(out > 0)
    if not len(on):
        return out
    one, other = _few(a.edges), _few(b.edges @ turned[on], axis=1)
    cross = np.cross(one[None, :, None], other[:, None]).reshape(len(on), -1, 3)
    length = np.linalg.norm(cross, axis=2)
    real = length > 1e-3
    cross /= np.where(real, length, 1.0)[..., None]
    edges = _least_along(a.vertices, corners[on], cross, real)
    closer = edges < 0.95 * out[on]
    out[on[closer]] = edges[closer]
    out[on[edges <= least]] = -np.inf
    return out


def _least_along(
    one: FloatArray, others: FloatArray, axes: FloatArray, real: npt.NDArray[np.bool_] | None = None
) -> FloatArray:
    """(S,) smallest overlap of (V, 3) and (S, W, 3) vertices along (S, N, 3) unit axes.

    Only axes that are ``real`` count; infinity where none is.
    """
    across = axes.swapaxes(1, 2)
    mine, its = one @ across, others @ across
    depth = np.minimum(mine.max(axis=1) - its.min(axis=1), its.max(axis=1) - mine.min(axis=1))
    if real is not None:
        depth[~real] = np.inf
    return np.asarray(depth.min(axis=1))
