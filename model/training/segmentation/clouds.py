"""Train the scorers of clicks on clouds: trees, and for local refinements a network.

Sessions are played by the project's scorers. Later clicks also have ``HISTORY_FEATURES``. Meshes
keep the scorers that learned from both: their shells and faces say more.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from model.segmentation.describe.objects import HISTORY_FEATURES, OBJECT_FEATURE_NAMES
from model.segmentation.score.scorers import SCORERS, shipped_scorers
from model.training.segmentation.clicks import ClickTraining, Round, collect
from model.training.segmentation.fit import Boosting
from model.training.segmentation.rows import Rows, fit_and_save, fit_scorer, fit_trees_to

PlayedRound = tuple[Round, int, int]
"""Kind of objects, first seed, end."""

FIRST_FEATURE_NAMES = tuple(n for n in OBJECT_FEATURE_NAMES if n not in HISTORY_FEATURES)
"""A first click has no history."""


@dataclass(frozen=True)
class CloudTraining:
    """Settings that trained ``first_click_cloud.npz``, ``later_click_cloud.npz`` and
    ``later_click_close.npz``.

    Attributes:
        rounds: the objects that are clicked.
        clicks: how they are clicked.
        held_out: every n-th object measures in a fit of its own.
        first, later: how the trees of both are grown.
        networks: that are fitted and averaged, for local refinements.
    """

    rounds: tuple[PlayedRound, ...] = (
        ("all", 60_000, 60_400),
        ("drawers", 90_000, 90_240),
        ("small", 70_000, 70_200),
    )
    clicks: ClickTraining = field(
        default_factory=lambda: ClickTraining(first_clicks=2, mesh_share=0.0, workers=2)
    )
    held_out: int = 6
    first: Boosting = field(default_factory=Boosting)
    later: Boosting = field(
        default_factory=lambda: Boosting(trees=800, leaves=31, forests=1, scale=4.0)
    )
    networks: int = 3


def play_rounds(config: CloudTraining) -> tuple[list[Rows], list[Rows]]:
    """Rows of the first and of the later clicks on each object."""
    played = [
        rows
        for kind, first, end in config.rounds
        for rows in collect(range(first, end), config.clicks, kind, *shipped_scorers("cloud"))
    ]
    first, later = ([pair[k] for pair in played if len(pair[k].share)] for k in (0, 1))
    return first, later


def train_clouds(config: CloudTraining, folder: Path) -> dict[str, float]:
    """Play, fit, measure and write the scorers into ``folder``; see :func:`.fit_and_save`."""
    first, later = play_rounds(config)
    for_first, for_later = (folder / name for name in SCORERS["cloud"])
    at_first = partial(fit_trees_to, config=config.first, names=FIRST_FEATURE_NAMES)
    after = partial(fit_trees_to, config=config.later, names=OBJECT_FEATURE_NAMES)
    local = partial(fit_scorer, networks=config.networks)
    return {
        **fit_and_save(first, config, "first", for_first, at_first),
        **fit_and_save(later, config, "later", for_later, after),
        **fit_and_save(later, config, "close", folder / SCORERS["local"][1], local),
    }
