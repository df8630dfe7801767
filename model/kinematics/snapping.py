"""Snap a joint's axis to features of the shape: box axes, box edges, the contact line."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from model.core.errors import KinematicsError
from model.core.joint import Joint

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
            [f"joint {joint.name!r}: no box edge is parallel to its axis; choose the axis first"]
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
        raise KinematicsError(
            [
                f"joint {joint.name!r}: {joint.child} and {joint.parent} don't touch "
                f"({1000 * nearest:.0f} mm apart)"
            ]
        )
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
                f"joint {joint.name!r}: {joint.child} and {joint.parent} touch over a face, which "
                "defines no hinge line; take Box edge or Centre"
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
