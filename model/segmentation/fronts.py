"""Find flat fronts where they are clicked, and propose rectangles on them.

Doors and drawers that lie in one plane are separated by faint lines alone; see
:mod:`.front_rectangles`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter

import numpy as np
from cachetools import LRUCache, cachedmethod
from scipy.ndimage import (
    binary_closing,
    binary_fill_holes,
    center_of_mass,
    find_objects,
    grey_dilation,
    label,
)

from model.segmentation.arrays import Bool, Float, Float32, Int32, Int64
from model.segmentation.boxes import FRONTS, Shells, shaped_proposals
from model.segmentation.front_rectangles import (
    HIDDEN,
    LEAST_SIDE,
    Front,
    Rects,
    line_evidence,
    rectangles_around,
)
from model.segmentation.graph import Graph, lab_colors
from model.segmentation.nodes import Nodes
from model.segmentation.plane_boxes import BoxGrid
from model.segmentation.proposals import PartState, Proposals
from model.segmentation.superpoints import Superpoints

NODES_A_SQUARE = 1.5
"""Side of a square, in node spacings."""
_MOST_SIDE = 600
"""Squares along the longer side of a picture."""
_ALONG = 0.8
"""Least cosine between a clicked superpoint's normal and a main direction."""
_RIGHT_WAY = 0.2
"""Least share of the surface at a superpoint's depth that faces like it, if its normal is right."""
_DEEP, _DEEP_SPACINGS = 0.02, 4.0
"""Reach of a front before and behind the click: in diagonals and in spacings, the larger one."""
_CACHED, _LAYERS, _CLICKED = 16, 8, 64
"""Fronts, layers and clicked superpoints in the caches."""
_BINS = 4
"""Depth bins in the reach of a front."""
_SHIFT, _BEFORE_BINS = 2, 16
"""Most bins between a click and the middle of its front, and of the front behind a handle."""
_BEFORE, _STANDS_OUT = 4.0, 0.6
"""Most and least distance of a handle from its front, in the front's reach."""
_KNOB, _KNOB_SHARE = 4, 0.1
"""Least squares of a knob or handle, and its largest share of the front."""
_SHADE = 2
"""Squares around a handle that it shades or hides."""
BAR_LENGTH = 3.0
"""Least ratio of length to width of a bar; knobs are shorter."""
_AROUND_SIDE, _AROUND_BAR = 3.0, 2
"""Extent of the front around a clicked side of a bar (in reaches) and around the bar (in
squares)."""
_LARGER = 4.0
"""Least ratio of surface between the front behind a handle and the handle."""
_RECTANGLES = 12
"""Rectangles of each front, for later clicks."""


@dataclass(frozen=True, eq=False)
class Bar:
    """A handle or knob before a front.

    Attributes:
        superpoints: (C,) bool, of the bar. behind: (C,) those of the front around it.
        length: ratio of length to width.
    """

    superpoints: Bool
    behind: Bool
    length: float


@dataclass(frozen=True, eq=False)
class _Layer:
    """All nodes at one depth, on the squares of a picture.

    Attributes:
        across, depth, low, side: as in :class:`.Front`.
        count: (U, V) nodes in each square.
        maps: (U, V) means over them by name.
        component: (U, V) int32 connected component of each square, 0 for none.
    """

    across: tuple[int, int]
    depth: float
    low: Float
    side: float
    count: Float
    maps: dict[str, Float]
    component: Int32

    @property
    def shape(self) -> tuple[int, int]:
        """Columns and rows."""
        return self.component.shape  # type: ignore[return-value]

    @cached_property
    def there(self) -> Bool:
        """(U, V) squares that hold nodes."""
        return self.count > 0


class _DepthProfile:
    """Amount of surface that faces to one side, by its depth."""

    def __init__(self, depth: Float, size: Float, step: float) -> None:
        """``depth`` (K,) metres towards that side; ``size`` (K,) surface; ``step`` of a bin."""
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
        """The fullest bin of a range, -1 if that is empty."""
        first, last = max(first, 0), min(last, len(self._held) - 1)
        if last < first:
            return -1
        return first + int(self._held[first : last + 1].argmax())


class Fronts:
    """The fronts of an encoded object, laid out where they are clicked."""

    def __init__(
        self, nodes: Nodes, graph: Graph, strength: Float32, superpoints: Superpoints, axes: Float
    ) -> None:
        """``axes`` (3, 3): the object's main directions, in rows."""
        self._size = superpoints.size
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
        length = np.linalg.norm(superpoints.normal, axis=1, keepdims=True)
        self._turn = superpoints.normal / np.maximum(length, 1e-9) @ axes.T
        self._profiles: dict[tuple[int, int], _DepthProfile | None] = {}
        self._clicked: LRUCache = LRUCache(_CLICKED)
        self._layers: LRUCache = LRUCache(_LAYERS)
        self._laid_out: LRUCache = LRUCache(_CACHED)

    # Which fronts ----------------------------------------------------------------------

    @cachedmethod(attrgetter("_clicked"))
    def of(self, superpoint: int) -> list[Front]:
        """The fronts that a superpoint lies on or stands before, the nearest first.

        None if it faces along no main direction, unless it belongs to a handle.
        """
        axis = int(np.abs(self._turn[superpoint]).argmax())
        if abs(self._turn[superpoint, axis]) < _ALONG:
            return self._behind_bar(superpoint, -1)
        outward = self._outward(superpoint, axis)
        profile = self._profile(axis, outward)
        if profile is None:
            return []
        own = profile.bin_of(outward * float(self._center[superpoint, axis]))
        # The fullest bin: the same for all superpoints of a front, whichever is clicked first.
        bins = [profile.peak(own - _SHIFT, own + _SHIFT)]
        behind = profile.peak(own - _BEFORE_BINS, own - _SHIFT - 1)
        if profile.held(behind) > _LARGER * profile.held(bins[0]):
            bins.append(behind)
        fronts = [self._front(superpoint, axis, outward, depth) for depth in bins]
        there = [f for f in fronts if f is not None]
        if any(self._bar_before(front, superpoint) for front in there):
            return there
        return there + self._behind_bar(superpoint, axis)

    def _behind_bar(self, superpoint: int, faces: int) -> list[Front]:
        """The front behind a bar of which ``superpoint`` is a side.

        Args:
            faces: the direction along which the superpoint faces, -1 for none.
        """
        for axis in range(3):
            if axis == faces:
                continue
            for outward in (1, -1):
                profile = self._profile(axis, outward)
                if profile is None:
                    continue
                own = profile.bin_of(outward * float(self._center[superpoint, axis]))
                behind = profile.peak(own - _BEFORE_BINS, own - _SHIFT - 1)
                # Handles are on the outside.
                if behind < 0 or profile.middle(behind) < outward * self._middle[axis]:
                    continue
                if not self._alone_before(superpoint, axis, outward, profile.middle(behind)):
                    continue
                front = self._front(superpoint, axis, outward, behind)
                bar = None if front is None else self._bar_before(front, superpoint)
                if front is not None and bar is not None and bar.length >= BAR_LENGTH:
                    return [front]
        return []

    def _alone_before(self, superpoint: int, axis: int, outward: int, depth: float) -> bool:
        """True if a front at ``depth`` surrounds a superpoint, with little surface before it."""
        across = [k for k in range(3) if k != axis]
        apart = self._center[:, across] - self._center[superpoint, across]
        near = np.flatnonzero((np.abs(apart) < _AROUND_SIDE * self._reach).all(1))
        deep = outward * self._center[near, axis] - depth
        size, out = self._size[near], _STANDS_OUT * self._reach
        front = np.abs(deep) < out
        if size[deep > out].sum() > size[front].sum():
            return False
        beside = apart[near[front]] > 0
        return len(np.unique(2 * beside[:, 0] + beside[:, 1])) == 4

    def _outward(self, superpoint: int, axis: int) -> int:
        """To which side along an axis a superpoint faces, by the majority at its depth: single
        normals of a scan may be flipped.
        """
        near = np.abs(self._center[:, axis] - self._center[superpoint, axis]) < self._reach / _BINS
        turn = self._turn[near, axis]
        along = np.abs(turn) > _ALONG
        own = 1 if self._turn[superpoint, axis] > 0 else -1
        same = float(self._size[near] @ (along & (own * turn > 0)))
        return own if same > _RIGHT_WAY * float(self._size[near] @ along) else -own

    def bar(self, superpoint: int) -> Bar | None:
        """The handle or knob that ``superpoint`` belongs to, if it stands out before a front."""
        found = (self._bar_before(front, superpoint) for front in self.of(superpoint))
        return next((bar for bar in found if bar is not None), None)

    def _bar_before(self, front: Front, superpoint: int) -> Bar | None:
        deep = front.outward * self._center[:, front.axis] - front.depth
        number = int(front.knob_of[self._square(front, superpoint)])
        if number < 0 or deep[superpoint] < _STANDS_OUT * front.reach:
            return None
        at = np.argwhere(front.knob_of == number)
        u, v = ((self._center[:, list(front.across)] - front.low) / front.side).T
        (u0, v0), (u1, v1) = at.min(0) - _AROUND_BAR, at.max(0) + 1 + _AROUND_BAR
        inside = (u >= u0) & (u < u1) & (v >= v0) & (v < v1)
        behind = inside & (np.abs(deep) < _STANDS_OUT * front.reach)
        own = inside & ~behind & (deep > 0) & (deep < _BEFORE * front.reach)
        return Bar(own, behind, float(front.length[number])) if behind.any() else None

    def _profile(self, axis: int, outward: int) -> _DepthProfile | None:
        """None if nothing faces there."""
        if (axis, outward) not in self._profiles:
            facing = outward * self._turn[:, axis] > _ALONG
            depth, size = outward * self._center[facing, axis], self._size[facing]
            made = _DepthProfile(depth, size, self._reach / _BINS) if facing.any() else None
            self._profiles[axis, outward] = made
        return self._profiles[axis, outward]

    # Pictures --------------------------------------------------------------------------

    def _front(self, superpoint: int, axis: int, outward: int, depth: int) -> Front | None:
        layer = self._layer(axis, outward, depth)
        if layer is None:
            return None
        component = int(layer.component[self._square(layer, superpoint)])
        return self._lay_out(axis, outward, depth, component)

    def _square(self, picture: Front | _Layer, superpoint: int) -> tuple[int, int]:
        at = (self._center[superpoint, list(picture.across)] - picture.low) / picture.side
        u, v = np.clip(at.astype(int), 0, np.array(picture.shape) - 1).tolist()
        return u, v

    @cachedmethod(attrgetter("_layers"))
    def _layer(self, axis: int, outward: int, bin_: int) -> _Layer | None:
        across = (1, 2) if axis == 0 else (0, 2) if axis == 1 else (0, 1)
        profile = self._profile(axis, outward)
        assert profile is not None
        depth = profile.middle(bin_)
        near = np.abs(outward * self._at[:, axis] - depth) < self._reach
        chosen = np.flatnonzero(near)
        if len(chosen) < LEAST_SIDE**2:
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
        return _Layer(across, depth, low, side, count, maps, _closed_components(count > 0))

    @cachedmethod(attrgetter("_laid_out"))
    def _lay_out(self, axis: int, outward: int, depth: int, component: int) -> Front | None:
        layer = self._layer(axis, outward, depth)
        assert layer is not None
        region = layer.component == component
        if component == 0 or region.sum() < LEAST_SIDE**2 or not (region & layer.there).any():
            return None
        knobs, knob_of, length = self._knobs(axis, layer, outward, region)
        weight = np.where(knob_of >= 0, np.float32(HIDDEN), np.float32(1))
        columns = line_evidence(layer.maps, layer.there, region, weight)
        turned = {n: m.T for n, m in layer.maps.items()}
        rows = line_evidence(turned, layer.there.T, region.T, weight.T).transpose(1, 0, 2)
        nodes = np.pad(layer.count.astype(np.int64).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
        place = (axis, layer.across, layer.low, layer.side, outward, layer.depth, self._reach)
        return Front(*place, region, nodes, knobs, knob_of, length, columns, rows)

    def _knobs(
        self, axis: int, layer: _Layer, outward: int, region: Bool
    ) -> tuple[Float, Int32, Float]:
        """``knobs``, ``knob_of`` and ``length`` of a front."""
        deep = outward * self._at[:, axis] - layer.depth
        out = (deep > _STANDS_OUT * self._reach) & (deep < _BEFORE * self._reach)
        place = ((self._at[out][:, list(layer.across)] - layer.low) / layer.side).astype(int)
        inside = ((place >= 0) & (place < region.shape)).all(1)
        there = np.zeros(region.shape, bool)
        there[tuple(place[inside].T)] = True
        component = np.zeros(region.shape, np.int32)
        label(binary_closing(np.pad(there, 2), iterations=1)[2:-2, 2:-2], output=component)
        size = np.bincount((component * region).ravel(), minlength=int(component.max()) + 1)
        size[0] = 0
        small = np.flatnonzero((size >= _KNOB) & (size < _KNOB_SHARE * region.sum()))
        number = np.full(len(size), -1, np.int32)
        number[small] = np.arange(len(small))
        knob_of = number[component]
        found = find_objects(knob_of + 1)
        middle = np.array(center_of_mass(there, knob_of, np.arange(len(small)))).reshape(-1, 2)
        length = np.array(
            [_elongation(np.argwhere(knob_of[at] == k)) for k, at in enumerate(found)]
        )
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

    # Rectangles ------------------------------------------------------------------------

    def rectangles(self, front: Front, superpoint: int, outside: tuple[int, ...] = ()) -> Rects:
        """(R, 4) rectangles that hold a superpoint and not others, the likeliest first."""
        before = self._before(front)
        others = [self._square(front, c) for c in outside if before[c]]
        return rectangles_around(front, self._square(front, superpoint), others)

    def _before(self, front: Front) -> Bool:
        """(C,) the superpoints of a front, and those that stand out before it."""
        deep = front.outward * self._center[:, front.axis] - front.depth
        return (deep > -front.reach) & (deep < _BEFORE * front.reach)

    def masks(self, front: Front, rects: Rects) -> Bool:
        """(H, C) the superpoints in rectangles, with those that stand out before them."""
        out = np.zeros((len(rects), len(self._center)), bool)
        near = np.flatnonzero(self._before(front))
        u, v = ((self._center[near][:, list(front.across)] - front.low) / front.side).T
        u0, u1, v0, v1 = rects.T[:, :, None]
        out[:, near] = (u >= u0) & (u < u1 + 1) & (v >= v0) & (v < v1 + 1)
        return out


def _closed_components(there: Bool) -> Int32:
    """(U, V) connected components of squares; gaps are closed, and holes, which handles hide."""
    closed = np.asarray(binary_closing(np.pad(there, 3), iterations=2), bool)[3:-3, 3:-3] | there
    component = np.zeros(there.shape, np.int32)
    label(binary_fill_holes(closed), output=component)
    return component


def _elongation(squares: Int64) -> float:
    """Ratio of length to width of squares (N, 2)."""
    spread = np.linalg.eigvalsh(np.cov(squares.T) + np.eye(2) / 12)
    return float(np.sqrt(spread[1] / spread[0]))


class FrontRectangles:
    """The proposal source of rectangles on fronts, for parts that move."""

    moving_only = True

    def __init__(self, fronts: Fronts, grid: BoxGrid, shells: Shells | None) -> None:
        self._fronts, self._grid, self._shells = fronts, grid, shells

    def first(self, superpoint: int, outside: tuple[int, ...]) -> list[Proposals]:
        """Rectangles of the clicked fronts, and boxes behind the likeliest ones."""
        fronts, grid = self._fronts, self._grid
        made = [
            fronts.masks(f, fronts.rectangles(f, superpoint, outside))
            for f in fronts.of(superpoint)
        ]
        if not made:
            return []
        likely = np.concatenate([m[:FRONTS] for m in made])
        deep = grid.contents(*grid.behind(*grid.bounds(likely[likely.any(1)]), FRONTS))
        return [shaped_proposals([*made, deep], self._shells)]

    def later(
        self, before: PartState, after: PartState, superpoint: int, positive: bool
    ) -> list[Proposals]:
        """Rectangles that hold the part's clicks, with the mask and without, and after a negative
        click the mask without the rectangles around it.
        """
        if not after.positive:
            return []
        assert before.mask is not None
        made: list[Bool] = []
        own = superpoint if positive else after.positive[-1]
        for front in self._fronts.of(own):
            masks = self._around(front, own, after.negative)
            made.append(masks[masks[:, list(after.positive)].all(1)])
            if positive:
                made.append(masks | before.mask)
        if not positive:
            for front in self._fronts.of(superpoint):
                made.append(before.mask & ~self._around(front, superpoint, after.positive))
        return [shaped_proposals(made, self._shells)] if made else []

    def _around(self, front: Front, superpoint: int, outside: tuple[int, ...]) -> Bool:
        rects = self._fronts.rectangles(front, superpoint, outside)[:_RECTANGLES]
        return self._fronts.masks(front, rects)
