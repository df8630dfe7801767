"""Train the scorer of first clicks on moving parts, by the visible-click protocol.

People don't click the base: what no click claims belongs to it. So this scorer learns only from
moving parts, clicked where they are visible, with and without clicks on other parts, on objects
with ornaments, many of them scanned by simulated depth cameras.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from model.segmentation.describe.objects import MOVING_FEATURE_NAMES
from model.segmentation.models.mlp import Mlp
from model.segmentation.score.scorers import MOVING_SCORERS, shipped_scorers
from model.segmentation.solvers import solver_of
from model.training.segmentation.rows import Log, Rows, collected, fit_and_save, fit_scorer
from model.training.segmentation.visible_objects import (
    MovingPartTraining,
    first_clicks,
    visible_object,
)


def play(seed: int, config: MovingPartTraining) -> Rows:
    """First clicks on the moving parts of one object; rows of their proposals."""
    rng = np.random.default_rng([seed, 7])
    visible = visible_object(seed, config, rng)
    log = Log(MOVING_FEATURE_NAMES)
    # The app lays out no fronts on meshes, but they teach as well as clouds.
    solver = solver_of(visible.encoding, *shipped_scorers(), with_fronts=True)
    if visible.encoding.room is not None:
        return log.rows()  # taken for a room
    for part, clicks in first_clicks(visible, config, rng):
        for click in clicks:
            found = solver.answer(click.state, click.superpoint, True, click.blocked)
            log.add(found, visible.encoding, visible.labels == part)
    return log.rows()


def fit_moving(rows: Rows, networks: int) -> Mlp:
    """The mean of ``networks`` networks on the features of moving parts."""
    return fit_scorer(rows, networks, MOVING_FEATURE_NAMES)


def train_moving(config: MovingPartTraining, folder: Path) -> dict[str, float]:
    """Play, fit, measure and write the scorer into ``folder``; see :func:`.fit_and_save`."""
    rows = collected(play, config, config.seeds, config.workers)
    fit = partial(fit_moving, networks=config.networks)
    return fit_and_save(rows, config, "moving", folder / MOVING_SCORERS[0], fit)
