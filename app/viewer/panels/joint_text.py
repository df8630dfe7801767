"""Joints and links in words."""

from __future__ import annotations

import math

from app.server.display_names import in_words, joint_title, moved_part, part_title
from app.server.validating import JointCheck
from app.viewer.text import plain
from model.core.display_names import BASE
from model.core.joint import Joint, value_text
from model.core.tree import KinematicTree
from sessions.document import Document


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
    lower = value_text(joint.lower, joint.rotates).rstrip("° m")
    return f"{lower} to {value_text(joint.upper, joint.rotates)}"


def sure_text(doc: Document, child: str) -> str:
    """How sure the prediction of a joint is; what a person edited is no prediction."""
    if child in doc.edited_joints:
        return "edited"
    sure = sureness(doc, child)
    return "" if sure is None else f"{100 * sure:.0f} %"


def sureness(doc: Document, child: str) -> float | None:
    """How sure the prediction of a joint is, 0..1; None where nothing was predicted."""
    known = {} if doc.prediction is None else doc.prediction.confidence
    # All joints of a part are one prediction.
    part = child if doc.tree is None else moved_part(doc.tree, child)
    return known.get(child, known.get(part))


def range_doubts(joint: Joint) -> list[str]:
    """What is odd about the range, in sentences."""
    if not joint.limited:
        return []
    assert joint.lower is not None and joint.upper is not None
    out = []
    if joint.rotates and max(abs(joint.lower), abs(joint.upper)) > 2 * math.pi + 1e-6:
        out.append("It turns more than once round; a continuous joint has no limits.")
    if joint.lower > 1e-6 or joint.upper < -1e-6:
        out.append("The scanned pose, 0, lies outside of the range.")
    return out


def tree_text(tree: KinematicTree, doc: Document, checks: list[JointCheck]) -> str:
    """The tree as a nested list."""
    hits = {c.joint for c in checks}
    depth = {tree.root: 0}
    lines = []
    for link in tree.order:
        joint = tree.joint_of.get(link)
        if joint is not None:
            depth[link] = depth[joint.parent] + 1
        title = plain(part_title(doc, link) if joint is None else joint_title(doc, link))
        line = f"{'  ' * depth[link]}- **{title}**"
        if joint is not None:
            sure = sure_text(doc, link)
            line += f" {joint.type} {range_text(joint)}" if joint.limited else f" {joint.type}"
            line += f" · {sure} sure" if sure.endswith("%") else f" · {sure}" if sure else ""
            line += " · locked" if link in doc.locked else ""
            line += " · ⚠ odd range" if range_doubts(joint) else ""
            line += " · ⚠ collides" if joint.name in hits else ""
        elif title != BASE:
            line += f" {BASE}"
        lines.append(line)
    return "\n".join(lines)


def joint_note(joint: Joint, doc: Document, checks: list[JointCheck]) -> str:
    """How the joint was decided, and what its sweep hit."""
    lines = []
    if doc.prediction is not None:
        note = doc.prediction.notes.get(joint.child)
        said = f"*{plain(in_words(doc, note), 300)}*" if note else ""
        if joint != doc.prediction.joint(joint.child):
            whose = "the prediction" if doc.joints_file is None else "the file's joint"
            said = f"Edited; the grey arrow is {whose}" + (f": {said}" if said else ".")
        lines += [said] if said else []
    lines += [f"⚠ {said}" for said in range_doubts(joint)]
    for check in checks:
        if check.joint == joint.name:
            at = value_text(check.q, joint.rotates)
            other = f" with {plain(part_title(doc, check.other))}" if check.other else ""
            lines.append(
                f"⚠ Collides{other} at {at}: {1000 * check.depth:.1f} mm deep "
                "(red ball in that pose)."
            )
    return "\n\n".join(lines) or "Chosen by you."
