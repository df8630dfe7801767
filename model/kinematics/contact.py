"""Contact of parts at rest: which touch, where, and along which line."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Part
from model.core.errors import GeometryError
from model.kinematics.surface import Surface, surface_of

TOLERANCE = 0.01
"""Largest gap that counts as touching, in the diagonal of all parts: scans and CAD leave gaps."""
RESOLUTIONS = 1.5
"""The same in a cloud's spacing, which limits its precision."""

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Contact:
    """Contact of two parts at rest; metres, object frame.

    Attributes:
        a, b: the links, in the order of the parts.
        distance: smallest distance between the two surfaces.
        tolerance: largest gap that counts as touching.
        points: (K, 3) midpoints between samples of either part and the other part's surface, where
            that is within the tolerance.
        share_a, share_b: share of each part's surface in contact, 0..1.
    """

    a: str
    b: str
    distance: float
    tolerance: float
    points: FloatArray
    share_a: float
    share_b: float

    @property
    def touches(self) -> bool:
        """True if the gap is within the tolerance."""
        return bool(self.distance <= self.tolerance)

    @property
    def centroid(self) -> FloatArray:
        """(3,) mean of the contact points.

        Raises:
            GeometryError: where the parts don't touch.
        """
        self._require()
        return self.points.mean(axis=0)

    @property
    def line(self) -> ContactLine:
        """The line through the contact points.

        Raises:
            GeometryError: where the parts don't touch.
        """
        self._require()
        centred = self.points - self.centroid
        values, vectors = np.linalg.eigh(centred.T @ centred / len(centred))
        values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
        direction = vectors[:, 0] * np.sign(vectors[np.argmax(np.abs(vectors[:, 0])), 0])
        along = centred @ direction
        linearity = 1.0 - float(values[1] / values[0]) if values[0] > 0 else 0.0
        return ContactLine(self.centroid, direction, float(np.ptp(along)), linearity)

    def _require(self) -> None:
        if not len(self.points):
            raise GeometryError(f"{self.a!r} and {self.b!r} don't touch, so they have no contact")


@dataclass(frozen=True, eq=False)
class ContactLine:
    """The line that fits a contact best.

    Attributes:
        point: (3,) the contact's centroid.
        direction: (3,) unit; its largest component is positive.
        length: extent of the contact along it, metres.
        linearity: 1 for points on a line, 0 for a disc or a ball.
    """

    point: FloatArray
    direction: FloatArray
    length: float
    linearity: float


def contact_tolerance(parts: Iterable[Part]) -> float:
    """:data:`TOLERANCE` of the parts' diagonal in metres, or more for a sparse cloud."""
    surfaces = [s for p in parts if (s := surface_of(p)) is not None]
    if not surfaces:
        return 0.0
    bounds = np.stack([s.bounds for s in surfaces])
    diagonal = float(np.linalg.norm(bounds[:, 1].max(0) - bounds[:, 0].min(0)))
    return max(TOLERANCE * diagonal, RESOLUTIONS * max(s.resolution for s in surfaces))


def contact_between(a: Part, b: Part, tolerance: float | None = None) -> Contact:
    """Compute the contact of two parts.

    Args:
        tolerance: metres; by default :func:`contact_tolerance` of the two. Pass that of the whole
            object for small parts.

    Raises:
        GeometryError: for a part without geometry.
    """
    if tolerance is None:
        tolerance = contact_tolerance((a, b))
    first, second = surface_of(a), surface_of(b)
    for part, surface in ((a, first), (b, second)):
        if surface is None:
            raise GeometryError(f"part {part.link!r} has no face and no point")
    assert first is not None and second is not None
    return _contact(first, second, tolerance, exact=True)


def contacts(parts: Sequence[Part], tolerance: float | None = None) -> tuple[Contact, ...]:
    """Compute the contacts of all pairs of parts that touch, in the order of the parts."""
    if tolerance is None:
        tolerance = contact_tolerance(parts)
    surfaces = [s for p in parts if (s := surface_of(p)) is not None]
    found = (_contact(a, b, tolerance, exact=False) for a, b in combinations(surfaces, 2))
    return tuple(c for c in found if c.touches)


def _contact(a: Surface, b: Surface, tolerance: float, *, exact: bool) -> Contact:
    """``exact`` also measures the distance of parts that are far apart."""
    gap = np.maximum(np.maximum(a.bounds[0] - b.bounds[1], b.bounds[0] - a.bounds[1]), 0.0)
    apart = float(np.linalg.norm(gap)) > tolerance
    if apart and not exact:
        return Contact(a.link, b.link, np.inf, tolerance, np.zeros((0, 3)), 0.0, 0.0)
    places: list[FloatArray] = []
    shares: list[float] = []
    smallest = np.inf
    for one, other in ((a, b), (b, a)):
        low, high = other.bounds[0] - tolerance, other.bounds[1] + tolerance
        near = one.points[((one.points >= low) & (one.points <= high)).all(axis=1)]
        candidates = one.points if apart else near
        if len(candidates):
            distance, closest = other.distance(candidates)
            smallest = min(smallest, float(distance.min()))
            touching = distance <= tolerance
            places.append((candidates[touching] + closest[touching]) / 2)
            shares.append(float(touching.sum()) / len(one.points))
        else:
            shares.append(0.0)
    if not np.isfinite(smallest):  # boxes overlap, but without samples of one in the other
        smallest = float(b.distance(a.points)[0].min())
    points = np.concatenate([*places, np.zeros((0, 3))])
    return Contact(a.link, b.link, smallest, tolerance, points, shares[0], shares[1])
