"""Describe masks in a room: their size in metres, where they stand, how they fill their box."""

from __future__ import annotations

import numpy as np

from model.segmentation.arrays import Bool, Float, Uint64
from model.segmentation.describe.masks import FEATURE_NAMES, ClickContext, MaskDescriber, rounded
from model.segmentation.encode.hierarchy import Hierarchy
from model.segmentation.encode.room import Room
from model.segmentation.encode.superpoints import Superpoints
from model.segmentation.propose.room_boxes import bounds_of, contents_of

ROOM_FEATURES = (
    "on_border", "long_side", "short_side", "height_metres", "bottom", "top", "box_filled",
    "box_growth", "click_outside",
)  # fmt: skip
ROOM_FEATURE_NAMES = (*FEATURE_NAMES, *ROOM_FEATURES)
"""Stored in the files of weights, so these names stay as they are."""


class RoomDescriber(MaskDescriber):
    """Adds ``ROOM_FEATURES``."""

    names = ROOM_FEATURE_NAMES

    def __init__(self, superpoints: Superpoints, hierarchy: Hierarchy, room: Room) -> None:
        super().__init__(superpoints, hierarchy)
        self._room = room
        self._size = superpoints.size.astype(np.float32)

    def _own(self, masks: Bool, words: Uint64, context: ClickContext) -> Float:
        room = self._room
        m = masks.astype(np.float64)
        size = m @ self._size
        low, high = bounds_of(masks, room.position)
        side = np.maximum(high - low, 0.01, dtype=np.float64)
        within = m @ (self._size * ~room.border)
        held = contents_of(room, low, high).astype(np.float32) @ self._size
        growth = np.zeros(len(masks), np.float32)
        outside = 0.0
        if context.before is not None and context.before.any():
            before = bounds_of(context.before[None], room.position)
            volume = np.log(side + 0.05).sum(1)
            was = np.maximum(before[1] - before[0], 0.01, dtype=np.float64)
            growth = volume - np.log(was + 0.05).sum()
            spot = room.position[context.last]
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
        extra = rounded(columns)
        return np.concatenate([super()._own(masks, words, context), extra], axis=1)
