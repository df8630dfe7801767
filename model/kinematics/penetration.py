"""Points of one part that pass through the surface of another while a joint moves.

A point's path is cut into chords; each chord is a ray against the other part's triangles. That
works for single sheets of a scan as for closed boards. A crossing counts unless

- it grazes the surface (below :data:`GRAZING`): sliding along a rail is no collision, and the
  normals of a noisy scan are not better than that;
- a small step aside avoids the target: parts that touch along a face or an edge;
- the point leaves a solid, where the triangles say so;
- the bulk of its part lies ahead of the surface already: it was on the far side at rest;
- it touches at rest, and its own part's material lies ahead of it: it withdraws.

How deep: the way beyond the crossed element, along its normal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.core.lru_cache import array_digest
from model.kinematics.surface import Surface

GRAZING = 0.34
"""Sine of the angle below which a path slides along a surface: 20°."""
ROUNDS = 6
"""Surfaces that a chord may pass without a crossing that counts."""
SIDESTEPS = 6
SIDESTEP = 0.3
"""In tolerances, for meshes; a whole one for clouds."""
THICK = 10.0
"""Thickness of boards that points of their back don't look through, in tolerances."""
OUTLIERS = 0.004
"""Share of a part's samples that may be wrong."""
ASIDE = (0.5, 1.0, 2.0, 4.0)
"""Steps aside that are tried, in tolerances."""
ASIDE_POINTS = 64
ASIDE_SHARE = 0.9
"""Share of the crossings that a step aside must avoid."""
BULK = 0.08
"""Reach of a part's bulk about a point, in the part's diagonal."""

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RelativePath:
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
class Penetrations:
    """First crossing of each point that has one.

    Attributes:
        q: (E,) joint value.
        points: (E, 3) the crossing points at rest, their part's coordinates.
        anchor, normal: (E, 3) of the crossed element in the target's coordinates; the normal
            points the way the point went.
        outliers: how many of them may be chance: stray points, bled labels.
        aside: metres to step aside so that none of them happens, see :func:`_aside`; infinite
            where that is much, or can't be told.
    """

    q: FloatArray
    points: FloatArray
    anchor: FloatArray
    normal: FloatArray
    outliers: int
    aside: float

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
    turned = points @ np.swapaxes(target_from_part[:, :3, :3], 1, 2)
    return turned + target_from_part[:, None, :3, 3]


def inverse(poses: FloatArray) -> FloatArray:
    """Inverse of (K, 4, 4) rigid motions."""
    out = np.zeros_like(poses)
    out[:, :3, :3] = np.swapaxes(poses[:, :3, :3], 1, 2)
    out[:, :3, 3] = -np.einsum("kij,kj->ki", out[:, :3, :3], poses[:, :3, 3])
    out[:, 3, 3] = 1.0
    return out


def crossings(part: Surface, target: Surface, path: RelativePath, tolerance: float) -> Penetrations:
    """Where samples of ``part`` pass through ``target``.

    What was found lately is kept: where one joint is edited, most parts go the ways they went.

    Args:
        tolerance: metres; surfaces this close behind a point at rest count as touching it.
    """
    if path.straight and len(path.q) > 2:
        path = RelativePath(path.q[[0, -1]], path.target_from_part[[0, -1]], True)
    way = array_digest(
        path.q, path.target_from_part, np.array([tolerance, path.straight], np.float64)
    )

    def find() -> tuple[Penetrations, Surface]:
        return _crossings(part, target, path, tolerance), target  # whose id is no other's then

    return part.met.get((id(target), way), find, weigh=lambda held: float(len(held[0].q)))[0]


def _crossings(
    part: Surface, target: Surface, path: RelativePath, tolerance: float
) -> Penetrations:
    chosen, at = _near(part, target, path, tolerance)
    judge = _Judge(part, target, path, chosen, at, tolerance)
    chords = _chords(at, target, tolerance)
    best = np.full(len(chosen), np.inf)
    element = np.zeros(len(chosen), np.int64)
    anchor, normal = np.zeros((len(chosen), 3)), np.zeros((len(chosen), 3))
    for _ in range(ROUNDS):
        if not len(chords.point):
            break
        hits = target.cast(chords.origin, chords.direction)
        met = np.flatnonzero(hits.distance <= 1.0)
        chords, t, n = chords.take(met), hits.distance[met], hits.normals[met]
        hit = chords.origin + t[:, None] * chords.direction
        # Where on its step a chord is met, in 0..1; negative on the stretch before rest.
        along = _along(hit, at, chords)
        fraction = chords.step + along
        counts = judge.counts(chords, hit, n, along)
        order = np.flatnonzero(counts & (fraction < best[chords.point]))
        order = order[np.argsort(-fraction[order], kind="stable")]
        points = chords.point[order]  # the earliest of a point is written last
        best[points], element[points] = fraction[order], hits.element[met][order]
        sign = np.sign(np.einsum("ri,ri->r", n, chords.direction))[:, None]
        normal[points] = (n * sign)[order]
        anchor[points] = np.where((fraction[order] <= 0)[:, None], at[0][points], hit[order])
        again = np.flatnonzero(~counts & (fraction < best[chords.point]))
        chords = _continued(chords.take(again), t[again], tolerance)
    found = np.flatnonzero(np.isfinite(best))
    if not target.oriented:
        # One bad disc of a noisy cloud stops many points; it counts once.
        order = found[np.argsort(best[found], kind="stable")]
        found = order[np.unique(element[order], return_index=True)[1]]
    q = np.interp(np.maximum(best[found], 0), np.arange(len(path.q)), path.q)
    share = OUTLIERS if target.oriented else OUTLIERS / 2
    outliers = math.floor(share * len(part.points))
    aside = math.inf
    if part.oriented and target.oriented and len(found) > outliers:
        step = np.clip(best[found].astype(np.int64), 0, len(path.q) - 2)
        aside = _aside(target, anchor[found], at[step + 1, found] - at[step, found], tolerance)
    return Penetrations(
        q, part.points[chosen[found]], anchor[found], normal[found], outliers, aside
    )


def _near(
    part: Surface, target: Surface, path: RelativePath, tolerance: float
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


def _chords(at: FloatArray, target: Surface, tolerance: float) -> _Chords:
    """The chords that come near the target's box; the first ones begin a bit before rest."""
    low, high = target.bounds[0] - 2 * tolerance, target.bounds[1] + 2 * tolerance
    start, end = at[:-1], at[1:]
    under, over = at < low, at > high
    far = (under[:-1] & under[1:]) | (over[:-1] & over[1:])
    step, point = np.nonzero(~far.any(axis=2))
    origin, direction = start[step, point], end[step, point] - start[step, point]
    moves = np.abs(direction).max(axis=1, initial=0.0) > 1e-9
    step, point, origin, direction = step[moves], point[moves], origin[moves], direction[moves]
    first = step == 0
    length = np.linalg.norm(direction[first], axis=1, keepdims=True)
    before = direction[first] / length * tolerance
    origin[first] -= before
    direction[first] += before
    return _Chords(origin, direction, point, step)


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


class _Judge:
    """Tells crossings that count from touching, sliding and leaving."""

    def __init__(
        self,
        part: Surface,
        target: Surface,
        path: RelativePath,
        chosen: npt.NDArray[np.int64],
        at: FloatArray,
        tolerance: float,
    ) -> None:
        self.part, self.target, self.tolerance = part, target, tolerance
        exact = part.oriented and target.oriented
        self.sidestep = SIDESTEP * tolerance if exact else tolerance
        self.points, self.at = part.points[chosen], at
        self.part_from_target = inverse(path.target_from_part[:1])[0]
        self.coarse = path.move(part.coarse)
        step = np.linalg.norm(np.diff(at, axis=0), axis=2)
        self.travelled = np.concatenate([np.zeros((1, at.shape[1])), np.cumsum(step, axis=0)])

    def counts(
        self, chords: _Chords, hit: FloatArray, normals: FloatArray, along: FloatArray
    ) -> npt.NDArray[np.bool_]:
        """(R,) for hits at (R, 3) with the target's normals, ``along`` their steps."""
        ways = chords.direction / np.linalg.norm(chords.direction, axis=1, keepdims=True)
        sine = np.einsum("ri,ri->r", normals, ways)
        steep = np.flatnonzero(np.abs(sine) > GRAZING)
        solid = self.target.bounds_solid(hit[steep])
        kept = ~(solid & (sine[steep] > 0))
        steep, solid = steep[kept], solid[kept]
        fresh = self._at_rest(chords, along)[steep]
        toward = normals[steep] * np.sign(sine[steep])[:, None]
        ahead, behind = self._bulk(chords.take(steep), toward, solid)
        start = np.flatnonzero(fresh)
        good = ahead < 0.5
        good[start] = (ahead[start] < 0.05) & (behind[start] > 0.2)
        first = steep[start]
        start_point, end_point = self.at[0], self.at[1]
        step = np.linalg.norm((end_point - start_point)[chords.point[first]], axis=1)
        passed = np.where(chords.step[first] == 0, -along[first] * step, 0.0)
        good[start] &= self._leads(chords.point[first], ways[first], passed)
        steep = steep[good]
        out = np.zeros(len(hit), bool)
        out[steep] = _broad(self.target, hit[steep], ways[steep], self.sidestep)
        return out

    def _at_rest(self, chords: _Chords, along: FloatArray) -> npt.NDArray[np.bool_]:
        """(R,) whether a hit is no further from rest than parts that touch may be."""
        before = self.travelled[chords.step, chords.point]
        after = self.travelled[chords.step + 1, chords.point]
        return (1 - along) * before + along * after <= self.tolerance

    def _bulk(
        self, chords: _Chords, toward: FloatArray, solid: npt.NDArray[np.bool_]
    ) -> tuple[FloatArray, FloatArray]:
        """(R,) shares of the part about the crossing points that lie beyond the surface, and
        before it. Where the target is solid its winding has settled it: all lies before."""
        ahead, behind = np.zeros(len(toward)), np.ones(len(toward))
        for step in np.unique(chords.step[~solid]):
            mine = np.flatnonzero(~solid & (chords.step == step))
            ahead[mine], behind[mine] = _shares(
                self.coarse[step],
                self.at[step, chords.point[mine]],
                toward[mine],
                BULK * self.part.diagonal,
                0.5 * self.tolerance,
            )
        return ahead, behind

    def _leads(
        self, point: npt.NDArray[np.int64], ways: FloatArray, passed: FloatArray
    ) -> npt.NDArray[np.bool_]:
        """(R,) whether a point that touches at rest can push into what it touches.

        Only a point with none of its own part's material ahead of it can; the others withdraw.
        Where the target lies (R,) ``passed`` metres behind the point, the part's material must
        reach as far back, or all of it is beyond the target already.
        """
        own = ways @ self.part_from_target[:3, :3].T
        gap = 1e-2 if self.part.oriented else 1.0  # discs of a noisy cloud lie about the point
        gap *= self.tolerance
        starts = self.points[point]
        out = self.part.cast(starts + gap * own, own).distance > THICK * self.tolerance
        if self.part.oriented:
            out &= self.part.count(starts + gap * own, own) % 2 == 0
        behind = np.flatnonzero(out & (passed > 2 * gap))
        back = self.part.cast(starts[behind] - gap * own[behind], -own[behind]).distance + gap
        out[behind] = back >= passed[behind]
        return out


def _shares(
    posed: FloatArray, here: FloatArray, toward: FloatArray, reach: float, margin: float
) -> tuple[FloatArray, FloatArray]:
    """(R,) shares of samples (C, 3) about each of (R, 3) places that lie beyond it along (R, 3)
    directions, and before it, by more than ``margin``."""
    squared = (here**2).sum(1)[:, None] - 2 * here @ posed.T + (posed**2).sum(1)
    weight = np.exp(-squared / (2 * reach**2))
    weight /= np.maximum(weight.sum(1, keepdims=True), 1e-12)
    beyond = toward @ posed.T - np.einsum("ri,ri->r", here, toward)[:, None]
    return (weight * (beyond > margin)).sum(1), (weight * (beyond < -margin)).sum(1)


def _aside(target: Surface, hit: FloatArray, ways: FloatArray, tolerance: float) -> float:
    """Metres aside, square to (E, 3) ways, that avoid nearly all crossings at (E, 3) ``hit``.

    Two parts that overlap by a hair's breadth along an edge pass each other's whole depth; what
    is wrong with them is that breadth. It counts only where the opposite step of twice the size
    avoids nothing: both do at a thin post, which is in the way all the same.

    Returns:
        Infinite where it is more than the last of :data:`ASIDE`.
    """
    chosen = np.linspace(0, len(hit) - 1, min(len(hit), ASIDE_POINTS)).astype(np.int64)
    hit, ways = hit[chosen], ways[chosen]
    ways = ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-30)
    u, v = _across(ways)
    angles = np.arange(8) * (np.pi / 4)
    directions = np.cos(angles)[:, None, None] * u + np.sin(angles)[:, None, None] * v
    steps = np.array([*ASIDE, 2 * ASIDE[-1]]) * tolerance
    reach = 3.0 * steps[:, None, None, None]  # as in _broad
    start = hit + steps[:, None, None, None] * directions - reach * ways
    along = np.broadcast_to(ways, start.shape)
    distance = target.cast(start.reshape(-1, 3), along.reshape(-1, 3)).distance
    misses = distance.reshape(start.shape[:-1]) > 2 * reach[..., 0]
    opposite = np.roll(misses, 4, axis=1)
    ever = np.maximum.accumulate(opposite, axis=0)
    clear = misses[:-1] & ~ever[1:]
    first = np.where(clear, steps[:-1, None, None], np.inf).min(axis=(0, 1))
    return float(np.sort(first)[math.ceil(ASIDE_SHARE * len(first)) - 1])


def _across(ways: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two (R, 3) unit vectors square to (R, 3) unit vectors and to each other."""
    helper = np.eye(3)[np.argmin(np.abs(ways), axis=1)]
    u: FloatArray = np.cross(ways, helper)
    u = u / np.linalg.norm(u, axis=1, keepdims=True)
    return u, np.asarray(np.cross(ways, u), np.float64)


def _broad(
    target: Surface, hit: FloatArray, ways: FloatArray, sidestep: float
) -> npt.NDArray[np.bool_]:
    """(R,) whether the target is still hit when the path is moved sideways by ``sidestep``.

    Where it isn't, a step aside avoids the target: parts that touch along an edge or a face.
    """
    u, v = _across(ways)
    reach = 3.0 * sidestep  # a surface as flat as GRAZING allows is met that much later
    out = np.ones(len(hit), bool)
    for angle in np.arange(SIDESTEPS) * (2 * np.pi / SIDESTEPS):
        left = np.flatnonzero(out)
        if not len(left):
            break
        aside = sidestep * (np.cos(angle) * u[left] + np.sin(angle) * v[left])
        start = hit[left] + aside - reach * ways[left]
        out[left] = target.cast(start, ways[left]).distance <= 2 * reach
    return out
