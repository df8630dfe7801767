"""Train the small networks beside the scorers of clicks: for edges and *All parts*.

They learn whether an edge of the node graph crosses a border between parts, and which masks with
votes are parts that move. For these superpoints all over a procedural object, on the base as well,
vote for the masks that a click on them may mean; each mask is worth its overlap with the moving
part that it fits best.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from model.core.asset import Asset
from model.data.simulated.scans import random_scan
from model.segmentation.all_parts import (
    PART_FEATURE_NAMES,
    PART_SCORER,
    WORTH,
    exclusive_parts,
    spread,
    vote_for_masks,
)
from model.segmentation.arrays import Float, Uint8
from model.segmentation.graph import (
    FEATURE_NAMES,
    build_graph,
    edge_features,
    hand_set_strength,
)
from model.segmentation.models import Mlp, save_mlp
from model.segmentation.nodes import nodes_of_asset
from model.segmentation.scores import shipped_moving_scorers, shipped_scorers
from model.segmentation.solver import overlaps, solver_of
from model.training.segmentation import rows
from model.training.segmentation.rows import (
    Seeds,
    area_under_curve,
    averaged,
    collected,
    fit_mlp,
    split_by_object,
)
from model.training.segmentation.visible_objects import MovingPartTraining, visible_object


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


_FOUND = 0.5
"""IoU above which a part counts as found."""


@dataclass(frozen=True)
class PartMaskTraining:
    """Settings that trained ``part_masks.npz``.

    Attributes:
        seeds: of the objects, as ranges.
        objects: how they are made and scanned.
        spread, asked: superpoints spread over each, and how many of these vote.
        power: of the overlap that is learned, so that exact masks come before rough ones.
        held_out: every n-th object measures in a fit of its own.
        networks: that are fitted and averaged.
        workers: processes.
    """

    seeds: tuple[Seeds, ...] = ((203_000, 203_720, 1), (281_000, 281_180, 1))
    objects: MovingPartTraining = field(default_factory=MovingPartTraining)
    spread: int = 160
    asked: int = 36
    power: float = 1.5
    held_out: int = 6
    networks: int = 3
    workers: int = 2


@dataclass(frozen=True, eq=False)
class MaskRows:
    """The masks with votes of one object.

    Attributes:
        masks: (M, C) packed to bits along the superpoints. features: (M, F).
        overlap: (M, P) IoU with each part that moves.
        size: (C,) nodes of each superpoint.
    """

    masks: Uint8
    features: Float
    overlap: Float
    size: Float

    @property
    def share(self) -> Float:
        """(M,) IoU of each mask with the part that it fits best; see :func:`.collected`."""
        return self.overlap.max(1, initial=0.0)


def play_masks(seed: int, config: PartMaskTraining) -> MaskRows:
    """The masks that superpoints of one procedural object vote for."""
    rng = np.random.default_rng([seed, 21])
    visible = visible_object(seed, config.objects, rng)
    encoding = visible.encoding
    solver = solver_of(encoding, *shipped_scorers(), shipped_moving_scorers(), with_fronts=True)
    if encoding.room is not None:  # taken for a room
        none = np.zeros((0, len(PART_FEATURE_NAMES)), np.float32)
        return MaskRows(np.zeros((0, 0), np.uint8), none, none[:, :0], none[0:0, 0])
    superpoints = spread(encoding.superpoints.center, config.spread)
    voters = rng.choice(superpoints, min(config.asked, len(superpoints)), replace=False)
    voted = vote_for_masks(solver, np.sort(voters))
    parts = np.unique(visible.labels[visible.labels >= 0])
    moving = [visible.labels == part for part in parts[parts != visible.base].tolist()]
    overlap = np.zeros((len(voted.masks), len(moving)), np.float32)
    for k, truth in enumerate(moving):
        overlap[:, k] = rows.overlaps(encoding, voted.masks, truth)
    packed = np.packbits(voted.masks, axis=1)
    return MaskRows(packed, voted.features, overlap, encoding.superpoints.size.astype(np.float32))


def _fit(played: list[MaskRows], config: PartMaskTraining) -> Mlp:
    features = np.concatenate([r.features for r in played])
    worth = np.concatenate([r.share for r in played]) ** config.power
    # All objects weigh the same, however many masks they have.
    weight = np.concatenate([np.full(len(r.features), 1 / len(r.features)) for r in played])
    fit = partial(fit_mlp, PART_FEATURE_NAMES, features, worth, weight / weight.mean())
    fit = partial(fit, hidden=(64, 32), epochs=30, dropout=0.2, rate=3e-3, decay=0.05)
    return averaged([fit(seed=seed) for seed in range(config.networks)])


def _measured(scorer: Mlp, played: list[MaskRows]) -> dict[str, float]:
    """Share of the proposed masks that are parts, share of the moving parts that are found, and
    proposed masks per object.
    """
    proposed = right = there = found = 0
    for one in played:
        worth = scorer(one.features)
        may = np.nonzero(worth >= WORTH)[0]
        masks = np.unpackbits(one.masks[may], axis=1, count=len(one.size)).astype(bool)
        chosen = may[exclusive_parts(worth[may], overlaps(masks, one.size)[0], WORTH)]
        hit = one.overlap[chosen] > _FOUND
        proposed, right = proposed + len(chosen), right + int(hit.any(1).sum())
        there, found = there + hit.shape[1], found + int(hit.any(0).sum())
    return {
        "parts_right": right / max(proposed, 1),
        "parts_found": found / max(there, 1),
        "parts_proposed": proposed / len(played),
    }


def train_part_masks(config: PartMaskTraining, folder: Path) -> dict[str, float]:
    """Play, fit, measure and write the scorer into ``folder``; returns the scores of a fit without
    every n-th object.
    """
    played = collected(play_masks, config, config.seeds, config.workers)
    rest, test = split_by_object(played, config.held_out)
    scores = {**_measured(_fit(rest, config), test), "parts_objects": float(len(played))}
    notes: dict[str, object] = {"training": asdict(config), "scores": scores}
    save_mlp(_fit(played, config), folder / PART_SCORER, notes)
    return scores
