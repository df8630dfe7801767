"""Evidence for the confidence of a joint that Arti4URDF decided: from the network and the rules."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.special import softmax

from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.decoding import Answer, ChoiceRecord
from model.prediction.arti4urdf.structure import MECHANISMS, RANKS, SLOTS, Structure
from model.prediction.confidence import MAX_LOG_ODDS, Evidence, log_odds
from model.prediction.geometric.context import PartContext
from model.prediction.geometric.evidence import part_evidence

Array = npt.NDArray[np.float64]


def joint_evidence(
    structure: Structure, answer: Answer, part: int, rules: Array, same: npt.NDArray[np.bool_]
) -> Evidence:
    """Evidence for the joint of one part.

    Args:
        structure, answer: of the object. part: its index.
        rules: (P, SIZE) log-probabilities from geometry and names alone.
        same: (P, SLOTS, SLOTS) candidates with the same motion.
    """
    decision = answer.decisions[part]
    out = {"parent": log_odds(_parent_probability(answer, part))}
    for kind, chosen in (("type", decision.type), ("slot", decision.slot)):
        record = answer.record(part, kind)
        for expert in ("network", "rules"):
            out[f"{kind} {expert}"] = MAX_LOG_ODDS
            if record is not None:
                share = _share(record, rules[part], chosen, same[part], expert)
                out[f"{kind} {expert}"] = log_odds(share)
    slot = decision.slot
    mechanism = MECHANISMS[slot // RANKS] if 0 <= slot < SLOTS else None
    context = structure.contexts[part]
    if context.parent != decision.parent:
        parent = list(structure.assembly.parent)
        parent[part] = decision.parent
        context = PartContext(replace(structure.assembly, parent=parent), part)
    return out | part_evidence(context, mechanism)


def _parent_probability(answer: Answer, part: int) -> float:
    """Probability of a part's parent, or of the root."""
    if part == answer.root:
        record = answer.record(-1, "root")
        return record.probability if record is not None else 1.0
    parent = answer.decisions[part].parent
    found = 1.0
    for r in answer.records:
        if r.kind == "child" and r.part == parent and r.pointed == part:
            siblings = [k for k, d in enumerate(answer.decisions) if d.parent == parent]
            found = min(found, float(r.parts[siblings].sum()))
    return found


def _share(
    record: ChoiceRecord, rules: Array, chosen: int, same: npt.NDArray[np.bool_], expert: str
) -> float:
    """Probability, 0..1, that one of the two experts alone gives to the answer."""
    values = record.plain
    if expert == "rules":
        values = np.where(np.isfinite(record.plain), rules, -np.inf)
    weights = softmax(values)
    if record.kind == "type":
        return float(weights[v.TYPE_IDS[chosen]])
    slots = weights[v.SLOT_IDS]
    return float(weights[v.ID["<free>"]] if chosen >= len(slots) else (same @ slots)[chosen])
