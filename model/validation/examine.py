"""Checks of one joint on its own: limits, collisions, jamming, leaving its support.

Two more need no motion: warnings about joints in which the predictor has little confidence, and
errors about names that a project doesn't have.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from model.core import names
from model.core.articulated_object import ArticulatedObject
from model.core.joint import Joint
from model.core.tree import KinematicTree, driven
from model.geometry.units import unusual_height
from model.kinematics.surface import Surface
from model.kinematics.sweep import Sweep, sweep_joint, sweep_path
from model.validation import messages
from model.validation.messages import interval, length, value
from model.validation.report import (
    Finding,
    Fix,
    JointReport,
    Kind,
    Severity,
    ValidationReport,
    worst_first,
)
from model.validation.support import support_gap

SHALLOW = 0.03
"""Deepest penetration that is only a warning, in the object's diagonal."""
LATE = 0.1
"""Share of the range, at its ends, whose blocking is only a warning."""
STUCK = 0.02
"""Share of the range up to which a joint that moves counts as jammed."""
OFF = 0.03
"""Gap to its parent from which a part has come off, in the object's diagonal. Drawers that tilt on
their rails and lids on threads stay below it."""
LIFTS, PULLED = 0.25, 0.4
"""Share of the travel along which a lifted part stays at its support: lids and caps; and plugs and
deep rims, which are a warning."""
ONE_SIDED = 0.5
"""Net share of a surface that faces one way, from which it was seen from there alone."""
UPWARD = 0.5
"""Upright share of a prismatic axis from which its part is lifted."""
SLIDE_LIMIT, SLIDE_ABSURD = 1.2, 3.0
"""Travel of a prismatic joint in diagonals: a warning, and an error."""
TURNS_LIMIT, TURNS_ABSURD = 2 * math.pi * 1.01, 20
"""Range of a revolute joint: a warning in radians, an error in turns."""
EMPTY_ANGLE, EMPTY_SLIDE = math.radians(0.2), 2e-4
"""Range below which a joint can't move: radians, and diagonals."""
PRESSED = ("button", "key", "switch", "toggle", "pedal")
"""Names of parts that sink into their support when pressed."""

PATH_STEPS = 12


@dataclass(frozen=True, eq=False)
class Scene:
    """An object with its surfaces and scale.

    Attributes:
        surfaces: link → surface of its part, where that has usable geometry.
        diagonal: of the object. tolerance: of sweeps. Both in metres.
        samples: joint values of a sweep. points: samples of a part.
    """

    obj: ArticulatedObject
    surfaces: Mapping[str, Surface]
    diagonal: float
    tolerance: float
    samples: int = 25
    points: int = 2048

    def display_name(self, link: str) -> str:
        """Display name of a link."""
        return names.display_name(self.obj, link)

    def with_joint(self, joint: Joint) -> Scene:
        """The scene with a joint replaced."""
        tree = self.obj.tree.with_joint(joint)
        return replace(self, obj=replace(self.obj, tree=tree))


def examine(scene: Scene, joint: Joint) -> list[Finding]:
    """Run all checks of ``joint``, the other joints at rest."""
    found = limit_findings(scene, joint)
    joint = driven(scene.obj.tree, joint)
    lower, upper = joint.motion_range
    empty = upper - lower < _empty(scene, joint)
    return found + ([] if empty else examine_motion(scene, joint))


def examine_motion(scene: Scene, joint: Joint) -> list[Finding]:
    """Check for collisions over the range of ``joint``, and whether its part comes off."""
    sweep = sweep_joint(
        scene.obj, joint, scene.samples, tolerance=scene.tolerance, points=scene.points
    )
    collision = collision_finding(scene, joint, sweep)
    off = detached_finding(scene, joint)
    return [f for f in (collision, off) if f is not None]


def _empty(scene: Scene, joint: Joint) -> float:
    return EMPTY_ANGLE if joint.rotates else EMPTY_SLIDE * scene.diagonal


def limit_findings(scene: Scene, joint: Joint) -> list[Finding]:
    """Check for ranges that are empty or impossible for the type."""
    if not joint.limited:
        return []
    lower, upper = joint.motion_range
    span, text = upper - lower, interval(joint, lower, upper)
    if span < _empty(scene, joint):
        message = messages.EMPTY_RANGE.format(range=text)
        return [Finding("limits", Severity.ERROR, message)]
    out: list[Finding] = []

    def add(severity: Severity, template: str, **fields: str) -> None:
        out.append(Finding("limits", severity, template.format(range=text, **fields)))

    slack = _empty(scene, joint)
    if lower > slack or upper < -slack:
        add(Severity.WARNING, messages.POSE_OUTSIDE)
    if joint.rotates and lower < -slack and upper > slack and _is_door(scene, joint):
        add(Severity.WARNING, messages.BOTH_WAYS)
    screw = any(j.mimic and j.mimic.joint == joint.name for j in scene.obj.tree.joints)
    if joint.rotates and span > TURNS_LIMIT and not screw:
        turns = span / (2 * math.pi)
        severity = Severity.WARNING if turns < TURNS_ABSURD else Severity.ERROR
        add(severity, messages.MANY_TURNS, turns=f"{turns:.1f}")
    if not joint.rotates and span > SLIDE_LIMIT * scene.diagonal:
        ratio = span / scene.diagonal
        severity = Severity.WARNING if ratio < SLIDE_ABSURD else Severity.ERROR
        add(severity, messages.LONG_TRAVEL, ratio=f"{ratio:.1f}")
    return out


def collision_finding(scene: Scene, joint: Joint, sweep: Sweep) -> Finding | None:
    """Turn the deepest penetration of a sweep into a finding; None where nothing collides."""
    if not sweep.collides.any():
        return None
    worst = int(np.argmax(sweep.depth))
    other = sweep.others[worst]
    depth, q = float(sweep.depth[worst]), float(sweep.q[worst])
    at = tuple(float(v) for v in sweep.where[worst])

    def finding(severity: Severity, message: str, kind: Kind = "collision") -> Finding:
        return Finding(kind, severity, message, depth, {joint.name: q}, at, other)  # type: ignore[arg-type]

    what = scene.display_name(other) if other else messages.UNNAMED_PART
    if joint.give_way:
        message = messages.SHRUNK_SHAPES.format(other=what, depth=length(depth))
        return finding(Severity.WARNING, message)
    opened = first_open(scene, joint, sweep, other)
    if opened is not None:
        name = scene.display_name(opened.child)
        return finding(Severity.OK, messages.FREE_AFTER.format(other=name))
    lower, upper = joint.motion_range
    span = upper - lower
    reach = min(sweep.free[1], upper) - max(sweep.free[0], lower)
    shallow = depth <= SHALLOW * scene.diagonal
    if reach <= STUCK * span and not shallow:
        message = messages.BLOCKED_AT_REST.format(other=what)
        return finding(Severity.ERROR, message, "jammed")
    pressed = any(word in _part_name(scene, joint) for word in PRESSED)
    mild = shallow or reach >= (1 - LATE) * span or pressed
    message = messages.PENETRATION.format(
        other=what, depth=length(depth), at=value(joint, q), free=interval(joint, *sweep.free)
    )
    return finding(Severity.WARNING if mild else Severity.ERROR, message)


def _part_name(scene: Scene, joint: Joint) -> str:
    """Name of the part that a joint moves, in small letters; "" where it has none."""
    return (next((p.name for p in scene.obj.parts if p.link == joint.child), None) or "").lower()


def _is_door(scene: Scene, joint: Joint) -> bool:
    # The noun comes last: a door handle is no door.
    return _part_name(scene, joint).rstrip("s0123456789_- ").endswith("door")


def between(tree: KinematicTree, a: str, b: str) -> list[Joint]:
    """Return the moving joints between two links; mimics are replaced by their leaders."""

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
    """Find another joint that, once opened, lets this one move: a door before its drawer."""
    tree = scene.obj.tree
    if other is None or joint.mimic is not None:
        return None
    if {o for o, c in zip(sweep.others, sweep.collides, strict=True) if c} != {other}:
        return None
    hit = next((k for k in tree.descendants(joint.child) if k in scene.surfaces), joint.child)
    for first in between(tree, hit, other):
        if first.name == joint.name or first.name not in tree.by_name:
            continue
        low, high = first.motion_range
        for end in sorted({low, high, 0.5 * (low + high)} - {0.0}, key=lambda v: -abs(v)):
            if _clears(scene, joint, sweep, first, end, other):
                return first
    return None


def _clears(scene: Scene, joint: Joint, sweep: Sweep, first: Joint, end: float, other: str) -> bool:
    """True if ``joint`` passes ``other`` once ``first`` is at ``end``."""
    below = scene.obj.tree.descendants(joint.child)
    pairs = {frozenset((k, other)) for k in below}
    obj, points = scene.with_joint(joint).obj, scene.points // 2
    for stop in {float(sweep.q[0]), float(sweep.q[-1])} - {0.0}:
        path = [{first.name: end * t} for t in np.linspace(0, 1, PATH_STEPS)]
        path += [
            {first.name: end, joint.name: stop * t} for t in np.linspace(0, 1, 2 * PATH_STEPS)[1:]
        ]
        found = sweep_path(obj, path, pairs=pairs, tolerance=scene.tolerance, points=points)
        if (found.depth > scene.tolerance).any():
            return False
    return True


def detached_finding(scene: Scene, joint: Joint) -> Finding | None:
    """Check whether the part leaves its support within the range."""
    lower, upper = joint.motion_range
    support = support_gap(scene.obj.tree, joint, scene.surfaces, lower, upper)
    if support is None or support.rest > OFF * scene.diagonal:
        return None  # a gap at rest is reported as floating
    growth = support.growth
    k = int(np.argmax(growth))
    if growth[k] <= OFF * scene.diagonal:
        return None
    q, gap = float(support.q[k]), float(growth[k])
    if _may_reach_inside(scene, joint, support.link, q):
        return None
    severity, lifted = Severity.ERROR, False
    if not joint.rotates:
        # A lid moves away from its support all the while; a drawer that falls out has slid
        # along its rails first.
        kept = 1.0 - gap / abs(q)
        lifted = kept < PULLED
        if lifted:
            near = kept < LIFTS and gap < 0.5 * scene.diagonal
            severity = Severity.OK if near else Severity.WARNING
    if severity == Severity.ERROR and not _both_oriented(scene, joint, support.link):
        severity = Severity.WARNING
    at = tuple(float(v) for v in support.where[k])
    message = _how_detached(scene, joint, support.link, q, lifted).format(
        support=scene.display_name(support.link), gap=length(gap), at=value(joint, q)
    )
    return Finding("detached", severity, message, gap, {joint.name: q}, at, support.link)  # type: ignore[arg-type]


def _how_detached(scene: Scene, joint: Joint, support: str, q: float, lifted: bool) -> str:
    """The message's template: a drawer slides out of its support, a lid is lifted off."""
    if joint.rotates:
        return messages.COMES_OFF
    if math.copysign(1.0, q) * joint.axis[2] > UPWARD:
        return messages.LIFTS_OFF if lifted else messages.COMES_OFF
    part, around = (scene.surfaces.get(k) for k in (joint.child, support))
    if part is not None and around is not None:
        low, high = around.bounds
        inside = ((part.points >= low) & (part.points <= high)).all(axis=1).mean()
        if inside > 0.5:
            return messages.SLIDES_OUT
    return messages.SLIDES_OFF


def _both_oriented(scene: Scene, joint: Joint, support: str) -> bool:
    """True if the part and its support are meshes: clouds show their outside alone."""
    both = [scene.surfaces[k] for k in (joint.child, support) if k in scene.surfaces]
    return all(s.oriented for s in both)


def _may_reach_inside(scene: Scene, joint: Joint, support: str, q: float) -> bool:
    """True if unscanned geometry can hold a part at ``q``: a scan of a drawer shows its front,
    while the rest of it reaches as far in as its support is deep."""
    part, around = scene.surfaces.get(joint.child), scene.surfaces[support]
    if part is None or joint.rotates or abs(joint.axis[2]) > UPWARD:
        return False
    axis = np.asarray(joint.axis)
    if part.oriented:
        facing = part.normals @ axis
        if abs(facing.sum()) < ONE_SIDED * np.abs(facing).sum():
            return False
    return abs(q) <= float(np.ptp(around.points @ axis))


def attached_range(scene: Scene, joint: Joint) -> tuple[float, float]:
    """The part of the range, about 0, in which the part stays at its support."""
    lower, upper = joint.motion_range
    support = support_gap(scene.obj.tree, joint, scene.surfaces, lower, upper)
    if support is None:
        return lower, upper
    off = support.growth > OFF * scene.diagonal
    below = support.q[off & (support.q < 0)].max(initial=-math.inf)
    above = support.q[off & (support.q > 0)].min(initial=math.inf)
    # The last value at which it was attached, before the first at which it isn't.
    low = support.q[support.q > below].min(initial=0.0)
    high = support.q[support.q < above].max(initial=0.0)
    return float(max(lower, low)), float(min(upper, high))


UNLIKELY = 0.5
"""Confidence below which a joint is more likely wrong than right."""


def with_low_confidence(
    report: ValidationReport, tree: KinematicTree, confidence: Mapping[str, float]
) -> ValidationReport:
    """Add a warning to each joint that is likely wrong.

    Args:
        report: on the joints of ``tree``.
        confidence: child link → 0..1, of the joints that are still as predicted.

    Returns:
        ``report`` itself where no joint is likely wrong.
    """
    found = []
    for joint in tree.joints:
        if confidence.get(joint.child, 1.0) < UNLIKELY:
            percent = f"{100 * confidence[joint.child]:.0f}"
            message = messages.LOW_CONFIDENCE.format(percent=percent)
            q = {joint.name: _far_end(joint)} if joint.moves else {}
            found.append((joint.child, Finding("unsure", Severity.WARNING, message, q=q)))
    return _with(report, tree, found)


def _far_end(joint: Joint) -> float:
    """The joint value that shows the motion best."""
    if joint.lower is None or joint.upper is None:
        return math.pi / 2
    return max(joint.lower, joint.upper, key=abs)


def with_unusual_height(
    report: ValidationReport, tree: KinematicTree, category: str | None, height: float | None
) -> ValidationReport:
    """Add a warning about the root where ``height`` (metres) is unusual for the category."""
    odd = None if height is None else unusual_height(category, height)
    if odd is None or height is None:
        return report
    to = f"{odd.proposed:.2g}"
    fix = Fix("size", None, messages.FIX_SIZE.format(height=to), f"{to} m", odd.proposed / height)
    return _with(report, tree, [(tree.root, Finding("size", Severity.WARNING, odd.question))], fix)


def with_unknown_names(
    report: ValidationReport, tree: KinematicTree, parts: Mapping[str, str], category: str | None
) -> ValidationReport:
    """Add an error for each name that isn't allowed.

    Args:
        report: on the joints of ``tree``.
        parts: link → name, of the parts whose name isn't allowed.
        category: of the object, where it isn't allowed, else None.

    Returns:
        ``report`` itself where all names are allowed. What is about the root, which has no joint,
        has "" as joint.
    """
    wrong = [(link, messages.PART_NAME.format(name=name)) for link, name in parts.items()]
    if category is not None:
        wrong.append((tree.root, messages.CATEGORY_NAME.format(name=category)))
    return _with(report, tree, [(k, Finding("name", Severity.ERROR, text)) for k, text in wrong])


def _with(
    report: ValidationReport, tree: KinematicTree, found: list[tuple[str, Finding]], *fixes: Fix
) -> ValidationReport:
    """Add findings to those of the joints that move links; the fixes are for all of them."""
    if not found:
        return report
    joints = {j.child: j for j in report.joints}
    for link, finding in found:
        joint = tree.joint_of.get(link)
        before = joints.get(link, JointReport("" if joint is None else joint.name, link))
        findings = worst_first((*before.findings, finding))
        joints[link] = replace(before, findings=findings, fixes=(*before.fixes, *fixes))
    return replace(report, joints=tuple(sorted(joints.values(), key=lambda j: j.sort_key)))
