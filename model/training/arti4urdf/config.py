"""Configurations of training runs, and the loop of both models: schedule, resumable slices, log.

Presets are values.
"""

from __future__ import annotations

import importlib.util
import json
import math
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch

from model.core import codec
from model.core.errors import ConfigurationError, InputFileError
from model.core.packages import install_command
from model.core.progress import Progress
from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.checkpoints import read_qwen3_config
from model.prediction.arti4urdf.language_model import QWEN3, DecoderConfig
from model.prediction.arti4urdf.network import ModelConfig
from model.training.arti4urdf.batches import Augmentation

HALF = DecoderConfig(v.SIZE, 96, 256, 3, 3, 1, head_dim=32)


@dataclass(frozen=True)
class TrainingConfig:
    """One run of the small model.

    Attributes:
        model: sizes. augmentation: of the samples.
        batch: objects per step. learning_rate: at its peak; warmup: steps until then, after which
            it falls along a cosine to a twentieth.
        steps: of the whole schedule. weight_decay: of matrices.
        seed: random seed of the weights and of the order of the samples.
        average: decay of the moving average of the weights, which is saved for use.
        every: steps between validations and states.
        bfloat16: forward in bfloat16, weights in float32.
        threads: of the CPU; 0 for torch's default.
    """

    model: ModelConfig = field(default_factory=ModelConfig)
    augmentation: Augmentation = field(default_factory=Augmentation)
    batch: int = 32
    learning_rate: float = 1e-3
    warmup: int = 200
    steps: int = 3300
    weight_decay: float = 0.03
    seed: int = 0
    average: float = 0.995
    every: int = 250
    bfloat16: bool = True
    threads: int = 0


SIZES = tuple(QWEN3)
_NEEDED = ("transformers", "tokenizers", "accelerate")
_WHOLE = (
    "samples", "epochs", "batch", "warmup", "longest", "points", "groups", "neighbours", "every",
)  # fmt: skip
_SHARES = ("nameless", "forgotten", "test_share")
LORA_RANK, LORA_RATE = 16, 1e-4
"""Rank and learning rate of ``--lora``: low-rank updates tolerate a larger rate."""


@dataclass(frozen=True)
class FullConfig:
    """One run of the paper-size model; the defaults are the paper's recipe.

    Attributes:
        size: of Qwen3, one of :data:`SIZES`; "" for that of the folder.
        samples: procedural objects. epochs: times that every object is drawn; steps: optimiser
            steps, 0 for those of the epochs.
        batch: objects per step over all processes, one at a time on each (the paper: one per GPU
            on eight GPUs). Neither result nor order depend on the number of processes.
        learning_rate: of Adam at its peak; warmup: steps until then, after which it falls along a
            cosine to a twentieth.
        lora_rank: of low-rank updates; 0 trains every weight of the language model.
        bfloat16: compute in bfloat16, weights in float32. checkpointing: trade time for memory.
        seed: random seed of weights, objects, their order and variations.
        longest: tokens of prompt and answer; longer samples are left out.
        structure: describe the parts' geometric relations in the prompt.
        nameless: share of samples without any name. forgotten: probability that a single category
            or name is hidden in the others.
        points, groups, neighbours: of each cloud, as ULIP-2 was trained.
        every: steps between states, log entries and validations. validation: objects of each.
        held_out: also train on the paper's five held-out categories.
        test_share: share of a data set that is left out, as ``artiworld evaluate --split
            test:SHARE`` scores it.
    """

    size: str = ""
    samples: int = 8000
    epochs: int = 20
    steps: int = 0
    batch: int = 8
    learning_rate: float = 1e-5
    warmup: int = 100
    lora_rank: int = 0
    bfloat16: bool = True
    checkpointing: bool = True
    seed: int = 0
    longest: int = 8192
    structure: bool = True
    nameless: float = 0.3
    forgotten: float = 0.1
    points: int = 10_000
    groups: int = 512
    neighbours: int = 32
    every: int = 250
    validation: int = 32
    held_out: bool = False
    test_share: float = 0.0

    def __post_init__(self) -> None:
        for name in _WHOLE:
            if getattr(self, name) < 1:
                raise ConfigurationError(f"{name} must be 1 or more, got {getattr(self, name)}")
        for name in ("steps", "lora_rank", "validation", "seed"):
            if getattr(self, name) < 0:
                raise ConfigurationError(f"{name} must be 0 or more, got {getattr(self, name)}")
        for name in _SHARES:
            if not 0 <= getattr(self, name) < 1:
                raise ConfigurationError(f"{name} is a share of 0..1, got {getattr(self, name)}")
        if self.learning_rate <= 0:
            raise ConfigurationError(f"learning_rate must be above 0, got {self.learning_rate}")
        if self.size not in ("", *SIZES):
            raise ConfigurationError(f"no size {self.size!r}; there are {', '.join(SIZES)}")


def full_presets() -> dict[str, FullConfig]:
    """Name → configuration; ``qwen3`` takes a folder of any size, ``paper`` is Qwen3-8B."""
    out = {f"qwen3-{size}": FullConfig(size=size) for size in SIZES[:-1]}
    return {**out, "paper": FullConfig(size=SIZES[-1]), "qwen3": FullConfig()}


def with_settings(config: FullConfig, settings: Sequence[str]) -> FullConfig:
    """``config`` with settings of the form ``NAME=VALUE``, with values in JSON.

    Raises:
        ConfigurationError: for an unknown name or a value of another kind.
    """
    for setting in settings:
        name, equals, text = setting.partition("=")
        known = [f.name for f in fields(FullConfig) if f.name != "size"]
        if not equals or name not in known:
            raise ConfigurationError(
                f"--set {setting!r}: write NAME=VALUE; names are {', '.join(known)}"
            )
        try:
            value: Any = json.loads(text)
            read = codec.read_fields(FullConfig, {name: value}, "--set")
        except ValueError as error:  # of JSON, or of the codec
            raise ConfigurationError(f"--set {setting!r}: {error}") from error
        config = replace(config, **read)
    return config


def require_extras(config: FullConfig) -> None:
    """Check the packages that training needs.

    Raises:
        ConfigurationError: naming the missing ones.
    """
    needed = (*_NEEDED, "peft") if config.lora_rank else _NEEDED
    missing = [name for name in needed if importlib.util.find_spec(name) is None]
    if missing:
        raise ConfigurationError(
            f"training this model needs {', '.join(missing)}: {install_command('artiworld[train]')}"
        )


def check_size(config: FullConfig, folder: Path) -> None:
    """Check that a Qwen3 folder has the preset's size.

    Raises:
        InputFileError: if it has another size, or isn't one of Qwen3.
    """

    def shape(size: Any) -> tuple[int, ...]:
        return size.hidden_size, size.intermediate_size, size.layers, size.heads, size.kv_heads

    found = shape(read_qwen3_config(folder))
    if not config.size or found == shape(QWEN3[config.size]):
        return
    names = [name for name, other in full_presets().items() if other.size]
    preset = next((n for n in names if shape(QWEN3[full_presets()[n].size]) == found), "qwen3")
    raise InputFileError(
        folder / "config.json",
        f"has {found[2]} layers of width {found[0]}, unlike Qwen3-{config.size.upper()}",
        f"give a folder of that size, or --preset {preset} for this one",
    )


CONFIDENCE = "confidence"
"""Preset that fits the predictors' confidence instead of a network."""


def presets() -> dict[str, TrainingConfig]:
    """Name → configuration of the small model and its ablations."""
    nano = TrainingConfig()
    return {
        "nano": nano,
        "nano-no-structure": replace(nano, model=replace(nano.model, structure_prompt=False)),
        "nano-no-global": replace(nano, model=replace(nano.model, global_token=False)),
        "nano-no-json": replace(nano, model=replace(nano.model, json_step=False)),
        "nano-half": replace(nano, model=replace(nano.model, decoder=HALF)),
    }


def preset(name: str) -> TrainingConfig:
    """The preset of the small model called ``name``.

    Raises:
        ConfigurationError: if there is none.
    """
    found = presets()
    if name not in found:
        known = ", ".join([*found, *full_presets(), CONFIDENCE])
        raise ConfigurationError(f"no preset {name!r}; there are {known}")
    return found[name]


LOG = "log.jsonl"
CONFIG = "config.json"


Schedule = TrainingConfig | FullConfig


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
