"""The evidence of rules and words, as log-probabilities of the answer's words.

Geometry offers candidates. Its rules with the parts' words and the network's reading give each
joint type a log-probability, the highest sum is the answer; the candidates are scored by
:mod:`model.prediction.arti4urdf.motion_ranker`. Examples of accepted objects come after it, see
:mod:`model.prediction.lessons`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import softmax

from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.answer import proposal_of
from model.prediction.arti4urdf.decoding import Answer
from model.prediction.arti4urdf.structure import MECHANISMS, RANKS, SLOTS, Structure
from model.prediction.geometric.context import JointProposal
from model.prediction.geometric.roles import NAMED, mechanism_scores, named_mechanism
from model.prediction.lessons import Motion, along, same_steps

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

FLOOR = 0.002
"""Probability of words that the rules exclude."""
STAYS, WORTH = -3.0, -6.0
"""Log-likelihoods of a fixed joint where another one was chosen, and of what is worth a look."""


@dataclass(frozen=True)
class HybridSettings:
    """Influence of geometry, which also decides the tree.

    Attributes:
        weight: of geometry's log-probabilities of joint types and candidates.
        swept: log-odds in favour of a candidate's own limits, from rules and motion sweep.
    """

    weight: float = 5.0
    swept: float = 10.0


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
        comes_off = best.travel is not None or mechanism == v.TYPES[v.SCREW]
        kind = v.TYPES[v.SCREW] if comes_off else best.type
        types[v.TYPES.index(kind)] += mechanisms[k]
    out = np.zeros(v.SIZE)
    out[v.TYPE_IDS] = np.log(types / types.sum())
    out[v.SLOT_IDS] = np.log(np.maximum(slots, FLOOR / SLOTS))
    out[v.ID["<free>"]] = np.log(FLOOR)
    return out


def offered(
    structure: Structure, answer: Answer, part: int
) -> list[tuple[tuple[JointProposal, ...], float]]:
    """The motions of a part by geometry and network, the answer's first, with log-likelihoods."""
    decision = answer.decisions[part]
    own = steps_of(proposal_of(structure, part, decision))
    found: list[tuple[tuple[JointProposal, ...], float]] = [(own, 0.0)]
    if own:
        found.append(((), STAYS))
    if part not in answer.motions:
        return found
    slots, odds = answer.motions[part]
    likely = -np.logaddexp(0.0, -odds.astype(np.float64))
    there = np.flatnonzero(slots == decision.slot)
    best = float(likely[there[0]]) if len(there) else float(likely.max()) - STAYS
    for slot, value in zip(slots.tolist(), likely.tolist(), strict=True):
        proposal = structure.candidate(part, slot) if value - best > WORTH else None
        if proposal is not None:
            steps = steps_of(proposal)
            other = STAYS if len(steps) != len(own) else 0.0
            found.append((steps, min(0.0, value - best) + other))
    return found


def steps_of(proposal: JointProposal) -> tuple[JointProposal, ...]:
    """The joints of a proposal, working frame: none if it is fixed, two if it has a travel."""
    if proposal.type == "fixed":
        return ()
    if proposal.travel is None:
        return (proposal,)
    lower, upper = proposal.travel
    slide = replace(proposal, type="prismatic", lower=lower, upper=upper, travel=None)
    return slide, replace(proposal, travel=None)


def taught_steps(
    motion: Motion,
    given: Sequence[tuple[tuple[JointProposal, ...], float]],
    foreseen: bool,
) -> tuple[JointProposal, ...]:
    """A motion on the exact line that geometry offers for it, with the examples' ranges.

    Args:
        given: of :func:`offered`. foreseen: keep the ranges of the answer where
            the examples disagree.
    """
    for k, (steps, _) in enumerate(given):
        if same_steps(steps, motion.steps):
            if not motion.votes or (foreseen and k == 0 and not motion.agreed):
                return steps
            return tuple(
                replace(along(taught, own.axis), axis=own.axis, origin=own.origin)
                for own, taught in zip(steps, motion.steps, strict=True)
            )
    return motion.steps
