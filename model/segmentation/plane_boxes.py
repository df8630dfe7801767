"""All boxes between an object's planes, measured once, and superpoints on a grid along its axes.

Planes lie where much of the surface faces along a main direction (boards, bottoms, fronts) and
where strong cuts line up (gaps between doors). Summed-area tables over the grid of planes give the
content of all boxes between them, the leak through their sides, and the share of their sides that
is lined with surface. A click then looks up the boxes that hold it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from model.segmentation.arrays import Bool, Float, Float32, Float64, Int, Int16, Int64, Uint8
from model.segmentation.superpoints import Superpoints, totals

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
_CONSIDERED, _ALIKE = 400, 0.65
"""Least leaking boxes that are thinned, and the volume overlap of those that are alike."""
_SIZE_BIN = 0.3
"""Logarithmic size of the bins from which one box each is taken."""


@dataclass(frozen=True, eq=False)
class PlaneBoxes:
    """Boxes between the planes of an object, the least leak first.

    The leak is the conductance through the sides by the root of the content, less where surface
    lines the sides.

    Attributes:
        low, high: (3, B) first and last step of each along each direction.
        share: (B,) float32 of the surface in each box.
    """

    low: Int16
    high: Int16
    share: Float

    def take(self, index: Int) -> PlaneBoxes:
        """Boxes at ``index``."""
        return PlaneBoxes(self.low[:, index], self.high[:, index], self.share[index])

    def holding(self, inside: Int16, outside: Int16) -> PlaneBoxes:
        """Boxes that hold some places (3, K) and none of others (3, L), in steps."""
        found = self
        for places, wanted in ((inside, True), (outside, False)):
            for place in places.T[:, :, None]:
                held = ((found.low <= place) & (found.high >= place)).all(0)
                found = found.take(np.nonzero(held == wanted)[0])
        return found

    def apart(self, most: int) -> PlaneBoxes:
        """At most so many that aren't alike."""
        boxes = self.take(np.arange(min(len(self.share), _CONSIDERED)))
        free = np.ones(len(boxes.share), bool)
        out: list[int] = []
        while len(out) < most and free.any():
            best = int(free.argmax())
            out.append(best)
            free &= boxes.overlap(boxes.low[:, best], boxes.high[:, best]) < _ALIKE
            free[best] = False
        return boxes.take(np.array(out, np.int64))

    def of_all_sizes(self, most: int) -> PlaneBoxes:
        """At most so many, the first of each size."""
        size = np.log(self.share, dtype=np.float64)
        _, first = np.unique(np.floor(size / _SIZE_BIN), return_index=True)
        return self.take(np.sort(first)[:most])

    def overlap(self, low: Int16, high: Int16) -> Float:
        """(B,) IoU of their volumes with that of another box (3,), in steps."""
        first = np.maximum(self.low, low[:, None])
        last = np.minimum(self.high, high[:, None])
        common = np.maximum(last - first + np.float32(1), 0).prod(0)
        own = (self.high - self.low + np.float32(1)).prod(0)
        return common / (own + (high - low + np.float32(1)).prod() - common)


@dataclass(frozen=True, eq=False)
class _Axis:
    """Planes of one direction, and the intervals between them as indices of cuts."""

    cut: Int64
    first: Int64
    last: Int64
    slot: Int64


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
    held = _over_intervals([a.slot + 1 for a in axes], axes, superpoints.size, range(3))
    leak, lined = np.zeros_like(held), np.zeros_like(held)
    tables = [_side_tables(superpoints, axes, k, facing[k], step, spacing) for k in range(3)]
    for k, (through, faces, full) in enumerate(tables):
        leak += np.moveaxis(through[axes[k].first] + through[axes[k].last], 0, k)
        for slots in (axes[k].first, axes[k].last - 1):
            lined += np.moveaxis(np.minimum(faces[slots] / full[None], 1), 0, k)
    share = held / total
    leak = (leak + 1e-6) / np.sqrt(np.maximum(np.minimum(held, total - held), 1)) / (0.5 + lined)
    usable = np.nonzero(((share > _SMALLEST) & (share < _LARGEST)).ravel())[0]
    usable = usable[np.argsort(leak.ravel()[usable], kind="stable")[:_MOST]]
    index = np.unravel_index(usable, held.shape)
    first = np.stack([a.cut[a.first[i]] for a, i in zip(axes, index, strict=True)])
    last = np.stack([a.cut[a.last[i]] - 1 for a, i in zip(axes, index, strict=True)])
    return PlaneBoxes(
        first.astype(np.int16), last.astype(np.int16), share.ravel()[usable].astype(np.float32)
    )


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
        (layers, intervals, intervals) conductance of the links through each, and nodes that face
        along ``k``; (intervals, intervals) nodes that would line each.
    """
    links, axis = superpoints.links, axes[k]
    others, rest = zip(*((axes[o], o) for o in range(3) if o != k), strict=True)
    low, high = _ordered(axis.slot, links.a, links.b)
    times = high - low
    link = np.repeat(np.arange(len(times)), times)
    cut = low[link] + 1 + np.arange(len(link)) - np.repeat(np.cumsum(times) - times, times)
    side = [o.slot[links.a[link]] + 1 for o in others]
    through = _over_intervals([cut, *side], (axis, *others), links.conductance[link], (1, 2))
    lining = [axis.slot[facing], *(o.slot[facing] + 1 for o in others)]
    faces = _over_intervals(lining, (axis, *others), superpoints.size[facing], (1, 2))
    wide, tall = (
        (o.cut[o.last] - o.cut[o.first]) * step[d] for o, d in zip(others, rest, strict=True)
    )
    return through, faces, _SHEET * wide[:, None] * tall[None] / spacing**2


def _ordered(slot: Int, a: Int, b: Int) -> tuple[Int, Int]:
    return np.minimum(slot[a], slot[b]), np.maximum(slot[a], slot[b])


def _over_intervals(
    index: Sequence[Int], axes: Sequence[_Axis], values: Float, along: Sequence[int]
) -> Float64:
    """Sums of ``values`` at places ``index`` over all intervals ``along`` some of three axes."""
    shape = [len(axis.cut) for axis in axes]
    flat = np.ravel_multi_index(list(index), shape)
    out = totals(flat, values, int(np.prod(shape))).reshape(shape)
    for k in along:
        out = out.cumsum(k)
    for k in along:
        out = out.take(axes[k].last, k) - out.take(axes[k].first, k)
    return out


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


_AXES_TRIED = 400
_ALONG = np.cos(np.radians(6))
_SQUARE = 0.12
"""Largest cosine between a first and a second main direction, before it is made square."""
_LEAST_SUPPORT = 0.03
"""Least share of the surface that faces along a main direction."""
_FACING = 0.9
"""Least cosine between a superpoint's normal and the direction it faces along."""
_FLAT = 0.3
"""Largest ratio of the shortest to the second side of a front that a box may lie behind."""
_COVER = 0.2
"""Share of a front's own surface that has to face it for a box to end there."""
_NEAREST, _ENDS = 4, 2
"""Least steps between a front and the end of a box, and ends tried on each side."""
_TRIM = 0.01
"""Share of the content that may lie beyond each bound, such as a handle."""


def main_directions(normal: Float, weight: Float) -> Float64:
    """(3, 3) orthonormal rows along which most of the surface faces, the last nearest to z.

    Args:
        normal: (C, 3) unit normals, or zeros.
        weight: (C,) share of the surface.
    """
    step = max(len(normal) // _AXES_TRIED, 1)
    tried = np.concatenate([np.eye(3), normal[::step]])
    tried = tried[np.linalg.norm(tried, axis=1) > 0.5]
    total = max(float(weight.sum()), 1e-12)
    found: list[Float64] = []
    for _ in range(2):
        for axis in found:
            tried = tried[np.abs(tried @ axis) < _SQUARE]
            tried = tried - np.outer(tried @ axis, axis)
        tried = tried / np.linalg.norm(tried, axis=1, keepdims=True)
        if not len(tried):
            break
        support = (np.abs(tried @ normal.T) > _ALONG) @ weight / total
        best = tried[int(support.argmax())]
        if support.max() < _LEAST_SUPPORT:
            break
        near = np.abs(normal @ best) > _ALONG
        mean = (normal[near] * np.sign(normal[near] @ best)[:, None] * weight[near, None]).sum(0)
        for axis in found:
            mean -= mean @ axis * axis
        found.append(mean / np.linalg.norm(mean))
    if len(found) < 2:
        return np.eye(3)
    axes = np.stack([*found, np.cross(found[0], found[1])])
    upright = int(np.abs(axes[:, 2]).argmax())
    return np.roll(axes, 2 - upright, axis=0)


class BoxGrid:
    """The superpoints on a grid of 256 steps along the object's main directions.

    Attributes:
        place: (3, C) uint8 step of each superpoint along each direction.
        facing: (3, C) whether the superpoint faces along it.
        size: (C,) float32 nodes of each superpoint.
        square: (C,) the same, 0 for those that face along no direction.
        step: (3,) metres.
        axes: (3, 3) the directions, in rows.
    """

    def __init__(self, superpoints: Superpoints) -> None:
        length = np.linalg.norm(superpoints.normal, axis=1, keepdims=True)
        unit = superpoints.normal / np.maximum(length, 1e-9)
        self.axes = main_directions(unit, superpoints.size)
        at = superpoints.center @ self.axes.T
        low, side = at.min(0), np.maximum(np.ptp(at, axis=0), 1e-9)
        self.step = side / STEPS
        place = np.minimum((at - low) / self.step, STEPS - 1)
        self.place = np.ascontiguousarray(place.T.astype(np.uint8))
        self.facing = np.ascontiguousarray(np.abs(unit @ self.axes.T).T > _FACING)
        self.size = superpoints.size.astype(np.float32)
        self.square = self.facing.any(0) * self.size
        number = len(superpoints)
        rows = (self.place.astype(np.int64) + STEPS * np.arange(3)[:, None]).ravel()
        self._bins = csr_matrix(
            (np.tile(self.size, 3), (rows, np.tile(np.arange(number), 3))),
            shape=(3 * STEPS, number),
        )

    def between_planes(self, superpoints: Superpoints) -> PlaneBoxes:
        """The boxes between the object's planes."""
        links = superpoints.links
        apart = np.linalg.norm(superpoints.center[links.a] - superpoints.center[links.b], axis=1)
        # The distance of superpoints, patches of some nodes, tells the distance of nodes.
        spacing = float(np.median(apart)) if len(apart) else 1.0
        spacing /= max(float(np.sqrt(np.median(superpoints.size))), 1.0)
        return plane_boxes(superpoints, self.place, self.facing, self.step, max(spacing, 1e-9))

    def bounds(self, masks: Bool) -> tuple[Int16, Int16]:
        """(H, 3) first and last step of each mask, without a hundredth of it at each end."""
        held = (self._bins @ masks.T.astype(np.float32)).T.reshape(len(masks), 3, STEPS)
        low, high = trimmed_range(held)
        return low.astype(np.int16), high.astype(np.int16)

    def contents(self, low: Int16, high: Int16, margin: int = 1) -> Bool:
        """(H, C) superpoints in boxes (H, 3) that are ``margin`` steps larger on each side."""
        first = np.clip(low - margin, 0, STEPS - 1).astype(np.uint8)
        last = np.clip(high + margin, 0, STEPS - 1).astype(np.uint8)
        out = np.ones((len(low), self.place.shape[1]), bool)
        for axis in range(3):
            out &= self.place[axis] >= first[:, axis, None]
            out &= self.place[axis] <= last[:, axis, None]
        return out

    def behind(self, low: Int16, high: Int16, most: int) -> tuple[Int16, Int16]:
        """Boxes from the ``most`` largest flat ones to the surfaces that face them, both ways."""
        lows: list[Int16] = []
        highs: list[Int16] = []
        side = (high - low + 1) * self.step
        order = np.sort(side, axis=1)
        flat = np.nonzero(order[:, 0] <= _FLAT * order[:, 1])[0]
        flat = flat[np.argsort(-order[flat, 1] * order[flat, 2], kind="stable")][:most]
        for one, other, long in zip(low[flat], high[flat], side[flat], strict=True):
            axis = int(long.argmin())
            ends = self._facing_surfaces(one, other, axis)
            for end in ends[ends >= other[axis] + _NEAREST][:_ENDS]:
                lows.append(one)
                highs.append(_moved(other, axis, end))
            for end in ends[ends <= one[axis] - _NEAREST][::-1][:_ENDS]:
                lows.append(_moved(one, axis, end))
                highs.append(other)
        if not lows:
            return np.zeros((0, 3), np.int16), np.zeros((0, 3), np.int16)
        return np.stack(lows), np.stack(highs)

    def _facing_surfaces(self, low: Int16, high: Int16, axis: int) -> Int64:
        """Steps along ``axis`` at which much surface faces a flat box, within its outline."""
        inside = self.contents(_moved(low, axis, 0)[None], _moved(high, axis, STEPS - 1)[None])[0]
        inside &= self.facing[axis]
        held = np.bincount(self.place[axis][inside], self.size[inside], STEPS)
        held = held + np.r_[held[1:], 0] + np.r_[0, held[:-1]]
        own = held[low[axis] : high[axis] + 1].max()
        peak = (held >= np.r_[0, held[:-1]]) & (held > np.r_[held[1:], 0])
        return np.nonzero(peak & (held > _COVER * own))[0]


def _moved(corner: Int16, axis: int, step: int) -> Int16:
    out = corner.copy()
    out[axis] = step
    return out


def trimmed_range(held: Float32) -> tuple[Int64, Int64]:
    """First and last bin along the last axis, without a hundredth of the content at each end."""
    passed = np.cumsum(held, axis=-1)
    total = passed[..., -1:]
    first = (passed > _TRIM * total).argmax(-1)
    return first, (passed >= (1 - _TRIM) * total * (1 - 1e-6)).argmax(-1)
