"""Jobs that snap a joint to a box, contact or free range of its part, or change its type."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from app.server.part_tasks import PartSource, parts_of, segmented_object
from model.core.articulated_object import ArticulatedObject, Part
from model.core.errors import CommandError
from model.core.joint import Joint, JointType
from model.core.tree import KinematicTree, moving_chain
from model.geometry.sampling import sample_surface
from model.kinematics.snapping import (
    axis_along_box,
    box_of,
    on_barrels,
    origin_on_box_edge,
    origin_on_contact,
)
from model.kinematics.sweep import free_range
from model.prediction.geometric.roles import change_joint_type

SWEEP_POINTS = 3000


def snap_joint(source: PartSource, tree: KinematicTree, child: str, to: str) -> Joint:
    """Return the joint of ``child`` snapped to a feature of its part.

    Args:
        to: "axis Long", "axis Middle", "axis Short", "Box edge", "Contact", "Centre" or
            "free range" (limits up to the first collision).
    """
    parts = {p.link: p for p in parts_of(source)}
    joint = tree.joint_of[child]
    # Each joint of a serial chain snaps to the part at its end, and to the next part above.
    chain = moving_chain(tree, child, parts.__contains__)
    moved, above = chain[-1], tree.joint_of[chain[0]].parent
    if moved not in parts:
        raise CommandError(f"{child} carries several parts: it can't be snapped to one")
    points = _surface_points(parts[moved])
    if to == "free range":
        along = points @ np.asarray(joint.axis)
        most = math.pi if joint.rotates else 0.95 * float(np.ptp(along))
        return _with_free_range(source, tree, joint, tuple(parts.values()), most)
    if to.startswith("axis "):
        return axis_along_box(joint, box_of(points), to.removeprefix("axis "))  # type: ignore[arg-type]
    if to == "Box edge":
        return origin_on_box_edge(joint, box_of(points))
    if to == "Centre":
        return replace(joint, origin=tuple(float(v) for v in box_of(points).center))
    if above not in parts:
        raise CommandError(f"{above} has no geometry to touch")
    both = (parts[moved], parts[above])
    found = on_barrels(joint, *both)
    if found is not None:
        return found
    reach = 0.01 * float(np.linalg.norm(np.ptp(points, axis=0)))
    at_contact = origin_on_contact(joint, points, _surface_points(parts[above]), reach)
    # Barrels parallel to the present axis give it more exactly than a contact does.
    found = on_barrels(replace(at_contact, axis=joint.axis), *both) or on_barrels(at_contact, *both)
    return found or at_contact


def change_type(source: PartSource, tree: KinematicTree, child: str, kind: JointType) -> Joint:
    """Return the joint of ``child`` as one of another type."""
    return change_joint_type(segmented_object(source), tree, child, kind)


def _surface_points(part: Part) -> npt.NDArray[np.float64]:
    if part.mesh is not None and len(part.mesh.faces):
        samples, _ = sample_surface(part.mesh, SWEEP_POINTS, np.random.default_rng(0))
        corners = part.mesh.vertices[np.unique(part.mesh.faces)]
        return np.concatenate([samples.points.astype(np.float64), corners])
    assert part.cloud is not None
    points = part.cloud.points.astype(np.float64)
    if len(points) > 4 * SWEEP_POINTS:
        keep = np.random.default_rng(0).choice(len(points), 4 * SWEEP_POINTS, replace=False)
        points = points[keep]
    return points


def _with_free_range(
    source: PartSource, tree: KinematicTree, joint: Joint, parts: tuple[Part, ...], most: float
) -> Joint:
    lower, upper = free_range(ArticulatedObject(source.title, parts, tree), joint.name, most)
    closed_below, closed_above = joint.lower == 0.0, joint.upper == 0.0
    return replace(
        joint,
        lower=0.0 if closed_below else float(lower),
        upper=0.0 if closed_above else float(upper),
    )
