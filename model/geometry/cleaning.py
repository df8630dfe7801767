"""Classify a levelled scan into object, support, neighbours and outliers.

Everything is counted on one dense grid, so that five million points take a second or two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import label
from scipy.spatial import ConvexHull, KDTree, QhullError

Points = npt.NDArray[np.floating]
Index = npt.NDArray[np.int64]
Kinds = npt.NDArray[np.int8]

OBJECT, SUPPORT, CLUTTER, OUTLIER = range(4)
"""Kinds of points: the object, what it stands on, other things, and points on no surface."""
KIND_NAMES = ("object", "support", "clutter", "outlier")

CELLS = 160
"""Most cells along the scan's longest side."""
_NEIGHBOR, _SPARSE = 6, 90
"""Cells are as large as the distance to the n-th neighbour at this percentile: three points share a
cell of an even surface, and where it is sampled a tenth as densely, its cells still touch."""
_OUTLIER_SHARE = 0.002
"""A connected piece with fewer points than this share of the scan is no surface."""
_MOST = 1_000_000
"""Points that outlines are measured on, against the time."""
_BESIDE = 0.02
"""Most that a piece of the object may stand out of the object's outline, in its width."""


@dataclass(frozen=True, eq=False)
class _Grid:
    """Points in cubic cells.

    Attributes:
        cell: (N,) flat index of each point's cell.
        shape: cells along x, y, z.
        size: of a cell.
        low: (3,) corner.
    """

    cell: Index
    shape: tuple[int, int, int]
    size: float
    low: npt.NDArray[np.float64]

    def pieces(self, chosen: npt.NDArray[np.bool_]) -> npt.NDArray[np.int32]:
        """(N,) connected piece of each chosen point, from 1 on; 0 for the others."""
        filled = np.zeros(self.shape, bool)
        filled.ravel()[self.cell[chosen]] = True
        labels = np.zeros(self.shape, np.int32)
        label(filled, np.ones((3, 3, 3)), output=labels)
        return np.where(chosen, labels.ravel()[self.cell], 0)


def classify(points: Points, support: float | None = None) -> Kinds:
    """(N,) int8 kind of each point of a scan.

    Args:
        points: (N, 3) levelled, +z up, any unit.
        support: height of the surface that the object stands on, or None.
    """
    kinds = np.full(len(points), OUTLIER, np.int8)
    finite = np.isfinite(points).all(1)
    if finite.sum() < 10:
        return kinds
    inside = np.flatnonzero(finite)
    kinds[inside] = _classified(points[inside], support)
    return kinds


def _classified(points: Points, support: float | None) -> Kinds:
    grid = _grid(points)
    kinds = np.full(len(points), OBJECT, np.int8)
    above = np.ones(len(points), bool)
    if support is not None:
        band = _thickness(points[:, 2], support, grid.size)
        kinds[points[:, 2] < support + band] = SUPPORT
        above = points[:, 2] >= support + band
    piece = grid.pieces(above)
    count = np.bincount(piece, minlength=2)
    count[0] = 0
    small = count < max(_OUTLIER_SHARE * len(points), min(20, 0.01 * len(points)))
    kinds[above & small[piece]] = OUTLIER
    large = np.flatnonzero(~small)
    large = large[large > 0]
    if len(large) < 2 or support is None:  # without a table nothing tells neighbours from parts
        return kinds
    kinds[np.isin(piece, large)] = CLUTTER
    kinds[np.isin(piece, _belonging(points, piece, count, large))] = OBJECT
    return kinds


def _belonging(points: Points, piece: npt.NDArray[np.int32], count: Index, large: Index) -> Index:
    """The main piece and those within its outline, seen from above."""
    every = max(len(points) // _MOST, 1)
    points, piece = points[::every], piece[::every]
    low, high = np.percentile(points[np.isin(piece, large)][:, :2], [1, 99], axis=0)
    # People scan around the object: the middle of all points is near it, whatever stands beside it.
    middle, width = np.median(points[:, :2], axis=0), float(np.linalg.norm(high - low))
    centers = np.stack([points[piece == k][:, :2].mean(0) for k in large])
    central = np.exp(-np.linalg.norm(centers - middle, axis=1) / max(0.5 * width, 1e-12))
    main = large[(count[large] * central).argmax()]
    try:
        outline = ConvexHull(points[piece == main][:, :2])
    except (QhullError, ValueError):
        return large
    limit = _BESIDE * float(np.sqrt(outline.volume))
    outside = outline.equations[:, :2] @ centers.T + outline.equations[:, 2:]
    return large[(outside.max(0) < limit) | (large == main)]


def _grid(points: Points) -> _Grid:
    """Cells over all but the outermost points, which fall into the border's cells."""
    sample = points[:: max(len(points) // 100_000, 1)]
    low, high = np.percentile(sample, [0.1, 99.9], axis=0).astype(np.float64)
    longest = max(float((high - low).max()), 1e-12)
    size = min(max(longest / CELLS, connecting_distance(points)), longest / 16)
    shape = tuple(int(n) + 3 for n in np.ceil((high - low) / size))
    at = np.floor((points - low) / size).astype(np.int64) + 1
    at = np.clip(at, 0, np.array(shape) - 1)
    cell = (at[:, 0] * shape[1] + at[:, 1]) * shape[2] + at[:, 2]
    return _Grid(cell, (shape[0], shape[1], shape[2]), size, low)


def connecting_distance(points: Points) -> float:
    """Distance over which (N, 3) points of a surface hang together, even where it is sampled
    sparsely; repeated points and a few outliers don't count. 0 for a few points.
    """
    some = points[:: max(len(points) // _MOST, 1)].astype(np.float64)
    width = float(np.ptp(np.percentile(some, [1, 99], axis=0), axis=0).max())
    key = np.floor((some - some.min(0)) / max(width * 1e-4, 1e-12)).astype(np.int64)
    some = some[np.unique(key @ [1, 1 << 20, 1 << 40], return_index=True)[1]]
    if len(some) <= _NEIGHBOR:
        return 0.0
    chosen = some[:: max(len(some) // 5000, 1)]
    distance, _ = KDTree(some, balanced_tree=False).query(chosen, k=_NEIGHBOR + 1)
    return float(np.percentile(distance[:, -1], _SPARSE))


def _thickness(height: Points, support: float, cell: float) -> float:
    """Height up to which the supporting surface's points scatter above it, metres."""
    near = np.abs(height - support)
    near = near[near < 2 * cell]
    if not len(near):
        return cell
    return float(np.clip(4.5 * np.median(near), 0.25 * cell, 1.5 * cell))
