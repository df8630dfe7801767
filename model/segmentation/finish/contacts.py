"""Find which connected shells of a modelled mesh touch each other, measured to the triangles.

The node graph joins shells that are a few millimetres apart; a drawer's tray is as near to the
carcass that it slides in.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from model.core.geometry import Mesh
from model.geometry.sampling import sample_surface
from model.segmentation.arrays import Bool, Float32, Int, Int32, Int64

TOUCHING = 1e-4
"""Share of the mesh's diagonal: 0.1 mm on a metre, more than the rounding of models."""

MOST_SHELLS = 400
"""The smallest shells of a scan beyond these are left out."""

_SAMPLES = 1500
_MOST_CORNERS = 20_000
"""Most corners tested of one shell: a scan has millions; shells on it are tested by their own."""


def contacts_of(mesh: Mesh, shell: Int, wanted: Bool) -> tuple[Int32, Int32]:
    """Faces at which shells touch.

    Args:
        shell: (F,) the shell of each face.
        wanted: (F,) faces of the shells whose contacts are requested.

    Returns:
        Two (K,) arrays: a face of a requested shell, and one of another shell that it touches.
    """
    faces = _faces_of_shells(shell)
    there = np.argsort(-np.bincount(shell, mesh.face_areas), kind="stable")[:MOST_SHELLS]
    tolerance = TOUCHING * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    triangles = mesh.triangles.astype(np.float32)
    shells = [_Shell(triangles[faces[s]], faces[s]) for s in there]
    low = np.array([s.low for s in shells]) - tolerance
    high = np.array([s.high for s in shells]) + tolerance
    close = ((low[:, None] <= high[None]) & (low[None] <= high[:, None])).all(2)
    chosen = np.isin(there, shell[wanted])
    close &= chosen[:, None] | chosen[None]
    mine: list[Int32] = []
    other: list[Int32] = []
    for i, j in zip(*np.nonzero(np.triu(close, 1)), strict=True):
        for one, two in ((shells[i], shells[j]), (shells[j], shells[i])):
            a, b = one.on(two, tolerance)
            mine += [a, b]
            other += [b, a]
    if not mine:
        return np.zeros(0, np.int32), np.zeros(0, np.int32)
    pairs = np.stack([np.concatenate(mine), np.concatenate(other)], 1)
    pairs = np.unique(pairs[wanted[pairs[:, 0]]], axis=0).astype(np.int32)
    return pairs[:, 0], pairs[:, 1]


def _faces_of_shells(shell: Int) -> list[Int64]:
    order = np.argsort(shell, kind="stable")
    return np.split(order, np.cumsum(np.bincount(shell))[:-1])


class _Shell:
    """One shell: points on it, and distances of other points to its triangles."""

    def __init__(self, triangles: Float32, faces: Int) -> None:
        self._faces = faces.astype(np.int32)
        self._triangles = triangles
        self.low = triangles.reshape(-1, 3).min(0)
        self.high = triangles.reshape(-1, 3).max(0)
        self._points, self._of = self._sampled()
        self._scene: Any = None

    def _sampled(self) -> tuple[Float32, Int32]:
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

    def on(self, other: _Shell, tolerance: float) -> tuple[Int32, Int32]:
        """Own faces and those of ``other`` that lie within ``tolerance`` metres of them."""
        near = (self._points >= other.low - tolerance) & (self._points <= other.high + tolerance)
        rows = np.nonzero(near.all(1))[0]
        if not len(rows):
            return np.zeros(0, np.int32), np.zeros(0, np.int32)
        points = self._points[rows]
        place, hit = other.nearest(points)
        touching = np.linalg.norm(place - points, axis=1) <= tolerance
        return self._of[rows[touching]], other._faces[hit[touching]]

    def nearest(self, points: Float32) -> tuple[Float32, Int64]:
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
