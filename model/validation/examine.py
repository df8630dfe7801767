"""What is wrong with one joint on its own: limits, collisions, jamming, coming off its parent."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from model.core.articulated_object import ArticulatedObject
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.kinematics.surface import Surface
from model.kinematics.sweep import Sweep, sweep_joint, sweep_way
from model.validation.phrases import interval, length, title, value
from model.validation.report import Finding, Verdict
from model.validation.support import hold

SHALLOW = 0.03
"""Deepest penetration that is worth a look only, in the object's diagonal."""
LATE = 0.1
"""Share of the range that may be blocked at its ends for a look only."""
STUCK = 0.02
"""Share of the range that a jammed joint may move."""
OFF = 0.03
"""How far a part may come off its parent, in the object's diagonal. Drawers that tilt on their
rails and lids on threads stay below it."""
LIFTS, PULLED = 0.25, 0.4
"""Share of the way over which what is lifted off on purpose keeps to its holder: lids, caps; and
plugs and deep rims, which are worth a look."""
UPWARD = 0.5
"""Upright share of a slide's direction from which it lifts its part."""
SLIDE_LIMIT, SLIDE_ABSURD = 1.2, 3.0
"""Travel of a slide in diagonals: longer than the object, and nonsense."""
TURNS_LIMIT = 2 * math.pi * 1.01
EMPTY_ANGLE, EMPTY_SLIDE = math.radians(0.2), 2e-4
"""Range below which a joint doesn't move: radians, and diagonals."""
PRESSED = ("button", "key", "switch", "toggle", "pedal")
"""What is pushed sinks into what carries it."""

WAY_STEPS = 12


@dataclass(frozen=True, eq=False)
class Scene:
    """An object with what is measured of it once.

    Attributes:
        surfaces: by link, of the parts that have usable geometry.
        samples: joint values a sweep. points: sample points a part.
    """

    obj: ArticulatedObject
    surfaces: Mapping[str, Surface]
    diagonal: float
    tolerance: float
    samples: int = 25
    points: int = 2048

    def titled(self, link: str) -> str:
        """What people call the link."""
        return title(self.obj, link)

    def with_joint(self, joint: Joint) -> Scene:
        """The same with a joint replaced."""
        tree = self.obj.tree.with_joint(joint)
        return replace(self, obj=replace(self.obj, tree=tree))


def limits_of(joint: Joint) -> tuple[float, float]:
    """Its limits; a whole turn where it has none."""
    if not joint.limited:
        return -math.pi, math.pi
    assert joint.lower is not None and joint.upper is not None
    return joint.lower, joint.upper


def examine(scene: Scene, joint: Joint) -> list[Finding]:
    """Everything that is wrong with ``joint`` while the others rest."""
    found = limit_findings(scene, joint)
    lower, upper = limits_of(joint)
    if upper - lower < _empty(scene, joint):
        return found
    sweep = sweep_joint(
        scene.obj, joint, scene.samples, tolerance=scene.tolerance, points=scene.points
    )
    collision = collision_finding(scene, joint, sweep)
    off = detached_finding(scene, joint)
    return found + [f for f in (collision, off) if f is not None]


def _empty(scene: Scene, joint: Joint) -> float:
    return EMPTY_ANGLE if joint.rotates else EMPTY_SLIDE * scene.diagonal


def limit_findings(scene: Scene, joint: Joint) -> list[Finding]:
    """Ranges that are empty, or absurd for the type."""
    if not joint.limited:
        return []
    lower, upper = limits_of(joint)
    span, text = upper - lower, interval(joint, lower, upper)
    if span < _empty(scene, joint):
        return [Finding("limits", "broken", f"The range is empty ({text}): it can't move.")]
    out: list[Finding] = []
    slack = _empty(scene, joint)
    if lower > slack or upper < -slack:
        said = f"The scanned pose lies outside of the range ({text})."
        out.append(Finding("limits", "look", said))
    if joint.rotates and lower < -slack and upper > slack and _door(scene, joint):
        said = f"It turns both ways from the scanned pose ({text}); a shut door turns one way."
        out.append(Finding("limits", "look", said))
    if joint.rotates and span > TURNS_LIMIT:
        turns = span / (2 * math.pi)
        verdict: Verdict = "look" if turns < 20 else "broken"
        said = f"It turns {turns:.1f} times round ({text}); a continuous joint has no limits."
        out.append(Finding("limits", verdict, said))
    if not joint.rotates and span > SLIDE_LIMIT * scene.diagonal:
        ratio = span / scene.diagonal
        verdict = "look" if ratio < SLIDE_ABSURD else "broken"
        said = f"It slides {ratio:.1f} times the object's size ({text})."
        out.append(Finding("limits", verdict, said))
    return out


def collision_finding(scene: Scene, joint: Joint, sweep: Sweep) -> Finding | None:
    """What the sweep ran into, or None."""
    if not sweep.collides.any():
        return None
    worst = int(np.argmax(sweep.depth))
    other = sweep.others[worst]
    depth, q = float(sweep.depth[worst]), float(sweep.q[worst])
    lower, upper = limits_of(joint)
    way_out = None if joint.give_way else first_open(scene, joint, sweep, other)
    at = tuple(float(v) for v in sweep.where[worst])
    what = scene.titled(other) if other else "another part"
    free = interval(joint, *sweep.free)
    moment = {joint.name: q}
    if way_out is not None:
        said = f"Free once {scene.titled(way_out.child)} is moved out of the way."
        return Finding("collision", "fine", said, depth, moment, at, other)  # type: ignore[arg-type]
    if joint.give_way:
        said = f"Runs {length(depth)} into {what}; its collision shapes give way to it."
        return Finding("collision", "look", said, depth, moment, at, other)  # type: ignore[arg-type]
    span = upper - lower
    reach = min(sweep.free[1], upper) - max(sweep.free[0], lower)
    shallow = depth <= SHALLOW * scene.diagonal
    if reach <= STUCK * span and not shallow:
        said = f"Can't move from rest: it runs into {what} at once."
        return Finding("jammed", "broken", said, depth, moment, at, other)  # type: ignore[arg-type]
    late = reach >= (1 - LATE) * span
    mild = shallow or late or _pressed(scene, joint)
    said = f"Runs {length(depth)} into {what} at {value(joint, q)}; free from {free}."
    verdict: Verdict = "look" if mild else "broken"
    return Finding("collision", verdict, said, depth, moment, at, other)  # type: ignore[arg-type]


def _name(scene: Scene, joint: Joint) -> str:
    """Of the part that a joint moves, in small letters; "" where it has none."""
    return (next((p.name for p in scene.obj.parts if p.link == joint.child), None) or "").lower()


def _pressed(scene: Scene, joint: Joint) -> bool:
    return any(word in _name(scene, joint) for word in PRESSED)


def _door(scene: Scene, joint: Joint) -> bool:
    # The thing comes last: a door handle is none.
    return _name(scene, joint).rstrip("s0123456789_- ").endswith("door")


def between(tree: KinematicTree, a: str, b: str) -> list[Joint]:
    """The moving joints between two links; mimics stand for their leaders."""

    def up(link: str) -> list[Joint]:
        out = []
        while link in tree.joint_of:
            out.append(tree.joint_of[link])
            link = tree.joint_of[link].parent
        return out

    first, second = up(a), up(b)
    common = {j.name for j in first} & {j.name for j in second}
    leaders: dict[str, Joint] = {}
    for joint in (*first, *second):
        if joint.moves and joint.name not in common:
            leader = joint
            while leader.mimic is not None:
                leader = tree.by_name[leader.mimic.joint]
            leaders[leader.name] = leader
    return list(leaders.values())


def first_open(scene: Scene, joint: Joint, sweep: Sweep, other: str | None) -> Joint | None:
    """Another joint that, opened first, lets this one move: a drawer behind a door."""
    tree = scene.obj.tree
    if other is None or joint.mimic is not None:
        return None
    if {o for o, c in zip(sweep.others, sweep.collides, strict=True) if c} != {other}:
        return None
    hit = next((k for k in tree.descendants(joint.child) if k in scene.surfaces), joint.child)
    for first in between(tree, hit, other):
        if first.name == joint.name or first.name not in tree.by_name:
            continue
        low, high = limits_of(first)
        for end in sorted({low, high, 0.5 * (low + high)} - {0.0}, key=lambda v: -abs(v)):
            if _clears(scene, joint, sweep, first, end, other):
                return first
    return None


def _clears(scene: Scene, joint: Joint, sweep: Sweep, first: Joint, end: float, other: str) -> bool:
    """Whether ``joint`` passes the link it hit once ``first`` stands at ``end``."""
    tree = scene.obj.tree
    below = tree.descendants(joint.child)
    pairs = {frozenset((k, other)) for k in below}
    for stop in {float(sweep.q[0]), float(sweep.q[-1])} - {0.0}:
        way = [{first.name: end * t} for t in np.linspace(0, 1, WAY_STEPS)]
        way += [
            {first.name: end, joint.name: stop * t} for t in np.linspace(0, 1, 2 * WAY_STEPS)[1:]
        ]
        found = sweep_way(
            scene.with_joint(joint).obj,
            way,
            pairs=pairs,
            tolerance=scene.tolerance,
            points=scene.points // 2,
        )
        if (found.depth > scene.tolerance).any():
            return False
    return True


def detached_finding(scene: Scene, joint: Joint) -> Finding | None:
    """A part that leaves what holds it."""
    lower, upper = limits_of(joint)
    held = hold(scene.obj.tree, joint, scene.surfaces, lower, upper)
    if held is None or held.rest > OFF * scene.diagonal:
        return None  # what hangs in the air at rest is told of as floating
    growth = held.growth
    k = int(np.argmax(growth))
    if growth[k] <= OFF * scene.diagonal:
        return None
    q, holder = float(held.q[k]), scene.titled(held.holder)
    verdict: Verdict = "broken"
    lifted = False
    if not joint.rotates:
        # A lid goes away from what it lies on all the while; a drawer that falls out has slid
        # along its rails first.
        kept = 1.0 - float(growth[k]) / abs(q)
        lifted = kept < PULLED
        if lifted:
            near = kept < LIFTS and growth[k] < 0.5 * scene.diagonal
            verdict = "fine" if near else "look"
    if verdict == "broken" and not _closed(scene, joint, held.holder):
        verdict = "look"  # a scan doesn't show the rails inside
    at = tuple(float(v) for v in held.where[k])
    gap = float(growth[k])
    how = _way_off(scene, joint, held.holder, q, lifted)
    said = f"{how} {holder}: {length(gap)} away at {value(joint, q)}."
    return Finding("detached", verdict, said, gap, {joint.name: q}, at, held.holder)  # type: ignore[arg-type]


def _way_off(scene: Scene, joint: Joint, holder: str, q: float, lifted: bool) -> str:
    """How a part leaves what holds it: a drawer slides out of it, a lid is lifted off."""
    if joint.rotates:
        return "Comes off"
    if math.copysign(1.0, q) * joint.axis[2] > UPWARD:
        return "Lifts off" if lifted else "Comes off"
    part, around = (scene.surfaces.get(k) for k in (joint.child, holder))
    if part is not None and around is not None:
        low, high = around.bounds
        inside = ((part.points >= low) & (part.points <= high)).all(axis=1).mean()
        if inside > 0.5:
            return "Slides out of"
    return "Slides off"


def _closed(scene: Scene, joint: Joint, holder: str) -> bool:
    """Whether the part and what holds it are meshes: clouds show their outside alone."""
    both = [scene.surfaces[k] for k in (joint.child, holder) if k in scene.surfaces]
    return all(s.oriented for s in both)


def attached_range(scene: Scene, joint: Joint) -> tuple[float, float]:
    """The part of the range, about 0, in which the part stays on what holds it."""
    lower, upper = limits_of(joint)
    held = hold(scene.obj.tree, joint, scene.surfaces, lower, upper)
    if held is None:
        return lower, upper
    off = held.growth > OFF * scene.diagonal
    below = held.q[off & (held.q < 0)].max(initial=-math.inf)
    above = held.q[off & (held.q > 0)].min(initial=math.inf)
    # Between the last value at which it held and the first at which it doesn't: the former.
    low = held.q[held.q > below].min(initial=0.0)
    high = held.q[held.q < above].max(initial=0.0)
    return float(max(lower, low)), float(min(upper, high))
