"""Parting what no gap parts: straight cuts, rectangles, and pieces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.errors import PromptError
from model.geometry.asset import Asset
from model.geometry.splitting import Plane, crossing_share
from model.geometry.upright_box import box_yaw
from model.segmentation.cells import groups
from model.segmentation.default import DefaultSession
from model.segmentation.element_masks import checked, to_elements, to_nodes

Bool = npt.NDArray[np.bool_]
Float = npt.NDArray[np.float64]
Position = Sequence[float] | npt.NDArray[np.floating]

_AROUND = 24
_ONE_DIRECTION = 0.75
_UPRIGHT = 0.9
_BEHIND = 0.05
_BEHIND_SPACINGS = 3.0
_IN_FRONT = 0.5
_COARSE = 0.01
"""Share of the area: where less of a mesh's faces lies across a cut, their edges will do."""


@dataclass(frozen=True, eq=False)
class Cut:
    """A straight border through some elements of an asset.

    Attributes:
        chosen: (E,) what is cut.
        planes: what of it lies on the inner side of all of them comes off.
    """

    chosen: Bool
    planes: tuple[Plane, ...]

    def inside(self, asset: Asset) -> Bool:
        """(E,) the chosen elements whose middle lies on the inner side."""
        out = self.chosen.copy()
        for plane in self.planes:
            out &= plane.distance(asset.element_centers) > 0
        return out

    def splits_faces(self, asset: Asset) -> bool:
        """Whether it runs through faces so large that they have to be split."""
        mesh = asset.mesh
        return mesh is not None and crossing_share(mesh, self.chosen, self.planes) > _COARSE


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
    return Cut(checked(session, mask), (_plane(at[0], normal),))


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


def rectangle_cut(
    session: DefaultSession, mask: Bool, corners: Sequence[Position], view: Position | None = None
) -> Cut:
    """Cut an upright rectangle out of a surface, given two opposite corners of it.

    For doors and drawers that are flush with the body. What stands out in front of the rectangle
    (a handle) comes with it; what lies behind it, such as the inside, stays. On a level surface
    the rectangle follows the object's own upright box.

    Args:
        view: (3,) the direction that the person looks in; tells in front from behind.

    Raises:
        PromptError: where the corners span no rectangle.
    """
    at = np.array([np.asarray(tuple(p), float) for p in corners])
    if len(at) != 2:
        raise PromptError(f"a rectangle needs two opposite corners, got {len(at)}")
    mask = checked(session, mask)
    # What lies between the corners tells the direction better than their surroundings alone.
    out, across = surface_frame(
        session, at[0] + np.linspace(0, 1, 5)[:, None] * (at[1] - at[0]), view
    )
    frame = np.stack([across, np.cross(out, across)])
    centers = session.asset.element_centers
    low, high = np.sort(at @ frame.T, axis=0)
    sides = high - low
    least = float(sides.min())
    if least < 1e-3 * session.asset.diagonal:
        raise PromptError("the two corners of a rectangle must not lie on one line along it")
    depth = (centers - at.mean(0)) @ out
    behind = max(_BEHIND * least, _BEHIND_SPACINGS * session.encoding.graph.spacing)
    near = (depth > -behind) & (depth < _IN_FRONT * least)
    planes = []
    for axis, begin, end in zip(frame, low, high, strict=True):
        planes += [_plane(begin * axis, axis), _plane(end * axis, -axis)]
    return Cut(mask & near, tuple(planes))


def surface_frame(
    session: DefaultSession, at: Float, view: Position | None = None
) -> tuple[Float, Float]:
    """(3,) unit vectors out of the surface around places (N, 3), and level along it."""
    out = _into_the_surface(session, at, view)
    middle = session.encoding.nodes.points.mean(0)
    toward = np.asarray(tuple(view), float) if view is not None else middle - at.mean(0)
    out = out / np.linalg.norm(out) * (-1.0 if out @ toward > 0 else 1.0)
    return out, _across(session, out)


def _across(session: DefaultSession, out: Float) -> Float:
    """(3,) the level direction along a surface that faces ``out``."""
    if abs(out[2]) < _UPRIGHT:
        across = np.cross((0.0, 0.0, 1.0), out)
    else:
        yaw = box_yaw(session.encoding.nodes.points[:, :2])
        across = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        across -= (across @ out) * out
    return across / np.linalg.norm(across)


def _plane(point: Float, normal: Float) -> Plane:
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
    _, piece = groups(len(inside), graph.a[keep], graph.b[keep])
    ids, counts = np.unique(piece[inside], return_counts=True)
    out = []
    for i in ids[np.argsort(-counts, kind="stable")]:
        out.append(to_elements(session, inside & (piece == i)) & mask)
    return [m for m in out if m.any()]
