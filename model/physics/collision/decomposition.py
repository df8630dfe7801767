"""Convex decomposition: cut a part's surface into patches whose bodies cover no free space.

Top down: the whole, its connected shells, their smooth and flat regions, then halves by position
and direction. A patch is cut further only while its body covers free voxels. No step needs a
closed, oriented or clean mesh.
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
from model.physics.collision.dops import FaceExtents, FloatArray

SMOOTH = 0.5
"""Largest angle between faces of one smooth region, radians."""
FLAT = 0.05
"""The same for flat regions."""
MOST_PATCHES = 192
CORNERS = 64
"""Vertices of the hulls that decide whether a patch is convex."""
DIRECTION = 0.3
"""Weight of normals against positions where a patch is halved, in the patch's extent."""


@dataclass(frozen=True, eq=False)
class Patch:
    """Some faces of a part.

    Attributes:
        faces: (N,) indices.
        extent: (2, K), see :class:`~model.physics.collision.dops.FaceExtents`.
        covers: free voxels in it.
    """

    faces: npt.NDArray[np.int64]
    extent: FloatArray
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
            hull = surface.hull(worst.faces, CORNERS)
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
