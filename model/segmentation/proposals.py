"""Masks proposed for a click: the state they start from, the port of their sources, and regions.

Regions are those of the merge trees, and random walks from the clicks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Protocol

import numpy as np
import numpy.typing as npt
from cachetools import LRUCache, cachedmethod

from model.segmentation.arrays import Bool, Float, Int8, Int64
from model.segmentation.encoding import TREES, Hierarchy, RandomWalk
from model.segmentation.superpoints import Superpoints

_INEFFECTIVE_SHARE = 0.03
"""A click that changes less of the mask than this share was ineffective."""
_SIZE_MARGIN = 1.25
"""Least ratio of the upper to the lower size bound; closer bounds contradict each other."""


@dataclass(frozen=True, eq=False)
class CorrectiveClick:
    """A click that was to change a mask.

    Attributes:
        superpoint: the clicked one. positive: whether the part should hold it.
        before: (C,) the mask that the person saw, all False at the first click.
    """

    superpoint: int
    positive: bool
    before: Bool


@dataclass(frozen=True, eq=False)
class PartState:
    """Clicks and mask of one part.

    Attributes:
        positive, negative: clicked superpoints in order.
        mask: (C,) the part's superpoints, None before the first click.
        ineffective: consecutive clicks, the latest ones, that hardly changed the mask.
        streak: latest consecutive corrective clicks of one sign, negative for removals.
        drawn: how often the person chose or drew another mask than the clicks gave.
        least, most: bounds on the true size in nodes: the largest mask that lacked something and
            the smallest that held excess.
        confirmed: how many positive and negative clicks agreed with the mask.
        corrections: the other clicks, in order.
    """

    positive: tuple[int, ...] = ()
    negative: tuple[int, ...] = ()
    mask: Bool | None = None
    ineffective: int = 0
    streak: int = 0
    drawn: int = 0
    least: float = 0.0
    most: float = np.inf
    confirmed: tuple[int, int] = (0, 0)
    corrections: tuple[CorrectiveClick, ...] = ()

    @property
    def has_mask(self) -> bool:
        """True if any superpoint belongs to the part."""
        return self.mask is not None and bool(self.mask.any())

    @property
    def informative_clicks(self) -> int:
        """Clicks that changed the mask."""
        return len(self.positive) + len(self.negative) - sum(self.confirmed)

    def with_click(self, superpoint: int, positive: bool) -> PartState:
        """The state with one more click; a superpoint counts where it was clicked last."""
        yes = tuple(s for s in self.positive if s != superpoint)
        no = tuple(s for s in self.negative if s != superpoint)
        if positive:
            return replace(self, positive=(*yes, superpoint), negative=no)
        return replace(self, positive=yes, negative=(*no, superpoint))

    def with_confirming_click(self, superpoint: int, positive: bool) -> PartState:
        """The state after a click that agrees with the mask.

        Such clicks don't count as steps: after five on the glass of a door, the next one may
        still change much.
        """
        new = superpoint not in (self.positive if positive else self.negative)
        yes, no = self.confirmed
        confirmed = (yes + (new and positive), no + (new and not positive))
        return replace(self.with_click(superpoint, positive), confirmed=confirmed)

    def with_correction(
        self, superpoint: int, positive: bool, mask: Bool, size: Float
    ) -> PartState:
        """The state after a click that made the part ``mask``.

        Args:
            size: (C,) nodes of each superpoint.
        """
        ineffective = streak = 0
        if self.mask is not None and self.has_mask:
            changed, before = size[mask ^ self.mask].sum(), size[self.mask].sum()
            if changed < _INEFFECTIVE_SHARE * before:
                ineffective = self.ineffective + 1
            streak = max(self.streak, 0) + 1 if positive else min(self.streak, 0) - 1
        least, most = self.size_bounds(positive, size)
        before = np.zeros_like(mask) if self.mask is None else self.mask
        return replace(
            self.with_click(superpoint, positive),
            mask=mask,
            ineffective=ineffective,
            streak=streak,
            least=least,
            most=most,
            corrections=(*self.corrections, CorrectiveClick(superpoint, positive, before)),
        )

    def size_bounds(self, positive: bool, size: Float) -> tuple[float, float]:
        """``least`` and ``most`` after one more click, if people correct the larger error first."""
        if self.mask is None or not self.has_mask:
            return self.least, self.most
        nodes = float(size[self.mask].sum())
        least = max(self.least, nodes) if positive else self.least
        most = self.most if positive else min(self.most, nodes)
        if _SIZE_MARGIN * least > most:
            # This person doesn't: only the last click counts.
            return (nodes, np.inf) if positive else (0.0, nodes)
        return least, most


SOURCES = (
    "contact", "absorb", "patch", "sweep",
    "grow", "replace", "union", "cut", "walk", "mend", "keep",
)  # fmt: skip
"""Sources of masks; the weights' feature names contain these words, so they stay as they are.

contact, absorb, patch: one region of that merge tree; sweep: a level set of a random walk with
little leak through its border; grow: the earlier mask and a region; replace: a region that holds
all the clicks; union: a region around each click; cut: the earlier mask without a region; walk: a
random walk from the clicks alone; mend: a walk that starts from a mask; keep: the earlier mask and
the clicked superpoint."""
BOX_SOURCE = len(SOURCES)
"""Source of boxes and rectangles, which ``SOURCES`` lacks: the oldest weights don't know them."""


@dataclass(frozen=True, eq=False)
class Proposals:
    """H masks over the C superpoints with their origin.

    Attributes:
        masks: (H, C) bool.
        source: (H,) int8 index into ``SOURCES``, or ``BOX_SOURCE``.
        height, life: (H,) float32 cost at which a tree region forms, and how long it lasts.
    """

    masks: Bool
    source: Int8
    height: Float
    life: Float

    def __len__(self) -> int:
        return len(self.masks)

    @classmethod
    def of(cls, masks: list[Bool] | Bool, source: str | int) -> Proposals:
        """Proposals of one source that are no tree regions."""
        masks = np.stack(masks) if isinstance(masks, list) else masks
        number = SOURCES.index(source) if isinstance(source, str) else source
        zero = np.zeros(len(masks), np.float32)
        return cls(masks, np.full(len(masks), number, np.int8), zero, zero.copy())

    def take(self, index: npt.NDArray) -> Proposals:
        """Proposals at ``index``."""
        return Proposals(
            self.masks[index], self.source[index], self.height[index], self.life[index]
        )

    def with_masks(self, masks: Bool) -> Proposals:
        """The same proposals with other masks."""
        return replace(self, masks=masks)


def concatenated(groups: list[Proposals]) -> Proposals:
    """All proposals of several groups, in order."""
    return Proposals(
        np.concatenate([g.masks for g in groups]),
        np.concatenate([g.source for g in groups]),
        np.concatenate([g.height for g in groups]),
        np.concatenate([g.life for g in groups]),
    )


def distinct_proposals(groups: list[Proposals]) -> Proposals:
    """All proposals of several groups; of equal masks the first stays."""
    every = concatenated(groups)
    packed = np.packbits(every.masks, axis=1)
    _, first = np.unique(packed.view(f"V{packed.shape[1]}").ravel(), return_index=True)
    return every.take(np.sort(first))


def evenly(order: Int64, most: int) -> Int64:
    """At most ``most`` entries of ``order``, evenly spaced."""
    if len(order) <= most:
        return order
    return order[np.linspace(0, len(order) - 1, most).astype(int)]


class ProposalSource(Protocol):
    """Proposes masks for clicks on superpoints.

    Attributes:
        moving_only: whether it is asked only for clicks that mean a moving part, not the base.
    """

    moving_only: bool

    def first(self, superpoint: int, outside: tuple[int, ...]) -> list[Proposals]:
        """Masks that a first click on ``superpoint`` may mean.

        Args:
            outside: superpoints that the part doesn't hold. Masks with them are dropped later.
        """
        ...

    def later(
        self, before: PartState, after: PartState, superpoint: int, positive: bool
    ) -> list[Proposals]:
        """Masks that a later click may mean.

        Args:
            before: the part before the click; it has a mask. after: its clicks with the new one.
            positive: whether the part should hold ``superpoint``.
        """
        ...


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
