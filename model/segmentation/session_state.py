"""State of a session after all prompts so far, and its update by each prompt.

The state after some prompts is a pure function of them, so undo is going back to an earlier one.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from model.segmentation.arrays import Bool
from model.segmentation.encoding import Encoding
from model.segmentation.fronts import BAR_LENGTH
from model.segmentation.labels import LabelFinisher
from model.segmentation.prompt_steps import ClickStep, RegionStep, Step
from model.segmentation.prompts import BASE
from model.segmentation.proposals import PartState
from model.segmentation.scores import ALONE_MARGIN, NEARLY_ALL
from model.segmentation.solver import PartSolver, ScoredProposals

_TRIED = 12
"""First answers of a mesh that are tried for one that takes no more than ``NEARLY_ALL``."""
_INEFFECTIVE = 2
"""Ineffective clicks after which, in a room, one beside the part adds a region of its own."""
_LITTLE, _LITTLE_OF_PART = 0.002, 0.1
"""Shares of the room and of the part below which such a click added little,"""
_FAR_LARGER, _FAR_LARGER_LITTLE = 0.5, 20
"""and share of the part, or factor of little, above which a region is too large."""
_CHOSEN_SHARE = 0.1
"""Share of the mask above which a region was chosen or drawn to replace what clicks gave."""


@dataclass(frozen=True, eq=False)
class SessionState:
    """State of a session after some prompts.

    Attributes:
        parts: masks and clicks of the parts other than the base.
        base: superpoints clicked as base.
        scored: the proposals of the latest click of each part.
    """

    parts: dict[int, PartState] = field(default_factory=dict)
    base: tuple[int, ...] = ()
    scored: dict[int, ScoredProposals] = field(default_factory=dict)

    def with_mask(self, part: int, mask: Bool) -> SessionState:
        """The state if ``part`` had other superpoints."""
        parts = {
            other: its if its.mask is None else replace(its, mask=its.mask & ~mask)
            for other, its in self.parts.items()
        }
        parts[part] = replace(self.parts.get(part, PartState()), mask=mask)
        return replace(self, parts=parts)


class StateUpdates:
    """The change of the state by each prompt."""

    def __init__(
        self, encoding: Encoding, solver: PartSolver, finisher: LabelFinisher, moving: bool
    ) -> None:
        """``moving``: first clicks mean parts that move; see :meth:`.PartSolver.answer`."""
        self._superpoints = encoding.superpoints
        self._elements = encoding.nodes.elements
        self._walk = encoding.walk
        self._solver, self._finisher, self._moving = solver, finisher, moving
        # An object's own proposals reach far enough; a room's objects are many regions.
        self._adds_regions = encoding.room is not None
        fronts = None if solver.moving_parts is None else solver.moving_parts.fronts
        self._fronts = fronts if moving else None

    def after(self, state: SessionState, steps: tuple[Step, ...]) -> SessionState:
        """The state after the last of ``steps``, from that before it.

        Small components enter the masks, as the next click is about what the person sees.
        """
        after = self._after_step(state, steps)
        if self._finisher.joins_components and after.parts:
            of_superpoint = self._finisher.of_superpoints(after.parts, steps)
            parts = {
                part: its
                if its.mask is None
                else replace(its, mask=its.mask | (of_superpoint == part))
                for part, its in after.parts.items()
            }
            after = replace(after, parts=parts)
        return after

    def preview(self, superpoint: int) -> Bool:
        """(C,) the superpoints that a first click would take."""
        found = self._solver.first_answer(superpoint, moving=self._moving)
        best = found.best
        if self._finisher.attached is not None:
            node = int(np.argmax(self._superpoints.of_node == superpoint))
            element = int(self._elements.element_of_node[node])
            found = self._with_mount(found, PartState(), element, None)
            step = ClickStep(1, True, element, node)
            best = self._leaving_base(found, SessionState(), (step,))
        mask = self._solver.tidy(best, PartState(), superpoint)
        return self._finisher.with_components(mask.astype(np.int16), ()) > BASE

    def _after_step(self, state: SessionState, steps: tuple[Step, ...]) -> SessionState:
        step = steps[-1]
        if isinstance(step, RegionStep):
            return self._after_region(state, step)
        superpoint = int(self._superpoints.of_node[step.node])
        if step.part == BASE:
            return self._after_base_click(state, superpoint, step.positive)
        parts, scored = dict(state.parts), dict(state.scored)
        before = parts.get(step.part, self._new_part(state, step.part))
        others = {q: s for q, s in parts.items() if q != step.part and s.mask is not None}
        handle: Bool | None = None
        if before.mask is not None and bool(before.mask[superpoint]) == step.positive:
            parts[step.part] = before.with_confirming_click(superpoint, step.positive)
        else:
            blocked = _union(
                (s.mask for s in others.values() if step.positive and not s.mask[superpoint]),  # type: ignore[index]
                len(self._superpoints),
            )
            if step.positive and before.mask is None:
                handle = self._handle_of_other(superpoint, others)
            if handle is not None:
                blocked |= ~handle
            parts[step.part], scored[step.part] = self._answered(
                state, steps, before, superpoint, blocked
            )
        if step.positive:
            self._take_from_others(step.part, superpoint, others, parts, scored, handle)
        return SessionState(parts, state.base, scored)

    def _answered(
        self,
        state: SessionState,
        steps: tuple[Step, ...],
        before: PartState,
        superpoint: int,
        blocked: Bool,
    ) -> tuple[PartState, ScoredProposals]:
        """A part after a click that its mask disagrees with, and the click's proposals."""
        step = steps[-1]
        assert not isinstance(step, RegionStep)
        first = step.positive and before.mask is None
        self._walk.prefetch(superpoint)
        found = self._solver.answer(before, superpoint, step.positive, blocked, moving=self._moving)
        best = found.best
        if first and self._finisher.attached is not None:
            found = self._with_mount(found, before, step.element, blocked)
            best = self._leaving_base(found, state, steps)
        mask = self._solver.tidy(best, before, superpoint) & ~blocked
        if (
            self._adds_regions
            and step.positive
            and not first
            and before.ineffective >= _INEFFECTIVE
        ):
            mask = self._with_region_of_click(before, mask, superpoint, blocked)
        return self._solver.moved(before, superpoint, step.positive, mask), found

    def _take_from_others(
        self,
        part: int,
        superpoint: int,
        others: dict[int, PartState],
        parts: dict[int, PartState],
        scored: dict[int, ScoredProposals],
        handle: Bool | None,
    ) -> None:
        """Take the new superpoints of ``part`` from the other parts, in place."""
        taken = parts[part].mask
        assert taken is not None
        for q, other in others.items():
            assert other.mask is not None
            if other.mask[superpoint] and handle is None:
                # The click shows that this part was too large: answer its clicks again.
                rest = _union((s.mask for r, s in parts.items() if r != q), len(taken))
                parts[q], scored[q] = self._without(other, superpoint, rest)
            else:
                parts[q] = replace(
                    other.with_confirming_click(superpoint, False), mask=other.mask & ~taken
                )

    def _without(
        self, state: PartState, superpoint: int, rest: Bool
    ) -> tuple[PartState, ScoredProposals]:
        """A part after a click on something else that it held, and its proposals.

        With fronts, a part of one click is answered anew, knowing more; otherwise the mask is
        corrected. On meshes and in rooms the mask says more than a first click.

        Args:
            rest: (C,) superpoints of the other parts.
        """
        if self._fronts is None or len(state.positive) != 1 or state.drawn or state.streak:
            found = self._solver.answer(state, superpoint, False, rest, moving=self._moving)
            return self._solver.moved(state, superpoint, False, found.best & ~rest), found
        (first,) = state.positive
        new = PartState(negative=state.negative, confirmed=(0, state.confirmed[1]))
        new = new.with_confirming_click(superpoint, False)
        blocked = rest.copy()
        blocked[first] = False
        found = self._solver.answer(new, first, True, blocked)
        mask = self._solver.tidy(found.best, new, first) & ~blocked
        return self._solver.moved(new, first, True, mask), found

    def _handle_of_other(self, superpoint: int, others: dict[int, PartState]) -> Bool | None:
        """(C,) the handle at a superpoint, if another part holds it and the front behind it.

        A person who clicks there wants the handle as a part, not half of the door.
        """
        bar = None if self._fronts is None else self._fronts.bar(superpoint)
        if bar is None or bar.length < BAR_LENGTH:
            return None
        size = self._superpoints.size
        for other in others.values():
            mask = other.mask
            assert mask is not None
            behind = size[mask & bar.behind].sum()
            if mask[superpoint] and behind > 0.5 * size[bar.behind].sum():
                return bar.superpoints | (np.arange(len(size)) == superpoint)
        return None

    def _with_mount(
        self, found: ScoredProposals, state: PartState, element: int, blocked: Bool | None
    ) -> ScoredProposals:
        """First answers to a click on a mesh's handle: the answers to a click beside it, on the
        part that it moves, then the handle alone.

        Args:
            found: the answers to the click itself, on ``element``.
        """
        attached = self._finisher.attached
        face = attached.mount(element) if attached is not None and self._moving else None
        if face is None:
            return found
        superpoint, beside = (
            int(self._superpoints.of_node[self._elements.node_of_element[f]])
            for f in (element, face)
        )
        if superpoint == beside or (blocked is not None and blocked[beside]):
            return found
        moved = self._solver.answer(state, beside, True, blocked)
        masks = moved.proposals.masks.copy()
        masks[:, superpoint] = True
        moved = replace(moved, proposals=moved.proposals.with_masks(masks))
        alone = found.take(np.flatnonzero(~found.proposals.masks[:, beside]))
        if not len(alone.scores):
            return moved
        behind = alone.scores.max() - moved.scores.max() + ALONE_MARGIN
        lowered = replace(alone, scores=alone.scores - max(behind, 0.0))
        return ScoredProposals.of([moved, lowered])

    def _leaving_base(
        self, found: ScoredProposals, state: SessionState, steps: tuple[Step, ...]
    ) -> Bool:
        """The best first answer of a mesh that leaves enough of the base.

        The penalties see to that for superpoints, but whole facets and shells may be far more.
        """
        masks, part, weight = found.proposals.masks, steps[-1].part, self._finisher.weight
        for index in found.order[:_TRIED]:
            tried = state.with_mask(part, masks[index])
            labels = self._finisher.labels(steps, tried.parts)
            taken, left = (weight[labels == p].sum() for p in (part, BASE))
            if taken <= NEARLY_ALL * (taken + left):
                return masks[index]
        return found.best

    def _with_region_of_click(
        self, before: PartState, mask: Bool, superpoint: int, blocked: Bool
    ) -> Bool:
        """``mask``, with a region around the click if that added hardly anything.

        A person who keeps clicking beside a part means more: the best first answer there that is
        neither very small nor far larger than the part joins it.
        """
        size, center = self._superpoints.size, self._superpoints.center
        assert before.mask is not None
        own = size[before.mask].sum()
        least = min(_LITTLE * size.sum(), _LITTLE_OF_PART * own)
        if size[mask & ~before.mask].sum() >= least:
            return mask
        apart = ((center - center[superpoint]) ** 2).sum(1)
        if size[apart < apart[before.mask].min()].sum() < least:
            # Right beside the part a click means what it brought: the mask is nearly perfect.
            return mask
        most = max(_FAR_LARGER * own, _FAR_LARGER_LITTLE * least)
        first = self._solver.first_answer(superpoint)
        for index in first.order:
            more = first.proposals.masks[index] & ~blocked
            if not more[superpoint] or more[list(before.negative)].any():
                continue
            if least <= size[more & ~mask].sum() <= most:
                return mask | more
        return mask

    def _new_part(self, state: SessionState, part: int) -> PartState:
        """A part without clicks; superpoints clicked for other parts are not in it."""
        clicked = [c for q, s in state.parts.items() if q != part for c in s.positive]
        foreign = tuple(dict.fromkeys([*state.base, *clicked]))
        return PartState(negative=foreign, confirmed=(0, len(foreign)))

    def _after_base_click(
        self, state: SessionState, superpoint: int, positive: bool
    ) -> SessionState:
        base = tuple(c for c in state.base if c != superpoint)
        if not positive:
            return replace(state, base=base)
        parts, scored = dict(state.parts), dict(state.scored)
        for part, its in state.parts.items():
            if its.mask is not None and its.mask[superpoint]:
                none = np.zeros(len(its.mask), bool)
                parts[part], scored[part] = self._without(its, superpoint, none)
            else:
                parts[part] = its.with_confirming_click(superpoint, False)
        return SessionState(parts, (*base, superpoint), scored)

    def _after_region(self, state: SessionState, step: RegionStep) -> SessionState:
        of_node, size = self._superpoints.of_node, self._superpoints.size
        inside = np.bincount(of_node[step.nodes], minlength=len(size)) > 0.5 * size
        parts = dict(state.parts)
        for part, its in state.parts.items():
            if its.mask is not None and (step.positive or part == step.part):
                parts[part] = replace(its, mask=its.mask & ~inside)
        if step.positive and step.part != BASE:
            its = parts.get(step.part, self._new_part(state, step.part))
            mask = its.mask if its.mask is not None else np.zeros(len(size), bool)
            parts[step.part] = replace(its, mask=mask | inside)
        before, now = state.parts.get(step.part), parts.get(step.part)
        if before is not None and before.positive and before.mask is not None and now is not None:
            assert now.mask is not None
            changed = size[now.mask ^ before.mask].sum()
            if changed > _CHOSEN_SHARE * size[now.mask].sum():
                parts[step.part] = replace(now, drawn=before.drawn + 1)
        return replace(state, parts=parts)


def _union(masks: Iterable[Bool | None], count: int) -> Bool:
    out = np.zeros(count, bool)
    for mask in masks:
        if mask is not None:
            out |= mask
    return out
