"""Finish clouds: small components of the base beside one part alone belong to that part.

A handle in front of a door, its window, a hole that the clicks left.
"""

from __future__ import annotations

import numpy as np

from model.segmentation.arrays import Labels
from model.segmentation.encode.graph import components
from model.segmentation.encode.superpoints import Superpoints
from model.segmentation.prompt_steps import ClickStep, RegionStep, Step
from model.segmentation.prompts import BASE

_WITH_ONE_PART = 0.8
"""Share of its links that a component has with one part to lie beside that alone."""
_SHARE_OF_PART = 0.15
"""Largest share of the part's size; more is no handle."""


def with_small_components(
    superpoints: Superpoints, of_superpoint: Labels, steps: tuple[Step, ...]
) -> Labels:
    """``of_superpoint`` (C,) with the base's small components in the part beside them.

    Components that a prompt gives to another part stay, and so do those beside a part that the
    person drew last: its handle is drawn with it or left out.
    """
    links = superpoints.links
    width, free = int(of_superpoint.max()) + 1, of_superpoint == BASE
    one, two = free[links.a], free[links.b]
    inner = one & two
    count, component = components(len(superpoints), links.a[inner], links.b[inner])
    size = np.bincount(component[free], superpoints.size[free], count)
    out, back = np.flatnonzero(one & ~two), np.flatnonzero(two & ~one)
    mine = np.concatenate([links.a[out], links.b[back]])
    beside = np.concatenate([links.b[out], links.a[back]])
    weight = links.count[np.concatenate([out, back])]
    key = component[mine].astype(np.int64) * width + of_superpoint[beside]
    votes = np.bincount(key, weight, count * width).reshape(count, width)
    best = votes.argmax(1)
    part_size = np.bincount(of_superpoint, superpoints.size, width)
    joins = (best != BASE) & (votes.max(1) >= _WITH_ONE_PART * votes.sum(1))
    joins &= size <= _SHARE_OF_PART * part_size[best]
    joins[size.argmax()] = False  # the base keeps at least its largest component
    last = {step.part: step for step in steps}
    drawn = [part for part, step in last.items() if isinstance(step, RegionStep)]
    if drawn:
        joins &= ~np.isin(best, drawn)
    for step in steps:
        # What a positive prompt claimed and is in the base now was taken back since.
        if step.positive and step.part != BASE:
            continue
        nodes = step.node if isinstance(step, ClickStep) else step.nodes
        touched = np.unique(component[superpoints.of_node[nodes]])
        joins[touched] &= (not step.positive) & (best[touched] != step.part)
    return np.where(free & joins[component], best[component], of_superpoint).astype(np.int16)
