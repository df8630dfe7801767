"""Encode, steps 2 and 3: the nodes' normals and neighbourhood graph, and its edges' strengths.

Normals are those of local planes, oriented towards the directions that see them. Features of edges
(normals, creases, gaps, steps, colour) are free of scale: lengths are in units of the node spacing.
A small network reads them. The strength is the log-odds that an edge crosses a border between
parts, clipped to [0, 9]: 0 is the inside of a part, 9 a certain cut.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from model.core.files import static_assets
from model.segmentation.arrays import (
    Bool,
    Float,
    Float32,
    Float64,
    Int,
    Int32,
    Uint8,
    mapped,
    together,
)
from model.segmentation.models import Mlp, load_mlp
from model.segmentation.nodes import Nodes, distinct

_CHUNK = 20_000


def plane_normals(points: Float32, neighbors: Int) -> tuple[Float32, Float32]:
    """Normals of the planes fitted to each point's neighbours.

    Args:
        points: (N, 3).
        neighbors: (N, K) indices.

    Returns:
        (N, 3) unit normals of arbitrary sign, and (N,) surface variation in [0, 1/3].
    """
    normals = np.empty((len(points), 3), np.float32)
    variation = np.empty(len(points), np.float32)

    def fit(begin: int) -> None:
        local = points[neighbors[begin : begin + _CHUNK]].astype(np.float64)
        local -= local.mean(1, keepdims=True)
        covariance = np.matmul(local.transpose(0, 2, 1), local)
        values, vectors = np.linalg.eigh(covariance)
        normals[begin : begin + _CHUNK] = vectors[:, :, 0]
        variation[begin : begin + _CHUNK] = values[:, 0] / np.maximum(values.sum(1), 1e-30)

    mapped(fit, range(0, len(points), _CHUNK))
    return normals, variation


def sphere_directions(count: int) -> Float64:
    """(count, 3) unit vectors spread evenly (golden spiral)."""
    i = np.arange(count) + 0.5
    polar = np.arccos(1 - 2 * i / count)
    turn = np.pi * (1 + 5**0.5) * i
    return np.stack(
        [np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1
    )


def orient_outwards(
    points: Float32, normals: Float32, spacing: float, directions: int = 26
) -> Float32:
    """Flip normals towards the directions from which the points are visible.

    Each direction has a depth buffer with pixels of ``2 * spacing``. Right for 93 to 97 % of the
    points of furniture; hidden points keep their sign.
    """
    towards = np.zeros((len(points), 3), np.float32)
    pixel = max(2.0 * spacing, 1e-9)
    exact = points.astype(np.float64)

    def sees(direction: Float64) -> Bool:
        helper = np.array([1.0, 0, 0]) if abs(direction[0]) < 0.8 else np.array([0, 1.0, 0])
        u = np.cross(direction, helper)
        u /= np.linalg.norm(u)
        frame = np.stack([u, np.cross(direction, u), direction], axis=1)
        local = exact @ frame
        grid = np.floor((local[:, :2] - local[:, :2].min(0)) / pixel).astype(np.int64)
        key = grid[:, 0] * (grid[:, 1].max() + 1) + grid[:, 1]
        top = np.full(int(key.max()) + 1, -np.inf)
        np.maximum.at(top, key, local[:, 2])
        return local[:, 2] > top[key] - 2 * spacing

    tried = sphere_directions(directions)
    for direction, visible in zip(tried, mapped(sees, tried), strict=True):
        towards[visible] += direction.astype(np.float32)
    flip = np.einsum("ij,ij->i", normals, towards) < 0
    out = normals.copy()
    out[flip] *= -1
    return out


def smooth_normals(normals: Float32, neighbors: Int, passes: int = 3) -> Float32:
    """Bilateral smoothing: neighbours are weighted by how much they already agree."""
    out = normals
    for _ in range(passes):
        mixed = np.concatenate(mapped(partial(_blend, out, neighbors), range(0, len(out), _CHUNK)))
        out = mixed / np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), 1e-9)
    return out


def _blend(normals: Float32, neighbors: Int, begin: int) -> Float32:
    here = normals[begin : begin + _CHUNK]
    around = normals[neighbors[begin : begin + _CHUNK]]
    dot = np.einsum("nki,ni->nk", around, here)
    weight = np.exp((dot.astype(np.float64) - 1) / 0.35**2).astype(np.float32) * (dot > 0)
    return np.einsum("nk,nki->ni", weight, around) + here


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


FEATURE_NAMES = (
    *"length rough_angle angle_1 convex_1 step_1 angle_2 convex_2 step_2 angle_3 convex_3".split(),
    *"step_3 turn_2_max turn_2_difference turn_3_max turn_3_difference curvature_min".split(),
    *"curvature_max curvature_wide_min curvature_wide_max offset_min offset_difference rim".split(),
    *"rims_face density variation dark color_near color_wide hue_wide color_edge has_color".split(),
)

_NEAR = 12


class _Diffusion:
    """Averages over graph neighbours, repeated: 0.3 of itself, 0.7 of the neighbours' mean."""

    def __init__(self, neighbors: Int32) -> None:
        count, k = neighbors.shape
        self._matrix = csr_matrix(
            (
                np.full(count * k, 0.7 / max(k, 1), np.float32),
                neighbors.ravel(),
                np.arange(0, count * k + 1, max(k, 1)) if k else np.zeros(count + 1, np.int32),
            ),
            shape=(count, count),
        )

    def __call__(self, values: Float, passes: int) -> Float:
        for _ in range(passes):
            values = np.float32(0.3) * values + self._matrix @ values
        return values


def lab_colors(colors: Uint8) -> Float:
    """(N, 3) CIE Lab (D65) of sRGB colours."""
    c = np.arange(256) / 255
    linear = np.where(c > 0.04045, ((c + 0.055) / 1.055) ** 2.4, c / 12.92)
    to_xyz = np.array(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    )
    xyz = linear[colors] @ to_xyz.T / np.array([0.95047, 1, 1.08883])
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.stack(
        [116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1
    ).astype(np.float32)


def _pair(normals: Float, a: npt.NDArray, b: npt.NDArray, along: Float) -> list[Float]:
    unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    na, nb = unit[a], unit[b]
    angle = np.arccos(np.clip(np.einsum("ij,ij->i", na, nb), -1, 1, dtype=np.float64))
    out_a = np.einsum("ij,ij->i", na, along)
    out_b = np.einsum("ij,ij->i", nb, along)
    return [angle, out_b - out_a, np.abs(out_a + out_b) / 2]


def edge_features(nodes: Nodes, graph: Graph) -> Float:
    """(M, 31) features of the graph's edges, in the order of ``FEATURE_NAMES``."""
    smooth = _Diffusion(graph.neighbors[:, :_NEAR])
    shape, color = together(
        lambda: _shape_features(nodes, graph, smooth), lambda: _color_features(nodes, graph, smooth)
    )
    return np.stack([np.asarray(f, np.float32) for f in shape + color], axis=1)


def _shape_features(nodes: Nodes, graph: Graph, smooth: _Diffusion) -> list[Float]:
    a, b, h = graph.a, graph.b, np.float32(graph.spacing)
    points = nodes.points
    near = graph.neighbors[:, :_NEAR]
    along = (points[b] - points[a]) / np.maximum(graph.length, 1e-12)[:, None]
    normals = graph.normals
    normals_2 = smooth(normals, 4)
    normals_3 = smooth(normals_2, 8)
    rough = np.abs(np.einsum("ij,ij->i", graph.rough_normals[a], graph.rough_normals[b]))
    rough = np.arccos(np.minimum(rough, 1, dtype=np.float64))
    out: list[Float] = [np.minimum(graph.length / h, 8), rough]
    for pair in mapped(lambda n: _pair(n, a, b, along), (normals, normals_2, normals_3)):
        out += pair
    for scale in (normals_2, normals_3):
        turn = 1 - np.linalg.norm(scale, axis=1)
        out += [np.maximum(turn[a], turn[b]), np.abs(turn[a] - turn[b])]
    to = points[near] - points[:, None]
    bend = np.einsum("nkj,nkj->nk", normals[near] - normals[:, None], to)
    bend = (bend / (np.einsum("nkj,nkj->nk", to, to) + 1e-12)).mean(1) * h
    for value in (bend, smooth(bend, 4)):
        out += [np.minimum(value[a], value[b]), np.maximum(value[a], value[b])]
    offset = (
        np.einsum("ij,ij->i", points - smooth(points - points.mean(0), 3) - points.mean(0), normals)
        / h
    )
    out += [np.minimum(offset[a], offset[b]), np.abs(offset[a] - offset[b])]
    lean = to.mean(1)
    lean -= np.einsum("ij,ij->i", lean, normals)[:, None] * normals
    rim = np.linalg.norm(lean, axis=1) / h
    out += [np.maximum(rim[a], rim[b])]
    out += [np.einsum("ij,ij->i", lean[b] - lean[a], along) / h]
    reach = np.linalg.norm(to[:, :6], axis=2).mean(1) / h
    wide = np.maximum(smooth(reach, 3), 1e-6)
    out += [np.maximum(reach[a] / wide[a], reach[b] / wide[b])]
    out += [np.maximum(graph.variation[a], graph.variation[b])]
    return out


def _color_features(nodes: Nodes, graph: Graph, smooth: _Diffusion) -> list[Float]:
    a, b = graph.a, graph.b
    if nodes.colors is None or not np.ptp(nodes.colors.astype(np.int16), axis=0).any():
        return [np.zeros(len(a), np.float32)] * 6
    raw = lab_colors(nodes.colors)
    lab = smooth(raw, 1)
    wide = smooth(lab, 6)
    dark = lab[:, 0] - wide[:, 0]
    spread = np.sqrt(np.maximum(smooth((lab**2).sum(1), 4) - (smooth(lab, 4) ** 2).sum(1), 0))
    gap = wide[a] - wide[b]
    return [
        np.minimum(dark[a], dark[b]) / 10,
        np.linalg.norm(lab[a] - lab[b], axis=1) / 10,
        np.linalg.norm(gap, axis=1) / 10,
        np.linalg.norm(gap[:, 1:], axis=1) / 10,
        np.maximum(spread[a], spread[b]) / 10,
        np.ones(len(a), np.float32),
    ]


WEIGHTS = "segmentation/edges.npz"
MAX_STRENGTH = 9.0

_INSIDE = 0.75
_LEAST_SHIFT, _MOST_SHIFT = 3.0, 8.0
_SHELL_CUT = 5.0
_MATERIAL_CUT = 1.0


@lru_cache(maxsize=1)
def shipped_edge_model() -> Mlp | None:
    """The trained model of the project, or None if its file is absent."""
    path = static_assets() / WEIGHTS
    return load_mlp(path, FEATURE_NAMES) if path.is_file() else None


def hand_set_strength(features: Float32) -> Float32:
    """(M,) strength from angle, convexity and colour, without any training."""
    column = {name: features[:, i] for i, name in enumerate(FEATURE_NAMES)}
    angle = column["angle_1"]
    concave = column["convex_1"] < 0
    crease = np.where(concave, 60.0, 3.0) * angle**2
    color = 0.15 * (10 * column["color_near"] / 4) ** 2
    return np.clip(crease + color, 0, MAX_STRENGTH).astype(np.float32)


def edge_strength(nodes: Nodes, graph: Graph, model: Mlp | None) -> Float32:
    """(M,) strength of each edge by ``model``; None stands for the hand-set rule."""
    if not len(graph.a):
        return np.zeros(0, np.float32)
    features = edge_features(nodes, graph)
    if model is None:
        strength = hand_set_strength(features)
    else:
        logit = model(features)
        # Borders are fainter on noisy scans. Three quarters of all edges are certainly inside
        # parts: their quantile sets the zero.
        shift = np.clip(-np.quantile(logit, _INSIDE), _LEAST_SHIFT, _MOST_SHIFT)
        strength = logit + np.float32(shift)
    strength = np.clip(strength, 0, MAX_STRENGTH).astype(np.float32)
    a, b = graph.a, graph.b
    strength += _SHELL_CUT * (nodes.shell[a] != nodes.shell[b])
    strength += _MATERIAL_CUT * (nodes.material[a] != nodes.material[b])
    strength = np.clip(strength, 0, MAX_STRENGTH)
    strength[graph.bridge] = MAX_STRENGTH
    return strength


def edge_weight(strength: Float32, graph: Graph) -> Float32:
    """(M,) conductance of each edge for the random walk."""
    reach = np.minimum(graph.length / np.float32(graph.spacing), 8)
    return np.exp(-strength.astype(np.float64) - 0.1 * reach**2).astype(np.float32)
