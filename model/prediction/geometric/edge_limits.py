"""Limits of edge hinges: typical opening angles and motion sweeps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from model.core.joint import JOINT_KINDS
from model.core.names import mechanism_of
from model.prediction.explanation import Reason
from model.prediction.geometric.context import PartContext
from model.prediction.geometric.proposal import JointProposal
from model.prediction.geometric.shape import same_extents
from model.prediction.geometric.sweep import free_turn

OPENING: dict[str, float] = {
    "hinge": 1.65,
    "drop": 1.571,
    "flap": 1.75,
    "temple": 1.5,
}
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
    if Reason.CHAIN_PLANE in best.reasons and min(closing, opening) > best.upper:
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
        return abs(float(context.panel_normal[2])) > 0.9 and context.shut
    return named == "slide_out" and context.closed


def from_zero(context: PartContext, motion: JointProposal) -> JointProposal:
    """The motion with 0 as its lower limit if the part was scanned shut."""
    two_ways = motion.lower < 0 < motion.upper and JOINT_KINDS[motion.type].limited
    return replace(motion, lower=0.0) if two_ways and shut_front(context, motion) else motion


def _mirrored_twin(context: PartContext) -> int | None:
    """Another child of the parent with the same size."""
    for j in context.sampled.others(context.part):
        if j == context.parent or context.assembly.parent[j] != context.parent:
            continue
        if same_extents(context.sampled.shapes[j], context.shape, 0.3):
            return j
    return None
