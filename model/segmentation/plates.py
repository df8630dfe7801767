"""Plates: the flat polygons that a modelled mesh is made of.

A modelled panel is a few coplanar triangles, and the borders between them mean nothing: a part
takes a plate as a whole or not at all. Larger flat regions come from scans and grids, where a cut
may well run through.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from model.geometry.mesh import Mesh
from model.segmentation.prompt_steps import ClickStep, Step

FLAT = 0.01
"""Radians between faces up to which they count as coplanar."""

MOST_FACES = 12


@dataclass(frozen=True, eq=False)
class Plates:
    """The plates of a mesh.

    Attributes:
        of_face: (F,) int32 the plate of each face, -1 for faces that belong to none.
        weight: (F,) float64 areas in m².
        number: of plates.
    """

    of_face: npt.NDArray[np.int32]
    weight: npt.NDArray[np.float64]
    number: int

    def whole(self, labels: npt.NDArray[np.int16], steps: Iterable[Step]) -> npt.NDArray[np.int16]:
        """Labels (F,) with every plate in one part: that of its last positive click, else the
        one that has most of its area, among the parts that no click refuses there.
        """
        if not self.number:
            return labels
        on = self.of_face >= 0
        plate, label = self.of_face[on], labels[on].astype(np.int64)
        width = int(max(labels.max(), max((s.part for s in steps), default=0))) + 1
        votes = np.bincount(plate * width + label, self.weight[on] + 1e-12, self.number * width)
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
        out[on] = votes.argmax(axis=1)[plate]
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
