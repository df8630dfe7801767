"""Joints and links in words."""

from __future__ import annotations

import math

from app.judging import JointCheck
from app.viewer.text import plain
from model.kinematics.joint import Joint
from model.kinematics.tree import KinematicTree
from sessions.document import Document


def part_title(doc: Document, link: str) -> str:
    """What people call a link: its part's name, else the link's own."""
    digits = link.removeprefix("link_")
    for part in doc.parts:
        if str(part.id) == digits and part.name:
            return f"{part.name} {part.id}"
    return link


def titled(doc: Document, link: str) -> str:
    """The link with what people call it."""
    title = part_title(doc, link)
    return link if title == link else f"{link} · {title}"


def shown(joint: Joint, q: float) -> float:
    """Degrees or millimetres."""
    return math.degrees(q) if joint.rotates else 1000 * q


def range_text(joint: Joint) -> str:
    """The range of a joint with its unit."""
    if joint.type == "continuous":
        return "turns freely"
    if not joint.limited:
        return ""
    assert joint.lower is not None and joint.upper is not None
    unit = "°" if joint.rotates else " mm"
    return f"{shown(joint, joint.lower):.0f} to {shown(joint, joint.upper):.0f}{unit}"


def tree_text(tree: KinematicTree, doc: Document, checks: list[JointCheck]) -> str:
    """The tree as a nested list."""
    hits = {c.joint for c in checks}
    depth = {tree.root: 0}
    lines = []
    for link in tree.order:
        joint = tree.joint_of.get(link)
        if joint is not None:
            depth[link] = depth[joint.parent] + 1
        title = plain(part_title(doc, link))
        line = f"{'  ' * depth[link]}- **{title}**"
        if joint is not None:
            sure = None if doc.prediction is None else doc.prediction.confidence.get(link)
            line += f" {joint.type} {range_text(joint)}"
            line += "" if sure is None else f" · {100 * sure:.0f} % sure"
            line += " · locked" if link in doc.locked else ""
            line += " · ⚠ collides" if joint.name in hits else ""
        else:
            line += " base"
        lines.append(line)
    return "\n".join(lines)


def joint_note(joint: Joint, doc: Document, checks: list[JointCheck]) -> str:
    """How the joint was decided, and what its sweep hit."""
    lines = []
    if doc.prediction is not None:
        note = doc.prediction.notes.get(joint.child)
        if note:
            lines.append(f"*{plain(note, 300)}*")
        if joint != doc.prediction.joint(joint.child):
            lines.append("Edited; the grey arrow is the prediction.")
    for check in checks:
        if check.joint == joint.name:
            at = shown(joint, check.q)
            unit = "°" if joint.rotates else "mm"
            other = f" with {plain(part_title(doc, check.other))}" if check.other else ""
            lines.append(
                f"⚠ Collides{other} at {at:.0f} {unit}: {1000 * check.depth:.1f} mm deep "
                "(red ball in that pose)."
            )
    return "\n\n".join(lines) or "Chosen by you."
