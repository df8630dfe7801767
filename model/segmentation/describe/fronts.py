"""Describe masks on the flat front that was clicked: lines along their sides and within them."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from model.segmentation.arrays import Bool, Float, Float32, Int64
from model.segmentation.encode.superpoints import Superpoints
from model.segmentation.propose.box_grid import trimmed_range
from model.segmentation.propose.front_picture import CHANNELS, Front, Rects
from model.segmentation.propose.front_rectangles import PIECES, support
from model.segmentation.propose.fronts import NODES_A_SQUARE

FRONT_FEATURES = (
    "front", "front_share", "front_filled", "side_1", "side_2", "side_3", "side_4",
    *(f"sides_{name}" for name in CHANNELS),
    "within_upright", "within_level", "sides_of_front", "front_area", "front_wide", "front_high",
    "even_wide", "even_high", "front_support", "front_support_behind_best", "knobs",
    "knobs_of_front", "front_full", "framed_by", "frame_of", "repeat_1", "repeat_2",
    "split_upright", "split_level",
)  # fmt: skip


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
