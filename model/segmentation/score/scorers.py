"""The trained scorers that ship, by input domain."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Literal

from model.core.files import static_assets
from model.segmentation.describe.objects import MOVING_FEATURE_NAMES, OBJECT_FEATURE_NAMES
from model.segmentation.describe.rooms import ROOM_FEATURE_NAMES
from model.segmentation.models.trees import Scorer, load_scorer

MOVING_SCORERS = ("first_click_moving.npz", "later_click_moving.npz")

InputDomain = Literal["mesh", "cloud", "local", "room"]
"""Input domain: a mesh, a cloud, a cloud in a local refinement, or a room."""
SCORERS: dict[InputDomain, tuple[str, str]] = {
    "mesh": ("first_click.npz", "later_click.npz"),
    "cloud": ("first_click_cloud.npz", "later_click_cloud.npz"),
    # Local refinements have no superpoints of several nodes, as the trees learned from.
    "local": ("first_click.npz", "later_click_close.npz"),
    "room": ("room_first_click.npz", "room_later_click.npz"),
}
"""Files of the scorers of first and later clicks. Local refinements of meshes use ``mesh``."""

Scorers = tuple[Scorer | None, Scorer | None]
"""Scorers of first and of later clicks."""


@lru_cache(maxsize=len(SCORERS))
def shipped_scorers(domain: InputDomain = "mesh") -> Scorers:
    """The project's scorers; None for absent files."""
    return read_scorers(static_assets() / "segmentation", domain)


def read_scorers(folder: Path, domain: InputDomain = "mesh") -> Scorers:
    """The scorers in ``folder``; None for absent files."""
    names = ROOM_FEATURE_NAMES if domain == "room" else OBJECT_FEATURE_NAMES
    return _read(folder, SCORERS[domain], names)


@lru_cache(maxsize=1)
def shipped_moving_scorers() -> Scorers:
    """The project's scorers of moving parts on clouds of objects; None for absent files."""
    return _read(static_assets() / "segmentation", MOVING_SCORERS, MOVING_FEATURE_NAMES)


def _read(folder: Path, files: tuple[str, str], names: tuple[str, ...]) -> Scorers:
    first, later = (folder / name for name in files)
    return (
        load_scorer(first, names) if first.is_file() else None,
        load_scorer(later, names) if later.is_file() else None,
    )
