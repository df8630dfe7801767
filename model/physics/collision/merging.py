"""Merge neighbouring patches while the common body covers little free space.

Greedy, as in hierarchical approximate convex decomposition (Mamou and Ghorbel, 2009). The cost of a
merge is the number of free voxels that the common body newly covers. First with k-DOPs, which are
fast; the remaining ones with convex hulls, which are tighter about round shapes.
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.shapes import Hull, coarse
from model.physics.collision.decomposition import Patch
from model.physics.collision.dops import FaceExtents
from model.physics.collision.hulls import thick_hull

FREE_MERGE = 0.001
"""Most free voxels that one merge may cover, as a share of all."""
FREE_TOTAL = 0.01
"""The same for all merges together."""
ROUGH = 1.5
"""Patches left by the first stage, over the budget."""
CORNERS = 40
"""Vertices of hulls while they are compared."""

_OFFSETS = np.array([o for o in np.ndindex(3, 3, 3) if o > (1, 1, 1)]) - 1

Faces = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class _Body:
    """Faces with their k-DOP or hull, its free voxels and its size."""

    faces: Faces
    shape: Any
    covers: float
    size: float
    middle: npt.NDArray[np.float64]


def merge(surface: FaceExtents, patches: list[Patch], most: int) -> list[Faces]:
    """Return the faces of at most ``most`` groups.

    Above that number, the cheapest merges are made whatever they cost.
    """
    free = surface.space.free_count
    bodies = [_extent_body(surface, p.faces, p.extent, p.covers) for p in patches]
    rough = _Merging(bodies, _neighbours(surface, patches), lambda a, b: _extents(surface, a, b))
    rough.run(max(int(ROUGH * most), most + 4), free)
    left = list(rough.body)
    place = {key: i for i, key in enumerate(left)}
    near = [(place[a], place[b]) for a in left for b in rough.near[a] if a < b and b in place]
    hulls = [_hull_body(surface, rough.body[k].faces, surface.hull(rough.body[k].faces, CORNERS))
             for k in left]  # fmt: skip
    fine = _Merging(hulls, near, lambda a, b: _hulls(surface, a, b))
    fine.run(most, free)
    return [b.faces for b in fine.body.values()]


def _extent_body(surface: FaceExtents, faces: Faces, extent: Any, covers: float | None) -> _Body:
    size = float(np.prod(extent[1, :3] - extent[0, :3]))
    covers = surface.covers(extent) if covers is None else covers
    return _Body(faces, extent, covers, size, extent[:, :3].mean(axis=0))


def _extents(surface: FaceExtents, a: _Body, b: _Body) -> _Body:
    low = np.minimum(a.shape[0], b.shape[0])
    extent = np.stack([low, np.maximum(a.shape[1], b.shape[1])])
    return _extent_body(surface, np.concatenate([a.faces, b.faces]), extent, None)


def _hull_body(surface: FaceExtents, faces: Faces, hull: Hull) -> _Body:
    covers = surface.space.count_inside(surface.space.free, hull.planes, hull.bounds)
    return _Body(faces, hull, covers, hull.volume, hull.bounds.mean(axis=0))


def _hulls(surface: FaceExtents, a: _Body, b: _Body) -> _Body:
    corners = np.concatenate([a.shape.vertices, b.shape.vertices])
    hull = coarse(thick_hull(corners, 0.5 * surface.space.size), CORNERS)
    return _hull_body(surface, np.concatenate([a.faces, b.faces]), hull)


class _Merging:
    def __init__(
        self,
        bodies: list[_Body],
        near: Iterable[tuple[int, int]],
        union: Callable[[_Body, _Body], _Body],
    ) -> None:
        self.body = dict(enumerate(bodies))
        self.union = union
        self.near: dict[int, set[int]] = defaultdict(set)
        for a, b in near:
            self.near[a].add(b)
            self.near[b].add(a)
        self.queue: list[tuple[float, float, int, int, _Body]] = []
        self.next = len(bodies)

    def run(self, most: int, free: int) -> None:
        """Merge while it is cheap, and until at most ``most`` bodies are left."""
        for a in list(self.near):
            for b in self.near[a]:
                if a < b:
                    self._offer(a, b)
        spent, free = 0.0, max(free, 1)
        while len(self.body) > 1:
            while self.queue and not self._alive(self.queue[0]):
                heapq.heappop(self.queue)
            if not self.queue:
                if len(self.body) <= most:
                    break
                self._bridge()
                continue
            cost = self.queue[0][0]
            wanted = cost <= FREE_MERGE * free and spent + cost <= FREE_TOTAL * free
            if not wanted and len(self.body) <= most:
                break
            spent += max(cost, 0.0)
            _, _, a, b, made = heapq.heappop(self.queue)
            self._join(a, b, made)

    def _alive(self, entry: tuple[float, float, int, int, _Body]) -> bool:
        return entry[2] in self.body and entry[3] in self.body

    def _offer(self, a: int, b: int) -> None:
        made = self.union(self.body[a], self.body[b])
        cost = made.covers - self.body[a].covers - self.body[b].covers
        # Small ones first: they stay compact. No two entries have the same a and b.
        heapq.heappush(self.queue, (cost, made.size, a, b, made))

    def _join(self, a: int, b: int, made: _Body) -> None:
        new, self.next = self.next, self.next + 1
        around = (self.near.pop(a, set()) | self.near.pop(b, set())) - {a, b}
        del self.body[a], self.body[b]
        self.body[new], self.near[new] = made, around
        for other in around:
            self.near[other] -= {a, b}
            self.near[other].add(new)
            self._offer(other, new)

    def _bridge(self) -> None:
        """Make the nearest bodies neighbours where no neighbours are left."""
        keys = list(self.body)
        middles = np.stack([self.body[k].middle for k in keys])
        apart = np.linalg.norm(middles[:, None] - middles, axis=2)
        nearest = np.argsort(apart, axis=1)[:, 1:4]
        for a, b in {(min(i, j), max(i, j)) for i, row in enumerate(nearest.tolist()) for j in row}:
            self.near[keys[a]].add(keys[b])
            self.near[keys[b]].add(keys[a])
            self._offer(keys[a], keys[b])


def _neighbours(surface: FaceExtents, patches: list[Patch]) -> list[tuple[int, int]]:
    """Pairs of patches in the same voxel or in adjacent ones."""
    space = surface.space
    owner = np.full(len(surface.mesh.faces), -1)
    for i, patch in enumerate(patches):
        owner[patch.faces] = i
    patch_of = owner[surface.point_face]
    cell = np.floor((surface.points[patch_of >= 0] - space.low) / space.size).astype(np.int64) + 1
    shape = np.array(space.surface.shape) + 2
    key = np.ravel_multi_index(tuple(np.clip(cell, 0, shape - 1).T), tuple(shape))
    both = np.unique(key * len(patches) + patch_of[patch_of >= 0])
    cell, patch_of = both // len(patches), both % len(patches)
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    found: list[npt.NDArray[np.int64]] = []
    for step in [0, *(_OFFSETS @ strides).tolist()]:
        # Every patch of a cell against those of the cell ``step`` further.
        start = np.searchsorted(cell, cell + step, "left")
        number = np.searchsorted(cell, cell + step, "right") - start
        one = np.repeat(np.arange(len(cell)), number)
        offset = np.arange(len(one)) - np.repeat(np.cumsum(number) - number, number)
        a, b = patch_of[one], patch_of[start[one] + offset]
        found.append(np.unique(np.minimum(a, b) * len(patches) + np.maximum(a, b)))
    pairs = np.unique(np.concatenate(found))
    return [
        (p // len(patches), p % len(patches))
        for p in pairs.tolist()
        if p // len(patches) != p % len(patches)
    ]
