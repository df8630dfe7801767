"""What a training run is made of; presets are values."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

from model.core.errors import ConfigurationError
from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.language_model import DecoderConfig
from model.prediction.arti4urdf.network import ModelConfig
from model.training.arti4urdf.batches import Augmentation
from model.training.arti4urdf.full_config import full_presets

HALF = DecoderConfig(v.SIZE, 96, 256, 3, 3, 1, head_dim=32)


@dataclass(frozen=True)
class TrainingConfig:
    """One run of the small model.

    Attributes:
        model: sizes. augmentation: how samples are varied.
        batch: objects a step. learning_rate: at its peak; warmup: steps until then, after which it
            falls along a cosine to a twentieth.
        steps: of the whole schedule. weight_decay: of matrices.
        seed: of the weights and of the order of the samples.
        average: decay of the moving average of the weights, which is what is saved for use.
        every: steps between validations and checkpoints.
        bfloat16: forward in bfloat16, weights in float32.
        threads: of the CPU; 0 leaves it to torch.
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

    def to_json(self) -> dict[str, Any]:
        """As nested dictionaries."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> TrainingConfig:
        """From what :meth:`to_json` gave."""
        rest = {k: x for k, x in data.items() if k not in ("model", "augmentation")}
        return cls(
            ModelConfig.from_json(data["model"]), Augmentation(**data["augmentation"]), **rest
        )


CONFIDENCE = "confidence"
"""Preset that fits no network but the predictors' confidence."""


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
    """The preset called ``name``.

    Raises:
        ConfigurationError: where there is none, naming those that are there.
    """
    found = presets()
    if name not in found:
        known = ", ".join([*found, *full_presets(), CONFIDENCE])
        raise ConfigurationError(f"no preset {name!r}; there are {known}")
    return found[name]
