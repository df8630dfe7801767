"""The scorer of later clicks on parts that move: sessions as people have them.

A simulated person clicks a part where it is seen, then the middle of what looks most wrong, and so
on; mostly the best mask is followed, now and then another one, so that what goes wrong is met as
well.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from model.evaluation.segmentation.visible_clicks import LEAST_PIXELS, largest_piece
from model.segmentation.propose.boxes import MOVING_FEATURE_NAMES, ObjectSolver
from model.segmentation.score.scorers import (
    MOVING_SCORERS,
    shipped_moving_scorers,
    shipped_scorers,
    solver_of,
)
from model.training.segmentation.clicks import Log, Rows, overlaps
from model.training.segmentation.first_clicks import (
    FirstClick,
    MovingTraining,
    Seeds,
    SeenObject,
    clicks_in,
    collected,
    first_clicks,
    fit_moving,
    fitted,
    seen_object,
)

_NEAR_MIDDLE = 0.4
"""Share of later clicks that are not in the very middle of what is wrong."""


def _clouds() -> MovingTraining:
    return MovingTraining(camera=0.5, one_sided=0.25, mesh=0.0, clicks=2)


@dataclass(frozen=True)
class MendingTraining:
    """What is needed to train ``later_click_moving.npz`` again.

    Attributes:
        seeds: of the objects that are clicked, as ranges.
        objects: how they are made and met; ``clicks`` sessions for each part.
        later: clicks after the first one in each session, at most.
        explore: probability of going on from a mask that is not the best one.
        held_out: every n-th object measures in a fit of its own.
        networks: that are fitted and averaged.
        workers: processes.
    """

    seeds: tuple[Seeds, ...] = ((201_200, 201_480, 1), (260_100, 260_140, 1), (280_300, 280_360, 1))
    objects: MovingTraining = field(default_factory=_clouds)
    later: int = 4
    explore: float = 0.2
    held_out: int = 6
    networks: int = 3
    workers: int = 2


def play_sessions(seed: int, config: MendingTraining) -> Rows:
    """Sessions on the moving parts of one object; rows of the later clicks' hypotheses."""
    rng = np.random.default_rng([seed, 11])
    seen = seen_object(seed, config.objects, rng)
    log = Log(MOVING_FEATURE_NAMES)
    solver = solver_of(
        seen.encoding,
        *shipped_scorers("mesh" if seen.encoding.nodes.of_mesh else "cloud"),
        shipped_moving_scorers(),
    )
    if isinstance(solver, ObjectSolver):  # not taken for a room
        for part, clicks in first_clicks(seen, config.objects, rng):
            for click in clicks:
                _session(solver, seen, part, click, config, rng, log)
    return log.rows()


def _session(
    solver: ObjectSolver,
    seen: SeenObject,
    part: int,
    click: FirstClick,
    config: MendingTraining,
    rng: np.random.Generator,
    log: Log,
) -> None:
    encoding, picture = seen.encoding, seen.picture
    of_node, true = encoding.superpoints.of_node, seen.labels == part
    node = encoding.nodes.elements.node_of_element[picture.element]
    there, wanted = seen.shown >= 0, seen.shown == part
    state, superpoint, positive = click.state, click.superpoint, True
    ranked = solver.answer(state, superpoint, True, click.blocked)
    for _ in range(config.later):
        mask = ranked.best
        if rng.random() < config.explore:
            near = np.argsort(-ranked.scores)[: 1 + len(ranked.scores) // 3]
            mask = ranked.candidates.masks[int(rng.choice(near))]
        state = solver.moved(state, superpoint, positive, mask)
        given = mask[of_node][node]
        missing, extra = (largest_piece(p) for p in (wanted & ~given, there & given & ~wanted))
        piece, size = max(missing, extra, key=lambda found: found[1])
        if size < LEAST_PIXELS:
            return
        at = clicks_in(piece, 2, rng)[int(rng.random() < _NEAR_MIDDLE)]
        superpoint, positive = int(of_node[node[at]]), missing[1] >= extra[1]
        if mask[superpoint] == positive:
            return  # the error is smaller than a superpoint
        blocked = click.blocked
        if blocked is not None and positive:
            blocked = blocked.copy()
            blocked[superpoint] = False
        ranked = solver.answer(state, superpoint, positive, blocked)
        log.add(ranked, overlaps(encoding, ranked.candidates.masks, true), float(true.mean()))


def train_mending(config: MendingTraining, folder: Path) -> dict[str, float]:
    """Play, fit, measure and write the scorer into ``folder``; see :func:`.moving.fitted`."""
    rows = collected(play_sessions, config, config.seeds, config.workers)
    fit = partial(fit_moving, networks=config.networks)
    return fitted(rows, config, "mending", folder / MOVING_SCORERS[1], fit)
