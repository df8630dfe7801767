"""The choice among candidates: what rules, words and the network say, and a learned score.

Geometry offers candidates. Its rules with the parts' words and the network's reading give each
joint type a log-probability, the highest sum is the answer. Boosted trees then score the
candidates: they read what network and rules think of one, where its axis lies in the part and how
the part touches others, and were trained on our own procedural objects and on another generator's
(:mod:`model.training.arti4urdf.motions`). The answer's own motion stays unless another one is
clearly likelier. Examples of accepted objects come last, see :mod:`model.prediction.lessons`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
import numpy.typing as npt
from scipy.special import softmax

from model.core.files import static_assets
from model.core.joint import JOINT_KINDS
from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.answer import proposal_of
from model.prediction.arti4urdf.decoding import Answer
from model.prediction.arti4urdf.structure import (
    FEATURES,
    FIRST_NAME_SCALAR,
    MECHANISMS,
    RANKS,
    SIZES,
    SLOTS,
    VECTORS,
    Structure,
    StructureArrays,
)
from model.prediction.arti4urdf.vocabulary import Decision
from model.prediction.experience import part_name
from model.prediction.geometric.context import ACROSS, PARALLEL, JointProposal
from model.prediction.geometric.roles import NAMED, mechanism_scores, named_mechanism
from model.prediction.lessons import Motion, along, same_steps
from model.segmentation.models import Trees, load_trees

Array = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]
Bools = npt.NDArray[np.bool_]

SHIPPED = static_assets() / "arti4urdf" / "motions.npz"
MARGIN = 0.5
"""Least difference of log-probabilities that overrules; docs/research/predictor.md has others."""
LEAST = -12.0
"""Log-probability of what an expert excludes."""
_SCORES = SIZES + FEATURES
_VECTORS = ("outward", "exit", "contact", "handle", "normal")
_EXPERTS = ("network", "rules")
NAMES: tuple[str, ...] = (
    *"mechanism, rank, relative score, score, lower, upper, arm, turns, axis up".split(", "),
    *"axis z, along, across, slenderness, reach".split(", "),
    *(f"axis on {name}" for name in _VECTORS),
    *(f"arm on {name}" for name in _VECTORS),
    *"arm z, agreeing, named, named motion, mechanism score".split(", "),
    "mechanism score below best",
    *(f"scalar {k}" for k in range(_SCORES)),
    *"named fixed, unnamed".split(", "),
    *(f"{expert} {what}" for expert in _EXPERTS for what in ("slot", "motion", "kind", "fixed")),
)
"""Features of a candidate; lengths in diagonals of the object."""
_FIXED = v.TYPES.index("fixed")
_TURNING = [v.REVOLUTE, v.CONTINUOUS, v.SCREW]
FLOOR = 0.002
"""Probability of words that the rules exclude."""
STAYS, OTHER, WORTH = -3.0, -1.0, -6.0
"""Log-likelihoods of a fixed joint where another one was chosen, of any other motion at most, and
of what is worth a look."""


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


LIKELY, ACROSS_IT = 0.5, -8.0
"""Share by rules and words from which a part is a drawer or a knob, and the log-share of its
candidates that slide within the plane of its front, or turn about another axis than its panel's
normal."""


def motion_evidence(structure: Structure, rules: Array) -> dict[int, Array]:
    """Part → (SLOTS,) log-shares of its candidates for what drawers and knobs don't do. A badly cut
    drawer has the front of its siblings of the same name.

    Args:
        rules: (P, SIZE) of :func:`geometric_prior`.
    """
    out: dict[int, Array] = {}
    names = [(part_name(c.shape.name), c.parent) for c in structure.contexts]
    fronts = {
        n: c.front_normal
        for n, c in zip(names, structure.contexts, strict=True)
        if c.front_normal is not None
    }
    for i, context in enumerate(structure.contexts):
        shares = np.exp(rules[i][v.SLOT_IDS]).reshape(-1, RANKS).sum(1)
        for mechanism, normal, least in (
            ("slide_out", fronts.get(names[i]), ACROSS),
            ("spin", context.knob_normal, PARALLEL),
        ):
            if normal is None or shares[MECHANISMS.index(mechanism)] < LIKELY:
                continue
            there, slides = out.setdefault(i, np.zeros(SLOTS)), mechanism == "slide_out"
            for slot, p in enumerate(structure.slots[i]):
                if p is not None and JOINT_KINDS[p.type].slides == slides:
                    there[slot] += ACROSS_IT * (abs(float(p.axis @ normal)) < least)
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
    slots, likely = answer.motions[part]
    there = np.flatnonzero(slots == decision.slot)
    best = float(likely[there[0]]) if len(there) else float(likely.max()) - STAYS
    for slot, value in zip(slots.tolist(), likely.tolist(), strict=True):
        proposal = structure.candidate(part, slot) if value - best > WORTH else None
        if proposal is not None:
            steps = steps_of(proposal)
            other = STAYS if len(steps) != len(own) else 0.0
            found.append((steps, min(OTHER, value - best) + other))
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


def motion_features(
    arrays: StructureArrays, part: int, network: Array, rules: Array, same: Bools
) -> tuple[npt.NDArray[np.int64], Floats]:
    """The candidates of a part, and (K, len(NAMES)) their features.

    Args:
        arrays: the structure prompt.
        part: index of the part.
        network: (2, SIZE) log-odds of joint types and of candidates, -inf where excluded.
        rules: (SIZE,) log-probabilities from geometry and names.
        same: (SLOTS, SLOTS) candidates with the same motion.
    """
    scalars = arrays.candidate_scalars[part]
    slots = np.flatnonzero(scalars[:, 0] > 0)
    found, row = scalars[slots], arrays.scalars[part]
    axis, arm = np.moveaxis(arrays.candidate_vectors[part, slots].astype(np.float64), 1, 0)
    mechanism = slots // RANKS
    points = arrays.points[part].astype(np.float64)
    along = np.ptp(points @ axis.T, axis=0)
    offset = points[:, None] - (points @ axis.T)[..., None] * axis
    across = np.linalg.norm(offset - offset.mean(0), axis=-1).max(0)
    length = np.linalg.norm(arm, axis=1)
    toward = np.where(length[:, None] > 1e-3, arm / np.maximum(length, 1e-9)[:, None], 0.0)
    half = np.maximum(np.ptp(points @ toward.T, axis=0) / 2, 1e-4)
    reach = np.where(length > 1e-3, length / half, length)
    vectors = arrays.vectors[part].astype(np.float64)
    vectors /= np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)
    named = row[FIRST_NAME_SCALAR:][: len(MECHANISMS)]
    present = np.isin(np.arange(SLOTS), slots)
    score = row[_SCORES:][: len(MECHANISMS)]
    columns = [
        mechanism, slots % RANKS, *found[:, 1:].T,
        np.abs(axis[:, 2]), axis[:, 2], along, across, along / np.maximum(across, 1e-4), reach,
        *np.abs(vectors @ axis.T), *(vectors @ toward.T), toward[:, 2],
        same[slots].sum(1), named[mechanism],
        same[slots] @ (named[np.arange(SLOTS) // RANKS] * present),
        score[mechanism], score[mechanism] - score.max(),
    ]  # fmt: skip
    shared = [*row[:_SCORES], *row[FIRST_NAME_SCALAR + len(MECHANISMS) :]]
    experts = [_expert(t, s, found[:, -1] > 0, slots, same) for t, s in (network, (rules, rules))]
    features = np.concatenate(
        [np.stack(columns, 1), np.tile(shared, (len(slots), 1)), *experts], 1
    ).astype(np.float32)
    assert features.shape[1] == len(NAMES) and len(_VECTORS) == VECTORS
    return slots, features


def _expert(
    types: Array, words: Array, turns: Bools, slots: npt.NDArray[np.int64], same: Bools
) -> Array:
    """(K, 4) log-probabilities: of a candidate, its motion, its kind of joint, and of "fixed"."""
    kinds = _log_softmax(types[v.TYPE_IDS])
    own = _log_softmax(words[v.SLOT_IDS][slots])
    motion = np.log(np.maximum(same[np.ix_(slots, slots)] @ np.exp(own), 1e-6))
    turning = np.logaddexp.reduce(kinds[_TURNING])
    kind = np.where(turns, turning, kinds[v.PRISMATIC])
    return np.stack([own, motion, kind, np.full(len(slots), kinds[_FIXED])], 1)


def _log_softmax(values: Array) -> Array:
    if not np.isfinite(values).any():
        return np.full(len(values), LEAST)
    return np.maximum(values - np.logaddexp.reduce(values), LEAST)


@dataclass(frozen=True, eq=False)
class MotionRanker:
    """Overrules an answer's motions.

    Attributes:
        trees: log-odds that a candidate has the axis and the line of the true joint.
        margin: least difference of log-probabilities that overrules.
    """

    trees: Trees
    margin: float = MARGIN

    def __call__(
        self,
        answer: Answer,
        structure: Structure,
        arrays: StructureArrays,
        rules: Array,
        same: Bools,
        locked: frozenset[int] = frozenset(),
        evidence: Mapping[int, Array] = MappingProxyType({}),
    ) -> Answer:
        """The answer with the likeliest motion of each part that moves; locked parts stay.

        Args:
            evidence: part → (SLOTS,) log-shares that add to those of the trees.
        """
        decisions = list(answer.decisions)
        parts = [
            i
            for i, d in enumerate(decisions)
            if i not in locked and d.parent >= 0 and arrays.candidate_scalars[i, :, 0].any()
        ]
        read = [
            motion_features(arrays, i, network_odds(answer, i), rules[i], same[i]) for i in parts
        ]
        if not read:
            return answer
        odds = self.trees(np.concatenate([features for _, features in read]))
        ends = np.cumsum([len(slots) for slots, _ in read])[:-1]
        motions = {
            i: (slots, log_share(own) + (evidence[i][slots] if i in evidence else 0.0))
            for i, (slots, _), own in zip(parts, read, np.split(odds, ends), strict=True)
        }
        for i, (slots, own) in motions.items():
            if not 0 <= decisions[i].slot < SLOTS:
                continue
            present = int(np.flatnonzero(slots == decisions[i].slot)[0])
            among = same[i][np.ix_(slots, slots)]
            chosen = self.chosen(present, own, rules[i][v.SLOT_IDS][slots], among)
            if chosen != present:
                decisions[i] = with_candidate(structure, i, decisions[i], int(slots[chosen]))
        return replace(answer, decisions=tuple(decisions), motions=motions)

    def chosen(self, present: int, likely: Array, rules: Array, same: Bools) -> int:
        """Index of the candidate to take, of a part's K.

        Args:
            present: index of the answer's.
            likely: (K,) log-probabilities. rules: (K,) log-probabilities by the rules.
            same: (K, K) which have the same motion.
        """
        best = int(np.argmax(likely))
        if likely[best] - likely[same[present]].max() < self.margin:
            return present
        return best_limits(best, rules, same)


def log_share(odds: Floats) -> Array:
    """Log-probabilities of log-odds."""
    return -np.logaddexp(0.0, -odds.astype(np.float64))


def best_limits(candidate: int, rules: Array, same: Bools) -> int:
    """Index of the candidate with this motion whose limits the rules find likeliest."""
    return int(np.argmax(np.where(same[candidate], rules, -np.inf)))


def other_motions(
    answer: Answer, structure: Structure, part: int, rules: Array, same: Bools
) -> Iterator[Decision]:
    """The decision about a part with each of its candidates' motions, likeliest first.

    Args:
        rules: (SIZE,) log-probabilities from geometry and names.
        same: (SLOTS, SLOTS) candidates with the same motion.
    """
    if part not in answer.motions:
        return
    slots, odds = answer.motions[part]
    among, own = same[np.ix_(slots, slots)], rules[v.SLOT_IDS][slots]
    for k in np.argsort(-odds, kind="stable"):
        slot = int(slots[best_limits(int(k), own, among)])
        yield with_candidate(structure, part, answer.decisions[part], slot)


def network_odds(answer: Answer, part: int) -> Array:
    """(2, SIZE) log-odds of the network alone for joint types and candidates of a part."""
    out = np.full((2, v.SIZE), -np.inf)
    for row, kind in enumerate(("type", "slot")):
        record = answer.record(part, kind)
        if record is not None:
            out[row] = record.plain
    return out


def with_candidate(structure: Structure, part: int, decision: Decision, slot: int) -> Decision:
    """The decision with another candidate, its type and its limits."""
    found = structure.slots[part][slot]
    assert found is not None
    stays = decision.type == v.SCREW and not JOINT_KINDS[found.type].slides
    kind = v.TYPES[v.SCREW] if stays else found.type
    return replace(decision, slot=slot, type=v.TYPES.index(kind), lower=-1, upper=-1, numbers=[])


@lru_cache(maxsize=2)
def load_motion_ranker(path: Path = SHIPPED) -> MotionRanker:
    """The shipped ranker, or another file's.

    Raises:
        InputFileError: if the file is absent or damaged, or has other features.
    """
    return MotionRanker(load_trees(path, NAMES))
