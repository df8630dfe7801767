"""Outliers of a scan: points that lie on no surface.

A depth camera leaves points in the air, and between near and far surfaces. They would connect
separate surfaces, enlarge an object's box, and catch clicks on surfaces behind them.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

_NEIGHBOR, _FAR = 6, 4.5
"""A point this many times as far from its n-th neighbour as the median may be an outlier,"""
_LINK, _GROUP = 10.0, 20
"""unless it is in a group of more points, connected by this many median distances,"""
_ALIKE, _AROUND, _FLAT = 2.0, 10, 0.03
"""or its neighbours but one are at most this many times as dense, and so many of them are planar up
to this share of their variance: a surface that was scanned at a slant, or from afar."""
_MOST = 0.1
"""Largest share of outliers: a cloud with more has no typical distance."""
_SAMPLE = 2000

Points = npt.NDArray[np.floating]
Index = npt.NDArray[np.integer]
Bool = npt.NDArray[np.bool_]


def outlier_points(points: Points, tree: KDTree) -> npt.NDArray[np.int64]:
    """Return (S,) ascending indices of the outliers of (N, 3) points, of which is ``tree``."""
    none = np.zeros(0, np.int64)
    if len(points) <= _GROUP:
        return none
    apart = _apart(tree, points, workers=2)
    typical = float(np.median(apart))
    at = np.flatnonzero(apart > _FAR * typical)
    if not typical or not 0 < len(at) <= _MOST * len(points):
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
            if far and (apart > far).mean() <= _MOST:
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


def sparse_surface(points: Points, tree: KDTree, at: Index) -> Bool:
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
