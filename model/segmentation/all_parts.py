"""*All parts*: a first guess of all parts by mask votes, and what becomes of small components.

A click shows that there is a part; before any click most masks that look like one are ornament, a
panel or the body. Superpoints spread over the object vote for the masks that a first click on them
may mean, and each mask is scored once by all its votes. Masks of accepted objects of the kind, of
which it is known whether they are parts, tell more: what lies where, and how large it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from model.core.files import static_assets
from model.core.progress import Progress, no_progress
from model.geometry.like_object import UprightBox
from model.segmentation.arrays import Bool, Float, Float64, Int, Int16, Int64
from model.segmentation.default import DefaultSession
from model.segmentation.graph import components
from model.segmentation.mask_tools import first_elements
from model.segmentation.models import Mlp, load_mlp
from model.segmentation.object_features import MOVING_FEATURE_NAMES
from model.segmentation.prompts import BASE
from model.segmentation.scores import shipped_moving_scorers, shipped_scorers
from model.segmentation.similar import (
    MaskExample,
    MaskTable,
    ProposedParts,
    by_examples,
    proposed,
    telling,
    within_counts,
)
from model.segmentation.solver import PartSolver, overlaps, solver_of

PART_SCORER = "part_masks.npz"
PART_FEATURE_NAMES = (
    *MOVING_FEATURE_NAMES,
    *"score score_most behind behind_least said likely agreed agreed_most asked".split(),
)
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
        progress((row + 1) / len(voters), "")
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


WORTH = -1.0
"""Log-odds below which a mask of an object is no part."""
_ROOM_VOTES = 8
"""Masks that each superpoint votes for in a room."""
_LEAST = 0.3
"""Expected overlap below which a mask is no part."""
_PRICE = 0.0045
"""Share of the voters that a part has to gain, so that not every detail is one."""
_ROOM_SMALLER = 0.7
"""Largest ratio of size between a part and the one it lies on."""
_BODY = 0.6
"""Share of the room above which the largest part is the base."""


_KNOWN = 200
"""Masks of an accepted object that are kept beside its parts, the likeliest first."""


def scored_masks(
    session: DefaultSession, seeds: int = 160, progress: Progress = no_progress
) -> tuple[VotedMasks, MaskTable] | None:
    """The masks that a first click may mean; None of a room.

    Args:
        seeds: superpoints that vote.
        progress: called after each of them.
    """
    encoding, scorer = session.encoding, shipped_part_scorer()
    if scorer is None or encoding.room is not None:
        return None
    solver = session.solver
    if solver.moving_parts is None:
        moving = shipped_moving_scorers()
        solver = solver_of(encoding, *shipped_scorers(), moving, with_fronts=True)
    # The part scorer learned from the votes of this first scorer.
    solver = solver.with_first(shipped_scorers()[0])
    voted = vote_for_masks(solver, spread(encoding.superpoints.center, seeds), progress)
    points = encoding.nodes.points.astype(float)
    box, of_node = UprightBox.around(points), encoding.superpoints.of_node
    own = (points - box.middle) @ box.turn
    lowest = np.full((len(encoding.superpoints), 3), np.inf)
    highest = -lowest
    np.minimum.at(lowest, of_node, own)
    np.maximum.at(highest, of_node, own)
    low = np.stack([lowest[mask].min(0) for mask in voted.masks])
    high = np.stack([highest[mask].max(0) for mask in voted.masks])
    place, half = (low + high) / 2 / box.sides, (high - low) / 2 / np.linalg.norm(box.sides)
    return voted, MaskTable(scorer(voted.features), place, half)


def mask_examples(
    session: DefaultSession, labels: Int, names: Sequence[str]
) -> tuple[MaskExample, ...]:
    """The likeliest masks of an object whose parts are known, and those that are its parts.

    Args:
        labels: (E,) the part of each element, 0 the base. names: of the parts, the base's too.
    """
    scored, superpoints = scored_masks(session), session.encoding.superpoints
    if scored is None:
        return ()
    masks, table = scored[0].masks, scored[1]
    held = np.zeros((len(superpoints), len(names)))
    np.add.at(held, (superpoints.of_node, labels[first_elements(session)]), 1)
    inside, whole = masks @ held, masks @ superpoints.size
    overlap = (inside / np.maximum(whole[:, None] + held.sum(0) - inside, 1e-9))[:, 1:]
    right = overlap.max(axis=1, initial=0) > _ALIKE
    kept = right.copy()
    kept[np.argsort(-table.worth, kind="stable")[:_KNOWN]] = True
    return tuple(
        MaskExample(
            round(float(table.worth[k]), 3),
            _rounded(table.place[k]),
            _rounded(table.half[k]),
            names[1 + int(overlap[k].argmax())] if right[k] else None,
        )
        for k in np.flatnonzero(kept)
    )


def _rounded(values: Float64) -> tuple[float, float, float]:
    x, y, z = (round(float(v), 4) for v in values)
    return x, y, z


def propose_parts(
    session: DefaultSession,
    seeds: int = 160,
    progress: Progress = no_progress,
    known: Sequence[MaskTable] = (),
) -> ProposedParts:
    """A first guess of all parts, to start from.

    Superpoints vote for the masks that a first click on them may mean. Of an object, the best parts
    that exclude each other are proposed; of a room, its objects. The rest is the base.

    Args:
        seeds: superpoints that vote.
        progress: called after each of them.
        known: masks of accepted objects of its kind; see :func:`.telling`.
    """
    superpoints = session.encoding.superpoints
    scored = scored_masks(session, seeds, progress)
    if scored is None:
        masks = _room_objects(session, spread(superpoints.center, seeds), progress)
        return proposed(session, masks, [""] * len(masks))
    voted, table = scored
    followed = telling(known)
    worth, names = by_examples(table, followed)
    rows = exclusive_parts(worth, voted.common, WORTH)
    if followed:
        rows = within_counts(rows, worth, names, followed)
    rows.sort(key=lambda row: -float(superpoints.size[voted.masks[row]].sum()))
    return proposed(session, voted.masks[rows], [names[row] for row in rows], len(followed))


def _room_objects(session: DefaultSession, voters: Int64, progress: Progress) -> list[Bool]:
    """(C,) masks, the largest first, on which most of the voters within them agree.

    Small ones may lie on large ones; other overlaps are refused. A mask of most of the room is left
    out.
    """
    size = session.encoding.superpoints.size
    votes = collect_votes(session.solver, voters, _ROOM_VOTES, moving=False, progress=progress)
    likely = np.zeros((len(voters), len(votes.masks)))
    first = np.flatnonzero(np.diff(votes.voter, prepend=-1))
    power = np.exp((votes.scores - votes.scores[first][votes.voter]) / _TEMPERATURE)
    likely[votes.voter, votes.mask] = power / np.add.reduceat(power, first)[votes.voter]
    masks = votes.masks
    common, overlap = overlaps(masks, size)
    chosen = [masks[i] for i in _tiling(masks[:, voters].T * (likely @ overlap), common)]
    chosen.sort(key=lambda m: -float(size[m].sum()))
    if chosen and size[chosen[0]].sum() > _BODY * size.sum():
        chosen = chosen[1:]
    return chosen


def _tiling(agreed: Float, common: Float) -> list[int]:
    """Masks on which the voters within them agree, greedily.

    Args:
        agreed: (A, M) overlap of each mask that each voter expects, 0 outside the mask.
        common: (M, M) nodes that every two masks have in common.
    """
    inside = agreed > 0
    quality = agreed.sum(0) / np.maximum(inside.sum(0), 1)
    free = quality > _LEAST
    now = np.zeros(len(agreed))
    chosen: list[int] = []
    while free.any():
        # Voters change over to the new mask, be it better for them or worse.
        gain = np.where(inside, agreed - now[:, None], 0).mean(0) - _PRICE
        gain = np.where(free, gain * quality**3, -1.0)
        best = int(gain.argmax())
        if gain[best] <= 0:
            break
        chosen.append(best)
        now = np.where(inside[:, best], agreed[:, best], now)
        free &= compatible(common, best, _ROOM_SMALLER)[0]
    return chosen


def spread(points: Float64, count: int) -> Int64:
    """(count,) indices by farthest-point sampling, from the first point on."""
    chosen = [0]
    far = np.linalg.norm(points - points[0], axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(far.argmax()))
        far = np.minimum(far, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


def absorb_small_components(session: DefaultSession, labels: Int16, largest: float = 0.01) -> Int16:
    """Give small components to the label that they touch most.

    Those are the components of one label with at most ``largest`` of all nodes, except the label's
    largest one, and all unassigned elements.
    """
    nodes, graph = session.encoding.nodes, session.encoding.graph
    of_node = np.asarray(labels)[first_elements(session)]
    same = (of_node[graph.a] == of_node[graph.b]) & ~graph.bridge
    number, component = components(len(nodes), graph.a[same], graph.b[same])
    size = np.bincount(component, minlength=number)
    label = np.zeros(number, np.int16)
    label[component] = of_node
    biggest = np.zeros(number, bool)
    for part in np.unique(label):
        own = np.nonzero(label == part)[0]
        biggest[own[size[own].argmax()]] = part >= 0
    small = ~biggest & ((size <= largest * len(nodes)) | (label < 0))
    a, b = component[graph.a], component[graph.b]
    for here, there in ((a, b), (b, a)):
        use = small[here] & ~small[there]
        key, count = np.unique(
            here[use].astype(np.int64) * 1024 + label[there[use]], return_counts=True
        )
        order = np.argsort(count, kind="stable")
        label[key[order] // 1024] = np.where(
            small[key[order] // 1024], key[order] % 1024, label[key[order] // 1024]
        )
    out = np.maximum(label[component], BASE).astype(np.int16)
    moved = nodes.elements.to_elements(out)
    unchanged = nodes.elements.to_elements((out != of_node).astype(np.int16)) == 0
    return np.where(unchanged & (np.asarray(labels) >= 0), labels, moved)
