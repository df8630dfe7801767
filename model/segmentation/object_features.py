"""Describe masks on an object: depth, lines on the clicked front, boxes, the clicks so far.

People click in the middle of what they mean, so the depth of a mask's deepest point counts.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import KDTree

from model.segmentation.arrays import Bool, Float, Float32, Int, Int64, Uint64
from model.segmentation.encoding import Hierarchy
from model.segmentation.front_rectangles import CHANNELS, PIECES, Front, Rects, support
from model.segmentation.fronts import NODES_A_SQUARE
from model.segmentation.mask_features import FEATURE_NAMES, ClickContext, MaskDescriber, rounded
from model.segmentation.nodes import voxel_keys
from model.segmentation.plane_boxes import STEPS, BoxGrid, trimmed_range
from model.segmentation.proposals import BOX_SOURCE, CorrectiveClick, Proposals
from model.segmentation.superpoints import Superpoints

_FINENESS = (1.0, 2**0.5)
_FIRST = 2.0
"""Radius of the smallest balls, in distances between neighbours."""
_DENSE = 0.5
"""Distance between the centres of neighbouring balls, in radii."""
_LEAST = 8
_LARGEST = 0.5


class Depths:
    """Balls of doubling radii over points, each made of balls half as large.

    A ball lies in a mask if all its smaller balls do, so all masks are tested at once, a bit each.
    The two series of balls differ by the root of two. On real objects the true depth is mostly 0.6
    to 1.2 times the result, exact enough to tell a border from the middle.
    """

    def __init__(self, x: Float) -> None:
        """``x`` (C, 3): the points, the object's diagonal being 1."""
        number = len(x)
        self._series: list[list[tuple[float, Int, Int]]] = []
        if number < _LEAST:
            return
        apart, _ = KDTree(x).query(x, k=2)
        near = max(float(np.median(apart[:, 1])), 1e-3)
        for fineness in _FINENESS:
            radius, reach, middles = 0.0, _FIRST * near * fineness, x
            below = KDTree(x)
            levels: list[tuple[float, Int, Int]] = []
            while reach < _LARGEST and len(middles := _thinned(middles, _DENSE * reach)) >= _LEAST:
                here = KDTree(middles)
                held = here.sparse_distance_matrix(below, reach - radius, output_type="ndarray")
                order = np.argsort(held["i"], kind="stable")
                start = np.searchsorted(held["i"][order], np.arange(len(middles)))
                levels.append((reach, held["j"][order].astype(np.int32), start))
                below, radius, reach = here, reach, 2 * reach
            self._series.append(levels)

    def __call__(self, words: Uint64, number: int) -> Float:
        """(H,) radius of the largest ball in each mask, 0 if not even the smallest fits.

        Args:
            words: (C, W) the bits of the masks at each point.
            number: of masks.
        """
        out = np.zeros(number, np.float32)
        for levels in self._series:
            held = words
            for radius, members, start in levels:
                held = np.bitwise_and.reduceat(np.take(held, members, axis=0), start, axis=0)
                alive = np.bitwise_or.reduce(held, axis=0)
                if not alive.any():
                    break
                fits = np.unpackbits(alive.view(np.uint8))[:number] > 0
                out[fits] = np.maximum(out[fits], radius)
        return out


def _thinned(x: Float, side: float) -> Float:
    """One point of each voxel."""
    _, first = np.unique(voxel_keys(x, x.min(0), side), return_index=True)
    return x[np.sort(first)]


FRONT_FEATURES = (
    *"front front_share front_filled side_1 side_2 side_3 side_4".split(),
    *(f"sides_{name}" for name in CHANNELS),
    *"within_upright within_level sides_of_front front_area front_wide front_high".split(),
    *"even_wide even_high front_support front_support_behind_best knobs knobs_of_front".split(),
    *"front_full framed_by frame_of repeat_1 repeat_2 split_upright split_level".split(),
)


_REACH = 2
"""Squares by which a side may miss its line."""
_KNOBS = 4
_MARGIN, _UNEQUAL = 0.35, 3.0
"""Largest width of a frame, of the shorter side of its content, and ratio of its two sides."""
_NONE = -3.0
_CUTS = np.array([(k, pieces) for pieces in PIECES for k in range(1, pieces)])
"""Cuts of a rectangle into equal pieces: the number of each, and of the pieces."""
_FIRST_CUTS = np.cumsum([0, *(pieces - 1 for pieces in PIECES[:-1])])
"""Places in ``_CUTS`` at which those into each number of pieces begin."""


def front_features(
    masks: Bool, superpoints: Superpoints, axes: Float, front: Front | None
) -> Float32:
    """(H, F) features, in the order of ``FRONT_FEATURES``; zeros without a front.

    Args:
        masks: (H, C). axes: (3, 3) the object's main directions, in rows.
    """
    out = np.zeros((len(masks), len(FRONT_FEATURES)), np.float32)
    if front is None:
        return out
    there, own, rects = _on_front(masks, superpoints, axes, front)
    if not len(there):
        return out
    total = masks[there].astype(np.float32) @ superpoints.size.astype(np.float32)
    whole = np.array(front.bounds)
    wide, high = whole[1] + 1 - whole[0], whole[3] + 1 - whole[2]
    w, h = rects[:, 1] + 1 - rects[:, 0], rects[:, 3] + 1 - rects[:, 2]
    lines, inner = front.sides(rects, _REACH), front.within(rects)
    worth = support(lines[..., -1], inner)
    knobs = front.knobs[None]
    among = (knobs >= rects[:, None, ::2]) & (knobs <= rects[:, None, 1::2])
    full = float(front.region.sum()) / (wide * high)
    columns = [
        np.ones(len(own)), own / np.maximum(total, 1e-9),
        np.minimum(own / np.maximum(front.held(rects), 1), 2.0),
        *np.sort(lines[..., -1], axis=1).T, *lines[..., :-1].mean(1).T, *inner.T,
        (np.abs(rects - whole) <= _REACH).mean(1), np.log(w * h / (wide * high)),
        w / wide, h / high, _uneven(wide / w), _uneven(high / h), worth, worth - worth.max(),
        np.minimum(among.all(2).sum(1), _KNOBS),
        np.full(len(own), min(len(front.knobs), 2 * _KNOBS)), np.full(len(own), full),
        *_framing(rects, worth, (own > 0.5 * total) & (own > 0.7 * front.held(rects))),
        *_repeats(front, rects), *_splits(front, rects),
    ]  # fmt: skip
    out[there] = np.stack(columns, axis=1)
    return out


def _on_front(
    masks: Bool, superpoints: Superpoints, axes: Float, front: Front
) -> tuple[Int64, Float, Rects]:
    """(T,) the masks that lie on a front, (T,) their nodes and (T, 4) rectangles there."""
    at = superpoints.center @ axes.T
    layer = np.flatnonzero(np.abs(front.outward * at[:, front.axis] - front.depth) < front.reach)
    flat = (at[layer][:, list(front.across)] - front.low) / front.side
    size = superpoints.size[layer].astype(np.float32)
    held = masks[:, layer] * size
    own = held.sum(1)
    there = np.flatnonzero(own > 0)
    if not len(there):
        return there, own[:0], np.zeros((0, 4), np.int64)
    half = 0.5 * float(np.sqrt(np.median(size))) / NODES_A_SQUARE
    held = held[there]
    bounds = [_bounds(held, flat[:, k], half, front.shape[k]) for k in (0, 1)]
    return there, own[there], np.concatenate(bounds, axis=1)


def _framing(rects: Rects, worth: Float, filled: Bool) -> tuple[Float, Float]:
    """(R,) support of the best rectangle that frames each one, and of the best one that each
    frames: the panel of a door is no part of its own.
    """
    low, high = rects[:, ::2], rects[:, 1::2]
    before, after = low[:, None] - low[None], high[None] - high[:, None]
    margin = np.concatenate([before, after], axis=2)
    short = (high - low + 1).min(1)
    ok = (margin.min(2) >= 2) & (margin.max(2) <= _MARGIN * short[None])
    ok &= margin.max(2) <= _UNEQUAL * margin.min(2) + 2
    ok &= filled[:, None] & filled[None]
    framed_by = np.where(ok, worth[None], _NONE).max(1)
    frame_of = np.where(ok, worth[:, None], _NONE).max(0)
    return framed_by, frame_of


def _repeats(front: Front, rects: Rects) -> tuple[Float, Float]:
    """(R,) evidence of the far ends of the two best equal neighbours: doors come in rows."""
    whole, found = front.bounds, []
    for axis in (0, 1):
        length = rects[:, 2 * axis + 1] + 1 - rects[:, 2 * axis]
        for direction in (-1, 1):
            beside = rects.copy()
            beside[:, 2 * axis : 2 * axis + 2] += direction * length[:, None]
            inside = beside[:, 2 * axis] >= whole[2 * axis] - _REACH
            inside &= beside[:, 2 * axis + 1] <= whole[2 * axis + 1] + _REACH
            beside = np.clip(beside, np.repeat(whole[::2], 2), np.repeat(whole[1::2], 2))
            far = front.lines(beside, 2 * axis + (direction > 0), _REACH)
            found.append(np.where(inside, far, -1.0))
    ordered = np.sort(np.stack(found), axis=0)
    return ordered[-1], ordered[-2]


def _splits(front: Front, rects: Rects) -> tuple[Float, Float]:
    """(R,) evidence of vertical and horizontal lines that cut each rectangle into equal pieces: a
    row of drawers is no single part.
    """
    best = []
    for axis in (0, 1):
        length = rects[:, 2 * axis + 1] + 1 - rects[:, 2 * axis]
        cut = np.repeat(rects[None], len(_CUTS), axis=0)
        cut[:, :, 2 * axis] += np.round(_CUTS[:, :1] * length / _CUTS[:, 1:]).astype(np.int64)
        lines = front.lines(cut.reshape(-1, 4), 2 * axis, _REACH).reshape(len(_CUTS), -1)
        best.append(np.minimum.reduceat(lines, _FIRST_CUTS, axis=0).max(0))
    return best[0], best[1]


def _uneven(times: Float) -> Float:
    return np.abs(times - np.round(times))


def _bounds(held: Float32, at: Float, half: float, most: int) -> Int64:
    """(H, 2) first and last square along one direction, without a hundredth at each end.

    Args:
        held: (H, L) nodes of each superpoint. at: (L,) squares.
        half: squares from a superpoint's middle to its border.
    """
    where = np.clip(at.astype(np.int64), 0, most - 1)
    bins = csr_matrix((np.ones(len(at), np.float32), (where, np.arange(len(at)))), (most, len(at)))
    first, last = trimmed_range((bins @ held.T).T)
    bounds = np.stack([first + 0.5 - half, last + 0.5 + half], axis=1)
    return np.clip(np.floor(bounds), 0, most - 1).astype(np.int64)


BOX_FEATURES = (
    *"from_box box_filled box_volume box_short box_middle box_long box_bottom box_top".split(),
    *"box_reaches box_growth click_outside_box squareness round_positives".split(),
    *"round_positives_worst round_negatives round_negatives_worst first_deepest".split(),
    *"near_negatives between_positives".split(),
)
HISTORY_FEATURES = (
    *"change_deepest change_other past_deepest past_deepest_worst past_other".split(),
    *"past_other_worst last_changed change_of_last past_depth past_depth_worst".split(),
)
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
            now[0],
            now[1],
            deepest.mean(0),
            deepest.min(0),
            other.mean(0),
            other.min(0),
            np.full(number, np.log(changed / own)),
            np.clip(np.log((now[3] + 1) / changed), -6, 6),
            depth.mean(0),
            depth.min(0),
        ]

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
