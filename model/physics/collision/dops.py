"""Discrete oriented polytopes: convex bodies by their extent along fixed directions.

They stand for convex hulls while thousands of candidates are compared (Klosowski et al., 1998):
the union of two is one ``maximum``, and where the part's own face normals are among the directions
they are the hull itself for boards and boxes, and a little larger for everything else.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.core.mesh import Mesh
from model.core.shapes import Hull, coarse
from model.physics.collision.hulls import thick_hull
from model.physics.collision.voxels import Occupancy, lattice_with_faces

SAMPLES = 4000
"""Free voxels that stand for all of them."""
NORMALS = 10
"""Directions taken from the part's own faces, beside the 13 of a cube."""
SAME = 0.996
"""Cosine above which two directions are one: 5°."""

FloatArray = npt.NDArray[np.float64]

_CUBE = np.array([d for d in np.ndindex(3, 3, 3) if d > (1, 1, 1)], np.float64) - 1.0


class Surface:
    """A part's faces as extents, each with the solid beneath it, and samples of the free space.

    Attributes:
        mesh: the part's.
        space: its voxels.
        points: (N, 3) lattice on the faces; ``point_face`` (N,) their faces.
        low, high: (F, K) extents of each face and of the sealed voxels that it is nearest to.
        beneath: (S, 3) centres of the sealed voxels; ``owner`` (S,) the face nearest to each.
    """

    def __init__(self, mesh: Mesh, space: Occupancy, rng: np.random.Generator) -> None:
        self.mesh, self.space = mesh, space
        self.directions = _directions(mesh)
        self.points, self.point_face = lattice_with_faces(mesh.triangles, space.size / 2)
        reach = mesh.vertices @ self.directions.T
        corners = reach[mesh.faces]
        self.low, self.high = corners.min(axis=1), corners.max(axis=1)
        self.beneath = space.centers(space.solid)
        self.owner = np.zeros(0, np.int64)
        if len(self.beneath):
            self._take_beneath()
        self._probe(rng)

    def _take_beneath(self) -> None:
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
        """Half of the samples lie near the surface, where narrow hollows are; they count less."""
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
        """(2, K) of some faces, no thinner than half a voxel."""
        return self.thick(np.stack([self.low[faces].min(axis=0), self.high[faces].max(axis=0)]))

    def thick(self, extent: FloatArray) -> FloatArray:
        """``extent`` with half a voxel or more along each direction."""
        lack = np.maximum(0.5 * self.space.size - (extent[1] - extent[0]), 0.0) / 2
        return np.stack([extent[0] - lack, extent[1] + lack])

    def covers(self, extent: FloatArray) -> float:
        """How many free voxels a (2, K) body covers, estimated."""
        (low, high), (x, y, z) = extent, self.probes[:3]
        # The axes first: they rule out most, and contiguous rows are quick to compare.
        inside = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
        index = np.flatnonzero(inside & (z >= low[2]) & (z <= high[2]))
        if not len(index):
            return 0.0
        here = self.probes[3:, index]
        held = (here >= low[3:, None]) & (here <= high[3:, None])
        return float(self.weights[index[held.all(axis=0)]].sum())

    def corners(self, faces: npt.NDArray[np.int64]) -> FloatArray:
        """(N, 3) vertices of some faces."""
        return self.mesh.vertices[np.unique(self.mesh.faces[faces])]

    def hull(self, faces: npt.NDArray[np.int64], corners: int) -> Hull:
        """The true hull of some faces, with about ``corners`` corners at most."""
        return coarse(thick_hull(self.corners(faces), 0.5 * self.space.size), corners)


def _directions(mesh: Mesh) -> FloatArray:
    """(K, 3) unit: the axes, a cube's diagonals, and the normals that most of the area has."""
    cube = _CUBE[np.argsort(np.abs(_CUBE).sum(axis=1), kind="stable")]
    found = list(cube / np.linalg.norm(cube, axis=1, keepdims=True))
    normals, areas = mesh.face_normals, mesh.face_areas.copy()
    for direction in found:
        areas[np.abs(normals @ direction) > SAME] = 0.0
    # Faces of like normals are summed roughly, by rounding.
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
