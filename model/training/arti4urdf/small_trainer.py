"""Training of the small model: resumable at any step, on a CPU or a GPU."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from torch.nn.attention import SDPBackend, sdpa_kernel

from model.core import codec
from model.core.errors import ConfigurationError
from model.core.files import draft_of
from model.core.progress import Progress, no_progress
from model.prediction.arti4urdf.network import ArtiModel, save_weights
from model.training.arti4urdf.batches import (
    PLAIN,
    Batch,
    augmented,
    batch_loss,
    by_kind,
    collate,
    teacher_forced,
)
from model.training.arti4urdf.config import (
    CONFIG,
    LOG,
    TrainingConfig,
    append_entry,
    run_steps,
    same_config,
    set_rate,
)
from model.training.arti4urdf.samples import (
    Sample,
    read_shard,
)

STATE = "state.pt"
POOL = 8
"""Batches that are drawn together, so that objects of similar size share one."""
VALIDATION = 200
"""Most objects of a validation set."""


class Shards:
    """The samples of a folder; shards that appear later are read at the next refresh."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._read: set[Path] = set()
        self.samples: list[Sample] = []
        self.refresh()

    def refresh(self) -> None:
        """Read new shards.

        Raises:
            ConfigurationError: if there is no sample.
        """
        for path in sorted(self.folder.glob("[!.]*.npz")):
            if path not in self._read:
                self._read.add(path)
                self.samples += read_shard(path)
        if not self.samples:
            raise ConfigurationError(f"{self.folder} has no shards (*.npz): make some first")


def _batches(shards: Shards, config: TrainingConfig, start: int) -> Iterator[Batch]:
    """Batches from step ``start`` on; each pool draws from the samples that are read by then."""
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
        yield collate([teacher_forced(*pair, rng, json_step=json_step) for pair in varied])


class _SmallTrainer:
    """A run of the small model; see :class:`model.training.arti4urdf.config.Trainer`."""

    def __init__(
        self, config: TrainingConfig, data: Path, out: Path, validation: dict[str, Path | None]
    ) -> None:
        device = "cuda" if torch.cuda.is_available() else "cpu"
        self.config, self.out, self.step = config, out, 0
        self.model = ArtiModel(config.model).to(device)
        self.average = ArtiModel(config.model).to(device)
        self.average.load_state_dict(self.model.state_dict())
        groups = [
            {
                "params": [p for p in self.model.parameters() if p.ndim > 1],
                "weight_decay": config.weight_decay,
            },
            {"params": [p for p in self.model.parameters() if p.ndim <= 1], "weight_decay": 0.0},
        ]
        self.optimizer = torch.optim.AdamW(groups, lr=config.learning_rate, betas=(0.9, 0.98))
        if (out / STATE).exists():
            self._load()
        self.shards = Shards(data)
        json_step = config.model.json_step
        self.validation = {k: _validation(x, json_step) for k, x in validation.items()}
        self.batches = _batches(self.shards, config, self.step)

    def train_step(self, step: int) -> dict[str, float] | None:
        """See the protocol."""
        config, batch = self.config, next(self.batches)
        self.model.train()
        set_rate(self.optimizer, config, step)
        # For sequences this short the fused kernels are slower than plain products.
        with sdpa_kernel(SDPBackend.MATH):
            with torch.autocast(self.model.device.type, torch.bfloat16, enabled=config.bfloat16):
                loss = batch_loss(self.model, batch)
            self.optimizer.zero_grad(set_to_none=True)
            loss.total.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.model.parameters(), 1.0)
        if not bool(torch.isfinite(norm)):
            return None
        self.optimizer.step()
        decay = min(config.average, (step + 1) / (step + 10))
        with torch.no_grad():
            pairs = zip(self.average.parameters(), self.model.parameters(), strict=True)
            for mean, new in pairs:
                mean.lerp_(new, 1 - decay)
        return {**by_kind(loss.kinds, loss.losses), "loss": float(loss.total.detach())}

    def save_entry(self, means: dict[str, float], speed: float, skipped: int) -> None:
        """See the protocol."""
        entry = {k: round(mean, 4) for k, mean in means.items()}
        if skipped:
            entry["skipped"] = skipped
        entry |= {"step": self.step, "samples": len(self.shards.samples), "speed": round(speed, 1)}
        for name, batches in self.validation.items():
            entry |= {f"{name} {k}": x for k, x in _accuracy(self.average, batches).items()}
        append_entry(self.out, entry)
        state = {
            "model": self.model.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "step": self.step,
        }
        with draft_of(self.out / STATE) as draft:
            torch.save(state, draft)
        self.shards.refresh()

    def any_process(self, flag: bool) -> bool:
        """See the protocol; there is one process."""
        return flag

    def _load(self) -> None:
        state = torch.load(self.out / STATE, weights_only=True, map_location=self.model.device)
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
    """Train, or resume where the last slice ended.

    Args:
        config: the run; it is written beside the state and must not change between slices.
        data: folder of shards, read again at each log entry. validation: of other objects.
            held_out: of other families.
        out: folder of the run. seconds: stop (and save) after this long.

    Returns:
        The folder of the run.

    Raises:
        ConfigurationError: if ``out`` holds a run of another configuration, or data is missing.
    """
    out.mkdir(parents=True, exist_ok=True)
    same_config(asdict(config), out)
    if config.threads:
        torch.set_num_threads(config.threads)
    torch.manual_seed(config.seed)
    trainer = _SmallTrainer(config, data, out, {"valid": validation, "held out": held_out})
    run_steps(trainer, config, seconds, progress)
    return out


def export_weights(run: Path, folder: Path, *, version: str) -> None:
    """Write a run's averaged weights for use, with its configuration and last log entry.

    Raises:
        ConfigurationError: if ``run`` holds no state.
    """
    if not (run / STATE).exists():
        raise ConfigurationError(f"{run} holds no training state ({STATE}): train first")
    values = json.loads((run / CONFIG).read_text())
    config = codec.read(TrainingConfig, values, str(run / CONFIG))
    state = torch.load(run / STATE, weights_only=True, map_location="cpu")
    model = ArtiModel(config.model)
    model.load_state_dict(state["average"])
    lines = (run / LOG).read_text().splitlines()
    del values["model"]
    record = {"training": values, "log": json.loads(lines[-1]) if lines else {}}
    save_weights(model, folder, version=version, record=record)


def _validation(folder: Path | None, json_step: bool) -> list[Batch]:
    """Batches of a validation set, not augmented."""
    if folder is None:
        return []
    rng = np.random.default_rng(0)
    pairs = [augmented(s, PLAIN, rng) for s in Shards(folder).samples[:VALIDATION]]
    examples = [teacher_forced(*pair, rng, json_step=json_step) for pair in pairs]
    return [collate(examples[k : k + 32]) for k in range(0, len(examples), 32)]


@torch.no_grad()
def _accuracy(model: ArtiModel, batches: list[Batch]) -> dict[str, float]:
    """Share of correct choices by kind."""
    if not batches:
        return {}
    model.eval()
    losses = [batch_loss(model, batch) for batch in batches]
    kinds = np.concatenate([loss.kinds for loss in losses])
    hits = by_kind(kinds, torch.cat([loss.hits for loss in losses]))
    return {kind: round(share, 4) for kind, share in hits.items()}
