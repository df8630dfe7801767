"""Checkpoint folders of the small model: weights, configuration, vocabulary, record."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from model.core.checkpoints import strict_load
from model.core.errors import InputFileError
from model.core.files import static_assets
from model.prediction.arti4urdf import vocabulary
from model.prediction.arti4urdf.checkpoints import from_config, load_checkpoint, save_checkpoint
from model.prediction.arti4urdf.network import ArtiModel, ModelConfig

SHIPPED = static_assets() / "arti4urdf"
"""The weights that come with the repository."""


def vocabulary_hash() -> str:
    """Fingerprint of the vocabulary that weights depend on."""
    return hashlib.sha256("\n".join(vocabulary.TOKENS).encode()).hexdigest()[:16]


def save_weights(
    model: ArtiModel, folder: Path, *, version: str, record: Mapping[str, Any] | None = None
) -> None:
    """Write the folder: matrices in bfloat16, and ``record`` (training, scores).

    Raises:
        InputFileError: if the folder can't be written.
    """
    config = {
        "version": version,
        "vocabulary": vocabulary_hash(),
        "model": asdict(model.config),
        "record": dict(record or {}),
    }
    save_checkpoint(folder, config, model.state_dict())


def load_weights(folder: Path = SHIPPED) -> tuple[ArtiModel, str]:
    """The model in evaluation mode, and its version.

    Raises:
        InputFileError: if a file is absent or damaged, or has another vocabulary.
    """
    found = load_checkpoint(folder)
    path = folder / "config.json"
    if found.config.get("vocabulary") != vocabulary_hash():
        raise InputFileError(
            path,
            "the weights were trained with another vocabulary",
            "train again with this version, or use the version that made them",
        )
    model = ArtiModel(from_config(ModelConfig, found.config.get("model"), path))
    strict_load(model, found.state, path)
    return model.float().eval(), str(found.config.get("version", ""))
