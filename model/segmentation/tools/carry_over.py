"""Parts of an object from an example that is laid over it; see :mod:`model.geometry.like_object`.

Each part is the segmenter's own proposal that covers best what the example has there, so borders
lie where this object has them. Where none fits, superpoints take the part most of them lie on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model.geometry.like_object import Match
from model.segmentation.arrays import Bool, Float64, Int16
from model.segmentation.default import DefaultSession
from model.segmentation.prompts import BASE

_AGREES = 0.7
"""Overlap (IoU) from which a proposal is taken for a carried part."""


@dataclass(frozen=True, eq=False)
class CarriedParts:
    """Parts of an object that an example suggests.

    Attributes:
        labels: (E,) int16, 0 is the base.
        links: part → link of the example.
        agreement: 0..1, mean overlap of the example's parts with what the segmenter would answer
            to a click on each: whether they are parts here, too.
    """

    labels: Int16
    links: dict[int, str]
    agreement: float


def carry_over(session: DefaultSession, match: Match) -> CarriedParts:
    """Take over the parts of ``match`` but its root, which is the base."""
    nodes, superpoints = session.encoding.nodes, session.encoding.superpoints
    example = match.example
    nearest = example.part[example.tree.query(match.to_example(nodes.points))[1]]
    of_superpoint = np.full(len(superpoints), BASE, np.int16)
    links: dict[int, str] = {}
    overlaps: list[float] = []
    wanted = np.bincount(example.part, minlength=len(example.links)) / len(example.part)
    moving = [k for k, link in enumerate(example.links) if link != example.root]
    # The large ones first: what lies on them is theirs only where no smaller one has it.
    for k in sorted(moving, key=lambda k: -wanted[k]):
        share = np.bincount(superpoints.of_node, nearest == k, len(superpoints)) / superpoints.size
        if not (share > 0.5).any():
            continue
        mask, overlap = _proposal(session, share)
        part = len(links) + 1
        of_superpoint[mask] = part
        links[part] = example.links[k]
        overlaps.append(overlap)
    labels = session.finisher.without_prompts(of_superpoint)
    kept = [part for part in links if (labels == part).any()]
    numbers = np.zeros(len(links) + 1, np.int16)
    numbers[kept] = np.arange(1, len(kept) + 1)
    return CarriedParts(
        np.where(labels > BASE, numbers[np.maximum(labels, 0)], labels).astype(np.int16),
        {int(numbers[part]): links[part] for part in kept},
        float(np.mean(overlaps)) if overlaps else 0.0,
    )


def _proposal(session: DefaultSession, share: Float64) -> tuple[Bool, float]:
    """The superpoints of a part of which ``share`` (C,) of each belongs to it, and its overlap with
    the first answer to a click on it.
    """
    superpoints = session.encoding.superpoints
    size, own = superpoints.size, share > 0.5
    middle = np.average(superpoints.center[own], axis=0, weights=size[own])
    apart = np.linalg.norm(superpoints.center - middle, axis=1)
    seed = int(np.flatnonzero(own)[apart[own].argmin()])
    found = session.solver.first_answer(seed, moving=True)
    masks = found.proposals.masks
    common = masks @ (size * share)
    union = masks @ size + (size * share).sum() - common
    overlap = common / np.maximum(union, 1e-9)
    best, first = int(overlap.argmax()), float(overlap[found.order[0]])
    return (masks[best] if overlap[best] >= _AGREES else own), first
