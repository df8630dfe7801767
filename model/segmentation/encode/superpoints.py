"""Encode, step 4: superpoints, clusters of a few nodes whose borders follow the likely cuts.

Clicks are answered on about ten thousand superpoints instead of 100k nodes: a sparse solve then
takes milliseconds, and superpoints are so small that little accuracy is lost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.segmentation.arrays import Float, Float32, Float64, Int, Int32, Int64
from model.segmentation.encode.edge_features import lab_colors
from model.segmentation.encode.graph import Graph, components
from model.segmentation.encode.nodes import Nodes
from model.segmentation.encode.superpoint_colors import has_flat_colors, split_by_color

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

    On clouds with flat colours, clusters of two colours are then split; see
    :mod:`.superpoint_colors`. Meshes have their shells and materials instead.
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
