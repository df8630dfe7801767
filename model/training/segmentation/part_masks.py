"""Train the scorer of *All parts*: which masks with votes are parts that move.

Superpoints all over a procedural object, on the base as well, vote for the masks that a click on
them may mean; each mask is worth its overlap with the moving part that it fits best.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from model.segmentation.arrays import Float, Uint8
from model.segmentation.finish.alternatives import overlaps
from model.segmentation.models.mlp import Mlp, save_mlp
from model.segmentation.score.scorers import shipped_moving_scorers, shipped_scorers
from model.segmentation.solvers import solver_of
from model.segmentation.tools.all_parts import WORTH, spread
from model.segmentation.tools.mask_votes import (
    PART_FEATURE_NAMES,
    PART_SCORER,
    exclusive_parts,
    vote_for_masks,
)
from model.training.segmentation import rows
from model.training.segmentation.fit import averaged, fit_mlp
from model.training.segmentation.rows import Seeds, collected, split_by_object
from model.training.segmentation.visible_objects import MovingPartTraining, visible_object

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
    return averaged(
        [
            fit_mlp(PART_FEATURE_NAMES, features, worth, weight / weight.mean(), hidden=(64, 32),
                    epochs=30, dropout=0.2, rate=3e-3, decay=0.05, seed=seed)
            for seed in range(config.networks)
        ]
    )  # fmt: skip


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
