"""Revolute proposals: pins beside a part, and axes through it.

Pins are of scissors, bails, levers, rockers, tilting heads; axes through the part of wheels, knobs,
caps, spouts, turntables.
"""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from model.kinematics.sweep import TOLERANCE as SWEPT
from model.prediction.builder import left_out
from model.prediction.geometric.context import (
    ACROSS,
    PARALLEL,
    UP,
    JointProposal,
    PartContext,
    unit,
)
from model.prediction.geometric.limits import TOLERANCE, free_turn
from model.prediction.geometric.shape import (
    NOTHING,
    TINY,
    PartShape,
    Roundness,
    blades,
    roundness,
    same_extents,
)
from model.prediction.geometric.tree import LEAF, chain_plane

Array = npt.NDArray[np.float64]

CROSSED_PARTS, CROSSED_FRAMES = "where the parts cross", "where the frames cross"
ONE_END, SUPPORT = "held at one end", "vertical through its support"
SYMMETRY = "about its symmetry axis"
"""Reasons for a joint's place, as in notes to the reader."""
MIN_RANGE = 0.2
"""Collision-free range (rad) below which the pin is misplaced, so that its range is meaningless."""
SPINDLE = 1.0
"""Score of a lever's axis across the leaf that holds it; chosen by us, not tuned."""
ON_PANEL, KNOB_AXIS, ALONG = 2.0, 5.5, 0.98
"""What an axis of symmetry gains along the normal of a knob's panel; score of the normal itself, as
of such an axis; cosine from which one is along the other."""
OF_OBJECT, ROUGH = 0.9995, 0.11
"""Cosine to a direction of the object; spread of radii over their mean of what is barely round."""
SWING_UP, SWING_DOWN, QUARTER, LEVER_TURN = (-1.5, 1.5), (-0.8, 2.4), 1.57, 1.571
ROCKS, TILT, LEAST_TILT = 0.28, 0.6, 0.15
"""Usual ranges (rad) of bails that stand and hang, levers, rockers; swept and least of heads."""


def pivot_proposals(context: PartContext) -> list[JointProposal]:
    """About the common thin direction, where the two parts cross or where their ends meet."""
    shape, base = context.shape, context.parent_shape
    both = np.concatenate([shape.points, base.points])
    some = (both - both.mean(0))[:: max(1, len(both) // 2000)]
    _, _, rows = np.linalg.svd(some, full_matrices=len(some) < 3)  # always three rows
    thin = shape.box.axes[:, shape.order[0]]
    common = rows[2]
    axis = thin if abs(thin @ common) > 0.8 or shape.thinness < 0.35 else common
    cross = crossing_point(shape, base, axis)
    contact = context.contact_center
    found = []
    if cross is not None:
        inside = _inside_both(cross, shape, base, axis)
        found.append(_pin(axis, cross, 1.5 * inside, CROSSED_PARTS))
    found.append(_pin(axis, contact, 0.6, "at the contact"))
    if same_extents(shape, base):
        # Two equal parts cross; neither holds the other at its end.
        found = [dataclasses.replace(p, score=p.score + 1.0) for p in found]
    found += [] if left_out("pins at ends") else _end_pivots(context, axis)
    found += _crossed_frames(context)
    return [_pivot_limits(context, p) for p in found]


def _pin(
    axis: Array, origin: Array, score: float, reason: str, lower: float = 0.0, upper: float = 0.0
) -> JointProposal:
    return JointProposal("revolute", axis, origin, lower, upper, score, reasons=(reason,))


def _crossed_frames(context: PartContext) -> list[JointProposal]:
    """Flat frames that cross, as the legs of a folding chair, turn about their common line."""
    shape, base = context.shape, context.parent_shape
    if shape.slenderness < 0.3 or shape.thinness > 0.5:
        return []
    a = shape.box.axes[:, shape.order[0]]
    b = base.principal[:, 2]
    axis = np.cross(a, b)
    if np.linalg.norm(axis) < np.sin(np.deg2rad(15)):
        return []
    return [_pin(unit(axis), context.contact_center, 2.2, CROSSED_FRAMES)]


def crossing_point(shape: PartShape, base: PartShape, axis: Array) -> Array | None:
    """(3,) where the long axes cross, seen along ``axis``; None if they are nearly parallel."""
    a, b = shape.principal[:, 0], base.principal[:, 0]
    u = unit(a - (a @ axis) * axis)
    v = unit(b - (b @ axis) * axis)
    sine = float(np.cross(u, v) @ axis)
    if abs(sine) < np.sin(np.deg2rad(12)):
        return None
    step = base.points.mean(0) - shape.points.mean(0)
    t = float(np.cross(step, v) @ axis) / sine
    at = shape.points.mean(0) + t * u
    middle = 0.5 * (shape.center + base.center)
    return at + axis * float((middle - at) @ axis)


def _inside_both(point: Array, shape: PartShape, base: PartShape, axis: Array) -> float:
    """0..1: 1 if both parts have surface around the point, seen along the axis."""
    out = 1.0
    for s in (shape, base):
        d = s.points - point
        r = np.linalg.norm(d - np.outer(d @ axis, axis), axis=1)
        out = min(out, float(np.exp(-max(0.0, float(r.min()) - 0.02) / 0.05)))
    return out


def _end_pivots(context: PartContext, axis: Array) -> list[JointProposal]:
    """A pin near each end of the part."""
    shape = context.shape
    long = unit(shape.principal[:, 0] - (shape.principal[:, 0] @ axis) * axis)
    along = shape.points @ long
    low, high = np.quantile(along, [0.02, 0.98])
    width = max(0.08 * (high - low), 0.01)
    found = []
    for end, inward in ((low, 1.0), (high, -1.0)):
        band = np.abs(along - (end + inward * width)) < width
        if band.sum() < 4:
            continue
        spot = shape.points[band].mean(0)
        near = float(np.median(context.distance[band]))
        rest = float(np.median(context.distance))
        score = 0.5 + 1.2 * float(np.clip((rest - near) / 0.1, -1, 1))
        # A folding blade is held at the end that lies deeper inside the handle.
        score += 0.8 * _inside(spot, context.parent_shape)
        found.append(_pin(axis, spot, score, ONE_END))
    return found


def _inside(point: Array, base: PartShape) -> float:
    """0..1: 1 well inside the parent's box, 0 outside.

    The place along the parent doesn't count: a folded blade is pinned near the handle's end.
    """
    local = np.abs(base.box.axes.T @ (point - base.center)) / np.maximum(base.box.half, TINY)
    long = base.order[2]
    if local[long] < 1:
        local[long] = 0
    return float(np.clip(1.2 - local.max(), 0, 1))


def _pivot_limits(context: PartContext, h: JointProposal) -> JointProposal:
    scissors = context.category in ("scissors", "pliers")
    # For sheets that turn in their common plane only sense and size of the range can be judged.
    arm = context.shape.points.mean(0) - h.origin
    base_arm = context.parent_shape.points.mean(0) - h.origin
    closing = float(np.cross(arm, base_arm) @ h.axis)
    axis = h.axis if closing <= 0 else -h.axis
    if scissors:
        a, b = context.shape.principal[:, 0], context.parent_shape.principal[:, 0]
        angle = float(np.arccos(np.clip(abs(a @ b), 0, 1)))
        return dataclasses.replace(h, axis=axis, lower=-angle, upper=max(0.2, 0.9 - angle))
    return dataclasses.replace(h, axis=axis, lower=0.0, upper=2.9)


def within_reach(context: PartContext, h: JointProposal) -> JointProposal:
    """The proposal with its collision-free range, to the tolerance of validation.

    Only for parts that cross, as a blade that folds into its handle grazes it all the way, and
    not below :data:`MIN_RANGE`.
    """
    if not {CROSSED_PARTS, CROSSED_FRAMES} & set(h.reasons):
        return h

    def free(stop: float) -> float:
        return free_turn(context, h.axis, h.origin, stop, SWEPT)

    lower, upper = free(h.lower), free(h.upper)
    if upper - lower < MIN_RANGE:
        return h
    return dataclasses.replace(h, lower=lower, upper=upper)


def swing_proposals(context: PartContext) -> list[JointProposal]:
    """A bail turns about the line through its two supports."""
    shape = context.shape
    contact = context.contact
    up = float(shape.center[2] - contact[:, 2].mean()) >= 0
    found = []
    for k in range(3):
        axis = shape.box.axes[:, k]
        if abs(axis[2]) > ACROSS:
            continue
        along = (contact - contact.mean(0)) @ axis
        reach = 2 * shape.box.reach(axis)
        spread = float(np.ptp(np.quantile(along, [0.05, 0.95]))) / max(reach, TINY)
        score = 2.0 * spread + 0.6 * float(shape.box.half[k] / shape.box.half.max())
        low, high = contact[along < 0], contact[along >= 0]
        origin = contact.mean(0)
        if len(low) and len(high):
            origin = 0.5 * (low.mean(0) + high.mean(0))
        found.append(
            _pin(axis, origin, score, "held at both ends", *(SWING_UP if up else SWING_DOWN))
        )
    if found:
        return found
    axis = shape.box.axes[:, shape.order[1]]
    return [_pin(axis, context.contact_center, 0.0, ONE_END, 0.0, QUARTER)]


def lever_proposals(context: PartContext) -> list[JointProposal]:
    """A lever turns about its stem; positive q turns it to the front."""
    shape = context.shape
    covers = context.covers
    long = shape.order[2]
    arm = shape.points.mean(0) - context.contact_center
    found = []
    along = shape.box.axes[:, long]
    # The spindle of a door's lever goes through the leaf.
    base = context.parent_shape
    normal, leaf = base.box.axes[:, base.panel.normal], base.thinness < LEAF
    choices = list(zip(context.directions, covers, np.roll(covers, 3), strict=True))
    if shape.thinness > 0.7:
        # The box of a rod is arbitrary about its length: add the object's directions.
        e = np.concatenate([np.eye(3), -np.eye(3)])
        there = [context.sampled.cover(context.part, d, (context.parent,)) for d in e]
        choices += list(zip(e, there, np.roll(there, 3), strict=True))
    for direction, ahead, behind in choices:
        through = leaf * abs(float(direction @ normal))
        if abs(direction @ along) > ACROSS and shape.slenderness < 0.6 and through < 0.9:
            continue
        score = 1.2 * behind - 0.8 * ahead + 0.1 * float(np.abs(direction).max() > 0.999)
        score += SPINDLE * through
        score += 0.9 * float(direction @ unit(shape.center - context.parent_shape.center))
        score += 0.8 * float(direction @ unit(arm))
        origin = context.contact_center
        axis = direction
        tip = shape.points.mean(0) - origin
        tip = tip - (tip @ axis) * axis
        if float(np.cross(axis, tip) @ context.assembly.front) < -1e-3:
            axis = -axis
        found.append(_pin(axis, origin, score, "about its stem", 0.0, LEVER_TURN))
    return found


def toggle_proposals(context: PartContext) -> list[JointProposal]:
    """A rocker tilts about an axis within its plate, through its centre."""
    shape = context.shape
    outward = context.outward
    found = []
    for k in range(3):
        axis = shape.box.axes[:, k]
        if abs(axis @ outward) > ACROSS:
            continue
        rest = [j for j in range(3) if j != k]
        across = max(
            float(shape.box.half[j]) for j in rest if abs(shape.box.axes[:, j] @ outward) < ACROSS
        )
        score = across / max(float(shape.box.half.max()), NOTHING)
        score += 0.4 * (1 - abs(float(axis @ UP)))
        origin = shape.center - outward * 0.6 * shape.box.reach(outward)
        found.append(_pin(axis, origin, score, "about its middle", -ROCKS, ROCKS))
    return found


def tilt_proposals(context: PartContext) -> list[JointProposal]:
    """A screen or head tilts about a horizontal axis through its mount."""
    shape = context.shape
    found = []
    origin = context.contact_center
    level = [k for k in range(3) if abs(shape.box.axes[2, k]) <= ACROSS]
    longest = max(float(shape.box.half.max()), NOTHING)
    choices = [(shape.box.axes[:, k], float(shape.box.half[k]) / longest) for k in level]
    plane = chain_plane(context.assembly, context.part)
    if plane is not None and abs(float(plane.normal[2])) < ACROSS:
        # The head of a lamp turns as the members of its chain.
        choices.append((plane.normal, 1.2 + 1.5 * plane.certainty))
    for axis, score in choices:
        down = -free_turn(context, axis, origin, -TILT, TOLERANCE)
        up = free_turn(context, axis, origin, TILT, TOLERANCE)
        low, high = -max(down, LEAST_TILT), max(up, LEAST_TILT)
        found.append(_pin(axis, origin, score, "about its mount", low, high))
    return found


def spin_proposals(context: PartContext) -> list[JointProposal]:
    """About each axis of symmetry that the part may have."""
    shape = context.shape
    wheel = bool({"wheel", "roller", "tire"} & set(context.words))
    outwardness = dict(
        zip(map(tuple, context.directions.round(6)), context.outwardness, strict=True)
    )
    rough = shape.scanned and shape.size < 60 * shape.noise
    found, normal, axes = [], context.knob_normal, shape.roundnesses
    least = KNOB_AXIS if shape.scanned else 0.0  # a mesh shows its own axis
    if rough:  # too noisy for directions of its own
        axes = [r for r in axes if np.abs(r.axis).max() >= OF_OBJECT]
    if normal is not None and all(abs(r.axis @ normal) < ALONG for r in axes):
        found.append(_continuous(normal, shape.center, max(ON_PANEL, least), "normal to its panel"))
    for r in axes:
        score, origin = _spin_score(context, r, outwardness, wheel)
        cosine = 0.0 if normal is None else abs(float(r.axis @ normal))
        score += ON_PANEL * cosine
        score = score if cosine < ALONG else max(score, least)
        reason = SYMMETRY if r.round else "through its centre, barely round"
        found.append(_continuous(r.axis, origin, score, reason))
    ball = normal is None and shape.ball and shape.size > 25 * shape.noise
    poles = _poles(context) if ball and not wheel else None
    if poles is not None:
        found.append(_continuous(poles, shape.center, 4.5, "between its two supports"))
    fold = blades(shape)
    if fold is not None:
        found.append(_continuous(fold[0], fold[1], 4.0, "axis of its equal blades"))
    if not found:
        thin = shape.box.axes[:, shape.order[0]]
        found.append(JointProposal("continuous", thin, shape.center))
    return found


def _continuous(axis: Array, origin: Array, score: float, reason: str) -> JointProposal:
    return JointProposal("continuous", axis, origin, score=score, reasons=(reason,))


def _spin_score(
    context: PartContext, r: Roundness, outwardness: dict[tuple[float, ...], float], wheel: bool
) -> tuple[float, Array]:
    """Score of an axis of symmetry, and a point on it."""
    shape = context.shape
    score = 2.5 * float(np.clip(1 - r.spread / ROUGH, -0.5, 1))
    # A disc turns about its short axis, a rod about its long one.
    score += 0.4 * float(np.clip(1 - r.half / max(r.radius, TINY), -0.3, 1))
    level = 1 - abs(float(r.axis @ UP))
    score += _scan_bonus(shape, r.axis)
    if wheel:
        score += 1.2 * level
    for sign in (-1.0, 1.0):
        out = outwardness.get(tuple((sign * r.axis).round(6)))
        if out is not None and not wheel:
            score += 0.4 * max(0.0, float(out))
    if context.clock_hand and abs(r.axis @ shape.box.axes[:, shape.order[0]]) > PARALLEL:
        return score + 3.0, _hub(context, r)
    return score, r.center


def _scan_bonus(shape: PartShape, axis: Array) -> float:
    """Bonus of the object's directions on scans, where missing sides tilt a part's own axes."""
    return 0.9 if shape.scanned and np.abs(axis).max() > OF_OBJECT else 0.0


def _hub(context: PartContext, r: Roundness) -> Array:
    """Centre of a clock's hands: that of its round face, else where the hands cross."""
    face = roundness(context.parent_shape.outline, r.axis, context.parent_shape.scanned)
    if face is not None and face.round:
        return face.center
    other = _other_hand(context)
    if other is not None:
        a, b = context.shape, context.sampled.shapes[other]
        at = crossing_point(a, b, r.axis)
        return at if at is not None else context.sampled.contact(context.part, other).mean(0)
    return context.parent_shape.center


def _other_hand(context: PartContext) -> int | None:
    """Another clock hand on the same dial that reaches over this one."""
    shape = context.shape
    thin = shape.box.axes[:, shape.order[0]]
    found = [j for j in context.crossing_hands(thin) if context.sampled.gap[context.part, j] < 0.05]
    return max(found, key=lambda j: (context.sampled.shapes[j].size, -j)) if found else None


def _poles(context: PartContext) -> Array | None:
    """(3,) axis through the two opposite supports of a ball; None if it has no such supports."""
    shape = context.shape
    out = context.contact - shape.center
    if len(out) < 6:
        return None
    _, _, rows = np.linalg.svd(out, full_matrices=False)
    along = out @ rows[0]
    reach = shape.box.half.max()
    if min(along.max(), -along.min()) < 0.6 * reach:
        return None
    high, low = out[along > 0.5 * reach].mean(0), out[along < -0.5 * reach].mean(0)
    return unit(high - low)


def swivel_proposals(context: PartContext) -> list[JointProposal]:
    """About a vertical axis: the part's own if it is round, else through its support."""
    shape = context.shape
    up = context.upright()
    found = []
    r = roundness(shape.outline, up, shape.scanned)
    if r is not None:
        found.append(_continuous(up, r.center, 1.5 - 12 * r.spread, SYMMETRY))
    for axis, score in ((up, 0.7), (UP, 0.9)):
        found.append(_continuous(axis, _support(context), score, SUPPORT))
    return found


def _support(context: PartContext) -> Array:
    """Centre of the contact."""
    return 0.5 * (context.contact.min(0) + context.contact.max(0))


def screw_proposals(context: PartContext) -> list[JointProposal]:
    """A cap that turns and comes off, or a seat that turns and rises."""
    shape = context.shape
    up = context.upright()
    if "seat" in context.words or (shape.roundest is None and shape.size > 0.4):
        seat = _continuous(up, _support(context), 1.0, SUPPORT)
        return [replace(seat, travel=(0.0, 0.06))]
    best: JointProposal | None = None
    along = unit(shape.center - context.parent_shape.center)
    for r in shape.roundnesses:
        axis = r.axis * (1.0 if r.axis @ along >= 0 else -1.0)
        score = 2.0 * float(np.clip(1 - r.spread / ROUGH, -0.5, 1)) + float(axis @ along)
        score += 0.4 * abs(float(axis @ UP)) + _scan_bonus(shape, axis)
        travel = (0.0, float(np.clip(0.6 * 2 * r.half, 0.02, 0.08)))
        if best is None or score > best.score:
            cap = _continuous(axis, r.center, score, SYMMETRY)
            best = replace(cap, travel=travel)
    if best is None:
        best = JointProposal("continuous", up, shape.center, travel=(0.0, 0.05))
    return [best]
