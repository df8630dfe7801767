"""Train the network that ranks boxes between planes by their overlap with the clicked part."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from model.core.asset import Asset
from model.data.simulated.scans import SQUARE, build, random_scan
from model.evaluation.pool import in_order
from model.segmentation.arrays import Float
from model.segmentation.encode.edge_strength import shipped_edge_model
from model.segmentation.encode.encoding import encode_superpoints
from model.segmentation.models.mlp import Mlp, save_mlp
from model.segmentation.propose.box_grid import BoxGrid
from model.segmentation.propose.box_ranking import BOX_SCORE_FEATURES, BoxDescriber
from model.segmentation.simulated_clicks import central, deepest
from model.training.segmentation.fit import averaged, fit_ranker
from model.training.segmentation.rows import asked_by_size


@dataclass(frozen=True)
class BoxTraining:
    """Settings that trained ``boxes.npz``.

    Attributes:
        objects: half of them of all families, half of those whose parts fill boxes.
        held_out: every n-th measures in a fit of its own.
        parts: asked for in each object, spread over the logarithm of their sizes.
        boxes: of each click that are learned from: the best ones, the least leaking ones, others.
        mesh_share: share of the objects that are meshes.
        networks: that are fitted and averaged; each makes clicks slower.
        first_seed: of the objects.
        workers: processes.
    """

    objects: int = 600
    held_out: int = 10
    parts: int = 6
    boxes: tuple[int, int, int] = (12, 12, 40)
    mesh_share: float = 0.2
    networks: int = 1
    first_seed: int = 100_000
    workers: int = 1


Row = tuple[Float, Float, Float]
"""Features (K, F) and IoU (K,) of the boxes of a click, and the best IoU of all that hold it."""


def rows_of(seed: int, config: BoxTraining) -> list[Row]:
    """Boxes around some clicks on each part of one object."""
    rng = np.random.default_rng([seed, 5])
    families = SQUARE if seed % 2 else None
    if rng.random() < config.mesh_share:
        shape = build(seed, families)
        truth, asset = shape.part, Asset("object", mesh=shape.mesh)
    else:
        data = random_scan(seed, (40_000, 100_000)[seed // 2 % 2], families)
        truth, asset = data.labels, Asset("object", cloud=data.cloud)
    nodes, _, _, superpoints = encode_superpoints(asset, shipped_edge_model())
    labels, points = truth[nodes.elements.element_of_node], nodes.points
    grid = BoxGrid(superpoints)
    boxes = grid.between_planes(superpoints)
    describe = BoxDescriber(boxes, grid.step)
    held = boxes.sums(grid.place, superpoints.size)
    out: list[Row] = []
    for part in asked_by_size(rng, labels, config.parts, 30):
        mine = labels == part
        own = np.bincount(superpoints.of_node, mine, len(superpoints))
        common = boxes.sums(grid.place, own)
        overlap = common / np.maximum(held + own.sum() - common, 1e-9)
        starts = [deepest(points, mine), central(points, mine, rng), central(points, mine, rng, 1)]
        for start in starts:
            superpoint = int(superpoints.of_node[start])
            spot = grid.place[:, superpoint]
            found = boxes.holding(spot)
            if len(found) < 4 or overlap[found].max() < 0.3:
                continue
            best, tight, more = config.boxes
            value = overlap[found]
            pick = np.unique(np.r_[np.argsort(-value)[:best], np.arange(min(tight, len(found))),
                                   rng.permutation(len(found))[:more]])  # fmt: skip
            chosen = found[pick]
            features = describe(chosen, spot, grid.facing[:, superpoint])
            out.append((features, overlap[chosen].astype(np.float32), value.max()))
    return out


def collect(config: BoxTraining) -> list[list[Row]]:
    """Rows of each object; they don't depend on ``workers``."""
    seeds = range(config.first_seed, config.first_seed + config.objects)
    return in_order(partial(rows_of, config=config), seeds, config.workers)


def fit_boxes(rows: list[Row], networks: int) -> Mlp:
    """The mean of ``networks`` networks that rank the boxes of a click by IoU."""
    features, overlap = (np.concatenate([r[k] for r in rows]) for k in (0, 1))
    click = np.repeat(np.arange(len(rows)), [len(r[1]) for r in rows])
    weight = np.ones(len(rows), np.float32)
    return averaged(
        [
            fit_ranker(BOX_SCORE_FEATURES, features, overlap, click, weight,
                       hidden=(64, 32), epochs=30, seed=seed)
            for seed in range(networks)
        ]
    )  # fmt: skip


def train_boxes(config: BoxTraining, out: Path) -> dict[str, float]:
    """Train, measure on held-out objects, write ``out``; returns the scores."""
    played = collect(config)
    test = [r for i, rows in enumerate(played) if not i % config.held_out for r in rows]
    rest = [r for i, rows in enumerate(played) if i % config.held_out for r in rows]
    model = fit_boxes(rest, config.networks)
    chosen = [float(overlap[model(features).argmax()]) for features, overlap, _ in test]
    tightest = [float(overlap[0]) for _, overlap, _ in test]
    scores = {
        "iou": float(np.mean(chosen)),
        "least_leaking_iou": float(np.mean(tightest)),
        "best_possible": float(np.mean([r[2] for r in test])),
        "clicks": float(len(rest) + len(test)),
    }
    save_mlp(fit_boxes(rest + test, config.networks), out,
             {"training": asdict(config), "scores": scores})  # fmt: skip
    return scores
