"""Train the scorer of corrective clicks on moving parts, by the visible-click protocol.

A simulated person clicks a part where it is visible, then the middle of the largest visible error,
and so on. Mostly the best mask is followed, sometimes another one, so that errors occur as well.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from model.evaluation.segmentation.visible_clicks import LEAST_PIXELS, largest_component
from model.segmentation.describe.objects import MOVING_FEATURE_NAMES
from model.segmentation.score.scorers import MOVING_SCORERS, shipped_moving_scorers, shipped_scorers
from model.segmentation.solver import PartSolver
from model.segmentation.solvers import solver_of
from model.training.segmentation.first_clicks import fit_moving
from model.training.segmentation.rows import Log, Rows, Seeds, collected, fit_and_save
from model.training.segmentation.visible_objects import (
    FirstClick,
    MovingPartTraining,
    VisibleObject,
    clicks_in,
    first_clicks,
    visible_object,
)

_OFF_MIDDLE = 0.4
"""Share of corrective clicks that are not in the very middle of the error."""


def _clouds() -> MovingPartTraining:
    return MovingPartTraining(camera=0.5, one_sided=0.25, mesh=0.0, clicks=2)


@dataclass(frozen=True)
class CorrectiveClickTraining:
    """Settings that trained ``later_click_moving.npz``.

    Attributes:
        seeds: of the objects that are clicked, as ranges.
        objects: how they are made and scanned; ``clicks`` sessions for each part.
        later: most clicks after the first one in each session.
        explore: probability of going on from a mask that is not the best one.
        held_out: every n-th object measures in a fit of its own.
        networks: that are fitted and averaged.
        workers: processes.
    """

    seeds: tuple[Seeds, ...] = ((201_200, 201_480, 1), (260_100, 260_140, 1), (280_300, 280_360, 1))
    objects: MovingPartTraining = field(default_factory=_clouds)
    later: int = 4
    explore: float = 0.2
    held_out: int = 6
    networks: int = 3
    workers: int = 2


def play_sessions(seed: int, config: CorrectiveClickTraining) -> Rows:
    """Sessions on the moving parts of one object; rows of the later clicks' proposals."""
    rng = np.random.default_rng([seed, 11])
    visible = visible_object(seed, config.objects, rng)
    encoding, log = visible.encoding, Log(MOVING_FEATURE_NAMES)
    scorers = shipped_scorers("mesh" if encoding.nodes.of_mesh else "cloud")
    solver = solver_of(encoding, *scorers, shipped_moving_scorers())
    if encoding.room is None:  # not taken for a room
        for part, clicks in first_clicks(visible, config.objects, rng):
            for click in clicks:
                _session(solver, visible, part, click, config, rng, log)
    return log.rows()


def _session(
    solver: PartSolver,
    visible: VisibleObject,
    part: int,
    click: FirstClick,
    config: CorrectiveClickTraining,
    rng: np.random.Generator,
    log: Log,
) -> None:
    encoding, truth = visible.encoding, visible.labels == part
    of_node = encoding.superpoints.of_node
    node = encoding.nodes.elements.node_of_element[visible.picture.element]
    there, wanted = visible.shown >= 0, visible.shown == part
    state, superpoint, positive = click.state, click.superpoint, True
    found = solver.answer(state, superpoint, True, click.blocked)
    for _ in range(config.later):
        mask = found.best
        if rng.random() < config.explore:
            near = np.argsort(-found.scores)[: 1 + len(found.scores) // 3]
            mask = found.proposals.masks[int(rng.choice(near))]
        state = solver.moved(state, superpoint, positive, mask)
        given = mask[of_node][node]
        errors = (wanted & ~given, there & given & ~wanted)
        missing, extra = (largest_component(error) for error in errors)
        error, size = max(missing, extra, key=lambda component: component[1])
        if size < LEAST_PIXELS:
            return
        at = clicks_in(error, 2, rng)[int(rng.random() < _OFF_MIDDLE)]
        superpoint, positive = int(of_node[node[at]]), missing[1] >= extra[1]
        if mask[superpoint] == positive:
            return  # the error is smaller than a superpoint
        blocked = click.blocked
        if blocked is not None and positive:
            blocked = blocked.copy()
            blocked[superpoint] = False
        found = solver.answer(state, superpoint, positive, blocked)
        log.add(found, encoding, truth)


def train_corrective(config: CorrectiveClickTraining, folder: Path) -> dict[str, float]:
    """Play, fit, measure and write the scorer into ``folder``; see :func:`.fit_and_save`."""
    rows = collected(play_sessions, config, config.seeds, config.workers)
    fit = partial(fit_moving, networks=config.networks)
    return fit_and_save(rows, config, "mending", folder / MOVING_SCORERS[1], fit)
