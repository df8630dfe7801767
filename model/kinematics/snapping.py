"""Bringing a joint's axis to where the shape says it is: box axes, box edges, contact line."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from model.errors import KinematicsError
from model.kinematics.joint import Joint

Vector = npt.NDArray[np.float64]
BoxAxis = Literal["Long", "Middle", "Short"]
PARALLEL = 0.9
"""Cosine from which a box edge counts as parallel to the joint's axis."""


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

    Args:
        joint: its axis is kept, unless the contact is a clear line within 30° of it.
        child, parent: (N, 3) surface points.
        reach: how near counts as touching, in metres.

    Raises:
        KinematicsError: where they don't come near each other.
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
        if spread[1] < 0.25 * spread[0] and abs(line @ axis) > np.cos(np.pi / 6):
            axis = line if line @ axis > 0 else -line
    return replace(
        joint, origin=tuple(float(v) for v in center), axis=tuple(float(v) for v in axis)
    )
