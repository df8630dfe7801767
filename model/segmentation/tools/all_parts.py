"""*All parts*: a first guess of all parts, and what becomes of small components."""

from __future__ import annotations

import numpy as np

from model.core.progress import Progress, no_progress
from model.segmentation.arrays import Bool, Float, Float64, Int16, Int64
from model.segmentation.default import DefaultSession
from model.segmentation.encode.graph import components
from model.segmentation.finish.alternatives import overlaps
from model.segmentation.prompts import BASE, PartSegmentation
from model.segmentation.score.scorers import shipped_moving_scorers, shipped_scorers
from model.segmentation.solvers import solver_of
from model.segmentation.tools.element_masks import first_elements
from model.segmentation.tools.mask_votes import (
    collect_votes,
    compatible,
    exclusive_parts,
    shipped_part_scorer,
    vote_for_masks,
)

WORTH = -1.0
"""Log-odds below which a mask of an object is no part."""
_VOTES = 8
"""Masks that each superpoint votes for in a room."""
_TEMPERATURE = 2.0
_LEAST = 0.3
"""Expected overlap below which a mask is no part."""
_PRICE = 0.0045
"""Share of the voters that a part has to gain, so that not every detail is one."""
_SMALLER = 0.7
"""Largest ratio of size between a part and the one it lies on."""
_BODY = 0.6
"""Share of the room above which the largest part is the base."""


def propose_parts(
    session: DefaultSession, seeds: int = 160, progress: Progress = no_progress
) -> PartSegmentation:
    """A first guess of all parts, to start from.

    Superpoints vote for the masks that a first click on them may mean; see :mod:`.mask_votes`. Of
    an object, the best parts that exclude each other are proposed; of a room, its objects, see
    :func:`_room_objects`. The rest is the base.

    Args:
        seeds: superpoints that vote.
        progress: called after each of them.
    """
    superpoints = session.encoding.superpoints
    voters = spread(superpoints.center, seeds)
    scorer = shipped_part_scorer()
    if scorer is None or session.encoding.room is not None:
        chosen = _room_objects(session, voters, progress)
    else:
        solver = session.solver
        if solver.moving_parts is None:
            moving = shipped_moving_scorers()
            solver = solver_of(session.encoding, *shipped_scorers(), moving, with_fronts=True)
        # The part scorer learned from the votes of this first scorer.
        solver = solver.with_first(shipped_scorers()[0])
        voted = vote_for_masks(solver, voters, progress)
        rows = exclusive_parts(scorer(voted.features), voted.common, WORTH)
        chosen = sorted(voted.masks[rows], key=lambda m: -float(superpoints.size[m].sum()))
    of_superpoint = np.zeros(len(superpoints), np.int16)
    for part, mask in enumerate(chosen, start=BASE + 1):
        of_superpoint[mask] = part
    labels = session.finisher.without_prompts(of_superpoint)
    _, labels = np.unique(np.append(labels, BASE), return_inverse=True)  # some have merged
    return PartSegmentation(labels[:-1].astype(np.int16), "default")


def _room_objects(session: DefaultSession, voters: Int64, progress: Progress) -> list[Bool]:
    """(C,) masks, the largest first, on which most of the voters within them agree.

    Small ones may lie on large ones; other overlaps are refused. A mask of most of the room is left
    out.
    """
    size = session.encoding.superpoints.size
    votes = collect_votes(session.solver, voters, _VOTES, moving=False, progress=progress)
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
        free &= compatible(common, best, _SMALLER)[0]
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
