"""Cut an object out of a scan: floor, walls and outliers go, the rest stays."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from model.core.asset import Asset
from model.core.errors import GeometryError
from model.geometry.cleaning import connecting_distance, sparse_surface

Bool = npt.NDArray[np.bool_]

ROOM_METRES = 2.5
"""A scan that is wider than this may be a room."""

MOST_THICKNESS = 0.06
"""Largest unevenness of a wall in metres."""
GAP = 0.06
"""Metres between points of a scan that still connect."""

_SAMPLE = 20_000
_PLANES = 8
_YAW_STEP = 3
_BEYOND = 0.04


def outliers(asset: Asset, neighbors: int = 12, deviations: float = 4.0) -> Bool:
    """(E,) elements whose mean distance to their ``neighbors`` is more than ``deviations`` robust
    standard deviations above the median, unless they are on a sparsely sampled surface.
    """
    centers = asset.element_centers
    out = np.zeros(len(centers), bool)
    if len(centers) <= neighbors:
        return out
    tree = KDTree(centers)
    distance, _ = tree.query(centers, k=neighbors + 1, workers=2)
    mean = distance[:, 1:].mean(1)
    middle = float(np.median(mean))
    spread = 1.4826 * float(np.median(np.abs(mean - middle))) + 0.1 * middle
    at = np.flatnonzero(mean > middle + deviations * spread)
    out[at] = ~sparse_surface(centers, tree, at)
    return out


def largest_component(points: npt.NDArray[np.floating], gap: float = GAP) -> Bool:
    """(N,) the points of a scan's largest connected component.

    Leaves out what a box around an object caught of the things before and behind it.

    Args:
        points: (N, 3) metres.
        gap: metres between points that still connect; sparse scans are connected over more.
    """
    if len(points) < 2:
        return np.ones(len(points), bool)
    gap = max(gap, 2 * connecting_distance(points))
    voxels = np.floor((points - points.min(0)) / (gap / 3)).astype(np.int64)
    _, of = np.unique(voxels, axis=0, return_inverse=True)
    of = of.ravel()
    held = np.bincount(of)
    centers = np.stack([np.bincount(of, x) for x in points.T], axis=1) / held[:, None]
    near = KDTree(centers).query_pairs(gap, output_type="ndarray")
    links = coo_matrix((np.ones(len(near), np.int8), near.T), shape=(len(held), len(held)))
    _, component = connected_components(links, directed=False)
    mine = component[of]
    return np.asarray(mine == np.bincount(mine).argmax())


def floor_and_walls(asset: Asset, share: float = 0.03, thickness: float = 0.01) -> Bool:
    """(E,) elements on the floor, the ceiling and upright walls.

    A horizontal or vertical plane is one of them if it holds ``share`` of the elements and nearly
    nothing lies beyond it. In scans narrower than a room it must also extend farther than the rest:
    the sides of a single box are no walls.

    Args:
        share: of all elements.
        thickness: half the thickness of a plane in diagonals of the bounding box, at most
            ``MOST_THICKNESS``; smoother planes take less.
    """
    centers = asset.element_centers
    out = np.zeros(len(centers), bool)
    if len(centers) < 50:
        return out
    sample = centers[:: max(len(centers) // _SAMPLE, 1)]
    band = min(thickness * max(asset.diagonal, 1e-9), MOST_THICKNESS)
    room = bool(np.ptp(sample[:, :2], axis=0).max() > ROOM_METRES)
    left = np.ones(len(sample), bool)
    for _ in range(_PLANES):
        plane = _border_plane(sample, left, band, share, room)
        if plane is None:
            break
        normal, offset = plane
        away = np.abs(sample[left] @ normal - offset)
        spread = 1.4826 * float(np.median(away[away < band]))
        half = float(np.clip(3.0 * spread, 0.3 * band, band))
        out |= np.abs(centers @ normal - offset) < half
        left &= np.abs(sample @ normal - offset) >= band
    return out


def _border_plane(
    points: npt.NDArray[np.float64], left: Bool, band: float, share: float, room: bool
) -> tuple[npt.NDArray[np.float64], float] | None:
    """The best supported horizontal or vertical plane with nearly nothing beyond it.

    Such normals are few enough to try them all.
    """
    if left.sum() < 3:
        return None
    yaw = np.radians(np.arange(0, 360, _YAW_STEP))
    normals = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=1)
    best, answer = share * len(points), None
    for normal in (np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0]), *normals):
        # Windows of two bands near the far end along the normal, and how many points are in each.
        heights = points @ normal
        last = max(0, int((1 - _BEYOND) * len(heights)) - 1)
        end = np.partition(heights, last)[last]
        order = heights[left & (heights >= end - 2 * band)]
        if len(order) <= best:
            continue
        order.sort()
        count = np.searchsorted(order, order + 2 * band) - np.arange(len(order))
        k = int(count.argmax())
        if count[k] <= best:
            continue
        inside = (order >= order[k]) & (order <= order[k] + 2 * band)
        offset = float(order[inside].mean())
        height = points[left] @ normal - offset
        if room or _reaches_out(points[left], np.abs(height) < band, normal):
            best, answer = float(count[k]), (normal, offset)
    return answer


def _reaches_out(
    points: npt.NDArray[np.float64], near: Bool, normal: npt.NDArray[np.float64]
) -> bool:
    """True if along one of its axes the plane spans more than 1.2 times what the rest spans."""
    if near.all():
        return True
    side = np.cross(normal, [0.0, 0.0, 1.0]) if abs(normal[2]) < 0.5 else np.array([1.0, 0, 0])
    for axis in (side / np.linalg.norm(side), np.cross(normal, side)):
        along = points @ axis
        low, high = np.percentile(along[near], [2, 98])
        rest_low, rest_high = np.percentile(along[~near], [2, 98])
        if high - low > 1.2 * (rest_high - rest_low):
            return True
    return False


def crop(asset: Asset, keep: Bool) -> Asset:
    """The asset with only the elements in ``keep``.

    Raises:
        GeometryError: if nothing is kept.
    """
    keep = np.asarray(keep, bool)
    if keep.shape != (asset.element_count,) or not keep.any():
        raise GeometryError(
            f"{asset.name}: a crop needs a mask of {asset.element_count} elements that keeps some"
        )
    if asset.mesh is not None:
        mesh = asset.mesh.take_faces(keep)
        return Asset(asset.name, mesh=mesh, source=asset.source, warnings=asset.warnings)
    assert asset.cloud is not None
    cloud = asset.cloud.take(keep)
    return Asset(asset.name, cloud=cloud, source=asset.source, warnings=asset.warnings)
