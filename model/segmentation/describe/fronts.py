"""What a mask shows on the flat front that was clicked: lines along its sides and within it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix

from model.segmentation.encode.superpoints import Superpoints
from model.segmentation.propose.fronts import (
    CHANNELS,
    NODES_A_SQUARE,
    PIECES,
    Front,
    Rects,
    support,
)

FRONT_FEATURES = (
    "front", "front_share", "front_filled", "side_1", "side_2", "side_3", "side_4",
    *(f"sides_{name}" for name in CHANNELS),
    "within_upright", "within_level", "sides_of_front", "front_area", "front_wide", "front_high",
    "even_wide", "even_high", "front_support", "front_support_behind_best", "knobs",
    "knobs_of_front", "front_full", "framed_by", "frame_of", "repeat_1", "repeat_2",
    "split_upright", "split_level",
)  # fmt: skip

Bool = npt.NDArray[np.bool_]
Float = npt.NDArray[np.floating]

_TRIM = 0.01
"""Share of what is held that may stick out at each end: a handle, crumbs."""
_REACH = 2
_KNOBS = 4
_MARGIN, _UNEQUAL = 0.35, 3.0
"""A frame's width at most, of the shorter side of what it frames, and how much wider one side of it
is than another."""
_NONE = -3.0
_CUTS = np.array([(k, pieces) for pieces in PIECES for k in range(1, pieces)])
"""Where a rectangle is cut into equal pieces, and at which of these each number of them begins."""
_FIRST_CUTS = np.cumsum([0, *(pieces - 1 for pieces in PIECES[:-1])])


def front_features(
    masks: Bool, superpoints: Superpoints, axes: Float, front: Front | None
) -> npt.NDArray[np.float32]:
    """(H, F) features, in the order of ``FRONT_FEATURES``; zeros where there is no front.

    Args:
        masks: (H, C). axes: (3, 3) the object's main directions, in rows.
    """
    out = np.zeros((len(masks), len(FRONT_FEATURES)), np.float32)
    if front is None:
        return out
    at = superpoints.center @ axes.T
    layer = np.flatnonzero(np.abs(front.outward * at[:, front.axis] - front.depth) < front.reach)
    flat = (at[layer][:, list(front.across)] - front.low) / front.side
    size = superpoints.size[layer].astype(np.float32)
    if not len(layer):
        return out
    half = 0.5 * float(np.sqrt(np.median(size))) / NODES_A_SQUARE
    held = masks[:, layer] * size
    own = held.sum(1)
    there = np.flatnonzero(own > 0)
    if not len(there):
        return out
    held, own = held[there], own[there]
    rects = np.concatenate(
        [_bounds(held, flat[:, k], half, front.shape[k]) for k in (0, 1)], axis=1
    )
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


def _framing(rects: Rects, worth: Float, filled: Bool) -> tuple[Float, Float]:
    """(R,) of each rectangle the worth of the best one that frames it, and of the best one that it
    frames: a door's panel is no part of its own.
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
    """(R,) how clearly the two best neighbours of the same size end: doors come in rows."""
    whole, found = front.bounds, []
    for axis in (0, 1):
        length = rects[:, 2 * axis + 1] + 1 - rects[:, 2 * axis]
        for way in (-1, 1):
            beside = rects.copy()
            beside[:, 2 * axis : 2 * axis + 2] += way * length[:, None]
            inside = beside[:, 2 * axis] >= whole[2 * axis] - _REACH
            inside &= beside[:, 2 * axis + 1] <= whole[2 * axis + 1] + _REACH
            beside = np.clip(beside, np.repeat(whole[::2], 2), np.repeat(whole[1::2], 2))
            far = front.lines(beside, 2 * axis + (way > 0), _REACH)
            found.append(np.where(inside, far, -1.0))
    ordered = np.sort(np.stack(found), axis=0)
    return ordered[-1], ordered[-2]


def _splits(front: Front, rects: Rects) -> tuple[Float, Float]:
    """(R,) how clearly upright, and level, lines cut each rectangle into equal pieces: a row of
    drawers is not one.
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


def _bounds(
    held: npt.NDArray[np.float32], at: Float, half: float, most: int
) -> npt.NDArray[np.int64]:
    """(H, 2) first and last square along one direction, but for a hundredth at each end.

    Args:
        held: (H, L) nodes of each superpoint; at: (L,) squares; half: squares that a superpoint reaches beyond
            its middle.
    """
    where = np.clip(at.astype(np.int64), 0, most - 1)
    bins = csr_matrix((np.ones(len(at), np.float32), (where, np.arange(len(at)))), (most, len(at)))
    first, last = trimmed((bins @ held.T).T)
    bounds = np.stack([first + 0.5 - half, last + 0.5 + half], axis=1)
    return np.clip(np.floor(bounds), 0, most - 1).astype(np.int64)


def trimmed(held: npt.NDArray[np.float32]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """First and last bin along the last axis of what they hold, but for a hundredth at each end."""
    passed = np.cumsum(held, axis=-1)
    total = passed[..., -1:]
    first = (passed > _TRIM * total).argmax(-1)
    return first, (passed >= (1 - _TRIM) * total * (1 - 1e-6)).argmax(-1)
