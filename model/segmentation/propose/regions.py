"""Propose regions of the merge trees, and random walks from the clicks."""

from __future__ import annotations

from dataclasses import replace
from operator import attrgetter

import numpy as np
from cachetools import LRUCache, cachedmethod

from model.segmentation.arrays import Bool, Float, Int64
from model.segmentation.encode.hierarchy import TREES, Hierarchy
from model.segmentation.encode.random_walk import RandomWalk
from model.segmentation.encode.superpoints import Superpoints
from model.segmentation.part_state import PartState
from model.segmentation.propose.proposals import Proposals, distinct_proposals

_THINNING = 1.06
"""Nested regions that differ by a smaller factor in size count as one."""
_WHOLE = 0.97
"""Share of the object above which a region is the whole."""
_NESTED = 60
"""Nested regions around a superpoint, those that last longest."""
_UNIONS, _UNION_GROWTH = 24, 1.15
"""Unions of regions around all positive clicks: the coarsest, and least growth between two."""
_BIASES = (-0.02, -0.1, -0.25)
"""Values of the walk far from all clicks; the border lies at 0."""
_SWEEPS = 3
_CACHED = 16


class Regions:
    """The proposal source of all domains: nested regions of the merge trees."""

    moving_only = False

    def __init__(self, superpoints: Superpoints, hierarchy: Hierarchy) -> None:
        self._total = float(superpoints.size.sum())
        self._nested: LRUCache = LRUCache(_CACHED)
        self._labels = hierarchy.labels
        self._tree = hierarchy.tree
        self._height = hierarchy.height
        self._offset = hierarchy.offset[:-1]
        self._sizes = np.bincount(
            (hierarchy.labels + self._offset[:, None]).ravel(),
            np.tile(superpoints.size, len(hierarchy.labels)),
        )

    @cachedmethod(attrgetter("_nested"))
    def nested(self, superpoint: int) -> Proposals:
        """The nested regions around a superpoint, those of nearly the same size only once."""
        sizes = self._sizes[self._labels[:, superpoint] + self._offset]
        levels: list[int] = []
        lives: list[float] = []
        for tree in range(len(TREES)):
            rows = np.nonzero(self._tree == tree)[0]
            start = 0
            while start < len(rows):
                end = start
                while end + 1 < len(rows) and sizes[rows[end + 1]] < _THINNING * sizes[rows[start]]:
                    end += 1
                # A region lives from the level where it forms to the one that swallows it.
                if sizes[rows[start]] <= _WHOLE * self._total:
                    last = self._height[rows[end + 1]] if end + 1 < len(rows) else 10.0
                    levels.append(int(rows[end]))
                    lives.append(float(last - self._height[rows[start]]))
                start = end + 1
        if not levels:
            levels, lives = [0], [0.0]
        if len(levels) > _NESTED:
            keep = np.sort(np.argsort(-np.array(lives), kind="stable")[:_NESTED])
            levels, lives = [levels[k] for k in keep], [lives[k] for k in keep]
        index = np.array(levels)
        masks = self._labels[index] == self._labels[index, superpoint][:, None]
        life = np.array(lives, np.float32)
        return distinct_proposals([Proposals(masks, self._tree[index], self._height[index], life)])

    def first(self, superpoint: int, outside: tuple[int, ...]) -> list[Proposals]:
        """The nested regions; see :class:`.ProposalSource`."""
        del outside
        return [self.nested(superpoint)]

    def later(
        self, before: PartState, after: PartState, superpoint: int, positive: bool
    ) -> list[Proposals]:
        """The mask with or without a region, or regions in its place."""
        assert before.mask is not None
        mask, positives, negatives = before.mask, list(after.positive), list(after.negative)
        nested = self.nested(superpoint)
        keep = mask.copy()
        keep[superpoint] = positive
        out = [Proposals.of([keep], "keep")]
        refused = negatives if positive else positives
        clean = ~nested.masks[:, refused].any(1) if refused else np.ones(len(nested), bool)
        usable = nested.take(np.nonzero(clean)[0])
        if positive and len(usable):
            out.append(_like(usable, usable.masks | mask, "grow"))
            whole = usable.masks[:, positives].all(1)
            if whole.any():
                regions = usable.take(np.nonzero(whole)[0])
                out.append(_like(regions, regions.masks, "replace"))
        elif len(usable):
            out.append(_like(usable, mask & ~usable.masks, "cut"))
        return out + self._unions(positives, negatives)

    def _unions(self, positives: list[int], negatives: list[int]) -> list[Proposals]:
        """Unions of the regions of all positive clicks, one a level, if they hold no negative."""
        if not positives:
            return []
        labels = self._labels
        own = labels[:, positives]
        if negatives:
            hit = (labels[:, negatives][:, :, None] == own[:, None, :]).any((1, 2))
        else:
            hit = np.zeros(len(labels), bool)
        rows = np.nonzero(~hit)[0]
        out: list[Bool] = []
        for tree in range(len(TREES)):
            size = 0.0
            for row in rows[self._tree[rows] == tree]:
                regions = np.array(sorted(set(own[row].tolist())))
                now = float(self._sizes[regions + self._offset[row]].sum())
                if now < _UNION_GROWTH * size or now > _WHOLE * self._total:
                    continue
                size = now
                if len(regions) == 1:
                    out.append(labels[row] == regions[0])
                    continue
                chosen = np.zeros(int(labels[row].max()) + 1, bool)
                chosen[regions] = True
                out.append(chosen[labels[row]])
        return [Proposals.of(out[-_UNIONS:], "union")] if out else []


def _like(regions: Proposals, masks: Bool, source: str) -> Proposals:
    made = Proposals.of(masks, source)
    return replace(made, height=regions.height, life=regions.life)


class Walks:
    """Proposals by random walks, made after the first round has been scored."""

    def __init__(self, walk: RandomWalk, count: int) -> None:
        """``count``: of superpoints."""
        self._walk, self._count = walk, count

    def from_clicks(self, mask: Bool, after: PartState) -> list[Proposals]:
        """Walks from the clicks of ``after`` alone, and walks that start from ``mask``."""
        seeds, values = _seeds(after)
        flat = np.repeat(np.array(_BIASES, np.float32)[:, None], self._count, axis=1)
        free = self._walk.fields(flat, seeds, values, 0)
        swept = self._walk.sweep(free[1], _SWEEPS)
        prior = _prior(mask)
        near = [self._walk.fields(prior, seeds, values, reach)[0] > 0 for reach in (1, 2)]
        out = [Proposals.of(list(free > 0), "walk"), Proposals.of(near, "mend")]
        return [*out, Proposals.of(swept, "sweep")] if len(swept) else out

    def corrected(self, mask: Bool, after: PartState) -> Bool:
        """(C,) ``mask`` after a walk that makes it agree with the clicks."""
        seeds, values = _seeds(after)
        return self._walk.fields(_prior(mask), seeds, values, 1)[0] > 0


def _prior(mask: Bool) -> Float:
    return np.where(mask, np.float32(1), np.float32(-1))[None]


def _seeds(state: PartState) -> tuple[Int64, Float]:
    superpoints = np.array([*state.positive, *state.negative], np.int64)
    values = np.r_[np.ones(len(state.positive)), -np.ones(len(state.negative))]
    return superpoints, values.astype(np.float32)
