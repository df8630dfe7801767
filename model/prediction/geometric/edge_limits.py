"""How far doors, lids and arms open: what people expect of them, and a motion sweep."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from model.core.part_names import mechanism_of
from model.prediction.geometric.context import PartContext
from model.prediction.geometric.hypothesis import Hypothesis
from model.prediction.geometric.sweep import free_turn

OPENING: dict[str, float] = {
    "hinge": 1.65,
    "drop": 1.571,
    "flap": 1.75,
    "temple": 1.5,
}
"""How far it opens from closed, in rad, where nothing stops it."""

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

NOTED: dict[str, str] = {"temple": "folding arm"}
"""What notes call a mechanism, where its own name is a narrow word."""

IN_PLANE = "folds in the arms' plane"
"""How the note of a folding arm goes on, where it stays beside its neighbours as it turns."""

FOLDED_TOTAL = 3.0
"""Whole range (rad) assumed for a panel that was scanned open, from closed to far open."""


RECLINE = 0.35
"""How far (rad) a backrest leans back, as the procedural chairs have it (0.2 to 0.45). The sweep's
tolerance lets it pass the seat that it grazes; a finer one stops it somewhere near this."""


def with_swept_limits(context: PartContext, best: Hypothesis) -> Hypothesis:
    """Limits of the chosen hinge from how far it turns before it hits its parent.

    A panel that was scanned closed opens one way. One scanned open closes as well: both free
    ranges count.
    """
    if {"pedal", "pad"} & set(context.words):
        arm = context.shape.center - best.origin
        down = float(np.cross(best.axis, arm)[2]) <= 0
        return replace(best, axis=best.axis if down else -best.axis, lower=0.0, upper=0.3)
    if "backrest" in context.words and context.category != "foldingchair":
        return _reclining(context, best)
    twin = _mirrored_twin(context)
    if best.note.startswith(NOTED["temple"]) and twin is not None and not context.closed:
        # Arms of a pair fold towards each other.
        arm = context.shape.center - best.origin
        inward = context.scene.shapes[twin].center - context.shape.center
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
    if IN_PLANE in best.note and min(closing, opening) > best.upper:
        return best  # arms that pass each other stop nowhere: as far as they usually go
    key = (context.category, "flap")
    total = (
        CATEGORY_OPENING.get(key, FOLDED_TOTAL) if best.note.startswith("flap") else FOLDED_TOTAL
    )
    if closing > opening:
        return replace(
            best,
            axis=-best.axis,
            lower=-opening,
            upper=max(0.3, min(closing, total - opening)),
        )
    return replace(best, lower=-closing, upper=max(0.3, min(opening, total - closing)))


def _reclining(context: PartContext, best: Hypothesis) -> Hypothesis:
    """A backrest leans back from where it stands."""
    arm = context.shape.center - best.origin
    away = context.shape.center - context.scene.shapes[context.parent].center
    away[2] = 0.0
    axis = best.axis if float(np.cross(best.axis, arm) @ away) >= 0 else -best.axis
    return replace(best, axis=axis, lower=0.0, upper=RECLINE)


def shut_front(context: PartContext, motion: Hypothesis) -> bool:
    """Whether a motion is a door's or a drawer's that was scanned shut, or a lid's that lies."""
    named, _ = mechanism_of(context.shape.name, context.scene.category)
    noted = motion.note.partition(":")[0]
    if "hinge" in (named, noted) or "drop" in (named, noted):
        return context.shut
    if "flap" in (named, noted):
        # One that leans on a wall is open.
        return abs(float(context.panel_normal[2])) > 0.9 and context.shut
    return named == "slide_out" and context.closed


def from_zero(context: PartContext, motion: Hypothesis) -> Hypothesis:
    """A motion that starts where it was scanned, where that is shut."""
    two_ways = motion.lower < 0 < motion.upper and motion.type in ("revolute", "prismatic")
    return replace(motion, lower=0.0) if two_ways and shut_front(context, motion) else motion


def _mirrored_twin(context: PartContext) -> int | None:
    """Another part of the same size on the other side of the parent."""
    own = np.sort(context.shape.box.half)
    for j in context.scene.others(context.part):
        other = context.scene.shapes[j]
        if j == context.parent or context.assembly.parent[j] != context.parent:
            continue
        if np.all(np.abs(np.sort(other.box.half) - own) < 0.3 * own + 0.01):
            return j
    return None
