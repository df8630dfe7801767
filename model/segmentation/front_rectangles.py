"""Rectangles on a flat front, found by the lines in a picture of it.

A gap between two flush doors is narrower than the point spacing, and no edge of the graph is strong
there by itself. But the line is as long as the door: along it a little darkness, a dent, a step and
missing points add up. So evidence is summed over whole sides of rectangles.

The front is cut again and again at the strongest lines around a click, as pages are cut into
columns and paragraphs: recursive X-Y cuts (Nagy and Seth, *Hierarchical representation of optically
scanned documents*, 1984).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import uniform_filter1d

from model.segmentation.arrays import Bool, Float, Float32, Int32, Int64

Rect = tuple[int, int, int, int]
"""First and last column, first and last row, of squares."""
Rects = Int64
"""(R, 4) many of them."""

CHANNELS = ("strength", "gap", "dark", "dent", "step", "tilt", "hue")
"""Evidence of a line: strong edges, missing points, darkness, a dent, a step in depth, slanting
normals, a step in colour."""
_WEIGHT = np.array([0.3, 0.25, 0.25, 0.2, 0.2, 0.1, 0.2])
"""Weights of the channels in their mean."""
MAX_EVIDENCE = 4.0
"""In robust deviations of the region."""
HIDDEN = 0.05
"""Weight of a square that a handle hides or shades."""
_AROUND, _STEP = 3, 2
"""Squares over which values beside a line are averaged, and how far beside a step lies."""
_MARGIN = 2 * _AROUND
"""Squares around a region that affect the evidence within it."""


@dataclass(frozen=True, eq=False)
class Front:
    """The picture of a flat front: U columns by V rows of squares.

    Attributes:
        axis: main direction that it faces along; across: the two others.
        low: (2,) metres of the picture's corner; side: metres of a square.
        outward: 1 or -1, to which side along ``axis`` it faces.
        depth: metres along ``outward`` of its middle; reach: how far it extends in depth.
        region: (U, V) squares of the connected front.
        nodes: (U + 1, V + 1) int64 nodes before each column and row.
        knobs: (B, 2) column and row of the middle of each thing that stands out before it.
        knob_of: (U, V) int32 which of these hides or shades a square, -1 none.
        length: (B,) their ratios of length to width.
        columns, rows: (U, V + 1, K), (U + 1, V, K) evidence of vertical lines, summed along the
            second axis, and of horizontal ones, summed along the first: the channels, their mean,
            and the weight of the squares.
    """

    axis: int
    across: tuple[int, int]
    low: Float
    side: float
    outward: int
    depth: float
    reach: float
    region: Bool
    nodes: Int64
    knobs: Float
    knob_of: Int32
    length: Float
    columns: Float
    rows: Float

    @property
    def shape(self) -> tuple[int, int]:
        """Columns and rows."""
        return self.region.shape  # type: ignore[return-value]

    @cached_property
    def bounds(self) -> Rect:
        """Bounding rectangle of the region."""
        u, v = np.flatnonzero(self.region.any(1)), np.flatnonzero(self.region.any(0))
        return int(u[0]), int(u[-1]), int(v[0]), int(v[-1])

    def vertical(self, v0: int | Int64, v1: int | Int64) -> Float:
        """(U,) mean evidence of a vertical line at each column, between rows ``v0`` and ``v1``;
        (U, R) for R ranges of rows.
        """
        return _mean(self.columns[:, v1 + 1, -2:] - self.columns[:, v0, -2:])[..., 0]

    def horizontal(self, u0: int | Int64, u1: int | Int64) -> Float:
        """(V,) the same of horizontal lines; (R, V) for R ranges of columns."""
        return _mean(self.rows[u1 + 1, :, -2:] - self.rows[u0, :, -2:])[..., 0]

    def sides(self, rects: Rects, reach: int = 1) -> Float:
        """(R, 4, K) evidence along the sides of rectangles (left, right, below, above), the best
        within ``reach`` squares.

        The sides of the front itself are certain.
        """
        found = []
        for side in range(4):
            held, outermost = self._along(rects, side, reach)
            best = held[np.arange(len(rects)), held[..., -1].argmax(1)]
            best[outermost] = MAX_EVIDENCE / 2
            found.append(best)
        return np.stack(found, axis=1)

    def lines(self, rects: Rects, side: int, reach: int = 1) -> Float:
        """(R,) the channels' mean of one of these sides."""
        held, outermost = self._along(rects, side, reach, slice(-2, None))
        best = held[..., 0].max(1)
        best[outermost] = MAX_EVIDENCE / 2
        return best

    def _along(
        self, rects: Rects, side: int, reach: int, channels: slice = slice(None)
    ) -> tuple[Float, Bool]:
        """(R, 2 * reach + 1, K) mean evidence at and beside one side of rectangles, and (R,)
        whether that side is one of the front's own.
        """
        axis = side // 2
        at = rects[:, side] + side % 2
        begin, end = rects[:, 2 - 2 * axis, None], rects[:, 3 - 2 * axis, None] + 1
        places = np.clip(at[:, None] + np.arange(-reach, reach + 1), 0, self.shape[axis] - 1)
        if axis == 0:
            columns = self.columns[..., channels]
            held = columns[places, end] - columns[places, begin]
        else:
            rows = self.rows[..., channels]
            held = rows[end, places] - rows[begin, places]
        outermost = np.abs(at - self.bounds[side] - side % 2) <= 1 + reach
        return _mean(held), outermost

    def within(self, rects: Rects) -> Float32:
        """(R, 2) the strongest vertical and horizontal line within each rectangle."""
        u0, u1, v0, v1 = rects.T
        vertical, horizontal = self.vertical(v0, v1), self.horizontal(u0, u1).T
        return np.stack(
            [_highest(vertical, u0 + 3, u1 - 1), _highest(horizontal, v0 + 3, v1 - 1)], axis=1
        )

    def held(self, rects: Rects) -> Int64:
        """(R,) nodes in each rectangle."""
        u0, u1, v0, v1 = rects.T
        n = self.nodes
        return n[u1 + 1, v1 + 1] - n[u0, v1 + 1] - n[u1 + 1, v0] + n[u0, v0]


def line_evidence(maps: dict[str, Float], there: Bool, region: Bool, weight: Float) -> Float:
    """(U, V + 1, K + 2) evidence of vertical lines in each square, summed along the second axis.

    Each channel is the contrast with the squares on either side, in robust deviations of the
    region. The last two entries are the channels' mean and the squares' weight.

    Args:
        maps: (U, V) means of node values by name. there: (U, V) squares with nodes.
        region: (U, V) squares of the front. weight: (U, V) of each square.
    """
    out = np.zeros((*there.shape, len(CHANNELS) + 1), np.float32)
    inner = tuple(
        slice(max(int(at[0]) - _MARGIN, 0), int(at[-1]) + _MARGIN + 1)
        for at in (np.flatnonzero(region.any(1)), np.flatnonzero(region.any(0)))
    )
    out[inner] = _evidence({n: m[inner] for n, m in maps.items()}, there[inner], region[inner])
    each = np.concatenate([out * weight[..., None], weight[..., None]], axis=2)
    return np.concatenate([np.zeros_like(each[:, :1]), np.cumsum(each, axis=1)], axis=1)


def _evidence(maps: dict[str, Float], there: Bool, region: Bool) -> Float32:
    """(U, V, K + 1) the channels and their mean."""
    out = np.zeros((*there.shape, len(CHANNELS) + 1), np.float32)
    weight = there.astype(np.float64)
    held = uniform_filter1d(weight, _AROUND, axis=0, mode="constant")
    gap = np.minimum(_shifted(held, -_AROUND), _shifted(held, _AROUND))
    found = _contrasts(maps, there, weight)
    for k, name in enumerate(CHANNELS):
        if name == "gap":
            out[..., k] = np.where(there, 0.0, gap) * region * 2
            continue
        if name not in found:
            continue
        x = found[name]
        inside = x[region & there]
        middle = np.median(inside)
        spread = 1.4826 * np.median(np.abs(inside - middle)) + 1e-6
        out[..., k] = np.clip((x - middle) / spread, -1.5, MAX_EVIDENCE) * region
    out[..., -1] = out[..., :-1].astype(np.float64) @ _WEIGHT
    return out


def _contrasts(maps: dict[str, Float], there: Bool, weight: Float) -> dict[str, Float]:
    """(U, V) by channel, but for gaps: how much a square differs from those beside it."""
    smooth = {name: _smooth(m, weight) for name, m in maps.items()}

    def beside(name: str, apart: int) -> tuple[Float, Float]:
        return _shifted(smooth[name], -apart), _shifted(smooth[name], apart)

    def ridge(name: str) -> Float:
        before, after = beside(name, _AROUND)
        return np.where(there, maps[name] - (before + after) / 2, 0.0)

    before, after = beside("depth", _AROUND)
    one, other = beside("depth", _STEP)
    found = {
        "strength": ridge("strength"),
        "dent": np.where(there, np.minimum(before, after) - maps["depth"], 0.0),
        "step": np.abs(one - other),
        "tilt": ridge("tilt"),
    }
    if "L" in maps:
        found["dark"] = -ridge("L")
        hues = [beside(name, _STEP) for name in "Lab"]
        found["hue"] = np.sqrt(sum((one - other) ** 2 for one, other in hues))
    return found


def _smooth(values: Float, there: Float) -> Float:
    """Mean over ``_AROUND`` squares along the first axis, of those that hold nodes."""
    held = uniform_filter1d(there, _AROUND, axis=0, mode="constant")
    mean = uniform_filter1d(values * there, _AROUND, axis=0, mode="constant")
    return np.where(held > 1e-9, mean / np.maximum(held, 1e-9), 0.0)


def _shifted(x: Float, shift: int) -> Float:
    """``x[i + shift]`` at i, zero beyond."""
    out = np.zeros_like(x)
    if shift >= 0:
        out[: len(x) - shift] = x[shift:]
    else:
        out[-shift:] = x[:shift]
    return out


def _mean(held: Float) -> Float:
    """Weighted means of summed evidence (..., K + 1), whose last entry is the summed weight."""
    return held[..., :-1] / np.maximum(held[..., -1:], HIDDEN)


def _highest(line: Float, begin: Int64, end: Int64) -> Float:
    """(R,) maximum of each profile (U, R) in its range, at least -1."""
    at = np.arange(len(line))[:, None]
    inside = np.where((at >= begin) & (at < end), line, -np.inf)
    return np.maximum(inside.max(0, initial=-np.inf), -1.0).astype(np.float32)


PIECES = (2, 3, 4, 5)
"""Numbers of equal pieces that a rectangle may be cut into."""
LEAST_SIDE = 4
"""Squares."""
_CUTS, _APART = 3, 3
"""Cuts tried on each side of the click, and least squares between them."""
_EXPANDED, _AT_ONCE, _MOST = 20, 4, 20
"""Rectangles that are cut further, a few at once, and rectangles that are returned."""
EXTRA_RECTANGLES = 6
"""Further rectangles, which strong lines tell from a likelier one that overlaps much."""
_EVEN_PENALTY = 1.0
"""For a rectangle that is cut evenly, not at a line."""
_ALIKE, _SAME = 0.85, 0.93
"""Overlap above which the likelier of two rectangles suffices: unless a line tells them apart, and
in any case."""
_LINE, _LINE_APART = 1.5, 3
"""Evidence of such a line, and least squares between the sides that it tells apart: a door's window
is nearly as large as the door."""

Square = tuple[int, int]


def rectangles_around(front: Front, square: Square, others: list[Square]) -> Rects:
    """(R, 4) rectangles that hold a square and none of ``others``, the likeliest first."""
    whole = front.bounds
    worth: dict[Rect, float] = {whole: 0.0}
    sides: dict[Rect, Float] = {whole: np.full(4, MAX_EVIDENCE / 2)}
    queue, left = [whole], _EXPANDED
    while queue and left:
        found: dict[Rect, None] = {}
        for rect in queue[:_AT_ONCE][:left]:
            left -= 1
            found |= dict.fromkeys(_cuts(front, rect, square, others))
        queue = queue[_AT_ONCE:]
        queue += _scored(front, [r for r in found if r not in worth], worth, sides)
        queue.sort(key=lambda r: -worth[r])
    best = sorted(worth, key=lambda r: -worth[r])[:2]
    even = [r for rect in [whole, *best] for r in _even_pieces(rect, square) if r not in worth]
    for rect in _scored(front, list(dict.fromkeys(even)), worth, sides):
        worth[rect] -= _EVEN_PENALTY
    right = [r for r in worth if not any(_holds(r, o) for o in others)]
    right.sort(key=lambda r: -worth[r])
    lines = np.array([sides[r] for r in right]).reshape(-1, 4)
    return _distinct(np.array(right, np.int64).reshape(-1, 4), lines)


def support(sides: Float, inner: Float) -> Float:
    """(R,) how much rectangles look like parts of their own.

    Args:
        sides: (R, 4) evidence along their sides. inner: (R, 2) the strongest lines within.
    """
    return np.minimum(sides, 2.0).mean(1) + 0.5 * sides.min(1) - 0.5 * inner.max(1)


def _scored(
    front: Front, rects: list[Rect], worth: dict[Rect, float], sides: dict[Rect, Float]
) -> list[Rect]:
    """``rects``, after their entries in ``worth`` and ``sides`` have been added."""
    if rects:
        each = np.array(rects)
        lines = np.stack([front.lines(each, side) for side in range(4)], axis=1)
        worth.update(zip(rects, support(lines, front.within(each)).tolist(), strict=True))
        sides.update(zip(rects, lines, strict=True))
    return rects


def _distinct(rects: Rects, lines: Float) -> Rects:
    """The first rectangles that aren't alike, then those that strong lines tell apart.

    Args:
        lines: (R, 4) evidence along their sides.
    """
    area = (rects[:, 1] - rects[:, 0] + 1) * (rects[:, 3] - rects[:, 2] + 1)
    free, extra = np.ones(len(rects), bool), np.ones(len(rects), bool)
    kept: list[int] = []

    def keep(i: int) -> None:
        low = np.maximum(rects[i, ::2], rects[:, ::2])
        high = np.minimum(rects[i, 1::2], rects[:, 1::2])
        common = np.maximum(high - low + 1, 0).prod(1)
        overlap = common / (area + area[i] - common)
        elsewhere = np.abs(rects - rects[i]) > _LINE_APART
        alike = overlap >= _ALIKE
        free[alike] = False
        extra[alike & ~(elsewhere & (lines > _LINE)).any(1) | (overlap >= _SAME)] = False
        kept.append(i)

    while free.any() and len(kept) < _MOST:
        keep(int(free.argmax()))
    most = len(kept) + EXTRA_RECTANGLES
    extra &= ~free
    while extra.any() and len(kept) < most:
        keep(int(extra.argmax()))
    return rects[kept]


def _holds(rect: Rect, square: Square) -> bool:
    return rect[0] <= square[0] <= rect[1] and rect[2] <= square[1] <= rect[3]


def _even_pieces(rect: Rect, square: Square) -> list[Rect]:
    """The pieces that hold a square if a rectangle is cut evenly."""
    out: list[Rect] = []
    u0, u1, v0, v1 = rect
    for parts in PIECES:
        wide, high = (u1 + 1 - u0) / parts, (v1 + 1 - v0) / parts
        if wide >= LEAST_SIDE:
            k = int((square[0] - u0) / wide)
            out.append((round(u0 + k * wide), round(u0 + (k + 1) * wide) - 1, v0, v1))
        if high >= LEAST_SIDE:
            k = int((square[1] - v0) / high)
            out.append((u0, u1, round(v0 + k * high), round(v0 + (k + 1) * high) - 1))
    return [r for r in out if _holds(r, square)]


def _cuts(front: Front, rect: Rect, square: Square, others: list[Square]) -> list[Rect]:
    """The rests around ``square`` after one cut of a rectangle at a strong line."""
    u0, u1, v0, v1 = rect
    out: list[Rect] = []
    for axis in (0, 1):
        profile = front.vertical(v0, v1) if axis == 0 else front.horizontal(u0, u1)
        begin, end, at = (u0, u1, square[0]) if axis == 0 else (v0, v1, square[1])
        between = [o[axis] for o in others if _holds(rect, o)]
        ranges = ((begin + LEAST_SIDE, at - 2, False), (at + 3, end + 1 - LEAST_SIDE, True))
        for low, high, after in ranges:
            lines = _peaks(profile, low, high, _CUTS)
            for other in between:
                if other != at and (other > at) == after:
                    near = (low, min(high, other)) if after else (max(low, other + 1), high)
                    lines += _peaks(profile, *near, 1)
            for line in lines:
                if axis == 0:
                    out.append((u0, line - 1, v0, v1) if after else (line, u1, v0, v1))
                else:
                    out.append((u0, u1, v0, line - 1) if after else (u0, u1, line, v1))
    least = LEAST_SIDE - 1
    return [r for r in out if r[1] - r[0] >= least and r[3] - r[2] >= least]


def _peaks(profile: Float, low: int, high: int, most: int) -> list[int]:
    """The highest places of a profile in a range, apart from one another."""
    if high <= low:
        return []
    part = profile[low:high].copy()
    out: list[int] = []
    for _ in range(most):
        best = int(part.argmax())
        if part[best] == -np.inf:
            break
        out.append(low + best)
        part[max(best - _APART, 0) : best + _APART + 1] = -np.inf
    return out
