"""Points of one part that pass through the surface of another while a joint moves.

A point's path is cut into chords; each chord is a ray against the other part's triangles. That
works for single sheets of a scan as for closed boards. A crossing counts unless

- it grazes the surface (below :data:`GRAZING`): sliding along a rail is no collision, and the
  normals of a noisy scan are not better than that;
- a step aside by the tolerance avoids the target: parts that touch along a face or an edge;
- the point leaves a solid, where the triangles say so;
- the bulk of its part lies ahead of the surface already: it was on the far side at rest.

How deep: the way beyond the crossed element, along its normal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.kinematics.surface import Surface

GRAZING = 0.34
"""Sine of the angle below which a path slides along a surface: 20°."""
ROUNDS = 6
"""Surfaces that a chord may pass without a crossing that counts."""
SIDESTEPS = 6
OUTLIERS = 0.001
"""Share of a part's samples that may be wrong."""
BULK = 0.08
"""Reach of a part's bulk about a point, in the part's diagonal."""

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Path:
    """Motion of one part seen from another's rest frame, from rest onwards.

    Attributes:
        q: (K,) joint values, monotone, q[0] is rest.
        target_from_part: (K, 4, 4).
        straight: whether it is one translation, so that a single chord serves.
    """

    q: FloatArray
    target_from_part: FloatArray
    straight: bool

    def move(self, points: FloatArray) -> FloatArray:
        """(K, P, 3) of (P, 3) points."""
        return moved(self.target_from_part, points)


@dataclass(frozen=True, eq=False)
class Crossings:
    """First crossing of each point that has one.

    Attributes:
        q: (E,) joint value.
        points: (E, 3) the crossing points at rest, their part's coordinates.
        anchor, normal: (E, 3) of the crossed element in the target's coordinates; the normal
            points the way the point went.
        outliers: how many of them may be chance: stray points, bled labels.
    """

    q: FloatArray
    points: FloatArray
    anchor: FloatArray
    normal: FloatArray
    outliers: int

    def depth(self, target_from_part: FloatArray) -> FloatArray:
        """(K, E) metres beyond the crossed elements at (K, 4, 4) poses; negative is before."""
        now = moved(target_from_part, self.points)
        return np.einsum("kei,ei->ke", now - self.anchor, self.normal)


@dataclass(frozen=True, eq=False)
class _Chords:
    """Pieces of paths: (R, 3) rays with direction as long as the chord."""

    origin: FloatArray
    direction: FloatArray
    point: npt.NDArray[np.int64]
    step: npt.NDArray[np.int64]

    def take(self, index: npt.NDArray) -> _Chords:
        return _Chords(
            self.origin[index], self.direction[index], self.point[index], self.step[index]
        )


def moved(target_from_part: FloatArray, points: FloatArray) -> FloatArray:
    """(K, P, 3) of (K, 4, 4) and (P, 3)."""
    turned = np.einsum("kij,pj->kpi", target_from_part[:, :3, :3], points)
    return turned + target_from_part[:, None, :3, 3]


def inverse(poses: FloatArray) -> FloatArray:
    """Inverse of (K, 4, 4) rigid motions."""
    out = np.zeros_like(poses)
    out[:, :3, :3] = np.swapaxes(poses[:, :3, :3], 1, 2)
    out[:, :3, 3] = -np.einsum("kij,kj->ki", out[:, :3, :3], poses[:, :3, 3])
    out[:, 3, 3] = 1.0
    return out


def crossings(part: Surface, target: Surface, path: Path, tolerance: float) -> Crossings:
    """Where samples of ``part`` pass through ``target``.

    Args:
        tolerance: metres; surfaces this close behind a point at rest count as touching it.
    """
    if path.straight and len(path.q) > 2:
        path = Path(path.q[[0, -1]], path.target_from_part[[0, -1]], True)
    chosen, at = _near(part, target, path, tolerance)
    rest, chords = _chords(at, target, tolerance)
    best = np.full(len(chosen), np.inf)
    element = np.zeros(len(chosen), np.int64)
    anchor, normal = np.zeros((len(chosen), 3)), np.zeros((len(chosen), 3))
    coarse = path.move(part.coarse)
    travelled = _travelled(at)
    for _ in range(ROUNDS):
        if not len(chords.point):
            break
        hits = target.cast(chords.origin, chords.direction)
        # Where along its step each chord was met, in 0..1; the first ones begin before rest.
        met = hits.distance <= 1.0
        chords, t, n = chords.take(met), hits.distance[met], hits.normals[met]
        disc = hits.element[met]
        hit = chords.origin + t[:, None] * chords.direction
        along = _along(hit, at, chords)
        fraction = chords.step + along
        way = travelled[chords.step, chords.point] * (1 - along)
        way += travelled[chords.step + 1, chords.point] * along
        at_rest = way <= tolerance
        counts = _counts(part, target, chords, hit, n, at_rest, at, coarse, tolerance)
        order = np.flatnonzero(counts & (fraction < best[chords.point]))
        order = order[np.argsort(-fraction[order], kind="stable")]
        points = chords.point[order]  # the earliest of a point is written last
        best[points], element[points] = fraction[order], disc[order]
        sign = np.sign(np.einsum("ri,ri->r", n, chords.direction))[:, None]
        normal[points] = (n * sign)[order]
        anchor[points] = np.where((along[order] <= 0)[:, None], rest[points], hit[order])
        again = np.flatnonzero(~counts & (fraction < best[chords.point]))
        chords = _continued(chords.take(again), t[again], tolerance)
    found = np.flatnonzero(np.isfinite(best))
    if not target.oriented:
        # One bad disc of a noisy cloud stops many points; it counts once.
        order = found[np.argsort(best[found], kind="stable")]
        found = order[np.unique(element[order], return_index=True)[1]]
    q = np.interp(np.maximum(best[found], 0), np.arange(len(path.q)), path.q)
    outliers = math.floor(OUTLIERS * len(part.points))
    return Crossings(q, part.points[chosen[found]], anchor[found], normal[found], outliers)


def _near(
    part: Surface, target: Surface, path: Path, tolerance: float
) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Samples whose paths come near the target's box, and (K, P, 3) those paths."""
    low, high = target.bounds[0] - 2 * tolerance, target.bounds[1] + 2 * tolerance
    box = np.array(np.meshgrid(*part.bounds.T)).reshape(3, -1).T
    swept = path.move(box).reshape(-1, 3)
    slack = 0.02 * part.diagonal  # arcs bulge out of their chords' box
    if (swept.min(0) - slack > high).any() or (swept.max(0) + slack < low).any():
        return np.zeros(0, np.int64), np.zeros((len(path.q), 0, 3))
    at = path.move(part.points)
    inside = ((at.max(0) >= low) & (at.min(0) <= high)).all(axis=1)
    chosen = np.flatnonzero(inside)
    return chosen, at[:, chosen]


def _travelled(at: FloatArray) -> FloatArray:
    """(K, P) length of the path up to each step."""
    step = np.linalg.norm(np.diff(at, axis=0), axis=2)
    return np.concatenate([np.zeros((1, at.shape[1])), np.cumsum(step, axis=0)])


def _chords(at: FloatArray, target: Surface, tolerance: float) -> tuple[FloatArray, _Chords]:
    """(P, 3) rest positions, and the chords that come near the target's box."""
    low, high = target.bounds[0] - 2 * tolerance, target.bounds[1] + 2 * tolerance
    start, end = at[:-1], at[1:]
    near = (np.maximum(start, end) >= low) & (np.minimum(start, end) <= high)
    step, point = np.nonzero(near.all(axis=2) & (np.abs(end - start).max(axis=2) > 1e-9))
    origin, direction = start[step, point], end[step, point] - start[step, point]
    first = step == 0
    length = np.linalg.norm(direction[first], axis=1, keepdims=True)
    before = direction[first] / length * tolerance
    origin[first] -= before
    direction[first] += before
    return at[0], _Chords(origin, direction, point, step)


def _along(hit: FloatArray, at: FloatArray, chords: _Chords) -> FloatArray:
    """(R,) place of the hits on their step: 0 its start, 1 its end, negative before rest."""
    start, end = at[chords.step, chords.point], at[chords.step + 1, chords.point]
    whole = end - start
    return np.einsum("ri,ri->r", hit - start, whole) / np.einsum("ri,ri->r", whole, whole)


def _continued(chords: _Chords, t: FloatArray, tolerance: float) -> _Chords:
    """The rest of chords behind a hit that didn't count."""
    length = np.linalg.norm(chords.direction, axis=1)
    t = t + 1e-3 * tolerance / np.maximum(length, 1e-12)
    left = 1.0 - t
    kept = left > 0
    return _Chords(
        (chords.origin + t[:, None] * chords.direction)[kept],
        (left[:, None] * chords.direction)[kept],
        chords.point[kept],
        chords.step[kept],
    )


def _counts(
    part: Surface,
    target: Surface,
    chords: _Chords,
    hit: FloatArray,
    normals: FloatArray,
    at_rest: npt.NDArray[np.bool_],
    at: FloatArray,
    coarse: FloatArray,
    tolerance: float,
) -> npt.NDArray[np.bool_]:
    """(R,) whether the hits are crossings that count."""
    length = np.linalg.norm(chords.direction, axis=1)
    sine = np.einsum("ri,ri->r", normals, chords.direction) / length
    out = np.abs(sine) > GRAZING
    steep = np.flatnonzero(out)
    solid = target.bounds_solid(hit[steep])
    out[steep[solid & (sine[steep] > 0)]] = False
    sheet = steep[~solid]
    toward = normals[sheet] * np.sign(sine[sheet])[:, None]
    for step in np.unique(chords.step[sheet]):
        mine = np.flatnonzero(chords.step[sheet] == step)
        here = at[step, chords.point[sheet[mine]]]
        ahead, behind = _bulk(part, coarse[step], here, toward[mine], 0.5 * tolerance)
        fresh = (ahead < 0.05) & (behind > 0.2)
        out[sheet[mine]] = np.where(at_rest[sheet[mine]], fresh, ahead < 0.5)
    left = np.flatnonzero(out)
    ways = chords.direction[left] / length[left, None]
    out[left] = _broad(target, hit[left], ways, tolerance)
    return out


def _bulk(
    part: Surface, posed: FloatArray, here: FloatArray, toward: FloatArray, margin: float
) -> tuple[FloatArray, FloatArray]:
    """(R,) shares of the part's samples (C, 3) about each of (R, 3) places that lie beyond it
    along (R, 3) directions, and before it, by more than ``margin``."""
    squared = (here**2).sum(1)[:, None] - 2 * here @ posed.T + (posed**2).sum(1)
    weight = np.exp(-squared / (2 * (BULK * part.diagonal) ** 2))
    weight /= np.maximum(weight.sum(1, keepdims=True), 1e-12)
    beyond = toward @ posed.T - np.einsum("ri,ri->r", here, toward)[:, None]
    return (weight * (beyond > margin)).sum(1), (weight * (beyond < -margin)).sum(1)


def _broad(
    target: Surface, hit: FloatArray, ways: FloatArray, tolerance: float
) -> npt.NDArray[np.bool_]:
    """(R,) whether the target is still hit when the path is moved sideways by the tolerance.

    Where it isn't, a step aside avoids the target: parts that touch along an edge or a face.
    """
    helper = np.eye(3)[np.argmin(np.abs(ways), axis=1)]
    u = np.cross(ways, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(ways, u)
    reach = 3.0 * tolerance  # a surface as flat as GRAZING allows is met that much later
    out = np.ones(len(hit), bool)
    for angle in np.arange(SIDESTEPS) * (2 * np.pi / SIDESTEPS):
        left = np.flatnonzero(out)
        if not len(left):
            break
        aside = tolerance * (np.cos(angle) * u[left] + np.sin(angle) * v[left])
        start = hit[left] + aside - reach * ways[left]
        out[left] = target.cast(start, ways[left]).distance <= 2 * reach
    return out
