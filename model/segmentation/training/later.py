"""The scorer of later clicks on clouds: sessions on objects of all kinds, as the shipped scorers
play them.

It sees how well a mask explains all clicks so far, see ``HISTORY_FEATURES``. Meshes keep the scorer
that learned from both: on them what is known of shells and faces says more.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from model.segmentation.boxes import OBJECT_FEATURE_NAMES
from model.segmentation.scorers import CLOUD_SCORERS, shipped_scorers
from model.segmentation.training.clicks import ClickTraining, Round, Rows, collect
from model.segmentation.training.moving import fitted

Played = tuple[Round, int, int]
"""Kind of objects, first seed, end."""


@dataclass(frozen=True)
class LaterTraining:
    """What is needed to train ``later_click_cloud.npz`` again.

    Attributes:
        rounds: the objects that are clicked.
        clicks: how they are clicked.
        held_out: every n-th object measures in a fit of its own.
        networks: that are fitted and averaged.
    """

    rounds: tuple[Played, ...] = (
        ("all", 60_000, 60_400),
        ("drawers", 90_000, 90_240),
        ("small", 70_000, 70_200),
    )
    clicks: ClickTraining = field(
        default_factory=lambda: ClickTraining(first_clicks=2, mesh_share=0.0, workers=2)
    )
    held_out: int = 6
    networks: int = 3


def play_round(played: Played, config: LaterTraining) -> list[Rows]:
    """Rows of the later clicks on each object of a round, as the shipped scorers play."""
    kind, first, end = played
    rows = collect(range(first, end), config.clicks, kind, *shipped_scorers(clouds=True))
    return [later for _, later in rows if len(later.share)]


def train_later(config: LaterTraining, folder: Path) -> dict[str, float]:
    """Play, fit, measure and write the scorer into ``folder``; see :func:`.moving.fitted`."""
    rows = [row for played in config.rounds for row in play_round(played, config)]
    return fitted(rows, config, "later", folder / CLOUD_SCORERS[1], OBJECT_FEATURE_NAMES)
