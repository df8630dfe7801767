"""Labels: the true joints in terms of the structure prompt's candidates."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject
from model.core.joint import JOINT_KINDS, Joint
from model.evaluation.joint_metrics import UsableLimits, chain, interval_iou
from model.prediction.arti4urdf.structure import SLOTS, Structure
from model.prediction.arti4urdf.vocabulary import TYPES
from model.prediction.geometric.proposal import JointProposal

Array = npt.NDArray[np.float64]

GOOD_AXIS = 0.06
GOOD_LINE = 0.025
"""Largest errors of a correct candidate's axis (rad) and line (diagonals): half those of a usable
joint."""


@dataclass(frozen=True, eq=False)
class Labels:
    """The truth of one object, by part index.

    Attributes:
        parents: (P,), -1 for the root.
        types: (P,) index into ``TYPES``; "fixed" for the root.
        right: (P, SLOTS) candidates with a correct axis and line.
        offered: (P, SLOTS) those with correct limits of their own.
        limits: (P, 2) true limits (rad or diagonals) about the true axis.
        axis: (P, 3) true axis, working frame. line: (P, 3) point of its line nearest to the part's
            centre, relative to the centre; 0 for prismatic joints.
        same_sign: (P, SLOTS) the candidate's axis has the direction of the true one.
    """

    parents: npt.NDArray[np.int64]
    types: npt.NDArray[np.int64]
    right: npt.NDArray[np.bool_]
    offered: npt.NDArray[np.bool_]
    limits: npt.NDArray[np.float32]
    axis: npt.NDArray[np.float32]
    line: npt.NDArray[np.float32]
    same_sign: npt.NDArray[np.bool_]


def label(structure: Structure, truth: ArticulatedObject) -> Labels | None:
    """Labels of ``truth``; None if the vocabulary can't express its tree."""
    sampled = structure.sampled
    links = [s.link for s in sampled.shapes]
    index = {link: i for i, link in enumerate(links)}
    parts = frozenset(links)
    n = len(links)
    parents = np.full(n, -1, np.int64)
    types = np.full(n, TYPES.index("fixed"), np.int64)
    right, offered = np.zeros((n, SLOTS), bool), np.zeros((n, SLOTS), bool)
    same = np.ones((n, SLOTS), bool)
    limits, axes, lines = (np.zeros((n, k), np.float32) for k in (2, 3, 3))
    for i, link in enumerate(links):
        parent, joints = chain(truth.tree, link, parts)
        parents[i] = index.get(parent, -1)
        if parents[i] < 0 or not joints:
            continue
        kind = _kind(joints)
        if kind is None:
            return None
        types[i] = TYPES.index(kind)
        joint = next((j for j in joints if j.rotates), joints[0])
        axis = sampled.frame.object_from_working.T @ np.asarray(joint.axis)
        origin = sampled.frame.to_working(np.asarray(joint.origin)[None])[0]
        arm = origin - sampled.shapes[i].center
        arm = arm - axis * float(arm @ axis)
        limited = next((j for j in joints if j.limited), None)
        scale = sampled.frame.diagonal
        true_limits = _limits(limited, scale)
        axes[i], limits[i] = axis, true_limits
        lines[i] = arm if joint.rotates else 0.0
        for slot, h in enumerate(structure.slots[i]):
            if h is None or JOINT_KINDS[h.type].slides == joint.rotates:
                continue
            right[i, slot], same[i, slot] = _agrees(h, axis, origin, joint.rotates)
            if not right[i, slot]:
                continue
            if kind == "continuous":
                offered[i, slot] = True
                continue
            final = structure.candidate(i, slot)
            assert final is not None
            own = final.travel if kind == "screw" else (final.lower, final.upper)
            if own is None or (kind == "revolute" and h.type == "continuous"):
                continue
            aligned = float(final.axis @ axis) > 0
            offered[i, slot] = _limits_right(own, true_limits, aligned, kind == "revolute")
    if (parents < 0).sum() != 1:
        return None
    return Labels(parents, types, right, offered, limits, axes, lines, same)


def _kind(joints: tuple[Joint, ...]) -> str | None:
    if len(joints) == 1:
        return joints[0].type
    turning = [j for j in joints if j.rotates]
    if len(joints) == 2 and len(turning) == 1:
        a, b = (np.asarray(j.axis) for j in joints)
        if abs(float(a @ b)) > 0.99:
            return "screw"
    return None


def _limits(joint: Joint | None, diagonal: float) -> tuple[float, float]:
    if joint is None or joint.lower is None or joint.upper is None:
        return -math.pi, math.pi
    scale = 1.0 if joint.rotates else diagonal
    return joint.lower / scale, joint.upper / scale


def _agrees(h: JointProposal, axis: Array, origin: Array, rotates: bool) -> tuple[bool, bool]:
    along = float(h.axis @ axis)
    if abs(along) < math.cos(GOOD_AXIS):
        return False, along > 0
    if rotates:
        off = np.linalg.norm(np.cross(axis, h.origin - origin))
        if off > GOOD_LINE:
            return False, along > 0
    return True, along > 0


def _limits_right(
    own: tuple[float, float], true: tuple[float, float], aligned: bool, rotates: bool
) -> bool:
    low, high = own if aligned else (-own[1], -own[0])
    good = UsableLimits()
    near = good.angle if rotates else good.travel
    ends = max(abs(low - true[0]), abs(high - true[1]))
    return interval_iou((low, high), true) >= 0.6 or ends <= 0.7 * near
