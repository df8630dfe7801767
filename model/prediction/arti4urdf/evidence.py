"""What is known about a joint that was decided: what the network says, what the rules say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.decoding import Answer, Made
from model.prediction.arti4urdf.structure import MECHANISMS, RANKS, SLOTS, Structure
from model.prediction.confidence import Evidence, log_odds
from model.prediction.geometric.context import PartContext
from model.prediction.geometric.evidence import part_evidence

Array = npt.NDArray[np.float64]


def evidence_of(
    structure: Structure,
    answer: Answer,
    part: int,
    rules: Array,
    same: npt.NDArray[np.bool_],
    parent: float,
) -> Evidence:
    """Evidence for one joint.

    Args:
        structure, answer: of the object. part: which one.
        rules: (P, SIZE) log-probabilities by geometry and names alone.
        same: (P, SLOTS, SLOTS) candidates that mean the same motion.
        parent: probability that it hangs where it was put.
    """
    decision = answer.decisions[part]
    out = {"parent": log_odds(parent)}
    for kind, chosen in (("type", decision.type), ("slot", decision.slot)):
        asked = answer.choices(part, kind)
        for who in ("network", "rules"):
            out[f"{kind} {who}"] = (
                log_odds(_share(asked[0], rules[part], chosen, same[part], who)) if asked else 6.0
            )
    slot = decision.slot
    found = MECHANISMS[slot // RANKS] if 0 <= slot < SLOTS else None
    context = structure.contexts[part]
    if context.parent != decision.parent:
        hung = list(structure.assembly.parent)
        hung[part] = decision.parent
        context = PartContext(replace(structure.assembly, parent=hung), part)
    return out | part_evidence(context, found)


def _share(asked: Made, rules: Array, chosen: int, same: npt.NDArray[np.bool_], who: str) -> float:
    """0..1: what one of the two experts alone gives to the answer."""
    values = asked.plain if who == "network" else np.where(np.isfinite(asked.plain), rules, -np.inf)
    weights = np.exp(values - values.max())
    weights /= weights.sum()
    if asked.kind == "type":
        return float(weights[v.TYPE_IDS[chosen]])
    slots = weights[v.SLOT_IDS]
    return float(weights[v.ID["<free>"]] if chosen >= len(slots) else (same @ slots)[chosen])
