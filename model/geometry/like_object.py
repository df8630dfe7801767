"""Match an object with one that is done: which turn, mirroring and proportions map them best.

Objects stand upright (+z up, metres) and may face anywhere. Both are compared in the frames of
their tightest upright boxes: quarter turns and mirror images are tried, and the sides scaled, each
by its own factor; the best of them is fitted closer by matching nearest points.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from model.core.articulated_object import ArticulatedObject, Part
from model.core.errors import GeometryError
from model.geometry.levelling import box_yaw
from model.geometry.sampling import sample_surface

Points = npt.NDArray[np.float64]

POINTS = 4000
"""Points of each object that is compared."""
_LEAST_POINTS = 60
"""Points of each part, however small."""
PROPORTIONS = 1.35
"""Largest factor between two sides' scales."""
SCALE = 1.6
"""Largest factor between two sizes of one thing: the unit of a scan may be wrong by little."""
REACH = 0.02
"""Share of the diagonal within which a point has a counterpart."""
_ROUNDS = 6
_CLOSER = 6
"""Starts that are fitted closer."""
_MIRRORED = 0.03
"""Least advantage of a mirror image: most things look like their own."""
_FEWER, _WIDER = 8, 2.0
"""Divisor of the points by which starts are compared, and factor of the reach then."""
TURNED, MIRRORED = 0.1, 0.4
"""Cost of comparing an object turned, or mirrored: most face one way."""
_CLOSEST = 0.8
"""Share of the nearest pairs that a round fits: the others lack a counterpart."""


@dataclass(frozen=True, eq=False)
class Example:
    """A finished object as others are compared with it.

    Attributes:
        name: display name.
        points: (N, 3) on its surface, metres.
        part: (N,) index into ``links``; the base is one of them.
        links: the parts' links. names: what people call them, or None.
        root: the base's link. category: of the object, or None.
    """

    name: str
    points: Points
    part: npt.NDArray[np.int64]
    links: tuple[str, ...]
    names: tuple[str | None, ...]
    root: str
    category: str | None = None

    @cached_property
    def frame(self) -> UprightBox:
        """Its tightest upright box."""
        return UprightBox.around(self.points)

    @cached_property
    def tree(self) -> KDTree:
        """KD-tree of its points."""
        return KDTree(self.points)


@dataclass(frozen=True, eq=False)
class Match:
    """An example laid over an object.

    Attributes:
        linear, offset: (3, 3) and (3,): object = linear @ example + offset.
        fit: 0..1, share of each part's points that have a counterpart, mean of the parts and of
            the object's own points.
    """

    example: Example
    linear: Points
    offset: Points
    fit: float

    def to_object(self, points: npt.ArrayLike) -> Points:
        """(N, 3) points of the example, in the object's frame."""
        return np.asarray(points, float) @ self.linear.T + self.offset

    def to_example(self, points: npt.ArrayLike) -> Points:
        """(N, 3) points of the object, in the example's frame."""
        return (np.asarray(points, float) - self.offset) @ np.linalg.inv(self.linear).T


@dataclass(frozen=True, eq=False)
class UprightBox:
    """The tightest upright box of an object, but for the outermost of its points.

    Attributes:
        middle: (3,). turn: (3, 3) directions of its sides as columns. sides: (3,) lengths.
    """

    middle: Points
    turn: Points
    sides: Points

    @classmethod
    def around(cls, points: Points) -> UprightBox:
        """The box of (N, 3) points."""
        yaw = box_yaw(points[:, :2], 0.98)
        c, s = np.cos(yaw), np.sin(yaw)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        low, high = np.percentile(points @ turn, (0.5, 99.5), axis=0)
        return cls(turn @ (low + high) / 2, turn, np.maximum(high - low, 1e-9))


@lru_cache(maxsize=1)
def symmetries() -> tuple[tuple[Points, float], ...]:
    """(3, 3) matrices of the ways to turn an object upright, mirrored ones too, and their costs."""
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    out = []
    for flip in (np.eye(3), np.diag([1.0, -1, 1])):
        for k in range(4):
            cost = (TURNED if k else 0.0) + (MIRRORED if flip[1, 1] < 0 else 0.0)
            out.append((np.linalg.matrix_power(quarter, k) @ flip, cost))
    return tuple(out)


def example_of(obj: ArticulatedObject, name: str | None = None, seed: int = 0) -> Example:
    """Sample an object's parts evenly, small ones more densely.

    Raises:
        GeometryError: where no part has a surface or a point.
    """
    rng, sizes = np.random.default_rng(seed), [_size(p) for p in obj.parts]
    density = POINTS / max(sum(sizes), 1e-12)
    points = [
        _sampled(part, max(int(density * size), _LEAST_POINTS), rng)
        for part, size in zip(obj.parts, sizes, strict=True)
    ]
    if not sum(map(len, points)):
        raise GeometryError(f"{obj.name!r} has no surface to compare")
    return Example(
        name or obj.name,
        np.concatenate(points),
        np.repeat(np.arange(len(points)), [len(p) for p in points]),
        tuple(p.link for p in obj.parts),
        tuple(p.name for p in obj.parts),
        obj.tree.root,
        obj.category,
    )


def _size(part: Part) -> float:
    """Area (m²) of a mesh; of a cloud that of its box, as its points' density is unknown."""
    if part.cloud is None and part.mesh is not None:
        return float(part.mesh.face_areas.sum())
    a, b, c = np.ptp(part.bounds, axis=0)
    return float(a * b + b * c + c * a)


def _sampled(part: Part, count: int, rng: np.random.Generator) -> Points:
    if part.cloud is not None:  # as it was scanned, its mesh is made up
        every = rng.permutation(len(part.cloud))[:count]
        return part.cloud.points[every].astype(float)
    if part.mesh is None or not float(part.mesh.face_areas.sum()) > 0:
        return np.zeros((0, 3))
    return sample_surface(part.mesh, count, rng)[0].points.astype(float)


def best_match(examples: Iterable[Example], points: npt.ArrayLike, seed: int = 0) -> Match | None:
    """Return the example that fits an object best; None where none has its proportions.

    Args:
        points: (N, 3) on the object's surface, metres.
    """
    given = np.asarray(points, float)
    given = given[np.random.default_rng(seed).permutation(len(given))[:POINTS]]
    if len(given) < _LEAST_POINTS:
        return None
    frame, tree = UprightBox.around(given), KDTree(given)
    found = [_rough(start, given, tree) for e in examples for start in _starts(e, frame)]
    found.sort(key=_worth, reverse=True)
    closer = [_closer(match, given, tree) for match in found[:_CLOSER]]
    return max(closer, key=_worth, default=None)


def _worth(match: Match) -> float:
    return match.fit - _MIRRORED * (np.linalg.det(match.linear) < 0)


def _starts(example: Example, frame: UprightBox) -> Iterator[Match]:
    own = example.frame
    for turn, _ in symmetries():
        scale = frame.sides / np.abs(turn @ own.sides)
        mean = float(np.exp(np.log(scale).mean()))
        if max(mean, 1 / mean) <= SCALE and scale.max() <= PROPORTIONS * scale.min():
            linear = frame.turn @ np.diag(scale) @ turn @ own.turn.T
            yield Match(example, linear, frame.middle - linear @ own.middle, 0.0)


def _rough(match: Match, points: Points, tree: KDTree) -> Match:
    """The share of some points with a counterpart: which starts are worth a closer fit."""
    own, given = match.example.points, points[: POINTS // _FEWER]
    moved = match.to_object(own[:: max(1, _FEWER * len(own) // POINTS)])
    reach = REACH * float(np.linalg.norm(np.ptp(points, axis=0)))
    there = tree.query(moved, distance_upper_bound=reach)[0] < np.inf
    back = KDTree(moved).query(given, distance_upper_bound=_WIDER * reach)[0] < np.inf
    return replace(match, fit=(float(there.mean()) + float(back.mean())) / 2)


def _scored(match: Match, points: Points, tree: KDTree) -> Match:
    moved = match.to_object(match.example.points)
    reach = REACH * float(np.linalg.norm(np.ptp(points, axis=0)))
    there = tree.query(moved, distance_upper_bound=reach)[0] < np.inf
    part = match.example.part
    shares = np.bincount(part, there) / np.maximum(np.bincount(part), 1)
    back = KDTree(moved).query(points, distance_upper_bound=reach)[0] < np.inf
    return replace(match, fit=(float(shares.mean()) + float(back.mean())) / 2)


def _closer(match: Match, points: Points, tree: KDTree) -> Match:
    """Fit scale and offset of each side to the nearest points, in turns."""
    sides = UprightBox.around(points).turn
    best = match = _scored(match, points, tree)
    for _ in range(_ROUNDS):
        moved = match.to_object(match.example.points)
        found = tree.query(moved)
        far, nearest = np.asarray(found[0]), np.asarray(found[1])
        close = far <= np.quantile(far, _CLOSEST)
        x, y = moved[close] @ sides, points[nearest[close]] @ sides
        low = x.mean(axis=0)
        spread = np.maximum(((x - low) ** 2).mean(axis=0), 1e-12)
        slope = ((x - low) * (y - y.mean(axis=0))).mean(axis=0) / spread
        slope = np.clip(slope, 1 / PROPORTIONS, PROPORTIONS)
        linear = sides @ np.diag(slope) @ sides.T
        offset = sides @ (y.mean(axis=0) - slope * low)
        match = replace(match, linear=linear @ match.linear, offset=linear @ match.offset + offset)
        match = _scored(match, points, tree)
        best = max(best, match, key=lambda m: m.fit)
    return best
