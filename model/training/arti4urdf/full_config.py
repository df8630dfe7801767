"""What a training run of the paper-size model is made of; presets are values."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from model.core import codec
from model.core.errors import ConfigurationError, InputFileError
from model.core.installing import install_command

SIZES = ("0.6b", "1.7b", "4b", "8b")
_NEEDED = ("transformers", "tokenizers", "accelerate")
_WHOLE = (
    "samples", "epochs", "batch", "warmup", "longest", "points", "groups", "neighbours", "every",
)  # fmt: skip
_SHARES = ("nameless", "forgotten", "test_share")
LORA_RANK, LORA_RATE = 16, 1e-4
"""What ``--lora`` sets: small updates bear a larger rate."""


@dataclass(frozen=True)
class FullConfig:
    """One run of the paper-size model; the defaults are the paper's recipe.

    Attributes:
        size: of Qwen3, one of :data:`SIZES`; "" takes whatever the folder holds.
        samples: procedural objects. epochs: times that every object is drawn; steps: the same in
            optimiser steps, 0 for as many as the epochs take.
        batch: objects a step over all processes, one of them at a time on each (the paper: one a
            GPU on eight GPUs). Neither result nor order depend on the number of processes.
        learning_rate: of Adam at its peak; warmup: steps until then, after which it falls along a
            cosine to a twentieth.
        lora_rank: of low-rank updates; 0 trains every weight of the language model.
        bfloat16: compute in bfloat16, master weights in float32. checkpointing: trade time for
            memory.
        seed: of weights, objects, their order and variations.
        longest: tokens of prompt and answer; longer samples are left out.
        structure: the parts' geometric relations in words are part of the prompt.
        nameless: share of samples without any name; forgotten: chance that a single word (category
            or name of a part) is hidden in the others.
        points, groups, neighbours: of each cloud; ULIP-2 was trained with these.
        every: steps between states, log entries and validations. validation: objects of each.
        held_out: train on the paper's five held-out categories too.
        test_share: share of a data set that ``artiworld evaluate --split test:SHARE`` scores and
            that is therefore left out.
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
    """``config`` with settings of the form ``NAME=VALUE``, the value as in JSON.

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
    """Raise where a package that training needs isn't installed.

    Raises:
        ConfigurationError: naming them.
    """
    needed = (*_NEEDED, "peft") if config.lora_rank else _NEEDED
    missing = [name for name in needed if importlib.util.find_spec(name) is None]
    if missing:
        raise ConfigurationError(
            f"training this model needs {', '.join(missing)}: {install_command('artiworld[train]')}"
        )


def check_size(config: FullConfig, folder: Path) -> None:
    """Raise where a Qwen3 folder isn't of the preset's size.

    Raises:
        InputFileError: naming both sizes, or where the folder is none of Qwen3.
    """
    from model.prediction.arti4urdf.language_model import QWEN3
    from model.prediction.arti4urdf.published_weights import read_qwen3_config

    def shape(size: Any) -> tuple[int, ...]:
        return size.hidden_size, size.intermediate_size, size.layers, size.heads, size.kv_heads

    found = shape(read_qwen3_config(folder))
    if not config.size or found == shape(QWEN3[config.size]):
        return
    names = [name for name, other in full_presets().items() if other.size]
    preset = next((n for n in names if shape(QWEN3[full_presets()[n].size]) == found), "qwen3")
    raise InputFileError(
        folder / "config.json",
        f"has {found[2]} layers of width {found[0]}, which isn't Qwen3-{config.size.upper()}",
        f"give a folder of that size, or --preset {preset} for this one",
    )
