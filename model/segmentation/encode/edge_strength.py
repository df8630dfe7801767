"""Encode, step 3b: how likely each edge of the node graph crosses a border between parts.

The strength is a log-odds clipped to [0, 9]: 0 is the inside of a part, 9 a certain cut.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from model.core.files import static_assets
from model.segmentation.arrays import Float32
from model.segmentation.encode.edge_features import FEATURE_NAMES, edge_features
from model.segmentation.encode.graph import Graph
from model.segmentation.encode.nodes import Nodes
from model.segmentation.models.mlp import Mlp, load_mlp

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
