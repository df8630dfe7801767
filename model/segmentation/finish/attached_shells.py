"""What goes with a part of a modelled mesh though nobody clicked it: fittings and trays.

Small shells that the prompts leave to the base belong to the part that they are fastened to: a bar
on two posts to the door under the posts, a tray to the front that it hangs on. What truly touches
tells most; where nothing does, what lies beside it in the node graph.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.core.mesh import Mesh
from model.segmentation.encode.graph import components
from model.segmentation.finish.contacts import contacts_of
from model.segmentation.finish.facets import Plates, small_shells_of
from model.segmentation.prompt_steps import Step
from model.segmentation.prompts import BASE

_LEAST_TOUCHES = 3
_ALONE = 0.8
_MOSTLY = 0.5
_FITTING_SHARE = 0.3
"""Of the part's area: what is larger is no handle."""

_SPECK = 3e-4
"""Of the mesh: what is smaller and fastened to a part is none of its own unless it is clicked."""

_SPECK_OF_PART = 0.1
"""What is smaller may be beside the part by mistake."""

_BAR_SHARE = 0.01
"""Of the mesh: a handle has no more."""
_BAR_MOUNT, _BAR_PIECES = 4.0, 10.0
"""How much more surface what a bar is mounted on has, and the largest of its pieces has than the
one that was clicked, at most.
"""
_BAR_LENGTH, _BAR_OUT, _BAR_THROUGH = 3.0, 0.8, 0.3
"""How many times as long as wide a bar is; in its width, how far it stands out, and how thick what
it is mounted on is at least.
"""
_ALONG = 0.9
"""Least cosine between the normals of a flat front."""

_TRAY_OF_BASE = 0.4
"""Of what is the base's: a larger piece behind a front is the carcass."""
_FLAT = 0.5
"""Of the shorter side: a front is no thicker than this, its handle included."""
_STANDS_OUT = 0.02
"""Of the front's diagonal: how far a tray may stand out at its sides."""

Bool = npt.NDArray[np.bool_]
Labels = npt.NDArray[np.int16]


@dataclass(frozen=True, eq=False)
class Pairs:
    """Small shells and faces of other shells beside them.

    Attributes:
        shell: (K,) the small shell.
        face: (K,) the face of another shell.
    """

    shell: npt.NDArray[np.int64]
    face: npt.NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Idle shells that hang together, and the parts that they lie beside.

    Attributes:
        of_shell: (S,) the piece of each small shell.
        area: (P,) m².
        votes: (P, width) how many pairs each piece has with each part.
    """

    of_shell: npt.NDArray[np.int32]
    area: npt.NDArray[np.float64]
    votes: npt.NDArray[np.int64]


def _alone(
    votes: npt.NDArray[np.int64], share: float = 1.0, least: int = 1
) -> tuple[Bool, npt.NDArray[np.int64]]:
    """(P,) pieces that lie beside one part alone, by ``share`` of their pairs, and which."""
    total, best = votes.sum(1), votes.argmax(1)
    return (total >= least) & (votes.max(1) >= share * total) & (best != BASE), best


@dataclass(frozen=True, eq=False)
class Fittings:
    """What the small shells of a mesh are fastened to.

    Attributes:
        mesh: faces in metres, z up.
        shells: the small shells.
        touching: pairs in contact, measured to the triangles.
        beside: neighbours in the node graph.
    """

    mesh: Mesh
    shells: Plates
    touching: Pairs
    beside: Pairs

    def joined(self, labels: Labels, steps: Iterable[Step]) -> Labels:
        """Labels (F,) where shells left to the base belong to the one part they are fastened to.

        Shells that a prompt speaks of stay as they are.
        """
        if not self.shells.number or not labels.any():
            return labels
        steps = tuple(steps)
        labels = self._mounted(labels, steps)
        return self._pulled(labels, steps)

    def merged(self, labels: Labels) -> Labels:
        """Labels (F,) where trays that are parts of their own are one with their fronts.

        So are specks with what they are mounted on.
        """
        out, weight = labels, self.shells.weight
        if not self.shells.number:
            return labels
        for part in np.unique(labels[labels != BASE]):
            own = labels == part
            rest = np.where(own, BASE, out).astype(np.int16)
            joined = self._pulled(rest, ())[own]
            if weight[own].sum() <= _SPECK * weight.sum():
                joined = self._mounted(rest, ())[own]
            if joined[0] != BASE and (joined == joined[0]).all():
                out = np.where(own, joined[0], out).astype(np.int16)
        return out

    def freed(self, labels: Labels) -> Labels:
        """Labels (F,) where specks are the base's, so that what they are fastened to decides.

        A mask that is nearly a drawer has knuckles of the hinge beside it. Parts that are hardly
        more than a speck themselves, as keys are, stay.
        """
        of_face, weight = self.shells.of_face, self.shells.weight
        small = np.append(self.shells.area, np.inf)[of_face]
        part = np.bincount(labels, weight)[labels]
        speck = (small <= _SPECK * weight.sum()) & (small <= _SPECK_OF_PART * part)
        return np.where(speck, BASE, labels).astype(np.int16)

    def mount(self, face: int) -> int | None:
        """A face beside the bar that ``face`` is of, on what the bar is mounted on, a door's
        handle say; None where ``face`` is of no bar.

        A bar is some small shells in contact, longer than wide, and standing out at least as far as
        it is wide.
        """
        shell = int(self.shells.of_face[face])
        if shell < 0:
            return None
        area, all_area = self.shells.area, float(self.shells.weight.sum())
        small = area <= min(_BAR_SHARE * all_area, _BAR_PIECES * area[shell])
        if not small[shell]:
            return None
        one, two = self.touching.shell, self.shells.of_face[self.touching.face]
        near = (two >= 0) & small[one] & small[two]
        _, piece = components(self.shells.number, one[near], two[near])
        own = small & (piece == piece[shell])
        if area[own].sum() > _BAR_SHARE * all_area:
            return None
        faces = self._beside(own)
        if not len(faces):
            return None
        normals = self.mesh.face_normals[faces]
        # What it lies beside faces mostly to one side.
        main = normals[np.abs(normals @ normals.T).sum(0).argmax()]
        flat = faces[np.abs(normals @ main) > _ALONG]
        corners = self._corners(self._faces(own)).astype(np.float64)
        out = corners @ main
        plane = corners - out[:, None] * main
        _, _, axes = np.linalg.svd(plane - plane.mean(0), full_matrices=False)
        long, wide = np.ptp(plane @ axes[:2].T, axis=0)
        if long < _BAR_LENGTH * wide or np.ptp(out) < _BAR_OUT * wide:
            return None
        # Posts reach through a drawer's front to what is behind it.
        apart = self.mesh.vertices[self.mesh.faces[flat]].mean(1) - corners.mean(0)
        off = np.abs(apart @ main)
        close = np.flatnonzero(off < off.min() + _BAR_THROUGH * wide)
        return int(flat[close[(apart[close] ** 2).sum(1).argmin()]])

    def _beside(self, own: Bool) -> npt.NDArray[np.int32]:
        """Faces of larger shells beside some small ones, or in contact with them."""
        least = _BAR_MOUNT * self.shells.area[own].sum()
        for pairs in (self.beside, self.touching):
            two = self.shells.of_face[pairs.face]
            larger = (two < 0) | (self.shells.area[two] > least)
            chosen = own[pairs.shell] & larger
            if chosen.any():
                return np.unique(pairs.face[chosen])
        return np.zeros(0, np.int32)

    def _mounted(self, labels: Labels, steps: tuple[Step, ...]) -> Labels:
        """Labels where pieces that are small beside the part they lie on belong to it."""
        idle = self.shells.idle(labels, steps)
        if not idle.any():
            return labels
        # What is larger than any part's fitting is what they may be mounted on.
        part_area = np.bincount(labels, self.shells.weight)
        idle &= self.shells.area <= _FITTING_SHARE * part_area[BASE + 1 :].max(initial=0.0)
        pieces = self._pieces(labels, idle, self.beside)
        joins, best = _alone(pieces.votes, _ALONE, _LEAST_TOUCHES)
        # Where nothing else is touched, less of what lies beside is enough.
        nearly, _ = _alone(pieces.votes, _MOSTLY, _LEAST_TOUCHES)
        count = len(pieces.area)
        votes = self._votes(labels, idle, pieces.of_shell, count, self.touching)
        touched, only = _alone(votes)
        joins |= nearly & touched & (only == best)
        joins &= pieces.area <= _FITTING_SHARE * part_area[best]
        return self._moved(labels, idle, pieces, joins, best)

    def _pulled(self, labels: Labels, steps: tuple[Step, ...]) -> Labels:
        """Labels where pieces that are fastened to one upright front alone belong to it.

        They have to lie behind the front: within its outline, and less than is left of the base.
        Nobody sees a closed drawer's tray, so nobody clicks it.
        """
        idle = self.shells.idle(labels, steps)
        pieces = self._pieces(labels, idle, self.touching)
        joins, best = _alone(pieces.votes)
        joins &= pieces.area <= _TRAY_OF_BASE * self.shells.weight[labels == BASE].sum()
        for part in np.unique(best[joins]):
            outline = self._outline(labels == part)
            for piece in np.nonzero(joins & (best == part))[0]:
                faces = self._faces(idle & (pieces.of_shell == piece))
                joins[piece] = outline is not None and _within(self._corners(faces), outline)
        return self._moved(labels, idle, pieces, joins, best)

    def _pieces(self, labels: Labels, idle: Bool, pairs: Pairs) -> _Pieces:
        one, two = pairs.shell, self.shells.of_face[pairs.face]
        loose = idle[one] & (two >= 0) & idle[two]
        count, piece = components(self.shells.number, one[loose], two[loose])
        area = np.asarray(np.bincount(piece, self.shells.area * idle, count), np.float64)
        return _Pieces(piece, area, self._votes(labels, idle, piece, count, pairs))

    def _votes(
        self, labels: Labels, idle: Bool, piece: npt.NDArray[np.int32], count: int, pairs: Pairs
    ) -> npt.NDArray[np.int64]:
        """(P, width) how many pairs each piece has with each part, or with what is not idle."""
        two, width = self.shells.of_face[pairs.face], int(labels.max()) + 1
        asked = idle[pairs.shell] & ~((two >= 0) & idle[two])
        key = piece[pairs.shell[asked]] * width + labels[pairs.face[asked]]
        return np.bincount(key, minlength=count * width).reshape(count, width)

    def _faces(self, shells: Bool) -> Bool:
        return (self.shells.of_face >= 0) & shells[self.shells.of_face]

    def _moved(
        self, labels: Labels, idle: Bool, pieces: _Pieces, joins: Bool, best: npt.NDArray[np.int64]
    ) -> Labels:
        joined = idle & joins[pieces.of_shell]
        if not joined.any():
            return labels
        moved = self._faces(joined)
        out = labels.copy()
        out[moved] = best[pieces.of_shell[self.shells.of_face[moved]]]
        return out

    def _corners(self, faces: Bool) -> npt.NDArray[np.floating]:
        return self.mesh.vertices[self.mesh.faces[faces].reshape(-1)]

    def _outline(self, front: Bool) -> npt.NDArray[np.float64] | None:
        """(2, 3) lowest and highest coordinates of what can lie behind an upright front."""
        corners = self._corners(front)
        box = np.stack([corners.min(0), corners.max(0)]).astype(np.float64)
        size = box[1] - box[0]
        thin = int(size[:2].argmin())
        if size[thin] > _FLAT * np.delete(size, thin).min():
            return None
        margin = _STANDS_OUT * float(np.linalg.norm(size))
        box += [[-margin], [margin]]
        box[:, thin] = -np.inf, np.inf
        return box


def _within(corners: npt.NDArray[np.floating], box: npt.NDArray[np.float64]) -> bool:
    return bool((corners.min(0) >= box[0]).all() and (corners.max(0) <= box[1]).all())


def fittings_of(mesh: Mesh, a: npt.NDArray[np.integer], b: npt.NDArray[np.integer]) -> Fittings:
    """What the small shells of ``mesh`` are fastened to.

    Args:
        a, b: (M,) faces that lie beside each other.
    """
    from model.geometry.topology import connected_shells

    shell = np.asarray(connected_shells(mesh))
    shells = small_shells_of(mesh, shell)
    of_face = shells.of_face
    one, two = np.zeros((2, 0), np.int32)
    if shells.number:
        one, two = contacts_of(mesh, shell, of_face >= 0)
    mine = np.concatenate([of_face[a], of_face[b]]).astype(np.int64)
    face = np.concatenate([b, a]).astype(np.int32)
    keep = (mine >= 0) & (mine != of_face[face])
    beside = Pairs(mine[keep], face[keep])
    return Fittings(mesh, shells, Pairs(of_face[one].astype(np.int64), two), beside)
