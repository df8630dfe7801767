"""More than clicks: masks that a person asks for by other means.

Every function takes an encoded :class:`~model.segmentation.default.DefaultSession` and gives masks
over the elements (faces, or points); what to do with a mask is the caller's, usually a
:class:`~model.segmentation.prompts.Region`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.segmentation.default import DefaultSession
from model.segmentation.encode.graph import components
from model.segmentation.prompt_steps import locate
from model.segmentation.prompts import Click, Prompts
from model.segmentation.tools.element_masks import to_elements, to_nodes

Bool = npt.NDArray[np.bool_]
Position = Sequence[float] | npt.NDArray[np.floating]

_GAPS = (3.0, 2.5, 2.0)
"""Of the point spacing: jumps that still count as connected; the first that tells things apart."""
_NEARLY_ALL = 0.85
_CRUMB = 0.02
"""Of what is free: smaller pieces left over are no things."""


def hover(session: DefaultSession, position: Position, element: int | None = None) -> Bool:
    """(E,) what a first click at ``position`` would take; for showing under the pointer.

    Small parts take a close-up, a tenth of a second for each node that is pointed at.
    """
    found, node = locate(session.asset, session.encoding.nodes, position, element)
    superpoints = session.encoding.superpoints
    mask = session.preview(int(superpoints.of_node[node]))
    if session.closeups is not None and session.closeups.small(mask):
        x, y, z = (float(v) for v in position)
        return session.segment(Prompts((Click((x, y, z), 1, True, found),))).labels == 1
    out = to_elements(session, mask[superpoints.of_node])
    out[found] = True
    return out


@dataclass(frozen=True, eq=False)
class Connected:
    """What hangs together with a place.

    Attributes:
        mask: (E,) its elements.
        nearly_all: nothing but crumbs is left over, so that it tells nothing apart.
    """

    mask: Bool
    nearly_all: bool


def connected(
    session: DefaultSession,
    position: Position,
    element: int | None = None,
    taken: Bool | None = None,
) -> Connected:
    """Everything connected with the clicked place.

    On a mesh its connected shell; on a cloud what is reached without a jump over more than three
    times the point spacing, or over less, down to twice, where that would be nearly everything.

    Args:
        taken: (E,) what isn't to be had, such as other parts; nothing is reached through it.
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
            _, piece = components(len(nodes), graph.a[short], graph.b[short])
            inside = piece == piece[node]
        else:
            piece = nodes.shell
        inside = inside & free
        rest = np.bincount(piece[free & ~inside], minlength=1).max()
        nearly_all = bool(rest < _CRUMB * free.sum() and inside.sum() > _NEARLY_ALL * free.sum())
        if not nearly_all:
            break
    out = to_elements(session, inside)
    if taken is not None:
        out &= ~taken
    out[found] = True
    return Connected(out, nearly_all)


def grow(session: DefaultSession, mask: Bool, steps: int = 1) -> Bool:
    """The mask widened by ``steps`` neighbours; negative steps shrink it.

    It never grows over a gap. Shrinking undoes growing but for what touched the rest.
    """
    inside = to_nodes(session, mask)
    graph = session.encoding.graph
    a, b = graph.a[~graph.bridge], graph.b[~graph.bridge]
    for _ in range(abs(steps)):
        moving = inside if steps > 0 else ~inside
        reached = moving.copy()
        reached[b[moving[a]]] = True
        reached[a[moving[b]]] = True
        inside = reached if steps > 0 else ~reached
    out = to_elements(session, inside)
    return out | mask if steps > 0 else out & mask
