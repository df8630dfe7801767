"""The trees of first clicks on meshes: they learn from clicks on made objects of all kinds."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from model.segmentation.scorers import MESH_TREES
from model.segmentation.training.clicks import ClickTraining, fit_trees_to
from model.segmentation.training.clouds import PLAIN_FEATURE_NAMES, Played, play_rounds
from model.segmentation.training.fit import Boosting
from model.segmentation.training.moving import fitted


@dataclass(frozen=True)
class MeshTraining:
    """What is needed to train ``first_click_mesh.npz`` again.

    Attributes:
        rounds: the objects that are clicked.
        clicks: how they are clicked.
        held_out: every n-th object measures in a fit of its own.
        trees: how they are grown.
    """

    rounds: tuple[Played, ...] = (
        ("all", 60_000, 60_300),
        ("drawers", 90_000, 90_200),
        ("small", 70_000, 70_150),
    )
    clicks: ClickTraining = field(
        default_factory=lambda: ClickTraining(first_clicks=2, mesh_share=1.0, workers=2)
    )
    held_out: int = 6
    trees: Boosting = field(default_factory=lambda: Boosting(leaves=7))


def train_meshes(config: MeshTraining, folder: Path) -> dict[str, float]:
    """Play, fit, measure and write the trees into ``folder``; see :func:`.moving.fitted`."""
    first, _ = play_rounds(config, "mesh")
    fit = partial(fit_trees_to, config=config.trees, names=PLAIN_FEATURE_NAMES)
    return fitted(first, config, "first", folder / MESH_TREES, fit)
