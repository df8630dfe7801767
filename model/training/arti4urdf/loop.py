"""The training loop of the small model: resumable at any step, on a CPU or a GPU machine."""

from __future__ import annotations

import importlib.util
import json
import math
import time
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from torch.nn.attention import SDPBackend, sdpa_kernel

from model.core.errors import ConfigurationError
from model.core.progress import Progress, no_progress
from model.prediction.arti4urdf.network import ArtiModel
from model.prediction.arti4urdf.weights import save_weights
from model.training.arti4urdf.batches import PLAIN, Batch, augmented, collate, teacher_forced
from model.training.arti4urdf.config import TrainingConfig
from model.training.arti4urdf.loss import batch_loss, by_kind
from model.training.arti4urdf.samples import Sample, read_shard

STATE = "state.pt"
LOG = "log.jsonl"
CONFIG = "config.json"


class Shards:
    """Samples of a folder of shards; files that appear later are read when they are there."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._read: set[Path] = set()
        self.samples: list[Sample] = []

    def refresh(self) -> int:
        """Read what is new; gives the number of samples.

        Raises:
            ConfigurationError: where there is nothing to train on.
        """
        for path in sorted(self.folder.glob("*.npz")):
            if path not in self._read:
                self._read.add(path)
                self.samples += read_shard(path)
        if not self.samples:
            raise ConfigurationError(f"{self.folder} has no shards (*.npz): make some first")
        return len(self.samples)


POOL = 8
"""Batches that are drawn together, so that objects of like size can share one."""


def _batches(shards: Shards, config: TrainingConfig, start: int) -> Iterator[tuple[int, Batch]]:
    """Batches from step ``start`` on; each pool draws from what the shards hold by then."""
    pool: list[list[Sample]] = []
    for step in range(start, config.steps):
        if not pool or step % POOL == 0:
            draw = np.random.default_rng([config.seed, step // POOL])
            picks = draw.integers(len(shards.samples), size=config.batch * POOL)
            drawn = sorted((shards.samples[int(k)] for k in picks), key=lambda s: len(s.arrays))
            pool = [drawn[k * config.batch : (k + 1) * config.batch] for k in range(POOL)]
            pool = [pool[int(k)] for k in draw.permutation(POOL)]
        rng = np.random.default_rng([config.seed, step, 1])
        chosen = pool[step % POOL]
        varied = [augmented(s, config.augmentation, rng) for s in chosen]
        json_step = config.model.json_step
        yield step, collate([teacher_forced(*pair, rng, json_step=json_step) for pair in varied])


class Schedule(Protocol):
    """What the learning rate follows from; see :class:`TrainingConfig`."""

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
        """Of the whole run."""
        ...


def rate(config: Schedule, step: int) -> float:
    """Learning rate at ``step``."""
    if step < config.warmup:
        return config.learning_rate * (step + 1) / config.warmup
    done = (step - config.warmup) / max(1, config.steps - config.warmup)
    return config.learning_rate * (0.05 + 0.95 * (1 + math.cos(math.pi * done)) / 2)


@dataclass(eq=False)
class _Run:
    """Everything that is saved between slices."""

    model: ArtiModel
    average: ArtiModel
    optimizer: torch.optim.Optimizer
    step: int = 0

    def save(self, folder: Path) -> None:
        """Write the state; it appears whole or not at all."""
        part = folder / (STATE + ".part")
        torch.save(
            {
                "model": self.model.state_dict(),
                "average": self.average.state_dict(),
                "optimizer": self.optimizer.state_dict(),
                "step": self.step,
            },
            part,
        )
        part.replace(folder / STATE)

    def load(self, folder: Path) -> None:
        """Go on from what :meth:`save` wrote."""
        state = torch.load(folder / STATE, weights_only=True, map_location=self.model.device)
        self.model.load_state_dict(state["model"])
        self.average.load_state_dict(state["average"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.step = int(state["step"])


def train(
    config: TrainingConfig,
    data: Path,
    out: Path,
    *,
    validation: Path | None = None,
    held_out: Path | None = None,
    seconds: float = math.inf,
    progress: Progress = no_progress,
) -> Path:
    """Train, or go on where the last slice ended.

    Args:
        config: the run; it is written beside the checkpoint and must not change between slices.
        data: folder of shards, read again at each validation. validation: the same, of
            objects that are not trained on; held_out: of families that are not.
        out: folder of the run. seconds: stop (and save) after this long.

    Returns:
        The folder.

    Raises:
        ConfigurationError: where ``out`` holds a run of another configuration, or no data is there.
    """
    out.mkdir(parents=True, exist_ok=True)
    same_config(config.to_json(), out)
    if config.threads:
        torch.set_num_threads(config.threads)
    torch.manual_seed(config.seed)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    run = _begin(config, device)
    if (out / STATE).exists():
        run.load(out)
    shards = Shards(data)
    shards.refresh()
    sets = {"valid": validation, "held out": held_out}
    checks = {k: _validation(x, config.model.json_step) for k, x in sets.items()}
    end = time.monotonic() + seconds
    sums: dict[str, list[float]] = {}
    began, first = time.monotonic(), run.step
    for step, batch in _batches(shards, config, run.step):
        loss = _step(run, config, step, batch)
        for kind, value in loss.items():
            sums.setdefault(kind, []).append(value)
        run.step = step + 1
        speed = (run.step - first) * config.batch / (time.monotonic() - began)
        progress(run.step / config.steps, f"step {run.step}, {speed:.0f} objects/s")
        stop = time.monotonic() > end or run.step == config.steps
        if stop or run.step % config.every == 0:
            entry = {k: round(float(np.mean(x)), 4) for k, x in sums.items()}
            sums = {}
            entry |= {"step": run.step, "samples": len(shards.samples), "speed": round(speed, 1)}
            for name, batches in checks.items():
                entry |= {f"{name} {k}": x for k, x in _score(run.average, batches).items()}
            with (out / LOG).open("a") as log:
                log.write(json.dumps(entry) + "\n")
            to_board(out, entry)
            run.save(out)
            shards.refresh()
        if stop:
            break
    return out


def to_board(out: Path, entry: dict[str, float]) -> None:
    """A log entry for TensorBoard, where it is installed."""
    if importlib.util.find_spec("tensorboard") is None:
        return
    from torch.utils.tensorboard import SummaryWriter

    with SummaryWriter(str(out / "tensorboard")) as writer:
        for key, value in entry.items():
            name = key
            for group in ("valid", "held out"):
                name = name.replace(f"{group} ", f"{group}/")
            writer.add_scalar(name, value, int(entry["step"]))


def export_weights(run: Path, folder: Path, *, version: str) -> None:
    """Write a run's averaged weights for use, with its configuration and last log entry.

    Raises:
        ConfigurationError: where ``run`` holds no state.
    """
    if not (run / STATE).exists():
        raise ConfigurationError(f"{run} holds no training state ({STATE}): train first")
    config = TrainingConfig.from_json(json.loads((run / CONFIG).read_text()))
    state = torch.load(run / STATE, weights_only=True, map_location="cpu")
    model = ArtiModel(config.model)
    model.load_state_dict(state["average"])
    lines = (run / LOG).read_text().splitlines()
    record = {"training": config.to_json(), "log": json.loads(lines[-1]) if lines else {}}
    del record["training"]["model"]
    save_weights(model, folder, version=version, record=record)


def same_config(config: dict[str, Any], out: Path, *, free: Collection[str] = ()) -> None:
    """Write a run's configuration into its folder, or compare it with what is there.

    Args:
        config: as JSON values. out: folder of the run.
        free: names that may differ from slice to slice.

    Raises:
        ConfigurationError: where the folder belongs to another run.
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


def _begin(config: TrainingConfig, device: str) -> _Run:
    model, average = ArtiModel(config.model).to(device), ArtiModel(config.model).to(device)
    average.load_state_dict(model.state_dict())
    matrices = [p for p in model.parameters() if p.ndim > 1]
    others = [p for p in model.parameters() if p.ndim <= 1]
    groups = [
        {"params": matrices, "weight_decay": config.weight_decay},
        {"params": others, "weight_decay": 0.0},
    ]
    optimizer = torch.optim.AdamW(groups, lr=config.learning_rate, betas=(0.9, 0.98))
    return _Run(model, average, optimizer)


def _step(run: _Run, config: TrainingConfig, step: int, batch: Batch) -> dict[str, float]:
    run.model.train()
    for group in run.optimizer.param_groups:
        group["lr"] = rate(config, step)
    # The fused kernels are slower than plain products on sequences this short.
    with sdpa_kernel(SDPBackend.MATH):
        with torch.autocast(run.model.device.type, torch.bfloat16, enabled=config.bfloat16):
            loss = batch_loss(run.model, batch)
        run.optimizer.zero_grad(set_to_none=True)
        loss.total.backward()
    norm = torch.nn.utils.clip_grad_norm_(run.model.parameters(), 1.0)
    if not bool(torch.isfinite(norm)):
        return {"skipped": 1.0}  # one bad sample must not end the run
    run.optimizer.step()
    decay = min(config.average, (step + 1) / (step + 10))
    with torch.no_grad():
        for mean, new in zip(run.average.parameters(), run.model.parameters(), strict=True):
            mean.lerp_(new, 1 - decay)
    out = by_kind(loss.kinds, loss.losses)
    out["loss"] = float(loss.total.detach())
    return out


def _validation(folder: Path | None, json_step: bool, most: int = 200) -> list[Batch]:
    """Held-out batches, as they are: no turns, all cues."""
    if folder is None:
        return []
    shards = Shards(folder)
    shards.refresh()
    rng = np.random.default_rng(0)
    pairs = [augmented(s, PLAIN, rng) for s in shards.samples[:most]]
    examples = [teacher_forced(*pair, rng, json_step=json_step) for pair in pairs]
    return [collate(examples[k : k + 32]) for k in range(0, len(examples), 32)]


@torch.no_grad()
def _score(model: ArtiModel, batches: list[Batch]) -> dict[str, float]:
    """Share of decisions that are right, by kind."""
    model.eval()
    hits: dict[str, list[float]] = {}
    for batch in batches:
        loss = batch_loss(model, batch)
        for kind in np.unique(loss.kinds):
            hits.setdefault(str(kind), []).extend(loss.hits.double().numpy()[loss.kinds == kind])
    return {k: round(float(np.mean(x)), 4) for k, x in hits.items()}
