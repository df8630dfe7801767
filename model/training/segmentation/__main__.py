"""Train the small models of the default segmenter: ``python -m model.training.segmentation``."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from model.core.files import static_assets
from model.training.segmentation.clicks import (
    ClickTraining,
    CloudTraining,
    train_clouds,
    train_room_scorers,
    train_scorers,
)
from model.training.segmentation.networks import (
    EdgeTraining,
    PartMaskTraining,
    train_edges,
    train_part_masks,
)
from model.training.segmentation.visible_objects import (
    CorrectiveClickTraining,
    MovingPartTraining,
    train_corrective,
    train_moving,
)

Step = Literal["edges", "parts", "clouds", "rooms", "moving", "mending", "proposals"]


@dataclass(frozen=True)
class Training:
    """All trainings; about three hours on two cores.

    Attributes:
        out: folder for ``edges.npz``, ``first_click.npz``, ``later_click.npz``,
            ``first_click_cloud.npz``, ``later_click_cloud.npz``, ``first_click_moving.npz``,
            ``later_click_moving.npz``, ``part_masks.npz`` and, of rooms, ``room_first_click.npz``
            and ``room_later_click.npz``.
        skip: trainings whose models are kept as they are.
        edges, clicks, clouds, moving, corrective, proposals: their settings.
    """

    out: Path = field(default_factory=lambda: static_assets() / "segmentation")
    skip: tuple[Step, ...] = ()
    edges: EdgeTraining = field(default_factory=EdgeTraining)
    clicks: ClickTraining = field(default_factory=ClickTraining)
    clouds: CloudTraining = field(default_factory=CloudTraining)
    moving: MovingPartTraining = field(default_factory=MovingPartTraining)
    corrective: Annotated[CorrectiveClickTraining, tyro.conf.arg(name="mending")] = field(
        default_factory=CorrectiveClickTraining
    )
    proposals: PartMaskTraining = field(default_factory=PartMaskTraining)


def main() -> None:
    """Train and print the scores; the files hold them as well."""

    config = tyro.cli(Training, description=__doc__)
    config.out.mkdir(parents=True, exist_ok=True)
    out = config.out
    trainings: dict[Step, Callable[[], dict[str, float]]] = {
        "edges": lambda: train_edges(config.edges, out / "edges.npz"),
        "parts": lambda: train_scorers(config.clicks, out),
        "clouds": lambda: train_clouds(config.clouds, out),
        "rooms": lambda: train_room_scorers(config.clicks, out),
        "moving": lambda: train_moving(config.moving, out),
        "mending": lambda: train_corrective(config.corrective, out),
        "proposals": lambda: train_part_masks(config.proposals, out),
    }
    for step, train in trainings.items():
        if step not in config.skip:
            print(json.dumps(train(), indent=1))


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit(130)
