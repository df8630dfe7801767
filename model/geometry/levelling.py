"""Find the up direction of a scan of any rotation and scale, and the tightest upright box.

Candidates are the directions in which the surface faces most, and those square to two of them. Each
is described by what speaks for it: a surface that the object stands on and that reaches beyond it,
how much of the surface is level or upright, how broadly the object would stand, and what was seen
of its underside. A logistic model weighs these features; its probability is the confidence.

A scan with nothing below it whose faces lie along the file's axes is upright, or was saved with y
up and lies on its back: a second model, for clean surfaces, chooses among these.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, KDTree, QhullError
from scipy.special import softmax

from model.core.errors import GeometryError
from model.core.files import static_assets
from model.core.progress import Progress, no_progress


def box_yaw(flat: npt.NDArray[np.floating[Any]], gain: float = 0.8) -> float:
    """Return the yaw in (-π/4, π/4] of the smallest upright box around points.

    Args:
        flat: (N, 2) x and y, metres.
        gain: another angle than the best so far must bring the area below this share of it.
    """
    best, least = 0.0, np.inf
    for yaw in np.radians([0, *range(-44, 46, 2)]):
        turned = flat @ np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        low, high = np.percentile(turned, (1, 99), axis=0)
        area = float(np.prod(high - low + 1e-9))
        if area < least * gain:
            best, least = float(yaw), area
    return best


Array = npt.NDArray[np.float64]

_SAMPLE = 20_000
"""Points that are looked at; more change no answer."""
_MOST = 1_000_000
"""Points among which they are chosen, against the time."""
_LONE = 0.03
"""Share of a cell's usual number of points: with fewer it holds outliers, in dense scans alone."""
_DIRECTIONS = 1500
"""Directions of the half sphere whose share of normals is counted, 3.6 degrees apart."""
_SQUARE = np.radians(6)
"""Tilt up to which a face counts as level or upright: one-sided scans of rooms are that rough."""
_CANDIDATES = 6
"""Directions that are described, each both ways; of 400 scans none had its up further behind."""


LYING = 0.8
"""Probability from which a scan is said to lie on its back or front: of 39 PartNet-Mobility
objects, none of the fit, whole and as scanned, 5 % have it upright, and 75 % lying."""
LYING_DECLARED = 0.9
"""The same where the format says which axis is up, which is seldom wrong: 1 %, and 61 %."""
UPRIGHT = (0.0, 0.0, 1.0)
_BOARDS = 0.3
"""Share of points on inner boards, twice as many as along y, from which a scan stands. Of 79
PartNet-Mobility and 70 procedural objects 6 and 9 % of the upright ones are said to lie then, not
8 and 10 %, and as many lying ones as before."""
_UNUSUAL = 0.25
"""Odds of the opposite of the expected up direction against it, where a scan lies; our estimate."""
SURE = 0.5
"""Confidence from which a scan that lies askew is called tilted: chosen on the bundled objects and
on crops of one room, of which none that is upright is."""


@dataclass(frozen=True)
class Levelling:
    """A direction that may be up.

    Attributes:
        up: (3,) unit vector in the source's frame.
        confidence: probability that it is right within some degrees.
        support: height along ``up`` of the surface that the object stands on, in the source's
            unit; None where none reaches beyond the object.
        alternatives: other directions, the likelier first.
        askew: whether a main face is neither level nor upright as the scan lies, and none of the
            directions is along z.
        lying: probability that the scan lies on its back or front; None where it is askew or
            stands on something.
    """

    up: tuple[float, float, float]
    confidence: float
    support: float | None
    alternatives: tuple[tuple[float, float, float], ...] = ()
    askew: bool = False
    lying: float | None = None

    @property
    def tilt(self) -> float:
        """Radians between ``up`` and +z."""
        return float(np.arccos(np.clip(self.up[2], -1, 1)))

    def lies(self, declared: bool) -> bool:
        """True if it lies on its back or front; ``declared``: the format declares the up axis."""
        return (self.lying or 0.0) >= (LYING_DECLARED if declared else LYING)


def find_up(
    points: npt.NDArray[np.floating],
    normals: Array | None = None,
    progress: Progress = no_progress,
    *,
    mistaken: float = 1.0,
) -> Levelling:
    """The likeliest up direction of a scan.

    Args:
        points: (N, 3) in any unit.
        normals: (N, 3) of the points where they are known, either way round.
        progress: called between the steps.
        mistaken: y of the up direction, 1 or -1, where the file's up axis was taken for another.

    Raises:
        GeometryError: for fewer than four finite points.
    """
    sample, facing = sampled(np.asarray(points, np.float64), normals)
    found = _described(sample, facing, progress)
    features = np.array([c.described.features for c in found])
    weights = _weights()
    scores = (features - weights.mean) / weights.scale @ weights.weight
    odds = softmax(scores)
    order = np.argsort(-odds)
    best = found[order[0]]
    off = np.arccos([min(abs(float(c.up[2])), 1.0) for c in found[::2]])
    askew = bool((off > _SQUARE).all() and (off[:2] < np.pi / 2 - _SQUARE).any())
    others = tuple(_vector(found[k].up) for k in order[:4])
    if not askew and best.height is None:
        return _along_axes(sample, facing, mistaken, others)
    return Levelling(_vector(best.refined), float(odds[order[0]]), best.height, others[1:], askew)


def _along_axes(
    sample: Array, facing: Array, mistaken: float, others: tuple[tuple[float, float, float], ...]
) -> Levelling:
    """Upright, or lying on its back or front."""
    ups = np.array([UPRIGHT, [0.0, mistaken, 0.0], [0.0, -mistaken, 0.0]])
    features = np.array([bare_features(sample, facing, up) for up in ups])
    weights = _weights(bare=True)
    odds = np.exp((features - weights.mean) / weights.scale @ weights.weight)
    lying = float(odds[1:].sum() / odds.sum())
    boards, elsewhere = (_boards(sample, facing, up) for up in ups[:2])
    if boards > max(_BOARDS, 2 * elsewhere):
        lying = min(lying, 1 - LYING)
    order = np.argsort(-odds * [1.0, 1.0, _UNUSUAL])
    first = order[order > 0][0] if lying >= LYING else 0
    rest = [_vector(ups[k]) for k in order if k != first]
    far = [u for u in others if max(np.abs(u)) < np.cos(_SQUARE) or abs(u[0]) > 0.5]
    confidence = lying if first else 1 - lying
    return Levelling(_vector(ups[first]), confidence, None, (*rest, *far), lying=lying)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A direction that may be up.

    Attributes:
        up, refined: (3,) unit vectors, as found, and square to the supporting surface.
        described: what speaks for it.
        height: of the supporting surface along ``refined``, or None.
    """

    up: Array
    refined: Array
    described: Described
    height: float | None


def candidates_of(points: npt.NDArray[np.floating]) -> list[Candidate]:
    """The directions that may be up; errors as of :func:`find_up`."""
    return _described(*sampled(np.asarray(points, np.float64), None), no_progress)


def _described(sample: Array, facing: Array, progress: Progress) -> list[Candidate]:
    out: list[Candidate] = []
    progress(0.5, "comparing directions")
    for up in _candidates(sample, facing):
        progress(0.7, "comparing directions")
        described = describe(sample, facing, up)
        refined = _refined(sample, facing, up, described)
        height = None
        # Two faces of a plate are told apart once up is square to them.
        if described.support is not None and describe(sample, facing, refined).support is not None:
            height = float(np.median(sample[described.on_support] @ refined))
        out.append(Candidate(up, refined, described, height))
    return out


def supporting_height(
    points: npt.NDArray[np.floating], normals: Array | None, up: Array
) -> float | None:
    """Height along ``up`` of the surface that an object stands on, where it reaches beyond it."""
    sample, facing = sampled(np.asarray(points, np.float64), normals)
    return describe(sample, facing, up).support


@dataclass(frozen=True, eq=False)
class Described:
    """Evidence for one candidate.

    Attributes:
        features: (F,) see :data:`FEATURES`.
        support: height of the supporting surface along the candidate, or None.
        on_support: (N,) bool, points of the sample on it.
    """

    features: Array
    support: float | None
    on_support: npt.NDArray[np.bool_]


FEATURES = (
    "share of the level surface that lies lowest",
    "share of points below that surface",
    "how far it reaches beyond the rest",
    "share of level surface",
    "share of upright surface",
    "breadth of the stand",
    "margin of the centre over the stand",
    "level surface at the top against the bottom",
    "height against width",
)


def describe(points: Array, normals: Array, up: Array) -> Described:
    """Features of one candidate; lengths in parts of the points' extent."""
    height = points @ up
    low, high = np.percentile(height, [0.5, 99.5])
    extent = max(float(high - low), 1e-12)
    size = max(float(np.linalg.norm(np.ptp(points, axis=0))), 1e-12)
    band = 0.015 * size
    cosine = np.abs(normals @ up)
    level, upright = cosine > 0.95, cosine < 0.2
    edges = np.arange(low - 2 * band, high + 3 * band, band)
    held, _ = np.histogram(height[level], edges)
    thick = held[:-1] + held[1:]
    k = int(thick.argmax())
    at = edges[k] + band
    on = level & (np.abs(height - at) < band)
    below = float((height < at - 2 * band).mean())
    a, b = _plane_axes(up)
    flat = np.column_stack([points @ a, points @ b])
    rest = height > at + 2 * band
    reach = 0.0
    if on.sum() > 50 and rest.sum() > 50:
        reach = _reach(flat[on], flat[rest])
    foot = height < low + 0.04 * extent
    breadth, margin = _stand(flat, foot)
    top, bottom = (
        float((level & m).mean()) for m in (height > high - 2 * band, height < low + 2 * band)
    )
    width = float(np.linalg.norm(np.ptp(np.percentile(flat, [1, 99], axis=0), axis=0)))
    features = np.array(
        [
            float(on.mean()) * (below < 0.03),
            min(below, 0.5),
            float(np.clip(reach, -2, 3)),
            float(level.mean()),
            float(upright.mean()),
            breadth,
            margin,
            float(np.log((top + 0.01) / (bottom + 0.01))),
            float(np.log(extent / max(width, 1e-9))),
        ]
    )
    support = float(np.median(height[on])) if on.any() else at
    # A slab whose underside is seen too is part of the object: a laptop's base under its screen.
    scatter = float(np.median(np.abs(height[on] - support))) if on.any() else 0.0
    slab = float((height < support - 6 * scatter - 1e-3 * size).mean()) > 0.1
    near = level & (np.abs(height - support) < 3 * band)
    slab = slab or _both_faces(height[near], flat[near], 1e-3 * size)
    if rest.sum() <= 50:  # what lies there is thinner than the bands: scissors
        fine = np.abs(height - support) < max(6 * scatter, 1e-3 * size)
        rest = (height > support) & ~fine
        lies = on.any() and rest.sum() > max(50, 2 * ((height < support) & ~fine).sum())
        reach = _reach(flat[on & fine], flat[rest]) if lies else 0.0
    supported = below < 0.03 and reach > 0.1 and on.mean() > 0.04 and not slab
    return Described(features, support if supported else None, on)


def _reach(low: Array, high: Array) -> float:
    """Logarithm of how much wider (N, 2) points extend than others."""
    wide, narrow = (np.ptp(np.percentile(p, [2, 98], axis=0), axis=0) for p in (low, high))
    return float(np.log(np.prod(wide + 1e-9) / np.prod(narrow + 1e-9)))


def _both_faces(height: Array, flat: Array, least: float) -> bool:
    """True if level points lie on a plate's two faces, equally wide and ``least`` apart."""
    if len(height) < 50:
        return False
    low, high = np.percentile(height, [1, 99])
    count, edges = np.histogram(height, 12, (low, high))
    between = np.convolve(count, np.ones(3), "valid")  # a quarter of the range
    k = int(between.argmin())
    upper = height > (edges[k + 1] + edges[k + 2]) / 2
    apart = high - low > least and between[k] < 0.075 * len(height)
    return bool(apart and 0.05 < upper.mean() < 0.95 and _reach(flat[~upper], flat[upper]) < 0.1)


def _boards(points: Array, normals: Array, up: Array) -> float:
    """Share of points on level surfaces that are neither at the top nor at the bottom."""
    height = points @ up
    low, high = np.percentile(height, [0.5, 99.5])
    between = np.abs(height - (low + high) / 2) < 0.4 * (high - low)
    return float((between & (np.abs(normals @ up) > 0.95)).mean())


BARE_FEATURES = (
    *FEATURES[5:8],
    "mirror image upside down",
    "middle height",
    "level surface at the top",
    "height against diagonal",
)
_MIRRORED = 0.025
"""Share of the diagonal: greatest distance of a point from its mirror image."""


def bare_features(points: Array, normals: Array, up: Array) -> Array:
    """(F,) of a scan with nothing below it, see :data:`BARE_FEATURES`."""
    height = points @ up
    low, high = np.percentile(height, [0.5, 99.5])
    extent = max(float(high - low), 1e-12)
    size = max(float(np.linalg.norm(np.ptp(points, axis=0))), 1e-12)
    some = points[:: max(len(points) // 4000, 1)]
    middle = np.percentile(height, [1, 99]).mean()
    image = some[::4] - 2 * np.outer(some[::4] @ up - middle, up)
    alike = float((KDTree(some).query(image)[0] < _MIRRORED * size).mean())
    share = np.clip((height - low) / extent, 0, 1)
    top = float(((np.abs(normals @ up) > 0.95) & (share > 0.9)).mean())
    shape = np.array([alike, share.mean(), top, np.log(extent / size)])
    return np.concatenate([describe(points, normals, up).features[5:8], shape])


def _stand(flat: Array, foot: npt.NDArray[np.bool_]) -> tuple[float, float]:
    """Breadth of what touches the ground against the whole, and how well the centre is over it."""
    try:
        whole = ConvexHull(flat)
        stand = ConvexHull(flat[foot])
    except (QhullError, ValueError):
        return 0.0, -1.0
    middle = (flat.min(0) + flat.max(0)) / 2
    inside = -float((stand.equations[:, :2] @ middle + stand.equations[:, 2]).max())
    return float(stand.volume / whole.volume), inside / max(float(np.sqrt(whole.volume)), 1e-12)


def sampled(points: Array, normals: Array | None) -> tuple[Array, Array]:
    """At most :data:`_SAMPLE` points, evenly over the surface, and their normals."""
    some = slice(None, None, max(len(points) // _MOST, 1))
    points, normals = points[some], None if normals is None else normals[some]
    finite = np.isfinite(points).all(1)
    points = points[finite]
    if len(points) < 4:
        raise GeometryError(f"{len(points)} points have no up direction; four are needed")
    low, high = np.percentile(points, [1, 99], axis=0)
    size = float(np.linalg.norm(high - low))
    inside = ((points >= low - 0.3 * size) & (points <= high + 0.3 * size)).all(1)
    points = points[inside]
    cell = size / 120
    key = np.floor((points - points.min(0)) / max(cell, 1e-12)).astype(np.int64)
    span = key.max(0) + 1
    flat = (key[:, 0] * span[1] + key[:, 1]) * span[2] + key[:, 2]
    _, first, count = np.unique(flat, return_index=True, return_counts=True)
    usual = float(np.median(np.repeat(count, count)))  # of a point's cell
    first = first[count >= _LONE * usual]  # in dense scans outliers fill many cells
    first = first[:: max(len(first) // _SAMPLE, 1)]
    if normals is not None:
        return points[first], normals[finite][inside][first]
    if len(first) < 8:  # too few for a surface
        return points[first], np.tile([0.0, 0.0, 1.0], (len(first), 1))
    tree = KDTree(points[first])
    _, near = tree.query(points[first], k=min(24, len(first)), workers=2)
    around = points[first][near]
    around = around - around.mean(1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    return points[first], axes[:, :, 0]


@cache
def _half_sphere() -> Array:
    """(D, 3) even unit vectors (a Fibonacci lattice) with z above 0."""
    k = np.arange(_DIRECTIONS) + 0.5
    z = k / _DIRECTIONS
    angle = np.pi * (1 + np.sqrt(5)) * k
    r = np.sqrt(1 - z * z)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z])


def _candidates(points: Array, normals: Array) -> list[Array]:
    """Directions in which most of the surface faces and those square to two of them, both ways."""
    directions = _half_sphere()
    chosen = normals[:: max(len(normals) // 6000, 1)]
    count = (np.abs(directions @ chosen.T) > np.cos(np.radians(6))).sum(1).astype(float)
    axes: list[Array] = []
    while len(axes) < _CANDIDATES - 2 and count.max() > 0.01 * len(chosen):
        axis = _mean_axis(normals, directions[count.argmax()], 8.0)
        axes.append(axis)
        count[np.abs(directions @ axis) > np.cos(np.radians(20))] = 0
    spread = points - points.mean(0)
    _, principal = np.linalg.eigh(spread.T @ spread)
    squares = [np.cross(a, b) for i, a in enumerate(axes) for b in axes[:i] if abs(a @ b) < 0.2]
    for extra in (a / np.linalg.norm(a) for a in [*squares, *principal.T]):
        if all(abs(extra @ a) < np.cos(np.radians(15)) for a in axes):
            axes.append(extra)
    return [sign * axis for axis in axes for sign in (1.0, -1.0)]


def _mean_axis(normals: Array, axis: Array, degrees: float) -> Array:
    """The mean of the normals within some degrees of ``axis``, either way round."""
    for _ in range(4):
        near = normals[np.abs(normals @ axis) > np.cos(np.radians(degrees))]
        if len(near) < 10:
            break
        _, axes = np.linalg.eigh(near.T @ near)
        axis = axes[:, 2] * np.sign(axes[:, 2] @ axis)
    return axis


def _refined(points: Array, normals: Array, up: Array, found: Described) -> Array:
    """``up`` square to the supporting surface, else along the mean of the level normals."""
    if found.support is None:
        return _mean_axis(normals, up, 8.0)
    on = points[found.on_support]
    for _ in range(3):
        middle = on.mean(0)
        _, axes = np.linalg.eigh((on - middle).T @ (on - middle))
        away = np.abs((on - middle) @ axes[:, 0])
        on = on[away < 2.5 * max(float(np.median(away)), 1e-12)]
    return axes[:, 0] * np.sign(axes[:, 0] @ up)


@dataclass(frozen=True, eq=False)
class _Weights:
    mean: Array
    scale: Array
    weight: Array


@cache
def _weights(bare: bool = False) -> _Weights:
    data = json.loads((static_assets() / "levelling.json").read_text())
    data = data["bare"] if bare else data
    return _Weights(*(np.array(data[k]) for k in ("mean", "scale", "weight")))


def _plane_axes(up: Array) -> tuple[Array, Array]:
    a = np.asarray(np.cross(up, np.eye(3)[np.abs(up).argmin()]), np.float64)
    a = a / np.linalg.norm(a)
    return a, np.asarray(np.cross(up, a), np.float64)


def _vector(value: Array | Sequence[float]) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in value)
    return x, y, z
