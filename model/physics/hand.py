"""The parallel gripper that affordances are looked for with, and that opens them in simulation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Affordance, AffordanceKind

OPENING = 0.085
"""Metres between the pads at most, as of common two-finger grippers."""
FINGER = (0.004, 0.01, 0.06)
"""Metres of a finger: thickness, width, length."""
PALM = (0.08, 0.04, 0.06)
"""Metres of the palm behind the fingers: along the closing axis, across, along the approach."""
DEPTH = 0.008
"""Metres that the pads reach beyond the middle of what they hold."""
SPARE = 0.004
"""Metres between a pad and the surface before the fingers close."""
OFF = 0.003
"""Metres between the fingers and the surface before they push or hook it."""
ROWS = tuple((-np.arange(0.003, FINGER[2], 0.006)).tolist())
"""Metres of the spheres of :func:`finger_spheres` along a finger, from the tips."""
ARM = 0.15
"""Metres behind the palm that stay free for the wrist; the hand comes straight from outside."""

Array = npt.NDArray[np.float64]


def tool_pose(affordance: Affordance, gap: float = 0.0) -> Array:
    """(4, 4) ``link_from_tool`` of a gripper that takes hold.

    Its origin lies between the fingertips, x is the closing axis, z the approach.

    Args:
        gap: metres that a push or a hook stays off the surface.
    """
    x, z = np.asarray(affordance.closing), -np.asarray(affordance.normal)
    x = x - z * (x @ z)
    x /= np.linalg.norm(x)
    out = np.eye(4)
    out[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    out[:3, 3] = tip_of(affordance.kind, np.asarray(affordance.center), z, x, gap)
    return out


def tip_of(
    kind: AffordanceKind | npt.NDArray[np.str_],
    center: Array,
    approach: Array,
    closing: Array,
    gap: float,
) -> Array:
    """(..., 3) between the fingertips, for (...) kinds, as in :func:`tool_pose`."""
    kinds = np.asarray(kind)[..., None]
    off = np.where(kinds == "hook", FINGER[1] / 2 + gap, 0.0)
    ahead = np.where(kinds == "push", -gap, DEPTH)
    return np.asarray(center - off * np.cross(approach, closing) + ahead * approach)


def finger_spheres(rows: Sequence[float], opening: Array) -> tuple[Array, Array]:
    """(P, S, 3) centres in tool frames, for (P,) openings, and (S,) radii of both fingers."""
    thick, wide, _ = FINGER
    radius = 0.003
    at = np.array(
        [(s, y, z) for s in (-1, 1) for y in (-wide / 2 + 0.002, 0, wide / 2 - 0.002) for z in rows]
    )
    out = np.repeat(at[None], len(opening), axis=0)
    out[:, :, 0] *= (opening[:, None] + thick) / 2
    return out, np.full(len(at), radius)


def palm_spheres() -> tuple[Array, Array]:
    """(S, 3) centres and (S,) radii of palm and arm."""
    along, _, deep = PALM
    side = np.linspace(-along / 2 + 0.02, along / 2 - 0.02, 3)
    rows = -FINGER[2] - np.arange(0.02, deep + ARM, 0.025)
    at = np.array([(x, 0.0, z) for x in side for z in rows])
    return at, np.full(len(at), 0.02)
