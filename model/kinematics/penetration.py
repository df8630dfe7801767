"""Penetration: points of one part that pass through the surface of another while a joint moves.

A point's path is cut into chords, and each chord is cast as a ray against the other part's
triangles, which works for single sheets of a scan as for closed boards. A hit counts unless

- it grazes the surface (below :data:`GRAZING`): sliding along a rail is no collision, and the
  normals of a noisy scan are no more accurate;
- a small sidestep avoids the target: the parts touch along a face or an edge;
- the point leaves a solid, by the winding of the triangles;
- most of its part near the point is beyond the surface already: it was so at rest;
- it touches at rest, and material of its own part lies ahead of it: it withdraws.

The depth is the distance beyond the hit element along its normal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.core.memory import array_digest
from model.kinematics.surface import COARSE, Surface

GRAZING = 0.34
"""Sine of the angle below which a path slides along a surface: 20°, a choice."""
ROUNDS = 6
"""Most hits of a chord that are tried until one counts."""
SIDESTEPS = 6
SIDESTEP = 0.3
"""Sidestep of meshes in tolerances; of clouds it is one tolerance."""
THICK = 10.0
"""Largest thickness of a board whose back touches at rest, in tolerances."""
OUTLIERS = 0.004
"""Share of a part's samples whose penetrations are ignored."""
ESCAPES = (0.5, 1.0, 2.0, 4.0)
"""Sidesteps that are tried to avoid all penetrations, in tolerances."""
ESCAPE_POINTS = 64
ESCAPE_SHARE = 0.9
"""Share of the penetrations that a sidestep must avoid."""
BULK = 0.08
"""Standard deviation of the neighbourhood of a point, in the part's diagonal."""

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RelativePath:
    """Motion of a part in the target's rest frame, from rest onwards.

    Attributes:
        q: (K,) joint values, monotone, q[0] is rest.
        target_from_part: (K, 4, 4).
        straight: whether it is a single translation, which one chord covers.
    """

    q: FloatArray
    target_from_part: FloatArray
    straight: bool

    def move(self, points: FloatArray) -> FloatArray:
        """(K, P, 3) of (P, 3) points."""
        return moved(self.target_from_part, points)


@dataclass(frozen=True, eq=False)
class Penetrations:
    """First penetration of each point that has one.

    Attributes:
        q: (E,) joint value.
        points: (E, 3) the points at rest, their part's coordinates.
        anchor, normal: (E, 3) of the hit element in the target's coordinates; the normal points
            along the motion.
        outliers: number of points that are ignored, as outliers or wrong labels.
        sidestep: metres sideways that avoid them, see :func:`_escape`, or infinite.
    """

    q: FloatArray
    points: FloatArray
    anchor: FloatArray
    normal: FloatArray
    outliers: int
    sidestep: float

    def depth(self, target_from_part: FloatArray) -> FloatArray:
        """(K, E) metres beyond the hit elements at (K, 4, 4) poses; negative before them."""
        now = moved(target_from_part, self.points)
        return np.einsum("kei,ei->ke", now - self.anchor, self.normal)


@dataclass(frozen=True, eq=False)
class _Chords:
    """Pieces of paths: (R, 3) rays whose directions are as long as the chords."""

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


def penetrations(
    part: Surface, target: Surface, path: RelativePath, tolerance: float
) -> Penetrations:
    """Find where samples of ``part`` pass through ``target``.

    Results are cached: an edit of one joint changes few paths.

    Args:
        tolerance: metres; surfaces this close behind a point at rest count as touching it.
    """
    if path.straight and len(path.q) > 2:
        path = RelativePath(path.q[[0, -1]], path.target_from_part[[0, -1]], True)
    key = array_digest(
        path.q, path.target_from_part, np.array([tolerance, path.straight], np.float64)
    )

    def find() -> tuple[Penetrations, Surface]:
        return sweep_penetrations(part, target, path, tolerance), target  # reserves the target's id

    return part.cache.get((id(target), key), find, weigh=lambda held: float(len(held[0].q)))[0]


def sweep_penetrations(
    part: Surface, target: Surface, path: RelativePath, tolerance: float
) -> Penetrations:
    """:func:`penetrations` without its cache."""
    chosen, at = _near(part, target, path, tolerance)
    hit_filter = _HitFilter(part, target, path, chosen, at, tolerance)
    chords = _chords(at, target, tolerance)
    best = np.full(len(chosen), np.inf)
    element = np.zeros(len(chosen), np.int64)
    anchor, normal = np.zeros((len(chosen), 3)), np.zeros((len(chosen), 3))
    for _ in range(ROUNDS):
        if not len(chords.point):
            break
        hits = target.cast(chords.origin, chords.direction)
        index = np.flatnonzero(hits.distance <= 1.0)
        chords, t, n = chords.take(index), hits.distance[index], hits.normals[index]
        hit = chords.origin + t[:, None] * chords.direction
        # Position of the hit on its step, 0..1; negative before rest.
        along = _along(hit, at, chords)
        fraction = chords.step + along
        counts = hit_filter.counts(chords, hit, n, along)
        order = np.flatnonzero(counts & (fraction < best[chords.point]))
        order = order[np.argsort(-fraction[order], kind="stable")]
        points = chords.point[order]  # the earliest hit of a point is written last
        best[points], element[points] = fraction[order], hits.element[index][order]
        sign = np.sign(np.einsum("ri,ri->r", n, chords.direction))[:, None]
        normal[points] = (n * sign)[order]
        anchor[points] = np.where((fraction[order] <= 0)[:, None], at[0][points], hit[order])
        again = np.flatnonzero(~counts & (fraction < best[chords.point]))
        chords = _continued(chords.take(again), t[again], tolerance)
    found = np.flatnonzero(np.isfinite(best))
    if not target.oriented:
        # One bad disc of a noisy cloud stops many points: it counts once.
        order = found[np.argsort(best[found], kind="stable")]
        found = order[np.unique(element[order], return_index=True)[1]]
    q = np.interp(np.maximum(best[found], 0), np.arange(len(path.q)), path.q)
    share = OUTLIERS if target.oriented else OUTLIERS / 2
    outliers = math.floor(share * len(part.points))
    sidestep = math.inf
    if part.oriented and target.oriented and len(found) > outliers:
        step = np.clip(best[found].astype(np.int64), 0, len(path.q) - 2)
        sidestep = _escape(target, anchor[found], at[step + 1, found] - at[step, found], tolerance)
    return Penetrations(
        q, part.points[chosen[found]], anchor[found], normal[found], outliers, sidestep
    )


def _near(
    part: Surface, target: Surface, path: RelativePath, tolerance: float
) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Samples whose paths come near the target's box, and (K, P, 3) their paths."""
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
    """Chords near the target's box; the first ones start one tolerance before rest."""
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
    """(R,) position of the hits on their steps, 0..1; negative before rest."""
    start, end = at[chords.step, chords.point], at[chords.step + 1, chords.point]
    whole = end - start
    return np.einsum("ri,ri->r", hit - start, whole) / np.einsum("ri,ri->r", whole, whole)


def _continued(chords: _Chords, t: FloatArray, tolerance: float) -> _Chords:
    """The rest of the chords behind hits that don't count."""
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


class _HitFilter:
    """Separates penetrations from touching, sliding and leaving."""

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
        self.coarse = path.move(part.points[:COARSE])
        step = np.linalg.norm(np.diff(at, axis=0), axis=2)
        self.travelled = np.concatenate([np.zeros((1, at.shape[1])), np.cumsum(step, axis=0)])

    def counts(
        self, chords: _Chords, hit: FloatArray, normals: FloatArray, along: FloatArray
    ) -> npt.NDArray[np.bool_]:
        """(R,) whether hits at (R, 3) with the target's normals, ``along`` their steps, count."""
        directions = chords.direction / np.linalg.norm(chords.direction, axis=1, keepdims=True)
        sine = np.einsum("ri,ri->r", normals, directions)
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
        good[start] &= self._leads(chords.point[first], directions[first], passed)
        steep = steep[good]
        out = np.zeros(len(hit), bool)
        out[steep] = _is_broad(self.target, hit[steep], directions[steep], self.sidestep)
        return out

    def _at_rest(self, chords: _Chords, along: FloatArray) -> npt.NDArray[np.bool_]:
        """(R,) whether hits are within one tolerance of rest."""
        before = self.travelled[chords.step, chords.point]
        after = self.travelled[chords.step + 1, chords.point]
        return (1 - along) * before + along * after <= self.tolerance

    def _bulk(
        self, chords: _Chords, toward: FloatArray, solid: npt.NDArray[np.bool_]
    ) -> tuple[FloatArray, FloatArray]:
        """(R,) shares of the part near the hits that lie beyond the surface, and before it.

        For solid targets the winding has decided: all of it lies before.
        """
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
        self, point: npt.NDArray[np.int64], directions: FloatArray, passed: FloatArray
    ) -> npt.NDArray[np.bool_]:
        """(R,) whether a point that touches at rest can penetrate the target.

        A point with material of its own part ahead withdraws. Where the target lies (R,)
        ``passed`` metres behind the point, the part's material must reach as far back, or all of
        it is beyond the target already.
        """
        own = directions @ self.part_from_target[:3, :3].T
        gap = 1e-2 if self.part.oriented else 1.0  # discs of a noisy cloud surround the point
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
    """(R,) shares of samples (C, 3) near (R, 3) places that lie more than ``margin`` beyond them
    along (R, 3) directions, and before them."""
    squared = (here**2).sum(1)[:, None] - 2 * here @ posed.T + (posed**2).sum(1)
    weight = np.exp(-squared / (2 * reach**2))
    weight /= np.maximum(weight.sum(1, keepdims=True), 1e-12)
    beyond = toward @ posed.T - np.einsum("ri,ri->r", here, toward)[:, None]
    return (weight * (beyond > margin)).sum(1), (weight * (beyond < -margin)).sum(1)


def _escape(target: Surface, hit: FloatArray, directions: FloatArray, tolerance: float) -> float:
    """Smallest sidestep in metres, normal to (E, 3) directions, that avoids nearly all (E, 3) hits.

    Parts that overlap slightly along an edge penetrate each other's whole depth; their error is the
    sidestep. It counts only where the opposite step of twice the size avoids nothing: at a thin
    post both do, and it is a collision.

    Returns:
        Infinity above the last of :data:`ESCAPES`.
    """
    chosen = np.linspace(0, len(hit) - 1, min(len(hit), ESCAPE_POINTS)).astype(np.int64)
    hit, directions = hit[chosen], directions[chosen]
    length = np.linalg.norm(directions, axis=1, keepdims=True)
    directions = directions / np.maximum(length, 1e-30)
    u, v = _across(directions)
    angles = np.arange(8) * (np.pi / 4)
    sideways = np.cos(angles)[:, None, None] * u + np.sin(angles)[:, None, None] * v
    steps = np.array([*ESCAPES, 2 * ESCAPES[-1]]) * tolerance
    reach = 3.0 * steps[:, None, None, None]  # as in _is_broad
    start = hit + steps[:, None, None, None] * sideways - reach * directions
    along = np.broadcast_to(directions, start.shape)
    distance = target.cast(start.reshape(-1, 3), along.reshape(-1, 3)).distance
    misses = distance.reshape(start.shape[:-1]) > 2 * reach[..., 0]
    opposite = np.roll(misses, 4, axis=1)
    ever = np.maximum.accumulate(opposite, axis=0)
    clear = misses[:-1] & ~ever[1:]
    first = np.where(clear, steps[:-1, None, None], np.inf).min(axis=(0, 1))
    return float(np.sort(first)[math.ceil(ESCAPE_SHARE * len(first)) - 1])


def _across(directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two (R, 3) unit vectors normal to (R, 3) unit vectors and to each other."""
    helper = np.eye(3)[np.argmin(np.abs(directions), axis=1)]
    u: FloatArray = np.cross(directions, helper)
    u = u / np.linalg.norm(u, axis=1, keepdims=True)
    return u, np.asarray(np.cross(directions, u), np.float64)


def _is_broad(
    target: Surface, hit: FloatArray, directions: FloatArray, sidestep: float
) -> npt.NDArray[np.bool_]:
    """(R,) whether the target is still hit by the path moved sideways by ``sidestep``."""
    u, v = _across(directions)
    reach = 3.0 * sidestep  # a surface at the angle of GRAZING is hit that much later
    out = np.ones(len(hit), bool)
    for angle in np.arange(SIDESTEPS) * (2 * np.pi / SIDESTEPS):
        left = np.flatnonzero(out)
        if not len(left):
            break
        shift = sidestep * (np.cos(angle) * u[left] + np.sin(angle) * v[left])
        start = hit[left] + shift - reach * directions[left]
        out[left] = target.cast(start, directions[left]).distance <= 2 * reach
    return out
