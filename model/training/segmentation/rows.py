"""Training rows of scorers, and fits to rows of small perceptrons and trees.

Rows are features of the proposals of many clicks, with their true IoU. Perceptrons are fitted with
torch, trees with LightGBM, and converted to plain numpy.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
import torch
from scipy.linalg import block_diag
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits

from model.core.pool import in_order
from model.segmentation.arrays import Bool, Float, Int, Int64
from model.segmentation.encoding import Encoding
from model.segmentation.models import Mlp, Scorer, Trees, save_scorer
from model.segmentation.object_features import OBJECT_FEATURE_NAMES
from model.segmentation.solver import ScoredProposals

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
    net: nn.Module,
    losses: Callable[[], Iterator[Tensor]],
    epochs: int,
    batches: int,
    rate: float,
    decay: float,
) -> None:
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


Seeds = tuple[int, int, int]
"""First one, end, step."""

_LEAST_SPREAD = 0.01
"""Least difference in IoU between a click's proposals for the click to teach anything."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Proposals of many clicks.

    Attributes:
        features: (N, F). overlap: (N,) true IoU.
        click: (N,) which click each belongs to, ascending.
        share: (clicks,) of the object's surface that each click's true part has.
    """

    features: Float
    overlap: Float
    click: Int64
    share: Float


def joined_rows(parts: list[Rows]) -> Rows:
    """All rows, in order."""
    begin = np.cumsum([0, *(len(r.share) for r in parts)])
    return Rows(
        np.concatenate([r.features for r in parts]),
        np.concatenate([r.overlap for r in parts]),
        np.concatenate([r.click + n for r, n in zip(parts, begin[:-1], strict=True)]),
        np.concatenate([r.share for r in parts]),
    )


def overlaps(encoding: Encoding, masks: Bool, truth: Bool) -> Float:
    """(H,) IoU of masks (H, C) with the true nodes (N,)."""
    superpoints = encoding.superpoints
    own = np.bincount(superpoints.of_node, truth, len(superpoints))
    weight = masks.astype(np.float32)
    common = weight @ own.astype(np.float32)
    size = weight @ superpoints.size.astype(np.float32)
    return common / np.maximum(size + own.sum() - common, 1)


class Log:
    """Collects the rows of clicks."""

    def __init__(self, names: tuple[str, ...]) -> None:
        """``names`` of the features."""
        self._names = names
        self._rows: list[tuple[Float, Float, float]] = []

    def add(self, found: ScoredProposals, encoding: Encoding, truth: Bool) -> None:
        """Add the proposals of a click on the part of the nodes ``truth`` (N,)."""
        overlap = overlaps(encoding, found.proposals.masks, truth)
        self._rows.append((found.features, overlap.astype(np.float32), float(truth.mean())))

    def rows(self) -> Rows:
        """All rows so far."""
        none = np.zeros((0, len(self._names)), np.float32)
        counts = [len(o) for _, o, _ in self._rows]
        return Rows(
            np.concatenate([none, *(f for f, _, _ in self._rows)]),
            np.concatenate([none[:, 0], *(o for _, o, _ in self._rows)]),
            np.repeat(np.arange(len(counts)), counts),
            np.array([s for _, _, s in self._rows], np.float32),
        )


def asked_by_size(rng: np.random.Generator, labels: Int, most: int, least: int = 12) -> list[int]:
    """Parts spread evenly over the logarithm of their sizes, so that small ones are not rare."""
    ids, counts = np.unique(labels[labels >= 0], return_counts=True)
    ids, size = ids[counts >= least], np.log(counts[counts >= least])
    out: list[int] = []
    while len(ids) and len(out) < most:
        wanted = rng.uniform(size.min() - 0.1, size.max() + 0.1)
        nearest = int(np.abs(size - wanted).argmin())
        out.append(int(ids[nearest]))
        ids, size = np.delete(ids, nearest), np.delete(size, nearest)
    return out


class Played(Protocol):
    """The rows of one object."""

    @property
    def share(self) -> Float:
        """One number for each click or mask."""
        ...


C = TypeVar("C")
P = TypeVar("P", bound=Played)


def collected(
    play_one: Callable[[int, C], P], config: C, seeds: tuple[Seeds, ...], workers: int
) -> list[P]:
    """Rows of each object that has any; they don't depend on ``workers``."""
    numbers = [seed for one in seeds for seed in range(*one)]
    rows = in_order(partial(_played, play_one, config), numbers, workers)
    return [r for r in rows if len(r.share)]


def _played(play_one: Callable[[int, C], P], config: C, seed: int) -> P:
    return play_one(seed, config)


def split_by_object(rows: list[P], every: int) -> tuple[list[P], list[P]]:
    """The rows to learn from, and those of every n-th object to measure on."""
    return [r for i, r in enumerate(rows) if i % every], rows[::every]


def fit_scorer(rows: Rows, networks: int = 1, names: tuple[str, ...] = OBJECT_FEATURE_NAMES) -> Mlp:
    """The mean of ``networks`` networks that rank the proposals of a click by IoU."""
    data = _informative(rows)
    return averaged([fit_ranker(names, *data, seed=seed) for seed in range(networks)])


def fit_trees_to(rows: Rows, config: Boosting, names: tuple[str, ...]) -> Trees:
    """Trees that rank the proposals of a click by IoU.

    Args:
        names: of the first columns of the features; there may be more.
    """
    features, overlap, click, weight = _informative(rows)
    return fit_trees(names, features[:, : len(names)], overlap, click, weight, config)


def _informative(rows: Rows) -> tuple[Float, Float, Int64, Float]:
    """Features, IoU and click of the proposals, without clicks whose proposals are all alike, and
    the weights of all clicks.
    """
    begin = np.nonzero(np.r_[True, np.diff(rows.click) != 0])[0]
    spread = np.maximum.reduceat(rows.overlap, begin) - np.minimum.reduceat(rows.overlap, begin)
    keep = (spread > _LEAST_SPREAD)[rows.click]
    return rows.features[keep], rows.overlap[keep], rows.click[keep], _evened(rows.share)


def _evened(share: Float) -> Float:
    """(clicks,) weights by the root of the rareness of a size, on a logarithmic scale."""
    edges = np.linspace(np.log(1e-5), 0, 15)
    bin_of = np.clip(np.digitize(np.log(np.maximum(share, 1e-5)), edges) - 1, 0, 13)
    number = np.bincount(bin_of, minlength=14).astype(np.float64)
    weight = (number + 0.02 * number.sum())[bin_of] ** -0.5
    return (weight / weight.mean()).astype(np.float32)


def chosen_overlap(model: Scorer, rows: Rows) -> tuple[float, float]:
    """Mean IoU of the chosen proposals, and of the best ones."""
    score = model(rows.features)
    order = np.lexsort((-score, rows.click))
    head = order[np.r_[True, np.diff(rows.click[order]) != 0]]
    best = np.zeros(int(rows.click.max()) + 1)
    np.maximum.at(best, rows.click, rows.overlap)
    return float(rows.overlap[head].mean()), float(best[np.unique(rows.click)].mean())


def fit_and_save(
    rows: list[Rows], config: Any, kind: str, path: Path, fit: Callable[[Rows], Scorer]
) -> dict[str, float]:
    """Fit on all objects, and write the scorer of ``kind``.

    Args:
        config: a training's dataclass, with ``held_out``.

    Returns:
        Scores of a fit without every n-th object on those objects.
    """
    rest, test = split_by_object(rows, config.held_out)
    chosen, best = chosen_overlap(fit(joined_rows(rest)), joined_rows(test))
    scores = {
        f"{kind}_iou": chosen,
        f"{kind}_best_possible": best,
        f"{kind}_clicks": float(sum(len(r.share) for r in rows)),
    }
    save_scorer(fit(joined_rows(rows)), path, {"training": asdict(config), "scores": scores})
    return scores
