"""How deep convex bodies overlap: the separating axis theorem (Gottschalk, 1996)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.collision.hulls import Hull

MOST_EDGES = 24
"""Edge directions a body: products of more say nothing new but cost time."""

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Overlap:
    """Two bodies that overlap.

    Attributes:
        depth: metres that one must move along ``axis`` to be free; minus the gap between them.
        axis: (3,) unit, the way that the second body must go.
        begin, end: where along the axis both are: the second begins, the first ends.
    """

    depth: float
    axis: FloatArray
    begin: float
    end: float


def overlap(a: Hull, b: Hull, least: float = 0.0) -> Overlap | None:
    """How two bodies overlap; None where it is ``least`` metres or less.

    A negative ``least`` also finds bodies that a smaller gap parts; their depth is negative.
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


def _few(edges: FloatArray) -> FloatArray:
    return edges[:: -(-len(edges) // MOST_EDGES)]


def _along(a: Hull, b: Hull, axes: FloatArray, least: float) -> Overlap | None:
    """The least overlap along (N, 3) unit axes; None where that is ``least`` or less."""
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
