"""Jobs that answer where: the surface under a ray, the elements in a box or under a stroke, and the
box, contact or free range that a joint snaps to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.server.part_tasks import PartSource, parts_of, segmented_object
from app.server.tasks import arrays_of, asset_of
from model.core.articulated_object import ArticulatedObject, Part
from model.core.errors import CommandError
from model.core.joint import Joint, JointType
from model.core.memory import LruCache
from model.core.tree import KinematicTree, moving_chain
from model.geometry.crop import largest_component
from model.geometry.picking import Picker, Stroke
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


@dataclass(frozen=True)
class Hidden:
    """Parts that a person has hidden: picking goes through them.

    Attributes:
        workspace: folder of the stored labels.
        labels: reference of the stored (E,) labels.
        parts: ids of the hidden parts.
    """

    workspace: Path
    labels: str
    parts: tuple[int, ...]


_pickers: LruCache[Path, Any] = LruCache(8)
_hidden: LruCache[Hidden, npt.NDArray[np.bool_]] = LruCache(4)


def picker_of(folder: Path) -> Any:
    """Return the picker of an asset, cached in this process."""
    return _pickers.get(folder, lambda: Picker(asset_of(folder, textures=False)))


def prepare_picking(folder: Path) -> None:
    """Build the ray structure before the first click needs it."""
    picker_of(folder)


def _elements_of(hidden: Hidden | None) -> npt.NDArray[np.bool_] | None:
    """Return the (E,) mask of hidden elements."""
    if hidden is None:
        return None
    return _hidden.get(
        hidden, lambda: np.isin(arrays_of(hidden.workspace).get(hidden.labels), hidden.parts)
    )


def pick(
    folder: Path,
    origin: tuple[float, float, float],
    direction: tuple[float, float, float],
    hidden: Hidden | None = None,
) -> Any:
    """Return ``Pick(position, element, normal)`` of a ray, or None for the background."""
    picker = picker_of(folder)
    return picker.pick(np.asarray(origin), np.asarray(direction), hidden=_elements_of(hidden))


def select_box(
    folder: Path,
    workspace: Path,
    camera: Any,
    corner_min: tuple[float, float],
    corner_max: tuple[float, float],
    *,
    one_piece: bool = False,
    hidden: Hidden | None = None,
) -> tuple[str, int]:
    """Store the visible elements inside a rectangle of the screen; returns reference and number.

    Args:
        one_piece: of a scan only the largest connected component.
    """
    chosen = picker_of(folder).select_box(
        camera, corner_min, corner_max, visible_only=True, hidden=_elements_of(hidden)
    )
    cloud = asset_of(folder, textures=False).cloud
    if one_piece and cloud is not None and len(chosen):
        chosen = chosen[largest_component(cloud.points[chosen])]
    return arrays_of(workspace).put(np.asarray(chosen, np.int64)), len(chosen)


def select_stroke(
    folder: Path, workspace: Path, camera: Any, stroke: Stroke, hidden: Hidden | None = None
) -> tuple[str, int]:
    """Store the visible elements under a stroke; returns reference and number."""
    chosen = picker_of(folder).select_stroke(camera, stroke, hidden=_elements_of(hidden))
    return arrays_of(workspace).put(np.asarray(chosen, np.int64)), len(chosen)


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
