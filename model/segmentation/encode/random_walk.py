"""Encode, step 6: random walks on the superpoints as Green's functions, factorised once.

With the grounded Laplacian ``K = L + leak * I``, the field that takes the values y at the seeds
and otherwise follows the graph is ``mu + G_s (G_ss)^-1 (y - mu_s)`` with ``G = K^-1``: a new click
adds one column of G, undo drops it. The leak sets how far a click reaches.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from cachetools import LRUCache
from scipy.sparse import diags
from scipy.sparse.linalg import SuperLU, splu

from model.segmentation.arrays import Bool, Float, Int
from model.segmentation.encode.graph import adjacency
from model.segmentation.encode.superpoints import Superpoints

LEAKS = (1e-4, 2e-2, 2e-1)
_COLUMNS = 512


class RandomWalk:
    """Factorised walks with one reach for each of ``LEAKS``."""

    def __init__(self, superpoints: Superpoints, *, at_once: bool = True) -> None:
        """``at_once``: factorise now, not when a column is first asked for."""
        links = superpoints.links
        apart = np.linalg.norm(superpoints.center[links.a] - superpoints.center[links.b], axis=1)
        typical = float(np.median(apart)) if len(apart) else 1.0
        weight = links.conductance / np.maximum(apart / max(typical, 1e-12), 0.3)
        matrix = adjacency(len(superpoints), links.a, links.b, weight)
        degree = np.asarray(matrix.sum(1)).ravel()
        median = float(np.median(degree)) if len(links.a) else 1.0
        self._matrix, self._degree, self._unit = matrix, degree, max(median, 1e-9)
        self._factors: dict[int, SuperLU] = {}
        if at_once:
            for reach in range(len(LEAKS)):
                self._factor(reach)
        self._count = len(superpoints)
        self._a, self._b, self._weight, self._size = links.a, links.b, weight, superpoints.size
        self._columns: LRUCache[tuple[int, int], Future[Float]] = LRUCache(_COLUMNS)
        self._ahead: ThreadPoolExecutor | None = None

    def column(self, superpoint: int, reach: int) -> Float:
        """(C,) the Green's function of a superpoint; ``reach`` indexes ``LEAKS``."""
        found = self._columns.get((superpoint, reach))
        if found is None:
            found = Future()
            found.set_result(self._solve(superpoint, reach))
            self._columns[superpoint, reach] = found
        return found.result()

    def prefetch(self, superpoint: int) -> None:
        """Start solving for a superpoint on another thread; :meth:`column` waits for it."""
        if self._ahead is None:
            self._ahead = ThreadPoolExecutor(1, thread_name_prefix="walk")
        for reach in range(len(LEAKS)):
            if (superpoint, reach) not in self._columns:
                solving = self._ahead.submit(self._solve, superpoint, reach)
                self._columns[superpoint, reach] = solving

    def _solve(self, superpoint: int, reach: int) -> Float:
        unit = np.zeros(self._count)
        unit[superpoint] = 1
        return self._factor(reach).solve(unit).astype(np.float32)

    def _factor(self, reach: int) -> SuperLU:
        if reach not in self._factors:
            self._factors[reach] = splu(
                (diags(self._degree + LEAKS[reach] * self._unit) - self._matrix).tocsc(),
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        return self._factors[reach]

    def sweep(self, field: Float, most: int = 5) -> Bool:
        """Level sets of a field through whose border the walk leaks least, at several sizes.

        The sweep cut of local spectral clustering (Andersen, Chung, Lang 2006), with the leak
        relative to the root of the area, because borders of surfaces are lines.

        Args:
            field: (C,) high inside.
            most: largest number of sets.

        Returns:
            (H, C) bool, the tightest first.
        """
        order = np.argsort(-field, kind="stable")
        rank = np.empty(len(order), np.int64)
        rank[order] = np.arange(len(order))
        a, b = rank[self._a], rank[self._b]
        number = len(order) + 1
        through = np.bincount(np.minimum(a, b) + 1, self._weight, number) - np.bincount(
            np.maximum(a, b) + 1, self._weight, number
        )
        through = np.cumsum(through)[1:-1]
        area = np.cumsum(self._size[order])[:-1]
        if not len(area):
            return np.zeros((0, len(order)), bool)
        smaller = np.minimum(area, self._size.sum() - area)
        leak = np.maximum(through, 0) / np.sqrt(smaller) + 1e-9
        bins = np.floor(np.log(area) / 0.3).astype(np.int64)
        first = np.nonzero(np.r_[True, np.diff(bins) != 0])[0]
        low = np.minimum.reduceat(leak, first)
        number_in = np.diff(np.r_[first, len(leak)])
        at = np.nonzero(leak == np.repeat(low, number_in))[0]
        at = at[np.r_[True, np.diff(bins[at]) != 0]]
        around = np.minimum(np.r_[np.inf, low[:-1]], np.r_[low[1:], np.inf])
        good = np.nonzero(low <= 1.05 * around)[0]
        good = good[np.argsort(low[good], kind="stable")][:most]
        return rank[None] <= at[good][:, None]

    def fields(self, prior: Float, seeds: Int, values: Float, reach: int) -> Float:
        """Fields that keep to their priors far from the seeds and take ``values`` at them.

        Args:
            prior: (H, C).
            seeds: (K,) distinct superpoints.
            values: (K,).

        Returns:
            (H, C).
        """
        green = np.stack([self.column(int(s), reach) for s in seeds])
        inner = green[:, seeds].astype(np.float64)
        inner += 1e-7 * np.trace(inner) / len(seeds) * np.eye(len(seeds))
        missing = values[None] - prior[:, seeds]
        return prior + np.linalg.solve(inner, missing.T).T @ green
