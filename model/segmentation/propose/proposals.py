"""Masks proposed for a click, and the port of whatever proposes them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from model.segmentation.arrays import Bool, Float, Int8, Int64
from model.segmentation.part_state import PartState

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
        """Those at ``index``."""
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
