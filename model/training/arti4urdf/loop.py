"""The training loop of both models: schedule, resumable slices, log."""

from __future__ import annotations

import importlib.util
import json
import math
import time
from collections.abc import Collection
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch

from model.core.errors import ConfigurationError
from model.core.progress import Progress

LOG = "log.jsonl"
CONFIG = "config.json"


class Schedule(Protocol):
    """The part of a configuration that the loop reads."""

    @property
    def batch(self) -> int:
        """Objects per step."""
        ...

    @property
    def learning_rate(self) -> float:
        """At its peak."""
        ...

    @property
    def warmup(self) -> int:
        """Steps until the peak."""
        ...

    @property
    def steps(self) -> int:
        """Number of steps of the whole run."""
        ...

    @property
    def every(self) -> int:
        """Steps between log entries and states."""
        ...


class Trainer(Protocol):
    """A run that advances step by step.

    Attributes:
        step: next step of the schedule.
    """

    step: int

    def train_step(self, step: int) -> dict[str, float] | None:
        """One step of the optimiser; its losses by name, None if the gradient isn't finite."""
        ...

    def save_entry(self, means: dict[str, float], speed: float, skipped: int) -> None:
        """Log the mean losses since the last entry, and write the state."""
        ...

    def any_process(self, flag: bool) -> bool:
        """True if ``flag`` is true in any process of the run."""
        ...


def run_steps(
    trainer: Trainer, schedule: Schedule, seconds: float, progress: Progress
) -> dict[str, float]:
    """Train until the schedule or the time ends; returns the means of the last log entry."""
    began, first = time.monotonic(), trainer.step
    losses: dict[str, list[float]] = {}
    means: dict[str, float] = {}
    skipped = 0
    for step in range(first, schedule.steps):
        found = trainer.train_step(step)
        skipped += found is None
        for name, value in (found or {}).items():
            losses.setdefault(name, []).append(value)
        trainer.step = step + 1
        elapsed = time.monotonic() - began
        speed = (trainer.step - first) * schedule.batch / elapsed
        loss = losses["loss"][-1] if "loss" in losses else math.nan
        progress(
            trainer.step / schedule.steps,
            f"step {trainer.step} of {schedule.steps}, loss {loss:.3f}, {speed:.3g} objects/s",
        )
        stop = trainer.any_process(elapsed > seconds) or trainer.step == schedule.steps
        if stop or trainer.step % schedule.every == 0:
            means = {name: float(np.mean(values)) for name, values in losses.items()}
            trainer.save_entry(means, speed, skipped)
            losses, skipped = {}, 0
        if stop:
            break
    return means


def rate(schedule: Schedule, step: int) -> float:
    """Learning rate at ``step``: linear warm-up, then a cosine to a twentieth."""
    if step < schedule.warmup:
        return schedule.learning_rate * (step + 1) / schedule.warmup
    done = (step - schedule.warmup) / max(1, schedule.steps - schedule.warmup)
    return schedule.learning_rate * (0.05 + 0.95 * (1 + math.cos(math.pi * done)) / 2)


def set_rate(optimizer: torch.optim.Optimizer, schedule: Schedule, step: int) -> None:
    """Give the optimiser the learning rate of ``step``."""
    for group in optimizer.param_groups:
        group["lr"] = rate(schedule, step)


def append_entry(out: Path, entry: dict[str, float]) -> None:
    """Append an entry to a run's log, and to TensorBoard if it is installed."""
    with (out / LOG).open("a") as log:
        log.write(json.dumps(entry) + "\n")
    if importlib.util.find_spec("tensorboard") is None:
        return
    from torch.utils.tensorboard import SummaryWriter

    with SummaryWriter(str(out / "tensorboard")) as writer:
        for key, value in entry.items():
            name = key
            for group in ("valid", "held out"):
                name = name.replace(f"{group} ", f"{group}/")
            writer.add_scalar(name, value, int(entry["step"]))


def same_config(config: dict[str, Any], out: Path, *, free: Collection[str] = ()) -> None:
    """Write a run's configuration into its folder, or compare it with the one that is there.

    Args:
        config: as JSON values. out: folder of the run.
        free: names that may differ from slice to slice.

    Raises:
        ConfigurationError: if the folder belongs to another run.
    """
    path = out / CONFIG
    mine = json.loads(json.dumps(config))
    if path.exists():
        there = json.loads(path.read_text())
        differ = sorted(k for k in {*mine, *there} - {*free} if mine.get(k) != there.get(k))
        if differ:
            raise ConfigurationError(
                f"{path} belongs to another run ({', '.join(differ)} differ): choose another folder"
            )
    path.write_text(json.dumps(mine, indent=1))
