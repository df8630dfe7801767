"""Limits of proposed joints: collision-free ranges by a motion sweep, typical opening angles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from model.core.joint import JOINT_KINDS, Joint
from model.core.names import mechanism_of
from model.core.tree import KinematicTree
from model.kinematics.surface import surface_of
from model.kinematics.sweep import TOLERANCE as SWEPT
from model.kinematics.sweep import free_until
from model.prediction.builder import CHAIN_PLANE, left_out
from model.prediction.geometric.context import UPWARD, JointProposal, PartContext, three
from model.prediction.geometric.sampled_object import SampledObject
from model.prediction.geometric.shape import PartShape, same_extents

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
    line = three(direction), three(point)
    if rotates:
        joint = Joint("joint", "continuous", others, mover.link, *line)
    else:
        ends = min(stop * unit, 0.0), max(stop * unit, 0.0)
        joint = Joint("joint", "prismatic", others, mover.link, *line, *ends)
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
    who = (context.sampled, context.part, (context.parent,))
    line = {"axis": axis, "origin": origin, "stop": stop}
    return free_range(*who, rotates=True, **line, tolerance=tolerance)


def own_tolerance(shape: PartShape) -> float:
    """Penetration (diagonals) tolerated for a part: at most :data:`TOLERANCE`, less for thin parts,
    at least the tolerance of validation."""
    thickness = min(2 * float(shape.box.half.min()), shape.panel.high - shape.panel.low)
    return float(np.clip(OWN_THICKNESS * thickness, SWEPT, TOLERANCE))


OPENING: dict[str, float] = {"hinge": 1.65, "drop": 1.571, "flap": 1.75, "temple": 1.5}
"""Usual opening from shut (rad), unless something stops it earlier."""

CATEGORY_OPENING: dict[tuple[str, str], float] = {
    ("refrigerator", "hinge"): 2.3,
    ("box", "flap"): 2.6,
    ("door", "hinge"): 1.6,
    ("laptop", "flap"): 2.3,
    ("toilet", "flap"): 1.6,
    ("trashcan", "flap"): 1.6,
    ("washingmachine", "hinge"): 2.0,
    ("eyeglasses", "temple"): 1.45,
    ("stapler", "temple"): 1.9,
    ("safe", "hinge"): 1.9,
    ("lighter", "flap"): 2.2,
    ("keyboard", "flap"): 1.2,
    ("foldingchair", "flap"): 1.5,
    ("phone", "flap"): 2.6,
}

FOLDED_TOTAL = 3.0
"""Whole range (rad), from shut to far open, assumed for a panel that was scanned open."""

RECLINE = 0.35
"""Range (rad) of a backrest, from the procedural chairs (0.2 to 0.45): the sweep's tolerance would
let it pass the seat that it grazes."""


def with_swept_limits(context: PartContext, best: JointProposal) -> JointProposal:
    """The proposal with the limits within which the part is free of its parent.

    A panel that was scanned shut opens one way; one that was scanned open also closes.
    """
    if {"pedal", "pad"} & set(context.words):
        arm = context.shape.center - best.origin
        down = float(np.cross(best.axis, arm)[2]) <= 0
        return replace(best, axis=best.axis if down else -best.axis, lower=0.0, upper=0.3)
    if "backrest" in context.words and context.category != "foldingchair":
        return _reclining(context, best)
    twin = _mirrored_twin(context)
    if best.mechanism == "temple" and twin is not None and not context.closed:
        # The arms of a pair fold towards each other.
        arm = context.shape.center - best.origin
        inward = context.sampled.shapes[twin].center - context.shape.center
        axis = best.axis if float(np.cross(best.axis, arm) @ inward) >= 0 else -best.axis
        return replace(best, axis=axis, lower=0.0)

    def sweep(stop: float) -> float:
        return free_turn(context, best.axis, best.origin, stop)

    if context.closed or shut_front(context, best):
        opening = sweep(np.pi * 0.95)
        return replace(best, upper=min(best.upper, opening) if opening > 0.7 else best.upper)
    closing = -sweep(-np.pi * 0.95)
    opening = sweep(np.pi * 0.95)
    many = context.category == "box" or (
        not context.category and _mirrored_twin(context) is not None
    )
    if closing + opening > 4.4 and many:
        return replace(best, lower=-closing, upper=opening)
    if CHAIN_PLANE in best.reasons and min(closing, opening) > best.upper:
        return best  # members that pass each other collide nowhere: keep the usual limits
    total = FOLDED_TOTAL
    if best.mechanism == "flap":
        total = CATEGORY_OPENING.get((context.category, "flap"), FOLDED_TOTAL)
    if closing > opening:
        return replace(
            best,
            axis=-best.axis,
            lower=-opening,
            upper=max(0.3, min(closing, total - opening)),
        )
    return replace(best, lower=-closing, upper=max(0.3, min(opening, total - closing)))


def _reclining(context: PartContext, best: JointProposal) -> JointProposal:
    """A backrest leans back from its scanned pose."""
    arm = context.shape.center - best.origin
    away = context.shape.center - context.sampled.shapes[context.parent].center
    away[2] = 0.0
    axis = best.axis if float(np.cross(best.axis, arm) @ away) >= 0 else -best.axis
    return replace(best, axis=axis, lower=0.0, upper=RECLINE)


def shut_front(context: PartContext, motion: JointProposal) -> bool:
    """True if a motion is that of a door, drawer or lid that was scanned shut."""
    named, _ = mechanism_of(context.shape.name, context.sampled.category)
    mechanisms = (named, motion.mechanism)
    if "hinge" in mechanisms or "drop" in mechanisms:
        return context.shut
    if "flap" in mechanisms:
        # A lid that leans on a wall is open.
        return abs(float(context.panel_normal[2])) > UPWARD and context.shut
    return named == "slide_out" and context.closed


def from_zero(context: PartContext, motion: JointProposal) -> JointProposal:
    """The motion with 0 as its lower limit if the part was scanned shut."""
    kept = left_out("shut panels start at zero") or not JOINT_KINDS[motion.type].limited
    two_ways = motion.lower < 0 < motion.upper and not kept
    return replace(motion, lower=0.0) if two_ways and shut_front(context, motion) else motion


def _mirrored_twin(context: PartContext) -> int | None:
    """Another child of the parent with the same size."""
    for j in context.sampled.others(context.part):
        if j == context.parent or context.assembly.parent[j] != context.parent:
            continue
        if same_extents(context.sampled.shapes[j], context.shape, 0.3):
            return j
    return None
