"""Rectangles on a flat front: doors and drawers that are told apart by faint lines alone.

A gap between two flush doors is narrower than the points lie apart, and no edge of the graph is
strong there by itself. But the line is as long as the door: along it a little darkness, a dent, a
step and missing points add up. So a front is laid out as a picture of small squares, what looks
like a line is summed over whole sides of rectangles, and rectangles are found by cutting the front
again and again at the strongest lines on either side of a click, as pages are cut into columns
and paragraphs (recursive X-Y cuts; Nagy and Seth, *Hierarchical representation of optically
scanned documents*, 1984).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from scipy.ndimage import (
    binary_closing,
    binary_fill_holes,
    center_of_mass,
    find_objects,
    grey_dilation,
    label,
    uniform_filter1d,
)

from model.segmentation.encode.edge_features import lab_colors
from model.segmentation.encode.graph import Graph
from model.segmentation.encode.nodes import Nodes
from model.segmentation.encode.superpoints import Superpoints

Bool = npt.NDArray[np.bool_]
Float = npt.NDArray[np.floating]
Rect = tuple[int, int, int, int]
"""First and last column, first and last row, of squares."""
Rects = npt.NDArray[np.int64]
"""(R, 4) the same of many."""
Index = npt.NDArray[np.int64]

CHANNELS = ("strength", "gap", "dark", "dent", "step", "tilt", "hue")
"""What a line shows: strong edges, missing points, darkness, a dent, a step in depth, slanting
normals, a step in colour."""
_WEIGHT = np.array([0.3, 0.25, 0.25, 0.2, 0.2, 0.1, 0.2], np.float32)

NODES_A_SQUARE = 1.5
"""Side of a square, in node spacings."""
_ALONG = 0.8
"""Least cosine between a clicked superpoint's normal and a main direction."""
_TURNED = 0.2
"""Share of what lies at a superpoint's depth that faces as it does, if its normal is right."""
_DEEP, _DEEP_SPACINGS = 0.02, 4.0
"""How far before and behind the click a front reaches, in diagonals and in spacings."""
_LEAST_SIDE = 4
_MOST_SIDE = 600
_AROUND, _STEP = 3, 2
"""Squares that are compared with a line, and how far beside it; how far beside a step."""
_MARGIN = 2 * _AROUND
"""Squares round a front that tell anything of its lines."""
_CLIP = 4.0
_CUTS, _EXPANDED, _AT_ONCE, _MOST = 3, 20, 4, 20
"""Cuts tried on each side, rectangles that are cut further, a few at once, and kept."""
_EVENLY = 1.0
"""What speaks against a rectangle that no line tells."""
_APART = 3
_MORE = 6
"""Rectangles that are kept beside, since strong lines tell them from a likelier one like them."""
_ALIKE, _SAME = 0.85, 0.93
"""Overlap of rectangles of which the likelier one is enough: where no line tells them apart, and in
any case."""
_TOLD, _TOLD_APART = 1.5, 3
"""Evidence of a line that tells a rectangle from another, and how many squares apart their sides
are at least: a door's window is nearly as large as the door."""
_KEPT, _LAYERS, _CLICKED = 16, 8, 64
_BINS = 4
"""To the reach of a front."""
_SHIFT, _BEFORE_BINS = 2, 16
"""How many bins the middle of a front may lie from what was clicked, and behind a handle."""
PIECES = (2, 3, 4, 5)
"""Into how many equal pieces a rectangle may be cut."""
_BEFORE = 4.0
"""How far handles stand out before a front, in its reach."""
_STANDS_OUT = 0.6
"""How far before a front something has to be to stand out, in its reach."""
_KNOB, _KNOB_MOST = 4, 0.1
"""Squares that a knob or handle has at least, and what share of the front it is at most."""
_SHADE, _HIDDEN = 2, 0.05
"""Squares round a handle that it shades or hides, and what they count in a line."""
BAR_LENGTH = 3.0
"""How many times as long as wide a handle is that nobody takes for a knob."""
_ROUND = 3.0
"""How near to a bar's side that is clicked, in the front's reach, the front lies all round."""
_ROUND_BAR = 2
"""How far beyond that the front round a bar reaches, in squares."""
_LARGER = 4.0
"""How much more surface a front behind a handle has."""


@dataclass(frozen=True, eq=False)
class Front:
    """The picture of a flat front.

    Attributes:
        axis: main direction that it faces along; across: the two others.
        low: (2,) metres of the picture's corner; side: metres of a square.
        outward: 1 or -1, to which side along ``axis`` it faces.
        depth: metres along ``outward`` of its middle; reach: how far before and behind that is it.
        shape: columns and rows; region: (U, V) squares of the connected front.
        nodes: (U + 1, V + 1) int64 how many lie before each column and row.
        knobs: (B, 2) column and row of the middle of each thing that stands out before it.
        knob_of: (U, V) int32 which one hides or shades a square, -1 none.
        length: (B,) how many times as long as wide each is.
        columns, rows: (U, V + 1, K), (U + 1, V, K) evidence of upright lines, summed along the
            second place, and of level ones, summed along the first; K channels, their mean, and
            what a square counts.
    """

    axis: int
    across: tuple[int, int]
    low: Float
    side: float
    outward: int
    depth: float
    reach: float
    region: Bool
    nodes: Index
    knobs: Float
    knob_of: npt.NDArray[np.int32]
    length: Float
    columns: Float
    rows: Float

    @property
    def shape(self) -> tuple[int, int]:
        """Columns and rows."""
        return self.region.shape  # type: ignore[return-value]

    @cached_property
    def bounds(self) -> Rect:
        """What the region fills."""
        u, v = np.flatnonzero(self.region.any(1)), np.flatnonzero(self.region.any(0))
        return int(u[0]), int(u[-1]), int(v[0]), int(v[-1])

    def upright(self, v0: int, v1: int) -> Float:
        """(U,) mean evidence of an upright line at each column, between rows ``v0`` and ``v1``."""
        return _mean(self.columns[:, v1 + 1, -2:] - self.columns[:, v0, -2:])[..., 0]

    def level(self, u0: int, u1: int) -> Float:
        """(V,) the same of level lines."""
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
            best[outermost] = _CLIP / 2
            found.append(best)
        return np.stack(found, axis=1)

    def lines(self, rects: Rects, side: int, reach: int = 1) -> Float:
        """(R,) the mean over the channels of one side of these."""
        held, outermost = self._along(rects, side, reach, slice(-2, None))
        best = held[..., 0].max(1)
        best[outermost] = _CLIP / 2
        return best

    def _along(
        self, rects: Rects, side: int, reach: int, channels: slice = slice(None)
    ) -> tuple[Float, Bool]:
        """(R, 2 * reach + 1, K) mean evidence at one side of rectangles and beside it, and (R,)
        whether the side is one of the front's own.
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

    def within(self, rects: Rects) -> npt.NDArray[np.float32]:
        """(R, 2) the strongest upright and level line within each rectangle."""
        u0, u1, v0, v1 = rects.T
        upright = _mean(self.columns[:, v1 + 1, -2:] - self.columns[:, v0, -2:])[..., 0]
        level = _mean(self.rows[u1 + 1, :, -2:] - self.rows[u0, :, -2:])[..., 0].T
        return np.stack([_most(upright, u0 + 3, u1 - 1), _most(level, v0 + 3, v1 - 1)], axis=1)

    def held(self, rects: Rects) -> Index:
        """(R,) nodes in each rectangle."""
        u0, u1, v0, v1 = rects.T
        n = self.nodes
        return n[u1 + 1, v1 + 1] - n[u0, v1 + 1] - n[u1 + 1, v0] + n[u0, v0]


@dataclass(frozen=True, eq=False)
class Bar:
    """Something that stands out before a front.

    Attributes:
        superpoints: (C,) bool, its own. behind: (C,) those of the front round it.
        length: how many times as long as wide it is.
    """

    superpoints: Bool
    behind: Bool
    length: float


@dataclass(frozen=True, eq=False)
class _Layer:
    """All that lies at one depth, laid out in squares.

    Attributes:
        across, depth, low, side: as of a :class:`Front`.
        count: (U, V) nodes in each square.
        maps: (U, V) means over them by name.
        piece: (U, V) int32 which connected piece a square is of, 0 of none.
    """

    across: tuple[int, int]
    depth: float
    low: Float
    side: float
    count: Float
    maps: dict[str, Float]
    piece: npt.NDArray[np.int32]

    @property
    def shape(self) -> tuple[int, int]:
        """Columns and rows."""
        return self.piece.shape  # type: ignore[return-value]

    @cached_property
    def there(self) -> Bool:
        """(U, V) squares that hold nodes."""
        return self.count > 0


class _Side:
    """How much of the surface faces to one side, by its depth.

    Args:
        depth: (K,) metres towards that side; size: (K,) surface; step: metres of a bin.
    """

    def __init__(self, depth: Float, size: Float, step: float) -> None:
        self._low, self._step = float(depth.min()), step
        self._held = np.bincount(((depth - self._low) / step).astype(int), size)

    def bin_of(self, depth: float) -> int:
        return int((depth - self._low) / self._step)

    def middle(self, bin_: int) -> float:
        """Metres."""
        return self._low + (bin_ + 0.5) * self._step

    def held(self, bin_: int) -> float:
        """Surface in a bin and those beside it."""
        return float(self._held[max(bin_ - 1, 0) : bin_ + 2].sum()) if bin_ >= 0 else 0.0

    def peak(self, first: int, last: int) -> int:
        """The fullest bin of a range, -1 where that is empty."""
        first, last = max(first, 0), min(last, len(self._held) - 1)
        if last < first:
            return -1
        return first + int(self._held[first : last + 1].argmax())


_K = TypeVar("_K", bound=tuple[int, ...])
_V = TypeVar("_V")


def _kept(known: OrderedDict[_K, _V], key: _K, make: Callable[[_K], _V], most: int) -> _V:
    """What was made for ``key``; what was not asked for longest is forgotten."""
    if key not in known:
        known[key] = make(key)
        if len(known) > most:
            known.popitem(last=False)
    known.move_to_end(key)
    return known[key]


class Fronts:
    """The fronts of an encoded object, laid out where they are clicked."""

    def __init__(
        self, nodes: Nodes, graph: Graph, strength: npt.NDArray[np.float32], superpoints: Superpoints,
        axes: Float,
    ) -> None:  # fmt: skip
        self._superpoints = superpoints
        self._at = nodes.points.astype(np.float64) @ axes.T
        self._facing = graph.normals.astype(np.float64) @ axes.T
        self._center = superpoints.center @ axes.T
        self._graph, self._strength = graph, strength
        colors = nodes.colors
        self._lab = None if colors is None else lab_colors(colors)
        self._middle = (self._at.min(0) + self._at.max(0)) / 2
        self._side = NODES_A_SQUARE * graph.spacing
        diagonal = float(np.linalg.norm(np.ptp(nodes.points, axis=0)))
        self._reach = max(_DEEP * diagonal, _DEEP_SPACINGS * graph.spacing)
        unit = superpoints.normal / np.maximum(
            np.linalg.norm(superpoints.normal, axis=1, keepdims=True), 1e-9
        )
        self._turn = unit @ axes.T
        self._sides: dict[tuple[int, int], _Side | None] = {}
        self._of: OrderedDict[tuple[int], list[Front]] = OrderedDict()
        self._layers: OrderedDict[tuple[int, int, int], _Layer | None] = OrderedDict()
        self._fronts: OrderedDict[tuple[int, int, int, int], Front | None] = OrderedDict()

    def of(self, superpoint: int) -> list[Front]:
        """The fronts that a superpoint lies on or stands before, the nearest first.

        Nothing where the superpoint faces along no main direction, unless it is a handle's.
        """
        key = (superpoint,)
        return _kept(self._of, key, self._found, _CLICKED)

    def _found(self, key: tuple[int]) -> list[Front]:
        (superpoint,) = key
        axis = int(np.abs(self._turn[superpoint]).argmax())
        if abs(self._turn[superpoint, axis]) < _ALONG:
            return self._behind_bar(superpoint, -1)
        outward = self._outward(superpoint, axis)
        side = self._side_of(axis, outward)
        if side is None:
            return []
        own = side.bin_of(outward * float(self._center[superpoint, axis]))
        # The same for all that lie on it, and whatever was clicked before: where most of it is.
        bins = [side.peak(own - _SHIFT, own + _SHIFT)]
        behind = side.peak(own - _BEFORE_BINS, own - _SHIFT - 1)
        if side.held(behind) > _LARGER * side.held(bins[0]):
            bins.append(behind)
        fronts = [self._front(superpoint, axis, outward, depth) for depth in bins]
        there = [f for f in fronts if f is not None]
        if any(self._bar_before(front, superpoint) for front in there):
            return there
        return there + self._behind_bar(superpoint, axis)

    def _behind_bar(self, superpoint: int, faces: int) -> list[Front]:
        """The front before which a bar stands of which ``superpoint`` is a side.

        Args:
            faces: the direction along which the superpoint faces, -1: none.
        """
        for axis in range(3):
            if axis == faces:
                continue
            for outward in (1, -1):
                side = self._side_of(axis, outward)
                if side is None:
                    continue
                own = side.bin_of(outward * float(self._center[superpoint, axis]))
                behind = side.peak(own - _BEFORE_BINS, own - _SHIFT - 1)
                # Handles are outside.
                if behind < 0 or side.middle(behind) < outward * self._middle[axis]:
                    continue
                if not self._alone_before(superpoint, axis, outward, side.middle(behind)):
                    continue
                front = self._front(superpoint, axis, outward, behind)
                bar = None if front is None else self._bar_before(front, superpoint)
                if front is not None and bar is not None and bar.length >= BAR_LENGTH:
                    return [front]
        return []

    def _alone_before(self, superpoint: int, axis: int, outward: int, depth: float) -> bool:
        """Whether a front at ``depth`` is all round a superpoint, and not much else is as high above."""
        across = [k for k in range(3) if k != axis]
        apart = self._center[:, across] - self._center[superpoint, across]
        near = np.flatnonzero((np.abs(apart) < _ROUND * self._reach).all(1))
        deep = outward * self._center[near, axis] - depth
        size, out = self._superpoints.size[near], _STANDS_OUT * self._reach
        front = np.abs(deep) < out
        if size[deep > out].sum() > size[front].sum():
            return False
        beside = apart[near[front]] > 0
        return len(np.unique(2 * beside[:, 0] + beside[:, 1])) == 4

    def _outward(self, superpoint: int, axis: int) -> int:
        """To which side along an axis a superpoint faces, as nearly all that lies at its depth says: a
        scan's normals are turned the wrong way here and there.
        """
        near = np.abs(self._center[:, axis] - self._center[superpoint, axis]) < self._reach / _BINS
        turn = self._turn[near, axis]
        sure = np.abs(turn) > _ALONG
        own = 1 if self._turn[superpoint, axis] > 0 else -1
        same = float(self._superpoints.size[near] @ (sure & (own * turn > 0)))
        return own if same > _TURNED * float(self._superpoints.size[near] @ sure) else -own

    def bar(self, superpoint: int) -> Bar | None:
        """What ``superpoint`` is on, if that stands out before a front with something round it."""
        found = (self._bar_before(front, superpoint) for front in self.of(superpoint))
        return next((bar for bar in found if bar is not None), None)

    def _bar_before(self, front: Front, superpoint: int) -> Bar | None:
        deep = front.outward * self._center[:, front.axis] - front.depth
        number = int(front.knob_of[self._square(front, superpoint)])
        if number < 0 or deep[superpoint] < _STANDS_OUT * front.reach:
            return None
        at = np.argwhere(front.knob_of == number)
        u, v = ((self._center[:, list(front.across)] - front.low) / front.side).T
        (u0, v0), (u1, v1) = at.min(0) - _ROUND_BAR, at.max(0) + 1 + _ROUND_BAR
        inside = (u >= u0) & (u < u1) & (v >= v0) & (v < v1)
        behind = inside & (np.abs(deep) < _STANDS_OUT * front.reach)
        own = inside & ~behind & (deep > 0) & (deep < _BEFORE * front.reach)
        return Bar(own, behind, float(front.length[number])) if behind.any() else None

    def _side_of(self, axis: int, outward: int) -> _Side | None:
        """None where nothing faces there."""
        if (axis, outward) not in self._sides:
            facing = outward * self._turn[:, axis] > _ALONG
            depth, size = outward * self._center[facing, axis], self._superpoints.size[facing]
            made = _Side(depth, size, self._reach / _BINS) if facing.any() else None
            self._sides[axis, outward] = made
        return self._sides[axis, outward]

    def _front(self, superpoint: int, axis: int, outward: int, depth: int) -> Front | None:
        layer = _kept(self._layers, (axis, outward, depth), self._layer, _LAYERS)
        if layer is None:
            return None
        key = (axis, outward, depth, int(layer.piece[self._square(layer, superpoint)]))
        return _kept(self._fronts, key, self._laid_out, _KEPT)

    def _square(self, laid: Front | _Layer, superpoint: int) -> tuple[int, int]:
        at = (self._center[superpoint, list(laid.across)] - laid.low) / laid.side
        u, v = np.clip(at.astype(int), 0, np.array(laid.shape) - 1).tolist()
        return u, v

    def _layer(self, key: tuple[int, int, int]) -> _Layer | None:
        axis, outward, bin_ = key
        across = (1, 2) if axis == 0 else (0, 2) if axis == 1 else (0, 1)
        found = self._side_of(axis, outward)
        assert found is not None
        depth = found.middle(bin_)
        near = np.abs(outward * self._at[:, axis] - depth) < self._reach
        chosen = np.flatnonzero(near)
        if len(chosen) < _LEAST_SIDE**2:
            return None
        flat = self._at[chosen][:, list(across)]
        low = flat.min(0) - self._side
        side = max(self._side, float(np.ptp(flat, axis=0).max()) / (_MOST_SIDE - 3))
        place = ((flat - low) / side).astype(np.int64)
        shape = tuple((place.max(0) + 2).tolist())
        key_of = place[:, 0] * shape[1] + place[:, 1]
        size = shape[0] * shape[1]
        count = np.bincount(key_of, minlength=size).reshape(shape).astype(np.float64)

        def mean(values: Float) -> Float:
            return np.bincount(key_of, values, size).reshape(shape) / np.maximum(count, 1)

        maps = {
            "depth": mean(outward * self._at[chosen, axis] - depth) / side,
            "tilt": mean(1 - np.abs(self._facing[chosen, axis])),
            "strength": self._edges(near, across, low, side, shape),
        }
        if self._lab is not None:
            lab = self._lab[chosen]
            maps |= {n: mean(lab[:, k]) for k, n in enumerate("Lab")}
        there = count > 0
        # A handle hides what is behind it: what is all round a hole has it, too.
        closed = (
            np.asarray(binary_closing(np.pad(there, 3), iterations=2), bool)[3:-3, 3:-3] | there
        )
        piece = np.zeros(shape, np.int32)
        label(binary_fill_holes(closed), output=piece)
        return _Layer(across, depth, low, side, count, maps, piece)

    def _laid_out(self, key: tuple[int, int, int, int]) -> Front | None:
        axis, outward, _, number = key
        layer = self._layers[key[:3]]
        assert layer is not None
        region = layer.piece == number
        if number == 0 or region.sum() < _LEAST_SIDE**2 or not (region & layer.there).any():
            return None
        knobs, knob_of, length = self._knobs(axis, layer, outward, region)
        counts = np.where(knob_of >= 0, np.float32(_HIDDEN), np.float32(1))
        columns = _evidence(layer.maps, layer.there, region)
        rows = _evidence({n: m.T for n, m in layer.maps.items()}, layer.there.T, region.T)
        return Front(
            axis, layer.across, layer.low, layer.side, outward, layer.depth, self._reach, region,
            np.pad(layer.count.astype(np.int64).cumsum(0).cumsum(1), ((1, 0), (1, 0))),
            knobs, knob_of, length,
            _summed(columns, counts), _summed(rows, counts.T).transpose(1, 0, 2),
        )  # fmt: skip

    def _knobs(
        self, axis: int, layer: _Layer, outward: int, region: Bool
    ) -> tuple[Float, npt.NDArray[np.int32], Float]:
        """What stands out before a region: see ``knobs``, ``knob_of`` and ``length`` of a front."""
        deep = outward * self._at[:, axis] - layer.depth
        out = (deep > _STANDS_OUT * self._reach) & (deep < _BEFORE * self._reach)
        place = ((self._at[out][:, list(layer.across)] - layer.low) / layer.side).astype(int)
        inside = ((place >= 0) & (place < region.shape)).all(1)
        there = np.zeros(region.shape, bool)
        there[tuple(place[inside].T)] = True
        piece = np.zeros(region.shape, np.int32)
        label(binary_closing(np.pad(there, 2), iterations=1)[2:-2, 2:-2], output=piece)
        size = np.bincount((piece * region).ravel(), minlength=int(piece.max()) + 1)
        size[0] = 0
        small = np.flatnonzero((size >= _KNOB) & (size < _KNOB_MOST * region.sum()))
        number = np.full(len(size), -1, np.int32)
        number[small] = np.arange(len(small))
        knob_of = number[piece]
        found = find_objects(knob_of + 1)
        middle = np.array(center_of_mass(there, knob_of, np.arange(len(small)))).reshape(-1, 2)
        length = np.array([_length(np.argwhere(knob_of[at] == k)) for k, at in enumerate(found)])
        return middle, np.asarray(grey_dilation(knob_of, size=2 * _SHADE + 1), np.int32), length

    def _edges(
        self, near: Bool, across: tuple[int, int], low: Float, side: float, shape: tuple[int, int]
    ) -> Float:
        """(U, V) mean strength of the edges in each square."""
        graph = self._graph
        edges = np.flatnonzero(near[graph.a] & near[graph.b])
        a, b = graph.a[edges], graph.b[edges]
        u, v = (
            ((0.5 * (self._at[a, k] + self._at[b, k]) - begin) / side).astype(np.int64)
            for k, begin in zip(across, low, strict=True)
        )
        key, size = u * shape[1] + v, shape[0] * shape[1]
        total = np.bincount(key, self._strength[edges], size)
        count = np.bincount(key, minlength=size)
        return (total / np.maximum(count, 1)).reshape(shape)

    # Rectangles ----------------------------------------------------------------------

    def rectangles(self, front: Front, superpoint: int, outside: tuple[int, ...] = ()) -> Rects:
        """(R, 4) rectangles of a front that hold a superpoint, and not others; the likeliest first."""
        before = self._before(front)
        others = [self._square(front, c) for c in outside if before[c]]
        return _cut(front, self._square(front, superpoint), others)

    def _before(self, front: Front) -> Bool:
        """(C,) the superpoints of a front, and what stands out before it."""
        deep = front.outward * self._center[:, front.axis] - front.depth
        return (deep > -front.reach) & (deep < _BEFORE * front.reach)

    def masks(self, front: Front, rects: Rects) -> Bool:
        """(H, C) the superpoints in rectangles, with what stands out before them."""
        out = np.zeros((len(rects), len(self._center)), bool)
        near = np.flatnonzero(self._before(front))
        u, v = ((self._center[near][:, list(front.across)] - front.low) / front.side).T
        u0, u1, v0, v1 = rects.T[:, :, None]
        out[:, near] = (u >= u0) & (u < u1 + 1) & (v >= v0) & (v < v1 + 1)
        return out


def _smooth(values: Float, there: Float) -> Float:
    """Mean over ``_AROUND`` squares along the first place, of those that are ``there``."""
    held = uniform_filter1d(there, _AROUND, axis=0, mode="constant")
    mean = uniform_filter1d(values * there, _AROUND, axis=0, mode="constant")
    return np.where(held > 1e-9, mean / np.maximum(held, 1e-9), 0.0)


def _mean(held: Float) -> Float:
    """Means of sums of evidence (..., K + 1), the last of which is what their squares count."""
    return held[..., :-1] / np.maximum(held[..., -1:], _HIDDEN)


def _length(squares: Index) -> float:
    """How many times as long as wide what fills some squares (N, 2) is."""
    spread = np.linalg.eigvalsh(np.cov(squares.T) + np.eye(2) / 12)
    return float(np.sqrt(spread[1] / spread[0]))


def _most(line: Float, begin: Index, end: Index) -> Float:
    """(R,) the most of each profile in its range, -1 where it is empty or less.

    Args:
        line: (U, R) profiles. begin, end: (R,).
    """
    at = np.arange(len(line))[:, None]
    inside = np.where((at >= begin) & (at < end), line, -np.inf)
    return np.maximum(inside.max(0, initial=-np.inf), -1.0).astype(np.float32)


def _shifted(x: Float, shift: int) -> Float:
    """``x[i + shift]`` at i, zero beyond."""
    out = np.zeros_like(x)
    if shift >= 0:
        out[: len(x) - shift] = x[shift:]
    else:
        out[-shift:] = x[:shift]
    return out


def _evidence(maps: dict[str, Float], there: Bool, region: Bool) -> npt.NDArray[np.float32]:
    """(U, V, K) how much each square looks like one of an upright line, channel by channel.

    Every channel is what stands out against the squares beside it, in robust deviations of the
    region.
    """
    out = np.zeros((*there.shape, len(CHANNELS) + 1), np.float32)
    inner = tuple(
        slice(max(int(at[0]) - _MARGIN, 0), int(at[-1]) + _MARGIN + 1)
        for at in (np.flatnonzero(region.any(1)), np.flatnonzero(region.any(0)))
    )
    maps = {name: m[inner] for name, m in maps.items()}
    out[inner] = _evidence_within(maps, there[inner], region[inner])
    return out


def _evidence_within(maps: dict[str, Float], there: Bool, region: Bool) -> npt.NDArray[np.float32]:
    out = np.zeros((*there.shape, len(CHANNELS) + 1), np.float32)
    weight = there.astype(np.float64)
    smooth = {name: _smooth(m, weight) for name, m in maps.items()}

    def beside(name: str, apart: int) -> tuple[Float, Float]:
        """Before and after each square."""
        return _shifted(smooth[name], -apart), _shifted(smooth[name], apart)

    def ridge(name: str) -> Float:
        before, after = beside(name, _AROUND)
        return np.where(there, maps[name] - (before + after) / 2, 0.0)

    held = uniform_filter1d(weight, _AROUND, axis=0, mode="constant")
    gap = np.minimum(_shifted(held, -_AROUND), _shifted(held, _AROUND))
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
        out[..., k] = np.clip((x - middle) / spread, -1.5, _CLIP) * region
    out[..., -1] = out[..., :-1] @ _WEIGHT
    return out


def _summed(evidence: Float, counts: Float) -> Float:
    """(U, V + 1, K + 1) evidence (U, V, K) times what each square (U, V) counts, and that, summed
    along the second place.
    """
    each = np.concatenate([evidence * counts[..., None], counts[..., None]], axis=2)
    return np.concatenate([np.zeros_like(each[:, :1]), np.cumsum(each, axis=1)], axis=1)


def _cut(front: Front, spot: tuple[int, int], others: list[tuple[int, int]]) -> Rects:
    """(R, 4) rectangles round a square, found by cutting at the strongest lines; the likeliest
    first.
    """
    whole = front.bounds
    known: dict[Rect, float] = {whole: 0.0}
    sides: dict[Rect, Float] = {whole: np.full(4, _CLIP / 2)}
    queue, left = [whole], _EXPANDED
    while queue and left:
        found: dict[Rect, None] = {}
        for rect in queue[:_AT_ONCE][:left]:
            left -= 1
            found |= dict.fromkeys(_children(front, rect, spot, others))
        queue = queue[_AT_ONCE:]
        queue += _scored(front, [r for r in found if r not in known], known, sides)
        queue.sort(key=lambda r: -known[r])
    best = sorted(known, key=lambda r: -known[r])[:2]
    even = [r for rect in [whole, *best] for r in _even(rect, spot) if r not in known]
    for rect in _scored(front, list(dict.fromkeys(even)), known, sides):
        known[rect] -= _EVENLY
    right = [r for r in known if not any(_holds(r, o) for o in others)]
    right.sort(key=lambda r: -known[r])
    lines = np.array([sides[r] for r in right]).reshape(-1, 4)
    return _apart(np.array(right, np.int64).reshape(-1, 4), lines)


def _scored(
    front: Front, rects: list[Rect], known: dict[Rect, float], sides: dict[Rect, Float]
) -> list[Rect]:
    """``rects``, which are ``known`` now, with the lines along their ``sides``."""
    if rects:
        each = np.array(rects)
        lines = np.stack([front.lines(each, side) for side in range(4)], axis=1)
        worth = support(lines, front.within(each))
        known.update(zip(rects, worth.tolist(), strict=True))
        sides.update(zip(rects, lines, strict=True))
    return rects


def support(sides: Float, inner: Float) -> Float:
    """(R,) how much rectangles look like parts of their own: by the (R, 4) lines along their sides
    and the (R, 2) strongest within them.
    """
    return np.minimum(sides, 2.0).mean(1) + 0.5 * sides.min(1) - 0.5 * inner.max(1)


def _apart(rects: Rects, lines: Float) -> Rects:
    """The first ones that are not alike, and then those that are, but told apart by strong lines.

    Args:
        lines: (R, 4) the evidence along their sides.
    """
    area = (rects[:, 1] - rects[:, 0] + 1) * (rects[:, 3] - rects[:, 2] + 1)
    free, told = np.ones(len(rects), bool), np.ones(len(rects), bool)

    def keep(i: int) -> None:
        low = np.maximum(rects[i, ::2], rects[:, ::2])
        high = np.minimum(rects[i, 1::2], rects[:, 1::2])
        common = np.maximum(high - low + 1, 0).prod(1)
        overlap = common / (area + area[i] - common)
        elsewhere = np.abs(rects - rects[i]) > _TOLD_APART
        alike = overlap >= _ALIKE
        free[alike] = False
        told[alike & ~(elsewhere & (lines > _TOLD)).any(1) | (overlap >= _SAME)] = False
        kept.append(i)

    kept: list[int] = []
    while free.any() and len(kept) < _MOST:
        keep(int(free.argmax()))
    most = len(kept) + _MORE
    told &= ~free
    while told.any() and len(kept) < most:
        keep(int(told.argmax()))
    return rects[kept]


def _holds(rect: Rect, spot: tuple[int, int]) -> bool:
    return rect[0] <= spot[0] <= rect[1] and rect[2] <= spot[1] <= rect[3]


def _even(rect: Rect, spot: tuple[int, int]) -> list[Rect]:
    """The pieces that hold a square if a rectangle is cut evenly."""
    out: list[Rect] = []
    u0, u1, v0, v1 = rect
    for parts in PIECES:
        wide, high = (u1 + 1 - u0) / parts, (v1 + 1 - v0) / parts
        if wide >= _LEAST_SIDE:
            k = int((spot[0] - u0) / wide)
            out.append((round(u0 + k * wide), round(u0 + (k + 1) * wide) - 1, v0, v1))
        if high >= _LEAST_SIDE:
            k = int((spot[1] - v0) / high)
            out.append((u0, u1, round(v0 + k * high), round(v0 + (k + 1) * high) - 1))
    return [r for r in out if _holds(r, spot)]


def _children(
    front: Front, rect: Rect, spot: tuple[int, int], others: list[tuple[int, int]]
) -> list[Rect]:
    """What is left round ``spot`` of a rectangle after one cut at a strong line."""
    u0, u1, v0, v1 = rect
    out: list[Rect] = []
    for axis in (0, 1):
        profile = front.upright(v0, v1) if axis == 0 else front.level(u0, u1)
        begin, end, at = (u0, u1, spot[0]) if axis == 0 else (v0, v1, spot[1])
        between = [o[axis] for o in others if _holds(rect, o)]
        ranges = ((begin + _LEAST_SIDE, at - 2, False), (at + 3, end + 1 - _LEAST_SIDE, True))
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
    least = _LEAST_SIDE - 1
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
