"""Encode, step 4: superpoints, clusters of a few nodes whose borders follow the likely cuts.

Clicks are answered on about ten thousand superpoints instead of 100k nodes: a sparse solve then
takes milliseconds, and superpoints are so small that little accuracy is lost.

On clouds that were sampled from models, superpoints of two colours are split. Where one part lies
inside another by less than the point spacing (a drawer's box in its carcass, a blade in its
handle), neither creases nor gaps separate them; their colours may still differ. Depth cameras see
only the outer part and never record such flat colours, so scans gain nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.segmentation.arrays import Float, Float32, Float64, Int, Int32, Int64, Uint8
from model.segmentation.graph import Graph, components, lab_colors
from model.segmentation.nodes import Nodes

_LEAST_STEP = 10.0
"""Least Lab distance of two colours: about four just noticeable differences."""
_CLEAR = 4.0
"""Least distance of two colours in units of the spread around them; texture and noise have less."""
_LEAST_NODES = 2
_ROUNDS = 2
_MOVES = 3
_FLAT = 0.5
_NEAR = 6


def has_flat_colors(colors: Uint8, neighbors: Int) -> bool:
    """True if most colours (N, 3) equal that of one of their (N, K) neighbours."""
    same = (colors[neighbors[:, :_NEAR]] == colors[:, None]).all(axis=2).any(axis=1)
    return bool(same.mean() > _FLAT)


def split_by_color(of_node: Int, lab: Float, number: int) -> tuple[Int64, int]:
    """Split superpoints whose nodes have two to four colours.

    Args:
        of_node: (N,) the superpoint of each node.
        lab: (N, 3) CIE Lab.
        number: of superpoints, C.

    Returns:
        (N,) the new superpoint of each node, and the new number.
    """
    superpoints: Int64 = of_node.astype(np.int64)
    for _ in range(_ROUNDS):
        side, step, spread, fewer = _two_colors(superpoints, lab, number)
        cut = (step > _LEAST_STEP) & (step > _CLEAR * spread) & (fewer >= _LEAST_NODES)
        if not cut.any():
            break
        other = (side == 1) & cut[superpoints]
        new = np.cumsum(cut) - 1 + number
        superpoints = np.where(other, new[superpoints], superpoints)
        number += int(cut.sum())
    return superpoints, number


def _two_colors(of_node: Int64, lab: Float, number: int) -> tuple[Int64, Float, Float, Int64]:
    """Two-means clustering of each superpoint's colours.

    Returns:
        (N,) the cluster 0 or 1 of each node; (C,) distance of the two means, (C,) root mean square
        distance of the nodes to theirs, and (C,) nodes of the smaller cluster.
    """
    order = np.argsort(of_node, kind="stable")
    start = np.searchsorted(of_node[order], np.arange(number))

    def farthest(middle: Float) -> Float:
        """(C, 3) in each superpoint the colour that is farthest from (C, 3) ``middle``."""
        far = np.linalg.norm(lab - middle[of_node], axis=1)[order]
        most = np.maximum.reduceat(far, start)
        at = np.flatnonzero(far == most[of_node[order]])
        first = at[np.r_[True, np.diff(of_node[order][at]) != 0]]
        return lab[order[first]]

    def means(group: Int64, count: int) -> Float:
        size = np.maximum(np.bincount(group, minlength=count), 1)
        return np.stack([np.bincount(group, v, count) for v in lab.T], axis=1) / size[:, None]

    one = farthest(means(of_node, number))
    two = farthest(one)
    side = np.zeros(len(lab), np.int64)
    for _ in range(_MOVES):
        nearer = np.linalg.norm(lab - two[of_node], axis=1)
        side = (nearer < np.linalg.norm(lab - one[of_node], axis=1)).astype(np.int64)
        both = means(2 * of_node + side, 2 * number)
        one, two = both[::2], both[1::2]
    count = np.bincount(2 * of_node + side, minlength=2 * number).reshape(number, 2)
    rest = ((lab - both[2 * of_node + side]) ** 2).sum(1)
    free = np.maximum(count.sum(1) - 2, 1)  # two means of few points fit any noise
    spread = np.sqrt(np.bincount(of_node, rest, number) / free)
    return side, np.linalg.norm(one - two, axis=1), spread, count.min(1)


TARGET_SUPERPOINTS = 12_000
_MAX_NODES, _MAX_STRENGTH = 40, 3.0
"""Most nodes of a cluster, and strongest mean of the edges that it dissolves."""


def totals(index: Int, values: npt.NDArray, number: int) -> Float64:
    """(number,) sums of ``values`` by ``index``."""
    return np.asarray(np.bincount(index, values, number), np.float64)


@dataclass(frozen=True, eq=False)
class Links:
    """Weighted undirected edges between clusters.

    Attributes:
        a, b: (M,) int32, a < b.
        strength: (M,) float64 sum over the node edges between the two.
        count: (M,) float64 number of those node edges.
        conductance: (M,) float64 sum of their weights.
    """

    a: Int32
    b: Int32
    strength: Float64
    count: Float64
    conductance: Float64

    def contract(self, group: Int, number: int) -> Links:
        """The links between groups of clusters."""
        a, b = group[self.a].astype(np.int64), group[self.b].astype(np.int64)
        keep = a != b
        low, high = np.minimum(a, b)[keep], np.maximum(a, b)[keep]
        key, back = np.unique(low * number + high, return_inverse=True)
        size = len(key)
        return Links(
            (key // number).astype(np.int32),
            (key % number).astype(np.int32),
            totals(back, self.strength[keep], size),
            totals(back, self.count[keep], size),
            totals(back, self.conductance[keep], size),
        )

    def cheapest(self, cost: Float, number: int) -> Int64:
        """(number,) index of each cluster's cheapest link, -1 where it has none."""
        best = np.full(number, np.inf)
        np.minimum.at(best, self.a, cost)
        np.minimum.at(best, self.b, cost)
        chosen = np.full(number, -1, np.int64)
        # Written backwards, so that of equal links the first wins.
        for side in (self.b, self.a):
            hit = np.nonzero(cost == best[side])[0][::-1]
            chosen[side[hit]] = hit
        return chosen


@dataclass(frozen=True, eq=False)
class Superpoints:
    """The C superpoints of an encoded asset.

    Attributes:
        of_node: (N,) int32 the superpoint of each node.
        links: between superpoints.
        size: (C,) nodes in each.
        center: (C, 3) float64 metres.
        normal: (C, 3) mean of unit normals (not normalised).
        color: (C, 3) mean Lab, zeros without colours.
    """

    of_node: Int32
    links: Links
    size: Float64
    center: Float64
    normal: Float64
    color: Float64

    def __len__(self) -> int:
        return len(self.size)


def build_superpoints(
    nodes: Nodes, graph: Graph, strength: Float32, weight: Float32, target: int = TARGET_SUPERPOINTS
) -> Superpoints:
    """Merge pairs along the weakest edges until about ``target`` clusters are left.

    On clouds with flat colours, clusters of two colours are then split. Meshes have shells instead.
    """
    links = Links(
        graph.a,
        graph.b,
        strength.astype(np.float64),
        np.ones(len(graph.a)),
        weight.astype(np.float64),
    )
    of_node, merged, number = _merged_pairs(links, graph, target)
    colors = None if nodes.of_mesh else nodes.colors
    if colors is not None and has_flat_colors(colors, graph.neighbors):
        of_node, after = split_by_color(of_node, lab_colors(colors), number)
        if after > number:
            number, merged = after, links.contract(of_node, after)
    return _describe(nodes, graph, of_node.astype(np.int32), merged, number)


def _merged_pairs(links: Links, graph: Graph, target: int) -> tuple[Int, Links, int]:
    """(N,) the cluster of each node, the links between clusters, and their number."""
    number = graph.node_count
    of_node: Int = np.arange(number, dtype=np.int32)
    size = np.ones(number)
    far = np.minimum(graph.length / np.float32(graph.spacing), 8).astype(np.float64)
    while number > target and len(links.a):
        mean = links.strength / links.count
        joint = size[links.a] + size[links.b]
        cost = mean + 0.05 * joint + 0.1 * far
        # With equal costs every superpoint would choose its lowest neighbour, and none a pair.
        cost += 0.05 * np.random.default_rng(number).random(len(cost))
        cost[(joint > _MAX_NODES) | (mean > _MAX_STRENGTH)] = np.inf
        best = links.cheapest(cost, number)
        rows = np.nonzero(best >= 0)[0]
        rows = rows[np.isfinite(cost[best[rows]])]
        mate = np.where(links.a[best[rows]] == rows, links.b[best[rows]], links.a[best[rows]])
        mutual = best[mate] == best[rows]
        rows, mate = rows[mutual], mate[mutual]
        if not len(rows):
            break
        left, group = components(number, rows, mate)
        if left > 0.99 * number:
            break
        size = np.bincount(group, size, left)
        of_node = group[of_node]
        links = links.contract(group, left)
        far = np.zeros(len(links.a))
        number = left
    return of_node, links, number


def _describe(nodes: Nodes, graph: Graph, of_node: Int32, links: Links, number: int) -> Superpoints:
    size = np.bincount(of_node, minlength=number).astype(np.float64)

    def mean(values: npt.NDArray) -> Float64:
        return np.stack([np.bincount(of_node, v, number) for v in values.T], axis=1) / size[:, None]

    color = np.zeros((number, 3))
    if nodes.colors is not None:
        color = mean(lab_colors(nodes.colors))
    return Superpoints(of_node, links, size, mean(nodes.points), mean(graph.normals), color)
