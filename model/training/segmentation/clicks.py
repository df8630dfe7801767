"""Train the scorers of clicks on meshes, in rooms and on clouds, by sessions of simulated clicks.

On clouds sessions are played by the project's scorers, and later clicks also have
``HISTORY_FEATURES``; there are trees. Meshes keep the scorers that learned from both: their shells
and faces say more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from model.core.asset import Asset
from model.core.pool import in_order
from model.data.simulated.rooms import NOTHING, cropped_room, scanned_room
from model.data.simulated.scans import DRAWERED, SMALL_PARTED, build, random_scan
from model.segmentation.arrays import Bool, Int16
from model.segmentation.encoding import Encoding, encode
from model.segmentation.graph import shipped_edge_model
from model.segmentation.mask_features import ROOM_FEATURE_NAMES
from model.segmentation.models import Scorer, save_mlp
from model.segmentation.object_features import HISTORY_FEATURES, OBJECT_FEATURE_NAMES
from model.segmentation.prompts import central, deepest, next_click
from model.segmentation.proposals import PartState
from model.segmentation.scores import SCORERS, Scorers, read_scorers, shipped_scorers
from model.segmentation.solver import PartSolver, ScoredProposals, solver_of
from model.training.segmentation.rows import (
    Boosting,
    Log,
    Rows,
    asked_by_size,
    chosen_overlap,
    fit_and_save,
    fit_scorer,
    fit_trees_to,
    joined_rows,
    split_by_object,
)

Round = Literal["all", "small", "drawers", "rooms"]
ROUNDS: tuple[Round, ...] = ("all", "small", "drawers", "rooms")
"""Kinds of rounds: objects of all families, with small parts, with drawers, and rooms."""
_FAMILIES = {"small": SMALL_PARTED, "drawers": DRAWERED}
_POINTS = {"small": (60_000, 100_000), "drawers": (60_000, 100_000)}
_LEAST_OF_OBJECT = 150
"""Least visible nodes of an object in a room."""


@dataclass(frozen=True)
class ClickTraining:
    """Settings that trained the scorers of meshes and rooms.

    Attributes:
        objects: of the first round, of all families, played by ``start``.
        small_objects, drawer_objects: of the second and third round, of families with small parts
            and with drawers, played by the scorers of the rounds before.
        held_out: every n-th object of all rounds measures in a fit of its own.
        parts: asked for in each object, spread over the logarithm of their sizes.
        first_clicks: first clicks of each part: on its deepest point, on the deepest of a few
            random ones, and random ones.
        clicks: length of a simulated session.
        explore: probability of following a proposal that is not the best one, by kind of round.
        mesh_share: share of the objects that are meshes; the others are clouds.
        points: of each cloud; None for some of 30 to 100 thousand.
        networks: that are fitted and averaged.
        first_seed, small_seed, drawer_seed: of the objects of the rounds.
        rooms: of the first round of rooms, and of a second one, played by the scorers of the first.
        room_objects: asked for in each.
        bare_rooms: share of the rooms without floor and walls.
        room_seed: of the first.
        start: folder with the scorers that play the first round; None for the project's.
        workers: processes.
    """

    objects: int = 220
    small_objects: int = 110
    drawer_objects: int = 120
    held_out: int = 5
    parts: int = 5
    first_clicks: int = 4
    clicks: int = 8
    explore: tuple[float, float, float, float] = (0.3, 0.2, 0.2, 0.15)
    mesh_share: float = 0.3
    points: int | None = None
    networks: int = 3
    first_seed: int = 60_000
    small_seed: int = 70_000
    drawer_seed: int = 90_000
    rooms: int = 80
    room_objects: int = 8
    bare_rooms: float = 0.5
    room_seed: int = 80_000
    start: Path | None = None
    workers: int = 1


def _scene(
    seed: int, config: ClickTraining, kind: Round, rng: np.random.Generator
) -> tuple[Encoding, Int16]:
    """An encoded object or room, and the true part of every node, -1 for none."""
    if kind == "rooms":
        room = scanned_room(seed)
        if rng.random() < config.bare_rooms:
            room = cropped_room(room)
        labels = np.where(room.labels == NOTHING, np.int16(-1), room.labels)
        asset = Asset("room", cloud=room.cloud)
    elif rng.random() < config.mesh_share:
        shape = build(seed, _FAMILIES.get(kind))
        labels, asset = shape.part, Asset("object", mesh=shape.mesh)
    else:
        counts = _POINTS.get(kind, (30_000, 40_000, 100_000))
        count = config.points or counts[seed % len(counts)]
        data = random_scan(seed, count, _FAMILIES.get(kind))
        labels, asset = data.labels, Asset("object", cloud=data.cloud)
    encoding = encode(asset, shipped_edge_model())
    return encoding, labels[encoding.nodes.elements.element_of_node]


def play(
    seed: int, config: ClickTraining, kind: Round, first: Scorer | None, later: Scorer | None
) -> tuple[Rows, Rows]:
    """Simulated sessions on one object or room; rows of first and of later clicks."""
    rng = np.random.default_rng([seed, 3])
    encoding, labels = _scene(seed, config, kind, rng)
    points, of_node = encoding.nodes.points, encoding.superpoints.of_node
    solver = solver_of(encoding, first, later)
    first_log, later_log = Log(solver.describe.names), Log(solver.describe.names)
    rooms = kind == "rooms"
    if rooms and encoding.room is None:
        return first_log.rows(), later_log.rows()  # too little of its floor and walls is visible
    most, least = (config.room_objects, _LEAST_OF_OBJECT) if rooms else (config.parts, 12)
    for part in asked_by_size(rng, labels, most, least):
        truth = labels == part
        inside = np.nonzero(truth)[0]
        starts = [deepest(points, truth), central(points, truth, rng)]
        starts += rng.choice(inside, config.first_clicks - 2).tolist()
        answers = []
        for start in starts:
            found = solver.first_answer(int(of_node[start]), moving=False)
            first_log.add(found, encoding, truth)
            answers.append(found)
        # Half of the sessions begin on the deepest point.
        begin = int(rng.integers(0, 2)) * int(rng.integers(1, len(starts)))
        explore = config.explore[ROUNDS.index(kind)]
        opening = (starts[begin], answers[begin])
        _session(solver, encoding, truth, *opening, config.clicks, explore, rng, later_log)
    return first_log.rows(), later_log.rows()


def _session(
    solver: PartSolver,
    encoding: Encoding,
    truth: Bool,
    start: int,
    found: ScoredProposals,
    clicks: int,
    explore: float,
    rng: np.random.Generator,
    log: Log,
) -> None:
    of_node, points = encoding.superpoints.of_node, encoding.nodes.points
    state, superpoint, positive = PartState(), int(of_node[start]), True
    for step in range(clicks):
        if step:
            log.add(found, encoding, truth)
        mask = found.best
        if rng.random() < explore:
            near = np.argsort(-found.scores)[: 1 + len(found.scores) // 2]
            mask = found.proposals.masks[int(rng.choice(near))]
        state = solver.moved(state, superpoint, positive, mask)
        click = next_click(points, truth, mask[of_node])
        if click is None:
            return
        superpoint, positive = int(of_node[click[0]]), click[1]
        if mask[superpoint] == positive:
            return  # the error is smaller than a superpoint
        found = solver.answer(state, superpoint, positive, None, moving=False)


def collect(
    seeds: range, config: ClickTraining, kind: Round, first: Scorer | None, later: Scorer | None
) -> list[tuple[Rows, Rows]]:
    """Rows of each object; they don't depend on ``workers``."""
    playing = partial(play, config=config, kind=kind, first=first, later=later)
    return in_order(playing, seeds, config.workers)


def train_scorers(config: ClickTraining, folder: Path) -> dict[str, float]:
    """Three rounds: all families, small parts, drawers; each is played by the scorers so far.

    Writes both networks, fitted on all objects, into ``folder``; returns the scores that a fit
    without every n-th object has on those objects.
    """
    start = shipped_scorers() if config.start is None else read_scorers(config.start)
    rounds: list[tuple[Round, range]] = [
        ("all", range(config.first_seed, config.first_seed + config.objects)),
        ("small", range(config.small_seed, config.small_seed + config.small_objects)),
        ("drawers", range(config.drawer_seed, config.drawer_seed + config.drawer_objects)),
    ]
    return _trained(rounds, config, start, folder, SCORERS["mesh"], OBJECT_FEATURE_NAMES)


def train_room_scorers(config: ClickTraining, folder: Path) -> dict[str, float]:
    """As :func:`train_scorers`, for objects in rooms: the first round is played by the hand-set
    rule, the second by the scorers of the first.
    """
    middle = config.room_seed + config.rooms
    rounds: list[tuple[Round, range]] = [
        ("rooms", range(config.room_seed, middle)),
        ("rooms", range(middle, middle + config.rooms)),
    ]
    return _trained(rounds, config, (None, None), folder, SCORERS["room"], ROOM_FEATURE_NAMES)


def _trained(
    rounds: list[tuple[Round, range]],
    config: ClickTraining,
    scorers: Scorers,
    folder: Path,
    files: tuple[str, str],
    names: tuple[str, ...],
) -> dict[str, float]:
    """Play all rounds, fit, measure and write both networks."""
    fit: Callable[[Rows], Scorer] = partial(fit_scorer, networks=config.networks, names=names)
    played: list[tuple[Rows, Rows]] = []
    for index, (kind, seeds) in enumerate(rounds):
        if index:
            first, later = (fit(joined_rows([p[k] for p in played])) for k in (0, 1))
            scorers = (first, later)
        played += collect(seeds, config, kind, *scorers)
    scores: dict[str, float] = {}
    models = []
    for k, name in enumerate(("first", "later")):
        rows = [p[k] for p in played]
        rest, test = split_by_object(rows, config.held_out)
        model = fit(joined_rows(rest))
        iou, best = chosen_overlap(model, joined_rows(test))
        scores |= {f"{name}_iou": iou, f"{name}_best_possible": best}
        models.append(fit(joined_rows(rows)))
    notes: dict[str, object] = {
        "training": {**asdict(config), "start": config.start and config.start.name},
        "scores": scores,
    }
    for model, file in zip(models, files, strict=True):
        save_mlp(model, folder / file, notes)
    return scores


PlayedRound = tuple[Round, int, int]
"""Kind of objects, first seed, end."""

FIRST_FEATURE_NAMES = tuple(n for n in OBJECT_FEATURE_NAMES if n not in HISTORY_FEATURES)
"""A first click has no history."""


@dataclass(frozen=True)
class CloudTraining:
    """Settings that trained ``first_click_cloud.npz`` and ``later_click_cloud.npz``.

    Attributes:
        rounds: the objects that are clicked.
        clicks: how they are clicked.
        held_out: every n-th object measures in a fit of its own.
        first, later: how the trees of both are grown.
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
    return {
        **fit_and_save(first, config, "first", for_first, at_first),
        **fit_and_save(later, config, "later", for_later, after),
    }
