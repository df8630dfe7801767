"""Cutting a part's surface into pieces that cover no free space.

Top down: the whole, its connected shells, their smooth and flat regions, then halves by place and
direction, and each is cut further only while its body covers free voxels. No step needs a closed,
oriented or clean mesh.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from model.core.mesh import Mesh
from model.geometry.topology import connected_shells, face_adjacency, weld
from model.physics.collision.dops import FloatArray, Surface

SMOOTH = 0.5
"""Radians between faces of one smooth region."""
FLAT = 0.05
"""The same of one flat region."""
MOST_PIECES = 192
CORNERS = 64
"""Of the hulls that tell whether a piece is convex."""
DIRECTION = 0.3
"""Weight of the faces' normals against their places, in the piece's extent, where it is halved."""


@dataclass(frozen=True, eq=False)
class Patch:
    """Some faces of a part.

    Attributes:
        faces: (N,) indices.
        extent: (2, K), see :class:`~model.physics.collision.dops.Surface`.
        covers: free voxels in it.
    """

    faces: npt.NDArray[np.int64]
    extent: FloatArray
    covers: float


def decompose(surface: Surface, tolerance: float, most: int = MOST_PIECES) -> list[Patch]:
    """Pieces that cover at most ``tolerance`` free voxels each, as far as ``most`` pieces allow.

    Faces without area are left out.
    """
    levels = _Levels(surface.mesh)
    order = count()

    def piece(faces: npt.NDArray[np.int64]) -> Patch:
        extent = surface.extent(faces)
        return Patch(faces, extent, surface.covers(extent))

    first = piece(np.flatnonzero(surface.mesh.face_areas > 0))
    queue = [(-first.covers, next(order), 0, first)]
    done: list[Patch] = []
    while queue and len(queue) + len(done) < most:
        covers, _, level, worst = heapq.heappop(queue)
        if -covers > tolerance and len(worst.faces) > 1:  # its true hull may be tighter
            hull = surface.hull(worst.faces, CORNERS)
            covers = -surface.space.count_inside(surface.space.free, hull.planes, hull.bounds)
        if -covers <= tolerance or len(worst.faces) < 2:
            done.append(replace(worst, covers=min(worst.covers, -covers)))
            continue
        level, groups = levels.split(worst.faces, level)
        for faces in groups:
            made = piece(faces)
            heapq.heappush(queue, (-made.covers, next(order), level, made))
    return done + [entry[3] for entry in queue]


class _Levels:
    """How a set of faces is cut: by shell, by smooth region, by flat region, then in halves."""

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
        """The level that the groups are at, and the groups."""
        for i in range(level, len(self.regions)):
            _, group = np.unique(self.regions[i][faces], return_inverse=True)
            if group.max() > 0:
                return i, self._groups_halved(faces, group)
        return len(self.regions), self._halves(faces)

    def _groups_halved(
        self, faces: npt.NDArray[np.int64], group: npt.NDArray[np.int64]
    ) -> list[npt.NDArray[np.int64]]:
        """Cut by the groups' middles, none of them cut through."""
        weight = self.mesh.face_areas[faces]
        total: FloatArray = np.bincount(group, weight).astype(np.float64)
        at = [np.bincount(group, weight * c) / total for c in self.centers[faces].T]
        side = _two_sides(np.stack(at, axis=1), total)[group]
        return [faces[side], faces[~side]]

    def _halves(self, faces: npt.NDArray[np.int64]) -> list[npt.NDArray[np.int64]]:
        centers = self.centers[faces]
        extent = float(np.ptp(centers, axis=0).max())
        features = np.column_stack([centers, DIRECTION * extent * self.mesh.face_normals[faces]])
        side = _two_sides(features, self.mesh.face_areas[faces])
        return [faces[side], faces[~side]]


def _two_sides(features: FloatArray, weight: FloatArray) -> npt.NDArray[np.bool_]:
    """(N,) which side of the middle (N, K) rows are on along their longest direction."""
    centred = features - weight @ features / weight.sum()
    way = np.linalg.eigh((centred * weight[:, None]).T @ centred)[1][:, -1]
    side = centred @ way > 0
    if side.all() or not side.any():
        side = np.arange(len(features)) < len(features) // 2
    return side


def _regions(number: int, pairs: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    graph = coo_matrix(
        (np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(number, number)
    )
    return connected_components(graph, directed=False)[1]
