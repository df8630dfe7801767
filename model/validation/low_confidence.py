"""Warnings about joints in which the predictor has little confidence."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.validation import messages
from model.validation.report import (
    Finding,
    JointReport,
    Severity,
    ValidationReport,
    worst_first,
)

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
    unlikely = [j for j in tree.joints if confidence.get(j.child, 1.0) < UNLIKELY]
    if not unlikely:
        return report
    joints = {j.joint: j for j in report.joints}
    for joint in unlikely:
        percent = f"{100 * confidence[joint.child]:.0f}"
        message = messages.LOW_CONFIDENCE.format(percent=percent)
        q = {joint.name: _far_end(joint)} if joint.moves else {}
        before = joints.get(joint.name, JointReport(joint.name, joint.child))
        finding = Finding("unsure", Severity.WARNING, message, q=q)
        findings = worst_first((*before.findings, finding))
        joints[joint.name] = replace(before, findings=findings)
    return replace(report, joints=tuple(sorted(joints.values(), key=lambda j: j.sort_key)))


def _far_end(joint: Joint) -> float:
    """The joint value that shows the motion best."""
    if joint.lower is None or joint.upper is None:
        return math.pi / 2
    return max(joint.lower, joint.upper, key=abs)
