"""State of one part after the clicks so far, in superpoints."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from model.segmentation.arrays import Bool, Float

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
