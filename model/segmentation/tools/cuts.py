"""Parting what no gap parts: straight cuts, and pieces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.core.asset import Asset
from model.core.errors import PromptError
from model.geometry.splitting import ON_THE_PLANE, Plane, share_crossed
from model.segmentation.default import DefaultSession
from model.segmentation.encode.graph import components
from model.segmentation.tools.element_masks import checked, to_elements, to_nodes

Bool = npt.NDArray[np.bool_]
Float = npt.NDArray[np.float64]
Position = Sequence[float] | npt.NDArray[np.floating]

_AROUND = 24
_ONE_DIRECTION = 0.75
_COARSE = 0.01
"""Share of the area: where less of a mesh's faces lies across a cut, their edges will do."""


@dataclass(frozen=True, eq=False)
class Cut:
    """A straight border through some elements of an asset.

    Attributes:
        chosen: (E,) what is cut.
        planes: what of it lies on the inner side of all of them comes off.
        whole: (E,) what comes off as it is, or None.
    """

    chosen: Bool
    planes: tuple[Plane, ...]
    whole: Bool | None = None

    def inside(self, asset: Asset) -> Bool:
        """(E,) the chosen elements whose middle lies on the inner side, or on the border."""
        out = self.chosen & within(asset, self.planes)
        return out if self.whole is None else out | self.whole

    def splits_faces(self, asset: Asset) -> bool:
        """Whether it runs through faces so large that they have to be split."""
        mesh = asset.mesh
        return mesh is not None and share_crossed(mesh, self.chosen, self.planes) > _COARSE


def line_cut(
    session: DefaultSession, mask: Bool, positions: Sequence[Position], view: Position | None = None
) -> Cut:
    """Cut a mask by a plane through two or three clicks.

    Two clicks cut along the line between them, square to the surface there: the way to part a
    door that is flush with the body. Where the surface has no one direction there (an edge, a
    corner), the cut goes along ``view``. Three clicks are three points of the plane.

    Args:
        view: (3,) the direction that the person looks in.

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
    return Cut(checked(session, mask), (plane_through(at[0], normal),))


def straight_cut(
    session: DefaultSession, mask: Bool, positions: Sequence[Position], view: Position | None = None
) -> tuple[Bool, Bool]:
    """The two sides of :func:`line_cut`, (E,) each; together they are ``mask``.

    The first holds fewer elements.
    """
    cut = line_cut(session, mask, positions, view)
    first = cut.inside(session.asset)
    second = cut.chosen & ~first
    return (first, second) if first.sum() <= second.sum() else (second, first)


def within(asset: Asset, planes: Sequence[Plane]) -> Bool:
    """(E,) elements whose middle lies on the inner side of all planes, or on one."""
    out = np.ones(asset.element_count, bool)
    for plane in planes:
        out &= plane.distance(asset.element_centers) >= -ON_THE_PLANE * asset.diagonal
    return out


def plane_through(point: Float, normal: Float) -> Plane:
    """The plane through a point (3,), with a normal of any length."""
    x, y, z = point.tolist()
    u, v, w = (normal / np.linalg.norm(normal)).tolist()
    return Plane((x, y, z), (u, v, w))


def _into_the_surface(session: DefaultSession, at: Float, view: Position | None) -> Float:
    """(3,) the direction of the surface around some places, or ``view`` where it has no one."""
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
    _, piece = components(len(inside), graph.a[keep], graph.b[keep])
    ids, counts = np.unique(piece[inside], return_counts=True)
    out = []
    for i in ids[np.argsort(-counts, kind="stable")]:
        out.append(to_elements(session, inside & (piece == i)) & mask)
    return [m for m in out if m.any()]
