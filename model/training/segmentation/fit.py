"""Fit small perceptrons with torch and trees with LightGBM, and convert them to plain numpy."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.linalg import block_diag
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits

from model.segmentation.arrays import Bool, Float, Int
from model.segmentation.models.mlp import Mlp
from model.segmentation.models.trees import Trees

_EDGE_BATCH, _CLICK_BATCH = 4096, 128
_CALIBRATION = 0.1
"""Weight of the loss that keeps a ranker's output a calibrated score."""


def fit_mlp(
    names: tuple[str, ...],
    features: Float,
    target: Float,
    weight: Float,
    *,
    hidden: tuple[int, ...] = (32, 32),
    epochs: int = 12,
    dropout: float = 0.0,
    rate: float = 5e-3,
    decay: float = 1e-4,
    seed: int = 0,
) -> Mlp:
    """Weighted binary cross-entropy on targets in [0, 1]; the output is a logit.

    Args:
        features: (N, D). target, weight: (N,).
        rate: the highest learning rate. decay: of the weights.
    """
    torch.manual_seed(seed)
    mean, scale, x = _standardised(features)
    y, w = torch.from_numpy(target.astype(np.float32)), torch.from_numpy(weight.astype(np.float32))
    net = nn.Sequential(*_layers(features.shape[1], hidden, dropout))
    generator = torch.Generator().manual_seed(seed)

    def losses() -> Iterator[Tensor]:
        order = torch.randperm(len(x), generator=generator)
        for begin in range(0, len(x), _EDGE_BATCH):
            pick = order[begin : begin + _EDGE_BATCH]
            yield binary_cross_entropy_with_logits(net(x[pick])[:, 0], y[pick], w[pick])

    _optimise(net, losses, epochs, len(x) // _EDGE_BATCH + 1, rate, decay)
    return _plain(names, mean, scale, net)


def fit_ranker(
    names: tuple[str, ...],
    features: Float,
    value: Float,
    group: Int,
    weight: Float,
    *,
    hidden: tuple[int, ...] = (64, 32),
    epochs: int = 20,
    dropout: float = 0.2,
    seed: int = 0,
) -> Mlp:
    """A network whose softmax over a group expects the largest value.

    Args:
        features: (N, D). value: (N,) in [0, 1]. group: (N,) ascending ids.
        weight: (G,) of each group, by its id.
    """
    torch.manual_seed(seed)
    mean, scale, x = _standardised(features)
    y = torch.from_numpy(value.astype(np.float32))
    start = np.nonzero(np.r_[True, np.diff(group) != 0])[0]
    size = np.diff(np.r_[start, len(group)])
    share = torch.from_numpy(weight[group[start]].astype(np.float32))
    net = nn.Sequential(*_layers(features.shape[1], hidden, dropout))
    rng = np.random.default_rng(seed)

    def losses() -> Iterator[Tensor]:
        order = rng.permutation(len(start))
        for begin in range(0, len(order), _CLICK_BATCH):
            chosen = order[begin : begin + _CLICK_BATCH]
            rows = np.concatenate(
                [np.arange(int(start[c]), int(start[c] + size[c])) for c in chosen.tolist()]
            )
            number = torch.from_numpy(np.repeat(np.arange(len(chosen)), size[chosen]))
            heavy = share[torch.from_numpy(chosen)]
            yield _ranking_loss(net(x[rows])[:, 0], y[rows], number, heavy)

    _optimise(net, losses, epochs, len(start) // _CLICK_BATCH + 1, 3e-3, 0.05)
    return _plain(names, mean, scale, net)


def _ranking_loss(logit: Tensor, target: Tensor, number: Tensor, weight: Tensor) -> Tensor:
    """Expected loss of value under the softmax of each group, and calibration across groups.

    Args:
        logit, target: (N,). number: (N,) group of each. weight: (G,).
    """
    groups = len(weight)
    top = torch.full((groups,), -1e9).scatter_reduce(0, number, logit, "amax")
    power = torch.exp(logit - top.detach()[number])
    total = torch.zeros(groups).index_add(0, number, power)
    expected = torch.zeros(groups).index_add(0, number, power / total[number] * target)
    calibrated = binary_cross_entropy_with_logits(logit, target**2, weight[number])
    return (weight * (1 - expected)).mean() + _CALIBRATION * calibrated


def _standardised(features: Float) -> tuple[Float, Float, Tensor]:
    mean, scale = features.mean(0), np.maximum(features.std(0), 1e-6)
    x = np.clip((features - mean) / scale, -8, 8).astype(np.float32)
    return mean, scale, torch.from_numpy(x)


def _optimise(
    net: nn.Module, losses: Callable[[], Iterator[Tensor]], epochs: int, batches: int, rate: float,
    decay: float,
) -> None:  # fmt: skip
    """AdamW with a one-cycle schedule over the losses of each epoch's batches."""
    optimizer = torch.optim.AdamW(net.parameters(), lr=rate, weight_decay=decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, total_steps=epochs * batches)
    for _ in range(epochs):
        for loss in losses():
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()


@dataclass(frozen=True)
class Boosting:
    """Settings of trees that rank the proposals of a click (LambdaMART: Burges, *From RankNet to
    LambdaRank to LambdaMART*, 2010).

    Attributes:
        trees: that are summed. leaves: of each. least: proposals in a leaf.
        forests: that are averaged.
        scale: of the scores, against the solver's penalties.
        rate: learning rate. ridge: penalty on the leaves' values.
        features, hypotheses: shares of features and proposals that each tree learns from.
        grades: steps of the IoU; ``grade_doubles`` of them double the gain.
        among: how many of the best ones are ranked exactly.
    """

    trees: int = 400
    leaves: int = 15
    least: int = 200
    forests: int = 3
    scale: float = 1.0
    rate: float = 0.05
    ridge: float = 5.0
    features: float = 0.5
    hypotheses: float = 0.7
    grades: int = 32
    grade_doubles: float = 2.5
    among: int = 10


def fit_trees(
    names: tuple[str, ...],
    features: Float,
    value: Float,
    group: Int,
    weight: Float,
    config: Boosting,
) -> Trees:
    """Trees whose highest score of a group is that of the largest value.

    Args:
        features: (N, D). value: (N,) in [0, 1]. group: (N,) ascending ids.
        weight: (G,) of each group, by its id.
    """
    import lightgbm  # pyright: ignore[reportMissingImports]

    last = config.grades - 1
    settings = {
        "objective": "lambdarank",
        "label_gain": [2 ** (grade / config.grade_doubles) - 1 for grade in range(last + 1)],
        "lambdarank_truncation_level": config.among,
        "learning_rate": config.rate,
        "num_leaves": config.leaves,
        "min_data_in_leaf": config.least,
        "lambda_l2": config.ridge,
        "feature_fraction": config.features,
        "bagging_fraction": config.hypotheses,
        "bagging_freq": 1,
        "num_threads": 1,
        "deterministic": True,
        "force_row_wise": True,
        "verbosity": -1,
    }
    grade = np.clip((value * last).astype(np.int64), 0, last)
    _, count = np.unique(group, return_counts=True)
    grown: list[dict[str, Any]] = []
    for seed in range(config.forests):
        data = lightgbm.Dataset(features, grade, weight=weight[group], group=count)
        model = lightgbm.train({**settings, "seed": seed}, data, config.trees).dump_model()
        grown += model["tree_info"]
    return plain_trees(names, grown, config.scale / config.forests)


def plain_trees(names: tuple[str, ...], grown: list[dict[str, Any]], scale: float = 1.0) -> Trees:
    """The ``tree_info`` of LightGBM's ``dump_model`` as arrays, the leaves times ``scale``."""
    feature: list[int] = []
    threshold: list[np.float32] = []
    child: list[int] = []
    value: list[float] = []

    def new_leaf() -> int:
        feature.append(0)
        threshold.append(np.float32(np.inf))
        child.append(len(child))
        value.append(0.0)
        return child[-1]

    roots, depth = [], 0
    for tree in grown:
        roots.append(new_leaf())
        waiting = [(tree["tree_structure"], roots[-1], 0)]
        while waiting:
            node, at, level = waiting.pop()
            depth = max(depth, level)
            if "leaf_value" in node:
                value[at] = scale * node["leaf_value"]
                continue
            feature[at], threshold[at] = node["split_feature"], _at_most(node["threshold"])
            child[at] = new_leaf()
            waiting.append((node["left_child"], child[at], level + 1))
            waiting.append((node["right_child"], new_leaf(), level + 1))
    return Trees(
        names,
        np.array(feature, np.int32),
        np.array(threshold, np.float32),
        np.array(child, np.int32),
        np.array(value, np.float32),
        np.array(roots, np.int32),
        depth,
    )


def _at_most(threshold: float) -> np.float32:
    """The largest float32 up to ``threshold``: every float32 lies on the same side of both."""
    near = np.float32(threshold)
    return np.nextafter(near, np.float32(-np.inf)) if float(near) > threshold else near


def averaged(models: list[Mlp]) -> Mlp:
    """One network that answers with the mean of several of the same shape and inputs."""
    layers = []
    for parts in zip(*(m.layers for m in models), strict=True):
        weights, bias = [w for w, _ in parts], np.concatenate([b for _, b in parts])
        if not layers:
            joint = np.concatenate(weights)
        elif len(layers) < len(models[0].layers) - 1:
            joint = np.asarray(block_diag(*weights), np.float32)
        else:
            joint, bias = np.concatenate(weights, axis=1), bias.sum(keepdims=True)
            joint, bias = joint / np.float32(len(models)), bias / np.float32(len(models))
        layers.append((joint, bias))
    return Mlp(models[0].names, models[0].mean, models[0].scale, tuple(layers))


def _layers(width: int, hidden: tuple[int, ...], dropout: float = 0.0) -> list[Any]:
    sizes = (width, *hidden)
    layers: list[Any] = []
    for i in range(len(hidden)):
        layers += [nn.Linear(sizes[i], sizes[i + 1]), nn.ReLU()]
        layers += [nn.Dropout(dropout)] if dropout else []
    return [*layers, nn.Linear(sizes[-1], 1)]


def _plain(names: tuple[str, ...], mean: Float, scale: Float, net: Any) -> Mlp:
    linear = [m for m in net if hasattr(m, "weight")]
    return Mlp(
        names,
        mean.astype(np.float32),
        scale.astype(np.float32),
        tuple((m.weight.detach().numpy().copy(), m.bias.detach().numpy().copy()) for m in linear),
    )


def area_under_curve(score: Float, positive: Bool) -> float:
    """Probability that a random positive scores above a random negative."""
    rank = np.empty(len(score))
    rank[np.argsort(score, kind="stable")] = np.arange(1, len(score) + 1)
    n, m = int(positive.sum()), int((~positive).sum())
    return float((rank[positive].sum() - n * (n + 1) / 2) / max(n * m, 1))
