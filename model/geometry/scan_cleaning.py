"""Mending raw scans: stray points, the floor and the walls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from model.errors import GeometryError
from model.geometry.display import thin
from model.geometry.point_cloud import PointCloud

Array = npt.NDArray[Any]


def remove_outliers(
    cloud: PointCloud, *, neighbours: int = 16, ratio: float = 4.0
) -> tuple[PointCloud, npt.NDArray[np.int64]]:
    """Without stray points: those far lonelier than usual.

    Args:
        cloud: the scan.
        neighbours: how many are looked at.
        ratio: a point is stray where its mean distance to its neighbours exceeds the median by
            more than this many times the median absolute deviation (times 1.4826), and is twice
            the median at least, so that an even cloud loses nothing.

    Returns:
        The cloud that is left, and the indices that were kept.
    """
    from scipy.spatial import KDTree

    if len(cloud) <= neighbours:
        return cloud, np.arange(len(cloud))
    distance = KDTree(cloud.points).query(cloud.points, k=neighbours + 1)[0][:, 1:].mean(axis=1)
    middle = float(np.median(distance))
    spread = 1.4826 * float(np.median(np.abs(distance - middle)))
    kept = np.flatnonzero(distance <= max(middle + ratio * spread, 2.0 * middle))
    return cloud.take(kept), kept


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane found in a cloud: the points p with normal · p = offset.

    Attributes:
        normal: (3,) unit; up for a floor.
        offset: metres.
        members: (K,) indices of its points.
    """

    normal: npt.NDArray[np.float64]
    offset: float
    members: npt.NDArray[np.int64]

    @property
    def is_horizontal(self) -> bool:
        """Within 10 degrees of level: a floor, a ceiling, a table top."""
        return abs(float(self.normal[2])) > np.cos(np.radians(10.0))


def find_planes(
    cloud: PointCloud,
    rng: np.random.Generator,
    *,
    tolerance: float = 0.02,
    smallest: float = 0.05,
    most: int = 6,
    trials: int = 300,
) -> tuple[Plane, ...]:
    """The largest planes, largest first, by RANSAC (Fischler and Bolles, 1981).

    Args:
        cloud: the scan.
        rng: draws the trials.
        tolerance: metres that a point may be off its plane.
        smallest: share of all points that a plane needs.
        most: stop after so many.
        trials: triples drawn for each plane.

    Raises:
        GeometryError: where there are fewer than three points.
    """
    points = cloud.points.astype(np.float64)
    if len(points) < 3:
        raise GeometryError(f"{len(points)} points hold no plane; at least 3 are needed")
    sample = points[thin(cloud.points, 20_000)]
    left = np.ones(len(points), bool)
    out: list[Plane] = []
    while len(out) < most and len(sample) >= 3:
        found = _best_plane(sample, rng, tolerance, trials)
        if found is None:
            break
        normal, offset = found
        off = np.abs(points @ normal - offset)
        members = np.flatnonzero(left & (off <= tolerance))
        if len(members) < smallest * len(points):
            break
        left[members] = False
        sample = sample[np.abs(sample @ normal - offset) > tolerance]
        if normal[2] < 0:
            normal, offset = -normal, -offset
        out.append(Plane(normal, float(offset), members))
    return tuple(out)


def _best_plane(
    sample: Array, rng: np.random.Generator, tolerance: float, trials: int
) -> tuple[Array, float] | None:
    triple = sample[rng.integers(0, len(sample), (trials, 3))]
    normal = np.cross(triple[:, 1] - triple[:, 0], triple[:, 2] - triple[:, 0])
    length = np.linalg.norm(normal, axis=1)
    good = length > 1e-12
    if not good.any():
        return None
    normal = normal[good] / length[good, None]
    offset = np.einsum("ij,ij->i", normal, triple[good, 0])
    score = [
        (np.abs(sample @ n - o) <= tolerance).sum() for n, o in zip(normal, offset, strict=True)
    ]
    best = int(np.argmax(score))
    near = sample[np.abs(sample @ normal[best] - offset[best]) <= tolerance]
    # The plane of least squares through all of them.
    middle = near.mean(axis=0)
    fitted = np.linalg.svd(near - middle, full_matrices=False)[2][-1]
    return fitted, float(fitted @ middle)
