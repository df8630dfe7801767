"""Circles in the outline of a part, and extents that outliers don't spoil."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

ROUND = 0.055
"""Largest spread of the outline's radius over its mean that still counts as a circle (a hexagon
has 0.047, a square 0.11)."""


@dataclass(frozen=True, eq=False)
class Roundness:
    """How well the outline seen along ``axis`` is a circle.

    Attributes:
        axis: (3,) unit. center: (3,) on the axis, at the part's middle. radius: of the circle.
        spread: standard deviation of the outline's radius over its mean; 0 is a circle.
        half: half of the part's extent along the axis.
    """

    axis: Array
    center: Array
    radius: float
    spread: float
    half: float

    @property
    def round(self) -> bool:
        """Whether it counts as a circle."""
        return self.spread < ROUND


def extent(points: Array, scanned: bool) -> Array:
    """(2, D) lowest and highest values; of clouds without the outermost 0.4 %."""
    if scanned and len(points) >= 200:
        return np.quantile(points, [0.004, 0.996], axis=0)
    return np.stack([points.min(0), points.max(0)])


def roundness(points: Array, axis: Array, scanned: bool, noise: float = 0.0) -> Roundness | None:
    """Fit a circle to the convex outline of ``points`` seen along ``axis``.

    What the noise alone would make of a circle is taken off the spread.
    """
    from scipy.spatial import ConvexHull, QhullError

    u = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    flat = points @ np.stack([u, v], 1)
    if len(flat) < 4:
        return None
    if scanned and len(flat) >= 50:
        middle = np.median(flat, axis=0)
        r = np.linalg.norm(flat - middle, axis=1)
        flat = flat[r <= np.quantile(r, 0.985)]
    try:
        hull = np.asarray(flat[ConvexHull(flat).vertices], np.float64)
    except (QhullError, ValueError):
        return None
    ring = _resampled(hull, 96)
    scale = float(np.ptp(ring, axis=0).max())
    if scale < 1e-9:
        return None
    a = np.column_stack([2 * ring, np.ones(len(ring))])
    solution, *_ = np.linalg.lstsq(a, (ring**2).sum(1), rcond=None)
    middle = solution[:2]
    radii = np.linalg.norm(ring - middle, axis=1)
    along = points @ axis
    low, high = extent(along[:, None], scanned)[:, 0]
    center = middle[0] * u + middle[1] * v + axis * (low + high) / 2
    mean = float(radii.mean())
    spread = np.sqrt(max(0.0, float(radii.std()) ** 2 - (1.2 * noise) ** 2))
    if mean > 0.65 * scale:
        spread = mean  # a sliver lies well on a huge circle; that isn't round
    return Roundness(axis, center, mean, float(spread / mean), float(high - low) / 2)


def _resampled(polygon: Array, count: int) -> Array:
    """Evenly spaced points along a closed polygon."""
    closed = np.vstack([polygon, polygon[:1]])
    step = np.linalg.norm(np.diff(closed, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(step)])
    at = np.linspace(0.0, along[-1], count, endpoint=False)
    return np.stack([np.interp(at, along, closed[:, i]) for i in range(2)], 1)
