"""Training rows of scorers: features of the proposals of many clicks, with their true IoU."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from model.evaluation.pool import in_order
from model.segmentation.arrays import Bool, Float, Int, Int64
from model.segmentation.describe.objects import OBJECT_FEATURE_NAMES
from model.segmentation.encode.encoding import Encoding
from model.segmentation.models.mlp import Mlp
from model.segmentation.models.trees import Scorer, Trees, save_scorer
from model.segmentation.solver import ScoredProposals
from model.training.segmentation.fit import Boosting, averaged, fit_ranker, fit_trees

Seeds = tuple[int, int, int]
"""First one, end, step."""

_LEAST_SPREAD = 0.01
"""Least difference in IoU between a click's proposals for the click to teach anything."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Proposals of many clicks.

    Attributes:
        features: (N, F). overlap: (N,) true IoU.
        click: (N,) which click each belongs to, ascending.
        share: (clicks,) of the object's surface that each click's true part has.
    """

    features: Float
    overlap: Float
    click: Int64
    share: Float


def joined_rows(parts: list[Rows]) -> Rows:
    """All rows, in order."""
    begin = np.cumsum([0, *(len(r.share) for r in parts)])
    return Rows(
        np.concatenate([r.features for r in parts]),
        np.concatenate([r.overlap for r in parts]),
        np.concatenate([r.click + n for r, n in zip(parts, begin[:-1], strict=True)]),
        np.concatenate([r.share for r in parts]),
    )


def overlaps(encoding: Encoding, masks: Bool, truth: Bool) -> Float:
    """(H,) IoU of masks (H, C) with the true nodes (N,)."""
    superpoints = encoding.superpoints
    own = np.bincount(superpoints.of_node, truth, len(superpoints))
    weight = masks.astype(np.float32)
    common = weight @ own.astype(np.float32)
    size = weight @ superpoints.size.astype(np.float32)
    return common / np.maximum(size + own.sum() - common, 1)


class Log:
    """Collects the rows of clicks."""

    def __init__(self, names: tuple[str, ...]) -> None:
        """``names`` of the features."""
        self._names = names
        self._rows: list[tuple[Float, Float, float]] = []

    def add(self, found: ScoredProposals, encoding: Encoding, truth: Bool) -> None:
        """Add the proposals of a click on the part of the nodes ``truth`` (N,)."""
        overlap = overlaps(encoding, found.proposals.masks, truth)
        self._rows.append((found.features, overlap.astype(np.float32), float(truth.mean())))

    def rows(self) -> Rows:
        """All rows so far."""
        none = np.zeros((0, len(self._names)), np.float32)
        counts = [len(o) for _, o, _ in self._rows]
        return Rows(
            np.concatenate([none, *(f for f, _, _ in self._rows)]),
            np.concatenate([none[:, 0], *(o for _, o, _ in self._rows)]),
            np.repeat(np.arange(len(counts)), counts),
            np.array([s for _, _, s in self._rows], np.float32),
        )


def asked_by_size(rng: np.random.Generator, labels: Int, most: int, least: int = 12) -> list[int]:
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


class Played(Protocol):
    """The rows of one object."""

    @property
    def share(self) -> Float:
        """One number for each click or mask."""
        ...


C = TypeVar("C")
P = TypeVar("P", bound=Played)


def collected(
    play_one: Callable[[int, C], P], config: C, seeds: tuple[Seeds, ...], workers: int
) -> list[P]:
    """Rows of each object that has any; they don't depend on ``workers``."""
    numbers = [seed for one in seeds for seed in range(*one)]
    rows = in_order(partial(_played, play_one, config), numbers, workers)
    return [r for r in rows if len(r.share)]


def _played(play_one: Callable[[int, C], P], config: C, seed: int) -> P:
    return play_one(seed, config)


def split_by_object(rows: list[P], every: int) -> tuple[list[P], list[P]]:
    """The rows to learn from, and those of every n-th object to measure on."""
    return [r for i, r in enumerate(rows) if i % every], rows[::every]


def fit_scorer(rows: Rows, networks: int = 1, names: tuple[str, ...] = OBJECT_FEATURE_NAMES) -> Mlp:
    """The mean of ``networks`` networks that rank the proposals of a click by IoU."""
    data = _informative(rows)
    return averaged([fit_ranker(names, *data, seed=seed) for seed in range(networks)])


def fit_trees_to(rows: Rows, config: Boosting, names: tuple[str, ...]) -> Trees:
    """Trees that rank the proposals of a click by IoU.

    Args:
        names: of the first columns of the features; there may be more.
    """
    features, overlap, click, weight = _informative(rows)
    return fit_trees(names, features[:, : len(names)], overlap, click, weight, config)


def _informative(rows: Rows) -> tuple[Float, Float, Int64, Float]:
    """Features, IoU and click of the proposals, without clicks whose proposals are all alike, and
    the weights of all clicks.
    """
    begin = np.nonzero(np.r_[True, np.diff(rows.click) != 0])[0]
    spread = np.maximum.reduceat(rows.overlap, begin) - np.minimum.reduceat(rows.overlap, begin)
    keep = (spread > _LEAST_SPREAD)[rows.click]
    return rows.features[keep], rows.overlap[keep], rows.click[keep], _evened(rows.share)


def _evened(share: Float) -> Float:
    """(clicks,) weights by the root of the rareness of a size, on a logarithmic scale."""
    edges = np.linspace(np.log(1e-5), 0, 15)
    bin_of = np.clip(np.digitize(np.log(np.maximum(share, 1e-5)), edges) - 1, 0, 13)
    number = np.bincount(bin_of, minlength=14).astype(np.float64)
    weight = (number + 0.02 * number.sum())[bin_of] ** -0.5
    return (weight / weight.mean()).astype(np.float32)


def chosen_overlap(model: Scorer, rows: Rows) -> tuple[float, float]:
    """Mean IoU of the chosen proposals, and of the best ones."""
    score = model(rows.features)
    order = np.lexsort((-score, rows.click))
    head = order[np.r_[True, np.diff(rows.click[order]) != 0]]
    best = np.zeros(int(rows.click.max()) + 1)
    np.maximum.at(best, rows.click, rows.overlap)
    return float(rows.overlap[head].mean()), float(best[np.unique(rows.click)].mean())


def fit_and_save(
    rows: list[Rows], config: Any, kind: str, path: Path, fit: Callable[[Rows], Scorer]
) -> dict[str, float]:
    """Fit on all objects, and write the scorer of ``kind``.

    Args:
        config: a training's dataclass, with ``held_out``.

    Returns:
        Scores of a fit without every n-th object on those objects.
    """
    rest, test = split_by_object(rows, config.held_out)
    chosen, best = chosen_overlap(fit(joined_rows(rest)), joined_rows(test))
    scores = {
        f"{kind}_iou": chosen,
        f"{kind}_best_possible": best,
        f"{kind}_clicks": float(sum(len(r.share) for r in rows)),
    }
    save_scorer(fit(joined_rows(rows)), path, {"training": asdict(config), "scores": scores})
    return scores
