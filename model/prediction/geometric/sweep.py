"""How far a part of a scene moves before it runs into another: the motion sweep for guesses."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.kinematics.surface import surface_of
from model.kinematics.sweep import TOLERANCE as SWEPT
from model.kinematics.sweep import free_until
from model.prediction.geometric.assembly import Scene
from model.prediction.geometric.context import PartContext
from model.prediction.geometric.shape import Shape

Array = npt.NDArray[np.float64]

TOLERANCE = 0.024
"""Depth (diagonals) up to which parts may meet: an axis that is guessed lies a bit beside the true
one, and its part then grazes what the true motion passes."""
OWN_THICKNESS = 0.5
"""The same in the moving part's thickness, where that is less: a thin one passes through what it
meets."""
POINTS = 1024
"""Samples a part."""


def free_range(
    scene: Scene,
    part: int,
    obstacles: tuple[int, ...],
    *,
    rotates: bool,
    axis: Array,
    origin: Array,
    stop: float,
    tolerance: float | None = None,
) -> float:
    """The largest q in [0, stop] (or [stop, 0]) that is reached without a collision.

    Args:
        scene: all parts.
        part: which one moves. obstacles: which ones stand still.
        rotates, axis, origin: the motion, working frame.
        stop: rad or diagonals; its sign gives the direction.
        tolerance: depth (diagonals) that is no collision yet; what suits the part by default.
            What a network reads has :data:`TOLERANCE`, as its weights were trained.
    """
    if not obstacles or stop == 0:
        return stop
    frame = scene.frame
    unit = 1.0 if rotates else frame.diagonal
    direction, point = frame.direction_in_object(axis), frame.point_in_object(origin)
    mover = scene.parts[part]
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
    made = {scene.parts[k].link: surface_of(scene.parts[k], POINTS) for k in (part, *obstacles)}
    surfaces = {link: s for link, s in made.items() if s is not None}
    tree = KinematicTree((others, mover.link), (joint,))
    finest = max((s.resolution for s in surfaces.values()), default=0.0)
    if tolerance is None:
        tolerance = own_tolerance(scene.shapes[part])
    depth = max(tolerance * frame.diagonal, finest)
    reached = free_until(tree, joint, surfaces, stop * unit, depth)
    return reached / unit


def free_turn(
    context: PartContext, axis: Array, origin: Array, stop: float, tolerance: float | None = None
) -> float:
    """:func:`free_range` of the part's turn (rad) against its parent."""
    return free_range(
        context.scene,
        context.part,
        (context.parent,),
        rotates=True,
        axis=axis,
        origin=origin,
        stop=stop,
        tolerance=tolerance,
    )


def own_tolerance(shape: Shape) -> float:
    """Diagonals that a part may go into others: less than :data:`TOLERANCE` where it is thin, and
    no less than the gate allows."""
    thickness = min(2 * float(shape.box.half.min()), shape.panel.high - shape.panel.low)
    return float(np.clip(OWN_THICKNESS * thickness, SWEPT, TOLERANCE))
