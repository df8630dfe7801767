"""Facets and shells of a modelled mesh: each stays in one part, and which shells touch.

A facet is a few coplanar triangles of a modelled panel, and the edges between them mean nothing: a
part takes it whole or not at all. Larger flat regions come from scans and grids, where a border may
run through. A small shell is an object by itself (a handle, a drawer's box) and is split only where
clicks say so.

Contacts of shells are measured to the triangles: the node graph joins shells that are a few
millimetres apart; a drawer's tray is as near to the carcass that it slides in.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from model.core.geometry import Mesh
from model.geometry.sampling import sample_surface
from model.geometry.topology import face_adjacency
from model.segmentation.arrays import Bool, Float32, Float64, Int, Int32, Int64, Labels
from model.segmentation.graph import components
from model.segmentation.prompt_steps import ClickStep, Step
from model.segmentation.prompts import BASE

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


FLAT = 0.01
"""Largest angle in radians between coplanar faces."""
MOST_FACES = 12
"""Most faces of a facet."""
SHELL_SHARE = 0.25
"""Share of the mesh's area above which a shell may be several parts in one."""
LEAST_SHELLS = 3
"""With fewer shells, none is small."""


@dataclass(frozen=True, eq=False)
class FaceGroups:
    """Groups of faces that belong together.

    Attributes:
        of_face: (F,) int32 the group of each face, -1 for faces in none.
        weight: (F,) float64 areas in m².
        number: of groups.
        divisible: whether prompts for several parts divide a group.
    """

    of_face: Int32
    weight: Float64
    number: int
    divisible: bool = False

    @cached_property
    def area(self) -> Float64:
        """(number,) m² of each group."""
        on = self.of_face >= 0
        total = np.bincount(self.of_face[on], self.weight[on], self.number)
        return np.asarray(total, np.float64)

    @cached_property
    def _members(self) -> tuple[slice | Int64, Int64, Float64]:
        """The faces in groups, (M,) the group of each, and (M,) its weight."""
        at = np.flatnonzero(self.of_face >= 0)
        on = slice(None) if len(at) == len(self.of_face) else at
        return on, self.of_face[on].astype(np.int64), self.weight[on] + 1e-12

    def unclaimed(self, labels: Labels, steps: Iterable[Step]) -> Bool:
        """(number,) groups that belong wholly to the base and that no prompt touches."""
        out = np.ones(self.number + 1, bool)  # the last one is of faces in no group
        out[self.of_face[labels != BASE]] = False
        out = out[:-1]
        for step in steps:
            faces = step.element if isinstance(step, ClickStep) else step.elements
            groups = np.atleast_1d(self.of_face[faces])
            out[groups[groups >= 0]] = False
        return out

    def unified(self, labels: Labels, steps: Iterable[Step]) -> Labels:
        """Labels (F,) with every group in one part.

        That is the part of its last positive click, else the one with most of its area among those
        that no click refuses there.
        """
        steps = tuple(steps)
        if not self.number:
            return labels
        divided = self._divided(steps) if self.divisible else None
        on, group, weight = self._members
        label = labels[on]
        width = int(max(labels.max(), max((s.part for s in steps), default=0))) + 1
        votes = np.bincount(group * width + label, weight, self.number * width)
        votes = votes.reshape(self.number, width)
        for step in steps:
            if isinstance(step, ClickStep) and self.of_face[step.element] >= 0:
                row = votes[self.of_face[step.element]]
                if step.positive:
                    row[:] = 0.0
                    row[step.part] = 1.0
                else:
                    row[step.part] = -1.0
        out = labels.copy()
        winner = votes.argmax(axis=1)[group]
        out[on] = winner if divided is None else np.where(divided[group], label, winner)
        return out

    def _divided(self, steps: tuple[Step, ...]) -> Bool:
        """(number,) groups that prompts give to several parts, or refuse."""
        out = np.zeros(self.number, bool)
        part_of: dict[int, int] = {}
        for step in steps:
            if isinstance(step, ClickStep):
                group = int(self.of_face[step.element])
                if group >= 0:
                    out[group] |= (
                        not step.positive or part_of.setdefault(group, step.part) != step.part
                    )
            else:
                groups = self.of_face[step.elements]
                out[groups[groups >= 0]] = True
        return out


def find_facets(mesh: Mesh) -> FaceGroups:
    """The facets of ``mesh``: connected, coplanar faces of one material, at most a dozen each."""
    adjacency = face_adjacency(mesh)
    pairs = np.asarray(adjacency.pairs)
    flat = np.abs(np.asarray(adjacency.angle)) < FLAT
    flat &= mesh.face_material[pairs[:, 0]] == mesh.face_material[pairs[:, 1]]
    _, group = components(len(mesh.faces), *pairs[flat].T)
    size = np.bincount(group, minlength=1)[group]
    return _grouped(mesh, group, (size > 1) & (size <= MOST_FACES), divisible=False)


def find_small_shells(mesh: Mesh, shell: Int) -> FaceGroups:
    """The connected shells of ``mesh`` that are small enough to be one object each.

    Args:
        shell: (F,) the shell of each face.
    """
    total = np.bincount(shell, np.asarray(mesh.face_areas, np.float64))
    small = (total <= SHELL_SHARE * total.sum())[shell]
    if len(total) < LEAST_SHELLS:
        small[:] = False
    return _grouped(mesh, shell, small, divisible=True)


def _grouped(mesh: Mesh, group: Int, members: Bool, *, divisible: bool) -> FaceGroups:
    of_face = np.full(len(mesh.faces), -1, np.int32)
    ids, of_face[members] = np.unique(group[members], return_inverse=True)
    return FaceGroups(of_face, np.asarray(mesh.face_areas, np.float64), len(ids), divisible)
