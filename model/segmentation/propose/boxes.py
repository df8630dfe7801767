"""Propose boxes: a drawer is more than its front, and fills the box behind it.

Parts of furniture and appliances stand square to one another. Boxes along the object's main
directions are proposed around clicked regions, around the mask with them, behind flat fronts as
deep as the next surface that faces them, and between the object's planes. Planes along the sides of
such boxes cut off what a negative click means.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from model.segmentation.arrays import Bool, Float64, Int, Int16, Int64
from model.segmentation.part_state import PartState
from model.segmentation.propose.box_grid import BoxGrid
from model.segmentation.propose.box_ranking import BoxRanker, RankedBoxes
from model.segmentation.propose.proposals import BOX_SOURCE, Proposals, evenly
from model.segmentation.propose.regions import Regions

_REGIONS = 10
"""Nested regions around a click that get a box."""
FRONTS = 4
"""Largest fronts that boxes are put behind."""
_PLANES, _BETWEEN, _OF_SIZES = 16, 12, 10
"""Most cutting planes, boxes between planes, and the same on a mesh."""
_WHOLE = 0.8
"""Share of a shell in a box above which the whole shell is proposed."""
_ALIKE = 0.5
"""Volume overlap of boxes that are alike."""


class Shells:
    """The connected shells of a mesh; boxes are also proposed as the whole shells within them."""

    def __init__(self, shell: Int, size: Float64) -> None:
        """``shell`` (C,) of each superpoint; ``size`` (C,) its nodes."""
        _, self._of = np.unique(shell, return_inverse=True)
        number = int(self._of.max()) + 1
        at = np.arange(len(self._of))
        self._held = csr_matrix((size.astype(np.float32), (self._of, at)), (number, len(at)))
        self._size = np.bincount(self._of, size, number).astype(np.float32)

    def within(self, masks: Bool) -> Bool:
        """(H, C) the shells that lie nearly whole in each mask."""
        held = self._held @ masks.T.astype(np.float32)
        return (held > _WHOLE * self._size[:, None]).T[:, self._of]


def shaped_proposals(masks: list[Bool], shells: Shells | None) -> Proposals:
    """Boxes or rectangles (H, C) as proposals, on a mesh also the shells within them."""
    every = np.concatenate(masks)
    if shells is not None:
        every = np.concatenate([every, shells.within(every)])
    return Proposals.of(every[every.any(1)], BOX_SOURCE)


class Boxes:
    """The proposal source of boxes on objects."""

    moving_only = False

    def __init__(
        self,
        grid: BoxGrid,
        ranker: BoxRanker,
        regions: Regions,
        shells: Shells | None,
        of_mesh: bool,
    ) -> None:
        """``of_mesh``: take one box between planes of each size, instead of the likeliest."""
        self._grid, self._ranker = grid, ranker
        self._regions, self._shells = regions, shells
        self._of_mesh = of_mesh
        self._most = _OF_SIZES if of_mesh else _BETWEEN

    def first(self, superpoint: int, outside: tuple[int, ...]) -> list[Proposals]:
        """Boxes around nested regions, behind flat ones, and between planes."""
        del outside
        regions, grid = self._some(self._regions.nested(superpoint).masks), self._grid
        low, high = grid.bounds(regions)
        deep = grid.contents(*grid.behind(low, high, FRONTS))
        around = grid.contents(low, high) | regions
        between = self._between((superpoint,), (), self._most)
        return [shaped_proposals([around, deep, between], self._shells)]

    def later(
        self, before: PartState, after: PartState, superpoint: int, positive: bool
    ) -> list[Proposals]:
        """Boxes that widen the mask, or the mask without boxes and beyond planes."""
        assert before.mask is not None
        mask, grid = before.mask, self._grid
        regions = self._some(self._regions.nested(superpoint).masks)
        low, high = grid.bounds(regions)
        if positive:
            wider = regions | mask
            around = grid.contents(*grid.bounds(wider)) | wider
            deep = grid.contents(*grid.behind(low, high, FRONTS)) | mask
            own = (grid.contents(low, high) | mask)[::2]
            tight = self._tight(superpoint, after.negative, self._most // 2) | mask
            out = [around, deep, own, tight]
        else:
            without = mask & ~grid.contents(low, high)
            outside = mask & ~self._tight(superpoint, after.positive, self._most)
            out = [without, outside, self._cut(mask, low, high, after, superpoint)]
        if after.positive:
            out.append(self._between(after.positive, after.negative, self._most))
            out.append(self._alike(mask, after.positive, after.negative))
        return [shaped_proposals(out, self._shells)]

    def _between(self, inside: tuple[int, ...], outside: tuple[int, ...], most: int) -> Bool:
        """(H, C) the likeliest boxes between planes that hold some superpoints and not others."""
        ranked = self._ranker(inside, outside)
        return self._contents(ranked, self._few(ranked, most))

    def _tight(self, superpoint: int, outside: tuple[int, ...], most: int) -> Bool:
        """(H, C) the least leaking boxes that hold a superpoint and not others."""
        ranked = self._ranker.tight(superpoint, outside)
        return self._contents(ranked, self._few(ranked, most))

    def _few(self, ranked: RankedBoxes, most: int) -> Int64:
        return ranked.of_all_sizes(most) if self._of_mesh else ranked.apart(most)

    def _alike(self, mask: Bool, inside: tuple[int, ...], outside: tuple[int, ...]) -> Bool:
        """(H, C) boxes that hold some superpoints and not others, like the mask's own box."""
        low, high = self._grid.bounds(mask[None])
        ranked = self._ranker(inside, outside)
        return self._contents(ranked, ranked.alike(low, high, _ALIKE)[: self._most])

    def _contents(self, ranked: RankedBoxes, index: Int64) -> Bool:
        return self._grid.contents(ranked.low[:, index].T, ranked.high[:, index].T, 0)

    def _some(self, masks: Bool) -> Bool:
        """At most ``_REGIONS`` of the masks, of all sizes."""
        size = masks.astype(np.float32) @ self._grid.size
        return masks[evenly(np.argsort(size, kind="stable"), _REGIONS)]

    def _cut(self, mask: Bool, low: Int16, high: Int16, after: PartState, superpoint: int) -> Bool:
        """(H, C) the mask on one side of planes, which keep all positive clicks.

        The planes run along the sides of boxes, and halfway between ``superpoint`` and the
        positive clicks.
        """
        place = self._grid.place
        spot = place[:, superpoint].astype(int)
        kept = place[:, list(after.positive)].astype(int)
        stays: list[Bool] = []
        for axis in range(3):
            inner, outer = int(kept[axis].min(initial=255)), int(kept[axis].max(initial=0))
            upper = {int(v) - 1 for v in low[:, axis]} | {(outer + int(spot[axis])) // 2}
            lower = {int(v) + 1 for v in high[:, axis]} | {(inner + int(spot[axis]) + 1) // 2}
            stays += [place[axis] <= v for v in sorted(upper) if outer <= v < spot[axis]]
            stays += [place[axis] >= v for v in sorted(lower) if spot[axis] < v <= inner]
        if not stays:
            return np.zeros((0, len(mask)), bool)
        made = np.stack(stays) & mask
        size = made.astype(np.float32) @ self._grid.size
        return made[evenly(np.argsort(-size, kind="stable"), _PLANES)]
