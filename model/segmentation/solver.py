"""One part against the rest: hypotheses for a click, and the choice among them."""

from __future__ import annotations

from collections import OrderedDict
from copy import copy
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import numpy.typing as npt

from model.segmentation.describe.masks import (
    FEATURE_NAMES,
    Candidates,
    Clicked,
    MaskDescriber,
    MendingClick,
    concatenated,
    joined,
)
from model.segmentation.encode.graph import components
from model.segmentation.encode.hierarchy import TREES, Hierarchy
from model.segmentation.encode.random_walk import RandomWalk
from model.segmentation.encode.superpoints import Superpoints
from model.segmentation.score.trees import Scorer

Bool = npt.NDArray[np.bool_]
Float = npt.NDArray[np.floating]

_THINNING = 1.06
_BIASES = (-0.02, -0.1, -0.25)
_CHAIN = 40
_CHAINS_KEPT = 16
_IDLE_CELLS = 2
_IDLE_SHARE = 0.1
_IDLE_PENALTY = 3.0
_LOSS_PENALTY = 3.0
_USUAL_OVERLAP = 0.8
_OVERLAP_BEFORE = FEATURE_NAMES.index("overlap_before")

_REGION_SAYS = 4
"""Clicks that say as much as a mask that the person chose or drew."""
_CHOSEN = 5.0
"""How much more such a mask is worth keeping than one that clicks brought."""

NEARLY_ALL = 0.9
"""Of what is left: a first answer takes no more, since a part moves against something."""
_ALL_RAMP = 0.05
_ALL_PENALTY = 12.0
"""For a first answer that takes that share of it, and the ramp more."""
LARGE_PENALTY = 2.0
_LARGE, _LARGE_RAMP = 0.5, 0.2
"""The same for that share of the whole object, on meshes and beside other parts: hardly any part
that moves is so large."""

_SIZE_PENALTY = 4.0
"""For a mask e times as large as one that was too large, or that much smaller."""
_SIZE_MOST = 1.0
_ROOM = 1.25
"""How far apart these two sizes are where they tell anything."""

_STALL_SHARE = 0.03
"""Of the mask: a click that changes less was in vain."""
_STALL_PENALTY = 4.0
_STALL_DEMAND, _STALL_GROWTH, _STALL_MOST = 0.05, 3.0, 0.5
"""Share of the mask that a click has to change, how it grows with each one in vain, its limit."""
_STALL_BALL = 2.0
"""The same limit in what is nearer to the click than the mask's border."""
_RUN_FREE, _RUN_STALLS = 2, 0.5
"""Clicks of one kind in a row that tell nothing, and what part of one in vain each more is."""
_FAR, _FAR_PENALTY, _FAR_MOST = 10.0, 0.3, 3.0
"""A mask that changes more than that times what is nearer to the click than the border before loses
by the logarithm of it, up to the last."""
_SPECK_NODES, _SPECK_PENALTY, _SPECK_MOST = 16.0, 3.0, 3.0
"""A mask that becomes smaller than that many nodes loses by the logarithm of it, up to the last."""
ALONE_BEHIND = 1.0
"""How far behind the best answer with what it moves a clicked handle alone stays, at least."""
_FIRST_SPECK, CLOSE_SPECK = 32.0, 10.0
"""The same for first answers, and for those in a close-up."""
DETAIL_PENALTY, _DETAIL, _NO_DETAIL = 1.0, 2e-4, 0.02
"""For a first answer of that share of the object, less by the logarithm of what it has more."""


@dataclass(frozen=True, eq=False)
class PartState:
    """What is known of one part so far.

    Attributes:
        positive, negative: clicked superpoints in order.
        mask: (C,) its superpoints.
        stalls: how many clicks in a row have hardly changed the mask.
        run: clicks of the same kind in a row since the first, negative where they took away.
        drawn: how often the person has chosen or drawn another mask than the clicks brought.
        least, most: nodes of the largest mask from which something was missing, and of the smallest
            one that held too much.
        agreed: how many of the clicks of each kind only said what was so already.
        steps: the others, each with the mask that it was to change.
    """

    positive: tuple[int, ...] = ()
    negative: tuple[int, ...] = ()
    mask: Bool | None = None
    stalls: int = 0
    run: int = 0
    drawn: int = 0
    least: float = 0.0
    most: float = np.inf
    agreed: tuple[int, int] = (0, 0)
    steps: tuple[MendingClick, ...] = ()


@dataclass(frozen=True, eq=False)
class Ranked:
    """Hypotheses with their features and scores."""

    candidates: Candidates
    features: Float
    scores: Float

    @classmethod
    def of(cls, groups: list[Ranked]) -> Ranked:
        """Those of several groups, one after the other."""
        return cls(
            concatenated([g.candidates for g in groups]),
            np.concatenate([g.features for g in groups]),
            np.concatenate([g.scores for g in groups]),
        )

    def take(self, index: npt.NDArray) -> Ranked:
        """Some of them."""
        return Ranked(self.candidates.take(index), self.features[index], self.scores[index])

    @property
    def best(self) -> Bool:
        """(C,) the mask with the highest score."""
        return self.candidates.masks[int(self.scores.argmax())]


class PartSolver:
    """Finds the mask that a part's clicks mean."""

    _far_penalty = _FAR_PENALTY
    _large_penalty = 0.0
    _large_beside = 0.0
    _first_speck = _FIRST_SPECK
    _detail_penalty = 0.0
    _run_stalls = _RUN_STALLS
    _stall_ball = _STALL_BALL

    def __init__(
        self,
        superpoints: Superpoints,
        hierarchy: Hierarchy,
        walk: RandomWalk,
        first_scorer: Scorer | None,
        later_scorer: Scorer | None,
        describe: MaskDescriber | None = None,
    ) -> None:
        self.superpoints = superpoints
        self.describe = describe or MaskDescriber(superpoints, hierarchy)
        self._walk = walk
        self._first = first_scorer
        self._later = later_scorer
        self._chains: OrderedDict[int, Candidates] = OrderedDict()
        self._labels = hierarchy.labels
        self._tree = hierarchy.tree
        self._height = hierarchy.height
        self._offset = hierarchy.offset[:-1]
        self._sizes = np.bincount(
            (hierarchy.labels + self._offset[:, None]).ravel(),
            np.tile(superpoints.size, len(hierarchy.labels)),
        )

    # Regions around a superpoint -------------------------------------------------------------

    def chain(self, superpoint: int) -> Candidates:
        """The nested regions around a superpoint, those of nearly the same size only once."""
        if superpoint not in self._chains:
            self._chains[superpoint] = self._nested(superpoint)
            if len(self._chains) > _CHAINS_KEPT:
                self._chains.popitem(last=False)
        return self._chains[superpoint]

    def _nested(self, superpoint: int) -> Candidates:
        sizes = self._sizes[self._labels[:, superpoint] + self._offset]
        total = self.superpoints.size.sum()
        levels: list[int] = []
        lives: list[float] = []
        for tree in range(len(TREES)):
            rows = np.nonzero(self._tree == tree)[0]
            start = 0
            while start < len(rows):
                end = start
                while end + 1 < len(rows) and sizes[rows[end + 1]] < _THINNING * sizes[rows[start]]:
                    end += 1
                # The region lives from the level where it forms to the one that swallows it.
                if sizes[rows[start]] <= 0.97 * total:
                    last = self._height[rows[end + 1]] if end + 1 < len(rows) else 10.0
                    levels.append(int(rows[end]))
                    lives.append(float(last - self._height[rows[start]]))
                start = end + 1
        if not levels:
            levels, lives = [0], [0.0]
        if len(levels) > _CHAIN + 20:
            keep = np.sort(np.argsort(-np.array(lives), kind="stable")[: _CHAIN + 20])
            levels, lives = [levels[k] for k in keep], [lives[k] for k in keep]
        index = np.array(levels)
        masks = self._labels[index] == self._labels[index, superpoint][:, None]
        return joined(
            [Candidates(masks, self._tree[index], self._height[index], np.array(lives, np.float32))]
        )

    def first_regions(self, superpoint: int) -> Candidates:
        """What a first click on a superpoint may mean."""
        return self.chain(superpoint)

    def part_regions(self, superpoint: int, outside: tuple[int, ...]) -> Candidates:
        """What a first click on a superpoint may mean if that is a part that moves, without others."""
        del outside
        return self.first_regions(superpoint)

    def part_hypotheses(
        self, state: PartState, after: PartState, superpoint: int, positive: bool
    ) -> list[Candidates]:
        """What a later click may mean beside the usual, where the part is one that moves."""
        del state, after, superpoint, positive
        return []

    def _as_part(
        self, found: Candidates, features: Float, scores: Float, clicked: Clicked
    ) -> tuple[Float, Float]:
        """(H, F) features and (H,) scores of what a first click may mean as a part that moves.

        Args:
            scores: of what may be the base, too.
        """
        del found, clicked
        return features, scores

    def _as_mended(
        self, found: Candidates, features: Float, scores: Float, clicked: Clicked
    ) -> tuple[Float, Float]:
        """The same of what a later click may make of it."""
        del found, clicked
        return features, scores

    def first_answer(self, superpoint: int, *, of_a_part: bool = True) -> Ranked:
        """Hypotheses for a first click on ``superpoint`` with nothing else said.

        Args:
            of_a_part: see :meth:`answer`.
        """
        return self.answer(PartState(), superpoint, True, None, of_a_part=of_a_part)

    def with_first(self, scorer: Scorer | None) -> Self:
        """The same solver with another scorer of first clicks."""
        other = copy(self)
        other._first = scorer
        return other

    def tidy(self, mask: Bool, state: PartState, superpoint: int) -> Bool:
        """``mask`` without crumbs and pinholes that no click asked for.

        A piece of the mask (or of the rest) goes to the other side where it has less than a
        thousandth of all nodes and a fiftieth of the mask, and holds no click.
        """
        links, size = self.superpoints.links, self.superpoints.size
        same = mask[links.a] == mask[links.b]
        number, piece = components(len(mask), links.a[same], links.b[same])
        held = np.bincount(piece, size, number)
        small = held < min(0.001 * size.sum(), 0.02 * size[mask].sum())
        small[piece[[superpoint, *state.positive, *state.negative]]] = False
        return mask ^ small[piece]

    # Hypotheses ----------------------------------------------------------------------

    def answer(
        self,
        state: PartState,
        superpoint: int,
        positive: bool,
        blocked: Bool | None,
        *,
        of_a_part: bool = True,
    ) -> Ranked:
        """Hypotheses for a new click, scored.

        Args:
            state: before the click.
            superpoint: the clicked superpoint.
            positive: whether the part should hold it.
            blocked: (C,) superpoints of other parts that this part may not take.
            of_a_part: a first click means a part that moves, as people's do: what they don't click
                is the base. Without that the base, too, may be meant.
        """
        after = with_click(state, superpoint, positive)
        if state.mask is None or not state.mask.any():
            return self._first_answer(after, superpoint, blocked, of_a_part)
        clicked = Clicked(
            after.positive,
            after.negative,
            superpoint,
            positive,
            state.mask,
            state.agreed,
            state.steps,
        )
        made = self._region_hypotheses(state, after, superpoint, positive)
        if of_a_part:
            made = joined([made, *self.part_hypotheses(state, after, superpoint, positive)])
        found = self._finish(made, after, blocked)
        if self._later is None:
            scores = self._rule(found, clicked)
        else:
            scores = self._later(self.describe(found, clicked))
        mended = [self._mend(found.masks[int(i)], after) for i in np.argsort(-scores)[:2]]
        walks = self._walks(state.mask, after)
        more = [Candidates.of([m for pair in mended for m in pair], "mend"), *walks]
        both = joined([found, self._finish(joined(more), after, blocked)])
        features = self.describe(both, clicked)
        scores = self._rule(both, clicked) if self._later is None else self._later(features)
        if of_a_part:
            features, scores = self._as_mended(both, features, scores, clicked)
        lost = np.clip(1 - features[:, _OVERLAP_BEFORE] / _USUAL_OVERLAP, 0, 1)
        return Ranked(
            both, features, scores - self._unlikely(state, superpoint, positive, both.masks, lost)
        )

    def moved(self, state: PartState, superpoint: int, positive: bool, mask: Bool) -> PartState:
        """``state`` after a click that made the part ``mask``."""
        stalls = run = 0
        if state.mask is not None and state.mask.any():
            size = self.superpoints.size
            little = size[mask ^ state.mask].sum() < _STALL_SHARE * size[state.mask].sum()
            stalls = state.stalls + 1 if little else 0
            run = max(state.run, 0) + 1 if positive else min(state.run, 0) - 1
        least, most = self._bounds(state, positive)
        after = with_click(state, superpoint, positive)
        before = np.zeros_like(mask) if state.mask is None else state.mask
        steps = (*state.steps, MendingClick(superpoint, positive, before))
        return replace(
            after, mask=mask, stalls=stalls, run=run, least=least, most=most, steps=steps
        )

    def _bounds(self, state: PartState, positive: bool) -> tuple[float, float]:
        """``least`` and ``most`` after a click: most people mend the larger error first."""
        if state.mask is None or not state.mask.any():
            return state.least, state.most
        own = float(self.superpoints.size[state.mask].sum())
        least = max(state.least, own) if positive else state.least
        most = state.most if positive else min(state.most, own)
        if _ROOM * least > most:
            # This one mends what comes next: only the last click counts.
            return (own, np.inf) if positive else (0.0, own)
        return least, most

    def _unlikely(
        self, state: PartState, superpoint: int, positive: bool, masks: Bool, lost: Float
    ) -> Float:
        """(H,) what speaks against each mask whatever it looks like: nobody clicks for that.

        Args:
            state: before the click on ``superpoint``.
            positive: whether the part should hold ``superpoint``.
            lost: (H,) 0..1 how much of the mask before is gone.
        """
        assert state.mask is not None
        size = self.superpoints.size
        own = float(size[state.mask].sum())
        sides = np.stack([size, size * state.mask], axis=1).astype(np.float32)
        now, kept = (masks.astype(np.float32) @ sides).T
        changed = now + own - 2 * kept
        # Nobody clicks early to change a superpoint or two; later that may be all that is wrong.
        said = max(len(state.positive) + len(state.negative) - sum(state.agreed), 1)
        said += _REGION_SAYS * state.drawn
        early = np.exp(-(said - 1) / 2)
        idle = changed <= min(_IDLE_CELLS * size.mean(), _IDLE_SHARE * own)
        # And nobody clicks late to throw away most of what is there, unless nothing else helps.
        against = _IDLE_PENALTY * early * idle
        # But what was chosen or drawn is not thrown away because a click brought little.
        loss = _LOSS_PENALTY * (_CHOSEN if state.drawn else 1 / (1 + state.stalls))
        against += loss * (1 - early) * lost
        least, most = self._bounds(state, positive)
        log_now = np.log(np.maximum(now, 1))
        over, under = log_now - np.log(max(most, 1)), np.log(max(least, 1)) - log_now
        against += _SIZE_PENALTY * np.clip(np.maximum(over, under), 0, _SIZE_MOST)
        apart = ((self.superpoints.center - self.superpoints.center[superpoint]) ** 2).sum(1)
        other = state.mask != state.mask[superpoint]
        near = float(size[apart < apart[other].min()].sum() if other.any() else size.sum())
        # Nobody wants a part of a handful of nodes, whoever takes something away least of all.
        speck = np.log(np.minimum(_SPECK_NODES, own) / np.maximum(now, 1.0))
        against += _SPECK_PENALTY * np.clip(speck, 0, _SPECK_MOST)
        # Who clicks right beside the border of a mask means what is there.
        far = np.log(np.maximum(changed, 1.0) / (_FAR * max(near, 1e-9)))
        against += self._far_penalty * np.clip(far, 0, _FAR_MOST)
        # A first answer that lies far from the next click was a detail: the handle of a door.
        detail = near > own and not state.mask[superpoint]
        run = state.run if positive else -state.run
        stalls = state.stalls + self._run_stalls * max(run - _RUN_FREE, 0)
        if stalls or detail:
            # Who clicks again after a click in vain means more than the last answers gave.
            share = min(_STALL_DEMAND * _STALL_GROWTH**stalls, _STALL_MOST)
            wanted = min(share * (near if detail else own), self._stall_ball * near)
            against += _STALL_PENALTY * np.clip(1 - changed / max(wanted, 1.0), 0, 1)
        return against

    def _first_answer(
        self, after: PartState, superpoint: int, blocked: Bool | None, of_a_part: bool
    ) -> Ranked:
        clicked = Clicked(after.positive, after.negative, superpoint, True)
        if not after.positive:
            empty = Candidates.of([np.zeros(len(self.superpoints), bool)], "keep")
            return Ranked(empty, self.describe(empty, clicked), np.zeros(1, np.float32))
        found = (
            self.part_regions(superpoint, after.negative)
            if of_a_part
            else self.first_regions(superpoint)
        )
        if blocked is not None:
            found = replace(found, masks=found.masks & ~blocked)
        if after.negative:
            clean = ~found.masks[:, list(after.negative)].any(1)
            if clean.any():
                found = found.take(np.nonzero(clean)[0])
        found = self._finish(found, after, blocked)
        features = self.describe(found, clicked)
        scores = self._rule(found, clicked) if self._first is None else self._first(features)
        if of_a_part:
            features, scores = self._as_part(found, features, scores, clicked)
        against = self._no_part(found.masks, after, blocked, of_a_part)
        return Ranked(found, features, scores - against)

    def _no_part(
        self, masks: Bool, after: PartState, blocked: Bool | None, of_a_part: bool
    ) -> Float:
        """(H,) what speaks against first answers whatever they look like: nobody clicks for nearly
        all that other parts have left, most of the object, or a speck.

        A part moves against something, and what nobody claims is the base without a click.
        """
        held, size = self._nodes(masks), self.superpoints.size
        free = size if blocked is None else size[~blocked]
        share = held / max(float(free.sum()), 1e-9)
        against = _ALL_PENALTY * np.clip((share - NEARLY_ALL) / _ALL_RAMP, 0, 1)
        # Who has clicked other parts is after those that move, not after the base.
        beside = bool(after.negative) or (blocked is not None and bool(blocked.any()))
        if beside or of_a_part:
            against += (self._large_beside if beside else self._large_penalty) * self._large(held)
        speck = np.log(self._first_speck / np.maximum(held, 1.0))
        against += _SPECK_PENALTY * np.clip(speck, 0, _SPECK_MOST)
        larger = np.log(np.maximum(held, 1.0) / (_DETAIL * size.sum()))
        return against + self._detail_penalty * (
            1 - np.clip(larger / np.log(_NO_DETAIL / _DETAIL), 0, 1)
        )

    def _large(self, held: Float) -> Float:
        """(H,) 0..1 how much more than half of the object masks of ``held`` (H,) nodes are."""
        share = held / self.superpoints.size.sum()
        return np.clip((share - _LARGE) / _LARGE_RAMP, 0, 1)

    def _nodes(self, masks: Bool) -> Float:
        """(H,) nodes in each mask."""
        return masks.astype(np.float32) @ self.superpoints.size.astype(np.float32)

    def _region_hypotheses(
        self, state: PartState, after: PartState, superpoint: int, positive: bool
    ) -> Candidates:
        assert state.mask is not None
        mask, positives, negatives = state.mask, list(after.positive), list(after.negative)
        chain = self.chain(superpoint)
        keep = mask.copy()
        keep[superpoint] = positive
        made = [Candidates.of([keep], "keep")]
        if positive:
            clean = ~chain.masks[:, negatives].any(1) if negatives else np.ones(len(chain), bool)
            usable = chain.take(np.nonzero(clean)[0])
            if len(usable):
                made.append(
                    replace(Candidates.of(list(usable.masks | mask), "grow"),
                            height=usable.height, life=usable.life)
                )  # fmt: skip
                whole = usable.masks[:, positives].all(1)
                if whole.any():
                    region = usable.take(np.nonzero(whole)[0])
                    made.append(replace(Candidates.of(list(region.masks), "replace"),
                                        height=region.height, life=region.life))  # fmt: skip
        else:
            clean = ~chain.masks[:, positives].any(1)
            usable = chain.take(np.nonzero(clean)[0])
            if len(usable):
                made.append(
                    replace(Candidates.of(list(mask & ~usable.masks), "cut"),
                            height=usable.height, life=usable.life)
                )  # fmt: skip
        made += self._unions(positives, negatives)
        return joined(made)

    def _unions(self, positives: list[int], negatives: list[int]) -> list[Candidates]:
        """At each level the regions of all positive clicks together, where no negative is in."""
        if not positives:
            return []
        labels = self._labels
        own = labels[:, positives]
        if negatives:
            hit = (labels[:, negatives][:, :, None] == own[:, None, :]).any((1, 2))
        else:
            hit = np.zeros(len(labels), bool)
        rows = np.nonzero(~hit)[0]
        made: list[Bool] = []
        for tree in range(len(TREES)):
            size = 0.0
            for row in rows[self._tree[rows] == tree]:
                regions = np.array(sorted(set(own[row].tolist())))
                now = float(self._sizes[regions + self._offset[row]].sum())
                if now < 1.15 * size or now > 0.97 * self.superpoints.size.sum():
                    continue
                size = now
                if len(regions) == 1:
                    made.append(labels[row] == regions[0])
                    continue
                chosen = np.zeros(int(labels[row].max()) + 1, bool)
                chosen[regions] = True
                made.append(chosen[labels[row]])
        if not made:
            return []
        made = made[-24:]
        return [Candidates.of(made, "union")]

    def _walks(self, mask: Bool, after: PartState) -> list[Candidates]:
        seeds, values = _seeds(after)
        flat = np.repeat(np.array(_BIASES, np.float32)[:, None], len(self.superpoints), axis=1)
        free = self._walk.fields(flat, seeds, values, 0)
        sets = _level_sets(self._walk, free[1], 3)
        before = np.where(mask, np.float32(1), np.float32(-1))[None]
        mended = [self._walk.fields(before, seeds, values, reach)[0] > 0 for reach in (1, 2)]
        return [Candidates.of(list(free > 0), "walk"), Candidates.of(mended, "mend"), *sets]

    def _mend(self, mask: Bool, after: PartState) -> list[Bool]:
        seeds, values = _seeds(after)
        prior = np.where(mask, np.float32(1), np.float32(-1))[None]
        return [self._walk.fields(prior, seeds, values, 1)[0] > 0]

    def _finish(self, found: Candidates, after: PartState, blocked: Bool | None) -> Candidates:
        masks = found.masks.copy()
        if blocked is not None:
            masks &= ~blocked
        masks[:, list(after.negative)] = False
        masks[:, list(after.positive)] = True
        return joined([replace(found, masks=masks)])

    def _rule(self, found: Candidates, clicked: Clicked) -> Float:
        """Scores without a trained scorer: strong borders, lasting regions, not too small."""
        features = self.describe(found, clicked)
        size = features[:, 0]
        prior = -0.5 * ((size - np.log(0.06)) / 1.6) ** 2
        if clicked.before is None:
            return features[:, 1] + 0.5 * features[:, 24] + 0.5 * prior
        return features[:, 1] / 9 + 0.1 * features[:, 25]


def _level_sets(walk: RandomWalk, field: Float, most: int) -> list[Candidates]:
    masks = walk.sweep(field, most)
    return [Candidates.of(list(masks), "sweep")] if len(masks) else []


def with_click(state: PartState, superpoint: int, positive: bool) -> PartState:
    """The clicks after one more; a superpoint is on the side where it was clicked last."""
    yes = tuple(c for c in state.positive if c != superpoint)
    no = tuple(c for c in state.negative if c != superpoint)
    if positive:
        return replace(state, positive=(*yes, superpoint), negative=no)
    return replace(state, positive=yes, negative=(*no, superpoint))


def agreeing(state: PartState, superpoint: int, positive: bool) -> PartState:
    """The clicks after one more that changes nothing: the part has ``superpoint``, or has it not.

    Whoever clicks five places of a door's glass has told where it is, but has mended nothing: so
    that the next click may still change much, such clicks don't count as steps.
    """
    new = superpoint not in (state.positive if positive else state.negative)
    yes, no = state.agreed
    agreed = (yes + (new and positive), no + (new and not positive))
    return replace(with_click(state, superpoint, positive), agreed=agreed)


def _seeds(state: PartState) -> tuple[npt.NDArray[np.int64], Float]:
    superpoints = np.array([*state.positive, *state.negative], np.int64)
    values = np.r_[np.ones(len(state.positive)), -np.ones(len(state.negative))]
    return superpoints, values.astype(np.float32)
