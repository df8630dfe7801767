"""Panels that turn about one of their edges: doors, lids, screens, arms of glasses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.kinematics.barrels import barrel_line
from model.prediction.geometric.assembly import TOUCHING
from model.prediction.geometric.context import PartContext
from model.prediction.geometric.edge_limits import CATEGORY_OPENING, IN_PLANE, NOTED, OPENING
from model.prediction.geometric.hypothesis import UP, Hypothesis, snapped, unit
from model.prediction.geometric.serial_chains import SLENDER, arm_plane, is_arm
from model.prediction.geometric.shape import fit_panel

Array = npt.NDArray[np.float64]


AJAR = np.deg2rad((1.5, 2.5))
"""From how far on (rad) a shut panel may be one that stands ajar, and from where it is one."""
FLUSH, FLUSH_SHARE = np.deg2rad(1.2), 0.02
"""A share of the parent's surface that faces as the panel does, to within so much, is its frame."""


@dataclass(frozen=True)
class EdgeWeights:
    """How much each cue counts for one mechanism.

    Attributes:
        upright: axis along +z. level: axis horizontal. bottom: the edge is the lowest.
        short: the edge runs along the panel's short side. long: along its long side.
        contact: only this edge touches. margin: the edge is near the object's side.
        handle: a handle sits opposite. sibling: another panel lies beyond the edge.
        back: the edge is away from the object's front.
        wall: beyond the edge the parent rises above the panel (a toilet's tank).
        ajar: of a door that stands open by a few degrees this edge is the nearer one.
        inner: the edge lies farther within the parent, of an arm that tells by nothing else which
            of its ends is held.
        barrels: several small cylinders lie along the edge, which also look like a handle there.
    """

    upright: float = 0.0
    level: float = 0.0
    bottom: float = 0.0
    short: float = 0.0
    long: float = 0.3
    contact: float = 3.0
    margin: float = 1.0
    handle: float = 2.0
    sibling: float = 2.0
    back: float = 0.0
    wall: float = 0.0
    ajar: float = 2.0
    inner: float = 0.0
    barrels: float = 5.0


WEIGHTS: dict[str, EdgeWeights] = {
    "hinge": EdgeWeights(upright=0.9, long=0.8),
    "drop": EdgeWeights(level=1.0, bottom=3.0, margin=0.3, handle=1.5),
    "flap": EdgeWeights(level=1.2, long=0.6, back=1.2, margin=0.4, handle=1.2, wall=2.0),
    "temple": EdgeWeights(
        short=2.5, long=0.0, contact=4.0, margin=0.0, handle=0.3, back=0.8, inner=1.5
    ),
}

CATEGORY_UPRIGHT: dict[str, float] = {
    "refrigerator": 2.0,
    "door": 2.0,
    "safe": 1.5,
    "washingmachine": 0.8,
    "microwave": 0.5,
}
"""How much more than usual a category's doors turn about upright axes."""


def edge_hypotheses(
    context: PartContext, mechanism: str, front: Array | None = None
) -> list[Hypothesis]:
    """Every edge of the panel, scored, with its limits.

    Args:
        front: (3,) unit, where the part is shut and no panel but has its front there, as drawers
            do: the hinge is at that face.
    """
    weights = WEIGHTS[mechanism]
    shape, box = context.shape, context.shape.box
    face: float | None = None
    if front is None:
        normal = _panel_normal(context, mechanism)
        out_normal = context.panel_outward(box.axes[:, normal])
    else:
        normal = int(np.argmax(np.abs(front @ box.axes)))
        out_normal = box.axes[:, normal] * np.sign(front @ box.axes[:, normal])
        slab = fit_panel(shape, normal)
        face = slab.high if float(out_normal @ box.axes[:, normal]) > 0 else -slab.low
    n_axis = box.axes[:, normal]
    if mechanism == "flap" and context.closed and abs(float(n_axis[2])) < 0.3:
        weights = WEIGHTS["hinge"]  # half of a standing case
    # All edges of a closed door touch; a lid that leans on a wall is open within its body's box.
    closed = mechanism in ("hinge", "drop") and (front is not None or context.shut)
    in_plane = [k for k in range(3) if k != normal]
    local = box.local(shape.points)
    contact = _contact_scores(context, local, in_plane)
    found: list[Hypothesis] = _arm_hypotheses(context) if mechanism == "temple" else []
    for across, along in (tuple(in_plane), tuple(in_plane[::-1])):
        for side in (-1.0, 1.0):
            e = np.zeros(3)
            e[across] = side
            direction = box.axes @ e
            axis = box.axes[:, along]
            if mechanism == "temple":
                axis = snapped(axis, _frame_axes(context), 0.3)
            score, why = _edge_score(context, weights, direction, axis, across, along, side, normal)
            held = 0.0 if closed else contact[across, side]
            score += weights.contact * held
            if held > 0.3:
                why.append("only this edge touches")
            if weights.inner and abs(held) < 0.3 and shape.slenderness < SLENDER:
                score += weights.inner * _inner(context, direction, across)
            ajar = _ajar(context, out_normal, direction, axis) if closed else 0.0
            score += weights.ajar * ajar
            if ajar > 0.5:
                why.append("ajar")
            open_ = not closed and held > 0.3
            origin = _edge_origin(context, normal, across, side, out_normal, open_, local)
            if face is not None:
                origin = origin + out_normal * (face - float((origin - box.center) @ out_normal))
            barrels = _barrels(context, axis, origin, across, normal)
            if barrels is not None:
                origin = barrels[0]
                if barrels[1] > 1:
                    score += weights.barrels
                    why.append("hinge barrels")
            found.append(
                _with_limits(
                    context, mechanism, axis, origin, out_normal, open_, score, ", ".join(why)
                )
            )
    return found


def _arm_hypotheses(context: PartContext) -> list[Hypothesis]:
    """An arm folds within the plane of its chain, or that it spans with the part before or after
    it."""
    shape, assembly = context.shape, context.assembly
    if shape.slenderness > SLENDER:
        return []
    long = shape.box.axes[:, shape.order[2]]
    end = context.contact_center
    note = f"{NOTED['temple']}: {IN_PLANE}"
    found = []
    plane = arm_plane(assembly, context.part)
    if plane is not None:
        score = 6.5 + 2.0 * plane.sureness
        found.append(Hypothesis("revolute", plane.normal, end, -1.2, 1.2, score, note))
    if shape.thinness < 0.6:
        return found
    neighbours = [j for j, above in enumerate(assembly.parent) if above == context.part]
    for j in [*neighbours, context.parent]:
        other = context.scene.shapes[j]
        along = other.center - (end if j == context.parent else shape.center)
        normal = np.cross(long, unit(along))
        if np.linalg.norm(normal) < 0.25:
            continue
        normal = unit(normal)
        axis = snapped(normal, _frame_axes(context), 0.15)
        if j == context.parent and axis is normal and not is_arm(assembly, j):
            continue  # a lever under a seat: where the middle of the seat is says nothing
        score = 6.0 + 0.5 * (1 - abs(float(axis[2]))) - (1.0 if j == context.parent else 0.0)
        found.append(Hypothesis("revolute", axis, end, -1.2, 1.2, score, note))
    return found


def _frame_axes(context: PartContext) -> Array:
    """(6, 3) the object's directions and the parent's box axes."""
    return np.concatenate([np.eye(3), context.base.box.axes.T])


def _panel_normal(context: PartContext, mechanism: str) -> int:
    """Index of the box axis across the panel."""
    shape = context.shape
    axes = shape.box.axes
    if mechanism == "temple":
        thin, _, long = shape.order
        if shape.thinness < 0.6 and context.category != "stapler":
            return thin
        # A thick arm folds upright.
        return max((k for k in range(3) if k != long), key=lambda k: abs(axes[2, k]))
    return shape.panel.normal


def _contact_scores(
    context: PartContext, local: Array, in_plane: list[int]
) -> dict[tuple[int, float], float]:
    """(axis, side) → -1..1: how much nearer the parent is at this edge than at the opposite."""
    half = context.shape.box.half
    d = context.distance
    out: dict[tuple[int, float], float] = {}
    for k in in_plane:
        band = 0.12 * 2 * half[k]
        near: dict[float, float] = {}
        for side in (-1.0, 1.0):
            at = side * local[:, k] > half[k] - band
            near[side] = float(np.median(d[at])) if at.sum() >= 3 else float(np.median(d))
        reach = max(2 * float(half[k]), 1e-6)
        for side in (-1.0, 1.0):
            gain = (near[-side] - near[side]) / (0.35 * reach)
            # A gap of a few samples on a closed panel is noise.
            quiet = abs(near[-side] - near[side]) < 1.5 * TOUCHING
            out[k, side] = 0.0 if quiet else float(np.clip(gain, -1.0, 1.0))
    return out


def _edge_score(
    context: PartContext,
    weights: EdgeWeights,
    direction: Array,
    axis: Array,
    across: int,
    along: int,
    side: float,
    normal: int,
) -> tuple[float, list[str]]:
    half = context.shape.box.half
    why: list[str] = []
    upright = abs(float(axis @ UP))
    more = CATEGORY_UPRIGHT.get(context.category, 0.0) if weights.upright else 0.0
    score = (weights.upright + more) * upright + weights.level * (1 - upright)
    if weights.bottom and direction[2] < -0.5:
        score += weights.bottom
        why.append("bottom edge")
    ratio = float(half[along] / (half[along] + half[across] + 1e-9))
    score += weights.long * 2 * (ratio - 0.5) + weights.short * 2 * (0.5 - ratio)
    here = _margin(context, direction)
    there = _margin(context, -direction)
    margin = float(np.clip((there - here) / max(0.15 * 2 * half[across], 0.05), -1, 1))
    score += weights.margin * margin * 0.8
    handle, reason = _handle_cue(context, across, along, side, normal)
    score += weights.handle * handle
    if handle > 0.3:
        why.append(reason)
    if _sibling_beyond(context, direction, across, along, normal):
        score -= weights.sibling
        # Of two doors side by side each turns about its outer upright edge.
        score += weights.sibling * upright * 0.5
    elif upright > 0.5 and _sibling_beyond(context, -direction, across, along, normal):
        score += 0.6 * weights.sibling
        why.append("next to another panel")
    if weights.back:
        front = context.assembly.front
        back = -float(direction @ front)
        score += weights.back * back * (0.4 + 0.6 * context.assembly.front_certainty)
        if back > 0.7:
            why.append("at the back")
    if weights.wall and _rises_beyond(context, direction) > 2 * _rises_beyond(context, -direction):
        score += weights.wall
        why.append("the body rises behind it")
    return score, why


def _rises_beyond(context: PartContext, direction: Array) -> float:
    """Area of the parent beyond the panel's edge and above the panel (squared diagonals)."""
    shape, base = context.shape, context.base
    edge = float(shape.center @ direction) + 0.8 * shape.box.reach(direction)
    top = float(shape.high[2])
    beyond = (base.points @ direction > edge) & (base.points[:, 2] > top + 0.02)
    return base.area * float(beyond.mean()) + 1e-4


def _margin(context: PartContext, direction: Array) -> float:
    """Distance from the panel's edge to the object's own end in that direction."""
    base = context.base
    ends = base.outline @ direction
    end = float(np.quantile(ends, 0.995)) if base.scanned else float(ends.max())
    return max(
        0.0, end - float(context.shape.center @ direction) - context.shape.box.reach(direction)
    )


def _inner(context: PartContext, direction: Array, across: int) -> float:
    """-1..1: how much farther than the opposite edge this one lies within the parent."""
    deeper = _margin(context, direction) - _margin(context, -direction)
    return float(np.clip(deeper / max(2 * float(context.shape.box.half[across]), 1e-6), -1, 1))


def _handle_cue(
    context: PartContext, across: int, along: int, side: float, normal: int
) -> tuple[float, str]:
    """-1..1: a handle far from this edge speaks for it."""
    if context.shape.panel.normal != normal:
        return 0.0, ""
    half = context.shape.box.half
    best = 0.0
    for center, spread, strength in context.grips:
        at = float(center[across] / max(half[across], 1e-6))
        if abs(at) < 0.25:
            continue
        # A bar handle lies along the hinge axis.
        a, b = float(spread[along]), float(spread[across])
        shape = (a - b) / max(a + b, 1e-6)
        value = -side * float(np.clip(at / 0.7, -1, 1)) * (0.75 + 0.25 * shape) * strength
        if abs(value) > abs(best):
            best = value
    return best, "handle opposite"


def _sibling_beyond(
    context: PartContext, direction: Array, across: int, along: int, normal: int
) -> bool:
    """Whether another moving panel in the same plane lies right beyond the edge."""
    scene, shape = context.scene, context.shape
    box = shape.box
    for j in scene.others(context.part):
        if j in (context.parent, context.assembly.root):
            continue
        other = scene.shapes[j]
        if other.size < 0.4 * shape.size:
            continue
        offset = box.axes.T @ (other.center - shape.center)
        n = box.axes[:, normal]
        if abs(offset[normal]) > box.half[normal] + other.box.reach(n) + TOUCHING:
            continue
        reach = other.box.reach(box.axes[:, along])
        overlap = min(box.half[along], offset[along] + reach) - max(
            -box.half[along], offset[along] - reach
        )
        if overlap < 0.5 * min(box.half[along], reach):
            continue
        step = float((other.center - shape.center) @ direction)
        gap = step - box.half[across] - other.box.reach(direction)
        if step > 0 and -0.3 * box.half[across] < gap < 0.06:
            return True
    return False


def _edge_origin(
    context: PartContext,
    normal: int,
    across: int,
    side: float,
    out_normal: Array,
    open_: bool,
    local: Array,
) -> Array:
    """A point on the hinge line: at the slab's inner face, or in its middle where it is open."""
    shape, box = context.shape, context.shape.box
    panel = shape.panel
    at = np.zeros(3)
    at[across] = side * box.half[across]
    low, high = (
        (panel.low, panel.high)
        if panel.normal == normal
        else (
            -box.half[normal],
            box.half[normal],
        )
    )
    sign = float(box.axes[:, normal] @ out_normal)
    at[normal] = low if sign > 0 else high
    if open_:
        band = side * local[:, across] > box.half[across] * (1 - 0.2)
        d = context.distance
        if band.sum() >= 4:
            near = band & (d <= np.quantile(d[band], 0.3) + 1e-9)
            spot = local[near].mean(0)
            at[normal] = spot[normal]
            at[across] = 0.5 * (at[across] + spot[across])
    return box.center + box.axes @ at


def _ajar(context: PartContext, outward: Array, direction: Array, axis: Array) -> float:
    """-1..1: how much a panel looks as if it were turned a little about this edge: 1 where it
    stands out of the object's own directions and away from the edge, -1 where it can't be.

    Args:
        outward: the panel's normal. direction: from its middle to the edge. axis: along the edge.
    """
    shut = np.round(outward)
    turn = np.cross(shut, outward)
    angle = np.arcsin(np.clip(np.linalg.norm(turn), 0.0, 1.0))
    # One side of a noisy panel tells its direction half as well.
    angle = angle / 2 if context.shape.scanned else angle
    if np.linalg.norm(shut) != 1 or angle < AJAR[0]:
        return 0.0
    # One that lies along a face of its parent is shut, however the two of them stand.
    along = np.abs(context.base.normals @ outward) > np.cos(FLUSH)
    if along.mean() > FLUSH_SHARE:
        return 0.0
    sure = float(np.clip((angle - AJAR[0]) / (AJAR[1] - AJAR[0]), 0, 1))
    about = abs(float(unit(turn) @ axis)) > 0.7
    nearer = float(direction @ shut) < 0
    return sure if about and nearer else -sure


def _barrels(
    context: PartContext, axis: Array, origin: Array, across: int, normal: int
) -> tuple[Array, int] | None:
    """Where the hinge's barrels have their middle, near an edge, and how many there are."""
    key = axis.tobytes() + origin.tobytes() + bytes((across, normal))
    if key not in context.barrels:
        context.barrels[key] = _barrels_at(context, axis, origin, across, normal)
    return context.barrels[key]


def _barrels_at(
    context: PartContext, axis: Array, origin: Array, across: int, normal: int
) -> tuple[Array, int] | None:
    frame, shape = context.scene.frame, context.shape
    width = 2 * float(shape.box.half[across])
    panel = shape.panel
    thick = panel.high - panel.low if panel.normal == normal else 2 * float(shape.box.half[normal])
    parts = (context.scene.parts[context.part], context.scene.parts[context.parent])
    line = barrel_line(
        parts,
        frame.direction_in_object(axis),
        frame.point_in_object(origin),
        frame.diagonal * max(1.5 * min(thick, 0.2 * width), 0.04 * width),
        frame.diagonal * max(0.75 * min(thick, 0.2 * width), 0.025 * width),
    )
    return None if line is None else (frame.to_working(line.point[None])[0], line.count)


def _with_limits(
    context: PartContext,
    mechanism: str,
    axis: Array,
    origin: Array,
    out_normal: Array,
    open_: bool,
    score: float,
    why: str,
) -> Hypothesis:
    """Turn the axis so that positive q opens, and find how far."""
    arm = context.shape.center - origin
    if float(np.cross(axis, arm) @ out_normal) < 0:
        axis = -axis
    key = (context.category, mechanism)
    opening = CATEGORY_OPENING.get(key, OPENING[mechanism])
    noted = NOTED.get(mechanism, mechanism)
    return Hypothesis(
        "revolute", axis, origin, 0.0, opening, score, f"{noted}: {why}" if why else noted
    )
