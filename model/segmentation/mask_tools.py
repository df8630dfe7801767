"""Masks by other means than clicks: select what is connected, grow, shrink, cut, draw rectangles.

Every tool takes an encoded :class:`~model.segmentation.default.DefaultSession` and returns masks
over the elements (faces or points); the caller usually makes them a
:class:`~model.segmentation.prompts.Region`. A mask is cut along a plane or into its connected
components. Two corners cut a rectangle out of a surface: doors and drawers without any gap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from model.core.asset import Asset
from model.core.errors import PromptError
from model.geometry.levelling import box_yaw
from model.geometry.splitting import ON_THE_PLANE, Plane, share_crossed
from model.segmentation.arrays import Bool, Float, Float64, Int64
from model.segmentation.default import DefaultSession
from model.segmentation.graph import MAX_STRENGTH, components
from model.segmentation.prompt_steps import locate


def to_elements(session: DefaultSession, nodes: Bool) -> Bool:
    """(E,) the elements of the nodes in (N,) ``nodes``."""
    return session.encoding.nodes.elements.to_elements(nodes.astype(np.int16)) > 0


def to_nodes(session: DefaultSession, mask: Bool) -> Bool:
    """(N,) the nodes of the elements in (E,) ``mask``.

    Raises:
        PromptError: if the mask has another length.
    """
    mask = checked(session, mask)
    out = np.zeros(len(session.encoding.nodes), bool)
    out[session.encoding.nodes.elements.nodes_of(np.nonzero(mask)[0])] = True
    return out


def checked(session: DefaultSession, mask: Bool) -> Bool:
    """``mask`` as booleans.

    Raises:
        PromptError: if its length is not the number of elements.
    """
    mask = np.asarray(mask, bool)
    if mask.shape != (session.asset.element_count,):
        raise PromptError(
            f"{session.asset.name}: a mask needs shape ({session.asset.element_count},), "
            f"got {mask.shape}"
        )
    return mask


def first_elements(session: DefaultSession) -> Int64:
    """(N,) one element that each node stands for."""
    elements = session.encoding.nodes.elements
    first = np.zeros(len(session.encoding.nodes), np.int64)
    if len(elements.vote_node):
        first[elements.vote_node] = elements.vote_element
    first[elements.node_of_element[::-1]] = np.arange(len(elements.node_of_element) - 1, -1, -1)
    return first


Position = Sequence[float] | Float

_GAPS = (3.0, 2.5, 2.0)
"""In point spacings: gaps that still connect; the first that leaves something over is taken."""
_NEARLY_ALL, _REST = 0.85, 0.02
"""Share of the free nodes above which a component is nearly everything, and share below which the
largest other component counts as nothing."""


def hover(session: DefaultSession, position: Position, element: int | None = None) -> Bool:
    """(E,) what a first click at ``position`` would take; for showing under the pointer."""
    found, node = locate(session.asset, session.encoding.nodes, position, element)
    superpoints = session.encoding.superpoints
    mask = session.preview(int(superpoints.of_node[node]))
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


_AROUND = 24
_ONE_DIRECTION = 0.75
_COARSE = 0.01
"""Share of a mesh's area; if the faces across a cut have less, it follows their edges."""


@dataclass(frozen=True, eq=False)
class Cut:
    """A straight border through some elements of an asset.

    Attributes:
        chosen: (E,) the elements that are cut.
        planes: those on the inner side of all of them come off.
        whole: (E,) elements that come off undivided, or None.
    """

    chosen: Bool
    planes: tuple[Plane, ...]
    whole: Bool | None = None

    def inside(self, asset: Asset) -> Bool:
        """(E,) the elements that come off: their middle lies on the inner side or the border."""
        out = self.chosen & within(asset, self.planes)
        return out if self.whole is None else out | self.whole

    def splits_faces(self, asset: Asset) -> bool:
        """True if it crosses faces so large that they have to be split."""
        mesh = asset.mesh
        return mesh is not None and share_crossed(mesh, self.chosen, self.planes) > _COARSE


def line_cut(
    session: DefaultSession, mask: Bool, positions: Sequence[Position], view: Position | None = None
) -> Cut:
    """Cut a mask by a plane through two or three clicks.

    Two clicks cut along the line between them, perpendicular to the surface, or along ``view``
    where the surface has no single direction (an edge, a corner). This separates a door that is
    flush with the body. Three clicks are three points of the plane.

    Args:
        view: (3,) the direction that the person looks in.

    Raises:
        PromptError: if the clicks don't determine a plane.
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
        raise PromptError("the clicks of a straight cut must be distinct and not on one line")
    return Cut(checked(session, mask), (plane_through(at[0], normal),))


def within(asset: Asset, planes: Sequence[Plane]) -> Bool:
    """(E,) elements whose middle lies on the inner side of all planes, or on a plane."""
    out = np.ones(asset.element_count, bool)
    for plane in planes:
        out &= plane.distance(asset.element_centers) >= -ON_THE_PLANE * asset.diagonal
    return out


def plane_through(point: Float64, normal: Float64) -> Plane:
    """The plane through a point (3,), with a normal of any length."""
    x, y, z = point.tolist()
    u, v, w = (normal / np.linalg.norm(normal)).tolist()
    return Plane((x, y, z), (u, v, w))


def _into_the_surface(session: DefaultSession, at: Float64, view: Position | None) -> Float64:
    """(3,) the normal of the surface around some places; ``view`` if they have several."""
    nodes, normals = session.encoding.nodes, session.encoding.graph.normals
    _, near = nodes.tree.query(at, k=min(_AROUND, len(nodes)))
    around = normals[near].reshape(-1, 3).astype(float)
    # Normals of scans may be flipped: their main axis is the same.
    values, axes = np.linalg.eigh(around.T @ around)
    if view is not None and values[2] < _ONE_DIRECTION * values.sum():
        return np.asarray(tuple(view), float)
    return axes[:, 2]


def connected_components(session: DefaultSession, mask: Bool) -> list[Bool]:
    """The connected components of a mask, largest first; for splitting a part."""
    inside = to_nodes(session, mask)
    graph = session.encoding.graph
    keep = inside[graph.a] & inside[graph.b] & ~graph.bridge
    _, component = components(len(inside), graph.a[keep], graph.b[keep])
    ids, counts = np.unique(component[inside], return_counts=True)
    out = []
    for i in ids[np.argsort(-counts, kind="stable")]:
        out.append(to_elements(session, inside & (component == i)) & mask)
    return [m for m in out if m.any()]


_UPRIGHT = 0.9
_AROUND_CORNER, _OWN = 1000, 0.94
"""Nodes around each place whose normals are used, and least cosine to their main direction."""
_BEHIND, _BEHIND_SPACINGS = 0.05, 3.0
"""Largest depth behind the rectangle, in its shorter side and in node spacings, the larger one."""
_BEHIND_FACING, _FACING = 0.02, 0.7
"""The same for faces of a mesh that are parallel to it and may lie hidden behind a panel."""
_IN_FRONT = 0.5
"""Largest height of handles in front, in its shorter side."""
_SHELL_OFF = 0.2
"""Share of a small shell's area in the rectangle above which all of it comes off."""
_FIT_NODES, _FIT_TURN = 40, 0.95
"""Fewest nodes for a plane fitted to a scan, and least cosine to the estimated normal."""
_SNAP, _SNAP_OF_SIDE = 0.015, 0.1
"""Largest shift of a side, in the object's diagonal and in the rectangle's size."""
_SNAP_GAIN = 0.3
"""Least excess of a border's strength over the median there."""
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

    For doors and drawers that are flush with the body. Handles in front of the rectangle come off
    with it; the inside behind it stays. On a horizontal surface the rectangle is parallel to the
    object's upright box.

    Args:
        view: (3,) the direction that the person looks in; tells in front from behind.
        snap: let each side move to a gap, a crease or a step of colour close by.

    Raises:
        PromptError: if the corners span no rectangle.
    """
    if len(corners) != 2:
        raise PromptError(f"a rectangle needs two opposite corners, got {len(corners)}")
    at, mask = np.array([tuple(p) for p in corners], float), checked(session, mask)
    # Normals between the corners, too: better than those at the corners alone.
    between = at[0] + np.linspace(0, 1, 5)[:, None] * (at[1] - at[0])
    out, across = surface_frame(session, between, view)
    middle = at.mean(0)
    for refined in (session.asset.mesh is not None, True):  # a mesh's normals are exact
        frame = np.stack([across, np.cross(out, across)])
        low, high = np.sort(at @ frame.T, axis=0)
        least = float((high - low).min())
        if least < 1e-3 * session.asset.diagonal:
            raise PromptError("the two corners of a rectangle lie on one of its sides")
        behind = max(_BEHIND * least, _BEHIND_SPACINGS * session.encoding.graph.spacing)
        if not refined:
            middle, out = _fitted(session, middle, out, frame, low, high, behind)
            across = _across(session, out)
    depth = (session.asset.element_centers - middle) @ out
    near = (depth > -behind) & (depth < _IN_FRONT * least)
    mesh = session.asset.mesh
    if mesh is not None:
        near &= (depth > -_BEHIND_FACING * least) | (np.abs(mesh.face_normals @ out) < _FACING)
    if snap:
        low, high = _Sides(session, mask & near, middle, out, frame, behind).snapped(low, high)
    planes = []
    for axis, begin, end in zip(frame, low, high, strict=True):
        planes += [plane_through(begin * axis, axis), plane_through(end * axis, -axis)]
    whole = _whole_shells(session, mask, near & within(session.asset, planes), planes)
    return Cut(mask & near & ~whole, tuple(planes), whole)


def _whole_shells(session: DefaultSession, mask: Bool, off: Bool, planes: Sequence[Plane]) -> Bool:
    """(E,) small shells of a mesh that come off undivided: a panel, a handle."""
    out = np.zeros(len(mask), bool)
    if session.finisher.attached is None:
        return out
    shells = session.finisher.attached.shells
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
    session: DefaultSession,
    middle: Float,
    out: Float,
    frame: Float,
    low: Float,
    high: Float,
    near: float,
) -> tuple[Float, Float]:
    """Middle and normal of a plane fitted to the rectangle's nodes: clicks are noisy."""
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
    """Border strengths along the sides of a rectangle.

    Args:
        chosen: (E,) the elements that are cut.
        middle: (3,) of the rectangle, which faces ``out``.
        frame: (2, 3) unit vectors along its sides.
        behind: metres; nodes as far as that from its plane count.
    """

    def __init__(
        self,
        session: DefaultSession,
        chosen: Bool,
        middle: Float,
        out: Float,
        frame: Float,
        behind: float,
    ) -> None:
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
        """(2,) the corners after each side has moved to the strongest border close by."""
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
        # Hardly any edge crosses a gap, the strongest border of all.
        strength = across @ self._strength[beside] + MAX_STRENGTH * np.maximum(usual - count, 0)
        strength /= np.maximum(np.maximum(count, usual), 1)
        best = int((strength - ((places - at) / reach) ** 2).argmax())
        if strength[best] < np.median(strength) + _SNAP_GAIN:
            return at
        return self._on_an_edge(axis, float(places[best]), low - reach, high + reach)

    def _on_an_edge(self, axis: int, at: float, low: Float, high: Float) -> float:
        """``at``, or the nearest vertex coordinate of a mesh within about a node spacing."""
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
    """(3,) unit vectors out of the surface around places (N, 3), and horizontal along it."""
    middle = session.encoding.nodes.points.mean(0)
    toward = np.asarray(tuple(view), float) if view is not None else middle - at.mean(0)
    out = _facing(session, at, toward)
    out = out / np.linalg.norm(out) * (-1.0 if out @ toward > 0 else 1.0)
    return out, _across(session, out)


def _facing(session: DefaultSession, at: Float, toward: Float) -> Float:
    """(3,) the main direction of the normals around some places: corners have several."""
    nodes, normals = session.encoding.nodes, session.encoding.graph.normals
    _, near = nodes.tree.query(at, k=min(_AROUND_CORNER, len(nodes)))
    around = normals[near].reshape(-1, 3).astype(float)
    seen = np.abs(around @ (toward / max(np.linalg.norm(toward), 1e-12)))
    main = np.linalg.eigh((around * seen[:, None] ** 2).T @ around)[1][:, 2]
    # Adjacent faces tilt the main direction; the mean of the normals along it doesn't.
    side = around @ main
    own = around[np.abs(side) > _OWN] * np.sign(side[np.abs(side) > _OWN])[:, None]
    return own.mean(0) if len(own) else main


def _across(session: DefaultSession, out: Float) -> Float:
    """(3,) the horizontal direction along a surface that faces ``out``."""
    if abs(out[2]) < _UPRIGHT:
        across = np.cross((0.0, 0.0, 1.0), out)
    else:
        yaw = box_yaw(session.encoding.nodes.points[:, :2])
        across = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        across -= (across @ out) * out
    return across / np.linalg.norm(across)
