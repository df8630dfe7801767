"""From a part's mechanism to scored joint proposals, and the direction that an object faces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from model.core.motion_lexicon import Mechanism
from model.core.progress import attempt
from model.prediction.builder import Reason, left_out
from model.prediction.geometric.context import Assembly, JointProposal, PartContext, unit
from model.prediction.geometric.edge_hinges import edge_proposals
from model.prediction.geometric.limits import with_swept_limits
from model.prediction.geometric.prismatic import (
    lift_proposals,
    press_proposals,
    slide_along_proposals,
    slide_out_proposals,
)
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
        reasons = (Reason.NO_PROPOSAL,)
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
