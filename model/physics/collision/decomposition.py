"""Convex decomposition: cut a part's surface into patches whose bodies cover no free space.

Top down: the whole, its connected shells, their smooth and flat regions, then halves by position
and direction. A patch is cut further only while its body covers free voxels. No step needs a
closed, oriented or clean mesh.

Then neighbouring patches are merged, greedily, as in hierarchical approximate convex decomposition
(Mamou and Ghorbel, 2009). The cost of a merge is the number of free voxels that the common body
newly covers. First with k-DOPs, which are fast; the remaining ones with convex hulls, which are
tighter about round shapes.

CoACD runs in a process of its own, as it may crash and can't be interrupted.
``python -m model.physics.collision.decomposition IN.npz OUT.npz PARENT`` reads ``vertices``,
``faces`` and ``options`` (JSON), writes ``count`` and the vertices of each hull, and ends with the
process PARENT.
"""

from __future__ import annotations

import heapq
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from model.core.geometry import Mesh
from model.core.progress import die_with_parent
from model.core.shapes import FloatArray, Hull, coarse, hull_of, thick_hull
from model.geometry.topology import connected_shells, face_adjacency, weld
from model.physics.collision.convex_bodies import FaceExtents, Floats

SMOOTH = 0.5
"""Largest angle between faces of one smooth region, radians."""
FLAT = 0.05
"""The same for flat regions."""
MOST_PATCHES = 192
ROUGH_CORNERS = 64
"""Vertices of the hulls that decide whether a patch is convex."""
DIRECTION = 0.3
"""Weight of normals against positions where a patch is halved, in the patch's extent."""


@dataclass(frozen=True, eq=False)
class Patch:
    """Some faces of a part.

    Attributes:
        faces: (N,) indices.
        extent: (2, K), see :class:`~model.physics.collision.convex_bodies.FaceExtents`.
        covers: free voxels in it.
    """

    faces: npt.NDArray[np.int64]
    extent: Floats
    covers: float


def decompose(surface: FaceExtents, tolerance: float, most: int = MOST_PATCHES) -> list[Patch]:
    """Cut into at most ``most`` patches, so that each covers at most ``tolerance`` free voxels.

    Faces without area are left out.
    """
    levels = _Levels(surface.mesh)
    order = count()

    def patch(faces: npt.NDArray[np.int64]) -> Patch:
        extent = surface.extent(faces)
        return Patch(faces, extent, surface.covers(extent))

    first = patch(np.flatnonzero(surface.mesh.face_areas > 0))
    queue = [(-first.covers, next(order), 0, first)]
    done: list[Patch] = []
    while queue and len(queue) + len(done) < most:
        covers, _, level, worst = heapq.heappop(queue)
        if -covers > tolerance and len(worst.faces) > 1:  # its convex hull may be tighter
            hull = surface.hull(worst.faces, ROUGH_CORNERS)
            covers = -surface.space.count_inside(surface.space.free, hull.planes, hull.bounds)
        if -covers <= tolerance or len(worst.faces) < 2:
            done.append(replace(worst, covers=min(worst.covers, -covers)))
            continue
        level, groups = levels.split(worst.faces, level)
        for faces in groups:
            made = patch(faces)
            heapq.heappush(queue, (-made.covers, next(order), level, made))
    return done + [entry[3] for entry in queue]


class _Levels:
    """Cuts faces by shell, by smooth region, by flat region, then in halves."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        ids = weld(mesh)
        found = face_adjacency(mesh, ids)
        self.regions = [
            connected_shells(mesh, ids),
            *(_regions(len(mesh.faces), found.pairs[found.angle < a]) for a in (SMOOTH, FLAT)),
        ]
        self.centers = mesh.triangles.mean(axis=1)

    def split(
        self, faces: npt.NDArray[np.int64], level: int
    ) -> tuple[int, list[npt.NDArray[np.int64]]]:
        """Return the level of the groups, and the groups."""
        for i in range(level, len(self.regions)):
            _, group = np.unique(self.regions[i][faces], return_inverse=True)
            if group.max() > 0:
                return i, self._groups_halved(faces, group)
        return len(self.regions), self._halves(faces)

    def _groups_halved(
        self, faces: npt.NDArray[np.int64], group: npt.NDArray[np.int64]
    ) -> list[npt.NDArray[np.int64]]:
        """Split between groups, by their centres."""
        weight = self.mesh.face_areas[faces]
        total: Floats = np.bincount(group, weight).astype(np.float64)
        at = [np.bincount(group, weight * c) / total for c in self.centers[faces].T]
        side = _two_sides(np.stack(at, axis=1), total)[group]
        return [faces[side], faces[~side]]

    def _halves(self, faces: npt.NDArray[np.int64]) -> list[npt.NDArray[np.int64]]:
        centers = self.centers[faces]
        extent = float(np.ptp(centers, axis=0).max())
        features = np.column_stack([centers, DIRECTION * extent * self.mesh.face_normals[faces]])
        side = _two_sides(features, self.mesh.face_areas[faces])
        return [faces[side], faces[~side]]


def _two_sides(features: Floats, weight: Floats) -> npt.NDArray[np.bool_]:
    """(N,) side of the mean of (N, K) rows along their principal axis."""
    centred = features - weight @ features / weight.sum()
    axis = np.linalg.eigh((centred * weight[:, None]).T @ centred)[1][:, -1]
    side = centred @ axis > 0
    if side.all() or not side.any():
        side = np.arange(len(features)) < len(features) // 2
    return side


def _regions(number: int, pairs: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    graph = coo_matrix(
        (np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(number, number)
    )
    return connected_components(graph, directed=False)[1]


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
    hulls = [
        _hull_body(surface, rough.body[k].faces, surface.hull(rough.body[k].faces, CORNERS))
        for k in left
    ]
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
            while self.queue and not {*self.queue[0][2:4]} <= self.body.keys():  # one is merged
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


def coacd_installed() -> bool:
    """True if coacd (``artiworld[collision]``) is installed."""
    return find_spec("coacd") is not None


def coacd_hulls(mesh: Mesh, seconds: float, **options: Any) -> list[Hull] | None:
    """Decompose a mesh by CoACD (Wei et al., 2022); None where it fails or takes too long.

    Args:
        seconds: time limit of the process.
        options: of ``coacd.run_coacd``.
    """
    root = str(Path(__file__).resolve().parents[3])
    with tempfile.TemporaryDirectory(prefix="artiworld-") as folder:
        source, target = Path(folder, "in.npz"), Path(folder, "out.npz")
        np.savez(
            source,
            vertices=mesh.vertices,
            faces=mesh.faces,
            options=json.dumps(options),
            seconds=math.ceil(seconds),
        )
        paths = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
        try:
            subprocess.run(
                [sys.executable, "-m", __name__, str(source), str(target), str(os.getpid())],
                timeout=seconds,
                check=True,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env={**os.environ, "PYTHONPATH": paths},
            )
            with np.load(target, allow_pickle=False) as data:
                corners: list[FloatArray] = [data[f"{i}"] for i in range(int(data["count"]))]
        except (subprocess.SubprocessError, OSError):
            return None
    return [h for points in corners if (h := hull_of(points)) is not None] or None


def main(source: str, target: str, parent: str) -> None:
    """Run in the child process."""
    die_with_parent(int(parent))
    import coacd  # type: ignore[import-not-found]

    coacd.set_log_level("off")
    with np.load(source, allow_pickle=False) as data:
        signal.alarm(int(data["seconds"]) + 1)  # in case the parent was killed meanwhile
        mesh = coacd.Mesh(data["vertices"], data["faces"])
        found = coacd.run_coacd(mesh, **json.loads(str(data["options"])))
    corners = {str(i): np.asarray(vertices) for i, (vertices, _) in enumerate(found)}
    np.savez(target, count=len(found), **corners)  # type: ignore[arg-type]


if __name__ == "__main__":
    main(*sys.argv[1:])
