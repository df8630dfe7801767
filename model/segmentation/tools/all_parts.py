"""A first guess of all parts, and what becomes of the crumbs."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.core.progress import Progress, no_progress
from model.segmentation.default import DefaultSession
from model.segmentation.encode.graph import components
from model.segmentation.finish.alternatives import overlaps
from model.segmentation.prompts import BASE, PartSegmentation
from model.segmentation.propose.boxes import ObjectSolver
from model.segmentation.score.scorers import shipped_moving_scorers, shipped_scorers, solver_of
from model.segmentation.tools.element_masks import first_elements
from model.segmentation.tools.mask_votes import (
    answers_of,
    beside,
    parts_apart,
    shipped_part_scorer,
    spoken_of,
)

Bool = npt.NDArray[np.bool_]
Float = npt.NDArray[np.floating]

WORTH = -1.0
"""Log-odds below which a mask of an object is nobody's part."""

_ANSWERS = 8
"""Masks that each asked superpoint may mean, in a room."""
_TEMPERATURE = 2.0
_LEAST = 0.3
"""Expected overlap below which a mask is nobody's part."""
_PRICE = 0.0045
"""Share of the asked superpoints that a part has to be worth, so that not every detail is one."""
_SMALLER = 0.7
"""A part on another one is at most as large as this share of it."""
_BODY = 0.6
"""Share of the object above which the largest part is the base."""


def propose(
    session: DefaultSession, seeds: int = 160, progress: Progress = no_progress
) -> PartSegmentation:
    """A first guess of all parts, to start from.

    Each of many spread superpoints says what a first click on it might mean. Of an object a network
    judges which of these masks are parts that move (:mod:`.part_masks`), and the best of those that
    exclude each other are proposed. In a room the objects are wanted, and what they mean as well:
    see :func:`_agreed`. What no mask takes is the base.

    Args:
        seeds: superpoints asked.
        progress: told after each of them.
    """
    superpoints = session.encoding.superpoints
    asked = spread(superpoints.center, seeds)
    scorer = shipped_part_scorer()
    if scorer is None or session.encoding.room is not None:
        chosen = _agreed(session, asked, progress)
    else:
        solver = session.solver
        if not isinstance(solver, ObjectSolver) or solver.fronts is None:
            solver = solver_of(
                session.encoding, *shipped_scorers(), shipped_moving_scorers(), lined=True
            )
        # The part scorer learned from what this one says.
        solver = solver.with_first(shipped_scorers()[0])
        assert isinstance(solver, ObjectSolver)
        spoken = spoken_of(solver, asked, progress)
        rows = parts_apart(scorer(spoken.features), spoken.common, WORTH)
        chosen = sorted(spoken.masks[rows], key=lambda m: -float(superpoints.size[m].sum()))
    of_superpoint = np.zeros(len(superpoints), np.int16)
    for part, mask in enumerate(chosen, start=BASE + 1):
        of_superpoint[mask] = part
    labels = session.without_prompts(of_superpoint)
    _, labels = np.unique(np.append(labels, BASE), return_inverse=True)  # some have merged
    return PartSegmentation(labels[:-1].astype(np.int16), "default")


def _agreed(
    session: DefaultSession, asked: npt.NDArray[np.int64], progress: Progress
) -> list[Bool]:
    """(C,) masks, the largest first, of the highest expected overlap with what superpoints mean.

    A mask counts where most of its own superpoints agree on it. Small ones may lie on large ones; other
    overlaps are refused. The largest is left out where it covers most of what there is.
    """
    size = session.encoding.superpoints.size
    masks, likely = _answers(session, asked, progress)
    common, overlap = overlaps(masks, size)
    chosen = [masks[i] for i in _tiling(masks[:, asked].T * (likely @ overlap), common)]
    chosen.sort(key=lambda m: -float(size[m].sum()))
    if chosen and size[chosen[0]].sum() > _BODY * size.sum():
        chosen = chosen[1:]
    return chosen


def _answers(
    session: DefaultSession, asked: npt.NDArray[np.int64], progress: Progress
) -> tuple[Bool, Float]:
    """(M, C) the likeliest masks of all asked superpoints, and (A, M) how likely each is for a superpoint."""
    said = answers_of(session.solver, asked, _ANSWERS, of_a_part=False, progress=progress)
    likely = np.zeros((len(asked), len(said.masks)), np.float32)
    first = np.flatnonzero(np.diff(said.by, prepend=-1))
    power = np.exp((said.scores - said.scores[first][said.by]) / _TEMPERATURE)
    likely[said.by, said.of] = power / np.add.reduceat(power, first)[said.by]
    return said.masks, likely


def _tiling(agreed: Float, common: Float) -> list[int]:
    """Masks whose superpoints agree on them, greedily.

    Args:
        agreed: (A, M) expected overlap of a mask with what an asked superpoint means, 0 outside it.
        common: (M, M) how much every two masks have in common.
    """
    inside = agreed > 0
    quality = agreed.sum(0) / np.maximum(inside.sum(0), 1)
    free = quality > _LEAST
    now = np.zeros(len(agreed))
    chosen: list[int] = []
    while free.any():
        # Superpoints change over to the new mask, be it better for them or worse.
        gain = np.where(inside, agreed - now[:, None], 0).mean(0) - _PRICE
        gain = np.where(free, gain * quality**3, -1.0)
        best = int(gain.argmax())
        if gain[best] <= 0:
            break
        chosen.append(best)
        now = np.where(inside[:, best], agreed[:, best], now)
        free &= beside(common, best, _SMALLER)[0]
    return chosen


def spread(points: npt.NDArray[np.float64], count: int) -> npt.NDArray[np.int64]:
    """Farthest-point sampling; starts at the first point."""
    chosen = [0]
    far = np.linalg.norm(points - points[0], axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(far.argmax()))
        far = np.minimum(far, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


def without_leftovers(
    session: DefaultSession, labels: npt.NDArray[np.int16], largest: float = 0.01
) -> npt.NDArray[np.int16]:
    """Give the crumbs to their neighbours.

    Every connected piece of one label with at most ``largest`` of all nodes, other than that
    label's largest piece, goes to the label that it touches most; so do unassigned elements.
    """
    nodes, graph = session.encoding.nodes, session.encoding.graph
    of_node = np.asarray(labels)[first_elements(session)]
    same = (of_node[graph.a] == of_node[graph.b]) & ~graph.bridge
    number, piece = components(len(nodes), graph.a[same], graph.b[same])
    size = np.bincount(piece, minlength=number)
    label = np.zeros(number, np.int16)
    label[piece] = of_node
    biggest = np.zeros(number, bool)
    for part in np.unique(label):
        own = np.nonzero(label == part)[0]
        biggest[own[size[own].argmax()]] = part >= 0
    crumb = ~biggest & ((size <= largest * len(nodes)) | (label < 0))
    out = of_node.copy()
    a, b = piece[graph.a], piece[graph.b]
    for here, there in ((a, b), (b, a)):
        use = crumb[here] & ~crumb[there]
        key, count = np.unique(
            here[use].astype(np.int64) * 1024 + label[there[use]], return_counts=True
        )
        order = np.argsort(count, kind="stable")
        label[key[order] // 1024] = np.where(
            crumb[key[order] // 1024], key[order] % 1024, label[key[order] // 1024]
        )
    out = np.maximum(label[piece], BASE).astype(np.int16)
    moved = nodes.elements.to_elements(out)
    unchanged = nodes.elements.to_elements((out != of_node).astype(np.int16)) == 0
    return np.where(unchanged & (np.asarray(labels) >= 0), labels, moved)
