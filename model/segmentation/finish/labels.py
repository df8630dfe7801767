"""Finish labels: from the parts' superpoints to one label per face or point.

In this order: small components (clouds), superpoints that clicks divide, local refinement, the
majority of each large face's nodes, whole facets and shells, attached shells (meshes), and last the
prompts themselves, which hold exactly.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial import KDTree

from model.core.asset import Asset
from model.geometry.topology import coincident_faces
from model.segmentation.arrays import Bool, Int64, Labels
from model.segmentation.encode.encoding import Encoding
from model.segmentation.finish.attached_shells import AttachedShells, find_attached_shells
from model.segmentation.finish.facets import FaceGroups, find_facets
from model.segmentation.finish.local_refinement import LocalRefinement, RefinedPart
from model.segmentation.finish.small_components import with_small_components
from model.segmentation.part_state import PartState
from model.segmentation.prompt_steps import ClickStep, RegionStep, Step, enforce, surface_steps
from model.segmentation.prompts import BASE


class LabelFinisher:
    """Turns the parts of superpoints into labels of elements.

    Attributes:
        weight: (E,) area of each face, 1 for points.
        first_of: (E,) the first of the faces that coincide with each one; None without any.
        attached: small shells of a mesh and their neighbours; None for a cloud.
        joins_components: whether small components join the part beside them.
        refinement: of small parts; None in a room.
    """

    def __init__(
        self, asset: Asset, encoding: Encoding, refinement: LocalRefinement | None
    ) -> None:
        self.refinement = refinement
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

    def labels(
        self,
        steps: tuple[Step, ...],
        parts: Mapping[int, PartState],
        refined: Mapping[int, RefinedPart],
    ) -> Labels:
        """(E,) labels of the prompts ``steps`` that led to ``parts``."""
        elements = self._encoding.nodes.elements
        on_surface = surface_steps(steps)
        of_superpoint = self.of_superpoints(parts, on_surface)
        of_node = of_superpoint[self._encoding.superpoints.of_node]
        self._divide_superpoints(of_node, of_superpoint, on_surface)
        if self.refinement is not None:
            self.refinement.apply(of_node, refined)
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
