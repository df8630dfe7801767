"""Describe masks by features: border, shape, colour, repeats, and how they fit the clicks.

Keys, knobs and drawers seldom occur once. Every region of the merge trees is described by its size
and its spread along the axes; a mask's repeats are similar regions elsewhere. Copies at another
angle are missed. Masks in a room also have their size in metres, where they stand, and how they
fill their box.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
import numpy.typing as npt
from cachetools import LRUCache, cachedmethod
from scipy.linalg import get_blas_funcs
from scipy.spatial import KDTree

from model.segmentation.arrays import Bool, Float, Float32, Float64, Int64, Uint64
from model.segmentation.boxes import bounds_of, contents_of
from model.segmentation.encoding import Hierarchy, Room
from model.segmentation.proposals import SOURCES, CorrectiveClick, PartState, Proposals
from model.segmentation.superpoints import Superpoints

_LEAST_CELLS = 3
_MOST_SHARE = 0.35
_ALIKE = 0.18
_MOST = 40
_ORIGIN = 1 << 20
"""Added to places, in radii, to make them positive: 21 bits hold each coordinate."""


class Repeats:
    """Looks up the regions of an object's merge trees by shape."""

    def __init__(self, superpoints: Superpoints, hierarchy: Hierarchy, x: Float) -> None:
        """``x`` (C, 3): centres of the superpoints, the object's diagonal being 1."""
        labels, offset = hierarchy.labels, hierarchy.offset
        flat = (labels + offset[:-1, None]).ravel()
        number, levels = int(offset[-1]), len(labels)
        cell_count = np.bincount(flat, minlength=number)
        share = superpoints.size / superpoints.size.sum()
        moments = np.concatenate([np.ones((len(x), 1)), x, x**2], axis=1) * share[:, None]
        sums = np.stack([np.bincount(flat, np.tile(m, levels), number) for m in moments.T], axis=1)
        keep = (cell_count >= _LEAST_CELLS) & (sums[:, 0] <= _MOST_SHARE)
        # A region that outlives several levels is one region.
        keys = np.round(sums[keep] * 1e7).astype(np.int64)
        _, first = np.unique(keys, axis=0, return_index=True)
        shape, self._center = _shape(np.asarray(sums, np.float64)[keep][first])
        self._tree = KDTree(shape) if len(shape) else None

    def __call__(self, sums: Float) -> Float:
        """(H,) log of 1 + the number of similar regions elsewhere.

        Args:
            sums: (H, 7) share of the surface, and its first and second moments about the origin.
        """
        out = np.zeros(len(sums), np.float32)
        if self._tree is None:
            return out
        wanted = np.nonzero((sums[:, 0] > 0) & (sums[:, 0] <= _MOST_SHARE))[0]
        shape, center = _shape(sums[wanted].astype(np.float64))
        found = self._tree.query_ball_point(shape, _ALIKE)
        for row, hits in enumerate(found):
            if len(hits) < 2:
                continue
            radius = np.exp(shape[row, 1:]).max() * 2
            apart = self._center[hits] - center[row]
            other = np.abs(apart).max(1) > radius
            places = np.round(apart[other] / radius).astype(np.int64) + _ORIGIN
            keys = (places[:, 0] << 42) | (places[:, 1] << 21) | places[:, 2]
            out[wanted[row]] = np.log1p(min(len(set(keys.tolist())), _MOST))
        return out


def _shape(sums: Float) -> tuple[Float, Float]:
    """(H, 4) log of the root of the area and of the spread along each axis; (H, 3) centres."""
    area = np.maximum(sums[:, :1], 1e-12)
    center = sums[:, 1:4] / area
    spread = np.sqrt(np.maximum(sums[:, 4:7] / area - center**2, 0)) + 0.15 * np.sqrt(area) + 2e-3
    return np.log(np.concatenate([np.sqrt(area), spread], axis=1)), center


FEATURE_NAMES = (
    *"log_size border border_soft_min border_weak border_strong border_color border_turn".split(),
    *"border_per_size inside_strength inside_strong inside_weak extent_1 extent_2 extent_3".split(),
    *"flat thin one_normal color_spread click_depth click_depth_relative click_off_center".split(),
    *"first_depth_relative height life life_relative agreement agreement_max border_rank".split(),
    *"size_rank border_over_inside positives negatives last_positive overlap_before growth".split(),
    *"changed_border has_color bounds_filled closest_larger".split(),
    *(f"from_{s}" for s in SOURCES),
    *"change_size change_depth change_depth_relative change_depth_rank change_of_mask".split(),
    *"change_border change_border_weak change_normal repeats".split(),
)
"""Stored in the files of weights, so these names stay as they are."""
_RELATIVE = (
    *"height life life_relative agreement agreement_max border_rank size_rank".split(),
    *"closest_larger change_depth_rank".split(),
    *(f"from_{s}" for s in SOURCES),
)
"""Features that depend on a mask's source or on the other masks."""

_gram = get_blas_funcs(("syrk",), dtype=np.float32)[0]
"""All inner products of columns, the upper half of them: half the work of a full product."""
_NOISE = 1e-12
"""Variance, the diagonal being 1, that rounding may leave of none."""
_CACHED = 64
"""Clicked superpoints whose distances to all others are cached."""
_RING, _RING_GROWTH = 256, 3
"""Superpoints of the first ring around a click that is searched for a border, and its growth."""


@dataclass(frozen=True)
class ClickContext:
    """The clicks that a mask must fit.

    Attributes:
        positive, negative: superpoints, in order.
        last, last_positive: the superpoint clicked now, and whether the part should hold it.
        before: (C,) the mask before this click, None at the first.
        confirmed: how many positive and negative clicks agreed with the mask.
        corrections: the earlier clicks that didn't, in order.
    """

    positive: tuple[int, ...]
    negative: tuple[int, ...]
    last: int
    last_positive: bool
    before: Bool | None = None
    confirmed: tuple[int, int] = (0, 0)
    corrections: tuple[CorrectiveClick, ...] = ()

    @classmethod
    def of(
        cls, before: PartState, after: PartState, superpoint: int, positive: bool
    ) -> ClickContext:
        """The context of a click that leads from one state to another."""
        return cls(
            after.positive,
            after.negative,
            superpoint,
            positive,
            before.mask,
            before.confirmed,
            before.corrections,
        )

    @property
    def first(self) -> int:
        """The superpoint that was clicked first."""
        return self.positive[0] if self.positive else self.last


def _rank(values: Float) -> Int64:
    """(H,) 0 for the lowest."""
    return np.argsort(np.argsort(values, kind="stable"), kind="stable")


def rounded(columns: Sequence[npt.ArrayLike]) -> Float32:
    """(H, K) features from columns (H,), without residues, which trees would compare with 0."""
    return np.round(np.stack([np.asarray(c, np.float64) for c in columns], 1), 9).astype(np.float32)


def bits_of(masks: Bool) -> Uint64:
    """(C, W) the bits of all masks at each superpoint."""
    number, count = masks.shape
    padded = np.zeros((count, -(-number // 64) * 64), bool)
    padded[:, :number] = masks.T
    return np.packbits(padded, axis=1).view(np.uint64)


class MaskDescriber:
    """Computes the features of many masks at once.

    Attributes:
        names: of the features.
        relative: those of them that depend on more than a mask and the clicks.
    """

    names: tuple[str, ...] = FEATURE_NAMES
    relative: tuple[str, ...] = _RELATIVE

    def __init__(self, superpoints: Superpoints, hierarchy: Hierarchy) -> None:
        links = superpoints.links
        self._superpoints = superpoints
        self._a, self._b = links.a, links.b
        self._link = _link_features(superpoints)
        incident = np.zeros((len(superpoints), 7))
        for column in range(7):
            incident[:, column] = np.bincount(
                links.a, self._link[:, column], len(superpoints)
            ) + np.bincount(links.b, self._link[:, column], len(superpoints))
        low, high = superpoints.center.min(0), superpoints.center.max(0)
        x = (superpoints.center - (low + high) / 2) / max(float(np.linalg.norm(high - low)), 1e-9)
        self._x = x.astype(np.float32)
        self._root = float(np.sqrt(superpoints.size.sum()))
        self._features = np.concatenate([_moments(superpoints, x), incident], axis=1)
        self._repeats = Repeats(superpoints, hierarchy, x)
        self._column = {name: i for i, name in enumerate(self.names)}
        self._own_names = tuple(n for n in self.names if n not in self.relative)
        self._own_columns = [self._column[n] for n in self._own_names]
        self._context: ClickContext | None = None
        self._known: dict[bytes, Float] = {}
        self._distances: LRUCache = LRUCache(_CACHED)
        self._has_color = float(np.ptp(superpoints.color) > 1e-6)

    def __call__(self, proposals: Proposals, context: ClickContext) -> Float:
        """(H, F) features, in the order of ``names``."""
        masks = proposals.masks
        own = self._own_features(masks, context)
        out = np.zeros((len(masks), len(self.names)), np.float32)
        out[:, self._own_columns] = own
        log_size, border = (own[:, self._own_names.index(n)] for n in ("log_size", "border"))
        overlap = self._overlap(masks.astype(np.float32))
        count = max(len(masks) - 1, 1)
        relative = {
            "height": proposals.height,
            "life": proposals.life,
            "life_relative": proposals.life / (1 + 0.5 * proposals.height),
            "agreement": (overlap.sum(1) - 1) / count,
            "agreement_max": self._second(overlap),
            "border_rank": _rank(border) / count,
            "size_rank": _rank(log_size) / count,
            "closest_larger": self._next_larger(np.exp(log_size, dtype=np.float64)),
            **{f"from_{s}": proposals.source == i for i, s in enumerate(SOURCES)},
        }
        if context.before is not None:
            depth = own[:, self._own_names.index("change_depth")]
            relative["change_depth_rank"] = _rank(depth) / count
        for name, values in relative.items():
            out[:, self._column[name]] = values
        return out

    def _own_features(self, masks: Bool, context: ClickContext) -> Float:
        """(H, K) features of each mask by itself, in the order of ``_own_names``.

        Cached for one click, whose masks are described twice: before and after random walks.
        """
        if self._context is not context:
            self._context, self._known = context, {}
        keys = [row.tobytes() for row in np.packbits(masks, axis=1)]
        new = [i for i, key in enumerate(keys) if key not in self._known]
        if new:
            rows = self._own(masks[new], bits_of(masks[new]), context)
            for i, row in zip(new, rows, strict=True):
                self._known[keys[i]] = row
        return np.stack([self._known[key] for key in keys])

    def _own(self, masks: Bool, words: Uint64, context: ClickContext) -> Float:
        """(H, K) features of each mask by itself, computed.

        Args:
            words: (C, W) the bits of all masks at each superpoint, see :func:`bits_of`.
        """
        m = masks.astype(np.float64)
        crossed = words[self._a] ^ words[self._b]
        border = self._over_links(crossed, len(masks))
        changed = self._changed_border(crossed, border, context)
        sums = m @ self._features
        inside = np.maximum(sums[:, 17:] - border, 0) / 2
        area = np.maximum(sums[:, 0], 1e-9)
        center = sums[:, 1:4] / area[:, None]
        extents = self._extents(sums[:, 4:10] / area[:, None], center)
        b0 = np.maximum(border[:, 0], 1e-9)
        no_border = border[:, 0] < 0.5
        mean_border = np.where(no_border, 9.0, border[:, 1] / b0)
        soft = np.where(no_border, 9.0, -np.log(np.maximum(border[:, 2] / b0, 1e-4)))
        i0 = np.maximum(inside[:, 0], 1)
        scale = np.sqrt(area)
        color = sums[:, 13:16] / area[:, None]
        spread = np.sqrt(np.maximum(sums[:, 16] / area - (color**2).sum(1), _NOISE))
        depth = self._depth(words, len(masks), context.last)
        first = context.first
        first_depth = depth if first == context.last else self._depth(words, len(masks), first)
        off = np.linalg.norm(center - self._x[context.last], axis=1)
        extent = np.maximum(extents[:, 2], 1e-6)
        columns = [
            np.log(area), mean_border, soft, border[:, 3] / b0, border[:, 4] / b0,
            border[:, 5] / b0, border[:, 6] / b0, np.log(b0 / (scale * self._root) + 1e-3),
            inside[:, 1] / i0, inside[:, 4] / i0, inside[:, 3] / i0,
            extents[:, 2], extents[:, 1], extents[:, 0], extents[:, 0] / (extents[:, 1] + 1e-6),
            extents[:, 1] / extent, np.linalg.norm(sums[:, 10:13], axis=1) / area, spread,
            depth, depth / scale, off / extent, first_depth / scale,
            mean_border - inside[:, 1] / i0,
            *self._click_features(changed, context, m, area),
            np.full(len(m), self._has_color),
            area / np.maximum(extents.prod(1) ** (2 / 3), 1e-6).clip(1e-6),
            *self._change(words, changed, masks, context, area).T,
            self._repeats(sums[:, [0, 1, 2, 3, 4, 7, 9]]),
        ]  # fmt: skip
        return rounded(columns)

    def _changed_border(
        self, crossed: Uint64, border: Float, context: ClickContext
    ) -> Float | None:
        """(H, 7) as ``border``, for the border of the change from the mask before."""
        if context.before is None:
            return None
        edge = np.nonzero(context.before[self._a] ^ context.before[self._b])[0]
        shared = self._over_links(crossed[edge], len(border), edge)
        return np.maximum(border - 2 * shared + self._link[edge].sum(0), 0)

    def _change(
        self, words: Uint64, border: Float | None, masks: Bool, context: ClickContext, area: Float
    ) -> Float:
        """(H, 7) features of the change: people click in the middle of what is wrong."""
        number = len(masks)
        before = context.before
        if before is None or border is None:
            return np.zeros((number, 7), np.float32)
        flipped = masks ^ before
        changed = np.asarray(np.where(before[:, None], ~words, words), np.uint64)
        sums = flipped.astype(np.float64) @ self._features[:, :13]
        size = np.maximum(sums[:, 0], 1e-9)
        b0 = np.maximum(border[:, 0], 1e-9)
        depth = self._depth(changed, number, context.last)
        return np.stack(
            [
                np.log(size),
                depth,
                depth / np.sqrt(size),
                np.minimum(size / np.maximum(area, 1e-9), 4),
                border[:, 1] / b0,
                border[:, 3] / b0,
                np.linalg.norm(sums[:, 10:13], axis=1) / size,
            ],
            axis=1,
        )

    def _over_links(self, crossed: Uint64, number: int, links: Int64 | None = None) -> Float:
        """(H, 7) sums over the links that each mask's border crosses.

        Args:
            crossed: (M, W) bits of the masks whose border crosses each link.
        """
        any_ = crossed[:, 0].copy()
        for word in range(1, crossed.shape[1]):
            any_ |= crossed[:, word]
        touched = np.nonzero(any_)[0]
        bits = np.unpackbits(crossed[touched].view(np.uint8), axis=1)[:, :number]
        held = self._link[touched if links is None else links[touched]]
        return bits.astype(np.float64).T @ held

    @cachedmethod(attrgetter("_distances"))
    def _around(self, superpoint: int) -> tuple[Float, Int64]:
        """(C,) distances from a superpoint, diagonal = 1, and the superpoints by distance."""
        apart = np.linalg.norm(self._x - self._x[superpoint], axis=1)
        return apart, np.argsort(apart, kind="stable")

    def _extents(self, second: Float, center: Float) -> Float:
        covariance = second[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
        covariance = covariance - center[:, :, None] * center[:, None, :]
        return np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), _NOISE))

    def _depth(self, words: Uint64, number: int, superpoint: int) -> Float:
        """(H,) distance from a superpoint to the nearest one on the other side, diagonal = 1."""
        apart, order = self._around(superpoint)
        out = np.ones(number, np.float32)
        open_ = np.ones(number, bool)
        begin, step = 0, _RING
        # Most borders are near: search ever larger rings until every mask has met its border.
        while begin < len(order) and open_.any():
            ring = order[begin : begin + step]
            other = np.unpackbits((words[ring] ^ words[superpoint]).view(np.uint8), axis=1)[
                :, :number
            ]
            first = other.argmax(0)
            found = open_ & (other[first, np.arange(number)] > 0)
            out[found] = apart[ring[first[found]]]
            open_ &= ~found
            begin, step = begin + step, step * _RING_GROWTH
        return np.minimum(out, 1)

    @staticmethod
    def _overlap(m: Float) -> Float:
        half = _gram(1.0, m.T, trans=1)
        size = np.diagonal(half)
        common = half + half.T - np.diag(size)
        return common / np.maximum(size[:, None] + size[None] - common, 1e-9)

    @staticmethod
    def _second(overlap: Float) -> Float:
        return np.sort(overlap, axis=1)[:, -2] if len(overlap) > 1 else np.zeros(len(overlap))

    @staticmethod
    def _next_larger(area: Float) -> Float:
        """(H,) log ratio of the next larger mask's size to each one's, at most 3."""
        order = np.sort(area)
        index = np.searchsorted(order, area * 1.02)
        larger = np.where(index < len(order), order[np.minimum(index, len(order) - 1)], area * 20)
        return np.minimum(np.log(larger / area), 3)

    def _click_features(
        self, border: Float | None, context: ClickContext, m: Float, area: Float
    ) -> list[Float]:
        """(H,) each: clicks so far, and overlap, growth and border of the change."""
        number = len(m)
        overlap = np.zeros(number, np.float32)
        growth = np.zeros(number, np.float32)
        changed = np.zeros(number, np.float32)
        if border is not None and context.before is not None and context.before.any():
            before = context.before.astype(np.float64)
            common = m @ before
            overlap = common / np.maximum(m.sum(1) + before.sum() - common, 1)
            was = float((self._features[:, 0] * before).sum())
            growth = np.clip(np.log(area / max(was, 1e-9)), -4, 4)
            changed = border[:, 1] / np.maximum(border[:, 0], 1)
        return [
            np.full(number, min(max(len(context.positive) - context.confirmed[0], 1), 10)),
            np.full(number, min(max(len(context.negative) - context.confirmed[1], 0), 10)),
            np.full(number, float(context.last_positive)),
            overlap,
            growth,
            changed,
        ]


def _link_features(superpoints: Superpoints) -> Float64:
    """(M, 7) features of the links, weighted by their number of node edges."""
    links = superpoints.links
    mean = links.strength / np.maximum(links.count, 1)
    length = np.linalg.norm(superpoints.normal, axis=1, keepdims=True)
    unit = superpoints.normal / np.maximum(length, 1e-9)
    turn = 1 - np.abs(np.einsum("ij,ij->i", unit[links.a], unit[links.b]))
    hue = np.linalg.norm(superpoints.color[links.a] - superpoints.color[links.b], axis=1) / 20
    one = np.ones(len(mean))
    columns = [one, mean, np.exp(-mean), mean < 1.0, mean > 4.0, np.minimum(hue, 3), turn]
    return np.stack(columns, axis=1) * links.count[:, None]


def _moments(superpoints: Superpoints, x: Float) -> Float:
    """(C, 17) share of the surface times 1, place, its outer product, normal and colour."""
    size = superpoints.size / superpoints.size.sum()
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    outer = np.stack([x[:, i] * x[:, j] for i, j in pairs], axis=1)
    color = superpoints.color / 20
    square = (color**2).sum(1, keepdims=True)
    one = np.ones((len(x), 1))
    moments = np.concatenate([one, x, outer, superpoints.normal, color, square], axis=1)
    return moments * size[:, None]


ROOM_FEATURES = (
    *"on_border long_side short_side height_metres bottom top box_filled".split(),
    *"box_growth click_outside".split(),
)
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
