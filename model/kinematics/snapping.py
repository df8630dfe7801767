"""Bringing a joint's axis to where the shape says it is: box axes, box edges, contact line."""

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
"""A contact is a line where it spreads less than this share of its length to the sides."""
ROUND = 0.5
"""A contact lies round an axis where it spreads at least this share as far one way as the other."""
SPOT = 0.2
"""A contact that is smaller than this share of the part is a spot."""
AT_SIDE = 0.03
"""How near to a side the contact counts as there, in the part's width."""


@dataclass(frozen=True, eq=False)
class Box:
    """An oriented box: columns of ``axes`` are its unit axes, longest first; half extents in m."""

    center: Vector
    axes: Vector
    half: Vector


def box_of(points: Vector) -> Box:
    """The tight box of (N, 3) points; upright and world-aligned where that is nearly as tight."""
    import trimesh

    low, high = points.min(0), points.max(0)
    half, center, axes = (high - low) / 2, (low + high) / 2, np.eye(3)
    try:
        to_origin, extents = trimesh.bounds.oriented_bounds(points)
        if np.prod(extents + 1e-9) < 0.93 * np.prod(2 * half + 1e-9):
            inverse = np.linalg.inv(to_origin)
            axes, center, half = inverse[:3, :3], inverse[:3, 3], np.asarray(extents) / 2
    except (ValueError, RuntimeError):
        # Flat or degenerate points have no hull; their world box is right then.
        pass
    order = np.argsort(-half, kind="stable")
    return Box(np.asarray(center, np.float64), np.asarray(axes, np.float64)[:, order], half[order])


def axis_along_box(joint: Joint, box: Box, which: BoxAxis) -> Joint:
    """The joint with its axis along the box's long, middle or short axis; its side is kept."""
    axis = box.axes[:, ("Long", "Middle", "Short").index(which)]
    if axis @ np.asarray(joint.axis) < -1e-9:
        axis = -axis
    return replace(joint, axis=tuple(float(v) for v in axis))


def origin_on_box_edge(joint: Joint, box: Box) -> Joint:
    """The joint moved to the box's nearest edge that runs along its axis.

    Raises:
        KinematicsError: where no edge does.
    """
    axis, origin = np.asarray(joint.axis), np.asarray(joint.origin)
    cosine = np.abs(axis @ box.axes)
    along = int(np.argmax(cosine))
    if cosine[along] < PARALLEL:
        raise KinematicsError(
            [f"joint {joint.name!r}: no box edge runs along its axis; choose the axis first"]
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
    """The joint moved to where child and parent touch.

    A line within 30° of the axis gives the axis as well. Of a spot, and of what lies round the
    axis, the middle counts. Elsewhere the middle is no hinge (a door lies on its frame all round):
    then the axis moves to the child's nearer side along it, where they touch there.

    Args:
        joint: its axis is kept, unless the contact gives another.
        child, parent: (N, 3) surface points.
        reach: how near counts as touching, in metres.

    Raises:
        KinematicsError: where they don't come near each other, or touch over a face but not at
            that side.
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
                "says no hinge line; take Box edge or Centre"
            ]
        )
    return moved


def _moved(joint: Joint, origin: Vector, axis: Vector) -> Joint:
    return replace(
        joint, origin=tuple(float(v) for v in origin), axis=tuple(float(v) for v in axis)
    )


def _wide_across(axis: Vector, contact: Vector, child: Vector) -> Vector | None:
    """The direction across the axis in which a contact is wide; None for a spot, and for what
    spreads about as far one way as the other."""
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
    """The joint on the side of the box that its axis is nearer to, as deep as the contact (N, 3)
    there; None where there is none, or the box lies askew to the axis."""
    axis = np.asarray(joint.axis)
    along, across = (int(np.argmax(np.abs(v @ box.axes))) for v in (axis, wide))
    if joint.type == "continuous" or abs(float(axis @ box.axes[:, along])) < PARALLEL:
        return None
    normal = box.axes[:, across]
    side = 1.0 if (np.asarray(joint.origin) - box.center) @ normal >= 0 else -1.0
    outermost = float(box.center @ normal) * side + box.half[across]
    inside = outermost - side * (contact @ normal)
    held = inside <= max(2 * reach, AT_SIDE * 2 * box.half[across])
    if along == across or held.sum() < 3:
        return None
    place = contact[held].mean(0)
    place = place + (side * outermost - float(place @ normal)) * normal
    direction = box.axes[:, along]
    return _moved(joint, place, direction if direction @ axis >= 0 else -direction)
