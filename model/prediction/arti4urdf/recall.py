"""Lets the experience of a workspace overrule an answer of the small network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from model.core.joint import JOINT_KINDS, Joint
from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.decoding import Answer
from model.prediction.arti4urdf.grammar import Decision
from model.prediction.arti4urdf.motion_ranker import MARGIN, best_limits, with_candidate
from model.prediction.arti4urdf.structure import Structure
from model.prediction.experience import (
    MOST,
    Experience,
    Motions,
    Recalled,
    extent_along,
    in_part,
    part_name,
)

Array = npt.NDArray[np.float64]


def recall(
    experience: Experience,
    answer: Answer,
    structure: Structure,
    rules: Array,
    same: npt.NDArray[np.bool_],
    locked: frozenset[int] = frozenset(),
) -> tuple[Answer, dict[int, Recalled]]:
    """The answer with motions, types and parents that accepted objects of its category have.

    Args:
        rules: (P, SIZE) of the geometric prior. same: (P, SLOTS, SLOTS) equal motions.
        locked: parts that stay.

    Returns:
        The answer, and what is known about its parts.
    """
    sampled = structure.sampled
    parts = {i: _motions(structure, answer, i) for i in answer.motions if i not in locked}
    recalled = experience.recall(sampled.category, parts)
    decisions = list(answer.decisions)
    for i, known in recalled.items():
        decisions[i] = _moved(structure, answer, i, known, rules[i], same[i])
    names = [part_name(s.name) for s in sampled.shapes]
    for i, known in recalled.items():
        parent = known.agreed(known.parents)
        if parent is None:
            continue
        fitting = [k for k, name in enumerate(names) if name == parent and k != i]
        above = min(fitting, key=lambda k: sampled.gap[i, k]) if parent and fitting else None
        if not parent:
            above = answer.root
        if above is not None and not _below(decisions, above, i):
            decisions[i] = replace(decisions[i], parent=above)
    return replace(answer, decisions=tuple(decisions)), recalled


def _motions(structure: Structure, answer: Answer, part: int) -> Motions:
    slots, odds = answer.motions[part]
    found = [structure.slots[part][slot] for slot in slots.tolist()]
    lines = [in_part(structure.sampled, part, p.axis, p.origin) for p in found if p is not None]
    turns = np.array([p is not None and not JOINT_KINDS[p.type].slides for p in found])
    axes, arms = (np.array(side) for side in zip(*lines, strict=True))
    return Motions(structure.sampled.shapes[part].name, axes, arms, turns, odds.astype(np.float64))


def _moved(
    structure: Structure, answer: Answer, part: int, known: Recalled, rules: Array,
    same: npt.NDArray[np.bool_],
) -> Decision:  # fmt: skip
    """The decision about a part with the likeliest motion and the agreed type."""
    decision, (slots, _) = answer.decisions[part], answer.motions[part]
    agreed = known.agreed(known.types)
    if agreed == "fixed":
        return replace(decision, type=v.TYPES.index("fixed"), slot=-1, lower=-1, upper=-1)
    if v.TYPES[decision.type] == "fixed" and agreed is None:
        return decision
    among, own = same[np.ix_(slots, slots)], rules[v.SLOT_IDS][slots]
    best = int(np.argmax(known.total))
    present = np.flatnonzero(slots == decision.slot)
    # Where nothing speaks against the answer clearly, it stays.
    if not len(present) or known.total[best] - known.total[among[present[0]]].max() >= MARGIN:
        slot = int(slots[best_limits(best, own, among)])
        decision = with_candidate(structure, part, decision, slot)
    if agreed in ("revolute", "continuous") and v.TYPES[decision.type] in (
        "revolute",
        "continuous",
    ):
        decision = replace(decision, type=v.TYPES.index(agreed))
    return decision


def _below(decisions: Sequence[Decision], part: int, above: int) -> bool:
    """True if a part is ``above`` or one of its descendants."""
    seen: set[int] = set()
    while part >= 0 and part not in seen:
        if part == above:
            return True
        seen.add(part)
        part = decisions[part].parent
    return False


def with_known_range(
    joints: list[Joint], structure: Structure, part: int, known: Recalled
) -> list[Joint]:
    """The joint of a part with the limits on which accepted joints agree, if it has limits."""
    if len(joints) != 1 or not joints[0].limited:
        return joints
    [joint] = joints
    axis = structure.sampled.frame.object_from_working.T @ np.asarray(joint.axis)
    found = known.range_about(axis)
    if found is None:
        return joints
    scale = 1.0
    if not joint.rotates:
        scale = extent_along(structure.sampled, part, axis) * structure.sampled.frame.diagonal
    return [replace(joint, lower=found[0] * scale, upper=found[1] * scale)]


def follows(answer: Answer, part: int, known: Recalled) -> bool:
    """True if the decision about a part has the type and motion of most accepted joints."""
    decision = answer.decisions[part]
    if known.agreed(known.types) != v.TYPES[decision.type]:
        return False
    at = np.flatnonzero(answer.motions[part][0] == decision.slot)
    return decision.slot < 0 or bool(len(at) and known.agreeing[at[0]] >= MOST * known.objects)
