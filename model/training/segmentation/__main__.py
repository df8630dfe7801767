"""Trains the shipped networks again: ``python -m model.training.segmentation --help``."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, field
from pathlib import Path

from model.core.resources import static_assets
from model.training.segmentation.boxes import BoxTraining, train_boxes
from model.training.segmentation.clicks import ClickTraining, train_room_scorers, train_scorers
from model.training.segmentation.clouds import CloudTraining, train_clouds
from model.training.segmentation.corrective_clicks import MendingTraining, train_mending
from model.training.segmentation.edges import EdgeTraining, train_edges
from model.training.segmentation.first_clicks import MovingTraining, train_moving
from model.training.segmentation.part_masks import PartMaskTraining, train_part_masks


@dataclass(frozen=True)
class Training:
    """All trainings; about three hours on two cores.

    Attributes:
        out: folder for ``edges.npz``, ``boxes.npz``, ``first_click.npz``, ``later_click.npz``,
            ``first_click_cloud.npz``, ``later_click_cloud.npz``, ``later_click_close.npz``,
            ``first_click_moving.npz``, ``later_click_moving.npz``, ``part_masks.npz`` and, of
            rooms, ``room_first_click.npz`` and ``room_later_click.npz``.
        skip_edges, skip_boxes, skip_parts, skip_clouds, skip_rooms, skip_moving, skip_mending,
        skip_proposals: keep the networks that are there.
        edges, boxes, clicks, clouds, moving, mending, proposals: their settings.
    """

    out: Path = field(default_factory=lambda: static_assets() / "segmentation")
    skip_edges: bool = False
    skip_boxes: bool = False
    skip_parts: bool = False
    skip_clouds: bool = False
    skip_rooms: bool = False
    skip_moving: bool = False
    skip_mending: bool = False
    skip_proposals: bool = False
    edges: EdgeTraining = field(default_factory=EdgeTraining)
    boxes: BoxTraining = field(default_factory=BoxTraining)
    clicks: ClickTraining = field(default_factory=ClickTraining)
    clouds: CloudTraining = field(default_factory=CloudTraining)
    moving: MovingTraining = field(default_factory=MovingTraining)
    mending: MendingTraining = field(default_factory=MendingTraining)
    proposals: PartMaskTraining = field(default_factory=PartMaskTraining)


def main() -> None:
    """Train and print the scores; they are kept in the files as well."""
    import tyro

    config = tyro.cli(Training, description=__doc__)
    config.out.mkdir(parents=True, exist_ok=True)
    if not config.skip_edges:
        print(json.dumps(train_edges(config.edges, config.out / "edges.npz"), indent=1))
    if not config.skip_boxes:
        print(json.dumps(train_boxes(config.boxes, config.out / "boxes.npz"), indent=1))
    if not config.skip_parts:
        print(json.dumps(train_scorers(config.clicks, config.out), indent=1))
    if not config.skip_clouds:
        print(json.dumps(train_clouds(config.clouds, config.out), indent=1))
    if not config.skip_rooms:
        print(json.dumps(train_room_scorers(config.clicks, config.out), indent=1))
    if not config.skip_moving:
        print(json.dumps(train_moving(config.moving, config.out), indent=1))
    if not config.skip_mending:
        print(json.dumps(train_mending(config.mending, config.out), indent=1))
    if not config.skip_proposals:
        print(json.dumps(train_part_masks(config.proposals, config.out), indent=1))


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit(130)
