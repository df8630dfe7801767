"""Collision-free range of a proposed joint, by a motion sweep."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.kinematics.surface import surface_of
from model.kinematics.sweep import TOLERANCE as SWEPT
from model.kinematics.sweep import free_until
from model.prediction.geometric.context import PartContext
from model.prediction.geometric.sampled_object import SampledObject
from model.prediction.geometric.shape import PartShape

Array = npt.NDArray[np.float64]

TOLERANCE = 0.024
"""Penetration (diagonals) that is tolerated: a proposed axis lies a little beside the true one, so
that its part grazes what the true motion passes."""
OWN_THICKNESS = 0.5
"""Upper bound of the tolerance in thicknesses of the moving part: a thin part would otherwise pass
through obstacles."""
POINTS = 1024
"""Surface points per part."""


def free_range(
    sampled: SampledObject,
    part: int,
    obstacles: tuple[int, ...],
    *,
    rotates: bool,
    axis: Array,
    origin: Array,
    stop: float,
    tolerance: float | None = None,
) -> float:
    """The q of largest magnitude between 0 and ``stop`` that is reached without a collision.

    Args:
        sampled: all parts.
        part: index of the moving part. obstacles: of those that stand still.
        rotates, axis, origin: the motion, working frame.
        stop: rad or diagonals; its sign gives the direction.
        tolerance: tolerated penetration (diagonals); :func:`own_tolerance` by default. The
            network's input needs :data:`TOLERANCE`, with which it was trained.
    """
    if not obstacles or stop == 0:
        return stop
    frame = sampled.frame
    unit = 1.0 if rotates else frame.diagonal
    direction, point = frame.direction_in_object(axis), frame.point_in_object(origin)
    mover = sampled.parts[part]
    others = f"not {mover.link}"
    joint = Joint(
        "joint",
        "continuous" if rotates else "prismatic",
        others,
        mover.link,
        (float(direction[0]), float(direction[1]), float(direction[2])),
        (float(point[0]), float(point[1]), float(point[2])),
        None if rotates else min(stop * unit, 0.0),
        None if rotates else max(stop * unit, 0.0),
    )
    made = {sampled.parts[k].link: surface_of(sampled.parts[k], POINTS) for k in (part, *obstacles)}
    surfaces = {link: s for link, s in made.items() if s is not None}
    tree = KinematicTree((others, mover.link), (joint,))
    finest = max((s.resolution for s in surfaces.values()), default=0.0)
    if tolerance is None:
        tolerance = own_tolerance(sampled.shapes[part])
    depth = max(tolerance * frame.diagonal, finest)
    reached = free_until(tree, joint, surfaces, stop * unit, depth)
    return reached / unit


def free_turn(
    context: PartContext, axis: Array, origin: Array, stop: float, tolerance: float | None = None
) -> float:
    """:func:`free_range` of the part's turn (rad) against its parent."""
    return free_range(
        context.sampled,
        context.part,
        (context.parent,),
        rotates=True,
        axis=axis,
        origin=origin,
        stop=stop,
        tolerance=tolerance,
    )


def own_tolerance(shape: PartShape) -> float:
    """Penetration (diagonals) tolerated for a part: at most :data:`TOLERANCE`, less for thin parts,
    at least the tolerance of validation."""
    thickness = min(2 * float(shape.box.half.min()), shape.panel.high - shape.panel.low)
    return float(np.clip(OWN_THICKNESS * thickness, SWEPT, TOLERANCE))
