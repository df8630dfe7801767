"""Joints of a prediction against the truth: the paper's figures and sounder ones beside them.

Everything is compared in the world frame, the object's rest frame (metres, radians, +z up). A part
is the same part in truth and prediction where the link names agree. A joint belongs to its child
part: the joints between a part and the next part above it are one chain (helper links lie inside
it), and chains are matched joint by joint, equal types first.

Sources: *ArtiWorld* (CVPR 2026) for TC, APD, OPD, ALD, DLD and usability; S2O (Iliash et al.,
2024) for the unsigned axis error and the point-to-line origin error over a diagonal. Choices that
the paper leaves open are made here, once:

* An axis and its opposite are one line, so APD is unsigned; which way a joint opens shows in the
  limits, which are compared after the predicted axis was turned to the true side.
* A prismatic joint's origin and a continuous joint's limits mean nothing and are not scored.
* A missing joint (a part that should move and doesn't, or the whole prediction) is no type match
  and not usable; the means exist with it, at the worst value, and without it. An extra joint (a
  part that shouldn't move) makes the object unusable and lowers type precision.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from model.kinematics.articulated_object import ArticulatedObject
from model.kinematics.joint import Joint
from model.kinematics.tree import KinematicTree

WORST_ANGLE = math.pi / 2
"""Axis error of a missing joint (rad): an unsigned angle can't be larger."""
WORST_DISTANCE = 1.0
"""Origin error of a missing joint, in diagonals."""


@dataclass(frozen=True)
class UsableLimits:
    """What still counts as right for :attr:`JointScore.usable`.

    Attributes:
        axis: largest angle between the axis lines (rad), 0.1 is 5.7 degrees.
        origin: largest point-to-line distance over the object's diagonal.
        range_iou: smallest overlap of the two ranges, intersection over union.
        angle: a revolute range is also right where both ends are this close (rad).
        travel: a prismatic range is also right where both ends are this close (diagonals):
            the travel of a button or a pot's lid is below it, so its range has no wrong overlap.
    """

    axis: float = 0.1
    origin: float = 0.05
    range_iou: float = 0.5
    angle: float = 0.35
    travel: float = 0.03


@dataclass(frozen=True)
class JointScore:
    """One true joint and what the prediction made of it.

    Attributes:
        child: the part that moves.
        true_type, type: joint types; ``type`` is "missing" where there is no joint.
        parent_right: the part above it is the true one.
        apd: angle between the axis lines in [0, pi/2] rad; None where the prediction has no axis.
        opd: distance of the two origins (m), the paper's OPD; rotating joints only.
        opd_line: distance of the predicted origin to the true axis line over the object's
            diagonal; rotating joints only.
        ald: mean error of the two limits (rad), revolute in both.
        dld: mean error of the two limits (m), prismatic in both.
        range_iou: overlap of the ranges, both limited and of one type.
        range_right, usable: see :class:`UsableLimits`.
    """

    child: str
    true_type: str
    type: str
    parent_right: bool
    apd: float | None = None
    opd: float | None = None
    opd_line: float | None = None
    ald: float | None = None
    dld: float | None = None
    range_iou: float | None = None
    range_right: bool = False
    usable: bool = False

    @property
    def type_right(self) -> bool:
        """Whether the joint type is the true one."""
        return self.type == self.true_type


@dataclass(frozen=True)
class ObjectScore:
    """One object.

    Attributes:
        joints: one entry for each true joint that moves.
        extra: parts that move in the prediction and not in truth, with the joint's type.
        tree_right: every part has its true parent, and the root is the true root.
        problem: why there is no prediction, or "".
    """

    object_id: str
    category: str | None
    joints: tuple[JointScore, ...]
    extra: tuple[tuple[str, str], ...] = ()
    tree_right: bool = False
    problem: str = ""

    @property
    def usable(self) -> bool:
        """Every joint usable, none missing, none extra (the paper's usability)."""
        return not self.problem and not self.extra and all(j.usable for j in self.joints)


def chain(tree: KinematicTree, part: str, parts: frozenset[str]) -> tuple[str, tuple[Joint, ...]]:
    """The moving joints between ``part`` and the part above it, and that part ("" at the root)."""
    joints: list[Joint] = []
    link = part
    while (joint := tree.joint_of.get(link)) is not None:
        if joint.moves:
            joints.append(joint)
        link = joint.parent
        if link in parts:
            return link, tuple(reversed(joints))
    return "", tuple(reversed(joints))


def score_object(
    truth: ArticulatedObject,
    predicted: KinematicTree | None,
    *,
    limits: UsableLimits | None = None,
    problem: str = "",
) -> ObjectScore:
    """Compare a predicted tree with the truth.

    Args:
        truth: the object in its rest frame.
        predicted: a tree over the same link names, in the same frame; None where there is none.
        limits: what counts as usable.
        problem: recorded where ``predicted`` is None.
    """
    limits = limits or UsableLimits()
    parts = frozenset(p.link for p in truth.parts)
    bounds = np.stack([p.bounds for p in truth.parts])
    diagonal = float(np.linalg.norm(bounds[:, 1].max(0) - bounds[:, 0].min(0))) or 1.0
    joints: list[JointScore] = []
    extra: list[tuple[str, str]] = []
    tree_right = predicted is not None
    for part in sorted(parts):
        true_parent, true_chain = chain(truth.tree, part, parts)
        if predicted is None or part not in predicted.links:
            parent, found = None, ()
            tree_right = False
        else:
            parent, found = chain(predicted, part, parts)
        right = parent == true_parent
        tree_right = tree_right and right
        rest = list(found)
        for joint in true_chain:
            best = next((j for j in rest if j.type == joint.type), None) or next(
                (j for j in rest if not _claimed_later(true_chain, joint, j)), None
            )
            if best is not None:
                rest.remove(best)
            joints.append(_score_joint(part, joint, best, right, diagonal, limits))
        extra += [(part, j.type) for j in rest]
    return ObjectScore(truth.name, truth.category, tuple(joints), tuple(extra), tree_right, problem)


def _claimed_later(true_chain: Sequence[Joint], current: Joint, candidate: Joint) -> bool:
    """Whether a later joint of the true chain has the candidate's type."""
    later = true_chain[list(true_chain).index(current) + 1 :]
    return any(j.type == candidate.type for j in later)


def _score_joint(
    part: str,
    true: Joint,
    found: Joint | None,
    parent_right: bool,
    diagonal: float,
    limits: UsableLimits,
) -> JointScore:
    if found is None:
        return JointScore(part, true.type, "missing", parent_right)
    apd = axis_angle(true.axis, found.axis)
    opd = opd_line = None
    if true.rotates and found.rotates:
        opd = float(np.linalg.norm(np.subtract(found.origin, true.origin)))
        opd_line = point_to_line(found.origin, true.origin, true.axis) / diagonal
    ald = dld = iou = None
    range_right = true.type == found.type
    if range_right and true.limited:
        if np.dot(true.axis, found.axis) < 0:
            found = found.flipped()
        a, b = (true.lower or 0.0, true.upper or 0.0), (found.lower or 0.0, found.upper or 0.0)
        ends = (abs(a[0] - b[0]), abs(a[1] - b[1]))
        iou = interval_iou(a, b)
        tolerance = limits.angle if true.rotates else limits.travel * diagonal
        range_right = iou >= limits.range_iou or max(ends) <= tolerance
        if true.rotates:
            ald = sum(ends) / 2
        else:
            dld = sum(ends) / 2
    usable = (
        true.type == found.type
        and parent_right
        and apd <= limits.axis
        and (opd_line is None or opd_line <= limits.origin)
        and range_right
    )
    return JointScore(
        part,
        true.type,
        found.type,
        parent_right,
        apd,
        opd,
        opd_line,
        ald,
        dld,
        iou,
        range_right,
        usable,
    )


def axis_angle(a: Sequence[float], b: Sequence[float]) -> float:
    """Angle between two axis lines in [0, pi/2] rad; signs don't matter, lengths neither.

    ``atan2`` of the cross and dot product: exact near 0, where ``arccos`` of a rounded dot product
    above 1 would give NaN.
    """
    cross = float(np.linalg.norm(np.cross(a, b)))
    return math.atan2(cross, abs(float(np.dot(a, b))))


def point_to_line(point: Sequence[float], origin: Sequence[float], axis: Sequence[float]) -> float:
    """Distance (m) of ``point`` to the line through ``origin`` along the unit ``axis``."""
    return float(np.linalg.norm(np.cross(axis, np.subtract(point, origin))))


def interval_iou(a: tuple[float, float], b: tuple[float, float]) -> float:
    """Intersection over union of two closed intervals; 1 for two equal points."""
    union = max(a[1], b[1]) - min(a[0], b[0])
    if union <= 1e-12:
        return 1.0
    return max(0.0, min(a[1], b[1]) - max(a[0], b[0])) / union


@dataclass(frozen=True)
class Summary:
    """Figures of many objects. Joint figures are means over joints, not over objects.

    Attributes:
        objects, joints: how many were scored.
        tc: share of true joints whose type is right (the paper's TC).
        type_precision: share of predicted moving joints with the right type.
        parent: share of true joints below the right part.
        tree: share of objects whose whole tree is right.
        apd: mean angle between axis lines (rad) over joints that have a prediction.
        apd_all: the same with missing joints at pi/2.
        opd: mean distance of origins (m), rotating joints; opd_line: point to line, in diagonals.
        opd_line_all: the same with missing joints, and joints that should rotate and don't, at 1.
        ald: mean limit error of revolute joints (rad); dld: of prismatic joints (m).
        usable: share of usable objects; usable_joints: share of usable joints.
        missing, extra: joints that are not there, and that should not be.
        failed: objects without a prediction.
    """

    objects: int
    joints: int
    tc: float
    type_precision: float
    parent: float
    tree: float
    apd: float
    apd_all: float
    opd: float
    opd_line: float
    opd_line_all: float
    ald: float
    dld: float
    usable: float
    usable_joints: float
    missing: int
    extra: int
    failed: int


def summarise(scores: Iterable[ObjectScore]) -> Summary:
    """Average over objects; NaN where nothing was there to average."""
    objects = list(scores)
    joints = [j for o in objects for j in o.joints]
    missing = sum(j.type == "missing" for j in joints)
    extra = sum(len(o.extra) for o in objects)
    right = sum(j.type_right for j in joints)
    turning = [j for j in joints if j.true_type in ("revolute", "continuous")]
    return Summary(
        objects=len(objects),
        joints=len(joints),
        tc=_mean([j.type_right for j in joints]),
        type_precision=right / max(1, len(joints) - missing + extra),
        parent=_mean([j.parent_right for j in joints]),
        tree=_mean([o.tree_right for o in objects]),
        apd=_mean([j.apd for j in joints]),
        apd_all=_mean([WORST_ANGLE if j.apd is None else j.apd for j in joints]),
        opd=_mean([j.opd for j in joints]),
        opd_line=_mean([j.opd_line for j in joints]),
        opd_line_all=_mean([WORST_DISTANCE if j.opd_line is None else j.opd_line for j in turning]),
        ald=_mean([j.ald for j in joints]),
        dld=_mean([j.dld for j in joints]),
        usable=_mean([o.usable for o in objects]),
        usable_joints=_mean([j.usable for j in joints]),
        missing=missing,
        extra=extra,
        failed=sum(bool(o.problem) for o in objects),
    )


def _mean(values: Iterable[float | bool | None]) -> float:
    kept = [float(v) for v in values if v is not None]
    return sum(kept) / len(kept) if kept else math.nan
