"""Propose boxes: a drawer is more than its front, and fills the box behind it.

Parts of furniture and appliances stand square to one another. Boxes along the object's main
directions are proposed around clicked regions, around the mask with them, behind flat fronts as
deep as the next surface that faces them, and between the object's planes. Planes along the sides of
such boxes cut off what a negative click means.

Objects of a room stand upright. Boxes reach from a clicked front, top or side as deep as furniture
is; planes between clicks separate cabinets that stand side by side.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from model.segmentation.arrays import Bool, Float, Float32, Float64, Int, Int16
from model.segmentation.encoding import Room
from model.segmentation.plane_boxes import BoxGrid, PlaneBoxes
from model.segmentation.proposals import BOX_SOURCE, PartState, Proposals, Regions, evenly
from model.segmentation.superpoints import Superpoints

_REGIONS = 10
"""Nested regions around a click that get a box."""
FRONTS = 4
"""Largest fronts that boxes are put behind."""
_PLANES, _BETWEEN, _OF_SIZES = 16, 12, 10
"""Most cutting planes, boxes between planes, and the same on a mesh."""
_WHOLE = 0.8
"""Share of a shell in a box above which the whole shell is proposed."""
_ALIKE_BOXES = 0.5
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
        planes: PlaneBoxes,
        regions: Regions,
        shells: Shells | None,
        of_mesh: bool,
    ) -> None:
        self._grid, self._planes = grid, planes
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
            tight = self._between((superpoint,), after.negative, self._most // 2) | mask
            out = [around, deep, own, tight]
        else:
            without = mask & ~grid.contents(low, high)
            outside = mask & ~self._between((superpoint,), after.positive, self._most)
            out = [without, outside, self._cut(mask, low, high, after, superpoint)]
        if after.positive:
            out.append(self._between(after.positive, after.negative, self._most))
            out.append(self._alike(mask, after.positive, after.negative))
        return [shaped_proposals(out, self._shells)]

    def _between(self, inside: tuple[int, ...], outside: tuple[int, ...], most: int) -> Bool:
        """(H, C) the least leaking boxes between planes that hold some superpoints and not others.

        On clouds they aren't alike; on a mesh there is one of each size.
        """
        found = self._planes.holding(self._places(inside), self._places(outside))
        return self._contents(found.of_all_sizes(most) if self._of_mesh else found.apart(most))

    def _alike(self, mask: Bool, inside: tuple[int, ...], outside: tuple[int, ...]) -> Bool:
        """(H, C) boxes that hold some superpoints and not others, like the mask's own box."""
        (low,), (high,) = self._grid.bounds(mask[None])
        found = self._planes.holding(self._places(inside), self._places(outside))
        alike = np.nonzero(found.overlap(low, high) >= _ALIKE_BOXES)[0]
        return self._contents(found.take(alike[: self._most]))

    def _places(self, superpoints: tuple[int, ...]) -> Int16:
        return self._grid.place[:, list(superpoints)].astype(np.int16)

    def _contents(self, boxes: PlaneBoxes) -> Bool:
        return self._grid.contents(boxes.low.T, boxes.high.T, 0)

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


_MARGIN = 0.03
"""Metres by which a box is widened."""
_THIN = 0.15
"""Metres: a thinner box is a front, a side or a top."""
_TOP = 1.3
"""Metres above the floor below which a horizontal top stands on it."""
_DEPTHS = (0.35, 0.65)
"""Metres: usual depths of wall and base cabinets."""
_BOXES = 16
_CUTS, _PEAKS = 24, 3
_CUT_STEP, _LEAST_CUT = 0.02, 0.04
"""Metres between tried planes, and least metres between clicks for one to be tried."""
_LARGEST = 0.15
"""Largest share of the room that an object has."""
_GAP = 9.0
"""Strength of a plane that no link of the mask crosses."""


def bounds_of(masks: Bool, position: Float32) -> tuple[Float, Float]:
    """Lowest and highest corners (H, 3) of the boxes around masks; 0 for empty ones."""
    used = masks.any(0)
    some, at = masks[:, used], position[used]
    low, high = np.empty((len(masks), 3), np.float32), np.empty((len(masks), 3), np.float32)
    for axis in range(3):
        low[:, axis] = np.where(some, at[:, axis], np.float32(np.inf)).min(1, initial=np.inf)
        high[:, axis] = np.where(some, at[:, axis], np.float32(-np.inf)).max(1, initial=-np.inf)
    empty = ~masks.any(1)
    low[empty] = high[empty] = 0.0
    return low, high


def contents_of(room: Room, low: Float, high: Float) -> Bool:
    """(B, C) superpoints in boxes (B, 3), without floor and walls."""
    p = room.position
    out = np.repeat(~room.border[None], len(low), axis=0)
    for axis in range(3):
        out &= (p[:, axis] >= low[:, axis, None] - _MARGIN) & (
            p[:, axis] <= high[:, axis, None] + _MARGIN
        )
    return out


class RoomBoxes:
    """The proposal source of boxes in rooms."""

    moving_only = False

    def __init__(self, superpoints: Superpoints, room: Room, regions: Regions) -> None:
        self._superpoints, self._room, self._regions = superpoints, room, regions
        self._size = superpoints.size.astype(np.float32)
        self._most = _LARGEST * superpoints.size.sum()

    def first(self, superpoint: int, outside: tuple[int, ...]) -> list[Proposals]:
        """Boxes from nested regions as deep as furniture is."""
        del outside
        masks = self._some(self._regions.nested(superpoint).masks)
        return self._boxed(*self._deeper(*bounds_of(masks, self._room.position)))

    def later(
        self, before: PartState, after: PartState, superpoint: int, positive: bool
    ) -> list[Proposals]:
        """Boxes around the mask and a region, or the mask on one side of planes."""
        assert before.mask is not None
        regions = self._some(self._regions.nested(superpoint).masks)
        position = self._room.position
        if not positive:
            return self._cut(before.mask, regions, after, superpoint)
        low, high = bounds_of(regions | before.mask, position)
        clicked = np.zeros((1, len(position)), bool)
        clicked[0, list(after.positive)] = True
        own_low, own_high = bounds_of(clicked, position)
        return self._boxed(np.concatenate([low, own_low]), np.concatenate([high, own_high]))

    def _some(self, masks: Bool) -> Bool:
        """At most ``_BOXES`` of the masks, of all sizes that an object may have."""
        size = masks.astype(np.float32) @ self._size
        fit = np.nonzero(size <= self._most)[0]
        if len(fit) > _BOXES:
            fit = evenly(fit[np.argsort(size[fit], kind="stable")], _BOXES)
        return masks[fit]

    def _deeper(self, low: Float, high: Float) -> tuple[Float, Float]:
        """The boxes themselves, and thin ones as deep as furniture: upright ones to both sides,
        horizontal ones down to the floor.
        """
        lows, highs = [low], [high]
        side = high - low
        for axis in (0, 1):
            flat = (side[:, axis] < _THIN) & (side[:, axis] <= side[:, 1 - axis])
            for depth in _DEPTHS:
                wide = np.zeros(3, np.float32)
                wide[axis] = depth
                lows.append(low[flat] - wide)
                highs.append(high[flat] + wide)
        level = (side[:, 2] < _THIN) & (low[:, 2] < _TOP)
        down = low[level].copy()
        down[:, 2] = _MARGIN
        lows.append(down)
        highs.append(high[level])
        return np.concatenate(lows), np.concatenate(highs)

    def _boxed(self, low: Float, high: Float) -> list[Proposals]:
        if not len(low):
            return []
        masks = contents_of(self._room, low, high)
        size = masks.astype(np.float32) @ self._size
        masks = masks[(size > 0) & (size <= self._most)]
        return [Proposals.of(masks, "union")] if len(masks) else []

    def _cut(self, mask: Bool, regions: Bool, after: PartState, superpoint: int) -> list[Proposals]:
        """The mask on one side of vertical and horizontal planes.

        The planes are the sides of the boxes around the clicked regions, and planes between the
        click and the part's own clicks, through the strongest cuts or halfway: fronts of cabinets
        that stand side by side are one surface.
        """
        position = self._room.position
        kept = position[list(after.positive)]
        links = self._superpoints.links
        inside = np.nonzero(mask[links.a] & mask[links.b])[0]
        low, high = bounds_of(regions[~regions[:, list(after.positive)].any(1)], position)
        made: list[Bool] = []
        for axis in range(3):
            for bound, sign in ((low, 1.0), (high, -1.0)):
                spot = sign * float(position[superpoint, axis])
                nearest = float((sign * kept[:, axis]).max()) if len(kept) else -np.inf
                edges = sign * np.unique(bound[:, axis].round(2)) - 1e-3
                if np.isfinite(nearest) and spot - nearest > _LEAST_CUT:
                    edges = np.r_[edges, self._planes(inside, axis, sign, nearest, spot)]
                for edge in edges[(edges > nearest) & (edges <= spot)]:
                    stays = sign * position[:, axis] < edge
                    if not stays[superpoint] and (mask & stays).any():
                        made.append(mask & stays)
        if not made:
            return []
        size = np.array([self._superpoints.size[m].sum() for m in made])
        best = np.argsort(-size, kind="stable")[:_CUTS]
        return [Proposals.of([made[int(k)] for k in best], "cut")]

    def _planes(self, inside: Int, axis: int, sign: float, start: float, end: float) -> Float:
        """Coordinates between two others at which the links ``inside`` a mask look most like cuts,
        and the middle.
        """
        links, at = self._superpoints.links, sign * self._room.position[:, axis]
        a, b = at[links.a[inside]], at[links.b[inside]]
        number = max(int((end - start) / _CUT_STEP), 2)
        low, high = (
            np.clip(((side - start) / (end - start) * number).astype(np.int64), 0, number)
            for side in (np.minimum(a, b), np.maximum(a, b))
        )
        profile = []
        for weight in (links.strength[inside], links.count[inside]):
            passed = np.bincount(low, weight, number + 1) - np.bincount(high, weight, number + 1)
            profile.append(np.cumsum(passed)[:number])
        mean = profile[0] / np.maximum(profile[1], 1.0)
        mean[profile[1] < 1] = _GAP
        around = np.maximum(np.r_[0, mean[:-1]], np.r_[mean[1:], 0])
        peaks = np.nonzero(mean >= around)[0]
        peaks = peaks[np.argsort(-mean[peaks], kind="stable")[:_PEAKS]]
        cuts = np.r_[peaks, (number - 1) / 2] + 0.5
        return start + cuts * (end - start) / number
