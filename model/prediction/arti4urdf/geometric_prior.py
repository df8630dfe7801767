"""Probabilities of the answer's words from geometry and names alone."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import softmax

from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.structure import MECHANISMS, RANKS, SLOTS, Structure
from model.prediction.geometric.roles import NAMED, mechanism_scores, named_mechanism

Array = npt.NDArray[np.float64]

FLOOR = 0.002
"""Probability of words that the rules exclude."""


def geometric_prior(structure: Structure) -> Array:
    """(P, SIZE) log-probabilities of joint types and candidates; 0 for all other words."""
    known = {i: k for i, k in enumerate(structure.features) if k is not None}
    out = np.zeros((len(structure.sampled), v.SIZE))
    for i, context in enumerate(structure.contexts):
        if i not in known:
            continue
        named, fixed = named_mechanism(context), FLOOR
        scores = mechanism_scores(context, known[i], known)
        mechanisms = softmax(1.5 * np.array([scores.get(m, -2.0) for m in MECHANISMS]))
        if named is not None:  # a name may be wrong: what it leaves open is the shape's
            mechanisms *= 1 - NAMED
            if named == "fixed":
                fixed = NAMED
            else:
                mechanisms[MECHANISMS.index(named)] += NAMED
        out[i] = _word_odds(structure, i, mechanisms, fixed)
    return out


def _word_odds(structure: Structure, part: int, mechanisms: Array, fixed: float) -> Array:
    """(SIZE,) log-probabilities from those of the mechanisms."""
    slots, types = np.zeros(SLOTS), np.full(len(v.TYPES), FLOOR)
    types[v.TYPES.index("fixed")] = fixed
    for k, mechanism in enumerate(MECHANISMS):
        found = structure.slots[part][k * RANKS : (k + 1) * RANKS]
        scores = np.array([p.score for p in found if p is not None])
        if not len(scores):
            continue
        slots[k * RANKS : k * RANKS + len(scores)] = mechanisms[k] * softmax(2.0 * scores)
        best = found[0]
        assert best is not None
        kind = "screw" if best.travel is not None or mechanism == "screw" else best.type
        types[v.TYPES.index(kind)] += mechanisms[k]
    out = np.zeros(v.SIZE)
    out[v.TYPE_IDS] = np.log(types / types.sum())
    out[v.SLOT_IDS] = np.log(np.maximum(slots, FLOOR / SLOTS))
    out[v.ID["<free>"]] = np.log(FLOOR)
    return out
