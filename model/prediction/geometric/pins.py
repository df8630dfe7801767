"""Parts that turn about a pin: scissors, handles, levers, rockers, heads."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from model.kinematics.sweep import TOLERANCE as SWEPT
from model.prediction.geometric.context import PartContext
from model.prediction.geometric.hypothesis import UP, Hypothesis, unit
from model.prediction.geometric.outline import roundness
from model.prediction.geometric.serial_chains import arm_plane
from model.prediction.geometric.shape import Shape
from model.prediction.geometric.sweep import TOLERANCE, free_turn

Array = npt.NDArray[np.float64]

CROSSING = ("where the two cross", "where the two frames cross")
"""How notes say that two parts cross: scissors, legs of a folding chair."""
LEAST_TURN = 0.2
"""Range (rad) below which a motion sweep says nothing of a pin."""


def pivot_hypotheses(context: PartContext) -> list[Hypothesis]:
    """About the common thin direction, where the two parts cross or where their ends meet."""
    shape, base = context.shape, context.base
    both = np.concatenate([shape.points, base.points])
    _, _, rows = np.linalg.svd(
        (both - both.mean(0))[:: max(1, len(both) // 2000)], full_matrices=False
    )
    thin = shape.box.axes[:, shape.order[0]]
    common = rows[2]
    axis = thin if abs(thin @ common) > 0.8 or shape.thinness < 0.35 else common
    cross = crossing(shape, base, axis)
    contact = context.contact_center
    found = []
    if cross is not None:
        inside = _inside_both(cross, shape, base, axis)
        found.append(Hypothesis("revolute", axis, cross, score=1.5 * inside, note=CROSSING[0]))
    found.append(Hypothesis("revolute", axis, contact, score=0.6, note="where the two touch"))
    if alike(shape, base):
        found = [h.scored(1.0) for h in found]  # two of a kind cross; neither holds the other's end
    found += _end_pivots(context, axis) + _crossed_frames(context)
    return [_pivot_limits(context, h) for h in found]


def alike(a: Shape, b: Shape, tolerance: float = 0.25) -> bool:
    """Whether two parts have nearly the same box."""
    x, y = np.sort(a.box.half), np.sort(b.box.half)
    return bool(np.all(np.abs(x - y) < tolerance * y + 0.01))


def _crossed_frames(context: PartContext) -> list[Hypothesis]:
    """Flat frames that cross like the legs of a folding chair turn about their common line."""
    shape, base = context.shape, context.base
    if shape.slenderness < 0.3 or shape.thinness > 0.5:
        return []
    a = shape.box.axes[:, shape.order[0]]
    b = base.principal[:, 2]
    axis = np.cross(a, b)
    if np.linalg.norm(axis) < np.sin(np.deg2rad(15)):
        return []
    spot = context.contact_center
    return [Hypothesis("revolute", unit(axis), spot, score=2.2, note=CROSSING[1])]


def crossing(shape: Shape, base: Shape, axis: Array) -> Array | None:
    """(3,) where the long axes cross, seen along ``axis``; None where they are nearly parallel."""
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


def _inside_both(point: Array, shape: Shape, base: Shape, axis: Array) -> float:
    """1 where both parts have surface around the point, seen along the axis; else less."""
    out = 1.0
    for s in (shape, base):
        d = s.points - point
        r = np.linalg.norm(d - np.outer(d @ axis, axis), axis=1)
        out = min(out, float(np.exp(-max(0.0, float(r.min()) - 0.02) / 0.05)))
    return out


def _end_pivots(context: PartContext, axis: Array) -> list[Hypothesis]:
    """Near each end of the part, where the parent reaches too."""
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
        # A folding blade is held at the end that lies farther inside the handle.
        score += 0.8 * _inside(spot, context.base)
        found.append(Hypothesis("revolute", axis, spot, score=score, note="held at its end"))
    return found


def _inside(point: Array, base: Shape) -> float:
    """1 well inside the parent's box, 0 outside.

    Where along the parent it is does not matter: a blade folded in is pinned near the handle's end.
    """
    local = np.abs(base.box.axes.T @ (point - base.center)) / np.maximum(base.box.half, 1e-6)
    long = base.order[2]
    if local[long] < 1:
        local[long] = 0
    return float(np.clip(1.2 - local.max(), 0, 1))


def _pivot_limits(context: PartContext, h: Hypothesis) -> Hypothesis:
    scissors = context.category in ("scissors", "pliers")
    # In-plane motion of touching sheets: only the turn's sense and size can be judged.
    arm = context.shape.points.mean(0) - h.origin
    base_arm = context.base.points.mean(0) - h.origin
    closing = float(np.cross(arm, base_arm) @ h.axis)
    axis = h.axis if closing <= 0 else -h.axis
    if scissors:
        a, b = context.shape.principal[:, 0], context.base.principal[:, 0]
        angle = float(np.arccos(np.clip(abs(a @ b), 0, 1)))
        return dataclasses.replace(h, axis=axis, lower=-angle, upper=max(0.2, 0.9 - angle))
    return dataclasses.replace(h, axis=axis, lower=0.0, upper=2.9)


def within_reach(context: PartContext, h: Hypothesis) -> Hypothesis:
    """Two that cross turn as far as nothing stops them, to the gate's own tolerance.

    Others stay as they are: a blade that folds into its handle rubs along it all the way. So do
    those that stop at once: their pin is a guess.
    """
    if not h.note.startswith(CROSSING):
        return h

    def free(stop: float) -> float:
        return free_turn(context, h.axis, h.origin, stop, SWEPT)

    lower, upper = free(h.lower), free(h.upper)
    if upper - lower < LEAST_TURN:
        return h
    return dataclasses.replace(h, lower=lower, upper=upper)


def swing_hypotheses(context: PartContext) -> list[Hypothesis]:
    """A bail turns about the line through the two places that hold it."""
    shape = context.shape
    contact = context.contact
    up = float(shape.center[2] - contact[:, 2].mean()) >= 0
    found = []
    for k in range(3):
        axis = shape.box.axes[:, k]
        if abs(axis[2]) > 0.5:
            continue
        along = (contact - contact.mean(0)) @ axis
        reach = 2 * shape.box.reach(axis)
        spread = float(np.ptp(np.quantile(along, [0.05, 0.95]))) / max(reach, 1e-6)
        score = 2.0 * spread + 0.6 * float(shape.box.half[k] / shape.box.half.max())
        low, high = contact[along < 0], contact[along >= 0]
        origin = contact.mean(0)
        if len(low) and len(high):
            origin = 0.5 * (low.mean(0) + high.mean(0))
        found.append(
            Hypothesis(
                "revolute",
                axis,
                origin,
                -1.5 if up else -0.8,
                1.5 if up else 2.4,
                score,
                "bail held at both ends",
            )
        )
    return found or temple_like(context)


def temple_like(context: PartContext) -> list[Hypothesis]:
    """Turn about the middle box axis through the contact."""
    shape = context.shape
    axis = shape.box.axes[:, shape.order[1]]
    return [Hypothesis("revolute", axis, context.contact_center, 0.0, 1.57, 0.0, "held at one end")]


def lever_hypotheses(context: PartContext) -> list[Hypothesis]:
    """A handle turns about the stem that it stands on; positive turns it to the front."""
    shape = context.shape
    covers = context.covers
    long = shape.order[2]
    arm = shape.points.mean(0) - context.contact_center
    found = []
    along = shape.box.axes[:, long]
    choices = list(zip(context.directions, covers, np.roll(covers, 3), strict=True))
    if shape.thinness > 0.7:
        # A rod's box may lie anyhow about its own length: offer the object's directions too.
        e = np.concatenate([np.eye(3), -np.eye(3)])
        there = [context.scene.cover(context.part, d, (context.parent,)) for d in e]
        choices += list(zip(e, there, np.roll(there, 3), strict=True))
    for direction, ahead, behind in choices:
        if abs(direction @ along) > 0.5 and shape.slenderness < 0.6:
            continue
        score = 1.2 * behind - 0.8 * ahead + 0.1 * float(np.abs(direction).max() > 0.999)
        score += 0.9 * float(direction @ unit(shape.center - context.base.center))
        score += 0.8 * float(direction @ unit(arm))
        origin = context.contact_center
        r = roundness(
            shape.points[context.distance <= np.quantile(context.distance, 0.25)], direction, True
        )
        if r is not None and r.spread < 0.12:
            origin = r.center
        axis = direction
        tip = shape.points.mean(0) - origin
        tip = tip - (tip @ axis) * axis
        if float(np.cross(axis, tip) @ context.assembly.front) < -1e-3:
            axis = -axis
        found.append(
            Hypothesis("revolute", axis, origin, 0.0, 1.571, score, "turns about its stem")
        )
    return found


def toggle_hypotheses(context: PartContext) -> list[Hypothesis]:
    """A rocker tilts about a level axis within its plate, through its middle."""
    shape = context.shape
    outward = context.outward
    found = []
    for k in range(3):
        axis = shape.box.axes[:, k]
        if abs(axis @ outward) > 0.5:
            continue
        rest = [j for j in range(3) if j != k]
        across = max(
            float(shape.box.half[j]) for j in rest if abs(shape.box.axes[:, j] @ outward) < 0.5
        )
        score = across / max(float(shape.box.half.max()), 1e-9)
        score += 0.4 * (1 - abs(float(axis @ UP)))
        origin = shape.center - outward * 0.6 * shape.box.reach(outward)
        found.append(Hypothesis("revolute", axis, origin, -0.28, 0.28, score, "rocks"))
    return found


def tilt_hypotheses(context: PartContext) -> list[Hypothesis]:
    """A screen or head nods about a level axis through where it is held."""
    shape = context.shape
    found = []
    origin = context.contact_center
    level = [k for k in range(3) if abs(shape.box.axes[2, k]) <= 0.5]
    longest = max(float(shape.box.half.max()), 1e-9)
    choices = [(shape.box.axes[:, k], float(shape.box.half[k]) / longest) for k in level]
    plane = arm_plane(context.assembly, context.part)
    if plane is not None and abs(float(plane.normal[2])) < 0.5:
        # The head of a lamp nods as its arms do.
        choices.append((plane.normal, 1.2 + 1.5 * plane.sureness))
    for axis, score in choices:
        down = -free_turn(context, axis, origin, -0.6, TOLERANCE)
        up = free_turn(context, axis, origin, 0.6, TOLERANCE)
        found.append(
            Hypothesis(
                "revolute", axis, origin, -max(down, 0.15), max(up, 0.15), score, "tilts where held"
            )
        )
    return found
