"""Whole rooms: clicks mean objects there, not parts, and floor and walls hold nothing together.

Objects of a room stand upright, so boxes along its walls are hypotheses of their own: what a
clicked front, top or side belongs to, as deep as furniture is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from model.core.asset import Asset
from model.core.point_cloud import PointCloud
from model.geometry.crop import ROOM_METRES, floor_and_walls, largest_piece
from model.segmentation.describe.masks import (
    FEATURE_NAMES,
    Candidates,
    Clicked,
    MaskDescriber,
    joined,
)
from model.segmentation.encode.hierarchy import Hierarchy
from model.segmentation.encode.nodes import Nodes
from model.segmentation.encode.random_walk import RandomWalk
from model.segmentation.encode.superpoints import Superpoints
from model.segmentation.score.trees import Scorer
from model.segmentation.solver import PartSolver, PartState

Bool = npt.NDArray[np.bool_]
Float = npt.NDArray[np.floating]

ROOM_FEATURES = (
    "on_border", "long_side", "short_side", "height_metres", "bottom", "top", "box_filled",
    "box_growth", "click_outside",
)  # fmt: skip
ROOM_FEATURE_NAMES = (*FEATURE_NAMES, *ROOM_FEATURES)

_LEAST_FLOOR, _BAND, _LEVEL = 0.05, 0.06, 0.9
"""Share of the nodes that a floor has at least, metres it is uneven, upward part of its normal."""
_LOWEST = 0.25
"""Metres above the lowest points in which a floor is looked for."""
_LONE = 0.7
"""Share of a wide scan without a floor in one piece: it is a lone object."""
_FENCE = 9.0
_MARGIN = 0.03
_THIN = 0.15
_DEPTHS = (0.35, 0.65)
"""Metres that wall and base cabinets are deep."""
_BOXES = 16
_CUTS, _PEAKS = 24, 3
_CUT_STEP, _LEAST_CUT = 0.02, 0.04
"""Metres between planes that are tried, and between clicks for one to be tried at all."""
_LARGEST = 0.15
"""Share of the room: what is larger is no object."""


@dataclass(frozen=True, eq=False)
class Room:
    """What is known of a room.

    Attributes:
        border: (C,) superpoints of floor, ceiling and walls.
        position: (C, 3) float32 metres, turned so that most walls lie along x and y; z from the
            floor.
    """

    border: Bool
    position: npt.NDArray[np.float32]


def room_of(asset: Asset, nodes: Nodes, superpoints: Superpoints) -> Room | None:
    """The room that a scan shows, or None where it shows a lone object.

    A room is wide, and has a floor, or many things in it where floor and walls were left out.
    """
    if asset.cloud is None or np.ptp(nodes.points[:, :2], axis=0).max() < ROOM_METRES:
        return None
    border, floor = np.zeros(len(superpoints), bool), _floor(superpoints)
    if floor is not None:
        on_border = floor_and_walls(Asset(asset.name, cloud=PointCloud(nodes.points)))
        border = (
            np.bincount(superpoints.of_node, on_border, len(superpoints)) > 0.5 * superpoints.size
        )
    elif largest_piece(nodes.points).mean() > _LONE:
        return None
    yaw = _yaw(superpoints, border)
    cos, sin = np.cos(yaw), np.sin(yaw)
    turned = superpoints.center @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    turned[:, 2] -= np.percentile(nodes.points[:, 2], 1) if floor is None else floor
    return Room(border, turned.astype(np.float32))


def _floor(superpoints: Superpoints) -> float | None:
    """Height of the floor, level and below everything; None where there is none."""
    height, weight = superpoints.center[:, 2], superpoints.size / superpoints.size.sum()
    length = np.maximum(np.linalg.norm(superpoints.normal, axis=1), 1e-9)
    level = np.abs(superpoints.normal[:, 2]) / length > _LEVEL
    order = np.argsort(height)
    low = float(height[order[np.searchsorted(np.cumsum(weight[order]), 0.001)]])
    best, found = _LEAST_FLOOR, None
    for bottom in np.arange(low - _BAND, low + _LOWEST, _BAND / 2):
        inside = level & (height >= bottom) & (height < bottom + _BAND)
        if (share := float(weight[inside].sum())) > best:
            best, found = share, float(np.median(height[inside]))
    return found


def _yaw(superpoints: Superpoints, border: Bool) -> float:
    """Radians, 0 to a quarter of a turn: the commonest direction of upright surfaces."""
    normal = superpoints.normal / np.maximum(
        np.linalg.norm(superpoints.normal, axis=1, keepdims=True), 1e-9
    )
    upright = np.abs(normal[:, 2]) < 0.3
    angle = np.arctan2(normal[upright, 1], normal[upright, 0])
    weight = superpoints.size[upright] * (1 + 2 * border[upright])
    if not len(angle):
        return 0.0
    counts, _ = np.histogram(angle % (np.pi / 2), 90, (0, np.pi / 2), weights=weight)
    smooth = counts + np.roll(counts, 1) + np.roll(counts, -1)
    middle = (smooth.argmax() + 0.5) * np.pi / 180
    # The mean of what lies near it, on the circle of quarter turns.
    off = (angle - middle + np.pi / 4) % (np.pi / 2) - np.pi / 4
    near = np.abs(off) < np.radians(3)
    return float(middle + np.average(off[near], weights=weight[near]))


def fenced(superpoints: Superpoints, room: Room) -> Superpoints:
    """The superpoints with strong cuts between floor or walls and everything else."""
    links = superpoints.links
    across = room.border[links.a] != room.border[links.b]
    strength = np.where(across, _FENCE * links.count, links.strength)
    weakest = np.exp(-_FENCE) * links.count
    conductance = np.where(across, np.minimum(links.conductance, weakest), links.conductance)
    return replace(superpoints, links=replace(links, strength=strength, conductance=conductance))


class RoomDescriber(MaskDescriber):
    """Adds how large a mask is in metres, where it stands, and how well it fills its box."""

    names = ROOM_FEATURE_NAMES

    def __init__(self, superpoints: Superpoints, hierarchy: Hierarchy, room: Room) -> None:
        super().__init__(superpoints, hierarchy)
        self._room = room
        self._size = superpoints.size.astype(np.float32)

    def _own(self, masks: Bool, words: npt.NDArray[np.uint64], clicked: Clicked) -> Float:
        room = self._room
        m = masks.astype(np.float32)
        size = m @ self._size
        low, high = bounds_of(masks, room.position)
        side = np.maximum(high - low, 0.01)
        within = m @ (self._size * ~room.border)
        held = contents(room, low, high).astype(np.float32) @ self._size
        growth = np.zeros(len(masks), np.float32)
        outside = 0.0
        if clicked.before is not None and clicked.before.any():
            before = bounds_of(clicked.before[None], room.position)
            volume = np.log(side + 0.05).sum(1)
            growth = volume - np.log(np.maximum(before[1] - before[0], 0.01) + 0.05).sum()
            spot = room.position[clicked.last]
            outside = float(np.maximum(before[0] - spot, spot - before[1]).max())
        columns = [
            (size - within) / np.maximum(size, 1e-9),
            np.log(side[:, :2].max(1)),
            np.log(side[:, :2].min(1)),
            np.log(side[:, 2]),
            low[:, 2],
            high[:, 2],
            within / np.maximum(held, 1e-9),
            np.clip(growth, -5, 5),
            np.full(len(masks), np.clip(outside, -1, 2)),
        ]
        extra = np.stack([np.asarray(c, np.float32) for c in columns], axis=1)
        return np.concatenate([super()._own(masks, words, clicked), extra], axis=1)


def bounds_of(masks: Bool, position: npt.NDArray[np.float32]) -> tuple[Float, Float]:
    """Lowest and highest corners (H, 3) of the boxes round masks; empty ones get a point."""
    used = masks.any(0)
    some, at = masks[:, used], position[used]
    low, high = np.empty((len(masks), 3), np.float32), np.empty((len(masks), 3), np.float32)
    for axis in range(3):
        low[:, axis] = np.where(some, at[:, axis], np.float32(np.inf)).min(1, initial=np.inf)
        high[:, axis] = np.where(some, at[:, axis], np.float32(-np.inf)).max(1, initial=-np.inf)
    empty = ~masks.any(1)
    low[empty] = high[empty] = 0.0
    return low, high


def contents(room: Room, low: Float, high: Float, margin: float = _MARGIN) -> Bool:
    """(B, C) what stands in boxes (B, 3), floor and walls left out."""
    p = room.position
    out = np.repeat(~room.border[None], len(low), axis=0)
    for axis in range(3):
        out &= (p[:, axis] >= low[:, axis, None] - margin) & (
            p[:, axis] <= high[:, axis, None] + margin
        )
    return out


class RoomSolver(PartSolver):
    """Finds the object that clicks in a room mean."""

    # Its objects are many regions: a click for each is nothing odd, and more than one is no must.
    _run_stalls = 0.0
    _stall_ball = 1.0

    def __init__(
        self,
        superpoints: Superpoints,
        hierarchy: Hierarchy,
        walk: RandomWalk,
        room: Room,
        first_scorer: Scorer | None,
        later_scorer: Scorer | None,
    ) -> None:
        describe = RoomDescriber(superpoints, hierarchy, room)
        super().__init__(superpoints, hierarchy, walk, first_scorer, later_scorer, describe)
        self._room = room
        self._size = superpoints.size.astype(np.float32)
        self._most = _LARGEST * superpoints.size.sum()

    def first_regions(self, superpoint: int) -> Candidates:
        """The nested regions, and boxes that reach from them as deep as furniture is."""
        chain = super().first_regions(superpoint)
        masks = self._some(chain.masks)
        return joined([chain, *self._boxed(*self._deeper(*bounds_of(masks, self._room.position)))])

    def _region_hypotheses(
        self, state: PartState, after: PartState, superpoint: int, positive: bool
    ) -> Candidates:
        found = super()._region_hypotheses(state, after, superpoint, positive)
        assert state.mask is not None
        regions = self._some(self.chain(superpoint).masks)
        position = self._room.position
        if not positive:
            return joined([found, *self._cut(state.mask, regions, after, superpoint)])
        wider = regions | state.mask
        low, high = bounds_of(wider, position)
        clicked = np.zeros((1, len(position)), bool)
        clicked[0, list(after.positive)] = True
        own_low, own_high = bounds_of(clicked, position)
        boxes = self._boxed(np.concatenate([low, own_low]), np.concatenate([high, own_high]))
        return joined([found, *boxes])

    def _some(self, masks: Bool) -> Bool:
        """Those of the masks that an object may be, at most ``_BOXES``."""
        size = masks.astype(np.float32) @ self._size
        fit = np.nonzero(size <= self._most)[0]
        if len(fit) > _BOXES:
            order = fit[np.argsort(size[fit], kind="stable")]
            fit = order[np.linspace(0, len(order) - 1, _BOXES).astype(int)]
        return masks[fit]

    def _deeper(self, low: Float, high: Float) -> tuple[Float, Float]:
        """The boxes themselves, and flat ones as deep as furniture: upright ones to both sides,
        level ones down to the floor."""
        lows, highs = [low], [high]
        side = high - low
        for axis in (0, 1):
            flat = (side[:, axis] < _THIN) & (side[:, axis] <= side[:, 1 - axis])
            for depth in _DEPTHS:
                wide = np.zeros(3, np.float32)
                wide[axis] = depth
                lows.append(low[flat] - wide)
                highs.append(high[flat] + wide)
        level = (side[:, 2] < _THIN) & (low[:, 2] < 1.3)
        down = low[level].copy()
        down[:, 2] = _MARGIN
        lows.append(down)
        highs.append(high[level])
        return np.concatenate(lows), np.concatenate(highs)

    def _boxed(self, low: Float, high: Float) -> list[Candidates]:
        if not len(low):
            return []
        masks = contents(self._room, low, high)
        size = masks.astype(np.float32) @ self._size
        masks = masks[(size > 0) & (size <= self._most)]
        if not len(masks):
            return []
        return [Candidates.of(list(masks), "union")]

    def _cut(
        self, mask: Bool, regions: Bool, after: PartState, superpoint: int
    ) -> list[Candidates]:
        """The mask without what lies beyond an upright or level plane.

        The planes are the sides of the boxes round the clicked regions, and those between the
        click and the part's own clicks that run through the strongest cuts, or halfway: fronts of
        cabinets that stand side by side are one surface.
        """
        position = self._room.position
        kept = position[list(after.positive)]
        links = self.superpoints.links
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
        size = np.array([self.superpoints.size[m].sum() for m in made])
        best = np.argsort(-size, kind="stable")[:_CUTS]
        return [Candidates.of([made[int(k)] for k in best], "cut")]

    def _planes(
        self, inside: npt.NDArray[np.integer], axis: int, sign: float, start: float, end: float
    ) -> Float:
        """Where between two coordinates the links ``inside`` a mask look most like cuts, and the
        middle."""
        links, at = self.superpoints.links, sign * self._room.position[:, axis]
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
        # Peaks only, the strongest first; nothing passes where the mask has a gap.
        mean[profile[1] < 1] = 9.0
        around = np.maximum(np.r_[0, mean[:-1]], np.r_[mean[1:], 0])
        peaks = np.nonzero(mean >= around)[0]
        peaks = peaks[np.argsort(-mean[peaks], kind="stable")[:_PEAKS]]
        cuts = np.r_[peaks, (number - 1) / 2] + 0.5
        return start + cuts * (end - start) / number
