"""Find rectangles on a front by cutting it again and again at the strongest lines around a click.

As pages are cut into columns and paragraphs: recursive X-Y cuts (Nagy and Seth, *Hierarchical
representation of optically scanned documents*, 1984).
"""

from __future__ import annotations

import numpy as np

from model.segmentation.arrays import Float
from model.segmentation.propose.front_picture import MAX_EVIDENCE, Front, Rect, Rects

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
