"""Which of the masks that an object's superpoints speak of are parts that move.

A click says that there is a part; before any click nothing does, and most of what looks like a
part is relief, a panel or the body. What tells them apart is seen best over all superpoints that speak of
a mask, so each mask is judged once, by what they say of it together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from model.core.progress import Progress, no_progress
from model.core.resources import static_assets
from model.segmentation.finish.alternatives import overlaps
from model.segmentation.propose.boxes import MOVING_FEATURE_NAMES, ObjectSolver
from model.segmentation.score.mlp import Mlp, load_mlp
from model.segmentation.solver import PartSolver

Bool = npt.NDArray[np.bool_]
Float = npt.NDArray[np.floating]

PART_SCORER = "part_masks.npz"
PART_FEATURE_NAMES = (
    *MOVING_FEATURE_NAMES,
    "score",
    "score_most",
    "behind",
    "behind_least",
    "said",
    "likely",
    "agreed",
    "agreed_most",
    "asked",
)
"""Means over the superpoints that speak of a mask; then what they make of it, see :func:`spoken_of`."""
_ANSWERS = 16
"""Masks that each asked superpoint speaks of."""
_TEMPERATURE = 2.0
_APART = 0.1
"""Two parts share at most this of the smaller one,"""
_ON_IT, _SMALLER = 0.9, 0.25
"""or nearly all of the smaller one lies on the other, which is four times as large as all on it."""
_ALIKE, _AS_GOOD = 0.7, 0.5
"""IoU of masks that stand for one part, and how much less worth the most usual of them may have."""


@dataclass(frozen=True, eq=False)
class Spoken:
    """Masks of an object.

    Attributes:
        masks: (M, C). features: (M, F) by which each is judged.
        common: (M, M) nodes that every two have in common.
    """

    masks: Bool
    features: Float
    common: Float


@dataclass(frozen=True, eq=False)
class Answers:
    """What asked superpoints speak of.

    Attributes:
        masks: (M, C) each once.
        by, of: (R,) the asked superpoint and the mask of each answer, the superpoints in order and the
            likeliest first. features: (R, F). scores: (R,).
    """

    masks: Bool
    by: npt.NDArray[np.int64]
    of: npt.NDArray[np.int64]
    features: Float
    scores: Float


@lru_cache(maxsize=1)
def shipped_part_scorer() -> Mlp | None:
    """The scorer that ships, None where it is not there."""
    path = static_assets() / "segmentation" / PART_SCORER
    return load_mlp(path, PART_FEATURE_NAMES) if path.is_file() else None


def spoken_of(
    solver: ObjectSolver, asked: npt.NDArray[np.integer], progress: Progress = no_progress
) -> Spoken:
    """The masks that a first click on each of some superpoints may mean, the likeliest of each.

    Features are, of the superpoints that speak of a mask, the means of the hypotheses' features and of
    their scores, the highest score, and how far the mask is behind the best of each superpoint; of the
    asked superpoints within it, the share that speak of it, and how likely it is for them; how much what
    they mean overlaps with it, on the whole and for the one that agrees most; and the share of all
    asked superpoints that are within.

    Args:
        solver: with lines on fronts, see :func:`.scorers.solver_of`.
        asked: (A,) superpoints.
        progress: told after each of them.
    """
    said = answers_of(solver, asked, _ANSWERS, progress=progress)
    summed = np.zeros((len(said.masks), len(MOVING_FEATURE_NAMES)), np.float32)
    np.add.at(summed, said.of, said.features)
    speaks = np.zeros((len(asked), len(said.masks)), bool)
    score = np.zeros(speaks.shape, np.float32)
    speaks[said.by, said.of], score[said.by, said.of] = True, said.scores
    common, overlap = overlaps(said.masks, solver.superpoints.size)
    meant = _meant(speaks, score, said.masks[:, asked].T, overlap)
    features = np.concatenate([summed / speaks.sum(0)[:, None], meant], 1)
    return Spoken(said.masks, features, common)


def answers_of(
    solver: PartSolver,
    asked: npt.NDArray[np.integer],
    most: int,
    *,
    of_a_part: bool = True,
    progress: Progress = no_progress,
) -> Answers:
    """What first clicks on some superpoints (A,) may mean, the ``most`` likeliest of each; ``of_a_part``
    as in :meth:`.PartSolver.answer`; ``progress`` is told after each superpoint.
    """
    number: dict[bytes, int] = {}
    masks: list[Bool] = []
    by, of, described, scores = [], [], [], []
    for row, superpoint in enumerate(asked.tolist()):
        answer = solver.first_answer(superpoint, of_a_part=of_a_part)
        best = np.argsort(-answer.scores, kind="stable")[:most]
        for mask in answer.candidates.masks[best]:
            key = np.packbits(mask).tobytes()
            if key not in number:
                number[key] = len(masks)
                masks.append(mask)
            of.append(number[key])
        by += [row] * len(best)
        described.append(answer.features[best])
        scores.append(answer.scores[best])
        progress((row + 1) / len(asked), "looking for parts")
    return Answers(
        np.stack(masks),
        np.array(by),
        np.array(of),
        np.concatenate(described),
        np.concatenate(scores),
    )


def _meant(speaks: Bool, score: Float, within: Bool, overlap: Float) -> Float:
    """(M, 9) the features beyond the hypotheses' own.

    Args:
        speaks: (A, M) whether a superpoint speaks of a mask. score: (A, M) where it does.
        within: (A, M) whether it lies in it.
        overlap: (M, M) IoU of every two masks.
    """
    behind = score - score.max(1, where=speaks, initial=-np.inf)[:, None]
    likely = np.where(speaks, np.exp(behind / _TEMPERATURE), 0)
    likely /= likely.sum(1, keepdims=True)
    agreed = within * (likely @ overlap)
    told, inside = speaks.sum(0), np.maximum(within.sum(0), 1)
    return np.stack(
        [
            score.sum(0) / told,
            score.max(0, where=speaks, initial=-np.inf),
            np.where(speaks, behind, 0).sum(0) / told,
            behind.max(0, where=speaks, initial=-np.inf),
            told / inside,
            likely.sum(0) / inside,
            agreed.sum(0) / inside,
            agreed.max(0),
            within.mean(0),
        ],
        axis=1,
    ).astype(np.float32)


def beside(common: Float, chosen: int, smaller: float) -> tuple[Bool, Bool]:
    """(M,) masks that may be parts beside a chosen one, and those of them that it lies on.

    Args:
        common: (M, M) how much every two masks have in common.
        smaller: share of the other that what lies on it may have.
    """
    area, shared = np.diagonal(common), common[chosen]
    own = area[chosen]
    apart = shared < _APART * np.minimum(own, area)
    on_it = (shared > _ON_IT * area) & (area < smaller * own)
    under_it = (shared > _ON_IT * own) & (own < smaller * area)
    fits = apart | on_it | under_it
    fits[chosen] = False
    return fits, under_it


def parts_apart(worth: Float, common: Float, least: float) -> list[int]:
    """Masks of the highest worth that exclude each other; small ones may sit on large ones.

    Args:
        worth: (M,). common: (M, M) how much every two masks have in common.
        least: worth below which a mask is nobody's part.
    """
    area = np.diagonal(common)
    overlap = common / np.maximum(area[:, None] + area[None] - common, 1e-9)
    likely = 1 / (1 + np.exp(-worth))
    free = worth >= least
    covered = np.zeros(len(worth))
    chosen: list[int] = []
    while free.any():
        best = int(np.where(free, worth, -np.inf).argmax())
        # Of many masks of one part, the one that most of the others are like is the most exact.
        alike = free & (overlap[best] > _ALIKE) & (worth >= worth[best] - _AS_GOOD)
        rows = np.nonzero(alike)[0]
        best = int(rows[(overlap[np.ix_(rows, rows)] @ likely[rows]).argmax()])
        chosen.append(best)
        shared, own = common[best], area[best]
        apart = shared < _APART * np.minimum(own, area)
        on_it = (shared > _ON_IT * area) & (area < _SMALLER * own)
        under_it = (shared > _ON_IT * own) & (own < _SMALLER * area)
        free &= apart | on_it | under_it
        # What many parts lie on is the body.
        covered += np.where(under_it, own, 0)
        free &= covered < _SMALLER * area
        free[best] = False
    return chosen
