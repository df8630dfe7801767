"""Agreement of two annotations of one object.

Parts are matched by their surfaces (:mod:`model.evaluation.part_matching`), then joints are
compared as predictions are (:mod:`model.evaluation.joint_metrics`), the first annotation in the
place of the truth. It isn't the truth: only angles and IoU are the same both ways, and an origin's
distance is taken to the axis of the first.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject
from model.evaluation.joint_metrics import WORST_ANGLE, ObjectScore, UsableLimits, score_object
from model.evaluation.part_matching import match_parts, sampled_parts
from model.evaluation.predictions import renamed


@dataclass(frozen=True)
class Agreement:
    """Agreement of two annotations; figures are None where nothing could be compared.

    Attributes:
        part_iou: IoU of matched parts, mean over the parts of both; 1 is the same cut.
        type_agreement: share of moving joints of either that have the same type in both, 0..1.
        axis_angle: mean angle between the axis lines of one joint (rad).
        origin_distance: mean distance of axis lines over the object's diagonal; turning joints.
        range_iou: mean overlap of the ranges of joints of one type, 0..1.
        disagreement: 0 (the same) to 1: mean of what the figures above lack, an angle in shares
            of a right angle.
        what: human-readable differences beyond the tolerances of a usable joint.
    """

    part_iou: float
    type_agreement: float | None
    axis_angle: float | None
    origin_distance: float | None
    range_iou: float | None
    disagreement: float
    what: tuple[str, ...] = ()

    @property
    def agrees(self) -> bool:
        """True if there is no difference to review."""
        return not self.what


FIGURES = (
    "part_iou",
    "type_agreement",
    "axis_angle",
    "origin_distance",
    "range_iou",
    "disagreement",
)


def agreement(
    one: ArticulatedObject,
    other: ArticulatedObject,
    one_from_other: npt.NDArray[np.float64] | None = None,
) -> Agreement:
    """Compare two annotations of one object.

    Args:
        one: the first, or the ground truth.
        other: the second, in its own frame.
        one_from_other: (4, 4) similarity between the frames; None where they are the same.
    """
    if one_from_other is not None:
        other = other.moved(np.asarray(one_from_other, np.float64))
    matches = match_parts(sampled_parts(one.parts), sampled_parts(other.parts))
    tree = renamed(other.tree, {m.link: m.part for m in matches})
    score = score_object(
        one, tree, matches=matches, unmatched_parts=len(other.parts) - len(matches)
    )
    part_iou = 2 * sum(m.iou for m in matches) / max(len(one.parts) + len(other.parts), 1)
    moving = [*score.joints, *score.extra]
    same = sum(j.type_right for j in score.joints)
    types = same / len(moving) if moving else None
    axis = _mean(j.apd for j in score.joints)
    origin = _mean(j.opd_line for j in score.joints)
    ranges = _mean(j.range_iou for j in score.joints)
    lacking = (
        1 - part_iou,
        None if types is None else 1 - types,
        None if axis is None else axis / WORST_ANGLE,
        None if origin is None else min(origin, 1.0),
        None if ranges is None else 1 - ranges,
    )
    size = _mean(lacking) or 0.0
    return Agreement(part_iou, types, axis, origin, ranges, size, _differences(one, score))


def mean_figures(pairs: Sequence[Agreement]) -> dict[str, Any]:
    """Number of pairs and the mean of each figure over those that have it, rounded."""
    means = {f: _mean(getattr(p, f) for p in pairs) for f in FIGURES}
    return {"pairs": len(pairs)} | {
        f: None if value is None else round(value, 4) for f, value in means.items()
    }


def _differences(one: ArticulatedObject, score: ObjectScore) -> tuple[str, ...]:
    limits, names = UsableLimits(), {p.link: p.name or p.link for p in one.parts}
    out: list[str] = []
    if score.parts > score.matched:
        out.append(f"{score.parts - score.matched} of {score.parts} parts have no counterpart")
    for joint in score.joints:
        name = names.get(joint.child, joint.child)
        if not joint.present:
            out.append(f"{name} moves in the first only")
        elif not joint.type_right:
            out.append(f"{name}: {joint.true_type} or {joint.type}")
        elif joint.apd is not None and joint.apd > limits.axis:
            out.append(f"{name}: axes {math.degrees(joint.apd):.0f}° apart")
        elif joint.opd_line is not None and joint.opd_line > limits.origin:
            out.append(f"{name}: axes {100 * joint.opd_line:.0f} % of the diagonal apart")
        elif not joint.range_right:
            out.append(f"{name}: ranges overlap by {100 * (joint.range_iou or 0):.0f} %")
        elif not joint.parent_right:
            out.append(f"{name} hangs on another part")
    out += [f"{kind} joint in the second only" for _, kind in score.extra]
    return tuple(out)


def _mean(values: Iterable[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return sum(known) / len(known) if known else None
