"""Encode, step 5: merge trees, nested regions around every superpoint up to the whole object.

Regions are contracted at rising cost thresholds, all cheapest links of a threshold at once, so a
tree over ten thousand superpoints takes tenths of a second in numpy. Three costs give three trees:
one penalises thin contacts, one absorbs enclosed regions (handles, windows) early, one follows flat
and evenly coloured patches.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from model.segmentation.arrays import Float, Float32, Int8, Int32, Int64
from model.segmentation.encode.graph import components
from model.segmentation.encode.nodes import distinct
from model.segmentation.encode.superpoints import Links, Superpoints, totals

LEVELS = 44
TREES = ("contact", "absorb", "patch")
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """Nested partitions of the superpoints.

    Attributes:
        labels: (L, C) int32 region of each superpoint at each level, fine to coarse, one tree after
            another; each level counts its regions from 0.
        tree: (L,) int8 which of ``TREES``.
        height: (L,) float32 the level's cost threshold.
    """

    labels: Int32
    tree: Int8
    height: Float32

    @cached_property
    def offset(self) -> Int64:
        """(L + 1,) number of the first region of each level, counting all levels; the total."""
        return np.concatenate([[0], np.cumsum(self.labels.max(1).astype(np.int64) + 1)])


@dataclass
class _Regions:
    """Regions while they merge."""

    links: Links
    size: Float
    perimeter: Float
    normal: Float
    color: Float

    def merge(self, group: Int32, number: int) -> _Regions:
        inner = self.links.count * (group[self.links.a] == group[self.links.b])
        lost = totals(self.links.a, inner, len(self.size))
        outline = totals(group, self.perimeter - 2 * lost, number)
        return _Regions(
            self.links.contract(group, number),
            totals(group, self.size, number),
            outline,
            np.stack([totals(group, v, number) for v in self.normal.T], axis=1),
            np.stack([totals(group, v, number) for v in self.color.T], axis=1),
        )


def _cost(regions: _Regions, tree: int, total: float) -> Float:
    """(M,) cost of dissolving each link."""
    links, size = regions.links, regions.size
    small_is_a = size[links.a] <= size[links.b]
    small = np.where(small_is_a, links.a, links.b)
    area = size[small]
    share = area / total
    grown = np.minimum(1.0, share / 0.002)
    cost = links.strength / links.count * (0.35 + 0.65 * grown**0.35)
    contact = np.minimum(1.0, links.count / (6 * np.sqrt(area)))
    if tree == 0:
        return cost + 0.9 * (1 - contact) * np.sqrt(grown)
    if tree == 1:
        enclosed = np.minimum(links.count / np.maximum(regions.perimeter[small], 1e-9), 1)
        fade = np.where(share < 0.08, 1.0, np.maximum(0, 1 - (share - 0.08) / 0.1))
        cost = cost * (1 - 0.85 * enclosed**2 * fade)
        return cost + 0.3 * (1 - contact) * np.sqrt(grown) * (1 - enclosed)
    normal = regions.normal / np.maximum(
        np.linalg.norm(regions.normal, axis=1, keepdims=True), 1e-9
    )
    turn = 1 - np.abs(np.einsum("ij,ij->i", normal[links.a], normal[links.b]))
    color = regions.color / size[:, None]
    hue = np.linalg.norm(color[links.a] - color[links.b], axis=1) / 15
    return 0.6 * cost + (1.5 * turn + 1.2 * np.minimum(hue, 2)) * np.sqrt(grown)


def build_hierarchy(superpoints: Superpoints) -> Hierarchy:
    """Three merge trees over the superpoints."""
    total = float(superpoints.size.sum())
    thresholds = 9.0 * (np.arange(1, LEVELS + 1) / LEVELS) ** 1.6
    labels, trees, heights = [], [], []
    perimeter = totals(
        superpoints.links.a, superpoints.links.count, len(superpoints)
    ) + np.bincount(superpoints.links.b, superpoints.links.count, len(superpoints))
    for tree in range(len(TREES)):
        regions = _Regions(
            superpoints.links,
            superpoints.size,
            perimeter,
            superpoints.normal * superpoints.size[:, None],
            superpoints.color * superpoints.size[:, None],
        )
        label = np.arange(len(superpoints), dtype=np.int32)
        for threshold in thresholds:
            before = len(regions.size)
            for _ in range(_ROUNDS):
                number = len(regions.size)
                if not len(regions.links.a):
                    break
                cost = _cost(regions, tree, total)
                best = regions.links.cheapest(cost, number)
                pick = distinct(best[best >= 0])
                pick = pick[cost[pick] <= threshold]
                if not len(pick):
                    break
                left, group = components(number, regions.links.a[pick], regions.links.b[pick])
                regions = regions.merge(group, left)
                label = group[label].astype(np.int32)
            if len(regions.size) < before:
                labels.append(label)
                trees.append(tree)
                heights.append(threshold)
            if len(regions.size) == 1:
                break
    if not labels:
        labels, trees, heights = [np.arange(len(superpoints), dtype=np.int32)], [0], [0.0]
    return Hierarchy(np.stack(labels), np.array(trees, np.int8), np.array(heights, np.float32))
