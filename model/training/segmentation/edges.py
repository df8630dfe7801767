"""Train the edge model: does an edge of the node graph cross a border between parts?"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from model.core.asset import Asset
from model.data.simulated.scans import random_scan
from model.segmentation.arrays import Float
from model.segmentation.encode.edge_features import FEATURE_NAMES, edge_features
from model.segmentation.encode.edge_strength import hand_set_strength
from model.segmentation.encode.graph import build_graph
from model.segmentation.encode.nodes import nodes_of_asset
from model.segmentation.models.mlp import save_mlp
from model.training.segmentation.fit import area_under_curve, fit_mlp


@dataclass(frozen=True)
class EdgeTraining:
    """Settings that trained ``edges.npz``.

    Attributes:
        objects: training objects.
        held_out: further objects to measure on.
        edges_per_object: at most half of them borders.
        first_seed: of the objects.
    """

    objects: int = 320
    held_out: int = 40
    edges_per_object: int = 5000
    first_seed: int = 0


def edges_of(seed: int, limit: int) -> tuple[Float, Float, Float]:
    """Features, whether each is a border, and weights that restore the natural share."""
    data = random_scan(seed)
    nodes = nodes_of_asset(Asset("object", cloud=data.cloud))
    graph = build_graph(nodes)
    features = edge_features(nodes, graph)
    border = data.labels[graph.a] != data.labels[graph.b]
    rng = np.random.default_rng([seed, 2])
    picked, weight = [], []
    for side in (border & ~graph.bridge, ~border & ~graph.bridge):
        index = np.nonzero(side)[0]
        take = rng.permutation(index)[: limit // 2]
        picked.append(take)
        weight.append(np.full(len(take), len(index) / max(len(take), 1)))
    index = np.concatenate(picked)
    # Borders are rare: with three times their weight the model gets sharper there.
    share = np.concatenate([weight[0] * 3, weight[1]])
    share = share / max(share.sum(), 1e-9) * limit
    return features[index], border[index].astype(np.float32), share.astype(np.float32)


def train_edges(config: EdgeTraining, out: Path) -> dict[str, float]:
    """Train, measure on held-out objects, write ``out``; returns the scores."""
    seeds = range(config.first_seed, config.first_seed + config.objects + config.held_out)
    rows = []
    for i, seed in enumerate(seeds):
        rows.append(edges_of(seed, config.edges_per_object))
        if i % 20 == 0:
            print(f"object {i} of {len(seeds)}", flush=True)
    features, border, weight = (
        np.concatenate(column) for column in zip(*rows[: config.objects], strict=True)
    )
    model = fit_mlp(FEATURE_NAMES, features, border, weight)
    test, truth, _ = (
        np.concatenate(column) for column in zip(*rows[config.objects :], strict=True)
    )
    scores = {
        "auc": area_under_curve(model(test), truth > 0.5),
        "auc_hand_set": area_under_curve(hand_set_strength(test), truth > 0.5),
        "edges": float(len(features)),
    }
    save_mlp(model, out, {"training": asdict(config), "scores": scores})
    return scores
