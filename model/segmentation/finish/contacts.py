"""Which disconnected shells of a modelled mesh truly touch each other.

The node graph joins what lies within a few millimetres; a drawer's tray stands no farther than that
from the carcass it slides in. Distances to the triangles themselves tell what is fastened.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.mesh import Mesh
from model.geometry.sampling import sample_surface

TOUCHING = 1e-4
"""Of the mesh's diagonal: 0.1 mm on a metre, more than what models are rounded to."""

MOST_SHELLS = 400
"""Crumbs of a scan beyond those are not asked what they touch."""

_SAMPLES = 1500
_MOST_CORNERS = 20_000
"""Of one shell: a scan has millions, and what lies on it has corners of its own."""


def contacts_of(
    mesh: Mesh, shell: npt.NDArray[np.integer], asked: npt.NDArray[np.bool_]
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Faces at which shells touch.

    Args:
        shell: (F,) the shell of each face.
        asked: (F,) faces of the shells whose contacts are wanted.

    Returns:
        Two (K,) arrays: a face of an asked shell, and one of another shell that it touches.
        Of more than ``MOST_SHELLS`` shells the smaller ones are left out.
    """
    faces = _faces_of_shells(shell)
    there = np.argsort(-np.bincount(shell, mesh.face_areas), kind="stable")[:MOST_SHELLS]
    tolerance = TOUCHING * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    triangles = mesh.triangles.astype(np.float32)
    pieces = [_Shell(triangles[faces[s]], faces[s]) for s in there]
    low = np.array([p.low for p in pieces]) - tolerance
    high = np.array([p.high for p in pieces]) + tolerance
    close = ((low[:, None] <= high[None]) & (low[None] <= high[:, None])).all(2)
    wanted = np.isin(there, shell[asked])
    close &= wanted[:, None] | wanted[None]
    mine: list[npt.NDArray[np.int32]] = []
    other: list[npt.NDArray[np.int32]] = []
    for i, j in zip(*np.nonzero(np.triu(close, 1)), strict=True):
        for one, two in ((pieces[i], pieces[j]), (pieces[j], pieces[i])):
            a, b = one.on(two, tolerance)
            mine += [a, b]
            other += [b, a]
    if not mine:
        return np.zeros(0, np.int32), np.zeros(0, np.int32)
    pairs = np.stack([np.concatenate(mine), np.concatenate(other)], 1)
    pairs = np.unique(pairs[asked[pairs[:, 0]]], axis=0).astype(np.int32)
    return pairs[:, 0], pairs[:, 1]


def _faces_of_shells(shell: npt.NDArray[np.integer]) -> list[npt.NDArray[np.int64]]:
    order = np.argsort(shell, kind="stable")
    return np.split(order, np.cumsum(np.bincount(shell))[:-1])


class _Shell:
    """One shell: points on it, and how far others' points are from its triangles."""

    def __init__(self, triangles: npt.NDArray[np.float32], faces: npt.NDArray[np.integer]) -> None:
        self._faces = faces.astype(np.int32)
        self._triangles = triangles
        self.low = triangles.reshape(-1, 3).min(0)
        self.high = triangles.reshape(-1, 3).max(0)
        self._points, self._of = self._sampled()
        self._scene: Any = None

    def _sampled(self) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int32]]:
        """Corners and random points, and the face of each."""
        rng = np.random.default_rng(0)
        corners = self._triangles.reshape(-1, 3)
        at = np.arange(len(corners))
        if len(at) > _MOST_CORNERS:
            at = rng.choice(at, _MOST_CORNERS, replace=False)
        points, of = corners[at], at // 3
        mesh = Mesh(
            corners.astype(np.float64), np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
        )
        if mesh.face_areas.sum() > 0:
            more, on = sample_surface(mesh, _SAMPLES, rng)
            points, of = np.concatenate([points, more.points]), np.concatenate([of, on])
        return points, self._faces[of]

    def on(
        self, other: _Shell, tolerance: float
    ) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
        """Own faces and those of ``other`` that lie within ``tolerance`` metres of them."""
        near = (self._points >= other.low - tolerance) & (self._points <= other.high + tolerance)
        rows = np.nonzero(near.all(1))[0]
        if not len(rows):
            return np.zeros(0, np.int32), np.zeros(0, np.int32)
        points = self._points[rows]
        place, hit = other.nearest(points)
        touching = np.linalg.norm(place - points, axis=1) <= tolerance
        return self._of[rows[touching]], other._faces[hit[touching]]

    def nearest(
        self, points: npt.NDArray[np.float32]
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int64]]:
        """(N, 3) the nearest places on the shell, and (N,) which of its faces they are on."""
        import open3d as o3d

        if self._scene is None:
            self._scene = o3d.t.geometry.RaycastingScene()
            corners = np.arange(3 * len(self._triangles), dtype=np.uint32).reshape(-1, 3)
            self._scene.add_triangles(
                o3d.core.Tensor.from_numpy(self._triangles.reshape(-1, 3)),
                o3d.core.Tensor.from_numpy(corners),
            )
        found = self._scene.compute_closest_points(o3d.core.Tensor.from_numpy(points))
        return found["points"].numpy(), found["primitive_ids"].numpy().astype(np.int64)
