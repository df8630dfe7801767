"""What a candidate mask shows: its border, its shape, its colours, and how it fits the clicks."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import get_blas_funcs

from model.segmentation.describe.repeats import Repeats
from model.segmentation.encode.hierarchy import Hierarchy
from model.segmentation.encode.superpoints import Superpoints

Bool = npt.NDArray[np.bool_]
Float = npt.NDArray[np.floating]

SOURCES = (
    "contact", "absorb", "patch", "sweep",
    "grow", "replace", "union", "cut", "walk", "mend", "keep",
)  # fmt: skip
"""Where a mask came from. contact, absorb, patch: one region of that merge tree; sweep: a level
set of a random walk with little leaking through its border; grow: the earlier mask and a region;
replace: a region that holds all the clicks; union: a region around each click; cut: the earlier
mask without a region; walk: a random walk from the clicks alone; mend: a walk that keeps to a
mask; keep: the earlier mask and the clicked superpoint."""

FEATURE_NAMES = (
    "log_size", "border", "border_soft_min", "border_weak", "border_strong", "border_color",
    "border_turn", "border_per_size", "inside_strength", "inside_strong", "inside_weak",
    "extent_1", "extent_2", "extent_3", "flat", "thin", "one_normal", "color_spread",
    "click_depth", "click_depth_relative", "click_off_center", "first_depth_relative",
    "height", "life", "life_relative",
    "agreement", "agreement_max", "border_rank", "size_rank", "border_over_inside",
    "positives", "negatives", "last_positive", "overlap_before", "growth", "changed_border",
    "has_color", "bounds_filled", "closest_larger",
    *(f"from_{s}" for s in SOURCES),
    "change_size", "change_depth", "change_depth_relative", "change_depth_rank",
    "change_of_mask", "change_border", "change_border_weak", "change_normal", "repeats",
)  # fmt: skip
_AMONG = (
    "height", "life", "life_relative", "agreement", "agreement_max", "border_rank", "size_rank",
    "closest_larger", "change_depth_rank", *(f"from_{s}" for s in SOURCES),
)  # fmt: skip
"""What depends on where a mask came from and on the other masks."""


_gram = get_blas_funcs(("syrk",), dtype=np.float32)[0]
"""All inner products of columns, the upper half of them: half the work of a product."""

_KEPT = 64
"""Clicked superpoints whose distances to all others are kept."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Masks over the superpoints with what is known of their making.

    Attributes:
        masks: (H, C) bool.
        source: (H,) int8 index into ``SOURCES``.
        height, life: (H,) float32 cost at which a tree region forms, and how long it lasts.
    """

    masks: Bool
    source: npt.NDArray[np.int8]
    height: Float
    life: Float

    def __len__(self) -> int:
        return len(self.masks)

    @classmethod
    def of(cls, masks: list[Bool], source: str) -> Candidates:
        """Candidates that are no tree regions."""
        number = len(masks)
        zero = np.zeros(number, np.float32)
        return cls(
            np.stack(masks), np.full(number, SOURCES.index(source), np.int8), zero, zero.copy()
        )

    def take(self, index: npt.NDArray) -> Candidates:
        """Some of them."""
        return Candidates(
            self.masks[index], self.source[index], self.height[index], self.life[index]
        )


def concatenated(groups: list[Candidates]) -> Candidates:
    """All candidates of several groups, one after the other."""
    return Candidates(
        np.concatenate([g.masks for g in groups]),
        np.concatenate([g.source for g in groups]),
        np.concatenate([g.height for g in groups]),
        np.concatenate([g.life for g in groups]),
    )


def joined(groups: list[Candidates]) -> Candidates:
    """All candidates of several groups; of equal masks the first stays."""
    every = concatenated(groups)
    packed = np.packbits(every.masks, axis=1)
    _, first = np.unique(packed.view(f"V{packed.shape[1]}").ravel(), return_index=True)
    return every.take(np.sort(first))


@dataclass(frozen=True, eq=False)
class MendingClick:
    """A click that was to change a mask.

    Attributes:
        superpoint: that was clicked. positive: whether the part should hold it.
        before: (C,) the mask that whoever clicked saw, all False at the first click.
    """

    superpoint: int
    positive: bool
    before: Bool


@dataclass(frozen=True)
class Clicked:
    """The clicks that a mask must fit.

    Attributes:
        positive, negative: superpoints, in order.
        last: the superpoint clicked now, and on which side.
        before: (C,) the mask before this click, or None at the first.
        agreed: how many of the positive and of the negative ones changed nothing.
        steps: the ones before this that were to change a mask, in order.
    """

    positive: tuple[int, ...]
    negative: tuple[int, ...]
    last: int
    last_positive: bool
    before: Bool | None = None
    agreed: tuple[int, int] = (0, 0)
    steps: tuple[MendingClick, ...] = ()


def _rank(values: Float) -> npt.NDArray[np.int64]:
    """(H,) 0 for the lowest."""
    return np.argsort(np.argsort(values, kind="stable"), kind="stable")


def bits_of(masks: Bool) -> npt.NDArray[np.uint64]:
    """(C, W) the bits of all masks at each superpoint."""
    number, count = masks.shape
    padded = np.zeros((count, -(-number // 64) * 64), bool)
    padded[:, :number] = masks.T
    return np.packbits(padded, axis=1).view(np.uint64)


class MaskDescriber:
    """Computes the features of many masks at once.

    Attributes:
        names: of the features.
        among: those of them that depend on more than a mask and the clicks.
    """

    names: tuple[str, ...] = FEATURE_NAMES
    among: tuple[str, ...] = _AMONG

    def __init__(self, superpoints: Superpoints, hierarchy: Hierarchy) -> None:
        links = superpoints.links
        self._superpoints = superpoints
        self._a, self._b = links.a, links.b
        mean = links.strength / np.maximum(links.count, 1)
        unit = superpoints.normal / np.maximum(
            np.linalg.norm(superpoints.normal, axis=1, keepdims=True), 1e-9
        )
        turn = 1 - np.abs(np.einsum("ij,ij->i", unit[links.a], unit[links.b]))
        hue = np.linalg.norm(superpoints.color[links.a] - superpoints.color[links.b], axis=1) / 20
        per_link = np.stack(
            [
                np.ones(len(mean)),
                mean,
                np.exp(-mean),
                mean < 1.0,
                mean > 4.0,
                np.minimum(hue, 3),
                turn,
            ],
            axis=1,
        )
        self._link = (per_link * links.count[:, None]).astype(np.float32)
        incident = np.zeros((len(superpoints), 7))
        for column in range(7):
            incident[:, column] = np.bincount(
                links.a, self._link[:, column], len(superpoints)
            ) + np.bincount(links.b, self._link[:, column], len(superpoints))
        low, high = superpoints.center.min(0), superpoints.center.max(0)
        self._diagonal = max(float(np.linalg.norm(high - low)), 1e-9)
        x = (superpoints.center - (low + high) / 2) / self._diagonal
        self._x = x.astype(np.float32)
        self._root = float(np.sqrt(superpoints.size.sum()))
        size = superpoints.size / superpoints.size.sum()
        pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
        outer = np.stack([x[:, i] * x[:, j] for i, j in pairs], axis=1)
        color = superpoints.color / 20
        square = (color**2).sum(1, keepdims=True)
        one = np.ones((len(x), 1))
        moments = np.concatenate([one, x, outer, superpoints.normal, color, square], axis=1)
        self._cell = np.concatenate([moments * size[:, None], incident], axis=1).astype(np.float32)
        self._repeats = Repeats(superpoints, hierarchy, x)
        self._column = {name: i for i, name in enumerate(self.names)}
        self._own_names = tuple(n for n in self.names if n not in self.among)
        self._own_columns = [self._column[n] for n in self._own_names]
        self._click: Clicked | None = None
        self._seen: dict[bytes, Float] = {}
        self._near_to: OrderedDict[int, tuple[Float, npt.NDArray[np.int64]]] = OrderedDict()
        self._has_color = float(np.ptp(superpoints.color) > 1e-6)

    def __call__(self, candidates: Candidates, clicked: Clicked) -> Float:
        """(H, F) features, in the order of ``names``."""
        masks = candidates.masks
        own = self._known(masks, clicked)
        out = np.zeros((len(masks), len(self.names)), np.float32)
        out[:, self._own_columns] = own
        log_size, border = (own[:, self._own_names.index(n)] for n in ("log_size", "border"))
        m = masks.astype(np.float32)
        overlap = self._overlap(m)
        count = max(len(masks) - 1, 1)
        among = {
            "height": candidates.height,
            "life": candidates.life,
            "life_relative": candidates.life / (1 + 0.5 * candidates.height),
            "agreement": (overlap.sum(1) - 1) / count,
            "agreement_max": self._second(overlap),
            "border_rank": _rank(border) / count,
            "size_rank": _rank(log_size) / count,
            "closest_larger": self._next_larger(np.exp(log_size)),
            **{f"from_{s}": candidates.source == i for i, s in enumerate(SOURCES)},
        }
        if clicked.before is not None:
            depth = own[:, self._own_names.index("change_depth")]
            among["change_depth_rank"] = _rank(depth) / count
        for name, values in among.items():
            out[:, self._column[name]] = values
        return out

    def _known(self, masks: Bool, clicked: Clicked) -> Float:
        """(H, K) what masks show each by itself; those seen for the same click are kept.

        A click's masks are described twice: before some are mended, and with what came of that.
        """
        if self._click is not clicked:
            self._click, self._seen = clicked, {}
        keys = [row.tobytes() for row in np.packbits(masks, axis=1)]
        new = [i for i, key in enumerate(keys) if key not in self._seen]
        if new:
            rows = self._own(masks[new], bits_of(masks[new]), clicked)
            for i, row in zip(new, rows, strict=True):
                self._seen[keys[i]] = row
        return np.stack([self._seen[key] for key in keys])

    def _own(self, masks: Bool, words: npt.NDArray[np.uint64], clicked: Clicked) -> Float:
        """(H, K) what each mask shows by itself, in the order of ``own_names``.

        Args:
            words: (C, W) one bit a mask: on which sides of all the masks a superpoint lies.
        """
        m = masks.astype(np.float32)
        crossed = words[self._a] ^ words[self._b]
        border = self._over_links(crossed, len(masks))
        moved = self._moved(crossed, border, clicked)
        sums = m @ self._cell
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
        spread = np.sqrt(np.maximum(sums[:, 16] / area - (color**2).sum(1), 0))
        depth = self._depth(words, len(masks), clicked.last)
        first = clicked.positive[0] if clicked.positive else clicked.last
        first_depth = depth if first == clicked.last else self._depth(words, len(masks), first)
        off = np.linalg.norm(center - self._x[clicked.last], axis=1)
        extent = np.maximum(extents[:, 2], 1e-6)
        columns = [
            np.log(area), mean_border, soft, border[:, 3] / b0, border[:, 4] / b0,
            border[:, 5] / b0, border[:, 6] / b0, np.log(b0 / (scale * self._root) + 1e-3),
            inside[:, 1] / i0, inside[:, 4] / i0, inside[:, 3] / i0,
            extents[:, 2], extents[:, 1], extents[:, 0], extents[:, 0] / (extents[:, 1] + 1e-6),
            extents[:, 1] / extent, np.linalg.norm(sums[:, 10:13], axis=1) / area, spread,
            depth, depth / scale, off / extent, first_depth / scale,
            mean_border - inside[:, 1] / i0,
            *self._context(moved, clicked, m, area),
            np.full(len(m), self._has_color),
            area / np.maximum(extents.prod(1) ** (2 / 3), 1e-6).clip(1e-6),
            *self._change(words, moved, masks, clicked, area).T,
            self._repeats(sums[:, [0, 1, 2, 3, 4, 7, 9]]),
        ]  # fmt: skip
        return np.stack([np.asarray(c, np.float32) for c in columns], axis=1)

    def _moved(
        self, crossed: npt.NDArray[np.uint64], border: Float, clicked: Clicked
    ) -> Float | None:
        """(H, 7) as ``border``, for the border of what a mask changes: where either has one."""
        if clicked.before is None:
            return None
        edge = np.nonzero(clicked.before[self._a] ^ clicked.before[self._b])[0]
        shared = self._over_links(crossed[edge], len(border), edge)
        return np.maximum(border - 2 * shared + self._link[edge].sum(0), 0)

    def _change(
        self,
        words: npt.NDArray[np.uint64],
        border: Float | None,
        masks: Bool,
        clicked: Clicked,
        area: Float,
    ) -> Float:
        """(H, 7) what the click flips: people click into the middle of what is wrong."""
        number = len(masks)
        before = clicked.before
        if before is None or border is None:
            return np.zeros((number, 7), np.float32)
        flipped = masks ^ before
        moved = np.asarray(np.where(before[:, None], ~words, words), np.uint64)
        sums = flipped.astype(np.float32) @ self._cell[:, :13]
        size = np.maximum(sums[:, 0], 1e-9)
        b0 = np.maximum(border[:, 0], 1e-9)
        depth = self._depth(moved, number, clicked.last)
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
        ).astype(np.float32)

    def _over_links(
        self,
        crossed: npt.NDArray[np.uint64],
        number: int,
        links: npt.NDArray[np.int64] | None = None,
    ) -> Float:
        """(H, 7) sums over the links that each mask's border crosses, (M, words)."""
        any_ = crossed[:, 0].copy()
        for word in range(1, crossed.shape[1]):
            any_ |= crossed[:, word]
        touched = np.nonzero(any_)[0]
        bits = np.unpackbits(crossed[touched].view(np.uint8), axis=1)[:, :number]
        held = self._link[touched if links is None else links[touched]]
        return bits.astype(np.float32).T @ held

    def _around(self, superpoint: int) -> tuple[Float, npt.NDArray[np.int64]]:
        """(C,) distances from a superpoint, diagonal = 1, and the superpoints by it."""
        if superpoint not in self._near_to:
            apart = np.linalg.norm(self._x - self._x[superpoint], axis=1)
            self._near_to[superpoint] = apart, np.argsort(apart)
            if len(self._near_to) > _KEPT:
                self._near_to.popitem(last=False)
        return self._near_to[superpoint]

    def _extents(self, second: Float, center: Float) -> Float:
        covariance = second[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
        covariance = covariance - center[:, :, None] * center[:, None, :]
        return np.sqrt(np.maximum(np.linalg.eigvalsh(covariance.astype(np.float64)), 0)).astype(
            np.float32
        )

    def _depth(self, words: npt.NDArray[np.uint64], number: int, superpoint: int) -> Float:
        """(H,) distance from a superpoint to the nearest superpoint on the other side, diagonal = 1."""
        apart, order = self._around(superpoint)
        out = np.ones(number, np.float32)
        open_ = np.ones(number, bool)
        begin, step = 0, 256
        # Most borders are near: look at ever larger rings until every mask has met its own.
        while begin < len(order) and open_.any():
            ring = order[begin : begin + step]
            other = np.unpackbits((words[ring] ^ words[superpoint]).view(np.uint8), axis=1)[
                :, :number
            ]
            first = other.argmax(0)
            met = open_ & (other[first, np.arange(number)] > 0)
            out[met] = apart[ring[first[met]]]
            open_ &= ~met
            begin, step = begin + step, step * 3
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
        """(H,) log of how much larger the next larger candidate is, at most 3."""
        order = np.sort(area)
        index = np.searchsorted(order, area * 1.02)
        larger = np.where(index < len(order), order[np.minimum(index, len(order) - 1)], area * 20)
        return np.minimum(np.log(larger / area), 3)

    def _context(self, moved: Float | None, clicked: Clicked, m: Float, area: Float) -> list[Float]:
        number = len(m)
        overlap = np.zeros(number, np.float32)
        growth = np.zeros(number, np.float32)
        changed = np.zeros(number, np.float32)
        if moved is not None and clicked.before is not None and clicked.before.any():
            before = clicked.before.astype(np.float32)
            common = m @ before
            overlap = common / np.maximum(m.sum(1) + before.sum() - common, 1)
            was = float((self._cell[:, 0] * before).sum())
            growth = np.clip(np.log(area / max(was, 1e-9)), -4, 4)
            changed = moved[:, 1] / np.maximum(moved[:, 0], 1)
        return [
            np.full(number, min(max(len(clicked.positive) - clicked.agreed[0], 1), 10)),
            np.full(number, min(max(len(clicked.negative) - clicked.agreed[1], 0), 10)),
            np.full(number, float(clicked.last_positive)),
            overlap,
            growth,
            changed,
        ]
