"""Corrections that turn a session's joints into the ground truth, by the app's commands."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from model.core.articulated_object import ArticulatedObject, SegmentedObject
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.evaluation.joint_metrics import (
    UsableLimits,
    axis_angle,
    chain,
    compare_ranges,
    path,
    point_to_line,
)
from model.prediction.geometric.roles import change_joint_type
from sessions.commands import SetJoint, SetRoot
from sessions.live import LiveSession

WHO = "scripted annotator"


class JointCorrector:
    """Corrects one property of a joint at a time: parent, type, axis, origin, direction, one limit.

    Attributes:
        commands: number of corrections so far.
        unreachable: differences that no command can correct, in words.
    """

    def __init__(self, live: LiveSession, truth: ArticulatedObject, limits: UsableLimits) -> None:
        self.live, self.truth, self.limits = live, truth, limits
        self.parts = frozenset(p.link for p in truth.parts)
        corners = np.concatenate([p.bounds for p in truth.parts])
        self.diagonal = float(np.linalg.norm(np.ptp(corners, axis=0))) or 1.0
        self.commands = 0
        self.unreachable: list[str] = []

    def correct(self) -> tuple[int, int]:
        """Correct every joint; return how many were wrong, and the number of commands."""
        wrong = 0
        root = self.truth.tree.root
        if root in self.parts and root in self.tree.links and self.tree.root != root:
            self._do(SetRoot(root))
        for part in (p for p in self.truth.tree.order if p in self.parts):
            before = self.commands
            if part not in self.tree.links:
                self.unreachable.append(f"{part} got no points from the clicks")
                continue
            self._correct_part(part)
            wrong += self.commands > before
        return wrong, self.commands

    @property
    def tree(self) -> KinematicTree:
        """The session's current tree."""
        tree = self.live.document.tree
        assert tree is not None
        return tree

    def _do(self, command: SetJoint | SetRoot) -> None:
        before = self.live.state
        if self.live.do(command, WHO) is not before:
            self.commands += 1

    def _change(self, child: str, **values: Any) -> None:
        self._do(SetJoint(replace(self.tree.joint_of[child], **values)))

    def _correct_part(self, part: str) -> None:
        above, true_chain = chain(self.truth.tree, part, self.parts)
        parent, found = path(self.tree, part, self.parts)
        if above and found and parent != above and above in self.tree.links:
            self._change(found[0].child, parent=above)
            found = path(self.tree, part, self.parts)[1]
        if not true_chain:
            for joint in found:
                if joint.moves:
                    self._change(joint.child, type="fixed", lower=None, upper=None)
            return
        if len(found) != len(true_chain):
            self.unreachable.append(
                f"{part} needs {len(true_chain)} joints in a row, and there are {len(found)}"
            )
            return
        for true, joint in zip(true_chain, found, strict=True):
            self._correct_joint(true, joint.child)

    def _correct_joint(self, true: Joint, child: str) -> None:
        if self.tree.joint_of[child].type != true.type:
            # As on the screen, geometry proposes the joint of that type.
            parts = SegmentedObject(self.truth.name, self.truth.parts, self.truth.category)
            self._do(SetJoint(change_joint_type(parts, self.tree, child, true.type)))
        if axis_angle(true.axis, self.tree.joint_of[child].axis) > self.limits.axis:
            self._change(child, axis=true.axis)
        origin = self.tree.joint_of[child].origin
        off = point_to_line(origin, true.origin, true.axis) / self.diagonal
        if true.rotates and off > self.limits.origin:
            self._change(child, origin=true.origin)
        if true.limited:
            self._correct_range(true, child)

    def _correct_range(self, true: Joint, child: str) -> None:
        def right(joint: Joint) -> bool:
            return compare_ranges(true, joint, self.limits, self.diagonal)[2]

        joint = self.tree.joint_of[child]
        if right(joint):
            return
        turned = replace(joint, axis=tuple(-v if v else 0.0 for v in joint.axis))
        wanted = true if np.dot(true.axis, joint.axis) > 0 else true.flipped()
        other = true if np.dot(true.axis, turned.axis) > 0 else true.flipped()
        if right(turned) or _nearer(other, turned, wanted, joint):
            self._do(SetJoint(turned))
            joint, wanted = turned, other
        assert wanted.lower is not None and wanted.upper is not None
        # One limit at a time, as on the screen; the lower one never exceeds the upper one.
        order = ("upper", "lower") if wanted.upper >= (joint.lower or 0.0) else ("lower", "upper")
        for side in order:
            if not right(self.tree.joint_of[child]):
                self._change(child, **{side: getattr(wanted, side)})


def _nearer(a: Joint, turned: Joint, b: Joint, joint: Joint) -> bool:
    """True if turning the joint corrects more limits than it costs commands."""

    def differing(true: Joint, found: Joint) -> int:
        ends = ((true.lower, found.lower), (true.upper, found.upper))
        return sum(abs((x or 0.0) - (y or 0.0)) > 1e-3 for x, y in ends)

    return differing(a, turned) + 1 < differing(b, joint)
