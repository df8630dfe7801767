"""Parts that turn about an axis through their middle: wheels, knobs, caps, spouts, trays."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.prediction.geometric.context import PartContext
from model.prediction.geometric.hypothesis import UP, Hypothesis, unit
from model.prediction.geometric.outline import Roundness, roundness
from model.prediction.geometric.pins import crossing
from model.prediction.geometric.shape import Shape, blades

Array = npt.NDArray[np.float64]


def spin_hypotheses(context: PartContext) -> list[Hypothesis]:
    """About each axis along which the part may be round."""
    shape = context.shape
    wheel = bool({"wheel", "roller", "tire"} & set(context.words))
    hand = context.hand
    found = []
    outwardness = dict(
        zip(map(tuple, context.directions.round(6)), context.outwardness, strict=True)
    )
    rough = shape.scanned and shape.size < 60 * shape.noise
    for r in shape.roundnesses:
        if rough and np.abs(r.axis).max() < 0.9995:
            continue  # too few points to tell its own directions
        score = 2.5 * float(np.clip(1 - r.spread / 0.11, -0.5, 1))
        # A disc turns about its short axis; a rod about its long one.
        score += 0.4 * float(np.clip(1 - r.half / max(r.radius, 1e-6), -0.3, 1))
        level = 1 - abs(float(r.axis @ UP))
        score += _scan_bonus(shape, r.axis)
        if wheel:
            score += 1.2 * level
        for sign in (-1.0, 1.0):
            out = outwardness.get(tuple((sign * r.axis).round(6)))
            if out is not None and not wheel:
                score += 0.4 * max(0.0, float(out))
        origin = r.center
        if hand and abs(r.axis @ shape.box.axes[:, shape.order[0]]) > 0.95:
            score += 3.0
            origin = _hub(context, r)
        found.append(
            Hypothesis(
                "continuous",
                r.axis,
                origin,
                score=score,
                note="turns about its symmetry axis"
                if r.round
                else "turns about its middle, which is hardly round",
            )
        )
    ball = shape.ball and shape.size > 25 * shape.noise
    poles = _poles(context) if ball and not wheel else None
    if poles is not None:
        found.append(
            Hypothesis("continuous", poles, shape.center, score=4.5, note="ball held at two poles")
        )
    fold = blades(shape)
    if fold is not None:
        axis, center, count = fold
        note = f"{count} equal blades around the axis"
        found.append(Hypothesis("continuous", axis, center, score=4.0, note=note))
    if not found:
        thin = shape.box.axes[:, shape.order[0]]
        found.append(Hypothesis("continuous", thin, shape.center, score=0.0, note="spins"))
    return found


def _scan_bonus(shape: Shape, axis: Array) -> float:
    """Half-seen parts tilt their own axes: scans prefer the object's directions."""
    return 0.9 if shape.scanned and np.abs(axis).max() > 0.9995 else 0.0


def _hub(context: PartContext, r: Roundness) -> Array:
    """Where the hands of a clock meet: the middle of its round face, else of the base."""
    face = roundness(context.base.outline, r.axis, context.base.scanned)
    if face is not None and face.round:
        return face.center
    other = _other_hand(context)
    if other is not None:
        a, b = context.shape, context.scene.shapes[other]
        at = crossing(a, b, r.axis)
        return at if at is not None else context.scene.contact(context.part, other).mean(0)
    return context.base.center


def _other_hand(context: PartContext) -> int | None:
    """Another sliver that lies flat on the same dial and reaches over this one."""
    shape = context.shape
    thin = shape.box.axes[:, shape.order[0]]
    found = [
        j
        for j in context.scene.others(context.part)
        if context.assembly.parent[j] == context.parent
        and context.scene.shapes[j].slenderness < 0.35
        and abs(float(context.scene.shapes[j].box.axes[:, context.scene.shapes[j].order[0]] @ thin))
        > 0.95
        and context.scene.gap[context.part, j] < 0.05
    ]
    return max(found, key=lambda j: (context.scene.shapes[j].size, -j)) if found else None


def _poles(context: PartContext) -> Array | None:
    """(3,) axis through the two places that hold a ball; None where it isn't held so."""
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


def swivel_hypotheses(context: PartContext) -> list[Hypothesis]:
    """About an upright axis: the part's own where it is round, else through its support."""
    shape = context.shape
    up = context.upright()
    found = []
    r = roundness(shape.outline, up, shape.scanned)
    if r is not None:
        spread = r.spread
        found.append(
            Hypothesis(
                "continuous", up, r.center, score=1.5 - 12 * spread, note="round, upright axis"
            )
        )
    for axis, score in ((up, 0.7), (UP, 0.9)):
        note = "upright axis through support"
        found.append(
            Hypothesis("continuous", axis, _support(context, axis), score=score, note=note)
        )
    return found


def _support(context: PartContext, up: Array) -> Array:
    """Middle of the contact; of a round neck near it where there is one."""
    contact = context.contact
    near = context.distance <= np.quantile(context.distance, 0.12)
    points = context.shape.points[near] if near.sum() >= 8 else contact
    r = roundness(points, up, True)
    if r is not None and r.spread < 0.12:
        return r.center
    return 0.5 * (contact.min(0) + contact.max(0))


def screw_hypotheses(context: PartContext) -> list[Hypothesis]:
    """A cap that turns and comes off, or a seat that turns and rises."""
    shape = context.shape
    up = context.upright()
    best: Hypothesis | None = None
    if "seat" in context.words or (shape.roundest is None and shape.size > 0.4):
        origin = _support(context, up)
        return [
            Hypothesis(
                "continuous", up, origin, score=1.0, travel=(0.0, 0.06), note="turns and rises"
            )
        ]
    along = unit(shape.center - context.base.center)
    for r in shape.roundnesses:
        axis = r.axis * (1.0 if r.axis @ along >= 0 else -1.0)
        score = 2.0 * float(np.clip(1 - r.spread / 0.11, -0.5, 1)) + float(axis @ along)
        score += 0.4 * abs(float(axis @ UP)) + _scan_bonus(shape, axis)
        h = Hypothesis(
            "continuous",
            axis,
            r.center,
            score=score,
            travel=(0.0, float(np.clip(0.6 * 2 * r.half, 0.02, 0.08))),
            note="cap: turns and comes off",
        )
        best = h if best is None or h.score > best.score else best
    return (
        [best]
        if best is not None
        else [Hypothesis("continuous", up, shape.center, score=0.0, travel=(0.0, 0.05), note="cap")]
    )
