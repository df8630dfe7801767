"""Joining neighbouring pieces again while what holds both covers no free space.

Greedy, as in hierarchical approximate convex decomposition (Mamou and Ghorbel, 2009), but what a
merge costs is what matters here: the free voxels that the common body newly covers.
"""

from __future__ import annotations

import heapq
from collections import defaultdict

import numpy as np
import numpy.typing as npt

from model.collision.dops import FloatArray, Surface
from model.collision.pieces import Piece

FREE_MERGE = 0.001
"""Share of the free voxels that one merge may cover."""
FREE_TOTAL = 0.01
"""And all of them."""

_OFFSETS = np.array([o for o in np.ndindex(3, 3, 3) if o > (1, 1, 1)]) - 1


def merge(surface: Surface, pieces: list[Piece], most: int) -> list[npt.NDArray[np.int64]]:
    """The faces of at most ``most`` pieces.

    Beyond the number the merges that cost least free space are made whatever they cost.
    """
    return _Merging(surface, pieces).run(most)


class _Merging:
    def __init__(self, surface: Surface, pieces: list[Piece]) -> None:
        self.surface = surface
        self.piece = dict(enumerate(pieces))
        self.near: dict[int, set[int]] = defaultdict(set)
        for a, b in _neighbours(surface, pieces):
            self.near[a].add(b)
            self.near[b].add(a)
        self.queue: list[tuple[float, float, int, int, FloatArray, float]] = []
        self.next = len(pieces)

    def run(self, most: int) -> list[npt.NDArray[np.int64]]:
        free = max(self.surface.space.free_count, 1)
        for a in list(self.near):
            for b in self.near[a]:
                if a < b:
                    self._offer(a, b)
        spent = 0.0
        while len(self.piece) > 1:
            while self.queue and not self._alive(self.queue[0]):
                heapq.heappop(self.queue)
            if not self.queue:
                if len(self.piece) <= most:
                    break
                self._bridge()
                continue
            cost = self.queue[0][0]
            wanted = cost <= FREE_MERGE * free and spent + cost <= FREE_TOTAL * free
            if not wanted and len(self.piece) <= most:
                break
            spent += max(cost, 0.0)
            self._join(*heapq.heappop(self.queue)[2:])
        return [p.faces for p in self.piece.values()]

    def _alive(self, entry: tuple[float, float, int, int, FloatArray, float]) -> bool:
        return entry[2] in self.piece and entry[3] in self.piece

    def _offer(self, a: int, b: int) -> None:
        one, other = self.piece[a], self.piece[b]
        extent = np.stack([
            np.minimum(one.extent[0], other.extent[0]), np.maximum(one.extent[1], other.extent[1])
        ])  # fmt: skip
        covers = self.surface.covers(extent)
        cost = covers - one.covers - other.covers
        size = float(np.prod(extent[1, :3] - extent[0, :3]))  # small ones first, they stay compact
        heapq.heappush(self.queue, (cost, size, a, b, extent, covers))

    def _join(self, a: int, b: int, extent: FloatArray, covers: float) -> None:
        new, self.next = self.next, self.next + 1
        around = (self.near.pop(a, set()) | self.near.pop(b, set())) - {a, b}
        faces = np.concatenate([self.piece.pop(a).faces, self.piece.pop(b).faces])
        self.piece[new], self.near[new] = Piece(faces, extent, covers), around
        for other in around:
            self.near[other] -= {a, b}
            self.near[other].add(new)
            self._offer(other, new)

    def _bridge(self) -> None:
        """Offer each piece to its nearest ones where none touches another any more."""
        keys = list(self.piece)
        middles = np.stack([self.piece[k].extent[:, :3].mean(axis=0) for k in keys])
        apart = np.linalg.norm(middles[:, None] - middles, axis=2)
        nearest = np.argsort(apart, axis=1)[:, 1:4]
        for a, b in {(min(i, j), max(i, j)) for i, row in enumerate(nearest.tolist()) for j in row}:
            self.near[keys[a]].add(keys[b])
            self.near[keys[b]].add(keys[a])
            self._offer(keys[a], keys[b])


def _neighbours(surface: Surface, pieces: list[Piece]) -> list[tuple[int, int]]:
    """Pairs of pieces that are in the same voxel or in two that touch."""
    space = surface.space
    owner = np.full(len(surface.mesh.faces), -1)
    for i, piece in enumerate(pieces):
        owner[piece.faces] = i
    who = owner[surface.point_face]
    cell = np.floor((surface.points[who >= 0] - space.low) / space.size).astype(np.int64) + 1
    shape = np.array(space.surface.shape) + 2
    key = np.ravel_multi_index(tuple(np.clip(cell, 0, shape - 1).T), tuple(shape))
    both = np.unique(key * len(pieces) + who[who >= 0])
    cell, who = both // len(pieces), both % len(pieces)
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    found: list[npt.NDArray[np.int64]] = []
    for step in [0, *(_OFFSETS @ strides).tolist()]:
        # Every piece of a cell against those of the cell ``step`` further.
        start = np.searchsorted(cell, cell + step, "left")
        number = np.searchsorted(cell, cell + step, "right") - start
        one = np.repeat(np.arange(len(cell)), number)
        offset = np.arange(len(one)) - np.repeat(np.cumsum(number) - number, number)
        a, b = who[one], who[start[one] + offset]
        found.append(np.unique(np.minimum(a, b) * len(pieces) + np.maximum(a, b)))
    pairs = np.unique(np.concatenate(found))
    return [
        (p // len(pieces), p % len(pieces))
        for p in pairs.tolist()
        if p // len(pieces) != p % len(pieces)
    ]
