"""Snap a joint's axis to features of the shape: boxes, the contact line, hinge barrels and pins."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Part
from model.core.errors import KinematicsError
from model.core.geometry import Mesh
from model.core.joint import Joint
from model.geometry.topology import connected_shells, weld

Vector = npt.NDArray[np.float64]
BoxAxis = Literal["Long", "Middle", "Short"]
PARALLEL = 0.9
"""Cosine from which a box edge counts as parallel to the joint's axis."""
LINE = 0.25
"""Largest width of a contact line over its length."""
ROUND = 0.5
"""Smallest ratio of its two extents from which a contact surrounds an axis."""
SPOT = 0.2
"""Largest size of a spot contact, over the part's size."""
AT_SIDE = 0.03
"""Largest distance of contact from a side that counts as there, in the part's width."""


@dataclass(frozen=True, eq=False)
class Box:
    """An oriented box: columns of ``axes`` are its unit axes, longest first; half extents in m."""

    center: Vector
    axes: Vector
    half: Vector


def box_of(points: Vector) -> Box:
    """Return the tightest box of (N, 3) points, or the axis-aligned one if nearly as tight."""
    import trimesh

    low, high = points.min(0), points.max(0)
    half, center, axes = (high - low) / 2, (low + high) / 2, np.eye(3)
    try:
        to_origin, extents = trimesh.bounds.oriented_bounds(points)
        if np.prod(extents + 1e-9) < 0.93 * np.prod(2 * half + 1e-9):
            inverse = np.linalg.inv(to_origin)
            axes, center, half = inverse[:3, :3], inverse[:3, 3], np.asarray(extents) / 2
    except (ValueError, RuntimeError):
        pass  # degenerate points have no hull: keep the axis-aligned box
    order = np.argsort(-half, kind="stable")
    return Box(np.asarray(center, np.float64), np.asarray(axes, np.float64)[:, order], half[order])


def axis_along_box(joint: Joint, box: Box, which: BoxAxis) -> Joint:
    """Align the joint's axis to the box's longest, middle or shortest axis; its sign is kept."""
    axis = box.axes[:, ("Long", "Middle", "Short").index(which)]
    if axis @ np.asarray(joint.axis) < -1e-9:
        axis = -axis
    return replace(joint, axis=tuple(float(v) for v in axis))


def origin_on_box_edge(joint: Joint, box: Box) -> Joint:
    """Move the joint to the box's nearest edge along its axis.

    Raises:
        KinematicsError: where no edge is parallel to the axis.
    """
    axis, origin = np.asarray(joint.axis), np.asarray(joint.origin)
    cosine = np.abs(axis @ box.axes)
    along = int(np.argmax(cosine))
    if cosine[along] < PARALLEL:
        raise KinematicsError(
            [f"{joint.child}: no box edge is parallel to the axis; choose the axis first"]
        )
    a, b = (k for k in range(3) if k != along)
    corners = [
        box.center + s * box.half[a] * box.axes[:, a] + t * box.half[b] * box.axes[:, b]
        for s in (-1, 1)
        for t in (-1, 1)
    ]
    direction = box.axes[:, along] * (1 if axis @ box.axes[:, along] >= 0 else -1)
    gaps = [np.linalg.norm(np.cross(origin - c, direction)) for c in corners]
    nearest = corners[int(np.argmin(gaps))]
    return replace(
        joint,
        origin=tuple(float(v) for v in nearest),
        axis=tuple(float(v) for v in direction),
    )


def origin_on_contact(joint: Joint, child: Vector, parent: Vector, reach: float) -> Joint:
    """Move the joint to the contact of child and parent.

    A contact line within 30° of the axis sets the axis, too. A spot, and a contact around the axis,
    set the origin to their centre. The centre of another contact is no hinge (a door touches its
    frame all round): the axis moves to the nearer side of the child if they touch there.

    Args:
        joint: its axis is kept, unless the contact is a line.
        child, parent: (N, 3) surface points.
        reach: largest gap in metres that counts as touching.

    Raises:
        KinematicsError: where the parts don't touch, or over a face but not at that side.
    """
    from scipy.spatial import KDTree

    found = KDTree(parent).query(child)
    distance, index = np.asarray(found[0]), np.asarray(found[1])
    nearest = float(distance.min())
    touching = distance <= max(2.0 * nearest, reach)
    if nearest > 5 * reach:
        apart = f"({1000 * nearest:.0f} mm apart)"
        raise KinematicsError([f"{joint.child} and {joint.parent} don't touch {apart}"])
    points = (child[touching] + parent[index[touching]]) / 2
    center = points.mean(0)
    axis = np.asarray(joint.axis)
    if len(points) >= 8:
        _, spread, directions = np.linalg.svd(points - center, full_matrices=False)
        line = directions[0]
        if spread[1] < LINE * spread[0] and abs(line @ axis) > np.cos(np.pi / 6):
            return _moved(joint, center, line if line @ axis > 0 else -line)
    wide = _wide_across(axis, points, child) if joint.rotates else None
    if wide is None:
        return _moved(joint, center, axis)
    moved = _on_side_in_contact(joint, box_of(child), points, wide, reach)
    if moved is None:
        raise KinematicsError(
            [
                f"{joint.child} and {joint.parent} touch over a face, which defines no hinge line; "
                "take Box edge or Center"
            ]
        )
    return moved


def _moved(joint: Joint, origin: Vector, axis: Vector) -> Joint:
    return replace(
        joint, origin=tuple(float(v) for v in origin), axis=tuple(float(v) for v in axis)
    )


def _wide_across(axis: Vector, contact: Vector, child: Vector) -> Vector | None:
    """Direction across the axis in which a contact is wide; None for a spot, or around the axis."""
    across = contact - np.outer(contact @ axis, axis)
    _, spread, directions = np.linalg.svd(across - across.mean(0), full_matrices=False)
    widest = float(np.ptp(across @ directions[0]))
    whole = float(np.linalg.norm(np.ptp(child, axis=0)))
    if widest < SPOT * whole or (len(spread) > 1 and spread[1] > ROUND * spread[0]):
        return None
    return directions[0]


def _on_side_in_contact(
    joint: Joint, box: Box, contact: Vector, wide: Vector, reach: float
) -> Joint | None:
    """Move the joint to the nearer side of the box, at the depth of the contact (N, 3) there.

    None without contact there, and where no box axis is parallel to the joint's.
    """
    axis = np.asarray(joint.axis)
    along, across = (int(np.argmax(np.abs(v @ box.axes))) for v in (axis, wide))
    if joint.type == "continuous" or abs(float(axis @ box.axes[:, along])) < PARALLEL:
        return None
    normal = box.axes[:, across]
    side = 1.0 if (np.asarray(joint.origin) - box.center) @ normal >= 0 else -1.0
    outermost = float(box.center @ normal) * side + box.half[across]
    inside = outermost - side * (contact @ normal)
    there = inside <= max(2 * reach, AT_SIDE * 2 * box.half[across])
    if along == across or there.sum() < 3:
        return None
    place = contact[there].mean(0)
    place = place + (side * outermost - float(place @ normal)) * normal
    direction = box.axes[:, along]
    return _moved(joint, place, direction if direction @ axis >= 0 else -direction)


Array = npt.NDArray[np.float64]

LEAST_CORNERS = 6
"""Fewest corners of a circular cross-section."""
ROUND_BARREL = 0.06
"""Largest standard deviation of a barrel's radius over its mean."""
LONG = 0.8
"""Smallest length over diameter of a barrel: a screw's head is shorter."""
NEAR, WIDEST = 0.06, 0.03
"""Largest distance of barrels from the joint, and their largest radius, over the part's size."""
PIANO = 0.25
"""Smallest length of a hinge with a single barrel, over the part's size."""
IN_LINE = 0.5
"""Largest distance of barrels from their common line, in radii."""


@dataclass(frozen=True, eq=False)
class BarrelLine:
    """Cylinders around one line.

    Attributes:
        point: (3,) on the line, metres, object frame. radius: of the widest barrel, in metres.
        count: number of barrels.
        length: from end to end, in metres.
    """

    point: Array
    radius: float
    count: int
    length: float


@dataclass(frozen=True, eq=False)
class _Shells:
    """Connected shells of a mesh: corners (N, 3), start of each shell, boxes."""

    corners: Array
    starts: npt.NDArray[np.int64]
    low: Array
    high: Array


_CACHE: WeakKeyDictionary[Mesh, _Shells] = WeakKeyDictionary()


def barrel_line(
    parts: Iterable[Part], axis: Array, origin: Array, reach: float, widest: float
) -> BarrelLine | None:
    """Find the line of barrels near a hinge's line and parallel to it, or None.

    Barrels are separate shells of a mesh; clouds have none. Of several lines, the one with the most
    barrels is chosen, then the longest.

    Args:
        parts: both sides of the hinge, whose barrels may alternate.
        axis: (3,) unit. origin: (3,) on the hinge's line.
        reach: largest distance of barrels from it, metres. widest: their largest radius, metres.
    """
    found = [c for p in parts if p.mesh is not None for c in _near(p.mesh, axis, origin, reach)]
    round_ = [r for c in found if (r := _circle(c, axis)) is not None and r[1] <= widest]
    if not round_:
        return None
    centers = np.array([r[0] for r in round_])
    radii = np.array([r[1] for r in round_])
    ends = np.array([r[2] for r in round_])
    off = centers - np.outer(centers @ axis, axis)
    best = None
    for k in range(len(centers)):
        line = np.linalg.norm(off - off[k], axis=1) <= IN_LINE * radii[k]
        # A duplicate, or a pin in its knuckle, counts as one barrel.
        count = len(np.unique(np.round(centers[line] @ axis / max(radii[k], 1e-9))))
        length = float(ends[line, 1].max() - ends[line, 0].min())
        if best is None or (count, length) > (best.count, best.length):
            place = off[line].mean(0) + axis * float(origin @ axis)
            best = BarrelLine(place, float(radii[line].max()), count, length)
    return best


def on_barrels(joint: Joint, child: Part, parent: Part) -> Joint | None:
    """Move the joint to the line of its hinge's barrels; None without two or a long one."""
    if joint.type != "revolute" or child.mesh is None:
        return None
    size = float(np.linalg.norm(np.ptp(child.bounds, axis=0)))
    axis, origin = np.asarray(joint.axis), np.asarray(joint.origin)
    line = barrel_line((child, parent), axis, origin, NEAR * size, WIDEST * size)
    if line is None or (line.count < 2 and line.length < PIANO * size):
        return None
    return replace(joint, origin=tuple(float(v) for v in line.point))


def _near(mesh: Mesh, axis: Array, origin: Array, reach: float) -> list[Array]:
    """Corners of each shell within reach of the line."""
    if not len(mesh.faces):
        return []
    shells = _shells(mesh)
    middle, half = (shells.low + shells.high) / 2, (shells.high - shells.low) / 2
    off = middle - origin
    off = off - np.outer(off @ axis, axis)
    # A barrel's box extends at most twice its radius sideways.
    close = np.linalg.norm(off, axis=1) <= reach
    ends = np.append(shells.starts[1:], len(shells.corners))
    across = half - np.outer(half @ np.abs(axis), np.abs(axis))
    small = np.linalg.norm(across, axis=1) <= 4 * reach
    return [shells.corners[shells.starts[k] : ends[k]] for k in np.flatnonzero(close & small)]


def _circle(corners: Array, axis: Array) -> tuple[Array, float, tuple[float, float]] | None:
    """Centre, radius and ends of a cylinder along the axis; None for another shape."""
    u = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    u = u / np.linalg.norm(u)
    v = np.cross(axis, u)
    flat = np.unique(np.round(corners @ np.stack([u, v], 1), 7), axis=0)
    if len(flat) < LEAST_CORNERS:
        return None
    low, high = flat.min(0), flat.max(0)
    middle, size = (low + high) / 2, high - low
    if size.min() < 0.85 * size.max() or size.max() <= 0:
        return None
    distance = np.linalg.norm(flat - middle, axis=1)
    # Rings of a bevel and centres of caps are inside.
    rim = flat[distance > 0.9 * distance.max()]
    angles = np.sort(np.arctan2(*(rim - middle).T[::-1]))
    gap = np.diff(np.append(angles, angles[0] + 2 * np.pi)).max() if len(rim) else np.inf
    if len(rim) < LEAST_CORNERS or gap > np.pi / 2:
        return None
    solved = np.linalg.lstsq(np.column_stack([2 * rim, np.ones(len(rim))]), (rim**2).sum(1))[0]
    center = solved[:2]
    radii = np.linalg.norm(rim - center, axis=1)
    radius = float(radii.mean())
    along = corners @ axis
    ends = float(along.min()), float(along.max())
    if radii.std() > ROUND_BARREL * radius or ends[1] - ends[0] < LONG * 2 * radius:
        return None
    return center[0] * u + center[1] * v + axis * (sum(ends) / 2), radius, ends


def _shells(mesh: Mesh) -> _Shells:
    if mesh not in _CACHE:
        shell = np.repeat(connected_shells(mesh, weld(mesh, 0.0)), 3)
        order = np.argsort(shell, kind="stable")
        corners = mesh.vertices[mesh.faces.reshape(-1)[order]]
        starts = np.flatnonzero(np.diff(shell[order], prepend=-1))
        _CACHE[mesh] = _Shells(
            corners,
            starts,
            np.minimum.reduceat(corners, starts, axis=0),
            np.maximum.reduceat(corners, starts, axis=0),
        )
    return _CACHE[mesh]
