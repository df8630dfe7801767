"""Count how often a shape is repeated: keys, knobs and drawers seldom occur once.

Every region of the merge trees is described by its size and its spread along the axes; a mask's
repeats are similar regions elsewhere. Copies at another angle are missed.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from model.segmentation.arrays import Float
from model.segmentation.encode.hierarchy import Hierarchy
from model.segmentation.encode.superpoints import Superpoints

_LEAST_CELLS = 3
_MOST_SHARE = 0.35
_ALIKE = 0.18
_MOST = 40
_ORIGIN = 1 << 20
"""Added to places, in radii, to make them positive: 21 bits hold each coordinate."""


class Repeats:
    """Looks up the regions of an object's merge trees by shape."""

    def __init__(self, superpoints: Superpoints, hierarchy: Hierarchy, x: Float) -> None:
        """``x`` (C, 3): centres of the superpoints, the object's diagonal being 1."""
        labels, offset = hierarchy.labels, hierarchy.offset
        flat = (labels + offset[:-1, None]).ravel()
        number, levels = int(offset[-1]), len(labels)
        cell_count = np.bincount(flat, minlength=number)
        share = superpoints.size / superpoints.size.sum()
        moments = np.concatenate([np.ones((len(x), 1)), x, x**2], axis=1) * share[:, None]
        sums = np.stack([np.bincount(flat, np.tile(m, levels), number) for m in moments.T], axis=1)
        keep = (cell_count >= _LEAST_CELLS) & (sums[:, 0] <= _MOST_SHARE)
        # A region that outlives several levels is one region.
        keys = np.round(sums[keep] * 1e7).astype(np.int64)
        _, first = np.unique(keys, axis=0, return_index=True)
        shape, self._center = _shape(np.asarray(sums, np.float64)[keep][first])
        self._tree = KDTree(shape) if len(shape) else None

    def __call__(self, sums: Float) -> Float:
        """(H,) log of 1 + the number of similar regions elsewhere.

        Args:
            sums: (H, 7) share of the surface, and its first and second moments about the origin.
        """
        out = np.zeros(len(sums), np.float32)
        if self._tree is None:
            return out
        wanted = np.nonzero((sums[:, 0] > 0) & (sums[:, 0] <= _MOST_SHARE))[0]
        shape, center = _shape(sums[wanted].astype(np.float64))
        found = self._tree.query_ball_point(shape, _ALIKE)
        for row, hits in enumerate(found):
            if len(hits) < 2:
                continue
            radius = np.exp(shape[row, 1:]).max() * 2
            apart = self._center[hits] - center[row]
            other = np.abs(apart).max(1) > radius
            places = np.round(apart[other] / radius).astype(np.int64) + _ORIGIN
            keys = (places[:, 0] << 42) | (places[:, 1] << 21) | places[:, 2]
            out[wanted[row]] = np.log1p(min(len(set(keys.tolist())), _MOST))
        return out


def _shape(sums: Float) -> tuple[Float, Float]:
    """(H, 4) log of the root of the area and of the spread along each axis; (H, 3) centres."""
    area = np.maximum(sums[:, :1], 1e-12)
    center = sums[:, 1:4] / area
    spread = np.sqrt(np.maximum(sums[:, 4:7] / area - center**2, 0)) + 0.15 * np.sqrt(area) + 2e-3
    return np.log(np.concatenate([np.sqrt(area), spread], axis=1)), center
