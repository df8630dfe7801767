"""All boxes between an object's planes, measured once.

Planes lie where much of the surface faces along a main direction (boards, bottoms, fronts) and
where strong cuts line up (gaps between doors). Summed-area tables over the grid of planes give the
content of all boxes between them, the leak through their sides, and the share of their sides that
is lined with surface. A click then looks up the boxes that hold it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from model.segmentation.arrays import Bool, Float, Float64, Int, Int16, Int64, Uint8
from model.segmentation.encode.superpoints import Superpoints, totals

STEPS = 256
"""Steps of the grid along each direction."""
_SURFACES, _GAPS = 8, 3
"""Most planes of each direction."""
_LEAST_FACING = 0.001
"""Least share of the surface that faces along a plane."""
_APART, _WIDE = 3, 15
"""Least steps between planes, and steps around one that it is compared with."""
_SLAB, _SLAB_SHARE = 3, 0.15
"""Most steps of a board on each side of its plane, and their least share of its surface."""
_STRONG = 2.0
"""Least strength of a link that counts as a gap; see ``edge_strength``."""
_LONG = 12
"""Steps above which a link is a bridge and no sign of a gap."""
_THIN = 4
_SMALLEST, _LARGEST = 0.002, 0.95
"""Least and largest share of the surface that a box holds."""
_SHEET = 1.35
"""Nodes on a lined side of a box, in areas of the spacing squared."""
_MOST = 60_000
"""Boxes, those that leak least."""


SIDE_FEATURES = ("walked", "crossed", "strength", "lined")
"""Features of each side of a box, by its area: conductance and number of the links through it;
their mean strength; the share that is lined with surface."""


@dataclass(frozen=True, eq=False)
class PlaneBoxes:
    """The boxes between the planes of an object.

    Attributes:
        low, high: (3, B) first and last step of each along each direction.
        leak: (B,) conductance through the sides by the root of the content, less where surface
            lines the sides; ascending.
        share: (B,) float32 of the surface in each box.
        inner: (B,) float32 mean strength of the links of its content.
        sides: (B, 3, 2, 4) float32 ``SIDE_FEATURES`` of the low and the high side along each
            direction.
        surface: (B,) float32 nodes that would line all sides.
    """

    low: Int16
    high: Int16
    leak: Float
    share: Float
    inner: Float
    sides: Float
    surface: Float

    def holding(self, spot: Int) -> Int64:
        """The boxes that hold a place (three steps), the least leak first."""
        at = spot.astype(np.int16)[:, None]
        return np.nonzero(((self.low <= at) & (self.high >= at)).all(0))[0]

    def sums(self, place: Uint8, values: npt.NDArray) -> Float64:
        """(B,) sums of ``values`` (C,) at ``place`` (3, C) over the content of each box."""
        cuts = [np.unique(np.r_[0, self.low[k], self.high[k] + 1, STEPS]) for k in range(3)]
        slot: list[Int] = [
            np.asarray(np.searchsorted(c, p, side="right"))
            for c, p in zip(cuts, place, strict=True)
        ]
        shape = [len(c) for c in cuts]
        flat = np.ravel_multi_index(slot, shape)
        table = totals(flat, values, int(np.prod(shape))).reshape(shape)
        for k in range(3):
            table = table.cumsum(k)
        ends = [
            (np.searchsorted(c, low), np.searchsorted(c, high + 1))
            for c, low, high in zip(cuts, self.low, self.high, strict=True)
        ]
        return _corners(table, ends)


@dataclass(frozen=True, eq=False)
class _Axis:
    """Planes of one direction, and the intervals between them as indices of cuts."""

    cut: Int64
    first: Int64
    last: Int64
    slot: Int64

    def between(self, table: Float) -> Float:
        """Sums over the intervals, from sums up to each cut along the first axis."""
        return table[self.last] - table[self.first]


def plane_boxes(
    superpoints: Superpoints, place: Uint8, facing: Bool, step: Float, spacing: float
) -> PlaneBoxes:
    """Measure all boxes between the planes.

    Args:
        place: (3, C) step of each superpoint. facing: (3, C) whether it faces along the direction.
        step: (3,) metres. spacing: metres between neighbouring nodes.
    """
    at = place.astype(np.int64)
    total = float(superpoints.size.sum())
    axes = [_axis(superpoints, at[k], facing[k], total) for k in range(3)]
    held = _table([a.slot for a in axes], axes, superpoints.size)
    for k in range(3):
        held = np.moveaxis(axes[k].between(np.moveaxis(held, k, 0)), 0, k)
    leak, lined = np.zeros_like(held), np.zeros_like(held)
    tables = [_side_tables(superpoints, axes, k, facing[k], step, spacing) for k in range(3)]
    for k, (through, _, _, faces, full) in enumerate(tables):
        leak += np.moveaxis(through[axes[k].first] + through[axes[k].last], 0, k)
        for slots in (axes[k].first, axes[k].last - 1):
            lined += np.moveaxis(np.minimum(faces[slots] / full[None], 1), 0, k)
    share = held / total
    leak = (leak + 1e-6) / np.sqrt(np.maximum(np.minimum(held, total - held), 1)) / (0.5 + lined)
    usable = np.nonzero(((share > _SMALLEST) & (share < _LARGEST)).ravel())[0]
    leak = leak.ravel()[usable]
    if len(usable) > _MOST:
        best = np.sort(np.argpartition(leak, _MOST)[:_MOST])
        usable, leak = usable[best], leak[best]
    order = np.argsort(leak, kind="stable")
    usable, leak = usable[order], leak[order]
    index = np.unravel_index(usable, held.shape)
    first = np.stack([a.cut[a.first[i]] for a, i in zip(axes, index, strict=True)])
    last = np.stack([a.cut[a.last[i]] - 1 for a, i in zip(axes, index, strict=True)])
    made = PlaneBoxes(
        first.astype(np.int16), last.astype(np.int16), leak.astype(np.float32),
        share.ravel()[usable].astype(np.float32), leak, *_described(axes, index, tables)
    )  # fmt: skip
    links = superpoints.links
    strength, count = (
        totals(links.a, v, len(superpoints)) + totals(links.b, v, len(superpoints))
        for v in (links.strength, links.count)
    )
    inner = made.sums(place, strength) / np.maximum(made.sums(place, count), 1e-9)
    return replace(made, inner=inner.astype(np.float32))


def _side_tables(
    superpoints: Superpoints,
    axes: Sequence[_Axis],
    k: int,
    facing: Bool,
    step: Float,
    spacing: float,
) -> tuple[Float64, ...]:
    """Sums over all rectangles in each layer across direction ``k``.

    Returns:
        (layers, intervals, intervals) conductance, number and strength of the links through each,
        and nodes that face along ``k``; (intervals, intervals) nodes that would line each.
    """
    links, axis = superpoints.links, axes[k]
    others, rest = zip(*((axes[o], o) for o in range(3) if o != k), strict=True)
    low, high = _ordered(axis.slot, links.a, links.b)
    times = high - low
    link = np.repeat(np.arange(len(times)), times)
    cut = low[link] + 1 + np.arange(len(link)) - np.repeat(np.cumsum(times) - times, times)
    side = [o.slot[links.a[link]] for o in others]
    through, crossed, strong = (
        _sides(axis, others, cut, side, v[link])
        for v in (links.conductance, links.count, links.strength)
    )
    faces = _sides(
        axis, others, axis.slot[facing], [o.slot[facing] for o in others], superpoints.size[facing]
    )
    wide, tall = (
        (o.cut[o.last] - o.cut[o.first]) * step[d] for o, d in zip(others, rest, strict=True)
    )
    return through, crossed, strong, faces, _SHEET * wide[:, None] * tall[None] / spacing**2


def _described(
    axes: Sequence[_Axis], index: Sequence[Int64], tables: Sequence[Sequence[Float64]]
) -> tuple[Float, Float]:
    """``sides`` and ``surface`` of the boxes with these intervals along each direction."""
    sides = np.zeros((len(index[0]), 3, 2, len(SIDE_FEATURES)), np.float32)
    surface = np.zeros(len(index[0]), np.float32)
    for k, (through, crossed, strong, faces, full) in enumerate(tables):
        one, other = (index[o] for o in range(3) if o != k)
        area = np.maximum(full[one, other], 1)
        surface += 2 * area
        ends = (axes[k].first[index[k]], axes[k].last[index[k]])
        for side, (cut, slot) in enumerate(((ends[0], ends[0]), (ends[1], ends[1] - 1))):
            count = crossed[cut, one, other]
            sides[:, k, side] = np.stack(
                [
                    np.minimum(through[cut, one, other] / area, 8),
                    np.minimum(count / area, 8),
                    strong[cut, one, other] / np.maximum(count, 1),
                    np.minimum(faces[slot, one, other] / area, 1),
                ],
                axis=1,
            )
    return sides, surface


def _corners(table: Float64, ends: Sequence[tuple[Int, Int]]) -> Float64:
    """(B,) sums over boxes between two entries of a summed-area table along each axis."""
    out = np.zeros(len(ends[0][0]))
    for corner in itertools.product((0, 1), repeat=3):
        sign = (-1) ** (3 - sum(corner))
        out += sign * table[tuple(e[c] for e, c in zip(ends, corner, strict=True))]
    return out


def _ordered(slot: Int, a: Int, b: Int) -> tuple[Int, Int]:
    return np.minimum(slot[a], slot[b]), np.maximum(slot[a], slot[b])


def _table(index: Sequence[Int], axes: Sequence[_Axis], values: Float) -> Float64:
    """Summed-area table over the slots between cuts."""
    shape = [len(a.cut) for a in axes]
    flat = np.ravel_multi_index([i + 1 for i in index], shape)
    out = totals(flat, values, int(np.prod(shape))).reshape(shape)
    for k in range(len(axes)):
        out = out.cumsum(k)
    return out


def _sides(
    axis: _Axis, others: Sequence[_Axis], layer: Int, index: Sequence[Int], values: Float
) -> Float64:
    """(layers, intervals, intervals) sums over rectangles in each layer across ``axis``."""
    shape = [len(axis.cut), *(len(o.cut) for o in others)]
    flat = np.ravel_multi_index([layer, *(i + 1 for i in index)], shape)
    out = totals(flat, values, int(np.prod(shape))).reshape(shape).cumsum(1).cumsum(2)
    out = out[:, others[0].last] - out[:, others[0].first]
    return out[:, :, others[1].last] - out[:, :, others[1].first]


def _axis(superpoints: Superpoints, at: Int, facing: Bool, total: float) -> _Axis:
    held = totals(at[facing], superpoints.size[facing], STEPS)
    near = held + np.r_[held[1:], 0] + np.r_[0, held[:-1]]
    around = np.convolve(held, np.ones(_WIDE), "same") - near
    stands_out = near / np.sqrt(around / 4 + 0.0005 * total)
    peaks = _peaks(near, stands_out, near > _LEAST_FACING * total, [], _SURFACES)
    low: list[int] = []
    high: list[int] = []
    for peak in peaks:
        first = last = peak
        while first > max(peak - _SLAB, 0) and held[first - 1] > _SLAB_SHARE * held[peak]:
            first -= 1
        while last < min(peak + _SLAB, STEPS - 1) and held[last + 1] > _SLAB_SHARE * held[peak]:
            last += 1
        low.append(first)
        high.append(last + 1)
    gaps = _gaps(superpoints, at, low + high)
    lows, highs = np.unique([0, *low, *gaps]), np.unique([*low, *high, *gaps, STEPS])
    cut = np.unique(np.r_[lows, highs])
    first, last = (
        i.ravel()
        for i in np.meshgrid(np.searchsorted(cut, lows), np.searchsorted(cut, highs), indexing="ij")
    )
    thick = cut[last] - cut[first] >= _THIN
    return _Axis(cut, first[thick], last[thick], np.searchsorted(cut, at, side="right") - 1)


def _gaps(superpoints: Superpoints, at: Int, taken: list[int]) -> list[int]:
    """Steps before which strong cuts line up most."""
    links = superpoints.links
    low, high = _ordered(at, links.a, links.b)
    weight = np.maximum(links.strength - _STRONG * links.count, 0) * (high - low < _LONG)
    passing = totals(low + 1, weight, STEPS + 2) - totals(high + 1, weight, STEPS + 2)
    cuts = np.cumsum(passing)[:STEPS]
    if not cuts.any():
        return []
    around = np.convolve(cuts, np.ones(_WIDE) / _WIDE, "same")
    stands_out = cuts / np.sqrt(around + 0.001 * cuts.max())
    return _peaks(cuts, stands_out, cuts > 0, taken, _GAPS)


def _peaks(profile: Float, score: Float, allowed: Bool, taken: list[int], most: int) -> list[int]:
    """The local maxima with the best scores, apart from each other and from those taken."""
    top = (profile >= np.r_[0, profile[:-1]]) & (profile > np.r_[profile[1:], 0]) & allowed
    found = np.nonzero(top)[0]
    chosen: list[int] = []
    for peak in found[np.argsort(-score[found], kind="stable")].tolist():
        if len(chosen) == most:
            break
        if all(abs(peak - other) >= _APART for other in (*chosen, *taken)):
            chosen.append(peak)
    return sorted(chosen)
