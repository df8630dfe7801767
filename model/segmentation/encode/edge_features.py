"""Encode, step 3a: features of the node graph's edges: normals, creases, gaps, steps, colour.

All features are free of scale: lengths are in units of the node spacing.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix

from model.segmentation.arrays import Float, Int32, Uint8
from model.segmentation.encode.graph import Graph
from model.segmentation.encode.nodes import Nodes
from model.segmentation.parallel import mapped, together

FEATURE_NAMES = (
    "length", "rough_angle",
    "angle_1", "convex_1", "step_1", "angle_2", "convex_2", "step_2", "angle_3", "convex_3",
    "step_3", "turn_2_max", "turn_2_difference", "turn_3_max", "turn_3_difference",
    "curvature_min", "curvature_max", "curvature_wide_min", "curvature_wide_max",
    "offset_min", "offset_difference", "rim", "rims_face", "density", "variation",
    "dark", "color_near", "color_wide", "hue_wide", "color_edge", "has_color",
)  # fmt: skip

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
    offset = np.einsum("ij,ij->i", points - smooth(points - points.mean(0), 3) - points.mean(0),
                       normals) / h  # fmt: skip
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
