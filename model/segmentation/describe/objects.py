"""Describe masks on an object: their boxes, and how well they explain the clicks so far."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from model.segmentation.arrays import Bool, Float, Uint64
from model.segmentation.describe.depths import Depths
from model.segmentation.describe.fronts import FRONT_FEATURES
from model.segmentation.describe.masks import FEATURE_NAMES, ClickContext, MaskDescriber, rounded
from model.segmentation.encode.hierarchy import Hierarchy
from model.segmentation.encode.superpoints import Superpoints
from model.segmentation.part_state import CorrectiveClick
from model.segmentation.propose.box_grid import BoxGrid
from model.segmentation.propose.plane_boxes import STEPS
from model.segmentation.propose.proposals import BOX_SOURCE, Proposals

BOX_FEATURES = (
    "from_box", "box_filled", "box_volume", "box_short", "box_middle", "box_long", "box_bottom",
    "box_top", "box_reaches", "box_growth", "click_outside_box", "squareness",
    "round_positives", "round_positives_worst", "round_negatives", "round_negatives_worst",
    "first_deepest", "near_negatives", "between_positives",
)  # fmt: skip
HISTORY_FEATURES = (
    "change_deepest", "change_other", "past_deepest", "past_deepest_worst",
    "past_other", "past_other_worst", "last_changed", "change_of_last",
    "past_depth", "past_depth_worst",
)  # fmt: skip
"""Fit of a mask to this click and earlier ones as corrections of the masks then."""
OBJECT_FEATURE_NAMES = (*FEATURE_NAMES, *BOX_FEATURES, *HISTORY_FEATURES)
MOVING_FEATURE_NAMES = (*OBJECT_FEATURE_NAMES, *FRONT_FEATURES)
"""Features of masks of moving parts, on objects whose fronts are laid out. The files of weights
hold all these names, so they stay as they are."""
_LOG_SIZE, _FIRST_DEPTH = (
    [n for n in FEATURE_NAMES if n not in MaskDescriber.relative].index(n)
    for n in ("log_size", "first_depth_relative")
)
_NEIGHBORS = 16
"""Superpoints next to a click that are likely on its side."""
_SHALLOW = 1e-3
"""Depth, in diagonals, below which a click lies on a border."""
_EARLIER = 4
"""Latest clicks before the last one that are explained."""


class ObjectDescriber(MaskDescriber):
    """Adds ``BOX_FEATURES`` and ``HISTORY_FEATURES``.

    Attributes:
        with_history: whether ``HISTORY_FEATURES`` are computed; they are 0 otherwise.
    """

    with_history = True
    names = OBJECT_FEATURE_NAMES
    relative = (*MaskDescriber.relative, "from_box")

    def __init__(self, superpoints: Superpoints, hierarchy: Hierarchy, grid: BoxGrid) -> None:
        super().__init__(superpoints, hierarchy)
        self._grid = grid
        self._tree = KDTree(superpoints.center)
        self._neighbors = min(_NEIGHBORS, len(superpoints))
        self._depths = Depths(self._x)

    def __call__(self, proposals: Proposals, context: ClickContext) -> Float:
        """(H, F) features, in the order of ``OBJECT_FEATURE_NAMES``."""
        out = super().__call__(proposals, context)
        out[:, self._column["from_box"]] = proposals.source == BOX_SOURCE
        return out

    def _own(self, masks: Bool, words: Uint64, context: ClickContext) -> Float:
        grid = self._grid
        base = super()._own(masks, words, context)
        m = masks.astype(np.float64)
        size = m @ grid.size
        low, high = grid.bounds(masks)
        held = (grid.contents(low, high) | masks).astype(np.float32) @ grid.size
        steps = (high - low + 1).astype(np.float64)
        sides = np.sort(steps * grid.step, axis=1) / np.linalg.norm(STEPS * grid.step)
        volume = np.log(steps / STEPS).sum(1)
        growth, outside = self._box_growth(volume, context)
        columns = [
            size / np.maximum(held, 1e-9),
            volume,
            *np.log(sides).T,
            low[:, 2] / STEPS,
            high[:, 2] / STEPS,
            ((low <= 2) | (high >= STEPS - 3)).sum(1),
            np.clip(growth, -5, 5),
            np.full(len(masks), outside),
            m @ grid.square / np.maximum(size, 1e-9),
            *self._around_clicks(masks, context.positive),
            *self._around_clicks(~masks, context.negative),
            self._first_deepest(words, base),
            *self._sides_of_clicks(m, size, context),
            *self._history(words, m, size, context),
        ]
        extra = rounded(columns)
        return np.concatenate([base, extra], axis=1)

    def _box_growth(self, volume: Float, context: ClickContext) -> tuple[Float, float]:
        """(H,) log growth of the box against the mask before, and how far outside the click is."""
        grid = self._grid
        if context.before is None or not context.before.any():
            return np.zeros(len(volume), np.float32), 0.0
        first, last = grid.bounds(context.before[None])
        growth = volume - np.log((last - first + 1) / STEPS).sum()
        spot = grid.place[:, context.last].astype(np.int64)
        beyond = np.maximum(first[0] - spot, spot - last[0])
        return growth, float((beyond * grid.step).max() / np.linalg.norm(STEPS * grid.step))

    def _first_deepest(self, words: Uint64, base: Float) -> Float:
        """(H,) log ratio of the first click's depth to the greatest depth in the mask, -4..1.

        Args:
            base: (H, K) features of :class:`MaskDescriber`; its depths are relative to the root of
                the masks' sizes.
        """
        log_size, relative = base[:, _LOG_SIZE], base[:, _FIRST_DEPTH]
        own = relative * np.exp(log_size / 2, dtype=np.float64)
        return _log_depth_ratio(own, self._depths(words, len(base)))

    def _history(self, words: Uint64, m: Float, held: Float, context: ClickContext) -> list[Float]:
        """(H,) columns of ``HISTORY_FEATURES``.

        People click in the middle of the largest error. So if a mask is what they mean, every click
        was deep in missing or extra surface at its time, and that was the larger error.
        """
        number, size = len(m), self._grid.size
        if context.before is None or not self.with_history:
            return [np.zeros(number, np.float32)] * len(HISTORY_FEATURES)
        this = CorrectiveClick(context.last, context.last_positive, context.before)
        now = self._explained(words, m, held, this)
        earlier = context.corrections[-_EARLIER:]
        past = [self._explained(words, m, held, click) for click in earlier] or [now]
        deepest, other, depth = (np.stack([p[k] for p in past]) for k in range(3))
        last = context.corrections[-1].before if context.corrections else context.before
        changed = float(size @ (last ^ context.before)) + 1
        own = float(size @ context.before) + 1
        return [
            now[0], now[1], deepest.mean(0), deepest.min(0), other.mean(0), other.min(0),
            np.full(number, np.log(changed / own)), np.clip(np.log((now[3] + 1) / changed), -6, 6),
            depth.mean(0), depth.min(0),
        ]  # fmt: skip

    def _explained(
        self, words: Uint64, m: Float, held: Float, click: CorrectiveClick
    ) -> tuple[Float, Float, Float, Float]:
        """Fit of each of H masks, if it is the true one, to a click.

        Args:
            held: (H,) nodes in each mask.

        Returns:
            (H,) log ratio of the click's depth in the error to the greatest depth there, -4..1; log
            ratio of the clicked kind of error to the other kind, -4..4; the depth in roots of the
            error's share of the surface; nodes of both errors.
        """
        size, before = self._grid.size, click.before
        none = np.uint64(0)
        wrong = (
            np.where(before[:, None], none, words)
            if click.positive
            else np.where(before[:, None], ~words, none)
        )
        own, most = self._depth(wrong, len(m), click.superpoint), self._depths(wrong, len(m))
        common = m @ (size * before)
        missing, extra = held - common, float(size @ before) - common
        clicked, other = (missing, extra) if click.positive else (extra, missing)
        share = np.maximum(clicked / size.sum(), 1e-9)
        return (
            _log_depth_ratio(own, most),
            np.clip(np.log((clicked + 1) / (other + 1)), -4, 4),
            own / np.sqrt(share),
            clicked + other,
        )

    def _sides_of_clicks(self, m: Float, size: Float, context: ClickContext) -> tuple[Float, Float]:
        """(H,) share of each mask that is nearer to a negative click than to a positive one, and
        the share that it holds of the box around the positive clicks.

        A negative click deep in a mask means more than its neighbourhood, and clicks all over a
        part mean what lies between them, too.
        """
        none, all_ = np.zeros(len(m), np.float32), np.ones(len(m), np.float32)
        if not context.positive or len(context.positive) + len(context.negative) < 2:
            return none, all_
        nodes = self._grid.size

        def distance(superpoints: tuple[int, ...]) -> Float:
            return np.min([self._around(s)[0] for s in superpoints], axis=0)

        wrong = np.zeros(len(nodes), bool)
        if context.negative:
            wrong = distance(context.negative) < distance(context.positive)
        place = self._grid.place[:, list(context.positive)].astype(np.int16)
        between = ~wrong & self._grid.contents(place.min(1)[None], place.max(1)[None])[0]
        beyond = m @ (nodes * wrong) / np.maximum(size, 1e-9)
        if len(context.positive) < 2:
            return beyond, all_
        held = nodes * between
        return beyond, m @ held / np.maximum(held.sum(), 1e-9)

    def _around_clicks(self, masks: Bool, clicks: tuple[int, ...]) -> Float:
        """(2, H) share of the superpoints next to the clicks that each mask holds, mean and least.

        People click in the middle of what they mean, so the surroundings of a click belong to it.
        """
        if not clicks:
            return np.ones((2, len(masks)), np.float32)
        _, near = self._tree.query(self._superpoints.center[list(clicks)], k=self._neighbors)
        near = np.reshape(near, (len(clicks), self._neighbors))
        share = masks[:, near].mean(2, dtype=np.float32)
        return np.stack([share.mean(1), share.min(1)])


def _log_depth_ratio(depth: Float, most: Float) -> Float:
    ratio = np.log(np.maximum(depth, _SHALLOW) / np.maximum(most, _SHALLOW), dtype=np.float64)
    return np.clip(ratio, -4, 1)
