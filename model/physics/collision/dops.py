"""Discrete oriented polytopes (k-DOPs): convex bodies by their extent along fixed directions.

They replace convex hulls while thousands of candidates are compared (Klosowski et al., 1998): the
union of two is one ``maximum``. With the part's own face normals among the directions they equal
the hulls of boards and boxes, and are slightly larger for other bodies.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.core.mesh import Mesh
from model.core.shapes import Hull, coarse
from model.physics.collision.hulls import thick_hull
from model.physics.collision.voxels import Occupancy, surface_lattice

SAMPLES = 4000
"""Sampled free voxels."""
NORMALS = 10
"""Most face normals among the directions, beside the 13 of a cube."""
SAME = 0.996
"""Cosine above which two directions count as one: 5°."""

FloatArray = npt.NDArray[np.float64]

_CUBE = np.array([d for d in np.ndindex(3, 3, 3) if d > (1, 1, 1)], np.float64) - 1.0


class FaceExtents:
    """Extents of a part's faces with the solid beneath them, and samples of its free space.

    Attributes:
        mesh, space: of the part.
        directions: (K, 3) unit.
        points: (N, 3) lattice on the faces; ``point_face`` (N,) their faces.
        low, high: (F, K) extents of each face and of the sealed voxels nearest to it.
        beneath: (S, 3) centres of the sealed voxels; ``owner`` (S,) the nearest face of each.
    """

    def __init__(self, mesh: Mesh, space: Occupancy, rng: np.random.Generator) -> None:
        self.mesh, self.space = mesh, space
        self.directions = _directions(mesh)
        self.points, self.point_face = surface_lattice(mesh.triangles, space.size / 2)
        reach = mesh.vertices @ self.directions.T
        corners = reach[mesh.faces]
        self.low, self.high = corners.min(axis=1), corners.max(axis=1)
        self.beneath = space.centers(space.solid)
        self.owner = np.zeros(0, np.int64)
        if len(self.beneath):
            self._add_beneath()
        self._probe(rng)

    def _add_beneath(self) -> None:
        from scipy.ndimage import distance_transform_edt

        space = self.space
        cell = np.floor((self.points - space.low) / space.size).astype(np.int64)
        cell = np.clip(cell, 0, np.array(space.surface.shape) - 1)
        face_of = np.full(space.surface.shape, -1, np.int64)
        face_of[tuple(cell.T)] = self.point_face
        near = distance_transform_edt(face_of < 0, return_distances=False, return_indices=True)
        assert near is not None
        owner = face_of[tuple(near)][space.solid]
        order = np.argsort(owner, kind="stable")
        self.beneath, self.owner = self.beneath[order], owner[order]
        face, start = np.unique(self.owner, return_index=True)
        reach = self.beneath @ self.directions.T
        self.low[face] = np.minimum(self.low[face], np.minimum.reduceat(reach, start))
        self.high[face] = np.maximum(self.high[face], np.maximum.reduceat(reach, start))

    def _probe(self, rng: np.random.Generator) -> None:
        """Sample free voxels, half of them near the surface, where narrow hollows are."""
        from scipy.ndimage import binary_dilation

        free, space = self.space.free, self.space
        near = free & np.asarray(binary_dilation(space.surface, iterations=2), bool)
        chosen, weights = [], []
        for mask in (near, free & ~near):
            index = np.flatnonzero(mask)
            kept = rng.choice(index, min(len(index), SAMPLES // 2), replace=False)
            chosen.append(kept)
            weights.append(np.full(len(kept), len(index) / max(len(kept), 1)))
        at = np.stack(np.unravel_index(np.concatenate(chosen), free.shape), axis=1)
        self.weights = np.concatenate(weights)
        self.probes = self.directions @ (space.low + (at + 0.5) * space.size).T

    def extent(self, faces: npt.NDArray[np.int64]) -> FloatArray:
        """(2, K) extent of some faces, at least half a voxel thick."""
        extent = np.stack([self.low[faces].min(axis=0), self.high[faces].max(axis=0)])
        lack = np.maximum(0.5 * self.space.size - (extent[1] - extent[0]), 0.0) / 2
        return np.stack([extent[0] - lack, extent[1] + lack])

    def covers(self, extent: FloatArray) -> float:
        """Estimate the number of free voxels in a (2, K) body."""
        (low, high), (x, y, z) = extent, self.probes[:3]
        # The axes first: they exclude most, and contiguous rows compare fast.
        inside = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
        index = np.flatnonzero(inside & (z >= low[2]) & (z <= high[2]))
        if not len(index):
            return 0.0
        here = self.probes[3:, index]
        within = (here >= low[3:, None]) & (here <= high[3:, None])
        return float(self.weights[index[within.all(axis=0)]].sum())

    def corners(self, faces: npt.NDArray[np.int64]) -> FloatArray:
        """(N, 3) vertices of some faces."""
        return self.mesh.vertices[np.unique(self.mesh.faces[faces])]

    def hull(self, faces: npt.NDArray[np.int64], corners: int) -> Hull:
        """The convex hull of some faces, with at most about ``corners`` vertices."""
        return coarse(thick_hull(self.corners(faces), 0.5 * self.space.size), corners)


def _directions(mesh: Mesh) -> FloatArray:
    """(K, 3) unit: the axes, a cube's diagonals, and the normals with the largest area."""
    cube = _CUBE[np.argsort(np.abs(_CUBE).sum(axis=1), kind="stable")]
    found = list(cube / np.linalg.norm(cube, axis=1, keepdims=True))
    normals, areas = mesh.face_normals, mesh.face_areas.copy()
    for direction in found:
        areas[np.abs(normals @ direction) > SAME] = 0.0
    # Faces with similar normals are grouped by rounding.
    key = np.round(normals * np.sign(normals.sum(axis=1, keepdims=True) + 1e-12) * 16)
    group = np.unique((key + 16) @ (33**2, 33, 1), return_inverse=True)[1]
    for _ in range(NORMALS):
        weight = np.bincount(group, areas)
        if not weight.max() > 0.005 * float(mesh.face_areas.sum()):
            break
        face = np.flatnonzero(group == weight.argmax())
        found.append(normals[face[areas[face].argmax()]])
        areas[np.abs(normals @ found[-1]) > SAME] = 0.0
    return np.array(found)
