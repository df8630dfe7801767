"""Mask votes: which masks of an object are parts that move, before any click.

A click shows that there is a part; before any click most masks that look like one are ornament, a
panel or the body. Superpoints spread over the object vote for the masks that a first click on them
may mean, and each mask is judged once by all its votes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from model.core.files import static_assets
from model.core.progress import Progress, no_progress
from model.segmentation.arrays import Bool, Float, Int, Int64
from model.segmentation.describe.objects import MOVING_FEATURE_NAMES
from model.segmentation.finish.alternatives import overlaps
from model.segmentation.models.mlp import Mlp, load_mlp
from model.segmentation.solver import PartSolver

PART_SCORER = "part_masks.npz"
PART_FEATURE_NAMES = (
    *MOVING_FEATURE_NAMES, "score", "score_most", "behind", "behind_least", "said", "likely",
    "agreed", "agreed_most", "asked",
)  # fmt: skip
"""Means over a mask's voters, then :func:`_vote_features`; stored in the weights' file."""
_VOTES = 16
"""Masks that each voter votes for."""
_TEMPERATURE = 2.0
_APART = 0.1
"""Two parts share at most this of the smaller one,"""
_ON_IT, _SMALLER = 0.9, 0.25
"""or nearly all of the smaller one lies on the other, and all on that are a quarter of it."""
_ALIKE, _AS_GOOD = 0.7, 0.5
"""IoU of masks of one part, and how much less log-odds the most typical of them may have."""


@dataclass(frozen=True, eq=False)
class Votes:
    """The votes of some superpoints.

    Attributes:
        masks: (M, C) each mask once.
        voter, mask: (R,) voter and mask of each vote, the voters in order, each one's likeliest
            first. features: (R, F). scores: (R,).
    """

    masks: Bool
    voter: Int64
    mask: Int64
    features: Float
    scores: Float


@dataclass(frozen=True, eq=False)
class VotedMasks:
    """The masks of an object that got votes.

    Attributes:
        masks: (M, C). features: (M, F) in the order of ``PART_FEATURE_NAMES``.
        common: (M, M) nodes that every two have in common.
    """

    masks: Bool
    features: Float
    common: Float


@lru_cache(maxsize=1)
def shipped_part_scorer() -> Mlp | None:
    """The project's scorer, None if its file is absent."""
    path = static_assets() / "segmentation" / PART_SCORER
    return load_mlp(path, PART_FEATURE_NAMES) if path.is_file() else None


def collect_votes(
    solver: PartSolver,
    voters: Int,
    most: int,
    *,
    moving: bool = True,
    progress: Progress = no_progress,
) -> Votes:
    """The ``most`` likeliest masks of a first click on each of ``voters`` (A,).

    Args:
        moving: as in :meth:`.PartSolver.answer`.
        progress: called after each voter.
    """
    number: dict[bytes, int] = {}
    masks: list[Bool] = []
    voter, mask_of, features, scores = [], [], [], []
    for row, superpoint in enumerate(voters.tolist()):
        answer = solver.first_answer(superpoint, moving=moving)
        best = answer.order[:most]
        for mask in answer.proposals.masks[best]:
            key = np.packbits(mask).tobytes()
            if key not in number:
                number[key] = len(masks)
                masks.append(mask)
            mask_of.append(number[key])
        voter += [row] * len(best)
        features.append(answer.features[best])
        scores.append(answer.scores[best])
        progress((row + 1) / len(voters), "looking for parts")
    return Votes(
        np.stack(masks),
        np.array(voter),
        np.array(mask_of),
        np.concatenate(features),
        np.concatenate(scores),
    )


def vote_for_masks(solver: PartSolver, voters: Int, progress: Progress = no_progress) -> VotedMasks:
    """The masks that first clicks on ``voters`` may mean, described by their votes.

    Args:
        solver: with fronts, see :func:`.solver_of`.
        voters: (A,) superpoints.
        progress: called after each of them.
    """
    votes = collect_votes(solver, voters, _VOTES, progress=progress)
    summed = np.zeros((len(votes.masks), len(MOVING_FEATURE_NAMES)), np.float32)
    np.add.at(summed, votes.mask, votes.features)
    voted = np.zeros((len(voters), len(votes.masks)), bool)
    score = np.zeros(voted.shape)
    voted[votes.voter, votes.mask], score[votes.voter, votes.mask] = True, votes.scores
    common, overlap = overlaps(votes.masks, solver.superpoints.size)
    of_votes = _vote_features(voted, score, votes.masks[:, voters].T, overlap)
    features = np.concatenate([summed / voted.sum(0)[:, None], of_votes], 1)
    return VotedMasks(votes.masks, features, common)


def _vote_features(voted: Bool, score: Float, within: Bool, overlap: Float) -> Float:
    """(M, 9) features of the masks' votes.

    The mean and the highest score; the mean and least distance to each voter's best; of the voters
    within the mask the share that vote for it, the mean probability that their votes give it, the
    mean and highest overlap that they expect; the share of all voters within the mask.

    Args:
        voted: (A, M) which voters vote for which masks, with (A, M) ``score``.
        within: (A, M) which voters lie in which masks. overlap: (M, M) IoU of every two.
    """
    behind = score - score.max(1, where=voted, initial=-np.inf)[:, None]
    likely = np.where(voted, np.exp(behind / _TEMPERATURE), 0)
    likely /= likely.sum(1, keepdims=True)
    agreed = within * (likely @ overlap)
    votes, inside = voted.sum(0), np.maximum(within.sum(0), 1)
    columns = [
        score.sum(0) / votes,
        score.max(0, where=voted, initial=-np.inf),
        np.where(voted, behind, 0).sum(0) / votes,
        behind.max(0, where=voted, initial=-np.inf),
        votes / inside,
        likely.sum(0) / inside,
        agreed.sum(0) / inside,
        agreed.max(0),
        within.mean(0),
    ]
    return np.stack(columns, axis=1).astype(np.float32)


def compatible(common: Float, chosen: int, smaller: float) -> tuple[Bool, Bool]:
    """(M,) masks that may be parts beside a chosen one, and those of them that it lies on.

    Args:
        common: (M, M) nodes that every two have in common.
        smaller: largest ratio of size between a mask and the one it lies on.
    """
    area, shared = np.diagonal(common), common[chosen]
    own = area[chosen]
    apart = shared < _APART * np.minimum(own, area)
    on_it = (shared > _ON_IT * area) & (area < smaller * own)
    under_it = (shared > _ON_IT * own) & (own < smaller * area)
    fits = apart | on_it | under_it
    fits[chosen] = False
    return fits, under_it


def exclusive_parts(worth: Float, common: Float, least: float) -> list[int]:
    """Masks of the highest worth that exclude each other; small ones may lie on large ones.

    Args:
        worth: (M,) log-odds. common: (M, M) nodes that every two have in common.
        least: log-odds below which a mask is no part.
    """
    area = np.diagonal(common)
    overlap = common / np.maximum(area[:, None] + area[None] - common, 1e-9)
    likely = 1 / (1 + np.exp(-worth))
    free = worth >= least
    covered = np.zeros(len(worth))
    chosen: list[int] = []
    while free.any():
        best = int(np.where(free, worth, -np.inf).argmax())
        # Of many masks of one part, the one most like the others is the most exact.
        alike = free & (overlap[best] > _ALIKE) & (worth >= worth[best] - _AS_GOOD)
        rows = np.nonzero(alike)[0]
        best = int(rows[(overlap[np.ix_(rows, rows)] @ likely[rows]).argmax()])
        chosen.append(best)
        fits, under_it = compatible(common, best, _SMALLER)
        free &= fits
        # A mask that many parts lie on is the body.
        covered += np.where(under_it, area[best], 0)
        free &= covered < _SMALLER * area
    return chosen
