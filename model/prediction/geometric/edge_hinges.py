"""Edge-hinge proposals: doors, lids, screens and temples that turn about one of their edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.core.motion_lexicon import Mechanism
from model.kinematics.snapping import barrel_line
from model.prediction.builder import CHAIN_PLANE, left_out
from model.prediction.geometric.context import ACROSS, UP, JointProposal, PartContext, snapped, unit
from model.prediction.geometric.limits import CATEGORY_OPENING, OPENING
from model.prediction.geometric.sampled_object import CONTACT_GAP
from model.prediction.geometric.shape import NOTHING, TINY, fit_panel
from model.prediction.geometric.tree import SLENDER, chain_plane, is_slender

Array = npt.NDArray[np.float64]

AJAR = np.deg2rad((1.5, 2.5))
"""Angles (rad) of a panel to the object from which it may be, and certainly is, ajar."""
FLUSH, FLUSH_SHARE = np.deg2rad(1.2), 0.02
"""A panel is shut if this share of the parent's surface is parallel to it, to this angle (rad)."""


@dataclass(frozen=True)
class EdgeWeights:
    """Weights of the cues for one mechanism.

    Attributes:
        upright: the axis is vertical. level: it is horizontal. bottom: the edge is the lowest.
        short: the edge runs along the panel's short side. long: along its long side.
        contact: only this edge is in contact. margin: the edge is near the object's side.
        handle: a handle is opposite. sibling: another panel lies beyond the edge.
        back: the edge is away from the object's front.
        wall: beyond the edge the parent rises above the panel (a toilet's tank).
        ajar: the panel is open by a few degrees about this edge.
        inner: the edge lies deeper within the parent; for temples without a better cue.
        barrels: hinge barrels lie along the edge; enough to outweigh the handle that they look
            like.
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


WEIGHTS: dict[Mechanism, EdgeWeights] = {
    "hinge": EdgeWeights(upright=0.9, long=0.8),
    "drop": EdgeWeights(level=1.0, bottom=3.0, margin=0.3, handle=1.5),
    "flap": EdgeWeights(level=1.2, long=0.6, back=1.2, margin=0.4, handle=1.2, wall=2.0),
    "temple": EdgeWeights(
        short=2.5, long=0.0, contact=4.0, margin=0.0, handle=0.3, back=0.8, inner=1.5
    ),
}

CATEGORY_UPRIGHT: dict[str, float] = {"refrigerator": 2.0, "door": 2.0, "safe": 1.5}
CATEGORY_UPRIGHT |= {"washingmachine": 0.8, "microwave": 0.5}
"""Additional weight of vertical axes for a category's doors."""


@dataclass(frozen=True, eq=False)
class _Panel:
    """The panel whose edges are scored.

    Attributes:
        normal: index of the box axis across it. out_normal: (3,) that axis, away from the parent.
        closed: all its edges are in contact or none is.
        local: (N, 3) the part's points in box coordinates.
        contact: (axis, side) → score, see :func:`_contact_scores`.
        face: height of its front above the box's centre along ``out_normal`` if the hinge lies
            there, else None.
    """

    context: PartContext
    mechanism: Mechanism
    weights: EdgeWeights
    normal: int
    out_normal: Array
    closed: bool
    local: Array
    contact: dict[tuple[int, float], float]
    face: float | None


def edge_proposals(
    context: PartContext, mechanism: Mechanism, front: Array | None = None
) -> list[JointProposal]:
    """One scored proposal per edge of the panel, with the mechanism's usual limits.

    Args:
        front: (3,) unit, outward normal of the face with the hinge, for a shut part that is no
            panel, such as a drawer.
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
    # A closed door is in contact at all edges; an open lid may lie within its parent's box.
    closed = mechanism in ("hinge", "drop") and (front is not None or context.shut)
    in_plane = [k for k in range(3) if k != normal]
    local = box.local(shape.points)
    contact = _contact_scores(context, local, in_plane)
    panel = _Panel(context, mechanism, weights, normal, out_normal, closed, local, contact, face)
    found = _chain_proposals(context) if mechanism == "temple" else []
    for across, along in (tuple(in_plane), tuple(in_plane[::-1])):
        found += [_edge_proposal(panel, across, along, side) for side in (-1.0, 1.0)]
    return found


def _edge_proposal(panel: _Panel, across: int, along: int, side: float) -> JointProposal:
    """The proposal for the edge along box axis ``along`` on one side of ``across``."""
    context, weights, box = panel.context, panel.weights, panel.context.shape.box
    e = np.zeros(3)
    e[across] = side
    direction = box.axes @ e
    axis = box.axes[:, along]
    if panel.mechanism == "temple":
        axis = snapped(axis, _frame_axes(context), 0.3)
    score, reasons = _edge_score(
        context, weights, direction, axis, across, along, side, panel.normal
    )
    held = 0.0 if panel.closed else panel.contact[across, side]
    score += weights.contact * held
    if held > 0.3:
        reasons.append("at the only edge in contact")
    if weights.inner and abs(held) < 0.3 and context.shape.slenderness < SLENDER:
        score += weights.inner * _inner(context, direction, across)
    ajar = _ajar(context, panel.out_normal, direction, axis) if panel.closed else 0.0
    score += weights.ajar * ajar
    if ajar > 0.5:
        reasons.append("panel ajar")
    open_ = not panel.closed and held > 0.3
    out = panel.out_normal
    origin = _edge_origin(context, panel.normal, across, side, out, open_, panel.local)
    if panel.face is not None:
        origin = origin + out * (panel.face - float((origin - box.center) @ out))
    barrels = _barrels(context, axis, origin, across, panel.normal)
    if barrels is not None:
        origin = barrels[0]
        if barrels[1] > 1:
            score += weights.barrels
            reasons.append("at visible barrels")
    arm = context.shape.center - origin
    if float(np.cross(axis, arm) @ out) < 0:
        axis = -axis  # positive q opens
    opening = CATEGORY_OPENING.get((context.category, panel.mechanism), OPENING[panel.mechanism])
    return JointProposal(
        "revolute", axis, origin, 0.0, opening, score, panel.mechanism, tuple(reasons)
    )


def _chain_proposals(context: PartContext) -> list[JointProposal]:
    """A member folds within the plane of its chain, or that it spans with a neighbour."""
    shape, assembly = context.shape, context.assembly
    if shape.slenderness > SLENDER or left_out("chains"):
        return []
    long = shape.box.axes[:, shape.order[2]]
    end = context.contact_center

    def proposal(axis: Array, score: float) -> JointProposal:
        reasons = (CHAIN_PLANE,)
        return JointProposal("revolute", axis, end, -1.2, 1.2, score, "temple", reasons)

    found = []
    plane = chain_plane(assembly, context.part)
    if plane is not None:
        found.append(proposal(plane.normal, 6.5 + 2.0 * plane.certainty))
    if shape.thinness < 0.6:
        return found
    neighbours = [j for j, above in enumerate(assembly.parent) if above == context.part]
    for j in [*neighbours, context.parent]:
        other = context.sampled.shapes[j]
        along = other.center - (end if j == context.parent else shape.center)
        normal = np.cross(long, unit(along))
        if np.linalg.norm(normal) < 0.25:
            continue
        normal = unit(normal)
        axis = snapped(normal, _frame_axes(context), 0.15)
        if j == context.parent and axis is normal and not is_slender(assembly, j):
            continue  # a lever under a seat: the seat's centre has no meaning
        score = 6.0 + 0.5 * (1 - abs(float(axis[2]))) - (1.0 if j == context.parent else 0.0)
        found.append(proposal(axis, score))
    return found


def _frame_axes(context: PartContext) -> Array:
    """(6, 3) the object's directions and the parent's box axes."""
    return np.concatenate([np.eye(3), context.parent_shape.box.axes.T])


def _panel_normal(context: PartContext, mechanism: Mechanism) -> int:
    """Index of the box axis across the panel."""
    shape = context.shape
    axes = shape.box.axes
    if mechanism == "temple":
        thin, _, long = shape.order
        if shape.thinness < 0.6 and context.category != "stapler":
            return thin
        # A thick arm folds upwards.
        return max((k for k in range(3) if k != long), key=lambda k: abs(axes[2, k]))
    return shape.panel.normal


def _contact_scores(
    context: PartContext, local: Array, in_plane: list[int]
) -> dict[tuple[int, float], float]:
    """(axis, side) → -1..1: how much nearer the parent is at this edge than at the opposite one."""
    half = context.shape.box.half
    d = context.distance
    out: dict[tuple[int, float], float] = {}
    for k in in_plane:
        band = 0.12 * 2 * half[k]
        near: dict[float, float] = {}
        for side in (-1.0, 1.0):
            at = side * local[:, k] > half[k] - band
            near[side] = float(np.median(d[at])) if at.sum() >= 3 else float(np.median(d))
        reach = max(2 * float(half[k]), TINY)
        for side in (-1.0, 1.0):
            gain = (near[-side] - near[side]) / (0.35 * reach)
            # Differences below the spacing of the samples are noise.
            quiet = abs(near[-side] - near[side]) < 1.5 * CONTACT_GAP
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
    reasons: list[str] = []
    upright = abs(float(axis @ UP))
    more = CATEGORY_UPRIGHT.get(context.category, 0.0) if weights.upright else 0.0
    score = (weights.upright + more) * upright + weights.level * (1 - upright)
    if weights.bottom and direction[2] < -ACROSS:
        score += weights.bottom
        reasons.append("at the bottom edge")
    ratio = float(half[along] / (half[along] + half[across] + NOTHING))
    score += weights.long * 2 * (ratio - 0.5) + weights.short * 2 * (0.5 - ratio)
    here = _margin(context, direction)
    there = _margin(context, -direction)
    margin = float(np.clip((there - here) / max(0.15 * 2 * half[across], 0.05), -1, 1))
    score += weights.margin * margin * 0.8
    handle = _handle_cue(context, across, along, side, normal)
    score += weights.handle * handle
    if handle > 0.3:
        reasons.append("opposite the handle")
    if _sibling_beyond(context, direction, across, along, normal):
        score -= weights.sibling
        # Adjacent doors turn about their outer vertical edges.
        score += weights.sibling * upright * 0.5
    elif upright > ACROSS and _sibling_beyond(context, -direction, across, along, normal):
        score += 0.6 * weights.sibling
        reasons.append("at the outer edge of two panels")
    if weights.back:
        front = context.assembly.front
        back = -float(direction @ front)
        score += weights.back * back * (0.4 + 0.6 * context.assembly.front_certainty)
        if back > 0.7:
            reasons.append("at the back")
    if weights.wall and _rises_beyond(context, direction) > 2 * _rises_beyond(context, -direction):
        score += weights.wall
        reasons.append("at the raised back")
    return score, reasons


def _rises_beyond(context: PartContext, direction: Array) -> float:
    """Area of the parent beyond the panel's edge and above the panel (squared diagonals)."""
    shape, base = context.shape, context.parent_shape
    edge = float(shape.center @ direction) + 0.8 * shape.box.reach(direction)
    top = float(shape.high[2])
    beyond = (base.points @ direction > edge) & (base.points[:, 2] > top + 0.02)
    return base.area * float(beyond.mean()) + 1e-4


def _margin(context: PartContext, direction: Array) -> float:
    """Distance from the panel's edge to the parent's end in that direction."""
    base = context.parent_shape
    ends = base.outline @ direction
    end = float(np.quantile(ends, 0.995)) if base.scanned else float(ends.max())
    return max(
        0.0, end - float(context.shape.center @ direction) - context.shape.box.reach(direction)
    )


def _inner(context: PartContext, direction: Array, across: int) -> float:
    """-1..1: how much deeper than the opposite edge this one lies within the parent."""
    deeper = _margin(context, direction) - _margin(context, -direction)
    return float(np.clip(deeper / max(2 * float(context.shape.box.half[across]), TINY), -1, 1))


def _handle_cue(context: PartContext, across: int, along: int, side: float, normal: int) -> float:
    """-1..1: positive if the strongest handle is far from this edge."""
    if context.shape.panel.normal != normal or left_out("handles"):
        return 0.0
    half = context.shape.box.half
    best = 0.0
    for center, spread, strength in context.grips:
        at = float(center[across] / max(half[across], TINY))
        if abs(at) < 0.25:
            continue
        # Bar handles are parallel to the hinge.
        a, b = float(spread[along]), float(spread[across])
        shape = (a - b) / max(a + b, TINY)
        value = -side * float(np.clip(at / 0.7, -1, 1)) * (0.75 + 0.25 * shape) * strength
        if abs(value) > abs(best):
            best = value
    return best


def _sibling_beyond(
    context: PartContext, direction: Array, across: int, along: int, normal: int
) -> bool:
    """True if another moving panel in the same plane is adjacent to the edge."""
    sampled, shape = context.sampled, context.shape
    box = shape.box
    for j in () if left_out("adjacent panels") else sampled.others(context.part):
        if j in (context.parent, context.assembly.root):
            continue
        other = sampled.shapes[j]
        if other.size < 0.4 * shape.size:
            continue
        offset = box.axes.T @ (other.center - shape.center)
        n = box.axes[:, normal]
        if abs(offset[normal]) > box.half[normal] + other.box.reach(n) + CONTACT_GAP:
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
    """A point of the hinge line: on the slab's inner face, or in its middle if it is open."""
    shape, box = context.shape, context.shape.box
    panel = shape.panel
    at = np.zeros(3)
    at[across] = side * box.half[across]
    low, high = -box.half[normal], box.half[normal]
    if panel.normal == normal:
        low, high = panel.low, panel.high
    sign = float(box.axes[:, normal] @ out_normal)
    at[normal] = low if sign > 0 else high
    if open_:
        band = side * local[:, across] > box.half[across] * (1 - 0.2)
        d = context.distance
        if band.sum() >= 4:
            near = band & (d <= np.quantile(d[band], 0.3) + NOTHING)
            spot = local[near].mean(0)
            at[normal] = spot[normal]
            at[across] = 0.5 * (at[across] + spot[across])
    return box.center + box.axes @ at


def _ajar(context: PartContext, outward: Array, direction: Array, axis: Array) -> float:
    """1 if the panel is rotated a little about this edge, -1 if about another one, 0 if it is shut.

    Args:
        outward: the panel's normal. direction: from its centre to the edge. axis: along the edge.
    """
    shut = np.round(outward)
    turn = np.cross(shut, outward)
    angle = np.arcsin(np.clip(np.linalg.norm(turn), 0.0, 1.0))
    # One side of a noisy panel gives its direction only half as well.
    angle = angle / 2 if context.shape.scanned else angle
    if np.linalg.norm(shut) != 1 or angle < AJAR[0] or left_out("ajar panels"):
        return 0.0
    # A panel parallel to a face of its parent is shut, whatever the angle of both.
    along = np.abs(context.parent_shape.normals @ outward) > np.cos(FLUSH)
    if along.mean() > FLUSH_SHARE:
        return 0.0
    certainty = float(np.clip((angle - AJAR[0]) / (AJAR[1] - AJAR[0]), 0, 1))
    about = abs(float(unit(turn) @ axis)) > 0.7
    nearer = float(direction @ shut) < 0
    return certainty if about and nearer else -certainty


def _barrels(
    context: PartContext, axis: Array, origin: Array, across: int, normal: int
) -> tuple[Array, int] | None:
    """Centre of the hinge barrels near an edge, and their number; cached in the context."""
    if left_out("barrels"):
        return None
    key = axis.tobytes() + origin.tobytes() + bytes((across, normal))
    if key not in context.barrels:
        context.barrels[key] = _barrels_at(context, axis, origin, across, normal)
    return context.barrels[key]


def _barrels_at(
    context: PartContext, axis: Array, origin: Array, across: int, normal: int
) -> tuple[Array, int] | None:
    frame, shape = context.sampled.frame, context.shape
    width = 2 * float(shape.box.half[across])
    panel = shape.panel
    thick = panel.high - panel.low if panel.normal == normal else 2 * float(shape.box.half[normal])
    parts = (context.sampled.parts[context.part], context.sampled.parts[context.parent])
    line = barrel_line(
        parts,
        frame.direction_in_object(axis),
        frame.point_in_object(origin),
        frame.diagonal * max(1.5 * min(thick, 0.2 * width), 0.04 * width),
        frame.diagonal * max(0.75 * min(thick, 0.2 * width), 0.025 * width),
    )
    return None if line is None else (frame.to_working(line.point[None])[0], line.count)
