"""Finish labels: from the parts' superpoints to one label per face or point.

In this order: small components (clouds), superpoints that clicks divide, the majority of each large
face's nodes, whole facets and shells, attached shells (meshes), and last the prompts themselves,
which hold exactly.

A small component of the base beside one part alone belongs to that part: a handle in front of a
door, its window, a hole that the clicks left. A small shell that nobody clicked goes to the part it
is attached to: a bar on two posts goes with the door under the posts, a tray with the front that it
hangs on. Contacts, measured to the triangles, decide first; without any, neighbours in the node
graph.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from model.core.asset import Asset
from model.core.geometry import Mesh
from model.geometry.topology import coincident_faces, connected_shells
from model.segmentation.arrays import Bool, Float, Float64, Int, Int32, Int64, Labels
from model.segmentation.encoding import Encoding
from model.segmentation.facets import FaceGroups, contacts_of, find_facets, find_small_shells
from model.segmentation.graph import components
from model.segmentation.prompt_steps import ClickStep, RegionStep, Step, enforce, surface_steps
from model.segmentation.prompts import BASE
from model.segmentation.proposals import PartState
from model.segmentation.superpoints import Superpoints

_WITH_ONE_PART = 0.8
"""Share of its links that a component has with one part to lie beside that alone."""
_SHARE_OF_PART = 0.15
"""Largest share of the part's size; more is no handle."""


def with_small_components(
    superpoints: Superpoints, of_superpoint: Labels, steps: tuple[Step, ...]
) -> Labels:
    """``of_superpoint`` (C,) with the base's small components in the part beside them.

    Components that a prompt gives to another part stay, and so do those beside a part that the
    person drew last: its handle is drawn with it or left out.
    """
    links = superpoints.links
    width, free = int(of_superpoint.max()) + 1, of_superpoint == BASE
    one, two = free[links.a], free[links.b]
    inner = one & two
    count, component = components(len(superpoints), links.a[inner], links.b[inner])
    size = np.bincount(component[free], superpoints.size[free], count)
    out, back = np.flatnonzero(one & ~two), np.flatnonzero(two & ~one)
    mine = np.concatenate([links.a[out], links.b[back]])
    beside = np.concatenate([links.b[out], links.a[back]])
    weight = links.count[np.concatenate([out, back])]
    key = component[mine].astype(np.int64) * width + of_superpoint[beside]
    votes = np.bincount(key, weight, count * width).reshape(count, width)
    best = votes.argmax(1)
    part_size = np.bincount(of_superpoint, superpoints.size, width)
    joins = (best != BASE) & (votes.max(1) >= _WITH_ONE_PART * votes.sum(1))
    joins &= size <= _SHARE_OF_PART * part_size[best]
    joins[size.argmax()] = False  # the base keeps at least its largest component
    last = {step.part: step for step in steps}
    drawn = [part for part, step in last.items() if isinstance(step, RegionStep)]
    if drawn:
        joins &= ~np.isin(best, drawn)
    for step in steps:
        # What a positive prompt claimed and is in the base now was taken back since.
        if step.positive and step.part != BASE:
            continue
        nodes = step.node if isinstance(step, ClickStep) else step.nodes
        touched = np.unique(component[superpoints.of_node[nodes]])
        joins[touched] &= (not step.positive) & (best[touched] != step.part)
    return np.where(free & joins[component], best[component], of_superpoint).astype(np.int16)


_LEAST_PAIRS = 3
_ALONE, _MOSTLY = 0.8, 0.5
"""Shares of its pairs that an assembly has with one part: by itself, and if nothing else touches
it."""
_ATTACHED_SHARE = 0.3
"""Largest share of the part's area; more is no handle."""
_TINY, _TINY_OF_PART = 3e-4, 0.1
"""Shares of the mesh and of the part below which a shell is no part by itself unless clicked."""
_BAR_SHARE = 0.01
"""Largest share of the mesh that a handle has."""
_BAR_MOUNT, _BAR_SHELLS = 4.0, 10.0
"""Least ratio of area between the shell behind a bar and the bar; largest between a bar's shells
and the clicked one."""
_BAR_LENGTH, _BAR_OUT, _BAR_THROUGH = 3.0, 0.8, 0.3
"""In a bar's width: its least length, how far it stands out, least thickness of the panel."""
_ALONG = 0.9
"""Least cosine between the normals of a flat front."""
_TRAY_OF_BASE = 0.4
"""Share of the base's area above which an assembly behind a front is the carcass."""
_FLAT = 0.5
"""Largest ratio of a front's thickness, with its handle, to its shorter side."""
_STANDS_OUT = 0.02
"""Most that a tray stands out at the sides of its front, in the front's diagonal."""


@dataclass(frozen=True, eq=False)
class Pairs:
    """Small shells and faces of other shells next to them.

    Attributes:
        shell: (K,) the small shell.
        face: (K,) the face of another shell.
    """

    shell: Int64
    face: Int32


@dataclass(frozen=True, eq=False)
class _Assemblies:
    """Unclaimed shells that are connected, and the parts next to them.

    Attributes:
        of_shell: (S,) the assembly of each small shell.
        area: (P,) m².
        votes: (P, width) pairs of each assembly with each part.
    """

    of_shell: Int32
    area: Float64
    votes: Int64


def _with_one_part(votes: Int64, share: float = 1.0, least: int = 1) -> tuple[Bool, Int64]:
    """(P,) assemblies that have ``share`` of their pairs with one part, and (P,) that part."""
    total, best = votes.sum(1), votes.argmax(1)
    return (total >= least) & (votes.max(1) >= share * total) & (best != BASE), best


@dataclass(frozen=True, eq=False)
class AttachedShells:
    """The small shells of a mesh and their neighbours.

    Attributes:
        mesh: faces in metres, z up.
        shells: the small shells.
        touching: pairs in contact, measured to the triangles.
        beside: neighbours in the node graph.
    """

    mesh: Mesh
    shells: FaceGroups
    touching: Pairs
    beside: Pairs

    def attach(self, labels: Labels, steps: Iterable[Step]) -> Labels:
        """Labels (F,) with the base's shells in the one part that they are attached to.

        Shells that a prompt touches stay as they are.
        """
        if not self.shells.number or not labels.any():
            return labels
        steps = tuple(steps)
        labels = self._with_mounted(labels, steps)
        return self._with_trays(labels, steps)

    def merge_trays(self, labels: Labels) -> Labels:
        """Labels (F,) with trays that are parts by themselves merged into their fronts.

        Tiny parts are merged into the part that they are mounted on.
        """
        out, weight = labels, self.shells.weight
        if not self.shells.number:
            return labels
        for part in np.unique(labels[labels != BASE]):
            own = labels == part
            rest = np.where(own, BASE, out).astype(np.int16)
            joined = self._with_trays(rest, ())[own]
            if weight[own].sum() <= _TINY * weight.sum():
                joined = self._with_mounted(rest, ())[own]
            if joined[0] != BASE and (joined == joined[0]).all():
                out = np.where(own, joined[0], out).astype(np.int16)
        return out

    def release_tiny(self, labels: Labels) -> Labels:
        """Labels (F,) with tiny shells returned to the base, so that their contacts decide.

        A mask that is nearly a drawer holds knuckles of the hinge beside it. Parts that are hardly
        larger themselves, such as keys, stay.
        """
        of_face, weight = self.shells.of_face, self.shells.weight
        small = np.append(self.shells.area, np.inf)[of_face]
        part = np.bincount(labels, weight)[labels]
        tiny = (small <= _TINY * weight.sum()) & (small <= _TINY_OF_PART * part)
        return np.where(tiny, BASE, labels).astype(np.int16)

    def mount(self, face: int) -> int | None:
        """A face beside the bar that ``face`` belongs to, on the panel behind it.

        None if ``face`` belongs to no bar: some small shells in contact, longer than wide, and
        standing out about as far as they are wide.
        """
        bar = self._bar_shells(face)
        faces = np.zeros(0, np.int32) if bar is None else self._faces_beside(bar)
        if bar is None or not len(faces):
            return None
        normals = self.mesh.face_normals[faces]
        # Its neighbours face mostly to one side.
        main = normals[np.abs(normals @ normals.T).sum(0).argmax()]
        flat = faces[np.abs(normals @ main) > _ALONG]
        corners = self._corners(self._faces(bar)).astype(np.float64)
        out = corners @ main
        plane = corners - out[:, None] * main
        _, _, axes = np.linalg.svd(plane - plane.mean(0), full_matrices=False)
        long, wide = np.ptp(plane @ axes[:2].T, axis=0)
        if long < _BAR_LENGTH * wide or np.ptp(out) < _BAR_OUT * wide:
            return None
        # Posts reach through a drawer's front, and touch the shells behind it, too.
        apart = self.mesh.vertices[self.mesh.faces[flat]].mean(1) - corners.mean(0)
        off = np.abs(apart @ main)
        close = np.flatnonzero(off < off.min() + _BAR_THROUGH * wide)
        return int(flat[close[(apart[close] ** 2).sum(1).argmin()]])

    def _bar_shells(self, face: int) -> Bool | None:
        """(S,) the small shells in contact with that of ``face``, if together they are small."""
        shell = int(self.shells.of_face[face])
        if shell < 0:
            return None
        area, all_area = self.shells.area, float(self.shells.weight.sum())
        small = area <= min(_BAR_SHARE * all_area, _BAR_SHELLS * area[shell])
        if not small[shell]:
            return None
        one, two = self.touching.shell, self.shells.of_face[self.touching.face]
        near = (two >= 0) & small[one] & small[two]
        _, component = components(self.shells.number, one[near], two[near])
        own = small & (component == component[shell])
        return own if area[own].sum() <= _BAR_SHARE * all_area else None

    def _faces_beside(self, own: Bool) -> Int32:
        """Faces of larger shells beside some small ones, or in contact with them."""
        least = _BAR_MOUNT * self.shells.area[own].sum()
        for pairs in (self.beside, self.touching):
            two = self.shells.of_face[pairs.face]
            larger = (two < 0) | (self.shells.area[two] > least)
            chosen = own[pairs.shell] & larger
            if chosen.any():
                return np.unique(pairs.face[chosen])
        return np.zeros(0, np.int32)

    def _with_mounted(self, labels: Labels, steps: tuple[Step, ...]) -> Labels:
        """Labels with assemblies in the part that they lie on, if they are small beside it."""
        unclaimed = self.shells.unclaimed(labels, steps)
        if not unclaimed.any():
            return labels
        # Larger shells are what small ones may be mounted on.
        part_area = np.bincount(labels, self.shells.weight)
        most = _ATTACHED_SHARE * part_area[BASE + 1 :].max(initial=0.0)
        unclaimed &= self.shells.area <= most
        found = self._assemblies(labels, unclaimed, self.beside)
        joins, best = _with_one_part(found.votes, _ALONE, _LEAST_PAIRS)
        nearly, _ = _with_one_part(found.votes, _MOSTLY, _LEAST_PAIRS)
        count = len(found.area)
        votes = self._votes(labels, unclaimed, found.of_shell, count, self.touching)
        touched, only = _with_one_part(votes)
        joins |= nearly & touched & (only == best)
        joins &= found.area <= _ATTACHED_SHARE * part_area[best]
        return self._joined(labels, unclaimed, found, joins, best)

    def _with_trays(self, labels: Labels, steps: tuple[Step, ...]) -> Labels:
        """Labels with assemblies in the upright front that alone they touch.

        They have to lie behind the front, within its outline, and be less than the rest of the
        base. Nobody sees the tray of a closed drawer, so nobody clicks it.
        """
        unclaimed = self.shells.unclaimed(labels, steps)
        found = self._assemblies(labels, unclaimed, self.touching)
        joins, best = _with_one_part(found.votes)
        joins &= found.area <= _TRAY_OF_BASE * self.shells.weight[labels == BASE].sum()
        for part in np.unique(best[joins]):
            outline = self._outline(labels == part)
            for assembly in np.nonzero(joins & (best == part))[0]:
                faces = self._faces(unclaimed & (found.of_shell == assembly))
                joins[assembly] = outline is not None and _within(self._corners(faces), outline)
        return self._joined(labels, unclaimed, found, joins, best)

    def _assemblies(self, labels: Labels, unclaimed: Bool, pairs: Pairs) -> _Assemblies:
        one, two = pairs.shell, self.shells.of_face[pairs.face]
        loose = unclaimed[one] & (two >= 0) & unclaimed[two]
        count, component = components(self.shells.number, one[loose], two[loose])
        area = np.asarray(np.bincount(component, self.shells.area * unclaimed, count), np.float64)
        votes = self._votes(labels, unclaimed, component, count, pairs)
        return _Assemblies(component, area, votes)

    def _votes(
        self,
        labels: Labels,
        unclaimed: Bool,
        component: Int32,
        count: int,
        pairs: Pairs,
    ) -> Int64:
        """(P, width) pairs of each assembly with each part, and with other shells of the base."""
        two, width = self.shells.of_face[pairs.face], int(labels.max()) + 1
        counted = unclaimed[pairs.shell] & ~((two >= 0) & unclaimed[two])
        key = component[pairs.shell[counted]] * width + labels[pairs.face[counted]]
        return np.bincount(key, minlength=count * width).reshape(count, width)

    def _faces(self, shells: Bool) -> Bool:
        return (self.shells.of_face >= 0) & shells[self.shells.of_face]

    def _joined(
        self,
        labels: Labels,
        unclaimed: Bool,
        found: _Assemblies,
        joins: Bool,
        best: Int64,
    ) -> Labels:
        joined = unclaimed & joins[found.of_shell]
        if not joined.any():
            return labels
        changed = self._faces(joined)
        out = labels.copy()
        out[changed] = best[found.of_shell[self.shells.of_face[changed]]]
        return out

    def _corners(self, faces: Bool) -> Float:
        return self.mesh.vertices[self.mesh.faces[faces].reshape(-1)]

    def _outline(self, front: Bool) -> Float64 | None:
        """(2, 3) bounds of what can lie behind an upright front; None if it isn't flat."""
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


def _within(corners: Float, box: Float64) -> bool:
    return bool((corners.min(0) >= box[0]).all() and (corners.max(0) <= box[1]).all())


def find_attached_shells(mesh: Mesh, a: Int, b: Int) -> AttachedShells:
    """The small shells of ``mesh`` and their neighbours.

    Args:
        a, b: (M,) faces that lie beside each other.
    """
    shell = np.asarray(connected_shells(mesh))
    shells = find_small_shells(mesh, shell)
    of_face = shells.of_face
    one, two = np.zeros((2, 0), np.int32)
    if shells.number:
        one, two = contacts_of(mesh, shell, of_face >= 0)
    mine = np.concatenate([of_face[a], of_face[b]]).astype(np.int64)
    face = np.concatenate([b, a]).astype(np.int32)
    keep = (mine >= 0) & (mine != of_face[face])
    beside = Pairs(mine[keep], face[keep])
    return AttachedShells(mesh, shells, Pairs(of_face[one].astype(np.int64), two), beside)


class LabelFinisher:
    """Turns the parts of superpoints into labels of elements.

    Attributes:
        weight: (E,) area of each face, 1 for points.
        first_of: (E,) the first of the faces that coincide with each one; None without any.
        attached: small shells of a mesh and their neighbours; None for a cloud.
        joins_components: whether small components join the part beside them.
    """

    def __init__(self, asset: Asset, encoding: Encoding) -> None:
        self.first_of = None if asset.mesh is None else coincident_faces(asset.mesh)
        self.weight = np.ones(asset.element_count)
        self.attached: AttachedShells | None = None
        self._encoding = encoding
        # Shells tell what is attached on a mesh; in a room, things on a table are no part of it.
        self.joins_components = asset.mesh is None and encoding.room is None
        self._groups: tuple[FaceGroups, ...] = ()
        if asset.mesh is not None:
            self.weight = np.asarray(asset.mesh.face_areas, np.float64)
            graph, face = encoding.graph, encoding.nodes.elements.element_of_node
            a, b = face[graph.a[~graph.bridge]], face[graph.b[~graph.bridge]]
            self.attached = find_attached_shells(asset.mesh, a, b)
            self._groups = (find_facets(asset.mesh), self.attached.shells)

    def labels(self, steps: tuple[Step, ...], parts: Mapping[int, PartState]) -> Labels:
        """(E,) labels of the prompts ``steps`` that led to ``parts``."""
        elements = self._encoding.nodes.elements
        on_surface = surface_steps(steps)
        of_superpoint = self.of_superpoints(parts, on_surface)
        of_node = of_superpoint[self._encoding.superpoints.of_node]
        self._divide_superpoints(of_node, of_superpoint, on_surface)
        labels = elements.to_elements(of_node)
        if not steps:
            return labels
        labels = self._with_whole_groups(labels, steps)
        instead = self._instead(steps, of_superpoint, len(labels))
        labels = enforce(labels, steps, instead, _released(steps, labels))
        return labels if self.first_of is None else labels[self.first_of]

    def without_prompts(self, of_superpoint: Labels) -> Labels:
        """(E,) labels of parts of superpoints (C,) that come from something else than prompts."""
        of_superpoint = self.with_components(of_superpoint, ())
        of_node = of_superpoint[self._encoding.superpoints.of_node]
        labels = self._with_whole_groups(self._encoding.nodes.elements.to_elements(of_node), ())
        if self.attached is None:
            return labels
        return self.attached.attach(
            self.attached.merge_trays(self.attached.release_tiny(labels)), ()
        )

    def of_superpoints(self, parts: Mapping[int, PartState], steps: tuple[Step, ...]) -> Labels:
        """(C,) the part of each superpoint, on clouds with small components."""
        out = np.zeros(len(self._encoding.superpoints), np.int16)
        for part, state in parts.items():
            if state.mask is not None:
                out[state.mask] = part
        return self.with_components(out, steps)

    def with_components(self, of_superpoint: Labels, steps: tuple[Step, ...]) -> Labels:
        """(C,) the same with small components in the part beside them, on clouds."""
        if not self.joins_components:
            return of_superpoint
        return with_small_components(self._encoding.superpoints, of_superpoint, steps)

    def _with_whole_groups(self, labels: Labels, steps: tuple[Step, ...]) -> Labels:
        """``labels`` with undivided facets and shells, and with attached shells."""
        for groups in self._groups:
            labels = groups.unified(labels, steps)
        labels = labels if self.attached is None else self.attached.attach(labels, steps)
        return labels if self.first_of is None else labels[self.first_of]

    def _divide_superpoints(
        self, of_node: Labels, of_superpoint: Labels, steps: tuple[Step, ...]
    ) -> None:
        """Divide superpoints that were clicked for different parts: each node follows the nearest
        click. Changes ``of_node`` in place.
        """
        superpoints, points = self._encoding.superpoints, self._encoding.nodes.points
        clicked: dict[int, dict[int, ClickStep]] = {}
        for step in steps:
            if isinstance(step, ClickStep):
                clicked.setdefault(int(superpoints.of_node[step.node]), {})[step.node] = step
        for superpoint, clicks in clicked.items():
            if len(clicks) < 2:
                continue
            own = int(of_superpoint[superpoint])
            wanted = [
                s.part if s.positive else (own if own != s.part else BASE) for s in clicks.values()
            ]
            if len(set(wanted)) > 1:
                nodes = np.nonzero(superpoints.of_node == superpoint)[0]
                apart = points[nodes][:, None] - points[list(clicks)][None]
                nearest = np.linalg.norm(apart, axis=2).argmin(1)
                of_node[nodes] = np.array(wanted, np.int16)[nearest]

    def _instead(self, steps: tuple[Step, ...], of_superpoint: Labels, count: int) -> Labels:
        """(E,) labels of refused elements: the base, or the nearest part if the base is refused."""
        taken = np.nonzero(of_superpoint)[0]
        if not len(taken) or all(s.positive or s.part != BASE for s in steps):
            return np.zeros(count, np.int16)
        superpoints = self._encoding.superpoints
        _, near = KDTree(superpoints.center[taken]).query(superpoints.center)
        nearest = of_superpoint[taken[near]]
        instead = np.where(of_superpoint == BASE, nearest, BASE).astype(np.int16)
        return self._encoding.nodes.elements.to_elements(instead[superpoints.of_node])


def _released(steps: tuple[Step, ...], labels: Labels) -> dict[int, Bool]:
    """By the index of each region that a later click contradicts, the elements it loses.

    A click in a region of another part takes what that click's part takes; the rest stays.
    """
    out: dict[int, Bool] = {}
    for index, step in enumerate(steps):
        if not isinstance(step, RegionStep) or not len(step.elements):
            continue
        for later in steps[index + 1 :]:
            if not isinstance(later, ClickStep) or not _contains(step.elements, later.element):
                continue
            free = None
            if step.positive and later.positive and later.part != step.part:
                free = labels == later.part
            elif later.part == step.part and later.positive != step.positive:
                free = (labels == step.part) == later.positive
            if free is not None:
                out[index] = out[index] | free if index in out else free
    return out


def _contains(ordered: Int64, value: int) -> bool:
    at = int(np.searchsorted(ordered, value))
    return at < len(ordered) and int(ordered[at]) == value
