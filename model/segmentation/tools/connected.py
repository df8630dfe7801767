"""Select what is connected, grow and shrink masks, and preview clicks.

Every tool takes an encoded :class:`~model.segmentation.default.DefaultSession` and returns masks
over the elements (faces or points); the caller usually makes them a
:class:`~model.segmentation.prompts.Region`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from model.segmentation.arrays import Bool, Float
from model.segmentation.default import DefaultSession
from model.segmentation.encode.graph import components
from model.segmentation.prompt_steps import locate
from model.segmentation.prompts import Click, Prompts
from model.segmentation.tools.element_masks import to_elements, to_nodes

Position = Sequence[float] | Float

_GAPS = (3.0, 2.5, 2.0)
"""In point spacings: gaps that still connect; the first that leaves something over is taken."""
_NEARLY_ALL, _REST = 0.85, 0.02
"""Share of the free nodes above which a component is nearly everything, and share below which the
largest other component counts as nothing."""


def hover(session: DefaultSession, position: Position, element: int | None = None) -> Bool:
    """(E,) what a first click at ``position`` would take; for showing under the pointer.

    A small part is refined, which takes a tenth of a second for each new node.
    """
    found, node = locate(session.asset, session.encoding.nodes, position, element)
    superpoints = session.encoding.superpoints
    mask = session.preview(int(superpoints.of_node[node]))
    if session.refinement is not None and session.refinement.applies_to(mask):
        x, y, z = (float(v) for v in position)
        return session.segment(Prompts((Click((x, y, z), 1, True, found),))).labels == 1
    out = to_elements(session, mask[superpoints.of_node])
    out[found] = True
    return out


@dataclass(frozen=True, eq=False)
class Connected:
    """A connected component.

    Attributes:
        mask: (E,) its elements.
        nearly_all: whether hardly anything else is left.
    """

    mask: Bool
    nearly_all: bool


def connected(
    session: DefaultSession,
    position: Position,
    element: int | None = None,
    taken: Bool | None = None,
) -> Connected:
    """Everything connected to the clicked place.

    On a mesh its connected shell; on a cloud what is reached without a gap of more than three point
    spacings, or of less, down to two, if that would be nearly everything.

    Args:
        taken: (E,) elements that are excluded, such as other parts; none is reached through them.
    """
    nodes, graph = session.encoding.nodes, session.encoding.graph
    found, node = locate(session.asset, nodes, position, element)
    free = np.ones(len(nodes), bool) if taken is None else ~to_nodes(session, taken)
    free[node] = True
    inside, nearly_all = nodes.shell == nodes.shell[node], False
    near = ~graph.bridge & (nodes.shell[graph.a] == nodes.shell[graph.b])
    near &= free[graph.a] & free[graph.b]
    for gap in (0.0,) if session.asset.mesh is not None else _GAPS:
        if gap:
            short = near & (graph.length <= gap * graph.spacing)
            _, component = components(len(nodes), graph.a[short], graph.b[short])
            inside = component == component[node]
        else:
            component = nodes.shell
        inside = inside & free
        rest = np.bincount(component[free & ~inside], minlength=1).max()
        nearly_all = bool(rest < _REST * free.sum() and inside.sum() > _NEARLY_ALL * free.sum())
        if not nearly_all:
            break
    out = to_elements(session, inside)
    if taken is not None:
        out &= ~taken
    out[found] = True
    return Connected(out, nearly_all)


def grow(session: DefaultSession, mask: Bool, steps: int = 1) -> Bool:
    """The mask grown by ``steps`` neighbours; negative steps shrink it.

    It never grows over a gap. Shrinking undoes growing except where that touched the rest.
    """
    inside = to_nodes(session, mask)
    graph = session.encoding.graph
    a, b = graph.a[~graph.bridge], graph.b[~graph.bridge]
    for _ in range(abs(steps)):
        growing = inside if steps > 0 else ~inside
        reached = growing.copy()
        reached[b[growing[a]]] = True
        reached[a[growing[b]]] = True
        inside = reached if steps > 0 else ~reached
    out = to_elements(session, inside)
    return out | mask if steps > 0 else out & mask
