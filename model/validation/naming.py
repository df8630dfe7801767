"""Errors about names that a project doesn't have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from model.core.tree import KinematicTree
from model.validation import messages
from model.validation.report import (
    Finding,
    JointReport,
    Severity,
    ValidationReport,
    worst_first,
)


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
    found = [(link, messages.PART_NAME.format(name=name)) for link, name in parts.items()]
    if category is not None:
        found.append((tree.root, messages.CATEGORY_NAME.format(name=category)))
    if not found:
        return report
    joints = {j.child: j for j in report.joints}
    for link, message in found:
        joint = tree.joint_of.get(link)
        before = joints.get(link, JointReport("" if joint is None else joint.name, link))
        finding = Finding("name", Severity.ERROR, message)
        joints[link] = replace(before, findings=worst_first((*before.findings, finding)))
    return replace(report, joints=tuple(sorted(joints.values(), key=lambda j: j.sort_key)))
