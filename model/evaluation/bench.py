"""Benchmarks of whole objects with their true or their predicted joints, in processes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar

import numpy as np

from model.core.articulated_object import ArticulatedObject
from model.core.pool import robust_map
from model.core.progress import Progress, no_progress
from model.data.registry import DatasetOptions, open_dataset
from model.prediction.registry import DEFAULT, load_predictor

Half = Literal["choose", "table", "all"]
Joints = Literal["true", "predicted"]
SECONDS = 600.0
"""Time limit of an object's drives, of its formats, and of the robot's tries."""
S = TypeVar("S")


@dataclass(frozen=True)
class ObjectBench:
    """Objects to measure.

    Attributes:
        data: the objects. half: see :func:`half_of`. limit: of them; 0 for all.
        joints: the true ones, or predicted ones with names given.
        seed: random seed of the shuffle. jobs: processes.
    """

    data: DatasetOptions
    half: Half = "table"
    limit: int = 0
    joints: Joints = "true"
    seed: int = 0
    jobs: int = 2

    @property
    def label(self) -> str:
        """Label of its row."""
        return f"{self.data.name}, {self.joints} joints"

    def scores(
        self,
        score: Callable[[str], S],
        lost: Callable[[str, str], S],
        progress: Progress = no_progress,
    ) -> list[S]:
        """Score each object.

        Args:
            score: of an id; can be pickled, never raises.
            lost: score of an id without one, and why.
        """
        ids = half_of(open_dataset(self.data).ids(), self.half, self.seed, self.limit)
        found: dict[str, S] = {}
        for name, each in robust_map(score, ids, self.jobs):
            found[name] = lost(name, "its process died") if each is None else each
            progress(len(found) / len(ids), f"{self.label}: {name}")
        return [found[i] for i in ids]

    def object(self, name: str) -> ArticulatedObject:
        """The object with the joints that are measured.

        Raises:
            ValueError: where no tree was predicted.
        """
        truth = open_dataset(self.data).load(name)
        if self.joints == "true":
            return truth.object
        found = load_predictor(DEFAULT).predict(truth.segmented(names=True), seed=0)
        if found.tree is None:
            raise ValueError("; ".join(found.problems) or "there is no tree")
        return replace(truth.object, tree=found.tree, affordances=())


B = TypeVar("B", bound=ObjectBench)


def folder_runs(kind: type[B], data: DatasetOptions | None, **settings: Any) -> list[B]:
    """Truth and predictions of a data set, then of the bundled objects."""
    bundled = kind(DatasetOptions("bundled"), **{**settings, "half": "all"})
    runs = [] if data is None else [kind(data, **settings)]
    return [replace(run, joints=j) for run in (*runs, bundled) for j in ("true", "predicted")]


def half_of(all_ids: Sequence[str], half: Half, seed: int, limit: int) -> list[str]:
    """One of two halves of the shuffled objects that share none, at most ``limit`` (0: all)."""
    ids = list(all_ids)
    np.random.default_rng(seed).shuffle(ids)
    middle = len(ids) // 2
    ids = {"choose": ids[:middle], "table": ids[middle:], "all": ids}[half]
    return ids[: limit or None]
