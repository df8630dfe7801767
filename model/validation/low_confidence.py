"""What the predictor itself doesn't believe is worth a look, however freely it moves."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.validation.report import Finding, GateReport, JointVerdict, worst_first

UNLIKELY = 0.5
"""Confidence below which a joint is more likely wrong than right."""


def with_unsure(report: GateReport, tree: KinematicTree, sure: Mapping[str, float]) -> GateReport:
    """The gate's answer with a finding on each joint that is likely wrong.

    Args:
        report: on the joints of ``tree``.
        sure: child link → confidence, 0..1, of the joints that are as they were predicted.

    Returns:
        ``report`` itself where there is none.
    """
    doubted = [j for j in tree.joints if sure.get(j.child, 1.0) < UNLIKELY]
    if not doubted:
        return report
    joints = {j.joint: j for j in report.joints}
    for joint in doubted:
        verdict = joints.get(joint.name, JointVerdict(joint.name, joint.child))
        findings = worst_first((*verdict.findings, _finding(joint, sure[joint.child])))
        joints[joint.name] = replace(verdict, findings=findings)
    return replace(report, joints=tuple(sorted(joints.values(), key=lambda j: j.place)))


def _finding(joint: Joint, sure: float) -> Finding:
    what = "moves so" if joint.moves else "doesn't move"
    said = f"The prediction is only {100 * sure:.0f} % sure that it {what}."
    return Finding("unsure", "look", said, q={joint.name: _far_end(joint)} if joint.moves else {})


def _far_end(joint: Joint) -> float:
    """Where the motion is seen best."""
    if joint.lower is None or joint.upper is None:
        return math.pi / 2
    return max(joint.lower, joint.upper, key=abs)
