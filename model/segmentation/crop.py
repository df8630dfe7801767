"""Cutting an object out of a scan: floor, walls and outliers go, the rest stays."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from model.errors import GeometryError
from model.geometry.asset import Asset

Bool = npt.NDArray[np.bool_]

_SAMPLE = 40_000
_TRIALS = 400


def outliers(asset: Asset, neighbors: int = 12, deviations: float = 4.0) -> Bool:
    """(E,) elements that float far from the rest.

    Those whose mean distance to their ``neighbors`` is more than ``deviations`` robust standard
    deviations above the median.
    """
    centers = asset.element_centers
    if len(centers) <= neighbors:
        return np.zeros(len(centers), bool)
    distance, _ = KDTree(centers).query(centers, k=neighbors + 1, workers=2)
    mean = distance[:, 1:].mean(1)
    middle = float(np.median(mean))
    spread = 1.4826 * float(np.median(np.abs(mean - middle))) + 0.1 * middle
    return mean > middle + deviations * spread


def floor_and_walls(asset: Asset, share: float = 0.05, thickness: float = 0.01) -> Bool:
    """(E,) elements on the floor, the ceiling and upright walls.

    A plane counts as one of them where it holds ``share`` of the elements, nearly everything
    else lies on one side of it, and it reaches out farther than the rest: the sides of a lone
    box are no walls.

    Args:
        share: of all elements.
        thickness: half the thickness of a plane in parts of the bounding box's diagonal.
    """
    centers = asset.element_centers
    out = np.zeros(len(centers), bool)
    if len(centers) < 50:
        return out
    rng = np.random.default_rng(0)
    step = max(len(centers) // _SAMPLE, 1)
    sample = centers[::step]
    band = thickness * max(asset.diagonal, 1e-9)
    left = np.ones(len(sample), bool)
    for _ in range(8):
        plane = _border_plane(sample, left, band, share, rng)
        if plane is None:
            break
        normal, offset = plane
        near = np.abs(centers @ normal - offset) < band
        out |= near
        left &= np.abs(sample @ normal - offset) >= band
    return out


def _border_plane(
    points: npt.NDArray[np.float64],
    left: Bool,
    band: float,
    share: float,
    rng: np.random.Generator,
) -> tuple[npt.NDArray[np.float64], float] | None:
    """The best supported level or upright plane with nearly everything on one side."""
    pool = np.nonzero(left)[0]
    if len(pool) < 3:
        return None
    best, answer = share * len(points), None
    for _ in range(_TRIALS):
        a, b, c = points[rng.choice(pool, 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = float(np.linalg.norm(normal))
        if length < 1e-12:
            continue
        normal /= length
        # Rooms have level floors and upright walls; a shelf's slope is no border.
        if abs(normal[2]) > 0.98:
            normal = np.array([0.0, 0.0, 1.0])
        elif abs(normal[2]) < 0.05:
            normal[2] = 0
            normal /= np.linalg.norm(normal)
        else:
            continue
        height = points[pool] @ normal - a @ normal
        near = np.abs(height) < band
        support = int(near.sum())
        if support <= best:
            continue
        all_heights = points @ normal - a @ normal
        outside = min(int((all_heights > band).sum()), int((all_heights < -band).sum()))
        if outside < 0.02 * len(points) and _reaches_out(points[pool], near, normal):
            best, answer = support, (normal, float((points[pool[near]] @ normal).mean()))
    return answer


def _reaches_out(
    points: npt.NDArray[np.float64], near: Bool, normal: npt.NDArray[np.float64]
) -> bool:
    """Whether the plane's points span 1.2 times what the rest spans, along one of its axes."""
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
        GeometryError: where nothing is kept.
    """
    keep = np.asarray(keep, bool)
    if keep.shape != (asset.element_count,) or not keep.any():
        raise GeometryError(
            f"{asset.name}: a crop needs a mask of {asset.element_count} elements that keeps some"
        )
    if asset.mesh is not None:
        return Asset(asset.name, mesh=asset.mesh.take_faces(keep), source=asset.source)
    assert asset.cloud is not None
    return Asset(asset.name, cloud=asset.cloud.take(keep), source=asset.source)
