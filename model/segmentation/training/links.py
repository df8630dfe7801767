"""The link model: does a link between two cells cross a border, seen with what lies around it?"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.segmentation.cells import build_cells
from model.segmentation.edge_strength import edge_strength, edge_weight, shipped_edge_model
from model.segmentation.features import edge_features
from model.segmentation.graph import build_graph
from model.segmentation.link_strength import (
    CELL_FEATURES,
    GATE,
    LIMIT,
    LINK_FEATURES,
    PATCHES,
    LinkInputs,
    LinkModel,
    link_inputs,
    save_link_model,
)
from model.segmentation.nodes import nodes_of_asset
from model.segmentation.training.clicks import Round, random_asset
from model.segmentation.training.fit import area_under_curve

Float = npt.NDArray[np.floating]

_KINDS: tuple[Round, ...] = ("all", "small", "drawers", "all", "drawers")
_BORDERS_COUNT = 3.0
"""How many times borders count: they are rare, and what is wanted is where they are."""


@dataclass(frozen=True)
class LinkTraining:
    """What is needed to train the shipped link model again.

    Attributes:
        objects: of all families, and more of those with small parts and drawers.
        held_out: every n-th object only measures.
        mesh_share: of the objects that are met as meshes, the others as clouds.
        width: of the hidden layers. pooled: of what patches hold.
        rounds: of messages. patch_rounds: those that look at patches as well.
        epochs: how often each object is seen.
        rate: of learning, at its highest.
        first_seed: of the objects.
        workers: processes that make the objects.
        threads: that torch fits with.
    """

    objects: int = 700
    held_out: int = 15
    mesh_share: float = 0.25
    width: int = 32
    pooled: int = 16
    rounds: int = 4
    patch_rounds: tuple[int, ...] = (1, 2)
    epochs: int = 4
    rate: float = 3e-3
    first_seed: int = 200_000
    workers: int = 1
    threads: int = 2


@dataclass(frozen=True, eq=False)
class LinkExample:
    """An object's links.

    Attributes:
        seen: by the network; its features of links as float16, to save memory.
        border: (M,) whether the two cells are mostly of different parts.
        weight: (M,) node edges in each, 0 next to strays.
    """

    seen: LinkInputs
    border: npt.NDArray[np.bool_]
    weight: npt.NDArray[np.float32]


def link_example(index: int, config: LinkTraining) -> LinkExample:
    """The ``index``-th object."""
    seed = config.first_seed + index
    rng = np.random.default_rng([seed, 3])
    kind = _KINDS[index // 2 % len(_KINDS)]
    asset, labels = random_asset(seed, kind, config.mesh_share, rng)
    nodes = nodes_of_asset(asset)
    graph = build_graph(nodes)
    features = edge_features(nodes, graph)
    strength = edge_strength(nodes, graph, shipped_edge_model(), features)
    cells = build_cells(nodes, graph, strength, edge_weight(strength, graph))
    seen = link_inputs(nodes, graph, features, strength, cells)
    label = _majority(cells.of_node, labels[nodes.elements.element_of_node], len(cells))
    a, b = label[seen.a], label[seen.b]
    weight = cells.links.count * (a >= 0) * (b >= 0)
    packed = LinkInputs(seen.a, seen.b, seen.cell, seen.link.astype(np.float16), seen.along,
                        tuple(p.astype(np.int32) for p in seen.patches))  # fmt: skip
    return LinkExample(packed, a != b, weight.astype(np.float32))


def _majority(
    of_node: npt.NDArray[np.integer], labels: npt.NDArray[np.integer], number: int
) -> npt.NDArray[np.int64]:
    """(C,) the part that most nodes of each cell have, -1 where all are strays."""
    known = labels >= 0
    width = int(labels.max()) + 1
    key = of_node[known].astype(np.int64) * width + labels[known]
    votes = np.bincount(key, minlength=number * width).reshape(number, width)
    return np.where(votes.any(1), votes.argmax(1), -1)


def collect_links(config: LinkTraining) -> list[LinkExample]:
    """All objects that show a border."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    n = config.objects
    if config.workers <= 1:
        made = [link_example(i, config) for i in range(n)]
    else:
        with ProcessPoolExecutor(config.workers, mp_context=get_context("spawn")) as pool:
            made = list(pool.map(link_example, range(n), [config] * n, chunksize=4))
    return [m for m in made if (m.border & (m.weight > 0)).sum() >= 5]


def network(config: LinkTraining) -> Any:
    """The layers of :class:`~model.segmentation.link_strength.LinkModel` in torch, by name."""
    from torch import nn  # pyright: ignore[reportMissingImports]

    d, p = config.width, config.pooled
    layers = {
        "cell": nn.Linear(len(CELL_FEATURES), d),
        "link": nn.Linear(len(LINK_FEATURES), d),
        "link_2": nn.Linear(d, d),
        "out_1": nn.Linear(3 * d, d),
        "out_2": nn.Linear(d, 1),
    }
    for r in range(config.rounds):
        patches = r in config.patch_rounds
        layers |= {f"from_{r}": nn.Linear(d, d), f"to_{r}": nn.Linear(d, d)}
        layers |= {f"over_{r}": nn.Linear(d, d), f"along_{r}": nn.Linear(2, d)}
        layers |= {f"gate_{r}": nn.Linear(d, 1)}
        layers |= {f"update_{r}": nn.Linear(3 * d + patches * len(PATCHES) * p, d)}
        if patches:
            layers |= {f"patch_{r}": nn.Linear(d, p), f"link_update_{r}": nn.Linear(2 * d, d)}
    return nn.ModuleDict(layers)


def logits(net: Any, x: LinkInputs, mean: dict[str, Float], scale: dict[str, Float]) -> Any:
    """(M,) as :class:`~model.segmentation.link_strength.LinkModel` answers, to be learned from."""
    import torch  # pyright: ignore[reportMissingImports]

    def scaled(name: str, values: Float) -> Any:
        out = np.clip((values - mean[name]) / scale[name], -LIMIT, LIMIT)
        return torch.from_numpy(out.astype(np.float32))

    relu, number = torch.relu, len(x.cell)
    a, b = (torch.from_numpy(v.astype(np.int64)) for v in (x.a, x.b))
    patches = [torch.from_numpy(p.astype(np.int64)) for p in x.patches]
    forth_way = torch.from_numpy(x.along)
    back_way = -forth_way.flip(1)

    def into(at_b: Any, at_a: Any) -> Any:
        out = torch.zeros(number, at_b.shape[1])
        return out.index_add(0, b, at_b).index_add(0, a, at_a)

    def pooled(values: Any, patch: Any) -> Any:
        held = torch.zeros(int(patch.max()) + 1, values.shape[1]).index_add(0, patch, values)
        return (held / torch.bincount(patch)[:, None])[patch]

    one = torch.ones(len(x.a), 1)
    degree = into(one, one).clamp(min=1)
    h = relu(net["cell"](scaled("cell", x.cell)))
    e = relu(net["link_2"](relu(net["link"](scaled("link", x.link)))))
    for r in range(sum(name.startswith("from_") for name in net)):
        sent, got, over = net[f"from_{r}"](h), net[f"to_{r}"](h), net[f"over_{r}"](e)
        gate = torch.sigmoid(net[f"gate_{r}"](e))
        forth = relu(sent[a] + got[b] + over + net[f"along_{r}"](forth_way))
        back = relu(sent[b] + got[a] + over + net[f"along_{r}"](back_way))
        told = [h, into(forth, back) / degree,
                into(forth * gate, back * gate) / (into(gate, gate) + GATE)]  # fmt: skip
        if f"patch_{r}" in net:
            seen = relu(net[f"patch_{r}"](h))
            told += [pooled(seen, patch) for patch in patches]
            e = e + relu(net[f"link_update_{r}"](torch.cat([e, forth + back], 1)))
        h = h + relu(net[f"update_{r}"](torch.cat(told, 1)))
    ends = torch.cat([h[a] + h[b], (h[a] - h[b]).abs(), e], 1)
    return net["out_2"](relu(net["out_1"](ends)))[:, 0]


def plain(net: Any, mean: dict[str, Float], scale: dict[str, Float]) -> LinkModel:
    """``net`` as numpy arrays."""
    layers = {
        name: (layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy())
        for name, layer in net.items()
    }
    return LinkModel(
        {k: v.astype(np.float32) for k, v in mean.items()},
        {k: v.astype(np.float32) for k, v in scale.items()},
        layers,
    )


def fit_links(examples: list[LinkExample], config: LinkTraining) -> LinkModel:
    """Weighted binary cross-entropy, an object at a time."""
    import torch  # pyright: ignore[reportMissingImports]

    torch.manual_seed(0)
    torch.set_num_threads(config.threads)
    rng = np.random.default_rng(0)
    some = examples[:: max(len(examples) // 40, 1)]
    mean, scale = {}, {}
    for name in ("cell", "link"):
        values = np.concatenate([getattr(s.seen, name).astype(np.float32) for s in some])
        mean[name], scale[name] = values.mean(0), values.std(0) + 1e-3
    net = network(config)
    optimizer = torch.optim.AdamW(net.parameters(), lr=config.rate, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, config.rate, total_steps=config.epochs * len(examples), pct_start=0.05
    )
    for epoch in range(config.epochs):
        losses = []
        for index in rng.permutation(len(examples)).tolist():
            one = examples[index]
            share = one.weight * np.where(one.border, _BORDERS_COUNT, 1.0)
            loss = torch.nn.functional.binary_cross_entropy_with_logits(
                logits(net, one.seen, mean, scale),
                torch.from_numpy(one.border.astype(np.float32)),
                torch.from_numpy((share / share.sum()).astype(np.float32)),
                reduction="sum",
            )
            optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
            optimizer.step()
            schedule.step()
            losses.append(loss.item())
        print(f"epoch {epoch}: loss {np.mean(losses):.4f}", flush=True)
    return plain(net, mean, scale)


def train_links(config: LinkTraining, out: Path) -> dict[str, float]:
    """Train, measure on held-out objects, write ``out``; returns the scores."""
    examples = collect_links(config)
    test = examples[:: config.held_out]
    model = fit_links([e for i, e in enumerate(examples) if i % config.held_out], config)
    column = LINK_FEATURES.index("strength")
    scores = {
        "auc": float(np.mean([_auc(model(_full(e.seen)), e) for e in test])),
        "auc_edge_model": float(np.mean([_auc(e.seen.link[:, column], e) for e in test])),
        "objects": float(len(examples) - len(test)),
    }
    save_link_model(model, out, {"training": asdict(config), "scores": scores})
    return scores


def _full(x: LinkInputs) -> LinkInputs:
    return LinkInputs(x.a, x.b, x.cell, x.link.astype(np.float32), x.along, x.patches)


def _auc(score: Float, example: LinkExample) -> float:
    known = example.weight > 0
    return area_under_curve(score[known].astype(np.float64), example.border[known])
