"""Encode an asset once for all clicks: everything that doesn't depend on prompts.

Merge trees (step 5) are nested regions around every superpoint up to the whole object. Regions are
contracted at rising cost thresholds, all cheapest links of a threshold at once, so a tree over ten
thousand superpoints takes tenths of a second in numpy. Three costs give three trees: one penalises
thin contacts, one absorbs enclosed regions (handles, windows) early, one follows flat and evenly
coloured patches.

Random walks (step 6) are Green's functions, factorised once. With the grounded Laplacian
``K = L + leak * I``, the field that takes the values y at the seeds and otherwise follows the graph
is ``mu + G_s (G_ss)^-1 (y - mu_s)`` with ``G = K^-1``: a new click adds one column of G, undo drops
it. The leak sets how far a click reaches.

In scanned rooms floor and walls connect nothing, and clicks mean whole objects.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from cachetools import LRUCache
from scipy.sparse import diags
from scipy.sparse.linalg import SuperLU, splu

from model.core.asset import Asset
from model.core.geometry import PointCloud
from model.core.progress import Progress, no_progress
from model.geometry.crop import ROOM_METRES, floor_and_walls, largest_component
from model.segmentation.arrays import Bool, Float, Float32, Int, Int8, Int32, Int64, together
from model.segmentation.graph import (
    Graph,
    adjacency,
    build_graph,
    components,
    edge_strength,
    edge_weight,
)
from model.segmentation.models import Mlp
from model.segmentation.nodes import Nodes, distinct, nodes_of_asset
from model.segmentation.superpoints import Links, Superpoints, build_superpoints, totals

LEVELS = 44
TREES = ("contact", "absorb", "patch")
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """Nested partitions of the superpoints.

    Attributes:
        labels: (L, C) int32 region of each superpoint at each level, fine to coarse, one tree after
            another; each level counts its regions from 0.
        tree: (L,) int8 which of ``TREES``.
        height: (L,) float32 the level's cost threshold.
    """

    labels: Int32
    tree: Int8
    height: Float32

    @cached_property
    def offset(self) -> Int64:
        """(L + 1,) number of the first region of each level, counting all levels; the total."""
        return np.concatenate([[0], np.cumsum(self.labels.max(1).astype(np.int64) + 1)])


@dataclass
class _Regions:
    """Regions while they merge."""

    links: Links
    size: Float
    perimeter: Float
    normal: Float
    color: Float

    def merge(self, group: Int32, number: int) -> _Regions:
        inner = self.links.count * (group[self.links.a] == group[self.links.b])
        lost = totals(self.links.a, inner, len(self.size))
        outline = totals(group, self.perimeter - 2 * lost, number)
        return _Regions(
            self.links.contract(group, number),
            totals(group, self.size, number),
            outline,
            np.stack([totals(group, v, number) for v in self.normal.T], axis=1),
            np.stack([totals(group, v, number) for v in self.color.T], axis=1),
        )


def _cost(regions: _Regions, tree: int, total: float) -> Float:
    """(M,) cost of dissolving each link."""
    links, size = regions.links, regions.size
    small_is_a = size[links.a] <= size[links.b]
    small = np.where(small_is_a, links.a, links.b)
    area = size[small]
    share = area / total
    grown = np.minimum(1.0, share / 0.002)
    cost = links.strength / links.count * (0.35 + 0.65 * grown**0.35)
    contact = np.minimum(1.0, links.count / (6 * np.sqrt(area)))
    if tree == 0:
        return cost + 0.9 * (1 - contact) * np.sqrt(grown)
    if tree == 1:
        enclosed = np.minimum(links.count / np.maximum(regions.perimeter[small], 1e-9), 1)
        fade = np.where(share < 0.08, 1.0, np.maximum(0, 1 - (share - 0.08) / 0.1))
        cost = cost * (1 - 0.85 * enclosed**2 * fade)
        return cost + 0.3 * (1 - contact) * np.sqrt(grown) * (1 - enclosed)
    normal = regions.normal / np.maximum(
        np.linalg.norm(regions.normal, axis=1, keepdims=True), 1e-9
    )
    turn = 1 - np.abs(np.einsum("ij,ij->i", normal[links.a], normal[links.b]))
    color = regions.color / size[:, None]
    hue = np.linalg.norm(color[links.a] - color[links.b], axis=1) / 15
    return 0.6 * cost + (1.5 * turn + 1.2 * np.minimum(hue, 2)) * np.sqrt(grown)


def build_hierarchy(superpoints: Superpoints) -> Hierarchy:
    """Three merge trees over the superpoints."""
    total = float(superpoints.size.sum())
    thresholds = 9.0 * (np.arange(1, LEVELS + 1) / LEVELS) ** 1.6
    labels, trees, heights = [], [], []
    perimeter = totals(
        superpoints.links.a, superpoints.links.count, len(superpoints)
    ) + np.bincount(superpoints.links.b, superpoints.links.count, len(superpoints))
    for tree in range(len(TREES)):
        regions = _Regions(
            superpoints.links,
            superpoints.size,
            perimeter,
            superpoints.normal * superpoints.size[:, None],
            superpoints.color * superpoints.size[:, None],
        )
        label = np.arange(len(superpoints), dtype=np.int32)
        for threshold in thresholds:
            before = len(regions.size)
            for _ in range(_ROUNDS):
                number = len(regions.size)
                if not len(regions.links.a):
                    break
                cost = _cost(regions, tree, total)
                best = regions.links.cheapest(cost, number)
                pick = distinct(best[best >= 0])
                pick = pick[cost[pick] <= threshold]
                if not len(pick):
                    break
                left, group = components(number, regions.links.a[pick], regions.links.b[pick])
                regions = regions.merge(group, left)
                label = group[label].astype(np.int32)
            if len(regions.size) < before:
                labels.append(label)
                trees.append(tree)
                heights.append(threshold)
            if len(regions.size) == 1:
                break
    if not labels:
        labels, trees, heights = [np.arange(len(superpoints), dtype=np.int32)], [0], [0.0]
    return Hierarchy(np.stack(labels), np.array(trees, np.int8), np.array(heights, np.float32))


LEAKS = (1e-4, 2e-2, 2e-1)
_COLUMNS = 512


class RandomWalk:
    """Factorised walks with one reach for each of ``LEAKS``."""

    def __init__(self, superpoints: Superpoints) -> None:
        links = superpoints.links
        apart = np.linalg.norm(superpoints.center[links.a] - superpoints.center[links.b], axis=1)
        typical = float(np.median(apart)) if len(apart) else 1.0
        weight = links.conductance / np.maximum(apart / max(typical, 1e-12), 0.3)
        matrix = adjacency(len(superpoints), links.a, links.b, weight)
        degree = np.asarray(matrix.sum(1)).ravel()
        median = float(np.median(degree)) if len(links.a) else 1.0
        unit = max(median, 1e-9)
        self._factors: list[SuperLU] = [
            splu(
                (diags(degree + leak * unit) - matrix).tocsc(),
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
            for leak in LEAKS
        ]
        self._count = len(superpoints)
        self._a, self._b, self._weight, self._size = links.a, links.b, weight, superpoints.size
        self._columns: LRUCache[tuple[int, int], Future[Float]] = LRUCache(_COLUMNS)
        self._ahead: ThreadPoolExecutor | None = None

    def column(self, superpoint: int, reach: int) -> Float:
        """(C,) the Green's function of a superpoint; ``reach`` indexes ``LEAKS``."""
        found = self._columns.get((superpoint, reach))
        if found is None:
            found = Future()
            found.set_result(self._solve(superpoint, reach))
            self._columns[superpoint, reach] = found
        return found.result()

    def prefetch(self, superpoint: int) -> None:
        """Start solving for a superpoint on another thread; :meth:`column` waits for it."""
        if self._ahead is None:
            self._ahead = ThreadPoolExecutor(1, thread_name_prefix="walk")
        for reach in range(len(LEAKS)):
            if (superpoint, reach) not in self._columns:
                solving = self._ahead.submit(self._solve, superpoint, reach)
                self._columns[superpoint, reach] = solving

    def _solve(self, superpoint: int, reach: int) -> Float:
        unit = np.zeros(self._count)
        unit[superpoint] = 1
        return self._factors[reach].solve(unit).astype(np.float32)

    def sweep(self, field: Float, most: int = 5) -> Bool:
        """Level sets of a field through whose border the walk leaks least, at several sizes.

        The sweep cut of local spectral clustering (Andersen, Chung, Lang 2006), with the leak
        relative to the root of the area, because borders of surfaces are lines.

        Args:
            field: (C,) high inside.
            most: largest number of sets.

        Returns:
            (H, C) bool, the tightest first.
        """
        order = np.argsort(-field, kind="stable")
        rank = np.empty(len(order), np.int64)
        rank[order] = np.arange(len(order))
        a, b = rank[self._a], rank[self._b]
        number = len(order) + 1
        through = np.bincount(np.minimum(a, b) + 1, self._weight, number) - np.bincount(
            np.maximum(a, b) + 1, self._weight, number
        )
        through = np.cumsum(through)[1:-1]
        area = np.cumsum(self._size[order])[:-1]
        if not len(area):
            return np.zeros((0, len(order)), bool)
        smaller = np.minimum(area, self._size.sum() - area)
        leak = np.maximum(through, 0) / np.sqrt(smaller) + 1e-9
        bins = np.floor(np.log(area) / 0.3).astype(np.int64)
        first = np.nonzero(np.r_[True, np.diff(bins) != 0])[0]
        low = np.minimum.reduceat(leak, first)
        number_in = np.diff(np.r_[first, len(leak)])
        at = np.nonzero(leak == np.repeat(low, number_in))[0]
        at = at[np.r_[True, np.diff(bins[at]) != 0]]
        around = np.minimum(np.r_[np.inf, low[:-1]], np.r_[low[1:], np.inf])
        good = np.nonzero(low <= 1.05 * around)[0]
        good = good[np.argsort(low[good], kind="stable")][:most]
        return rank[None] <= at[good][:, None]

    def fields(self, prior: Float, seeds: Int, values: Float, reach: int) -> Float:
        """Fields that keep to their priors far from the seeds and take ``values`` at them.

        Args:
            prior: (H, C).
            seeds: (K,) distinct superpoints.
            values: (K,).

        Returns:
            (H, C).
        """
        green = np.stack([self.column(int(s), reach) for s in seeds])
        inner = green[:, seeds].astype(np.float64)
        inner += 1e-7 * np.trace(inner) / len(seeds) * np.eye(len(seeds))
        missing = values[None] - prior[:, seeds]
        return prior + np.linalg.solve(inner, missing.T).T @ green


_LEAST_FLOOR, _BAND, _LEVEL = 0.05, 0.06, 0.9
"""Least share of nodes on a floor, its unevenness in metres, least vertical part of its normal."""
_LOWEST = 0.25
"""Metres above the lowest points in which a floor is searched."""
_SINGLE = 0.7
"""Share of a wide scan without a floor in one piece, above which it is a single object."""
_CUT = 9.0
"""Strength of links between floor or walls and the rest: a certain cut."""


@dataclass(frozen=True, eq=False)
class Room:
    """Borders of a room.

    Attributes:
        border: (C,) superpoints of floor, ceiling and walls.
        position: (C, 3) float32 metres, in a frame with most walls along x and y, z = 0 on the
            floor.
    """

    border: Bool
    position: Float32


def room_of(asset: Asset, nodes: Nodes, superpoints: Superpoints) -> Room | None:
    """The room that a scan shows, or None if it shows a single object.

    A room is wide and has a floor; a room whose floor and walls were cropped falls into pieces.
    """
    if asset.cloud is None or np.ptp(nodes.points[:, :2], axis=0).max() < ROOM_METRES:
        return None
    border, floor = np.zeros(len(superpoints), bool), _floor(superpoints)
    if floor is not None:
        on_border = floor_and_walls(Asset(asset.name, cloud=PointCloud(nodes.points)))
        border = (
            np.bincount(superpoints.of_node, on_border, len(superpoints)) > 0.5 * superpoints.size
        )
    elif largest_component(nodes.points).mean() > _SINGLE:
        return None
    yaw = _yaw(superpoints, border)
    cos, sin = np.cos(yaw), np.sin(yaw)
    turned = superpoints.center @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    turned[:, 2] -= np.percentile(nodes.points[:, 2], 1) if floor is None else floor
    return Room(border, turned.astype(np.float32))


def _floor(superpoints: Superpoints) -> float | None:
    """Height of the floor, horizontal and below everything else; None if there is none."""
    height, weight = superpoints.center[:, 2], superpoints.size / superpoints.size.sum()
    length = np.maximum(np.linalg.norm(superpoints.normal, axis=1), 1e-9)
    level = np.abs(superpoints.normal[:, 2]) / length > _LEVEL
    order = np.argsort(height, kind="stable")
    low = float(height[order[np.searchsorted(np.cumsum(weight[order]), 0.001)]])
    best, found = _LEAST_FLOOR, None
    for bottom in np.arange(low - _BAND, low + _LOWEST, _BAND / 2):
        inside = level & (height >= bottom) & (height < bottom + _BAND)
        if (share := float(weight[inside].sum())) > best:
            best, found = share, float(np.median(height[inside]))
    return found


def _yaw(superpoints: Superpoints, border: Bool) -> float:
    """Radians, 0 to pi/2: the commonest direction of vertical surfaces."""
    normal = superpoints.normal / np.maximum(
        np.linalg.norm(superpoints.normal, axis=1, keepdims=True), 1e-9
    )
    upright = np.abs(normal[:, 2]) < 0.3
    angle = np.arctan2(normal[upright, 1], normal[upright, 0])
    weight = superpoints.size[upright] * (1 + 2 * border[upright])
    if not len(angle):
        return 0.0
    counts, _ = np.histogram(angle % (np.pi / 2), 90, (0, np.pi / 2), weights=weight)
    smooth = counts + np.roll(counts, 1) + np.roll(counts, -1)
    middle = (smooth.argmax() + 0.5) * np.pi / 180
    # The mean of the directions near it, on the circle of quarter turns.
    off = (angle - middle + np.pi / 4) % (np.pi / 2) - np.pi / 4
    near = np.abs(off) < np.radians(3)
    return float(middle + np.average(off[near], weights=weight[near]))


def with_borders_cut(superpoints: Superpoints, room: Room) -> Superpoints:
    """The superpoints with certain cuts between floor or walls and everything else."""
    links = superpoints.links
    across = room.border[links.a] != room.border[links.b]
    strength = np.where(across, _CUT * links.count, links.strength)
    weakest = np.exp(-_CUT) * links.count
    conductance = np.where(across, np.minimum(links.conductance, weakest), links.conductance)
    return replace(superpoints, links=replace(links, strength=strength, conductance=conductance))


@dataclass(frozen=True, eq=False)
class Encoding:
    """Nodes, graph, superpoints, merge trees and factorised walks of an asset.

    Attributes:
        strength: (M,) float32 of each edge of the node graph as a cut, 0..9.
        room: borders of a scanned room; None for an object.
    """

    nodes: Nodes
    graph: Graph
    strength: Float32
    superpoints: Superpoints
    hierarchy: Hierarchy
    walk: RandomWalk
    room: Room | None = None


def encode_superpoints(
    asset: Asset, edges: Mlp | None, progress: Progress = no_progress
) -> tuple[Nodes, Graph, Float32, Superpoints]:
    """Nodes, graph, edge strengths and superpoints of ``asset``: the first four steps."""
    progress(0.0, "sampling the surface")
    nodes = nodes_of_asset(asset)
    progress(0.15, "neighbours and normals")
    graph = build_graph(nodes)
    progress(0.45, "creases and colours")
    strength = edge_strength(nodes, graph, edges)
    progress(0.7, "small patches")
    superpoints = build_superpoints(nodes, graph, strength, edge_weight(strength, graph))
    return nodes, graph, strength, superpoints


def encode(asset: Asset, edges: Mlp | None, progress: Progress = no_progress) -> Encoding:
    """Encode ``asset``; ``edges`` is the edge model, None for the hand-set rule."""
    nodes, graph, strength, superpoints = encode_superpoints(asset, edges, progress)
    room = room_of(asset, nodes, superpoints)
    if room is not None:
        superpoints = with_borders_cut(superpoints, room)
    progress(0.8, "patches that belong together")
    # SuperLU frees memory only on the thread that allocated it: factorise on this one.
    walk, hierarchy = together(
        lambda: RandomWalk(superpoints), lambda: build_hierarchy(superpoints)
    )
    nodes.elements.prepare()
    progress(1.0, "ready")
    return Encoding(nodes, graph, strength, superpoints, hierarchy, walk, room)
