"""Findings about equal parts that move differently, with moving like the other one as their fix."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from model.core.joint import Joint
from model.kinematics.siblings import carried, fitting, move_alike, namesakes
from model.validation import messages
from model.validation.examine import Scene, examine_motion
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
        return like[link], -max(
            (f.severity.rank for f in found.get(joints[link].name, ())), default=0
        )

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
