"""Close-ups: a small part is answered on the nodes round its first click, not on superpoints.

A button of a remote is a few superpoints, so nothing made of superpoints has its outline, and every click near
its border takes a superpoint too many or too few. The few thousand nodes round the click, each a superpoint of
its own, are an object of their own with merge trees, walks and boxes, encoded in a tenth of a
second; clicks there take milliseconds.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from model.segmentation.encode.edge_strength import edge_weight
from model.segmentation.encode.encoding import Encoding
from model.segmentation.encode.graph import Graph
from model.segmentation.encode.hierarchy import build_hierarchy
from model.segmentation.encode.nodes import ElementMap, Nodes
from model.segmentation.encode.random_walk import RandomWalk
from model.segmentation.encode.superpoints import build_superpoints
from model.segmentation.finish.alternatives import offered
from model.segmentation.parallel import together
from model.segmentation.prompt_steps import ClickStep, Step
from model.segmentation.prompts import BASE
from model.segmentation.propose.boxes import ObjectSolver
from model.segmentation.score.scorers import shipped_scorers
from model.segmentation.solver import PartState, Ranked, with_click

SMALL = 0.012
"""Of all nodes: a part that has no more is looked at closely."""
_NODES = 4000
"""Of a close-up: with twice as many the smallest parts are chosen worse."""
_LARGE = 0.4
"""Of a close-up: what takes more doesn't fit into it."""
_KEPT = 12
"""Close-ups, some megabytes each."""

Float = npt.NDArray[np.floating]
Bool = npt.NDArray[np.bool_]
Int = npt.NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class ClosePart:
    """What is known of a part in a close-up.

    Attributes:
        nodes: (K,) ascending, those of the whole object that are in the close-up.
        state: its clicks and mask, over these nodes.
        ranked: the hypotheses of its latest click.
    """

    nodes: Int
    state: PartState
    ranked: Ranked

    def shows(self, step: Step) -> bool:
        """Whether a prompt says anything of what is in the close-up."""
        said = step.node if isinstance(step, ClickStep) else step.nodes
        return bool(np.isin(said, self.nodes).any())


class Closeup:
    """The surroundings of a node, encoded like an object.

    Attributes:
        nodes: (K,) ascending, those of the whole object that are in it; each is a superpoint.
    """

    def __init__(self, encoding: Encoding, anchor: int, axes: Float) -> None:
        nodes = encoding.nodes
        _, near = nodes.tree.query(nodes.points[anchor], k=min(_NODES, len(nodes)))
        self.nodes = np.sort(np.atleast_1d(near)).astype(np.int32)
        self._place = np.full(len(nodes), -1, np.int32)
        self._place[self.nodes] = np.arange(len(self.nodes), dtype=np.int32)
        self._encoding, self._axes = encoding, axes

    @cached_property
    def _solver(self) -> ObjectSolver:
        """Made when a click first needs it: most prompts only confirm what is there."""
        nodes, graph = self._encoding.nodes, self._encoding.graph
        part, edges = _part_of(nodes, graph, self.nodes, self._place)
        strength = self._encoding.strength[edges]
        superpoints = build_superpoints(
            *part, strength, edge_weight(strength, part[1]), len(self.nodes)
        )
        # Factors are freed by the thread that made them.
        walk, hierarchy = together(
            lambda: RandomWalk(superpoints), lambda: build_hierarchy(superpoints)
        )
        return ObjectSolver(
            superpoints,
            hierarchy,
            walk,
            *shipped_scorers("mesh" if nodes.of_mesh else "close-up"),
            axes=self._axes,
            of_mesh=nodes.of_mesh,
        )

    def after(
        self, known: ClosePart | None, steps: tuple[Step, ...], part: int, blocked: Bool
    ) -> ClosePart | None:
        """What is known of ``part`` after ``steps``, None where it doesn't fit in here.

        Args:
            known: before them.
            blocked: (K,) nodes that other parts have for certain.
        """
        state = known.state if known is not None else None
        ranked = known.ranked if known is not None else None
        foreign: list[int] = []
        for step in steps:
            if not isinstance(step, ClickStep):
                state = self._with_region(state, step.nodes, step.part == part, step.positive)
                continue
            superpoint, own = int(self._place[step.node]), step.part == part
            if superpoint < 0:
                continue
            if state is None or state.mask is None:
                if own and step.positive:
                    state = PartState(negative=tuple(foreign))
                else:
                    if not own and step.positive:
                        foreign.append(superpoint)
                    continue
            elif not own and not step.positive:
                continue
            positive = own and step.positive
            if state.mask is not None and bool(state.mask[superpoint]) == positive:
                state = with_click(state, superpoint, positive)
                continue
            stopped = blocked.copy()
            stopped[superpoint] = False
            ranked = self._solver.answer(state, superpoint, positive, stopped)
            mask = self._solver.tidy(ranked.best, state, superpoint)
            state = self._solver.moved(state, superpoint, positive, mask)
        if state is None or state.mask is None or ranked is None:
            return None
        fits = 0 < state.mask.sum() <= _LARGE * len(self.nodes)
        return ClosePart(self.nodes, state, ranked) if fits else None

    def _with_region(
        self, state: PartState | None, nodes: Int, own: bool, positive: bool
    ) -> PartState | None:
        """``state`` after a region: drawn, or chosen from what was offered."""
        if state is None or state.mask is None or (not own and not positive):
            return state
        place = self._place[nodes]
        inside = np.zeros(len(self.nodes), bool)
        inside[place[place >= 0]] = True
        if not inside.any():
            return state
        mask = state.mask | inside if own and positive else state.mask & ~inside
        return replace(state, mask=mask, drawn=state.drawn + own)


def _part_of(nodes: Nodes, graph: Graph, kept: Int, place: Int) -> tuple[tuple[Nodes, Graph], Int]:
    """The nodes ``kept`` with what lies between them, and the edges that do.

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


class Closeups:
    """The close-ups of an encoded object, made where they are needed."""

    def __init__(self, encoding: Encoding, axes: Float) -> None:
        """``axes`` (3, 3): main directions of the whole object."""
        self._encoding, self._axes = encoding, axes
        self._of: OrderedDict[int, Closeup] = OrderedDict()

    def __getitem__(self, anchor: int) -> Closeup:
        """The close-up round a node."""
        if anchor not in self._of:
            self._of[anchor] = Closeup(self._encoding, anchor, self._axes)
            if len(self._of) > _KEPT:
                self._of.popitem(last=False)
        self._of.move_to_end(anchor)
        return self._of[anchor]

    def small(self, mask: Bool) -> bool:
        """Whether a mask over the object's superpoints (C,) is looked at closely."""
        size = self._encoding.superpoints.size
        return 0 < float(size[mask].sum()) <= SMALL * float(size.sum())

    def after(
        self,
        known: Mapping[int, ClosePart],
        parts: Mapping[int, PartState],
        steps: tuple[Step, ...],
    ) -> dict[int, ClosePart]:
        """What close-ups show of the small parts.

        Args:
            known: the same before the last of ``steps``.
            parts: what is known of all parts after it, in superpoints of the whole object.
        """
        superpoints = self._encoding.superpoints
        out: dict[int, ClosePart] = {}
        for part, own in parts.items():
            if own.mask is None or not self.small(own.mask):
                continue
            anchor = next(
                (s.node for s in steps
                 if isinstance(s, ClickStep) and s.part == part and s.positive), None
            )  # fmt: skip
            if anchor is None:
                continue
            before = known.get(part)
            if before is not None and not before.shows(steps[-1]):
                out[part] = before
                continue
            closeup = self[anchor]
            blocked = self._blocked(parts, part)[superpoints.of_node[closeup.nodes]]
            todo = steps if before is None else steps[-1:]
            close = closeup.after(before, todo, part, blocked)
            if close is not None:
                out[part] = close
        return out

    def _blocked(self, parts: Mapping[int, PartState], part: int) -> Bool:
        """(C,) superpoints that other parts have for certain: those inside them, not at their border."""
        superpoints, links = self._encoding.superpoints, self._encoding.superpoints.links
        of_superpoint = np.zeros(len(superpoints), np.int32)
        for other, its in parts.items():
            if its.mask is not None:
                of_superpoint[its.mask] = other
        out = (of_superpoint != BASE) & (of_superpoint != part)
        if out.any():
            border = of_superpoint[links.a] != of_superpoint[links.b]
            out[links.a[border]] = False
            out[links.b[border]] = False
        return out

    def place(self, of_node: npt.NDArray[np.int16], close: Mapping[int, ClosePart]) -> None:
        """Change the parts of nodes (N,), in place, to what close-ups show.

        A node that a part gives up goes to what lies next to it.
        """
        points = self._encoding.nodes.points
        for part, its in close.items():
            mask = its.state.mask
            assert mask is not None
            here = of_node[its.nodes]
            left, others = (here == part) & ~mask, (here != part) & ~mask
            if left.any():
                around = points[its.nodes]
                _, near = KDTree(around[others]).query(around[left])
                here[left] = here[others][near]
            here[mask] = part
            of_node[its.nodes] = here

    def superpoints(self, close: ClosePart, own: PartState) -> Bool:
        """(C,) superpoints of the whole object most of which are in a mask, at least one.

        Args:
            own: what is known of the part in these superpoints; it counts outside the close-up.
        """
        superpoints = self._encoding.superpoints
        assert own.mask is not None and close.state.mask is not None
        node = own.mask[superpoints.of_node]
        node[close.nodes] = close.state.mask
        held = np.bincount(superpoints.of_node, node, len(superpoints)) / superpoints.size
        out = held > 0.5
        out[held.argmax()] = True
        return out

    def others(self, close: ClosePart) -> Iterator[ClosePart]:
        """``close`` with the other masks that a person is offered."""
        masks, own = close.ranked.candidates.masks, close.state.mask
        assert own is not None
        for index in offered(masks, close.ranked.scores, own, np.ones(len(own))):
            yield replace(close, state=replace(close.state, mask=masks[index]))
