"""Narrow phase: which bodies of two links overlap, in one pose or along a path, and how deep.

The depth is found by the separating axis theorem (Gottschalk, 1996).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.core.memory import LruCache, array_digest
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


Bodies = dict[str, list[Hull]]


@dataclass(frozen=True, eq=False)
class BodyOverlap:
    """Two bodies of two links that overlap in a pose.

    Attributes:
        a, b: links; i, j: which of their bodies.
        depth: metres; minus the gap between them.
        a_from_b: (4, 4) motion from b's rest frame to a's.
    """

    a: str
    b: str
    i: int
    j: int
    depth: float
    a_from_b: FloatArray


def overlaps(
    bodies: Bodies,
    pairs: list[tuple[str, str]],
    poses: Mapping[str, FloatArray],
    least: float = 0.0,
) -> list[BodyOverlap]:
    """Find bodies of ``pairs`` of links that overlap by more than ``least`` metres in a pose.

    Args:
        poses: link → (4, 4) ``posed_from_rest``; missing links are at rest.
        least: negative to find bodies with a smaller gap, too.
    """
    links = {link for pair in pairs for link in pair}
    rest = np.eye(4)
    boxes = {
        k: _boxes(hulls, poses.get(k, rest)[None])[0]
        for k, hulls in bodies.items()
        if hulls and k in links
    }
    out: list[BodyOverlap] = []
    for a, b in pairs:
        if a not in boxes or b not in boxes:
            continue
        near = _near(boxes[a][None], boxes[b][None], least)[0]
        if not near.any():
            continue
        a_from_b = np.linalg.inv(poses.get(a, rest)) @ poses.get(b, rest)
        posed: dict[int, Hull] = {}
        for i, j in np.argwhere(near).tolist():
            if j not in posed:
                posed[j] = bodies[b][j].moved(a_from_b)
            found = overlap(bodies[a][i], posed[j], least)
            if found is not None:
                out.append(BodyOverlap(a, b, i, j, found.depth, a_from_b))
    return out


class PosePath:
    """A sequence of poses, in which overlaps are searched while bodies are being cut.

    Depths are cached per pair of bodies: few of them are cut each time.

    Args:
        poses: link → (S, 4, 4) ``posed_from_rest``; missing links are at rest.
        count: S.
    """

    def __init__(self, poses: Mapping[str, FloatArray], count: int) -> None:
        self._poses, self._count = poses, count
        # The bodies are kept, so that no new one gets the id of an old one.
        self._known: dict[tuple[int, int, float], tuple[Hull, Hull, FloatArray]] = {}

    def overlaps(
        self, bodies: Bodies, pairs: list[tuple[str, str]], least: float
    ) -> list[list[BodyOverlap]]:
        """:func:`overlaps` in each pose."""
        out: list[list[BodyOverlap]] = [[] for _ in range(self._count)]
        links = {link for pair in pairs for link in pair}
        boxes = {
            k: _boxes(hulls, self._of(k)) for k, hulls in bodies.items() if hulls and k in links
        }
        for a, b in pairs:
            if a not in boxes or b not in boxes:
                continue
            near = _near(boxes[a], boxes[b], least)
            if not near.any():
                continue
            a_from_b = np.broadcast_to(
                np.linalg.inv(self._of(a)) @ self._of(b), (self._count, 4, 4)
            )
            for i, j in np.argwhere(near.any(axis=0)).tolist():
                at = np.flatnonzero(np.broadcast_to(near, (self._count, *near.shape[1:]))[:, i, j])
                found = self._depths(bodies[a][i], bodies[b][j], a_from_b, at, least)
                for k in at[found[at] > least].tolist():
                    out[k].append(BodyOverlap(a, b, i, j, float(found[k]), a_from_b[k]))
        return out

    def _of(self, link: str) -> FloatArray:
        """(S, 4, 4), or (1, 4, 4) at rest."""
        return self._poses.get(link, np.eye(4)[None])

    def _depths(
        self, a: Hull, b: Hull, a_from_b: FloatArray, at: npt.NDArray[np.int64], least: float
    ) -> FloatArray:
        """(S,) depths, computed at the poses ``at``."""
        key = (id(a), id(b), least)
        if key not in self._known:
            found = np.full(self._count, -np.inf)
            found[at] = _depths_of(a, b, a_from_b[at], least)
            self._known[key] = a, b, found
        return self._known[key][2]


recent_depths: LruCache[bytes, FloatArray] = LruCache(4096, 1e6)
"""Depths of pairs of bodies along paths: an edit of one joint changes few of them."""


def _depths_of(a: Hull, b: Hull, a_from_b: FloatArray, least: float) -> FloatArray:
    """:func:`depths`, cached."""
    key = array_digest(*a.measured, *b.measured, a_from_b, np.array([least]))
    return recent_depths.get(key, lambda: depths(a, b, a_from_b, least), len(a_from_b))


def _near(a: FloatArray, b: FloatArray, least: float) -> npt.NDArray[np.bool_]:
    """(S, N, M) whether (S, N, 2, 3) and (S, M, 2, 3) boxes overlap by more than ``least``."""
    a, b = a[:, :, None], b[:, None]
    apart = (a[..., 0, :] - b[..., 1, :] >= -least).any(axis=-1)
    apart |= (b[..., 0, :] - a[..., 1, :] >= -least).any(axis=-1)
    return np.logical_not(apart)


def _boxes(hulls: list[Hull], poses: FloatArray) -> FloatArray:
    """(S, N, 2, 3) boxes of bodies in (S, 4, 4) poses."""
    corners = np.concatenate([h.vertices for h in hulls])
    at = corners @ poses[:, :3, :3].swapaxes(1, 2) + poses[:, None, :3, 3]
    start = np.cumsum([0, *(len(h.vertices) for h in hulls[:-1])])
    low, high = (f.reduceat(at, start, axis=1) for f in (np.minimum, np.maximum))
    return np.stack([low, high], axis=2)
