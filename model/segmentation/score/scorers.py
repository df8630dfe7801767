"""The trained scorers of clicks on objects and in rooms, and the solver that uses them."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from model.core.resources import static_assets
from model.segmentation.encode.encoding import Encoding
from model.segmentation.encode.room import ROOM_FEATURE_NAMES, RoomSolver
from model.segmentation.propose.boxes import (
    MOVING_FEATURE_NAMES,
    OBJECT_FEATURE_NAMES,
    ObjectSolver,
)
from model.segmentation.propose.fronts import Fronts
from model.segmentation.score.trees import Scorer, load_scorer
from model.segmentation.solver import PartSolver

MOVING_SCORERS = ("first_click_moving.npz", "later_click_moving.npz")

Met = Literal["mesh", "cloud", "close-up", "room"]
"""What is clicked: a mesh, a cloud, a cloud from close by, or a room."""
SCORERS: dict[Met, tuple[str, str]] = {
    "mesh": ("first_click.npz", "later_click.npz"),
    "cloud": ("first_click_cloud.npz", "later_click_cloud.npz"),
    # Trees learned from superpoints, and close-ups have none: there networks choose better.
    "close-up": ("first_click.npz", "later_click_close.npz"),
    "room": ("room_first_click.npz", "room_later_click.npz"),
}
"""Files of the scorers of a first click and of later ones. Meshes are their own close-ups."""

Scorers = tuple[Scorer | None, Scorer | None]
"""Of a first click, and of later ones."""


@lru_cache(maxsize=len(SCORERS))
def shipped_scorers(met: Met = "mesh") -> Scorers:
    """The scorers that ship, None where they are not there."""
    return read_scorers(static_assets() / "segmentation", met)


def read_scorers(folder: Path, met: Met = "mesh") -> Scorers:
    """The scorers in ``folder``."""
    names = ROOM_FEATURE_NAMES if met == "room" else OBJECT_FEATURE_NAMES
    return _read(folder, SCORERS[met], names)


@lru_cache(maxsize=1)
def shipped_moving_scorers() -> Scorers:
    """The scorers of clicks on parts that move, for clouds of objects; None where not there."""
    return _read(static_assets() / "segmentation", MOVING_SCORERS, MOVING_FEATURE_NAMES)


def _read(folder: Path, files: tuple[str, str], names: tuple[str, ...]) -> Scorers:
    first, later = (folder / name for name in files)
    return (
        load_scorer(first, names) if first.is_file() else None,
        load_scorer(later, names) if later.is_file() else None,
    )


def solver_of(
    encoding: Encoding,
    first: Scorer | None,
    later: Scorer | None,
    moving: Scorers = (None, None),
    *,
    lined: bool = False,
) -> PartSolver:
    """The solver for what was encoded, an object or a room.

    Args:
        first, later: scorers of clicks that may mean the base, too; moving: of those that mean a
            part that moves.
        lined: look for lines on fronts on meshes, too.
    """
    superpoints, hierarchy, walk, room = (
        encoding.superpoints,
        encoding.hierarchy,
        encoding.walk,
        encoding.room,
    )
    if room is None:
        solver = ObjectSolver(superpoints, hierarchy, walk, first, later, _shells(encoding))
        nodes, graph, strength = encoding.nodes, encoding.graph, encoding.strength
        # To who clicks, faces and shells tell the parts of a mesh better than lines.
        if lined or not nodes.of_mesh:
            solver.fronts = Fronts(nodes, graph, strength, superpoints, solver.axes)
            solver.moving_scorers = moving
        return solver
    return RoomSolver(superpoints, hierarchy, walk, room, first, later)


def _shells(encoding: Encoding) -> npt.NDArray[np.int32] | None:
    """(C,) the shell of each superpoint of a mesh."""
    nodes, superpoints = encoding.nodes, encoding.superpoints
    if not nodes.of_mesh:
        return None
    out = np.zeros(len(superpoints), np.int32)
    out[superpoints.of_node] = nodes.shell
    return out
