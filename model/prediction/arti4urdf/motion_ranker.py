"""The learned score of each part's candidates.

Boosted trees read what the network and the geometric rules think of a candidate, where its axis
lies in the part and how the part touches others. They were trained on our own procedural objects
and on another generator's (:mod:`model.training.arti4urdf.motions`). Accepted joints of a workspace
add to their log-probability; the answer's own motion stays unless another one is clearly likelier.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.core.files import static_assets
from model.core.joint import JOINT_KINDS
from model.prediction.arti4urdf import vocabulary as v
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
NOTHING: Mapping[int, Array] = {}
_FIXED = v.TYPES.index("fixed")
_TURNING = [v.REVOLUTE, v.CONTINUOUS, v.SCREW]


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
        evidence: Mapping[int, Array] = NOTHING,
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
