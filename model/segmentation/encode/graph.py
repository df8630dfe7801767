"""Encode, step 2: the neighbourhood graph over the nodes, with their normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from model.segmentation.arrays import Bool, Float, Float32, Int, Int32
from model.segmentation.encode.nodes import Nodes, distinct
from model.segmentation.encode.normals import orient_outwards, plane_normals, smooth_normals

EDGE_NEIGHBORS = 10
PLANE_NEIGHBORS = 20
_BRIDGE_SAMPLES = 64


@dataclass(frozen=True, eq=False)
class Graph:
    """Undirected k-nearest-neighbour graph, made connected by a few bridges.

    Attributes:
        a, b: (M,) int32 node indices, a < b.
        length: (M,) float32 metres.
        bridge: (M,) bool; True for edges that join otherwise separate components.
        neighbors: (N, K) int32, nearest first, without the node itself.
        spacing: typical distance between neighbours in metres.
        normals: (N, 3) float32 smoothed unit normals, turned outwards.
        rough_normals: (N, 3) float32 the same before smoothing.
        variation: (N,) float32 surface variation.
    """

    a: Int32
    b: Int32
    length: Float32
    bridge: Bool
    neighbors: Int32
    spacing: float
    normals: Float32
    rough_normals: Float32
    variation: Float32

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return len(self.normals)


def build_graph(nodes: Nodes) -> Graph:
    """Connect the nodes and find their normals."""
    points = nodes.points
    count = len(points)
    k = min(PLANE_NEIGHBORS, count - 1)
    if k < 1:
        none = np.zeros(0, np.int32)
        up = np.tile(np.array([0, 0, 1], np.float32), (count, 1))
        flat = np.zeros(count, np.float32)
        empty = np.zeros((count, 0), np.int32)
        return Graph(none, none, flat[:0], np.zeros(0, bool), empty, 1e-3, up, up, flat)
    distance, near = nodes.tree.query(points, k=k + 1, workers=2)
    near = np.asarray(near)[:, 1:].astype(np.int32)
    spacing = max(float(np.median(np.asarray(distance)[:, 1 : min(5, k + 1)])), 1e-9)
    rough, variation = plane_normals(
        points, np.concatenate([np.arange(count, dtype=np.int32)[:, None], near], axis=1)
    )
    if nodes.normals is not None:
        given = nodes.normals
        good = np.linalg.norm(given, axis=1, keepdims=True) > 0.5
        rough = np.where(good, given, rough).astype(np.float32)
    rough = orient_outwards(points, rough, spacing)
    normals = smooth_normals(rough, near[:, :12])
    a, b = _undirected(near[:, :EDGE_NEIGHBORS])
    bridge = np.zeros(len(a), bool)
    more = _bridges(points, a, b)
    if len(more):
        a = np.concatenate([a, more.min(1)])
        b = np.concatenate([b, more.max(1)])
        bridge = np.concatenate([bridge, np.ones(len(more), bool)])
    length = np.linalg.norm(points[b] - points[a], axis=1).astype(np.float32)
    return Graph(a, b, length, bridge, near, spacing, normals, rough, variation)


def _undirected(near: Int32) -> tuple[Int32, Int32]:
    count = len(near)
    i = np.repeat(np.arange(count, dtype=np.int64), near.shape[1])
    j = near.ravel().astype(np.int64)
    key = distinct(np.minimum(i, j) * count + np.maximum(i, j))
    key = key[key // count != key % count]
    return (key // count).astype(np.int32), (key % count).astype(np.int32)


def components(count: int, a: npt.NDArray, b: npt.NDArray) -> tuple[int, Int32]:
    """Number of connected components over edges ``a``-``b``, and (count,) the one of each node."""
    links = coo_matrix((np.ones(len(a), np.int8), (a, b)), shape=(count, count))
    return connected_components(links, directed=False)


def _bridges(points: Float32, a: Int32, b: Int32) -> Int32:
    """(K, 2) node pairs that connect each component with near ones until there is only one."""
    found: list[Int32] = []
    for _ in range(12):
        number, label = components(len(points), a, b)
        if number == 1:
            break
        # A sample of each component is matched with the samples of the others: cheap, and exact
        # enough for edges that count as cuts anyway.
        order = np.argsort(label, kind="stable")
        start = np.searchsorted(label[order], np.arange(number + 1))
        size = np.diff(start)
        step = np.maximum(size // _BRIDGE_SAMPLES, 1)
        chosen = np.concatenate(
            [order[start[c] : start[c + 1] : step[c]] for c in range(number)]
        ).astype(np.int32)
        group = label[chosen]
        k = min(len(chosen), 2 * _BRIDGE_SAMPLES + 2)
        distance, near = KDTree(points[chosen]).query(points[chosen], k=k, workers=2)
        distance, near = np.asarray(distance), np.asarray(near)
        foreign = group[near] != group[:, None]
        first = foreign.argmax(1)
        rows = np.arange(len(chosen))
        reach = np.where(foreign[rows, first], distance[rows, first], np.inf)
        best = np.lexsort((reach, group))
        head = best[np.r_[True, np.diff(group[best]) != 0]]
        head = head[np.isfinite(reach[head])]
        if not len(head):
            big = int(size.argmax())
            pairs = np.array(
                [[order[start[big]], order[start[c]]] for c in range(number) if c != big], np.int32
            )
        else:
            pairs = np.stack([chosen[head], chosen[near[head, first[head]]]], axis=1)
        pairs = np.unique(np.sort(pairs, axis=1), axis=0).astype(np.int32)
        found.append(pairs)
        a = np.concatenate([a, pairs[:, 0]])
        b = np.concatenate([b, pairs[:, 1]])
    return np.concatenate(found) if found else np.zeros((0, 2), np.int32)


def adjacency(count: int, a: Int, b: Int, weight: Float) -> csr_matrix:
    """Symmetric sparse matrix of edge weights."""
    rows = np.concatenate([a, b])
    columns = np.concatenate([b, a])
    return csr_matrix((np.concatenate([weight, weight]), (rows, columns)), shape=(count, count))
