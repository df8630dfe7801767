"""The scorers: which of a click's hypotheses overlaps most with the part that was meant?"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.geometry.asset import Asset
from model.segmentation.edge_strength import shipped_edge_model
from model.segmentation.encoding import Encoding, encode
from model.segmentation.masks import FEATURE_NAMES
from model.segmentation.mlp import Mlp, save_mlp
from model.segmentation.simulate import deepest, next_click
from model.segmentation.solver import PartSolver, PartState, Ranked, with_click
from model.segmentation.training.fit import fit_ranker
from model.segmentation.training.scans import random_scan

Float = npt.NDArray[np.floating]


@dataclass(frozen=True)
class ClickTraining:
    """What is needed to train the shipped scorers again.

    Attributes:
        objects, held_out: numbers of objects to train and to measure on.
        parts_per_object: parts asked for in each, the base among them.
        first_clicks: first clicks of each part.
        clicks: length of a simulated session.
        explore: probability of following a hypothesis that is not the best one.
        first_seed: of the objects; other ones than the edge model has seen.
        workers: processes.
    """

    objects: int = 200
    held_out: int = 16
    parts_per_object: int = 6
    first_clicks: int = 6
    clicks: int = 8
    explore: float = 0.25
    first_seed: int = 10_000
    workers: int = 1


@dataclass(frozen=True, eq=False)
class Rows:
    """Hypotheses of many clicks: features, true IoU, and which click each belongs to."""

    features: Float
    overlap: Float
    click: npt.NDArray[np.int64]

    @classmethod
    def empty(cls) -> Rows:
        """No rows."""
        return cls(
            np.zeros((0, len(FEATURE_NAMES)), np.float32), np.zeros(0, np.float32), np.zeros(0, int)
        )


def _joined(parts: list[Rows]) -> Rows:
    offset, clicks = 0, []
    for rows in parts:
        clicks.append(rows.click + offset)
        offset += int(rows.click.max()) + 1 if len(rows.click) else 0
    return Rows(
        np.concatenate([r.features for r in parts]),
        np.concatenate([r.overlap for r in parts]),
        np.concatenate(clicks),
    )


def overlaps(encoding: Encoding, ranked: Ranked, truth: npt.NDArray[np.bool_]) -> Float:
    """(H,) IoU of each hypothesis with the true nodes."""
    cells = encoding.cells
    own = np.bincount(cells.of_node, truth, len(cells))
    masks = ranked.candidates.masks.astype(np.float32)
    common = masks @ own.astype(np.float32)
    return common / np.maximum(masks @ cells.size.astype(np.float32) + own.sum() - common, 1)


class _Log:
    def __init__(self) -> None:
        self._rows: list[tuple[Float, Float]] = []

    def add(self, ranked: Ranked, overlap: Float) -> None:
        self._rows.append((ranked.features, overlap.astype(np.float32)))

    def rows(self) -> Rows:
        if not self._rows:
            return Rows.empty()
        counts = [len(o) for _, o in self._rows]
        return Rows(
            np.concatenate([f for f, _ in self._rows]),
            np.concatenate([o for _, o in self._rows]),
            np.repeat(np.arange(len(counts)), counts),
        )


def play(
    seed: int, config: ClickTraining, first: Mlp | None, later: Mlp | None
) -> tuple[Rows, Rows]:
    """Simulated sessions on one object; rows of first and of later clicks."""
    data = random_scan(seed, (25_000, 60_000)[seed % 2])
    encoding = encode(Asset("object", cloud=data.cloud), shipped_edge_model())
    solver = PartSolver(encoding.cells, encoding.hierarchy, encoding.walk, first, later)
    rng = np.random.default_rng([seed, 3])
    points, labels, of_node = data.cloud.points, data.labels, encoding.cells.of_node
    ids, counts = np.unique(labels, return_counts=True)
    ids = ids[counts >= 15]
    first_log, later_log = _Log(), _Log()
    if len(ids) < 2:
        return first_log.rows(), later_log.rows()
    for part in rng.permutation(ids)[: config.parts_per_object]:
        truth = labels == part
        inside = np.nonzero(truth)[0]
        starts = [deepest(points, truth), *rng.choice(inside, config.first_clicks - 1)]
        answers = []
        for start in starts:
            ranked = solver.answer(PartState(), int(of_node[start]), True, None)
            first_log.add(ranked, overlaps(encoding, ranked, truth))
            answers.append(ranked)
        begin = int(rng.integers(len(starts)))
        _session(solver, encoding, points, truth, starts[begin], answers[begin], config, rng,
                 later_log)  # fmt: skip
    return first_log.rows(), later_log.rows()


def _session(
    solver: PartSolver,
    encoding: Encoding,
    points: npt.NDArray[np.float32],
    truth: npt.NDArray[np.bool_],
    start: int,
    ranked: Ranked,
    config: ClickTraining,
    rng: np.random.Generator,
    log: _Log,
) -> None:
    of_node = encoding.cells.of_node
    state = with_click(PartState(), int(of_node[start]), True)
    for step in range(config.clicks):
        if step:
            log.add(ranked, overlaps(encoding, ranked, truth))
        mask = ranked.best
        if rng.random() < config.explore:
            near = np.argsort(-ranked.scores)[: 1 + len(ranked.scores) // 2]
            mask = ranked.candidates.masks[int(rng.choice(near))]
        state = PartState(state.positive, state.negative, mask)
        click = next_click(points, truth, mask[of_node])
        if click is None:
            return
        cell = int(of_node[click[0]])
        if mask[cell] == click[1]:
            return  # the error is smaller than a cell
        ranked = solver.answer(state, cell, click[1], None)
        state = with_click(state, cell, click[1])


def collect(
    seeds: range, config: ClickTraining, first: Mlp | None, later: Mlp | None
) -> tuple[Rows, Rows]:
    """Rows of many objects; the order does not depend on ``workers``."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    if config.workers <= 1:
        pairs = [play(seed, config, first, later) for seed in seeds]
    else:
        context = get_context("spawn")
        with ProcessPoolExecutor(config.workers, mp_context=context) as pool:
            n = len(seeds)
            pairs = list(pool.map(play, seeds, [config] * n, [first] * n, [later] * n, chunksize=4))
    return _joined([p[0] for p in pairs]), _joined([p[1] for p in pairs])


def fit_scorer(rows: Rows, seed: int = 0) -> Mlp:
    """A network that ranks the hypotheses of a click by IoU."""
    return fit_ranker(FEATURE_NAMES, rows.features, rows.overlap, rows.click, seed=seed)


def chosen_overlap(model: Mlp, rows: Rows) -> tuple[float, float]:
    """Mean IoU of the chosen hypotheses, and of the best ones that were there."""
    score = model(rows.features)
    order = np.lexsort((-score, rows.click))
    head = order[np.r_[True, np.diff(rows.click[order]) != 0]]
    best = np.zeros(int(rows.click.max()) + 1)
    np.maximum.at(best, rows.click, rows.overlap)
    return float(rows.overlap[head].mean()), float(best[np.unique(rows.click)].mean())


def train_scorers(config: ClickTraining, folder: Path) -> dict[str, float]:
    """Two rounds; the second is longer and plays with the scorers of the first.

    Writes both networks into ``folder`` and returns the scores on held-out objects.
    """
    a, b = config.first_seed + config.objects // 4, config.first_seed + config.objects
    c = b + config.held_out
    first_1, later_1 = collect(range(config.first_seed, a), config, None, None)
    first, later = fit_scorer(first_1), fit_scorer(later_1)
    print("round 1", chosen_overlap(first, first_1), chosen_overlap(later, later_1), flush=True)
    first_2, later_2 = collect(range(a, b), config, first, later)
    first, later = fit_scorer(_joined([first_1, first_2])), fit_scorer(_joined([later_1, later_2]))
    quiet = ClickTraining(**{**asdict(config), "explore": 0.0})
    first_t, later_t = collect(range(b, c), quiet, first, later)
    scores = {}
    for name, model, rows in (("first", first, first_t), ("later", later, later_t)):
        scores[f"{name}_iou"], scores[f"{name}_best_possible"] = chosen_overlap(model, rows)
    notes: dict[str, object] = {"training": asdict(config), "scores": scores}
    save_mlp(first, folder / "first_click.npz", notes)
    save_mlp(later, folder / "later_click.npz", notes)
    return scores
