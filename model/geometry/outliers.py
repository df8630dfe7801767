"""Points of a scan that float alone: they lie on no surface.

A depth camera leaves points in the air and between what is near and what is far. They would join
surfaces that don't touch, push an object's box outwards, and catch clicks that mean what is behind.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

_NEIGHBOR, _FAR = 6, 4.5
"""A point that is that many times as far from its n-th neighbour as most may be stray."""
_LINK, _GROUP = 10.0, 20
"""Unless it is one of more than so many, that many usual distances apart,"""
_ALIKE, _AROUND, _FLAT = 2.0, 10, 0.03
"""or all neighbours but one lie no more than so many times as near to theirs, and so many on a
plane but for that share of their spread: a surface that was seen at a slant, or from afar."""
_MOST = 0.1
"""Of all points: a cloud with more has no usual distance."""
_SAMPLE = 2000

Points = npt.NDArray[np.floating]
Index = npt.NDArray[np.integer]
Bool = npt.NDArray[np.bool_]


def stray_points(points: Points, tree: KDTree) -> npt.NDArray[np.int64]:
    """(S,) ascending, the points (N, 3) that lie on no surface; ``tree`` is over all of them."""
    none = np.zeros(0, np.int64)
    if len(points) <= _GROUP:
        return none
    apart = _apart(tree, points, workers=2)
    usual = float(np.median(apart))
    at = np.flatnonzero(apart > _FAR * usual)
    if not usual or not 0 < len(at) <= _MOST * len(points):
        return none
    return at[_alone(points[at], _LINK * usual) & ~_sparse_surface(points, tree, at)]


class Strays:
    """Asks a cloud about single points, without looking at all of them."""

    def __init__(self, points: Points, tree: KDTree) -> None:
        self._points, self._tree = points, tree
        self._far = np.inf
        if len(points) > _GROUP:
            apart = _apart(tree, points[:: max(len(points) // _SAMPLE, 1)])
            far = _FAR * float(np.median(apart))
            if far and (apart > far).mean() <= _MOST:
                self._far = far

    def holds(self, index: int) -> bool:
        """Whether a point lies on no surface; of small groups some may pass for one."""
        at = np.array([index])
        if _apart(self._tree, self._points[at])[0] <= self._far:
            return False
        return not _sparse_surface(self._points, self._tree, at)[0]


def _apart(tree: KDTree, points: Points, workers: int = 1) -> npt.NDArray[np.float64]:
    """(K,) metres from each of ``points`` (K, 3) to its n-th neighbour."""
    distance, _ = tree.query(points, k=_NEIGHBOR + 1, workers=workers)
    return np.asarray(distance)[:, -1]


def _alone(points: Points, reach: float) -> Bool:
    """(K,) whether few of ``points`` (K, 3) hang together, by steps of at most ``reach``."""
    pairs = KDTree(points).query_pairs(reach, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs), bool), pairs.T), shape=(len(points), len(points)))
    _, group = connected_components(links, directed=False)
    return np.bincount(group)[group] <= _GROUP


def _sparse_surface(points: Points, tree: KDTree, at: Index) -> Bool:
    """(K,) whether the points ``at`` (K,) lie among others that are as far apart, on a plane."""
    distance, near = tree.query(points[at], k=min(_AROUND + 1, len(points)))
    near = np.asarray(near)  # with the point itself
    apart = np.asarray(distance)[:, _NEIGHBOR]
    neighbor = near[:, 1 : _NEIGHBOR + 1]
    others = _apart(tree, points[neighbor.ravel()]).reshape(neighbor.shape)
    # But for one, which may lie on a denser surface.
    alike = apart < _ALIKE * np.sort(others, axis=1)[:, 1]
    offset = points[near].astype(np.float64)
    offset -= offset.mean(1, keepdims=True)
    spread = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", offset, offset))
    return alike & (spread[:, 0] < _FLAT * spread.sum(1))
