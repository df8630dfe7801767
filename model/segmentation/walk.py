"""Random walks on the cells, as Green's functions: factor once, one solve a click.

With the grounded Laplacian ``K = L + leak * I``, the field that takes the values y at the seeds
and otherwise follows the graph is ``mu + G_s (G_ss)^-1 (y - mu_s)`` with ``G = K^-1``: a new click
adds one column of G, undo drops it. The leak sets how far a click reaches.
"""

from __future__ import annotations

from collections import OrderedDict

import numpy as np
import numpy.typing as npt
from scipy.sparse import diags
from scipy.sparse.linalg import splu

from model.segmentation.cells import Cells
from model.segmentation.graph import adjacency

LEAKS = (1e-4, 2e-2, 2e-1)
_COLUMNS = 512

Float = npt.NDArray[np.float32]


class Walk:
    """Factorised walks with one reach for each of ``LEAKS``."""

    def __init__(self, cells: Cells) -> None:
        links = cells.links
        apart = np.linalg.norm(cells.center[links.a] - cells.center[links.b], axis=1)
        typical = float(np.median(apart)) if len(apart) else 1.0
        weight = links.conductance / np.maximum(apart / max(typical, 1e-12), 0.3)
        matrix = adjacency(len(cells), links.a, links.b, weight)
        degree = np.asarray(matrix.sum(1)).ravel()
        median = float(np.median(degree)) if len(links.a) else 1.0
        self._factors = [
            splu(
                (diags(degree + leak * max(median, 1e-9)) - matrix).tocsc(),
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
            for leak in LEAKS
        ]
        self._count = len(cells)
        self._columns: OrderedDict[tuple[int, int], Float] = OrderedDict()

    def column(self, cell: int, reach: int) -> Float:
        """(C,) the Green's function of a cell; ``reach`` indexes ``LEAKS``."""
        key = (cell, reach)
        found = self._columns.get(key)
        if found is None:
            unit = np.zeros(self._count)
            unit[cell] = 1
            found = self._factors[reach].solve(unit).astype(np.float32)
            self._columns[key] = found
            if len(self._columns) > _COLUMNS:
                self._columns.popitem(last=False)
        return found

    def fields(
        self, prior: Float, seeds: npt.NDArray[np.integer], values: Float, reach: int
    ) -> Float:
        """Fields that keep to their priors far from the seeds and take ``values`` at them.

        Args:
            prior: (H, C).
            seeds: (K,) distinct cells.
            values: (K,).

        Returns:
            (H, C).
        """
        green = np.stack([self.column(int(s), reach) for s in seeds])
        inner = green[:, seeds].astype(np.float64)
        inner += 1e-7 * np.trace(inner) / len(seeds) * np.eye(len(seeds))
        missing = values[None] - prior[:, seeds]
        return prior + (np.linalg.solve(inner, missing.T).T.astype(np.float32)) @ green
