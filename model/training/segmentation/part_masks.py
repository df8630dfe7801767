"""The scorer of *All parts*: which masks that superpoints speak of are parts that move?

Superpoints spread over a made object say what a click on them may mean, wherever they lie, on the base as
well; each mask of theirs is worth its overlap with the moving part that it fits best.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.segmentation.finish.alternatives import overlaps
from model.segmentation.propose.boxes import ObjectSolver
from model.segmentation.score.mlp import Mlp, save_mlp
from model.segmentation.score.scorers import shipped_moving_scorers, shipped_scorers, solver_of
from model.segmentation.tools.all_parts import WORTH, spread
from model.segmentation.tools.mask_votes import (
    PART_FEATURE_NAMES,
    PART_SCORER,
    parts_apart,
    spoken_of,
)
from model.training.segmentation import clicks
from model.training.segmentation.first_clicks import MovingTraining, Seeds, collected, seen_object
from model.training.segmentation.fit import averaged, fit_mlp

Bool = npt.NDArray[np.bool_]
Float = npt.NDArray[np.floating]

_FOUND = 0.5
"""IoU above which a part counts as found."""


@dataclass(frozen=True)
class PartMaskTraining:
    """What is needed to train ``part_masks.npz`` again.

    Attributes:
        seeds: of the objects, as ranges.
        objects: how they are made and met.
        spread, asked: superpoints spread over each, and how many of these are asked.
        power: of the overlap that is learned, so that exact masks come before rough ones.
        held_out: every n-th object measures in a fit of its own.
        networks: that are fitted and averaged.
        workers: processes.
    """

    seeds: tuple[Seeds, ...] = ((203_000, 203_720, 1), (281_000, 281_180, 1))
    objects: MovingTraining = field(default_factory=MovingTraining)
    spread: int = 160
    asked: int = 36
    power: float = 1.5
    held_out: int = 6
    networks: int = 3
    workers: int = 2


@dataclass(frozen=True, eq=False)
class MaskRows:
    """The masks that are spoken of on one object.

    Attributes:
        masks: (M, C) packed to bits along the superpoints. features: (M, F).
        overlap: (M, P) IoU with each part that moves.
        size: (C,) nodes of each superpoint.
    """

    masks: npt.NDArray[np.uint8]
    features: Float
    overlap: Float
    size: Float

    @property
    def share(self) -> Float:
        """(M,) IoU of each mask with the part that it fits best; see :func:`.collected`."""
        return self.overlap.max(1, initial=0.0)


def play_masks(seed: int, config: PartMaskTraining) -> MaskRows:
    """What the superpoints of one made object speak of."""
    rng = np.random.default_rng([seed, 21])
    seen = seen_object(seed, config.objects, rng)
    encoding = seen.encoding
    solver = solver_of(encoding, *shipped_scorers(), shipped_moving_scorers(), lined=True)
    if not isinstance(solver, ObjectSolver):  # taken for a room
        none = np.zeros((0, len(PART_FEATURE_NAMES)), np.float32)
        return MaskRows(np.zeros((0, 0), np.uint8), none, none[:, :0], none[0:0, 0])
    superpoints = spread(encoding.superpoints.center, config.spread)
    asked = np.sort(rng.choice(superpoints, min(config.asked, len(superpoints)), replace=False))
    spoken = spoken_of(solver, asked)
    parts = np.unique(seen.labels[seen.labels >= 0])
    moving = [seen.labels == part for part in parts[parts != seen.base].tolist()]
    overlap = np.zeros((len(spoken.masks), len(moving)), np.float32)
    for k, truth in enumerate(moving):
        overlap[:, k] = clicks.overlaps(encoding, spoken.masks, truth)
    packed = np.packbits(spoken.masks, axis=1)
    return MaskRows(packed, spoken.features, overlap, encoding.superpoints.size.astype(np.float32))


def _fit(rows: list[MaskRows], config: PartMaskTraining) -> Mlp:
    features = np.concatenate([r.features for r in rows])
    worth = np.concatenate([r.share for r in rows]) ** config.power
    # Every object says as much, however many masks it has.
    weight = np.concatenate([np.full(len(r.features), 1 / len(r.features)) for r in rows])
    return averaged(
        [
            fit_mlp(PART_FEATURE_NAMES, features, worth, weight / weight.mean(), hidden=(64, 32),
                    epochs=30, dropout=0.2, rate=3e-3, decay=0.05, seed=seed)
            for seed in range(config.networks)
        ]
    )  # fmt: skip


def _measured(scorer: Mlp, rows: list[MaskRows]) -> dict[str, float]:
    """Of what would be proposed, the share that are parts, and of the parts that move the share
    that are found.
    """
    proposed = right = there = found = 0
    for one in rows:
        worth = scorer(one.features)
        may = np.nonzero(worth >= WORTH)[0]
        masks = np.unpackbits(one.masks[may], axis=1, count=len(one.size)).astype(bool)
        chosen = may[parts_apart(worth[may], overlaps(masks, one.size)[0], WORTH)]
        hit = one.overlap[chosen] > _FOUND
        proposed, right = proposed + len(chosen), right + int(hit.any(1).sum())
        there, found = there + hit.shape[1], found + int(hit.any(0).sum())
    return {
        "parts_right": right / max(proposed, 1),
        "parts_found": found / max(there, 1),
        "parts_proposed": proposed / len(rows),
    }


def train_part_masks(config: PartMaskTraining, folder: Path) -> dict[str, float]:
    """Play, fit, measure and write the scorer into ``folder``; returns the scores of a fit without
    every n-th object.
    """
    rows = collected(play_masks, config, config.seeds, config.workers)
    rest = [r for i, r in enumerate(rows) if i % config.held_out]
    scores = {**_measured(_fit(rest, config), rows[:: config.held_out]),
              "parts_objects": float(len(rows))}  # fmt: skip
    save_mlp(_fit(rows, config), folder / PART_SCORER,
             {"training": asdict(config), "scores": scores})  # fmt: skip
    return scores
