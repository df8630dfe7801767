"""Drawers' trays on modelled meshes: what is fastened to a front alone goes with it.

Nobody sees a closed drawer's tray, so nobody clicks it, and no border that the surface shows
tells it from the carcass that it slides in. What it touches does.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from model.geometry.mesh import Mesh
from model.segmentation.contacts import contacts_of
from model.segmentation.plates import Plates
from model.segmentation.prompt_steps import Step
from model.segmentation.prompts import BASE

_OF_BASE = 0.4
"""Of what is the base's: a larger piece behind a front is the carcass."""
_FLAT = 0.5
"""Of the shorter side: a front is no thicker than this, its handle included."""
_STANDS_OUT = 0.02
"""Of the front's diagonal: how far a tray may stand out at its sides."""


@dataclass(frozen=True, eq=False)
class Trays:
    """What the small shells of a mesh are fastened to.

    Attributes:
        mesh: faces in metres, z up.
        shells: the small shells.
        shell, face: (K,) pairs of a small shell and a face of another shell that it touches.
    """

    mesh: Mesh
    shells: Plates
    shell: npt.NDArray[np.int64]
    face: npt.NDArray[np.int32]

    def pulled(self, labels: npt.NDArray[np.int16], steps: Iterable[Step]) -> npt.NDArray[np.int16]:
        """Labels (F,) where shells that are fastened to one upright front alone belong to it.

        They have to be the base's so far, no prompt may speak of them, and they have to lie behind
        the front: within its outline, and less than is left of the base.
        """
        if not len(self.shell):
            return labels
        of_face, number = self.shells.of_face, self.shells.number
        idle = self.shells.idle(labels, steps)
        other = of_face[self.face]
        loose = idle[self.shell] & (other >= 0) & idle[other]
        links = coo_matrix(
            (np.ones(int(loose.sum()), np.int8), (self.shell[loose], other[loose])),
            shape=(number, number),
        )
        count, piece = connected_components(links, directed=False)
        asked = idle[self.shell] & ~loose
        at, part = piece[self.shell[asked]], labels[self.face[asked]]
        least, most = np.full(count, np.iinfo(np.int16).max), np.full(count, BASE)
        np.minimum.at(least, at, part)
        np.maximum.at(most, at, part)
        area = np.bincount(piece, self.shells.area * idle, count)
        joins = (least == most) & (most != BASE)
        joins &= area <= _OF_BASE * self.shells.weight[labels == BASE].sum()
        out = labels.copy()
        for p in np.unique(most[joins]):
            outline = self._outline(labels == p)
            if outline is None:
                continue
            for k in np.nonzero(joins & (most == p))[0]:
                faces = (of_face >= 0) & (idle & (piece == k))[of_face]
                corners = self.mesh.triangles[faces].reshape(-1, 3)
                if (corners.min(0) >= outline[0]).all() and (corners.max(0) <= outline[1]).all():
                    out[faces] = p
        return out

    def _outline(
        self, front: npt.NDArray[np.bool_]
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]] | None:
        """Lowest and highest coordinates of what can lie behind ``front``, None if it is none."""
        corners = self.mesh.triangles[front].reshape(-1, 3).astype(np.float64)
        low, high = corners.min(0), corners.max(0)
        size = high - low
        thin = int(size[:2].argmin())
        if size[thin] > _FLAT * np.delete(size, thin).min():
            return None
        margin = _STANDS_OUT * float(np.linalg.norm(size))
        low, high = low - margin, high + margin
        low[thin], high[thin] = -np.inf, np.inf
        return low, high


def trays_of(mesh: Mesh, shells: Plates) -> Trays:
    """What the small shells of ``mesh`` are fastened to."""
    from model.geometry.topology import connected_shells

    none = np.zeros(0, np.int32)
    if not shells.number:
        return Trays(mesh, shells, none.astype(np.int64), none)
    mine, face = contacts_of(mesh, np.asarray(connected_shells(mesh)), shells.of_face >= 0)
    return Trays(mesh, shells, shells.of_face[mine].astype(np.int64), face)
