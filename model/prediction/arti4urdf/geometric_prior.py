"""What geometry and names alone would say, as probabilities of the answer's words."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.core.motion_lexicon import CATEGORY_MOTIONS
from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.structure import MECHANISMS, RANKS, SLOTS, Structure
from model.prediction.geometric.motion_scores import motion_scores
from model.prediction.geometric.roles import CATEGORY_BONUS, named_mechanism

Array = npt.NDArray[np.float64]

NAMED = 0.95
"""Probability of the mechanism that a part's name says."""
FLOOR = 0.002


def geometric_prior(structure: Structure) -> Array:
    """(P, SIZE) log-probabilities of joint types and of candidates; 0 for all other words."""
    scene = structure.scene
    known = {i: k for i, k in enumerate(structure.looks) if k is not None}
    out = np.zeros((len(scene), v.SIZE))
    for i, context in enumerate(structure.contexts):
        if i not in known:
            continue
        said = named_mechanism(context)
        if said is not None:
            mechanisms = np.full(len(MECHANISMS), (1 - NAMED) / len(MECHANISMS))
            fixed = NAMED if said == "fixed" else FLOOR
            if said != "fixed":
                mechanisms[MECHANISMS.index(said)] += NAMED
        else:
            scores = motion_scores(context, known[i], known)
            for usual in CATEGORY_MOTIONS.get(context.category, ()):
                scores[usual] = scores.get(usual, 0.0) + CATEGORY_BONUS
            values = np.array([scores.get(m, -2.0) for m in MECHANISMS])
            mechanisms = np.exp(1.5 * (values - values.max()))
            mechanisms, fixed = mechanisms / mechanisms.sum(), FLOOR
        out[i] = _words(structure, i, mechanisms, fixed)
    return out


def _words(structure: Structure, part: int, mechanisms: Array, fixed: float) -> Array:
    """(SIZE,) log-probabilities from those of the mechanisms."""
    slots, types = np.zeros(SLOTS), np.full(len(v.TYPES), FLOOR)
    types[v.TYPES.index("fixed")] = fixed
    for k, mechanism in enumerate(MECHANISMS):
        found = structure.slots[part][k * RANKS : (k + 1) * RANKS]
        scores = np.array([h.score for h in found if h is not None])
        if not len(scores):
            continue
        shares = np.exp(2.0 * (scores - scores.max()))
        slots[k * RANKS : k * RANKS + len(shares)] = mechanisms[k] * shares / shares.sum()
        best = found[0]
        assert best is not None
        kind = "screw" if best.travel is not None or mechanism == "screw" else best.type
        types[v.TYPES.index(kind)] += mechanisms[k]
    out = np.zeros(v.SIZE)
    out[v.TYPE_IDS] = np.log(types / types.sum())
    out[v.SLOT_IDS] = np.log(np.maximum(slots, FLOOR / SLOTS))
    out[v.ID["<free>"]] = np.log(FLOOR)
    return out
