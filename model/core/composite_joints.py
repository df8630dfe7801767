"""Motions that take several joints: screw, ball, universal joint, plane, lift and swivel.

A tree has joints of one degree of freedom alone, so such a motion is a chain through helper links
that hold no part. In a screw the slide follows the turn. Every format holds such a chain: MJCF's
equality, USD's PhysxMimicJointAPI, URDF's mimic; SDF has a joint for screws.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from model.core.errors import KinematicsError
from model.core.files import free_name
from model.core.joint import Joint, JointType, Mimic
from model.core.tree import KinematicTree, moving_chain

CompositeKind = Literal["single", "screw", "lift_and_swivel", "ball", "universal", "planar"]
COMPOSITE_KINDS: tuple[CompositeKind, ...] = get_args(CompositeKind)
Axis = tuple[float, float, float]


@dataclass(frozen=True)
class CompositeRow:
    """Properties of one motion, and its words elsewhere.

    Attributes:
        title: on screens.
        helpers: links between the parent and the part.
        sdf: the joint type that SDF has for it; "" where it has none.
        pitched: True where it has a pitch; such a motion is one joint in the SDF that we write.
    """

    title: str
    helpers: int = 0
    sdf: str = ""
    pitched: bool = False


COMPOSITES: dict[str, CompositeRow] = {
    "single": CompositeRow("One joint"),
    "screw": CompositeRow("Screw", 1, "screw", pitched=True),
    "lift_and_swivel": CompositeRow("Lift and swivel", 1),
    "ball": CompositeRow("Ball", 2, "ball"),
    "universal": CompositeRow("Universal joint", 1),
    "planar": CompositeRow("Plane", 2),
}
"""Kind → its row."""
SWING = math.pi / 4
"""Radians by which a ball or universal joint tilts either way where nothing is said: the usual
45 degrees of ball-and-socket joints for machines (DIN 71802 allows 18 degrees, camera heads 90)."""
TURNS = 2.0
"""Turns of a screw where nothing is said, about those of a bottle's cap and of a jar's lid."""
LIFT = 0.1
"""Metres of a lift, and either way of a plane, where nothing is said: an office chair's stroke."""
PARALLEL = 1e-6
"""Deviation of two axes, or of their points, up to which they are the same."""


@dataclass(frozen=True)
class Composite:
    """Motion of a part.

    Attributes:
        kind: "single" for one joint.
        pitch: of a screw, metres along the axis for a right-handed turn; else 0.
    """

    kind: CompositeKind = "single"
    pitch: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in COMPOSITE_KINDS:
            known = ", ".join(COMPOSITE_KINDS)
            raise KinematicsError([f"motion {self.kind!r} is none of {known}"])
        if not math.isfinite(self.pitch) or COMPOSITES[self.kind].pitched != (self.pitch != 0):
            raise KinematicsError(
                [f"a screw has a pitch other than 0 m, and nothing else has one: got {self.pitch}"]
            )


def composite_joints(
    composite: Composite,
    joint: Joint,
    helpers: Sequence[str],
    *,
    swing: float = SWING,
    slide: tuple[float, float] | None = None,
) -> tuple[Joint, ...]:
    """The joints of a motion, from the parent down to the part.

    Args:
        joint: parent, child, axis, origin and limits; its name stays with the part's own joint. The
            axis is the screw's, a ball's twist, or the plane's normal.
        helpers: free names of links, at least as many as :data:`COMPOSITES` says.
        swing: radians of a tilt either way.
        slide: metres of a lift or a plane's slides.
    """
    if composite.kind == "single":
        return (joint,)
    above = [joint.parent, *helpers[: COMPOSITES[composite.kind].helpers]]
    turn = _turning(joint, composite)
    x, y = _across(joint.axis)
    own = replace(turn, parent=above[-1])

    def step(
        k: int, kind: JointType, axis: Axis, low: float, high: float, mimic: Mimic | None = None
    ) -> Joint:
        name = f"joint_{helpers[k]}"
        return Joint(name, kind, above[k], helpers[k], axis, joint.origin, low, high, mimic)

    match composite.kind:
        case "screw":
            slope = composite.pitch / (2 * math.pi)
            ends = sorted(slope * q for q in turn.motion_range)
            mimic = Mimic(joint.name, slope)
            return step(0, "prismatic", joint.axis, ends[0], ends[1], mimic), own
        case "lift_and_swivel":
            low, high = slide or (0.0, LIFT)
            return step(0, "prismatic", joint.axis, low, high), own
        case "universal":
            tilt = replace(own, type="revolute", axis=y, lower=-swing, upper=swing)
            return step(0, "revolute", x, -swing, swing), tilt
        case "ball":
            return (
                step(0, "revolute", x, -swing, swing),
                step(1, "revolute", y, -swing, swing),
                own,
            )
        case _:
            low, high = slide or (-LIFT, LIFT)
            return step(0, "prismatic", x, low, high), step(1, "prismatic", y, low, high), own


def with_composite(
    tree: KinematicTree, child: str, composite: Composite, holds: Callable[[str], bool]
) -> KinematicTree:
    """The tree where a part moves so; its own joint's axis, origin, name and limits stay.

    Args:
        child: link of the part. holds: whether a link holds a part.

    Raises:
        KinematicsError: where ``child`` has no joint.
    """
    own = tree.joint_of.get(child)
    if own is None:
        raise KinematicsError([f"{child!r} has no joint: it is the root, or isn't there"])
    chain = moving_chain(tree, child, holds)
    now = composite_of(tree, child, holds)
    if now == composite:
        return tree
    joints_now = [tree.joint_of[link] for link in chain]
    base = replace(_main(joints_now, own), parent=joints_now[0].parent, mimic=None)
    slides = [j.motion_range for j in joints_now if j.type == "prismatic"]
    gone = set(chain[:-1])
    helpers = free_helpers(child, COMPOSITES[composite.kind].helpers, set(tree.links) - gone)
    along = slides and now.kind != "planar" and "lift_and_swivel" in (now.kind, composite.kind)
    lift = slides[0] if along else None
    made = composite_joints(composite, base, helpers, slide=lift)
    lost = {j.name for j in joints_now} - {j.name for j in made}
    kept = [
        replace(j, mimic=None) if j.mimic is not None and j.mimic.joint in lost else j
        for j in tree.joints
        if j.child not in chain
    ]
    at = min(i for i, j in enumerate(tree.joints) if j.child in chain)
    links = [link for link in tree.links if link not in gone]
    return KinematicTree((*links, *helpers), (*kept[:at], *made, *kept[at:]))


def composite_of(tree: KinematicTree, child: str, holds: Callable[[str], bool]) -> Composite:
    """Motion of a part; unknown chains are "single"."""
    own = tree.joint_of.get(child)
    if own is None:
        return Composite()
    joints = [tree.joint_of[link] for link in moving_chain(tree, child, holds)]
    types = "".join("s" if j.type == "prismatic" else "t" if j.moves else "f" for j in joints)
    first = joints[0]
    along = float(np.dot(first.axis, own.axis))
    if types == "st" and abs(along) > 1 - PARALLEL:
        if first.mimic is None:
            return Composite("lift_and_swivel")
        if first.mimic.joint == own.name and first.mimic.multiplier:
            return Composite("screw", math.copysign(2 * math.pi, along) * first.mimic.multiplier)
    if types in ("tt", "ttt", "sst") and all(j.mimic is None for j in joints):
        square = all(
            abs(float(np.dot(a.axis, b.axis))) < PARALLEL
            for k, a in enumerate(joints)
            for b in joints[:k]
        )
        one_point = all(_same(j.origin, own.origin) for j in joints)
        if square and (one_point or types == "sst"):
            return Composite({"tt": "universal", "ttt": "ball", "sst": "planar"}[types])  # type: ignore[arg-type]
    return Composite()


def _main(joints: Sequence[Joint], own: Joint) -> Joint:
    """The part's own joint, turned into what it was before a universal joint took its axis."""
    if len(joints) == 2 and all(j.type == "revolute" for j in joints):
        axis = tuple(np.cross(joints[0].axis, own.axis).tolist())
        return replace(own, axis=axis)  # type: ignore[arg-type]
    return own


def _turning(joint: Joint, composite: Composite) -> Joint:
    """The joint as the turn of a motion."""
    if composite.pitch and joint.type == "prismatic":
        ends = sorted(2 * math.pi / composite.pitch * q for q in joint.motion_range)
        return replace(joint, type="revolute", lower=ends[0], upper=ends[1])
    if composite.pitch and joint.type != "revolute":
        return replace(joint, type="revolute", lower=0.0, upper=2 * math.pi * TURNS)
    if joint.type == "revolute":
        return joint
    return replace(joint, type="continuous", lower=None, upper=None)


def _across(axis: Sequence[float]) -> tuple[Axis, Axis]:
    """Two unit vectors that make a right-handed frame with ``axis``, along the object's axes where
    that can be."""
    z = np.asarray(axis)
    x = np.eye(3)[int(np.abs(z).argmin())]
    x = x - (x @ z) * z
    x = x / np.linalg.norm(x)
    y = np.asarray(np.cross(z, x))
    return (float(x[0]), float(x[1]), float(x[2])), (float(y[0]), float(y[1]), float(y[2]))


def free_helpers(child: str, count: int, taken: Collection[str]) -> list[str]:
    """Names for helper links of a part that no link has: ``helper_3``, ``helper_3_2``."""
    out: list[str] = []
    for _ in range(count):
        out.append(free_name(f"helper_{child.removeprefix('link_')}", {*taken, *out}))
    return out


def _same(a: Sequence[float], b: Sequence[float]) -> bool:
    return bool(np.abs(np.subtract(a, b)).max() < PARALLEL)
