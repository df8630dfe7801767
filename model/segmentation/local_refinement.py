"""Finish small parts: answer their clicks on the nodes around the first one, not on superpoints.

A button of a remote is a few superpoints, so no union of superpoints has its outline, and every
click near its border takes one too many or too few. The few thousand nodes around the click, each a
superpoint of its own, form an object with merge trees, walks and boxes. Its encoding takes a tenth
of a second; clicks there take milliseconds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter

import numpy as np
from cachetools import LRUCache, cachedmethod
from scipy.spatial import KDTree

from model.segmentation.arrays import Bool, Float, Int16, Int32
from model.segmentation.encoding import Encoding, RandomWalk, build_hierarchy
from model.segmentation.graph import Graph, edge_weight
from model.segmentation.nodes import ElementMap, Nodes
from model.segmentation.prompt_steps import ClickStep, Step
from model.segmentation.prompts import BASE
from model.segmentation.proposals import PartState
from model.segmentation.scores import shipped_scorers
from model.segmentation.solver import PartSolver, ScoredProposals, object_solver, offered
from model.segmentation.superpoints import build_superpoints

SMALL = 0.012
"""Share of all nodes up to which a part is refined."""
_NODES = 4000
"""Nodes of a neighbourhood; with twice as many the smallest parts are chosen worse."""
_FITS = 0.4
"""Share of the neighbourhood above which a part doesn't fit into it."""
_CACHED = 12
"""Neighbourhoods, some megabytes each."""


@dataclass(frozen=True, eq=False)
class RefinedPart:
    """A part in its neighbourhood.

    Attributes:
        nodes: (K,) ascending, the whole object's nodes in the neighbourhood.
        state: the part's clicks and mask, over these nodes.
        scored: the proposals of its latest click.
    """

    nodes: Int32
    state: PartState
    scored: ScoredProposals

    def concerns(self, step: Step) -> bool:
        """True if a prompt touches the neighbourhood."""
        nodes = np.atleast_1d(step.node if isinstance(step, ClickStep) else step.nodes)
        place = np.searchsorted(self.nodes, nodes).clip(max=len(self.nodes) - 1)
        return bool((self.nodes[place] == nodes).any())


class Neighborhood:
    """The surroundings of a node, encoded like an object.

    Attributes:
        nodes: (K,) ascending, the whole object's nodes in it; each is a superpoint here.
    """

    def __init__(self, encoding: Encoding, anchor: int, axes: Float) -> None:
        nodes = encoding.nodes
        _, near = nodes.tree.query(nodes.points[anchor], k=min(_NODES, len(nodes)))
        self.nodes = np.sort(np.atleast_1d(near)).astype(np.int32)
        self._place = np.full(len(nodes), -1, np.int32)
        self._place[self.nodes] = np.arange(len(self.nodes), dtype=np.int32)
        self._encoding, self._axes = encoding, axes

    @cached_property
    def solver(self) -> PartSolver:
        """Made when a click first needs it: most prompts only confirm the mask."""
        nodes, graph = self._encoding.nodes, self._encoding.graph
        part, edges = _part_of(nodes, graph, self.nodes, self._place)
        strength = self._encoding.strength[edges]
        superpoints = build_superpoints(
            *part, strength, edge_weight(strength, part[1]), len(self.nodes)
        )
        # First clicks need no walk. SuperLU frees memory only on the thread that allocated it.
        walk = RandomWalk(superpoints, at_once=False)
        hierarchy = build_hierarchy(superpoints)
        scorers = shipped_scorers("mesh" if nodes.of_mesh else "local")
        return object_solver(
            superpoints, hierarchy, walk, *scorers, axes=self._axes, of_mesh=nodes.of_mesh
        )

    def after(
        self, known: RefinedPart | None, steps: tuple[Step, ...], part: int, blocked: Bool
    ) -> RefinedPart | None:
        """``part`` after ``steps``, None if it doesn't fit in here.

        Args:
            known: the part before them.
            blocked: (K,) nodes inside other parts.
        """
        state = known.state if known is not None else None
        scored = known.scored if known is not None else None
        foreign: list[int] = []
        for step in steps:
            if not isinstance(step, ClickStep):
                state = self._with_region(state, step.nodes, step.part == part, step.positive)
                continue
            node, own = int(self._place[step.node]), step.part == part
            if node < 0:
                continue
            if state is None or state.mask is None:
                if not own or not step.positive:
                    if not own and step.positive:
                        foreign.append(node)
                    continue
                state = PartState(negative=tuple(foreign))
            elif not own and not step.positive:
                continue
            positive = own and step.positive
            if state.mask is not None and bool(state.mask[node]) == positive:
                state = state.with_click(node, positive)
                continue
            free = blocked.copy()
            free[node] = False
            scored = self.solver.answer(state, node, positive, free)
            mask = self.solver.tidy(scored.best, state, node)
            state = self.solver.moved(state, node, positive, mask)
        if state is None or state.mask is None or scored is None:
            return None
        fits = 0 < state.mask.sum() <= _FITS * len(self.nodes)
        return RefinedPart(self.nodes, state, scored) if fits else None

    def _with_region(
        self, state: PartState | None, nodes: Int32, own: bool, positive: bool
    ) -> PartState | None:
        """``state`` after a region that the person drew or chose."""
        if state is None or state.mask is None or (not own and not positive):
            return state
        place = self._place[nodes]
        inside = np.zeros(len(self.nodes), bool)
        inside[place[place >= 0]] = True
        if not inside.any():
            return state
        mask = state.mask | inside if own and positive else state.mask & ~inside
        return replace(state, mask=mask, drawn=state.drawn + own)


def _part_of(
    nodes: Nodes, graph: Graph, kept: Int32, place: Int32
) -> tuple[tuple[Nodes, Graph], Int32]:
    """The nodes ``kept`` with their graph, and the edges between them.

    Args:
        place: (N,) of each node among those kept, -1 for the others.
    """
    edges = np.nonzero((place[graph.a] >= 0) & (place[graph.b] >= 0))[0].astype(np.int32)
    none, own = np.zeros(0, np.int32), np.arange(len(kept), dtype=np.int32)
    few = Nodes(
        nodes.points[kept],
        None,
        None if nodes.colors is None else nodes.colors[kept],
        nodes.shell[kept],
        nodes.material[kept],
        ElementMap(own, none, none, len(kept)),
        nodes.of_mesh,
    )
    among = Graph(
        place[graph.a[edges]],
        place[graph.b[edges]],
        graph.length[edges],
        graph.bridge[edges],
        np.zeros((len(kept), 0), np.int32),
        graph.spacing,
        graph.normals[kept],
        graph.rough_normals[kept],
        graph.variation[kept],
    )
    return (few, among), edges


class LocalRefinement:
    """Refines the small parts of an encoded object."""

    def __init__(self, encoding: Encoding, axes: Float) -> None:
        """``axes`` (3, 3): main directions of the whole object."""
        self._encoding, self._axes = encoding, axes
        self._cache: LRUCache = LRUCache(_CACHED)

    @cachedmethod(attrgetter("_cache"))
    def around(self, anchor: int) -> Neighborhood:
        """The neighbourhood of a node."""
        return Neighborhood(self._encoding, anchor, self._axes)

    def applies_to(self, mask: Bool) -> bool:
        """True if a mask over the object's superpoints (C,) is small enough to be refined."""
        size = self._encoding.superpoints.size
        return 0 < float(size[mask].sum()) <= SMALL * float(size.sum())

    def after(
        self,
        known: Mapping[int, RefinedPart],
        parts: Mapping[int, PartState],
        steps: tuple[Step, ...],
    ) -> dict[int, RefinedPart]:
        """The refined small parts after ``steps``.

        Args:
            known: the same before the last step.
            parts: all parts after it, in superpoints of the whole object.
        """
        of_node = self._encoding.superpoints.of_node
        out: dict[int, RefinedPart] = {}
        for part, state in parts.items():
            if state.mask is None or not self.applies_to(state.mask):
                continue
            anchor = next(
                (
                    s.node
                    for s in steps
                    if isinstance(s, ClickStep) and s.part == part and s.positive
                ),
                None,
            )
            if anchor is None:
                continue
            before = known.get(part)
            if before is not None and not before.concerns(steps[-1]):
                out[part] = before
                continue
            neighborhood = self.around(anchor)
            blocked = self._blocked(parts, part)[of_node[neighborhood.nodes]]
            todo = steps if before is None else steps[-1:]
            refined = neighborhood.after(before, todo, part, blocked)
            if refined is not None:
                out[part] = refined
        return out

    def _blocked(self, parts: Mapping[int, PartState], part: int) -> Bool:
        """(C,) superpoints inside other parts, not at their border."""
        links = self._encoding.superpoints.links
        of_superpoint = np.zeros(len(self._encoding.superpoints), np.int32)
        for other, state in parts.items():
            if state.mask is not None:
                of_superpoint[state.mask] = other
        out = (of_superpoint != BASE) & (of_superpoint != part)
        if out.any():
            border = of_superpoint[links.a] != of_superpoint[links.b]
            out[links.a[border]] = False
            out[links.b[border]] = False
        return out

    def apply(self, of_node: Int16, refined: Mapping[int, RefinedPart]) -> None:
        """Write refined parts into the parts of nodes (N,), in place.

        A node that a part gives up goes to the nearest other part.
        """
        points = self._encoding.nodes.points
        for part, its in refined.items():
            mask = its.state.mask
            assert mask is not None
            here = of_node[its.nodes]
            left, others = (here == part) & ~mask, (here != part) & ~mask
            if left.any():
                taking = here[others]
                if np.ptp(taking) > 0:
                    around = points[its.nodes]
                    _, near = KDTree(around[others]).query(around[left])
                    here[left] = taking[near]
                else:
                    here[left] = taking[0]
            here[mask] = part
            of_node[its.nodes] = here

    def coarse_mask(self, refined: RefinedPart, state: PartState) -> Bool:
        """(C,) the whole object's superpoints that lie mostly in a refined part, at least one.

        Args:
            state: the part in these superpoints; it counts outside the neighbourhood.
        """
        superpoints = self._encoding.superpoints
        assert state.mask is not None and refined.state.mask is not None
        here = superpoints.of_node[refined.nodes]
        change = refined.state.mask.astype(np.float64) - state.mask[here]
        held = state.mask + np.bincount(here, change, len(superpoints)) / superpoints.size
        out = held > 0.5
        out[held.argmax()] = True
        return out

    def alternatives(self, refined: RefinedPart) -> Iterator[RefinedPart]:
        """``refined`` with the other masks that a person is offered."""
        masks, mask = refined.scored.proposals.masks, refined.state.mask
        assert mask is not None
        for index in offered(masks, refined.scored.scores, mask, np.ones(len(mask))):
            yield replace(refined, state=replace(refined.state, mask=masks[index]))
