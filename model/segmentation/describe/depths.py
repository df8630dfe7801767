"""Find the depth of the deepest point of masks: people click in the middle of what they mean."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from model.segmentation.arrays import Float, Int, Uint64
from model.segmentation.encode.nodes import voxel_keys

_FINENESS = (1.0, 2**0.5)
_FIRST = 2.0
"""Radius of the smallest balls, in distances between neighbours."""
_DENSE = 0.5
"""Distance between the centres of neighbouring balls, in radii."""
_LEAST = 8
_LARGEST = 0.5


class Depths:
    """Balls of doubling radii over points, each made of balls half as large.

    A ball lies in a mask if all its smaller balls do, so all masks are tested at once, a bit each.
    The two series of balls differ by the root of two. On real objects the true depth is mostly 0.6
    to 1.2 times the result, exact enough to tell a border from the middle.
    """

    def __init__(self, x: Float) -> None:
        """``x`` (C, 3): the points, the object's diagonal being 1."""
        number = len(x)
        self._series: list[list[tuple[float, Int, Int]]] = []
        if number < _LEAST:
            return
        apart, _ = KDTree(x).query(x, k=2)
        near = max(float(np.median(apart[:, 1])), 1e-3)
        for fineness in _FINENESS:
            radius, reach, middles = 0.0, _FIRST * near * fineness, x
            below = KDTree(x)
            levels: list[tuple[float, Int, Int]] = []
            while reach < _LARGEST and len(middles := _thinned(middles, _DENSE * reach)) >= _LEAST:
                here = KDTree(middles)
                held = here.sparse_distance_matrix(below, reach - radius, output_type="ndarray")
                order = np.argsort(held["i"], kind="stable")
                start = np.searchsorted(held["i"][order], np.arange(len(middles)))
                levels.append((reach, held["j"][order].astype(np.int32), start))
                below, radius, reach = here, reach, 2 * reach
            self._series.append(levels)

    def __call__(self, words: Uint64, number: int) -> Float:
        """(H,) radius of the largest ball in each mask, 0 if not even the smallest fits.

        Args:
            words: (C, W) the bits of the masks at each point.
            number: of masks.
        """
        out = np.zeros(number, np.float32)
        for levels in self._series:
            held = words
            for radius, members, start in levels:
                held = np.bitwise_and.reduceat(np.take(held, members, axis=0), start, axis=0)
                alive = np.bitwise_or.reduce(held, axis=0)
                if not alive.any():
                    break
                fits = np.unpackbits(alive.view(np.uint8))[:number] > 0
                out[fits] = np.maximum(out[fits], radius)
        return out


def _thinned(x: Float, side: float) -> Float:
    """One point of each voxel."""
    _, first = np.unique(voxel_keys(x, x.min(0), side), return_index=True)
    return x[np.sort(first)]
