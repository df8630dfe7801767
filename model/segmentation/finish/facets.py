"""What a modelled mesh is made of: plates (flat polygons) and small disconnected shells.

A modelled panel is a few coplanar triangles, and the borders between them mean nothing: a part
takes a plate as a whole or not at all. Larger flat regions come from scans and grids, where a cut
may well run through. A small shell among several is a thing of its own (a handle, a drawer's box);
it is split only where the clicks say so.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from model.core.mesh import Mesh
from model.segmentation.prompt_steps import ClickStep, Step
from model.segmentation.prompts import BASE

FLAT = 0.01
"""Radians between faces up to which they count as coplanar."""

MOST_FACES = 12
SHELL_SHARE = 0.25
"""Of the mesh's area: larger shells may be several parts that were modelled or scanned as one."""

LEAST_SHELLS = 3


@dataclass(frozen=True, eq=False)
class Plates:
    """Groups of faces that belong together.

    Attributes:
        of_face: (F,) int32 the group of each face, -1 for faces that belong to none.
        weight: (F,) float64 areas in m².
        number: of groups.
        splits: whether prompts of several parts in one group leave it as it is.
    """

    of_face: npt.NDArray[np.int32]
    weight: npt.NDArray[np.float64]
    number: int
    splits: bool = False

    @cached_property
    def area(self) -> npt.NDArray[np.float64]:
        """(number,) m² of each group."""
        on = self.of_face >= 0
        total = np.bincount(self.of_face[on], self.weight[on], self.number)
        return np.asarray(total, np.float64)

    @cached_property
    def _members(
        self,
    ) -> tuple[slice | npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.float64]]:
        """The faces that are in a group, (M,) the group of each, and its weight."""
        at = np.flatnonzero(self.of_face >= 0)
        on = slice(None) if len(at) == len(self.of_face) else at
        return on, self.of_face[on].astype(np.int64), self.weight[on] + 1e-12

    def idle(self, labels: npt.NDArray[np.int16], steps: Iterable[Step]) -> npt.NDArray[np.bool_]:
        """(number,) groups that are the base's altogether and of which no prompt speaks."""
        out = np.ones(self.number + 1, bool)  # the last one is of faces in no group
        out[self.of_face[labels != BASE]] = False
        out = out[:-1]
        for step in steps:
            faces = step.element if isinstance(step, ClickStep) else step.elements
            groups = np.atleast_1d(self.of_face[faces])
            out[groups[groups >= 0]] = False
        return out

    def whole(self, labels: npt.NDArray[np.int16], steps: Iterable[Step]) -> npt.NDArray[np.int16]:
        """Labels (F,) with every group in one part: that of its last positive click, else the
        one that has most of its area, among the parts that no click refuses there.
        """
        steps = tuple(steps)
        if not self.number:
            return labels
        disputed = self._disputed(steps) if self.splits else None
        on, plate, weight = self._members
        label = labels[on]
        width = int(max(labels.max(), max((s.part for s in steps), default=0))) + 1
        votes = np.bincount(plate * width + label, weight, self.number * width)
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
        winner = votes.argmax(axis=1)[plate]
        out[on] = winner if disputed is None else np.where(disputed[plate], label, winner)
        return out

    def _disputed(self, steps: tuple[Step, ...]) -> npt.NDArray[np.bool_]:
        """(number,) groups in which prompts speak of several parts, or refuse one."""
        out = np.zeros(self.number, bool)
        said: dict[int, int] = {}
        for step in steps:
            if isinstance(step, ClickStep):
                group = int(self.of_face[step.element])
                if group >= 0:
                    out[group] |= (
                        not step.positive or said.setdefault(group, step.part) != step.part
                    )
            else:
                groups = self.of_face[step.elements]
                out[groups[groups >= 0]] = True
        return out


def plates_of(mesh: Mesh) -> Plates:
    """The plates of ``mesh``: connected, coplanar, of one material, of at most a dozen faces."""
    from model.geometry.topology import face_adjacency

    adjacency = face_adjacency(mesh)
    pairs = np.asarray(adjacency.pairs)
    flat = np.abs(np.asarray(adjacency.angle)) < FLAT
    flat &= mesh.face_material[pairs[:, 0]] == mesh.face_material[pairs[:, 1]]
    a, b = pairs[flat].T
    count = len(mesh.faces)
    links = coo_matrix((np.ones(len(a), np.int8), (a, b)), shape=(count, count))
    _, group = connected_components(links, directed=False)
    size = np.bincount(group, minlength=1)[group]
    is_plate = (size > 1) & (size <= MOST_FACES)
    of_face = np.full(count, -1, np.int32)
    ids, of_face[is_plate] = np.unique(group[is_plate], return_inverse=True)
    return Plates(of_face, np.asarray(mesh.face_areas, np.float64), len(ids))


def small_shells_of(mesh: Mesh, shell: npt.NDArray[np.integer]) -> Plates:
    """The disconnected shells of ``mesh`` that are small enough to be one thing each.

    Args:
        shell: (F,) the shell of each face.
    """
    area = np.asarray(mesh.face_areas, np.float64)
    total = np.bincount(shell, area)
    of_face = np.full(len(shell), -1, np.int32)
    small = (total <= SHELL_SHARE * total.sum())[shell]
    if len(total) < LEAST_SHELLS or not small.any():
        return Plates(of_face, area, 0, True)
    ids, of_face[small] = np.unique(shell[small], return_inverse=True)
    return Plates(of_face, area, len(ids), True)
