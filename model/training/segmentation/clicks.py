"""The scorers: which of a click's hypotheses overlaps most with the part that was meant?"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from model.core.asset import Asset
from model.data.simulated.rooms import NOTHING, bared, scanned_room
from model.data.simulated.scans import DRAWERED, SMALL_PARTED, build, random_scan
from model.evaluation.pool import in_order
from model.segmentation.encode.edge_strength import shipped_edge_model
from model.segmentation.encode.encoding import Encoding, encode
from model.segmentation.encode.room import ROOM_FEATURE_NAMES
from model.segmentation.propose.boxes import OBJECT_FEATURE_NAMES
from model.segmentation.score.mlp import Mlp, save_mlp
from model.segmentation.score.scorers import (
    SCORERS,
    Scorers,
    read_scorers,
    shipped_scorers,
    solver_of,
)
from model.segmentation.score.trees import Scorer, Trees
from model.segmentation.simulated_clicks import central, deepest, next_click
from model.segmentation.solver import PartSolver, PartState, Ranked
from model.training.segmentation.fit import Boosting, averaged, fit_ranker, fit_trees

Float = npt.NDArray[np.floating]
Round = Literal["all", "small", "drawers", "rooms"]
ROUNDS: tuple[Round, ...] = ("all", "small", "drawers", "rooms")
"""What is played on: objects of all families, of those with small parts or with drawers, rooms."""
_FAMILIES = {"small": SMALL_PARTED, "drawers": DRAWERED}
_POINTS = {"small": (60_000, 100_000), "drawers": (60_000, 100_000)}

_LEAST_OF_OBJECT = 150
"""Nodes that an object of a room must show to be asked for."""


@dataclass(frozen=True)
class ClickTraining:
    """What is needed to train the shipped scorers again.

    Attributes:
        objects: of the first round, of all families, played by ``start``.
        small_objects, drawer_objects: of the second and third round, of families with small parts
            and with drawers, played by what came of the rounds before.
        held_out: every n-th object of all rounds measures in a fit of its own.
        parts: asked for in each object, spread over the logarithm of their sizes.
        first_clicks: first clicks of each part: on its deepest point, on the deepest of a few
            random ones, and random ones.
        clicks: length of a simulated session.
        explore: probability of following a hypothesis that is not the best one, by kind of round.
        mesh_share: of the objects that are met as meshes, the others as clouds.
        networks: that are fitted and averaged.
        first_seed, small_seed, drawer_seed: of the objects of the rounds.
        rooms: that the scorers of rooms learn from, and as many again, played by what came of
            those.
        room_objects: asked for in each.
        bare_rooms: share of the rooms that are met without floor and walls.
        room_seed: of the first.
        start: folder with the scorers that play the first round; None: those that ship.
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


@dataclass(frozen=True, eq=False)
class Rows:
    """Hypotheses of many clicks.

    Attributes:
        features: (N, F). overlap: (N,) true IoU.
        click: (N,) which click each belongs to, ascending.
        share: (clicks,) of the object's surface that each click's true part has.
    """

    features: Float
    overlap: Float
    click: npt.NDArray[np.int64]
    share: Float


def joined_rows(parts: list[Rows]) -> Rows:
    """One after the other."""
    begin = np.cumsum([0, *(len(r.share) for r in parts)])
    return Rows(
        np.concatenate([r.features for r in parts]),
        np.concatenate([r.overlap for r in parts]),
        np.concatenate([r.click + n for r, n in zip(parts, begin[:-1], strict=True)]),
        np.concatenate([r.share for r in parts]),
    )


def overlaps(
    encoding: Encoding, found: npt.NDArray[np.bool_], truth: npt.NDArray[np.bool_]
) -> Float:
    """(H,) IoU of masks (H, C) with the true nodes (N,)."""
    superpoints = encoding.superpoints
    own = np.bincount(superpoints.of_node, truth, len(superpoints))
    masks = found.astype(np.float32)
    common = masks @ own.astype(np.float32)
    return common / np.maximum(masks @ superpoints.size.astype(np.float32) + own.sum() - common, 1)


class Log:
    """Collects the rows of clicks; ``names`` are of the features."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self._names = names
        self._rows: list[tuple[Float, Float, float]] = []

    def add(self, ranked: Ranked, overlap: Float, share: float) -> None:
        """One click: its hypotheses, their IoU (H,), and what the part is of the surface."""
        self._rows.append((ranked.features, overlap.astype(np.float32), share))

    def rows(self) -> Rows:
        """All of them."""
        none = np.zeros((0, len(self._names)), np.float32)
        counts = [len(o) for _, o, _ in self._rows]
        return Rows(
            np.concatenate([none, *(f for f, _, _ in self._rows)]),
            np.concatenate([none[:, 0], *(o for _, o, _ in self._rows)]),
            np.repeat(np.arange(len(counts)), counts),
            np.array([s for _, _, s in self._rows], np.float32),
        )


@dataclass(frozen=True, eq=False)
class _Scene:
    """An encoded object with the true part of every node."""

    encoding: Encoding
    labels: npt.NDArray[np.int16]


def _scene(seed: int, config: ClickTraining, kind: Round, rng: np.random.Generator) -> _Scene:
    if kind == "rooms":
        room = scanned_room(seed)
        if rng.random() < config.bare_rooms:
            room = bared(room)
        encoding = encode(Asset("room", cloud=room.cloud), shipped_edge_model())
        # What is nothing's own is never asked for, as strays are not.
        labels = np.where(room.labels == NOTHING, np.int16(-1), room.labels)
        return _Scene(encoding, labels[encoding.nodes.elements.element_of_node])
    families = _FAMILIES.get(kind)
    if rng.random() < config.mesh_share:
        shape = build(seed, families)
        labels, asset = shape.part, Asset("object", mesh=shape.mesh)
    else:
        counts = _POINTS.get(kind, (30_000, 40_000, 100_000))
        data = random_scan(seed, counts[seed % len(counts)], families)
        labels, asset = data.labels, Asset("object", cloud=data.cloud)
    encoding = encode(asset, shipped_edge_model())
    return _Scene(encoding, labels[encoding.nodes.elements.element_of_node])


def asked_by_size(
    rng: np.random.Generator, labels: npt.NDArray[np.integer], most: int, least: int = 12
) -> list[int]:
    """Parts spread evenly over the logarithm of their sizes, so that small ones are not rare."""
    ids, counts = np.unique(labels[labels >= 0], return_counts=True)
    ids, size = ids[counts >= least], np.log(counts[counts >= least])
    out: list[int] = []
    while len(ids) and len(out) < most:
        wanted = rng.uniform(size.min() - 0.1, size.max() + 0.1)
        nearest = int(np.abs(size - wanted).argmin())
        out.append(int(ids[nearest]))
        ids, size = np.delete(ids, nearest), np.delete(size, nearest)
    return out


def play(
    seed: int, config: ClickTraining, kind: Round, first: Scorer | None, later: Scorer | None
) -> tuple[Rows, Rows]:
    """Simulated sessions on one object or room; rows of first and of later clicks."""
    rng = np.random.default_rng([seed, 3])
    scene = _scene(seed, config, kind, rng)
    encoding, points = scene.encoding, scene.encoding.nodes.points
    solver = solver_of(encoding, first, later)
    of_node = encoding.superpoints.of_node
    first_log, later_log = Log(solver.describe.names), Log(solver.describe.names)
    rooms = kind == "rooms"
    if rooms and encoding.room is None:
        return first_log.rows(), later_log.rows()  # too little of its floor and walls was seen
    most, least = (config.room_objects, _LEAST_OF_OBJECT) if rooms else (config.parts, 12)
    for part in asked_by_size(rng, scene.labels, most, least):
        truth = scene.labels == part
        inside = np.nonzero(truth)[0]
        starts = [deepest(points, truth), central(points, truth, rng)]
        starts += rng.choice(inside, config.first_clicks - 2).tolist()
        answers = []
        for start in starts:
            ranked = solver.answer(PartState(), int(of_node[start]), True, None, of_a_part=False)
            first_log.add(ranked, overlaps(encoding, ranked.candidates.masks, truth), truth.mean())
            answers.append(ranked)
        # Half of the sessions begin on the deepest point.
        begin = int(rng.integers(0, 2)) * int(rng.integers(1, len(starts)))
        explore = config.explore[ROUNDS.index(kind)]
        _session(solver, encoding, truth, starts[begin], answers[begin], config.clicks, explore,
                 rng, later_log)  # fmt: skip
    return first_log.rows(), later_log.rows()


def _session(
    solver: PartSolver,
    encoding: Encoding,
    truth: npt.NDArray[np.bool_],
    start: int,
    ranked: Ranked,
    clicks: int,
    explore: float,
    rng: np.random.Generator,
    log: Log,
) -> None:
    of_node, points = encoding.superpoints.of_node, encoding.nodes.points
    state, superpoint, positive = PartState(), int(of_node[start]), True
    for step in range(clicks):
        if step:
            log.add(ranked, overlaps(encoding, ranked.candidates.masks, truth), truth.mean())
        mask = ranked.best
        if rng.random() < explore:
            near = np.argsort(-ranked.scores)[: 1 + len(ranked.scores) // 2]
            mask = ranked.candidates.masks[int(rng.choice(near))]
        state = solver.moved(state, superpoint, positive, mask)
        click = next_click(points, truth, mask[of_node])
        if click is None:
            return
        superpoint, positive = int(of_node[click[0]]), click[1]
        if mask[superpoint] == positive:
            return  # the error is smaller than a superpoint
        ranked = solver.answer(state, superpoint, positive, None, of_a_part=False)


def collect(
    seeds: range, config: ClickTraining, kind: Round, first: Scorer | None, later: Scorer | None
) -> list[tuple[Rows, Rows]]:
    """Rows of each object; they do not depend on ``workers``."""
    playing = partial(play, config=config, kind=kind, first=first, later=later)
    return in_order(playing, seeds, config.workers)


def fit_scorer(rows: Rows, networks: int = 1, names: tuple[str, ...] = OBJECT_FEATURE_NAMES) -> Mlp:
    """The mean of ``networks`` networks that rank the hypotheses of a click by IoU."""
    telling = _telling(rows)
    return averaged([fit_ranker(names, *telling, seed=seed) for seed in range(networks)])


def fit_trees_to(rows: Rows, config: Boosting, names: tuple[str, ...]) -> Trees:
    """Trees that rank the hypotheses of a click by IoU.

    Args:
        names: of the first columns of the features; there may be more.
    """
    features, overlap, click, weight = _telling(rows)
    return fit_trees(names, features[:, : len(names)], overlap, click, weight, config)


def _telling(rows: Rows) -> tuple[Float, Float, npt.NDArray[np.int64], Float]:
    """Features, IoU and click of the hypotheses, and the clicks' weights, but for those clicks
    whose hypotheses are all alike: they teach nothing.
    """
    begin = _starts(rows)
    told = np.maximum.reduceat(rows.overlap, begin) - np.minimum.reduceat(rows.overlap, begin)
    keep = (told > 0.01)[rows.click]
    return rows.features[keep], rows.overlap[keep], rows.click[keep], _evened(rows.share)


def _starts(rows: Rows) -> npt.NDArray[np.int64]:
    return np.nonzero(np.r_[True, np.diff(rows.click) != 0])[0]


def _evened(share: Float) -> Float:
    """(clicks,) weights by the root of how rare a size is, on a logarithmic scale."""
    edges = np.linspace(np.log(1e-5), 0, 15)
    bin_of = np.clip(np.digitize(np.log(np.maximum(share, 1e-5)), edges) - 1, 0, 13)
    number = np.bincount(bin_of, minlength=14).astype(np.float64)
    weight = (number + 0.02 * number.sum())[bin_of] ** -0.5
    return (weight / weight.mean()).astype(np.float32)


def chosen_overlap(model: Scorer, rows: Rows) -> tuple[float, float]:
    """Mean IoU of the chosen hypotheses, and of the best ones that were there."""
    score = model(rows.features)
    order = np.lexsort((-score, rows.click))
    head = order[np.r_[True, np.diff(rows.click[order]) != 0]]
    best = np.zeros(int(rows.click.max()) + 1)
    np.maximum.at(best, rows.click, rows.overlap)
    return float(rows.overlap[head].mean()), float(best[np.unique(rows.click)].mean())


def train_scorers(config: ClickTraining, folder: Path) -> dict[str, float]:
    """Three rounds: all families, small parts, drawers; each plays with what came of the last.

    Writes both networks, fitted on all objects, into ``folder``; returns the scores that a fit
    without every n-th object has on those objects.
    """
    start = shipped_scorers() if config.start is None else read_scorers(config.start)
    rounds: list[tuple[Round, range]] = [
        ("all", range(config.first_seed, config.first_seed + config.objects)),
        ("small", range(config.small_seed, config.small_seed + config.small_objects)),
        ("drawers", range(config.drawer_seed, config.drawer_seed + config.drawer_objects)),
    ]
    played = _rounds(rounds, config, start)
    return _fitted(played, config, folder, SCORERS["mesh"], OBJECT_FEATURE_NAMES)


def train_room_scorers(config: ClickTraining, folder: Path) -> dict[str, float]:
    """As :func:`train_scorers`, for objects picked out of rooms: the first round is played by the
    hand-set rule, the second by what came of it.
    """
    middle = config.room_seed + config.rooms
    rounds: list[tuple[Round, range]] = [
        ("rooms", range(config.room_seed, middle)),
        ("rooms", range(middle, middle + config.rooms)),
    ]
    played = _rounds(rounds, config, (None, None))
    return _fitted(played, config, folder, SCORERS["room"], ROOM_FEATURE_NAMES)


def _rounds(
    rounds: list[tuple[Round, range]], config: ClickTraining, scorers: Scorers
) -> list[tuple[Rows, Rows]]:
    """What was played in all rounds, each by what was learned from those before."""
    played: list[tuple[Rows, Rows]] = []
    for index, (kind, seeds) in enumerate(rounds):
        if index:
            names = ROOM_FEATURE_NAMES if kind == "rooms" else OBJECT_FEATURE_NAMES
            first, later = (joined_rows([p[k] for p in played]) for k in (0, 1))
            scorers = (fit_scorer(first, config.networks, names),
                       fit_scorer(later, config.networks, names))  # fmt: skip
        played += collect(seeds, config, kind, *scorers)
    return played


def _fitted(
    played: list[tuple[Rows, Rows]],
    config: ClickTraining,
    folder: Path,
    files: tuple[str, str],
    names: tuple[str, ...],
) -> dict[str, float]:
    """Fit, measure and write both networks."""
    scores: dict[str, float] = {}
    models = []
    for k, name in enumerate(("first", "later")):
        rows = [p[k] for p in played]
        test = joined_rows(rows[:: config.held_out])
        rest = joined_rows([r for i, r in enumerate(rows) if i % config.held_out])
        model = fit_scorer(rest, config.networks, names)
        scores[f"{name}_iou"], scores[f"{name}_best_possible"] = chosen_overlap(model, test)
        models.append(fit_scorer(joined_rows(rows), config.networks, names))
    notes: dict[str, object] = {
        "training": {**asdict(config), "start": config.start and config.start.name},
        "scores": scores,
    }
    for model, file in zip(models, files, strict=True):
        save_mlp(model, folder / file, notes)
    return scores
