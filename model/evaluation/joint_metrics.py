"""Joints of a prediction against the truth: the paper's figures and sounder ones beside them.

Everything is compared in the world frame, the object's rest frame (metres, radians, +z up). The
prediction comes with the truth's link names: given, where the parts were given, else found by
geometry (:mod:`model.evaluation.part_matching`). A joint belongs to its child part: the joints
between a part and the next part above it are one chain (helper links lie inside it), and chains are
matched joint by joint, equal types first.

Sources: *ArtiWorld* (CVPR 2026) for TC, APD, OPD, ALD, DLD and usability; S2O (Iliash et al.,
2024) for the unsigned axis error, the point-to-line origin error over a diagonal, and what counts
as a hit. Choices that the paper leaves open are made here, once:

* An axis and its opposite are one line, so APD is unsigned (a knob may be turned either way); which
  way a joint opens shows in the limits, which are compared after the predicted axis was turned to
  the true side.
* A prismatic joint's origin and a continuous joint's limits mean nothing and are not scored.
* Where two parts are as large as each other (pliers, the panels of a carton), which of them is the
  base is a convention: a prediction with the other one is turned round first. The box of the
  predicted base needs :data:`EQUAL_BASE` of the true one's surface.
* A revolute joint that turns by :data:`FULL_TURN` or more and a continuous one are one type: nobody
  notices the stop of such a knob.
* Limits that were written in the wrong order are compared as written.
* A missing joint (a part that should move and doesn't, is not there, or the whole prediction) and
  one that couldn't be read are no type match and not usable; the means exist with them, at the
  worst value, and without. An extra joint (a part that shouldn't move) makes the object unusable
  and lowers precision.

An object is executable where validation (:mod:`model.validation`) finds no error: every joint over
its range, alone, together, and in an engine. Its findings become figures of an object: penetration,
parts that come off, jam or float, impossible limits, and in the simulator values that are no
numbers, explode, drift or stop short.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from model.core.articulated_object import ArticulatedObject
from model.core.joint import JOINT_KINDS, Joint
from model.core.pool import OutOfTimeError, time_limit
from model.core.tree import KinematicTree
from model.evaluation.part_matching import PartMatch
from model.validation.engines import MUJOCO
from model.validation.report import Severity, ValidationReport
from model.validation.runner import validate


def chain(tree: KinematicTree, part: str, parts: Collection[str]) -> tuple[str, tuple[Joint, ...]]:
    """The next of ``parts`` above ``part``, "" at the root, and the moving joints down from it."""
    above, joints = path(tree, part, parts)
    return above, tuple(j for j in joints if j.moves)


def path(tree: KinematicTree, part: str, parts: Collection[str]) -> tuple[str, tuple[Joint, ...]]:
    """The same with the fixed joints among them."""
    joints: list[Joint] = []
    link = part
    while (joint := tree.joint_of.get(link)) is not None:
        joints.append(joint)
        link = joint.parent
        if link in parts:
            return link, tuple(reversed(joints))
    return "", tuple(reversed(joints))


def parents(tree: KinematicTree, parts: Collection[str]) -> dict[str, str]:
    """Part → the next part above it, "" at the root; helper links are passed over."""
    return {p: path(tree, p, parts)[0] for p in parts if p in tree.links}


def tree_edits(truth: Mapping[str, str], predicted: Mapping[str, str], *, extra: int = 0) -> int:
    """Tree edit distance: fewest edits that make the predicted tree the true one, no unit.

    Nodes are known apart (they were matched by geometry), so the distance for labelled trees
    (Zhang and Shasha, 1989, with re-attaching as one edit) is a count: one for each part that
    has the wrong parent, is missing, or is extra. 0 is the true tree.

    Args:
        truth, predicted: part → parent, "" at the root.
        extra: predicted parts that match no true one.
    """
    wrong = sum(p in predicted and predicted[p] != above for p, above in truth.items())
    missing = sum(p not in predicted for p in truth)
    return wrong + missing + extra


MOST = 6
"""Findings that are listed of one object."""


@dataclass(frozen=True)
class Execution:
    """The result of one object.

    Attributes:
        executable: no errors, and the simulator ran.
        why: human-readable errors and warnings; "" where all joints move freely.
        kinds: kinds of the errors, see :data:`model.validation.report.Kind`.
        depth: deepest penetration over the object's diagonal.
        drift: largest share of a joint's range by which it moved while others were driven.
        missed: largest share of a range that a driven joint fell short of.
        joints, broken: number of moving joints, and of those with errors.
        engines: engine → whether the object is executable there; empty in reports before them.
    """

    executable: bool
    why: str
    kinds: tuple[str, ...] = ()
    depth: float = 0.0
    drift: float = 0.0
    missed: float = 0.0
    joints: int = 0
    broken: int = 0
    engines: Mapping[str, bool] = field(default_factory=dict)


def execute(
    obj: ArticulatedObject | None,
    *,
    seed: int = 0,
    timeout: float = 120.0,
    engines: Sequence[str] = (MUJOCO,),
    shapes: bool = False,
    store: Path | None = None,
) -> Execution:
    """Drive all joints of ``obj``; never raises but for a lack of memory.

    Args:
        obj: None where there is no prediction: not executable.
        seed: random seed of the combinations.
        timeout: seconds, after which the object counts as not executable.
        engines: names; the object is executable where it is so in all.
        shapes: whether its collision shapes take part. store: folder that keeps them.
    """
    nowhere = dict.fromkeys(engines, False)
    if obj is None:
        return Execution(False, "there is no prediction", engines=nowhere)
    try:
        with time_limit(timeout):
            report = validate(
                obj, seed=seed, shapes=shapes, store=store, fixes=False, engines=engines
            )
            return _execution(obj, report, engines)
    except OutOfTimeError as error:
        return Execution(False, f"driving its joints was {error}", engines=nowhere)
    except Exception as error:  # the boundary: any geometry may come here
        return Execution(False, f"{type(error).__name__}: {error}"[:300], engines=nowhere)


def _execution(
    obj: ArticulatedObject, report: ValidationReport, engines: Sequence[str]
) -> Execution:
    bad = report.joints_with(Severity.ERROR)
    said = [f"{v.child}: {v.message}" for v in report.joints if v.severity != Severity.OK]
    kinds = {f.kind for v in bad for f in v.findings if f.severity == Severity.ERROR}
    runs = [run for run in (report.physics, *report.others) if run is not None]
    ran = bool(runs) and all(run.ran for run in runs)
    if not ran and not bad:
        problems = [run.problem for run in runs if run.problem]
        said.insert(0, "; ".join(problems) or "the simulator didn't run")
    works = dict(zip(engines, map(report.executable_in, runs), strict=False))
    return Execution(
        executable=not bad and ran,
        why="; ".join(said[:MOST]) + ("; …" if len(said) > MOST else ""),
        kinds=tuple(sorted(kinds)),
        depth=max((v.depth for v in report.joints), default=0.0) / (report.diagonal or 1.0),
        drift=max((v for run in runs for v in run.drifted.values()), default=0.0),
        missed=max((v for run in runs for v in run.missed.values()), default=0.0),
        joints=sum(j.moves for j in obj.tree.joints),
        broken=len(bad),
        engines={**dict.fromkeys(engines, False), **works},
    )


ABSENT = ("missing", "unparseable")
"""Types of a missing joint, and of one that couldn't be read."""
WORST_ANGLE = math.pi / 2
"""Axis error of a missing joint (rad): an unsigned angle can't be larger."""
WORST_DISTANCE = 1.0
"""Origin error of a missing joint, in diagonals."""
EQUAL_BASE = 0.6
FULL_TURN = math.radians(300)


@dataclass(frozen=True)
class UsableLimits:
    """Tolerances of :attr:`JointScore.usable`.

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
    """Score of one true joint.

    Attributes:
        child: the part that moves.
        true_type, type: joint types; ``type`` is one of :data:`ABSENT` where there is no joint.
        parent_right: the part above it is the true one.
        apd: angle between the axis lines in [0, pi/2] rad; None where the prediction has no axis.
        opd: distance of the two origins (m), the paper's OPD; rotating joints only.
        opd_line: distance of the predicted origin to the true axis line over the object's
            diagonal; rotating joints only.
        opd_part: the same over the moving part's diagonal (S2O).
        ald: mean error of the two limits (rad), revolute in both.
        dld: mean error of the two limits (m), prismatic in both.
        still: mean error of the two limits if the joint didn't move (rad or m), which a missing
            joint counts with. None for continuous joints.
        range_iou: overlap of the ranges, both limited and of one type.
        range_right, usable: see :class:`UsableLimits`.
        full_turn: one is continuous and the other turns by :data:`FULL_TURN` or more.
        confidence: the predictor's, 0..1, or None.
    """

    child: str
    true_type: str
    type: str
    parent_right: bool
    apd: float | None = None
    opd: float | None = None
    opd_line: float | None = None
    opd_part: float | None = None
    ald: float | None = None
    dld: float | None = None
    still: float | None = None
    range_iou: float | None = None
    range_right: bool = False
    usable: bool = False
    confidence: float | None = None
    full_turn: bool = False

    @property
    def type_right(self) -> bool:
        """True if the joint type is the true one, or as good."""
        return self.type == self.true_type or self.full_turn

    @property
    def present(self) -> bool:
        """True if there is a joint to compare."""
        return self.type not in ABSENT

    @property
    def rotates(self) -> bool:
        """True if the true joint turns."""
        return JOINT_KINDS[self.true_type].rotates


@dataclass(frozen=True)
class ObjectScore:
    """One object.

    Attributes:
        joints: one entry for each true joint that moves.
        extra: predicted moving joints without a true joint: child and type.
        tree_right: every part has its true parent, and the root is the true root.
        problem: why there is no prediction, or "".
        diagonal: of the true object (m).
        tree_edits: see :func:`model.evaluation.joint_metrics.tree_edits`.
        part_iou: mean over the true parts, 0 for unmatched ones; None where parts were given.
        parts, matched: number of true parts, and of those that were found.
        note: human-readable remarks on reading the prediction.
        execution: result of driving the joints, or None.
    """

    object_id: str
    category: str | None
    joints: tuple[JointScore, ...]
    extra: tuple[tuple[str, str], ...] = ()
    tree_right: bool = False
    problem: str = ""
    diagonal: float = 1.0
    tree_edits: int = 0
    part_iou: float | None = None
    parts: int = 0
    matched: int = 0
    note: str = ""
    execution: Execution | None = None

    @property
    def usable(self) -> bool:
        """Every joint usable, none missing, none extra (the paper's usability)."""
        return not self.problem and not self.extra and all(j.usable for j in self.joints)


def score_object(
    truth: ArticulatedObject,
    predicted: KinematicTree | None,
    *,
    limits: UsableLimits | None = None,
    problem: str = "",
    matches: Sequence[PartMatch] | None = None,
    faulty: Collection[str] = (),
    swapped: Collection[str] = (),
    confidence: Mapping[str, float] | None = None,
    unmatched_parts: int = 0,
) -> ObjectScore:
    """Compare a predicted tree with the truth.

    Args:
        truth: the object in its rest frame.
        predicted: a tree with the truth's link names, in the same frame, or None.
        limits: tolerances.
        problem: recorded where ``predicted`` is None.
        matches: parts matched by geometry; None where the parts were given.
        faulty: names of joints that couldn't be read.
        swapped: names of joints whose limits were written in the wrong order.
        confidence: child → 0..1.
        unmatched_parts: number of predicted parts without a true part.
    """
    limits = limits or UsableLimits()
    parts = frozenset(p.link for p in truth.parts)
    above = parents(truth.tree, parts)
    if predicted is not None and _equal_base(truth, predicted):
        predicted = predicted.rerooted(truth.tree.root)
    below = {} if predicted is None else parents(predicted, parts)
    diagonal = _diagonal(truth, parts)
    joints: list[JointScore] = []
    used: set[str] = set()
    for part in sorted(parts):
        true_chain = chain(truth.tree, part, parts)[1]
        found = () if part not in below else path(predicted, part, parts)[1]  # type: ignore[arg-type]
        absent = "unparseable" if any(j.name in faulty for j in found) else "missing"
        scorer = _PartScorer(
            part, below.get(part) == above[part], diagonal, _diagonal(truth, {part}), limits
        )
        for joint, best in _paired(true_chain, [j for j in found if j.moves]):
            if best is None:
                joints.append(scorer.missing(joint, absent))
                continue
            used.add(best.name)
            own = (confidence or {}).get(part)
            joints.append(scorer.score(joint, best, best.name in swapped, own))
    moving = () if predicted is None else [j for j in predicted.joints if j.moves]
    ious = None if matches is None else sum(m.iou for m in matches) / max(1, len(parts))
    return ObjectScore(
        object_id=truth.name,
        category=truth.category,
        joints=tuple(joints),
        extra=tuple((j.child, j.type) for j in moving if j.name not in used),
        tree_right=predicted is not None and below == above and not unmatched_parts,
        problem=problem,
        diagonal=diagonal,
        tree_edits=tree_edits(above, below, extra=unmatched_parts),
        part_iou=ious,
        parts=len(parts),
        matched=len(below),
    )


def _equal_base(truth: ArticulatedObject, predicted: KinematicTree) -> bool:
    """True if the predicted base isn't the true one, but could be it as well."""
    sides = {p.link: np.ptp(p.bounds, axis=0) for p in truth.parts}
    bases = (predicted.root, truth.tree.root)
    if bases[0] == bases[1] or not {*bases} <= sides.keys() & {*predicted.links}:
        return False
    mine, own = (float(sides[base] @ np.roll(sides[base], 1)) for base in bases)
    return mine >= EQUAL_BASE * own


def _diagonal(truth: ArticulatedObject, links: Collection[str]) -> float:
    bounds = np.stack([p.bounds for p in truth.parts if p.link in links])
    return float(np.linalg.norm(bounds[:, 1].max(0) - bounds[:, 0].min(0))) or 1.0


def _paired(
    true_chain: Sequence[Joint], found: Sequence[Joint]
) -> Iterator[tuple[Joint, Joint | None]]:
    """True joints with the predicted one of their type, else of a type that no later one has."""
    rest = list(found)
    for k, joint in enumerate(true_chain):
        later = {j.type for j in true_chain[k + 1 :]}
        same = next((j for j in rest if j.type == joint.type), None)
        best = same or next((j for j in rest if j.type not in later), None)
        if best is not None:
            rest.remove(best)
        yield joint, best


@dataclass(frozen=True)
class _PartScorer:
    """Scores the joints of one part."""

    part: str
    parent_right: bool
    diagonal: float
    part_diagonal: float
    limits: UsableLimits

    def missing(self, true: Joint, absent: str) -> JointScore:
        return JointScore(self.part, true.type, absent, self.parent_right, still=_still(true))

    def score(
        self, true: Joint, found: Joint, swapped: bool, confidence: float | None
    ) -> JointScore:
        limits = self.limits
        apd = axis_angle(true.axis, found.axis)
        opd = line = None
        if true.rotates and found.rotates:
            opd = float(np.linalg.norm(np.subtract(found.origin, true.origin)))
            line = point_to_line(found.origin, true.origin, true.axis)
        error = iou = None
        full_turn = _full_turn(true, found)
        same = true.type == found.type or full_turn
        range_right = same
        if true.type == found.type and true.limited:
            error, iou, range_right = compare_ranges(
                true, found, limits, self.diagonal, swapped=swapped
            )
        usable = (
            same
            and self.parent_right
            and apd <= limits.axis
            and (line is None or line / self.diagonal <= limits.origin)
            and range_right
        )
        return JointScore(
            child=self.part,
            true_type=true.type,
            type=found.type,
            parent_right=self.parent_right,
            apd=apd,
            opd=opd,
            opd_line=None if line is None else line / self.diagonal,
            opd_part=None if line is None else line / self.part_diagonal,
            ald=error if true.rotates else None,
            dld=None if true.rotates else error,
            still=_still(true),
            range_iou=iou,
            range_right=range_right,
            usable=usable,
            confidence=confidence,
            full_turn=full_turn,
        )


def _full_turn(true: Joint, found: Joint) -> bool:
    if {true.type, found.type} != {"revolute", "continuous"}:
        return False
    lower, upper = (true if true.limited else found).motion_range
    return upper - lower >= FULL_TURN


def compare_ranges(
    true: Joint, found: Joint, limits: UsableLimits, diagonal: float, *, swapped: bool = False
) -> tuple[float, float, bool]:
    """Two limited joints of one type: mean error of the limits (rad or m), IoU, and whether right.

    Args:
        swapped: the found limits were written in the wrong order; they are compared as written.
    """
    if np.dot(true.axis, found.axis) < 0:
        found = found.flipped()
    a, b = (true.lower or 0.0, true.upper or 0.0), (found.lower or 0.0, found.upper or 0.0)
    if swapped:
        b = (b[1], b[0])
    ends = (abs(a[0] - b[0]), abs(a[1] - b[1]))
    iou = 0.0 if swapped else interval_iou(a, b)
    tolerance = limits.angle if true.rotates else limits.travel * diagonal
    right = iou >= limits.range_iou or max(ends) <= tolerance
    return sum(ends) / 2, iou, right and not swapped


def _still(true: Joint) -> float | None:
    if not true.limited:
        return None
    return (abs(true.lower or 0.0) + abs(true.upper or 0.0)) / 2


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
