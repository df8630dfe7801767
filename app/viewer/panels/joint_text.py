"""Joints and links in words."""

from __future__ import annotations

import math
from typing import Final

from app.server.display_names import display_text, moved_part, part_title
from app.server.validating import JointCollision
from app.viewer.text import plain
from app.viewer.words import joints as words
from app.viewer.words.common import warning
from model.core.joint import Joint, value_text
from sessions.document import Document

_NEARLY: Final = 0.97
"""Least cosine between an axis and the one that it is called after."""


def shown(joint: Joint, q: float) -> float:
    """Degrees or millimetres."""
    return math.degrees(q) if joint.rotates else 1000 * q


def range_text(joint: Joint) -> str:
    """The range of a joint with its unit."""
    if joint.type == "continuous":
        return words.UNLIMITED
    if not joint.limited:
        return ""
    assert joint.lower is not None and joint.upper is not None
    lower = value_text(joint.lower, joint.rotates).rstrip("° m")
    return words.span(lower, value_text(joint.upper, joint.rotates))


def confidence_text(doc: Document, child: str) -> str:
    """Confidence of a joint's prediction, or that a user edited the joint."""
    if child in doc.edited_joints:
        return words.EDITED
    if any(joint.child == child for joint in doc.new_joints):
        return words.NEW
    share = confidence_of(doc, child)
    return "" if share is None else words.confidence(share)


def confidence_of(doc: Document, child: str) -> float | None:
    """Confidence of a joint's prediction, 0..1; None where nothing was predicted."""
    known = {} if doc.prediction is None else doc.prediction.confidence
    # All joints of a part are one prediction.
    part = child if doc.tree is None else moved_part(doc.tree, child)
    return known.get(child, known.get(part))


def axis_name(joint: Joint) -> str:
    """The axis as "X" or "-Z"; "" for another direction, or a joint that doesn't move."""
    largest = max(range(3), key=lambda k: abs(joint.axis[k]))
    if not joint.moves or abs(joint.axis[largest]) < _NEARLY:
        return ""
    return f"{'-' if joint.axis[largest] < 0 else ''}{'XYZ'[largest]}"


def range_warnings(joint: Joint) -> list[str]:
    """Warnings about the range of a joint."""
    if not joint.limited:
        return []
    assert joint.lower is not None and joint.upper is not None
    out = []
    if joint.rotates and max(abs(joint.lower), abs(joint.upper)) > 2 * math.pi + 1e-6:
        out.append(words.BEYOND_A_TURN)
    if joint.lower > 1e-6 or joint.upper < -1e-6:
        out.append(words.SCAN_OUTSIDE)
    return out


def joint_note(joint: Joint, doc: Document, checks: list[JointCollision]) -> str:
    """Explanation of the joint's values, and the collisions of its sweep."""
    lines = []
    if doc.prediction is not None:
        note = doc.prediction.notes.get(joint.child)
        text = f"*{plain(display_text(doc, note), 300)}*" if note else ""
        if joint != doc.prediction.joint(joint.child):
            text = words.edited(doc.joints_file is not None, text)
        lines += [text] if text else []
    lines += [warning(text) for text in range_warnings(joint)]
    for check in checks:
        if check.joint == joint.name:
            at = value_text(check.q, joint.rotates)
            other = plain(part_title(doc, check.other)) if check.other else ""
            lines.append(words.collision(other, at, 1000 * check.depth))
    return "\n\n".join(lines) or words.SET_MANUALLY
