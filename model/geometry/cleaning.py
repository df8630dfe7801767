"""Clean a scan: outliers, noise, and the classes of a levelled one.

Outliers lie on no surface: a depth camera leaves points in the air, and between near and far
surfaces. They would connect separate surfaces, enlarge an object's box, and catch clicks on
surfaces behind them.

Noise: reconstructions from photos or LiDAR see a surface several times, a little apart. Their
points are then farther from the surface than from each other, and normals and creases drown in
that. Points move onto the planes of their neighbourhoods.

Classes are object, support, neighbours and outliers. Everything is counted on one dense grid, so
that five million points take a second or two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import label
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, KDTree, QhullError

_NEIGHBOR, _FAR = 6, 4.5
"""A point this many times as far from its n-th neighbour as the median may be an outlier,"""
_LINK, _GROUP = 10.0, 20
"""unless it is in a group of more points, connected by this many median distances,"""
_ALIKE, _AROUND, _FLAT = 2.0, 10, 0.03
"""or its neighbours but one are at most this many times as dense, and so many of them are planar up
to this share of their variance: a surface that was scanned at a slant, or from afar."""
_MOST_SHARE = 0.1
"""Largest share of outliers: a cloud with more has no typical distance."""
_SAMPLE = 2000

Points = npt.NDArray[np.floating]
Indices = npt.NDArray[np.integer]
Bool = npt.NDArray[np.bool_]


def outlier_points(points: Points, tree: KDTree) -> npt.NDArray[np.int64]:
    """Return (S,) ascending indices of the outliers of (N, 3) points, of which is ``tree``."""
    none = np.zeros(0, np.int64)
    if len(points) <= _GROUP:
        return none
    apart = _apart(tree, points, workers=2)
    typical = float(np.median(apart))
    at = np.flatnonzero(apart > _FAR * typical)
    if not typical or not 0 < len(at) <= _MOST_SHARE * len(points):
        return none
    return at[_isolated(points[at], _LINK * typical) & ~sparse_surface(points, tree, at)]


class OutlierTest:
    """Tests single points of a cloud, without computing all outliers."""

    def __init__(self, points: Points, tree: KDTree) -> None:
        self._points, self._tree = points, tree
        self._far = np.inf
        if len(points) > _GROUP:
            apart = _apart(tree, points[:: max(len(points) // _SAMPLE, 1)])
            far = _FAR * float(np.median(apart))
            if far and (apart > far).mean() <= _MOST_SHARE:
                self._far = far

    def is_outlier(self, index: int) -> bool:
        """True if a point is an outlier; points of small groups may not be recognised."""
        at = np.array([index])
        if _apart(self._tree, self._points[at])[0] <= self._far:
            return False
        return not sparse_surface(self._points, self._tree, at)[0]


def _apart(tree: KDTree, points: Points, workers: int = 1) -> npt.NDArray[np.float64]:
    """(K,) metres from each of ``points`` (K, 3) to its n-th neighbour."""
    distance, _ = tree.query(points, k=_NEIGHBOR + 1, workers=workers)
    return np.asarray(distance)[:, -1]


def _isolated(points: Points, reach: float) -> Bool:
    """(K,) whether ``points`` (K, 3) are in small groups connected by at most ``reach``."""
    pairs = KDTree(points).query_pairs(reach, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs), bool), pairs.T), shape=(len(points), len(points)))
    _, group = connected_components(links, directed=False)
    return np.bincount(group)[group] <= _GROUP


def sparse_surface(points: Points, tree: KDTree, at: Indices) -> Bool:
    """(K,) whether points ``at`` (K,) have equally sparse neighbours on a plane."""
    distance, near = tree.query(points[at], k=min(_AROUND + 1, len(points)))
    near = np.asarray(near)  # includes the point itself
    apart = np.asarray(distance)[:, _NEIGHBOR]
    neighbor = near[:, 1 : _NEIGHBOR + 1]
    others = _apart(tree, points[neighbor.ravel()]).reshape(neighbor.shape)
    # Except for one, which may lie on a denser surface.
    alike = apart < _ALIKE * np.sort(others, axis=1)[:, 1]
    offset = points[near].astype(np.float64)
    offset -= offset.mean(1, keepdims=True)
    spread = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", offset, offset))
    return alike & (spread[:, 0] < _FLAT * spread.sum(1))


NEIGHBORS, NOISE_NEIGHBORS = 16, 12
NOISY = 0.32
"""Noise level above which points are as far from their surface as from each other. Simulated depth
cameras give up to 0.29, reconstructions from many views 0.33 and more."""
_PASSES = 2
_CHUNK = 20_000

Float32 = npt.NDArray[np.float32]


def noise_level(points: Float32, tree: KDTree | None = None) -> float:
    """Median distance of points from the planes of their neighbourhoods, in spacings.

    Args:
        points: (N, 3) any unit. tree: over ``points``, if there is one.
    """
    if len(points) <= NOISE_NEIGHBORS:
        return 0.0
    tree = tree or KDTree(points)
    some = points[:: max(len(points) // _SAMPLE, 1)]
    distance, near = tree.query(some, k=NOISE_NEIGHBORS)
    mean, normal = _planes(points, np.asarray(near), np.asarray(distance))
    spread = np.abs(np.einsum("nki,ni->nk", points[near] - mean[:, None], normal)).mean(1)
    spacing = np.asarray(distance)[:, 1:5].mean(1)
    return float(np.median(spread / np.maximum(spacing, 1e-12)))


def denoised(points: Float32, tree: KDTree | None = None, passes: int = _PASSES) -> Float32:
    """(N, 3) points moved along the normals of their neighbourhoods onto their planes.

    Each plane is fitted to the :data:`NEIGHBORS` nearest points, weighted by nearness. Rounds edges
    by about that radius, so it is for noisy scans alone: see :func:`noise_level`.
    """
    if len(points) <= NEIGHBORS:
        return points
    distance, near = (tree or KDTree(points)).query(points, k=NEIGHBORS, workers=2)
    near, distance = np.asarray(near), np.asarray(distance)
    out = points
    for _ in range(passes):
        moved = np.empty_like(points)
        for begin in range(0, len(points), _CHUNK):
            rows = slice(begin, begin + _CHUNK)
            mean, normal = _planes(out, near[rows], distance[rows])
            off = np.einsum("ni,ni->n", out[rows] - mean, normal)
            moved[rows] = out[rows] - off[:, None] * normal
        out = moved
    return out


def _planes(points: Float32, near: npt.NDArray, distance: npt.NDArray) -> tuple[Float32, Float32]:
    """(N, 3) weighted means of the neighbours and (N, 3) unit normals of their planes."""
    reach = np.maximum(distance[:, -1:], 1e-12)
    weight = np.exp(-2 * (distance / reach) ** 2).astype(np.float32)
    weight /= weight.sum(1, keepdims=True)
    local = points[near]
    mean = np.einsum("nk,nki->ni", weight, local)
    local = local - mean[:, None]
    covariance = np.matmul((local * weight[..., None]).transpose(0, 2, 1), local)
    _, vectors = np.linalg.eigh(covariance.astype(np.float64))
    return mean, vectors[:, :, 0].astype(np.float32)


Index = npt.NDArray[np.int64]
Kinds = npt.NDArray[np.int8]

OBJECT, SUPPORT, CLUTTER, OUTLIER = range(4)
"""Kinds of points: the object, what it stands on, other things, and points on no surface."""
KIND_NAMES = ("object", "support", "clutter", "outlier")

CELLS = 160
"""Most cells along the scan's longest side."""
_CELL_NEIGHBOR, _SPARSE = 6, 90
"""Cells are as large as the distance to the n-th neighbour at this percentile: three points share a
cell of an even surface, and where it is sampled a tenth as densely, its cells still touch."""
_OUTLIER_SHARE = 0.002
"""A connected piece with fewer points than this share of the scan is no surface."""
_BORDER = 0.1
"""Margin of the grid round all but the outermost points, in their longest side: points beyond it
share the cells of the grid's edge, which must not touch the object."""
_MOST_POINTS = 1_000_000
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
    every = max(len(points) // _MOST_POINTS, 1)
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
    """Cells over all but the outermost points and a margin; points beyond fall into its edge."""
    sample = points[:: max(len(points) // 100_000, 1)]
    low, high = np.percentile(sample, [0.1, 99.9], axis=0).astype(np.float64)
    longest = max(float((high - low).max()), 1e-12)
    size = min(max(longest / CELLS, connecting_distance(points)), longest / 16)
    low = np.maximum(low - _BORDER * longest, points.min(0))
    high = np.minimum(high + _BORDER * longest, points.max(0))
    shape = tuple(int(n) + 3 for n in np.ceil((high - low) / size))
    at = np.floor((points - low) / size).astype(np.int64) + 1
    at = np.clip(at, 0, np.array(shape) - 1)
    cell = (at[:, 0] * shape[1] + at[:, 1]) * shape[2] + at[:, 2]
    return _Grid(cell, (shape[0], shape[1], shape[2]), size, low)


def connecting_distance(points: Points) -> float:
    """Distance over which (N, 3) points of a surface hang together, even where it is sampled
    sparsely; repeated points and a few outliers don't count. 0 for a few points.
    """
    some = points[:: max(len(points) // _MOST_POINTS, 1)].astype(np.float64)
    width = float(np.ptp(np.percentile(some, [1, 99], axis=0), axis=0).max())
    key = np.floor((some - some.min(0)) / max(width * 1e-4, 1e-12)).astype(np.int64)
    some = some[np.unique(key @ [1, 1 << 20, 1 << 40], return_index=True)[1]]
    if len(some) <= _CELL_NEIGHBOR:
        return 0.0
    chosen = some[:: max(len(some) // 5000, 1)]
    distance, _ = KDTree(some, balanced_tree=False).query(chosen, k=_CELL_NEIGHBOR + 1)
    return float(np.percentile(distance[:, -1], _SPARSE))


def _thickness(height: Points, support: float, cell: float) -> float:
    """Height up to which the supporting surface's points scatter above it, metres."""
    near = np.abs(height - support)
    near = near[near < 2 * cell]
    if not len(near):
        return cell
    return float(np.clip(4.5 * np.median(near), 0.25 * cell, 1.5 * cell))
