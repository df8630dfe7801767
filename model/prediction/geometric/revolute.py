"""Revolute proposals about an axis through the part: wheels, knobs, caps, spouts, turntables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from model.prediction.explanation import Reason
from model.prediction.geometric.context import PartContext
from model.prediction.geometric.pins import crossing_point
from model.prediction.geometric.proposal import UP, JointProposal, unit
from model.prediction.geometric.shape import PartShape, Roundness, blades, roundness

Array = npt.NDArray[np.float64]


def spin_proposals(context: PartContext) -> list[JointProposal]:
    """About each axis of symmetry that the part may have."""
    shape = context.shape
    wheel = bool({"wheel", "roller", "tire"} & set(context.words))
    outwardness = dict(
        zip(map(tuple, context.directions.round(6)), context.outwardness, strict=True)
    )
    rough = shape.scanned and shape.size < 60 * shape.noise
    found = []
    for r in shape.roundnesses:
        if rough and np.abs(r.axis).max() < 0.9995:
            continue  # too noisy for directions of its own
        score, origin = _spin_score(context, r, outwardness, wheel)
        reason = Reason.SYMMETRY if r.round else Reason.CENTER
        found.append(_continuous(r.axis, origin, score, reason))
    ball = shape.ball and shape.size > 25 * shape.noise
    poles = _poles(context) if ball and not wheel else None
    if poles is not None:
        found.append(_continuous(poles, shape.center, 4.5, Reason.POLES))
    fold = blades(shape)
    if fold is not None:
        found.append(_continuous(fold[0], fold[1], 4.0, Reason.BLADES))
    if not found:
        thin = shape.box.axes[:, shape.order[0]]
        found.append(JointProposal("continuous", thin, shape.center))
    return found


def _continuous(axis: Array, origin: Array, score: float, reason: Reason) -> JointProposal:
    return JointProposal("continuous", axis, origin, score=score, reasons=(reason,))


def _spin_score(
    context: PartContext, r: Roundness, outwardness: dict[tuple[float, ...], float], wheel: bool
) -> tuple[float, Array]:
    """Score of an axis of symmetry, and a point on it."""
    shape = context.shape
    score = 2.5 * float(np.clip(1 - r.spread / 0.11, -0.5, 1))
    # A disc turns about its short axis, a rod about its long one.
    score += 0.4 * float(np.clip(1 - r.half / max(r.radius, 1e-6), -0.3, 1))
    level = 1 - abs(float(r.axis @ UP))
    score += _scan_bonus(shape, r.axis)
    if wheel:
        score += 1.2 * level
    for sign in (-1.0, 1.0):
        out = outwardness.get(tuple((sign * r.axis).round(6)))
        if out is not None and not wheel:
            score += 0.4 * max(0.0, float(out))
    if context.clock_hand and abs(r.axis @ shape.box.axes[:, shape.order[0]]) > 0.95:
        return score + 3.0, _hub(context, r)
    return score, r.center


def _scan_bonus(shape: PartShape, axis: Array) -> float:
    """Bonus of the object's directions on scans, where missing sides tilt a part's own axes."""
    return 0.9 if shape.scanned and np.abs(axis).max() > 0.9995 else 0.0


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
    found = [
        j
        for j in context.sampled.others(context.part)
        if context.assembly.parent[j] == context.parent
        and context.sampled.shapes[j].slenderness < 0.35
        and abs(
            float(context.sampled.shapes[j].box.axes[:, context.sampled.shapes[j].order[0]] @ thin)
        )
        > 0.95
        and context.sampled.gap[context.part, j] < 0.05
    ]
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
        found.append(_continuous(up, r.center, 1.5 - 12 * r.spread, Reason.SYMMETRY))
    for axis, score in ((up, 0.7), (UP, 0.9)):
        found.append(_continuous(axis, _support(context, axis), score, Reason.SUPPORT))
    return found


def _support(context: PartContext, up: Array) -> Array:
    """Centre of the contact, or of a round neck near it."""
    contact = context.contact
    near = context.distance <= np.quantile(context.distance, 0.12)
    points = context.shape.points[near] if near.sum() >= 8 else contact
    r = roundness(points, up, True)
    if r is not None and r.spread < 0.12:
        return r.center
    return 0.5 * (contact.min(0) + contact.max(0))


def screw_proposals(context: PartContext) -> list[JointProposal]:
    """A cap that turns and comes off, or a seat that turns and rises."""
    shape = context.shape
    up = context.upright()
    if "seat" in context.words or (shape.roundest is None and shape.size > 0.4):
        seat = _continuous(up, _support(context, up), 1.0, Reason.SUPPORT)
        return [replace(seat, travel=(0.0, 0.06))]
    best: JointProposal | None = None
    along = unit(shape.center - context.parent_shape.center)
    for r in shape.roundnesses:
        axis = r.axis * (1.0 if r.axis @ along >= 0 else -1.0)
        score = 2.0 * float(np.clip(1 - r.spread / 0.11, -0.5, 1)) + float(axis @ along)
        score += 0.4 * abs(float(axis @ UP)) + _scan_bonus(shape, axis)
        travel = (0.0, float(np.clip(0.6 * 2 * r.half, 0.02, 0.08)))
        if best is None or score > best.score:
            cap = _continuous(axis, r.center, score, Reason.SYMMETRY)
            best = replace(cap, travel=travel)
    if best is None:
        best = JointProposal("continuous", up, shape.center, travel=(0.0, 0.05))
    return [best]
