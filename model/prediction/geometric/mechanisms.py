"""From a mechanism to the scored joints that it may have."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from model.core.motion_lexicon import Mechanism
from model.prediction.geometric.context import Assembly, PartContext
from model.prediction.geometric.edge_hinges import edge_hypotheses
from model.prediction.geometric.edge_limits import with_swept_limits
from model.prediction.geometric.hypothesis import Hypothesis, unit
from model.prediction.geometric.pins import (
    lever_hypotheses,
    pivot_hypotheses,
    swing_hypotheses,
    tilt_hypotheses,
    toggle_hypotheses,
    within_reach,
)
from model.prediction.geometric.prismatic import (
    lift_hypotheses,
    press_hypotheses,
    slide_along_hypotheses,
    slide_out_hypotheses,
)
from model.prediction.geometric.revolute import screw_hypotheses, spin_hypotheses, swivel_hypotheses

Array = npt.NDArray[np.float64]

BUILDERS: dict[Mechanism, Callable[[PartContext], list[Hypothesis]]] = {
    "hinge": lambda c: edge_hypotheses(c, "hinge"),
    "flap": lambda c: edge_hypotheses(c, "flap"),
    "drop": lambda c: edge_hypotheses(c, "drop"),
    "temple": lambda c: edge_hypotheses(c, "temple"),
    "pivot": pivot_hypotheses,
    "swing": swing_hypotheses,
    "lever": lever_hypotheses,
    "toggle": toggle_hypotheses,
    "tilt": tilt_hypotheses,
    "spin": spin_hypotheses,
    "swivel": swivel_hypotheses,
    "screw": screw_hypotheses,
    "slide_out": slide_out_hypotheses,
    "slide_along": slide_along_hypotheses,
    "lift": lift_hypotheses,
    "press": press_hypotheses,
    "fixed": lambda c: [Hypothesis("fixed", np.array([0.0, 0.0, 1.0]), c.shape.center)],
}

SWEPT: dict[Mechanism, Callable[[PartContext, Hypothesis], Hypothesis]] = {
    "hinge": with_swept_limits,
    "flap": with_swept_limits,
    "drop": with_swept_limits,
    "temple": with_swept_limits,
    "pivot": within_reach,
}
"""Mechanisms whose limits come from a motion sweep of the chosen joint, and how."""


def propose(context: PartContext, mechanism: Mechanism) -> list[Hypothesis]:
    """All joints that the mechanism may have here, best first, the best with its limits.

    Where it can have none, the part stays fixed, for a person to see.
    """
    found = sorted(BUILDERS[mechanism](context), key=lambda h: -h.score)
    if not found:
        note = f"no {mechanism} fits here: left fixed"
        return [replace(h, note=note) for h in BUILDERS["fixed"](context)]
    if mechanism in SWEPT:
        found[0] = SWEPT[mechanism](context, found[0])
    return found


def find_front(assembly: Assembly, mechanisms: dict[int, Mechanism]) -> tuple[Array, float]:
    """Where the object faces, from the parts that people reach for.

    Returns:
        A horizontal unit vector and 0..1 how sure it is. Without any sign: where most data sets'
        objects face, -x of the object's frame.
    """
    scene = assembly.scene
    default = scene.frame.object_from_working.T @ np.array([-1.0, 0.0, 0.0])
    if assembly.category == "faucet":
        flat = np.concatenate([s.outline for s in scene.shapes])[:, :2]
        base = scene.shapes[assembly.root]
        low = base.points[
            base.points[:, 2] < base.low[2] + 0.1 * (base.high[2] - base.low[2] + 1e-9)
        ]
        middle = (low if len(low) >= 8 else base.points)[:, :2].mean(0)
        # The spout reaches farther from the foot than anything else.
        far = flat[np.argmax(np.abs((flat - middle) @ _spout_axis(scene, assembly, middle)))]
        axis = _spout_axis(scene, assembly, middle)
        sign = 1.0 if (far - middle) @ axis >= 0 else -1.0
        return np.array([*(sign * axis), 0.0]), 0.8
    votes = np.zeros(3)
    for part, mechanism in mechanisms.items():
        if part == assembly.root:
            continue
        context = PartContext(assembly, part)
        shape = context.shape
        if mechanism in ("hinge", "drop"):
            n = context.panel_normal
            weight = 2.0 * shape.size
        elif mechanism in ("slide_out", "press", "spin") and not (
            {"wheel", "caster"} & set(context.words)
        ):
            n = context.outward
            weight = 1.0 if mechanism == "slide_out" else 0.4
        elif mechanism == "flap" and ({"pedal", "pad"} & set(context.words)):
            # One steps on it from the front.
            n, weight = unit(shape.center - scene.shapes[assembly.root].center), 1.0
        elif mechanism == "flap" and context.grips:
            # A knob or latch on a lid is at the front.
            at = max(context.grips, key=lambda g: g[2])[0]
            n, weight = 0.5 * shape.box.axes @ (at / np.maximum(shape.box.half, 1e-6)), 0.5
        else:
            continue
        votes += weight * np.array([n[0], n[1], 0.0])
    length = float(np.linalg.norm(votes))
    if length < 0.1:
        return unit(np.array([default[0], default[1], 0.0])), 0.0
    return votes / length, float(np.clip(length / 1.5, 0, 1))


def _spout_axis(scene: object, assembly: Assembly, middle: Array) -> Array:
    """Horizontal axis (2,) along which the faucet reaches farthest to one side."""
    flat = np.concatenate([s.outline for s in assembly.scene.shapes])[:, :2] - middle
    best, out = -1.0, np.array([1.0, 0.0])
    for axis in (np.array([1.0, 0.0]), np.array([0.0, 1.0])):
        along = flat @ axis
        lopsided = abs(float(along.max() + along.min()))
        if lopsided > best:
            best, out = lopsided, axis
    del scene
    return out
