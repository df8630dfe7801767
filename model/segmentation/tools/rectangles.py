"""Rectangles cut out of a surface by two corners: doors and drawers that no gap parts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from model.core.errors import PromptError
from model.geometry.splitting import Plane
from model.geometry.upright_box import box_yaw
from model.segmentation.default import DefaultSession
from model.segmentation.encode.edge_strength import MAX_STRENGTH
from model.segmentation.tools.cuts import Bool, Cut, Float, Position, plane_through, within
from model.segmentation.tools.element_masks import checked

_UPRIGHT = 0.9
_AROUND, _OWN = 1000, 0.94
"""Nodes around each place whose normals tell its direction, and the cosine of those that do."""
_BEHIND, _BEHIND_SPACINGS = 0.05, 3.0
"""How far behind the rectangle what it takes may lie, in its shorter side and in node spacings."""
_BEHIND_FACING, _FACING = 0.02, 0.7
"""The same for faces of a mesh that look out, or back: what hides behind a panel."""
_IN_FRONT = 0.5
"""How far in front, in its shorter side: handles."""
_SHELL_OFF = 0.2
"""Share of a small shell's area at the front of a rectangle for which all of it comes along."""
_FIT_NODES, _FIT_TURN = 40, 0.95
"""Fewest nodes for a plane fitted to a scan, and the least cosine by which it may turn."""
_SNAP, _SNAP_OF_SIDE = 0.015, 0.1
"""How far a side moves at most, in the object's diagonal and in the rectangle's own size."""
_SNAP_GAIN = 0.3
"""How much stronger a border is than what is usual there, for a side to move to it."""
_SNAP_PLACES, _SNAP_EDGES = 41, 20
_SNAP_SPACINGS = 1.5


def rectangle_cut(
    session: DefaultSession,
    mask: Bool,
    corners: Sequence[Position],
    view: Position | None = None,
    *,
    snap: bool = True,
) -> Cut:
    """Cut an upright rectangle out of a surface, given two opposite corners of it.

    For doors and drawers that are flush with the body. What stands out in front of the rectangle
    (a handle) comes with it; what lies behind it, such as the inside, stays. On a level surface
    the rectangle follows the object's own upright box.

    Args:
        view: (3,) the direction that the person looks in; tells in front from behind.
        snap: let each side move to a gap, a crease or a step of colour close by.

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
    middle = at.mean(0)
    for refined in (session.asset.mesh is not None, True):  # a mesh's normals are exact
        frame = np.stack([across, np.cross(out, across)])
        low, high = np.sort(at @ frame.T, axis=0)
        least = float((high - low).min())
        if least < 1e-3 * session.asset.diagonal:
            raise PromptError("the two corners of a rectangle must not lie on one line along it")
        behind = max(_BEHIND * least, _BEHIND_SPACINGS * session.encoding.graph.spacing)
        if not refined:
            middle, out = _fitted(session, middle, out, frame, low, high, behind)
            across = _across(session, out)
    centers = session.asset.element_centers
    depth = (centers - middle) @ out
    near = (depth > -behind) & (depth < _IN_FRONT * least)
    mesh = session.asset.mesh
    if mesh is not None:
        # A face that looks out from farther behind is what the door hides.
        near &= (depth > -_BEHIND_FACING * least) | (np.abs(mesh.face_normals @ out) < _FACING)
    if snap:
        low, high = _Sides(session, mask & near, middle, out, frame, behind).snapped(low, high)
    planes = []
    for axis, begin, end in zip(frame, low, high, strict=True):
        planes += [plane_through(begin * axis, axis), plane_through(end * axis, -axis)]
    chosen = mask & near
    whole = _whole_shells(session, mask, near & within(session.asset, planes), planes)
    return Cut(chosen & ~whole, tuple(planes), whole)


def _whole_shells(session: DefaultSession, mask: Bool, off: Bool, planes: Sequence[Plane]) -> Bool:
    """(E,) small shells of a mesh that come off with their backs and all: a panel, a handle."""
    out = np.zeros(len(mask), bool)
    if len(session.groups) < 2:
        return out
    shells = session.groups[1]
    on = (shells.of_face >= 0) & mask
    shell, area = shells.of_face[on], shells.weight[on]
    if not len(shell):
        return out

    def of(faces: Bool) -> Float:
        return np.bincount(shell, area * faces[on], shells.number).astype(np.float64)

    total = np.bincount(shell, area, shells.number)
    taken = (of(off) > _SHELL_OFF * total) & (of(within(session.asset, planes)) > 0.9 * total)
    out[on] = taken[shell]
    return out


def _fitted(
    session: DefaultSession, middle: Float, out: Float, frame: Float, low: Float, high: Float,
    near: float,
) -> tuple[Float, Float]:  # fmt: skip
    """Middle and direction of the plane through what lies in a rectangle: clicks are noisy."""
    points = session.encoding.nodes.points.astype(float)
    flat = points @ frame.T
    inside = points[((flat > low) & (flat < high)).all(1)]
    for reach in (2 * near, near):
        close = inside[np.abs((inside - middle) @ out) < reach]
        if len(close) < _FIT_NODES:
            return middle, out
        center = np.median(close, axis=0)
        normal = np.linalg.eigh(np.cov((close - center).T))[1][:, 0]
        normal = normal * (1.0 if normal @ out > 0 else -1.0)
        if normal @ out < _FIT_TURN:
            return middle, out
        middle, out = center, normal
    return middle, out


class _Sides:
    """What looks like a border along the sides of a rectangle.

    Args:
        chosen: (E,) what is cut.
        middle: (3,) of the rectangle, which faces ``out``.
        frame: (2, 3) unit vectors along its sides.
        behind: metres; nodes as far as that from its plane count.
    """

    def __init__(
        self, session: DefaultSession, chosen: Bool, middle: Float, out: Float, frame: Float,
        behind: float,
    ) -> None:  # fmt: skip
        encoding, self._reach = session.encoding, _SNAP * session.asset.diagonal
        graph, points = encoding.graph, encoding.nodes.points.astype(float)
        near = np.abs((points - middle) @ out) < behind
        edges = near[graph.a] & near[graph.b]
        flat = points @ frame.T
        self._a, self._b = flat[graph.a[edges]], flat[graph.b[edges]]
        self._strength = encoding.strength[edges].astype(float)
        self._spacing = graph.spacing
        mesh = session.asset.mesh
        self._corners = np.zeros((0, 2))
        if mesh is not None:
            self._corners = mesh.vertices[np.unique(mesh.faces[chosen])] @ frame.T

    def snapped(self, low: Float, high: Float) -> tuple[Float, Float]:
        """(2,) the corners with each side where the border is strongest close by."""
        out = np.stack([low, high])
        for side in (0, 1):
            for axis in (0, 1):
                out[side, axis] = self._best(axis, float((low, high)[side][axis]), low, high)
        return out[0], out[1]

    def _best(self, axis: int, at: float, low: Float, high: Float) -> float:
        other, size = 1 - axis, high - low
        reach = min(self._reach, _SNAP_OF_SIDE * float(size[axis]))
        begin, end = low[other] + 0.05 * size[other], high[other] - 0.05 * size[other]
        a, b = self._a, self._b
        beside = (np.minimum(a, b)[:, other] > begin) & (np.maximum(a, b)[:, other] < end)
        first, last = np.minimum(a, b)[:, axis], np.maximum(a, b)[:, axis]
        beside &= (last > at - reach) & (first < at + reach)
        if np.count_nonzero(beside) < _SNAP_EDGES:
            return at
        places = np.linspace(at - reach, at + reach, _SNAP_PLACES)
        across = (first[beside] < places[:, None]) & (last[beside] >= places[:, None])
        count = across.sum(1)
        usual = 0.5 * float(np.median(count))
        # Where hardly an edge leads across there is a gap, the strongest border of all.
        strength = across @ self._strength[beside] + MAX_STRENGTH * np.maximum(usual - count, 0)
        strength /= np.maximum(np.maximum(count, usual), 1)
        best = int((strength - ((places - at) / reach) ** 2).argmax())
        if strength[best] < np.median(strength) + _SNAP_GAIN:
            return at
        return self._on_an_edge(axis, float(places[best]), low - reach, high + reach)

    def _on_an_edge(self, axis: int, at: float, low: Float, high: Float) -> float:
        """``at``, or the place of a mesh's own vertices where those are as near as a node."""
        inside = ((self._corners > low) & (self._corners < high)).all(1)
        places = self._corners[inside, axis]
        if len(places):
            nearest = float(places[np.abs(places - at).argmin()])
            if abs(nearest - at) < _SNAP_SPACINGS * self._spacing:
                return nearest
        return at


def surface_frame(
    session: DefaultSession, at: Float, view: Position | None = None
) -> tuple[Float, Float]:
    """(3,) unit vectors out of the surface around places (N, 3), and level along it."""
    middle = session.encoding.nodes.points.mean(0)
    toward = np.asarray(tuple(view), float) if view is not None else middle - at.mean(0)
    out = _facing(session, at, toward)
    out = out / np.linalg.norm(out) * (-1.0 if out @ toward > 0 else 1.0)
    return out, _across(session, out)


def _facing(session: DefaultSession, at: Float, toward: Float) -> Float:
    """(3,) the main direction of the normals around some places: corners have several."""
    nodes, normals = session.encoding.nodes, session.encoding.graph.normals
    _, near = nodes.tree.query(at, k=min(_AROUND, len(nodes)))
    around = normals[near].reshape(-1, 3).astype(float)
    seen = np.abs(around @ (toward / max(np.linalg.norm(toward), 1e-12)))
    main = np.linalg.eigh((around * seen[:, None] ** 2).T @ around)[1][:, 2]
    # The faces beside it tilt the main direction: the mean of its own is free of them.
    side = around @ main
    own = around[np.abs(side) > _OWN] * np.sign(side[np.abs(side) > _OWN])[:, None]
    return own.mean(0) if len(own) else main


def _across(session: DefaultSession, out: Float) -> Float:
    """(3,) the level direction along a surface that faces ``out``."""
    if abs(out[2]) < _UPRIGHT:
        across = np.cross((0.0, 0.0, 1.0), out)
    else:
        yaw = box_yaw(session.encoding.nodes.points[:, :2])
        across = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        across -= (across @ out) * out
    return across / np.linalg.norm(across)
