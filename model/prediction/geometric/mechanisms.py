"""From a part's mechanism to scored joint proposals, those of drawers, sliding panels, lids and
buttons among them, and the direction that an object faces.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from model.core.motion_lexicon import Mechanism
from model.core.progress import attempt
from model.prediction.builder import left_out
from model.prediction.geometric.context import ACROSS, Assembly, JointProposal, PartContext, unit
from model.prediction.geometric.edge_hinges import edge_proposals
from model.prediction.geometric.limits import TOLERANCE, free_range, with_swept_limits
from model.prediction.geometric.revolute import (
    lever_proposals,
    pivot_proposals,
    screw_proposals,
    spin_proposals,
    swing_proposals,
    swivel_proposals,
    tilt_proposals,
    toggle_proposals,
    within_reach,
)
from model.prediction.geometric.shape import NOTHING, TINY

Array = npt.NDArray[np.float64]

DRAWER_TRAVEL = 0.79
"""Travel of a drawer over its depth; the rest stays in the rails."""


OPEN, BACKED, FACING, OUTWARD, SIDEWAYS, EDGE = 1.8, 0.9, 0.8, 0.3, 3.0, (-1.5, 0.3)
"""Scores of the direction of a drawer, the last one against the plane of its front; and bounds of
its place over half its parent's depth."""
SHALLOW, SCANNED_DEPTH, FRONT_ALONE, HALF_DEPTH = 0.4, 0.8, 0.25, 0.5
"""Depths over that of the parent: of a scanned and a modelled front, and of the drawers behind."""
FREE, ALONG, AWAY, LEVEL, BLADE, BLADE_SLENDER, LID = 1.2, 0.5, 0.4, 0.8, 1.5, 0.45, 1.0
"""Scores of a panel's direction; and middle over long extent of a blade."""
IN, OUT, THIN, SURFACE = 1.2, 1.2, (0.5, 1.0), (2.0, 1.2)
SEEN, CENTRE, FRONT, UPPER = 1.0, 0.5, 0.15, 0.1
"""Scores of a button's direction; two of scanned and of modelled parts."""


def _slide(axis: Array, origin: Array, travel: float, score: float, *why: str) -> JointProposal:
    return JointProposal("prismatic", axis, origin, 0.0, travel, score, reasons=why)


def slide_out_proposals(context: PartContext) -> list[JointProposal]:
    """A drawer slides out of the open side of its parent."""
    shape, base = context.shape, context.parent_shape
    covers = context.covers
    found = []
    front, certainty = context.assembly.front, context.assembly.front_certainty
    for k, direction in enumerate(context.directions):
        if abs(direction[2]) > ACROSS:
            continue
        ends = base.outline @ direction
        end = float(np.quantile(ends, 0.99))
        own = float(shape.center @ direction) + shape.box.reach(direction)
        reach = max(base.box.reach(direction), 1e-3)
        edge = float(np.clip((own - end) / (0.5 * reach), *EDGE))
        score = OPEN * (1 - covers[k]) + BACKED * covers[(k + 3) % 6] + edge
        score += FACING * certainty * float(direction @ front)
        score += OUTWARD * float(direction @ unit(shape.center - base.center))
        if context.front_normal is not None:
            score -= SIDEWAYS * (1 - abs(float(direction @ context.front_normal)))
        depth = _drawer_depth(context, direction)
        reasons = ["towards the open side"] if covers[k] < 0.3 else []
        found.append(_slide(direction, shape.center, DRAWER_TRAVEL * depth, score, *reasons))
    return found


def _drawer_depth(context: PartContext, direction: Array) -> float:
    """Depth of the drawer; estimated from its parent if only the front was scanned or modelled."""
    own = 2 * context.shape.box.reach(direction)
    behind = 2 * context.parent_shape.box.reach(direction)
    if context.shape.scanned and own < SHALLOW * behind:
        return SCANNED_DEPTH * behind
    # A front without a drawer: half the parent's depth.
    return own if own > FRONT_ALONE * behind else max(own, HALF_DEPTH * behind)


def slide_along_proposals(context: PartContext) -> list[JointProposal]:
    """A panel or blade slides within its own plane, preferably along the parent."""
    shape, base = context.shape, context.parent_shape
    _, middle, long = shape.order
    axes = shape.box.axes
    found = []
    for k in (middle, long):
        for sign in (-1.0, 1.0):
            direction = sign * axes[:, k]
            stop = min(1.0, 2 * float(shape.box.half[k]))
            line = {"rotates": False, "axis": direction, "origin": shape.center}
            who = (context.sampled, context.part, (context.parent,))
            free = free_range(*who, **line, stop=stop, tolerance=TOLERANCE)
            wanted = max(TINY, stop)
            along = float(abs(base.box.axes[:, base.order[2]] @ direction))
            away = float(direction @ unit(shape.center - base.center))
            # Sliding doors and sashes move horizontally, blades along their handle.
            level = 1.0 - abs(direction[2])
            score = FREE * free / wanted + ALONG * along + AWAY * away
            if shape.panel.normal != int(np.argmax(np.abs(axes[2]))):
                score += LEVEL * level
            if k == long and shape.slenderness < BLADE_SLENDER:
                score += BLADE
            if {"lid", "cap", "cover", "blade"} & set(context.words):
                score += LID * along
            found.append(
                _slide(direction, shape.center, 0.8 * wanted, score, "within its own plane")
            )
    return found


def lift_proposals(context: PartContext) -> list[JointProposal]:
    """A lid or plunger moves along its vertical axis, a toaster's lever downwards."""
    up = context.upright()
    height = 2 * context.shape.box.reach(up)
    travel = {"kitchenpot": 0.012, "bottle": 0.06, "suitcase": 0.75 * height, "kettle": 0.12}.get(
        context.category, 0.035 if context.shape.roundest is not None else max(0.03, 0.5 * height)
    )
    down = context.category == "toaster"
    axis = -up if down else up
    if down:
        travel = 0.5 * 2 * context.parent_shape.box.reach(up)
    return [_slide(axis, context.shape.center, travel, 1.0, "vertical")]


def press_proposals(context: PartContext) -> list[JointProposal]:
    """A button moves into the surface around it."""
    shape = context.shape
    found = []
    normals = context.normals_around
    choices = [(d, c) for d, c in zip(context.directions, _covered(context), strict=True)]
    local = context.surface_normal
    if local is not None and np.abs(context.directions @ local).max() < 0.995:
        for d in (local, -local):
            near = int(np.argmax(context.directions @ d))
            choices.append((d, choices[near][1]))
    surface = unit(shape.center - _surface_center(context))
    sides = np.abs(shape.box.axes.T @ np.stack([d for d, _ in choices]).T).T @ shape.box.half
    flat = 1 - sides / max(float(sides.max()), NOTHING)
    normal_weight = SURFACE[0] if shape.scanned else SURFACE[1]
    for (direction, (ahead, behind)), reach, thin in zip(choices, sides, flat, strict=True):
        score = IN * behind - OUT * ahead + thin * (THIN[0] if shape.scanned else THIN[1])
        if len(normals):
            score += normal_weight * float(np.mean(np.abs(normals @ direction)))
        if shape.scanned:
            score += SEEN * float(np.mean(np.abs(shape.normals @ direction)))
        score += CENTRE * float(direction @ surface)
        score += FRONT * float(direction @ context.assembly.front)
        score += UPPER * max(0.0, direction[2])
        travel = float(np.clip(0.6 * 2 * reach, 0.002, 0.02))
        found.append(_slide(-direction, shape.center, travel, score, "into its surface"))
    return found


def _covered(context: PartContext) -> list[tuple[float, float]]:
    """For each of the part's directions: coverage in front, and behind."""
    covers = context.covers
    return [(float(covers[k]), float(covers[(k + 3) % 6])) for k in range(6)]


def _surface_center(context: PartContext) -> Array:
    """(3,) centre of the parent's surface around the part; of the parent if none is near."""
    sampled, shape = context.sampled, context.shape
    reach = max(0.8 * shape.size, 0.04)
    index = sampled.tree(context.parent).query_ball_point(shape.center, reach)
    if len(index) < 4:
        return context.parent_shape.center
    return context.parent_shape.points[np.asarray(index, int)].mean(0)


BUILDERS: dict[Mechanism, Callable[[PartContext], list[JointProposal]]] = {
    "hinge": lambda c: edge_proposals(c, "hinge"),
    "flap": lambda c: edge_proposals(c, "flap"),
    "drop": lambda c: edge_proposals(c, "drop"),
    "temple": lambda c: edge_proposals(c, "temple"),
    "pivot": pivot_proposals,
    "swing": swing_proposals,
    "lever": lever_proposals,
    "toggle": toggle_proposals,
    "tilt": tilt_proposals,
    "spin": spin_proposals,
    "swivel": swivel_proposals,
    "screw": screw_proposals,
    "slide_out": slide_out_proposals,
    "slide_along": slide_along_proposals,
    "lift": lift_proposals,
    "press": press_proposals,
    "fixed": lambda c: [JointProposal("fixed", np.array([0.0, 0.0, 1.0]), c.shape.center)],
}
"""Mechanism → function that proposes its joints; see :func:`proposals_for`."""


def swept_limits(
    mechanism: Mechanism,
) -> Callable[[PartContext, JointProposal], JointProposal] | None:
    """The motion sweep that gives the chosen joint of a mechanism its limits; None without one."""
    if left_out("swept ranges"):
        return None
    if mechanism in ("hinge", "flap", "drop", "temple"):
        return with_swept_limits
    return within_reach if mechanism == "pivot" else None


def proposals_for(context: PartContext, mechanism: Mechanism) -> list[JointProposal]:
    """The joints that a mechanism can have here, in no order, with its usual limits."""
    found = context.attempt(f"the joint rule {mechanism}", lambda: BUILDERS[mechanism](context), [])
    return [replace(p, mechanism=mechanism) for p in found]


def propose(context: PartContext, mechanism: Mechanism) -> list[JointProposal]:
    """The joints that a mechanism can have here, best first, the best one with its limits.

    If there are none, a fixed joint, so that a person notices.
    """
    found = sorted(proposals_for(context, mechanism), key=lambda p: -p.score)
    if not found:
        reasons = ("no other proposal fits",)
        return [replace(p, reasons=reasons) for p in proposals_for(context, "fixed")]
    swept, best = swept_limits(mechanism), found[0]
    if swept is not None:
        found[0] = context.attempt("the motion sweep", lambda: swept(context, best), best)
    return found


def face_front(assembly: Assembly, mechanisms: dict[int, Mechanism]) -> None:
    """Set the assembly's front from the parts that people reach for.

    Without any cue it is -x of the object's frame, where the objects of most data sets face.

    Args:
        mechanisms: by part index.
    """
    assembly.front, assembly.front_certainty = attempt(
        assembly.faults,
        "the search for the object's front",
        lambda: front_of(assembly, mechanisms),
        (assembly.front, 0.0),
    )


def front_of(assembly: Assembly, mechanisms: dict[int, Mechanism]) -> tuple[Array, float]:
    """(3,) unit direction of the front and its certainty, 0..1."""
    if left_out("front"):
        return assembly.front, 0.0
    if assembly.category == "faucet":
        return _spout_direction(assembly), 0.8
    votes = np.zeros(3)
    for part, mechanism in mechanisms.items():
        if part == assembly.root:
            continue
        normal, weight = _front_vote(PartContext(assembly, part), mechanism)
        votes += weight * np.array([normal[0], normal[1], 0.0])
    length = float(np.linalg.norm(votes))
    if length < 0.1:
        default = assembly.sampled.frame.object_from_working.T @ np.array([-1.0, 0.0, 0.0])
        return unit(np.array([default[0], default[1], 0.0])), 0.0
    return votes / length, float(np.clip(length / 1.5, 0, 1))


def _front_vote(context: PartContext, mechanism: Mechanism) -> tuple[Array, float]:
    """The direction that one part suggests, and its weight."""
    shape, words = context.shape, set(context.words)
    if mechanism in ("hinge", "drop"):
        return context.panel_normal, 2.0 * shape.size
    if mechanism in ("slide_out", "press", "spin") and not {"wheel", "caster"} & words:
        return context.outward, 1.0 if mechanism == "slide_out" else 0.4
    if mechanism == "flap" and {"pedal", "pad"} & words:
        base = context.sampled.shapes[context.assembly.root]
        return unit(shape.center - base.center), 1.0  # pedals are at the front
    if mechanism == "flap" and context.grips:
        # So are the knob or latch of a lid.
        at = max(context.grips, key=lambda g: g[2])[0]
        return 0.5 * shape.box.axes @ (at / np.maximum(shape.box.half, TINY)), 0.5
    return np.zeros(3), 0.0


def _spout_direction(assembly: Assembly) -> Array:
    """(3,) horizontal working axis along which a faucet reaches farthest from its foot."""
    flat = np.concatenate([s.outline for s in assembly.sampled.shapes])[:, :2]
    base = assembly.sampled.shapes[assembly.root]
    height = base.high[2] - base.low[2] + NOTHING
    low = base.points[base.points[:, 2] < base.low[2] + 0.1 * height]
    foot = (low if len(low) >= 8 else base.points)[:, :2].mean(0)
    best, axis = -1.0, np.array([1.0, 0.0])
    for candidate in (np.array([1.0, 0.0]), np.array([0.0, 1.0])):
        along = (flat - foot) @ candidate
        lopsided = abs(float(along.max() + along.min()))
        if lopsided > best:
            best, axis = lopsided, candidate
    far = flat[np.argmax(np.abs((flat - foot) @ axis))]
    sign = 1.0 if (far - foot) @ axis >= 0 else -1.0
    return np.array([*(sign * axis), 0.0])
