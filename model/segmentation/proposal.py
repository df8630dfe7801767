"""A first guess of all parts, and what becomes of the crumbs."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.segmentation.cells import groups
from model.segmentation.default import DefaultSession
from model.segmentation.element_masks import first_elements
from model.segmentation.prompts import BASE, PartSegmentation

Bool = npt.NDArray[np.bool_]


def propose(session: DefaultSession, seeds: int = 160, least: float = 0.55) -> PartSegmentation:
    """A first guess of all parts, to start from.

    Masks that a first click on one of many spread cells would take, best first; a small part may
    sit on a large one, other overlaps are refused. What none of them takes is the base, and so
    is the largest where it covers most of the object.

    Args:
        seeds: cells asked.
        least: score (0..1, the expected IoU squared) that a part needs.
    """
    cells = session.encoding.cells
    ranked: list[tuple[float, Bool]] = []
    for cell in _spread(cells.center, seeds):
        answer = session.solver.first_answer(int(cell))
        score = 1 / (1 + np.exp(-answer.scores))
        for index in np.argsort(-score)[:4]:
            ranked.append((float(score[index]), answer.candidates.masks[index]))
    ranked.sort(key=lambda pair: -pair[0])
    chosen: list[Bool] = []
    for score, mask in ranked:
        size = float(cells.size[mask].sum())
        shared = [float(cells.size[mask & other].sum()) for other in chosen]
        # Apart from all others, or a small part that sits on one of them: a knob on a panel.
        fits = all(
            common < 0.1 * size
            or (common > 0.9 * size and size < 0.25 * float(cells.size[other].sum()))
            for common, other in zip(shared, chosen, strict=True)
        )
        if score >= least and fits:
            chosen.append(mask)
    of_cell = np.zeros(len(cells), np.int16)
    chosen.sort(key=lambda m: -float(cells.size[m].sum()))
    if chosen and cells.size[chosen[0]].sum() > 0.4 * cells.size.sum():
        chosen = chosen[1:]
    for part, mask in enumerate(chosen, start=BASE + 1):
        of_cell[mask] = part
    labels = session.encoding.nodes.elements.to_elements(of_cell[cells.of_node])
    return PartSegmentation(labels, "default")


def _spread(points: npt.NDArray[np.float64], count: int) -> npt.NDArray[np.int64]:
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
    number, piece = groups(len(nodes), graph.a[same], graph.b[same])
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
