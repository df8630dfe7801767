"""Parting what no gap parts: straight cuts, and pieces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from model.errors import PromptError
from model.segmentation.cells import groups
from model.segmentation.default import DefaultSession
from model.segmentation.element_masks import checked, to_elements, to_nodes

Bool = npt.NDArray[np.bool_]
Position = Sequence[float] | npt.NDArray[np.floating]

_AROUND = 24
_ONE_DIRECTION = 0.75


def straight_cut(
    session: DefaultSession,
    mask: Bool,
    positions: Sequence[Position],
    view: Position | None = None,
) -> tuple[Bool, Bool]:
    """Cut a mask by a plane through two or three clicks.

    Two clicks cut along the line between them, square to the surface there: the way to part a
    door that is flush with the body. Where the surface has no one direction there (an edge, a
    corner), the cut goes along ``view``. Three clicks are three points of the plane.

    Args:
        view: (3,) the direction that the person looks in.

    Returns:
        The two sides, (E,) each; together they are ``mask``. The first holds fewer elements.

    Raises:
        PromptError: where the clicks don't fix a plane.
    """
    at = np.array([np.asarray(tuple(p), float) for p in positions])
    if len(at) not in (2, 3):
        raise PromptError(f"a straight cut needs two or three clicks, got {len(at)}")
    along = at[1] - at[0]
    if len(at) == 3:
        normal = np.cross(along, at[2] - at[0])
    else:
        normal = np.cross(along, _into_the_surface(session, at, view))
    length = float(np.linalg.norm(normal))
    if length < 1e-9 * max(float(along @ along), 1e-18):
        raise PromptError("the clicks of a straight cut must not lie on one another or one line")
    mask = checked(session, mask)
    side = (session.asset.element_centers - at[0]) @ (normal / length) > 0
    first, second = mask & side, mask & ~side
    return (first, second) if first.sum() <= second.sum() else (second, first)


def _into_the_surface(
    session: DefaultSession, at: npt.NDArray[np.float64], view: Position | None
) -> npt.NDArray[np.float64]:
    """(3,) the direction of the surface around two clicks, or ``view`` where it has no one."""
    nodes, normals = session.encoding.nodes, session.encoding.graph.normals
    _, near = nodes.tree.query(at, k=min(_AROUND, len(nodes)))
    around = normals[near].reshape(-1, 3).astype(float)
    # Normals of scans point either way: the main axis of them doesn't care.
    values, axes = np.linalg.eigh(around.T @ around)
    if view is not None and values[2] < _ONE_DIRECTION * values.sum():
        return np.asarray(tuple(view), float)
    return axes[:, 2]


def pieces(session: DefaultSession, mask: Bool) -> list[Bool]:
    """The connected pieces of a mask, largest first; for splitting a part."""
    inside = to_nodes(session, mask)
    graph = session.encoding.graph
    keep = inside[graph.a] & inside[graph.b] & ~graph.bridge
    _, piece = groups(len(inside), graph.a[keep], graph.b[keep])
    ids, counts = np.unique(piece[inside], return_counts=True)
    out = []
    for i in ids[np.argsort(-counts, kind="stable")]:
        out.append(to_elements(session, inside & (piece == i)) & mask)
    return [m for m in out if m.any()]
