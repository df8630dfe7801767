"""Reranking of likely candidates by their collision-free range."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.answer import proposal_of
from model.prediction.arti4urdf.decoding import Answer
from model.prediction.arti4urdf.grammar import FREE, Decision
from model.prediction.arti4urdf.structure import SLOTS, Structure
from model.prediction.geometric.proposal import JointProposal
from model.prediction.geometric.sweep import free_range

MAX_CANDIDATES = 3
MIN_SHARE = 0.1
"""Least probability of a candidate over that of the best one."""
FLOOR = 0.1
"""Least factor of a candidate without any collision-free range."""


def rerank_by_motion(
    answer: Answer, structure: Structure, same: npt.NDArray[np.bool_], weight: float
) -> Answer:
    """The answer with candidates by likelihood times the collision-free share of their range.

    Args:
        answer: as decoded. structure: of the object.
        same: (P, SLOTS, SLOTS) candidates with the same motion.
        weight: exponent of the collision-free share; 0 changes nothing.
    """
    decisions = list(answer.decisions)
    for part, decision in enumerate(decisions):
        record = answer.record(part, "slot")
        if record is None or decision.slot in (-1, FREE) or v.TYPES[decision.type] == "continuous":
            continue
        options = _options(record.words[v.SLOT_IDS], same[part], decision.slot)
        if len(options) < 2:
            continue
        tried = [_variant(decision, slot) for slot, _ in options]
        free = [
            free_share(structure, part, d.parent, proposal_of(structure, part, d)) for d in tried
        ]
        scores = [
            np.log(p) + weight * np.log(max(f, FLOOR))
            for (_, p), f in zip(options, free, strict=True)
        ]
        decisions[part] = tried[int(np.argmax(scores))]
    return replace(answer, decisions=tuple(decisions))


def _variant(decision: Decision, slot: int) -> Decision:
    """The decision with another candidate and that candidate's own limits."""
    if slot == decision.slot:
        return decision
    return replace(decision, slot=slot, lower=-1, upper=-1)


def _options(
    words: npt.NDArray[np.float64], same: npt.NDArray[np.bool_], chosen: int
) -> list[tuple[int, float]]:
    """Likely motions, the chosen one first: candidate, and probability of its motion."""
    shared = same @ words
    out, taken = [(chosen, max(float(shared[chosen]), 1e-9))], same[chosen].copy()
    for slot in np.argsort(-words):
        if len(out) == MAX_CANDIDATES or taken[slot] or shared[slot] < MIN_SHARE * out[0][1]:
            continue
        if words[slot] <= 0:
            break
        out.append((int(slot), float(shared[slot])))
        taken |= same[slot]
    assert len(taken) == SLOTS
    return out


def free_share(structure: Structure, part: int, parent: int, motion: JointProposal) -> float:
    """0..1: share of its range in which a part is free of its parent."""
    ends = [e for e in (motion.lower, motion.upper) if abs(e) > 1e-3]
    if not ends or parent < 0:
        return 1.0
    reached = [
        free_range(
            structure.sampled,
            part,
            (parent,),
            rotates=motion.type != "prismatic",
            axis=motion.axis,
            origin=motion.origin,
            stop=float(end),
        )
        for end in ends
    ]
    return float(sum(abs(r) for r in reached) / sum(abs(e) for e in ends))
