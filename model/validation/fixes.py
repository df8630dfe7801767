"""Changes of a joint that remove its findings.

Each is validated before it is offered, but for shrinking collision shapes: those are cut until
nothing blocks them.

Also findings about equal parts that move differently, whose fix is the motion of the other one.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Prediction
from model.core.errors import ArtiworldError
from model.core.geometry import x_onto
from model.core.joint import Joint, JointType
from model.kinematics.contact import contact_between
from model.kinematics.siblings import carried, fitting, move_alike, namesakes
from model.kinematics.snapping import box_of
from model.kinematics.sweep import sweep_joint
from model.validation import messages
from model.validation.examine import Scene, attached_range, examine_motion
from model.validation.report import Finding, Fix, Severity, worst_first


def unlike_findings(scene: Scene, found: Mapping[str, list[Finding]]) -> dict[str, Finding]:
    """Find joints that move a part otherwise than most of the parts that are equal to it.

    Of two that differ, the one with the worse findings counts; where neither has worse ones, both.

    Args:
        found: joint name → its other findings.

    Returns:
        Joint name → finding, whose ``other`` is the equal part.
    """
    points = {link: surface.points for link, surface in scene.surfaces.items()}
    joints = {
        j.child: j
        for j in scene.obj.tree.joints
        if j.mimic is None and j.child in points and j.parent in points
    }
    parts = {p.link: p for p in scene.obj.parts}
    others = {
        link: [o for o in joints if o != link and namesakes(parts[o], parts[link])]
        for link in joints
    }
    like = {
        link: sum(move_alike(joints[o], own, points[o], points[link]) for o in others[link])
        for link, own in joints.items()
    }

    def rank(link: str) -> tuple[int, int]:
        worst = max((f.severity.rank for f in found.get(joints[link].name, ())), default=0)
        return like[link], -worst

    out: dict[str, Finding] = {}
    for link, own in joints.items():
        better = [o for o in others[link] if joints[o].moves and rank(o) >= rank(link)]
        better.sort(key=lambda o: np.linalg.norm(points[o].mean(0) - points[link].mean(0)))
        better.sort(key=rank, reverse=True)
        for other in better:
            if move_alike(joints[other], own, points[other], points[link]):
                break
            if fitting(points[other], points[link]):
                out[own.name] = _finding(scene, own, joints[other])
                break
    return out


def _finding(scene: Scene, own: Joint, other: Joint) -> Finding:
    name = scene.display_name(other.child)
    if own.slides and other.slides:
        across = abs(float(np.dot(own.axis, other.axis))) < 0.5
        template = messages.MOVES_ACROSS if across else messages.MOVES_AGAINST
    else:
        template = messages.MOVES_OTHERWISE
    q = {own.name: max(own.motion_range, key=abs)} if own.moves else {}
    text = template.format(other=name)
    return Finding("siblings", Severity.WARNING, text, q=q, other=other.child)


def like_fix(scene: Scene, own: Joint, other: str) -> list[Fix]:
    """Return moving like the equal part ``other``, where that is no error."""
    best: tuple[int, Joint] | None = None
    a, b = scene.surfaces[other].points, scene.surfaces[own.child].points
    for image in fitting(a, b):
        joint = carried(scene.obj.tree.joint_of[other], own, image)
        findings = worst_first(examine_motion(scene.with_joint(joint), joint))
        rank = findings[0].severity.rank if findings else 0
        if best is None or rank < best[0]:
            best = rank, joint
    if best is None or best[0] == Severity.ERROR.rank:
        return []
    name = scene.display_name(other)
    return [Fix("like", best[1], messages.FIX_LIKE.format(other=name), name)]


FIXABLE = ("collision", "jammed", "detached", "limits")
LEAST_ANGLE, LEAST_SLIDE = math.radians(3.0), 0.01
"""Smallest range that is offered: radians, and diagonals."""
MOST = 0.5
"""Share of a predicted range that is left after it is cut; less says that the axis is wrong."""
ASIDE = 0.015
"""Distance by which a predicted hinge's axis may be shifted, in the object's diagonal."""
INSET = 0.01
"""Limits end this share of the range before the contact."""
ALONG_CONTACT = 0.9
"""Linearity from which a contact is a hinge line."""
NEAR_HINGE = 0.02
"""Axes nearer to the present one than this share of the part's size are the same axis."""

FloatArray = npt.NDArray[np.float64]


def find_fixes(scene: Scene, joint: Joint, findings: Iterable[Finding]) -> tuple[Fix, ...]:
    """Fixes of a joint, best first: the motion of an equal part, the other direction, another axis,
    a shorter range, smaller collision shapes."""
    if joint.mimic is not None:
        return ()
    problems = [f for f in findings if f.severity != Severity.OK]
    bad = [f for f in problems if f.kind in FIXABLE]
    shrink = _shrink(joint, problems)
    unlike = [f.other for f in problems if f.kind == "siblings" and f.other is not None]
    out = [fix for other in unlike for fix in like_fix(scene, joint, other)]
    if not bad:
        return (*out, *shrink)
    # Axis and direction are hardly the cause of a warning.
    errors = [f.kind for f in bad if f.severity == Severity.ERROR and f.kind != "limits"]
    if "collision" in errors or "jammed" in errors:
        out += _flip(scene, joint)
    if joint.rotates and errors:
        out += _shift(scene, joint)
    out += _limits(scene, joint)
    return (*out, *shrink)


def _shrink(joint: Joint, problems: Iterable[Finding]) -> tuple[Fix, ...]:
    """Smaller collision shapes, where others block them."""
    blocked = any(
        f.kind in ("collision", "jammed") or (f.kind == "physics" and f.other is not None)
        for f in problems
    )
    if joint.give_way or not blocked:
        return ()
    return (Fix("shrink", replace(joint, give_way=True), messages.FIX_SHRINK),)


def _is_fixed(scene: Scene, joint: Joint) -> bool:
    """True if ``joint`` neither collides nor leaves its support over its range."""
    found = examine_motion(scene.with_joint(joint), joint)
    return all(f.severity == Severity.OK for f in found)


def _flip(scene: Scene, joint: Joint) -> list[Fix]:
    """Reverse the axis, with the same limits."""
    lower, upper = joint.motion_range
    if not joint.limited or math.isclose(-lower, upper, rel_tol=0.02):
        return []
    x, y, z = (-v if v else 0.0 for v in joint.axis)
    turned = replace(joint, axis=(x, y, z))
    if not _is_fixed(scene, turned):
        return []
    return [Fix("flip", turned, messages.FIX_FLIP)]


def _shift(scene: Scene, joint: Joint) -> list[Fix]:
    """Move the axis to the line where part and parent touch, or to an edge of the part there."""
    for moved in _other_axes(scene, joint):
        x, y, z = (-v if v else 0.0 for v in moved.axis)
        turned = replace(moved, axis=(x, y, z))
        for tried, message in ((moved, messages.FIX_AXIS), (turned, messages.FIX_AXIS_AND_FLIP)):
            if _is_fixed(scene, tried):
                return [Fix("shift", tried, message)]
    return []


def _other_axes(scene: Scene, joint: Joint) -> Iterator[Joint]:
    parts = {p.link: p for p in scene.obj.parts}
    child, parent = scene.surfaces.get(joint.child), scene.surfaces.get(joint.parent)
    if child is None or parent is None:
        return
    axis, origin = np.asarray(joint.axis), np.asarray(joint.origin)
    lines: list[tuple[FloatArray, FloatArray]] = []
    touch = max(0.01 * scene.diagonal, 2 * scene.tolerance)
    try:
        contact = contact_between(parts[joint.child], parts[joint.parent], touch)
        if contact.touches and contact.line.linearity > ALONG_CONTACT:
            lines.append((contact.line.point, contact.line.direction))
    except ArtiworldError:
        pass  # no contact: only the part's edges are left
    lines += _contact_edges(child.points, parent.distance(child.points)[0] <= touch, axis)
    for point, along in lines:
        direction = along if along @ axis >= 0 else -along
        apart = float(np.linalg.norm(np.cross(point - origin, direction)))
        turned = math.acos(min(abs(float(direction @ axis)), 1.0))
        if apart > NEAR_HINGE * child.diagonal or turned > math.radians(5):
            yield replace(
                joint,
                origin=tuple(float(v) for v in point),
                axis=tuple(float(v) for v in direction),
            )


def _contact_edges(
    points: FloatArray, touching: npt.NDArray[np.bool_], axis: FloatArray
) -> list[tuple[FloatArray, FloatArray]]:
    """Edges of the part's box along ``axis`` where it touches its parent, most contact first."""
    if not touching.any():
        return []
    box = box_of(points)
    along = int(np.argmax(np.abs(axis @ box.axes)))
    a, b = (k for k in range(3) if k != along)
    local = (points[touching] - box.center) @ box.axes
    found = []
    for s in (-1, 1):
        for t in (-1, 1):
            edge = np.array([s * box.half[a], t * box.half[b]])
            reach = 0.1 * max(2 * box.half[a], 2 * box.half[b])
            count = int((np.linalg.norm(local[:, [a, b]] - edge, axis=1) <= reach).sum())
            place = box.center + edge[0] * box.axes[:, a] + edge[1] * box.axes[:, b]
            found.append((count, place, box.axes[:, along]))
    found.sort(key=lambda e: -e[0])
    return [(place, direction) for count, place, direction in found if count]


def checked_ranges(prediction: Prediction, scene: Scene, locked: Container[str]) -> Prediction:
    """Make the checks accept predicted motions: shift a hinge's axis slightly, or cut the limits
    where most of the range is left; the notes say so, or that the checks object.

    Args:
        prediction: of the tree in ``scene``.
        locked: child links whose joints stay.
    """
    notes = dict(prediction.notes)
    for joint in scene.obj.tree.joints:
        stays = not joint.moves or joint.mimic is not None or joint.child in locked
        if stays or _is_fixed(scene, joint):
            continue
        near = next((n for n in _nearby(scene, joint) if _is_fixed(scene, n)), None)
        cut = None if near else next((f.joint for f in _limits(scene, joint) if f.joint), None)
        was = np.ptp(joint.motion_range)
        if near is not None:
            scene, text = scene.with_joint(near), messages.AXIS_SHIFTED
        elif cut is not None and MOST * was <= np.ptp(cut.motion_range) < was:
            scene, text = scene.with_joint(cut), messages.RANGE_CUT
        else:
            text = messages.RANGE_REFUSED
        notes[joint.child] = f"{notes.get(joint.child, '').rstrip('.')}. {text}".lstrip(". ")
    return replace(prediction, tree=scene.obj.tree, notes=notes)


def _nearby(scene: Scene, joint: Joint) -> Iterator[Joint]:
    """Yield the hinge with its axis shifted to eight sides; nothing for other joints."""
    across = ASIDE * scene.diagonal * x_onto(np.asarray(joint.axis))[:, 1:]
    for turn in np.pi / 4 * np.arange(8) if joint.rotates and joint.limited else ():
        place = joint.origin + across @ (math.cos(turn), math.sin(turn))
        yield replace(joint, origin=tuple(place.tolist()))


def _limits(scene: Scene, joint: Joint) -> list[Fix]:
    """Set the range in which the part is free and stays at its support."""
    lower, upper = joint.motion_range
    least = LEAST_ANGLE if joint.rotates else LEAST_SLIDE * scene.diagonal
    wide = math.pi if joint.rotates else scene.diagonal
    empty = upper - lower < 1e-9 + 0.1 * least
    if empty:
        lower, upper = 0.0, wide / 2
    if joint.rotates:
        lower, upper = max(lower, -2 * math.pi), min(upper, 2 * math.pi)
    else:
        lower, upper = max(lower, -wide), min(upper, wide)
    kind: JointType = "revolute" if joint.rotates else "prismatic"
    tried = replace(joint, type=kind, lower=min(lower, 0.0), upper=max(upper, 0.0))
    sweep = sweep_joint(scene.obj, tried, 9, tolerance=scene.tolerance, points=scene.points)
    low, high = attached_range(scene.with_joint(tried), tried)
    low, high = max(low, sweep.free[0]), min(high, sweep.free[1])
    inset = INSET * (high - low)
    low = low + inset if low > tried.lower else low  # type: ignore[operator]
    high = high - inset if high < tried.upper else high  # type: ignore[operator]
    span = high - low
    if span < least:
        return []
    changed = replace(tried, lower=float(low), upper=float(high))
    if changed == joint or not _is_fixed(scene, changed):
        return []
    text = messages.FIX_RANGE.format(range=messages.interval(changed, low, high))
    return [Fix("limits", changed, text)]
