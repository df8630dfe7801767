"""ArtiWorld's checkpoint folders.

A checkpoint is a folder of two files: ``config.json`` (with a format number) and
``weights.safetensors``.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import torch
from safetensors import SafetensorError
from safetensors.torch import save_file
from torch import Tensor

from model.core import codec
from model.core.checkpoints import read_safetensors
from model.core.errors import InputFileError
from model.core.files import draft_of

FORMAT = 1
CONFIG_FILE = "config.json"
WEIGHTS_FILE = "weights.safetensors"
MAX_CONFIG_BYTES = 50_000_000

D = TypeVar("D")


@dataclasses.dataclass(frozen=True, eq=False)
class Checkpoint:
    """The contents of a checkpoint folder.

    Attributes:
        folder: of the files. config: ``config.json`` without the format.
        state: tensors by name.
    """

    folder: Path
    config: Mapping[str, Any]
    state: Mapping[str, Tensor]


def save_checkpoint(
    folder: Path,
    config: Mapping[str, Any],
    state: Mapping[str, Tensor],
    *,
    dtype: torch.dtype = torch.bfloat16,
) -> None:
    """Write a checkpoint folder; each file appears whole or not at all.

    Matrices are written as ``dtype``; vectors (norms, biases) keep their precision. Tensors that
    share memory are written separately.

    Raises:
        InputFileError: if the folder can't be written.
    """
    small = {
        name: (value.to(dtype) if value.is_floating_point() and value.ndim > 1 else value)
        .detach()
        .cpu()
        .contiguous()
        .clone()
        for name, value in state.items()
    }
    text = json.dumps({"format": FORMAT, **config}, indent=2, ensure_ascii=False, allow_nan=False)
    try:
        with draft_of(folder / WEIGHTS_FILE) as weights:
            save_file(small, weights, metadata={"format": "pt"})
        with draft_of(folder / CONFIG_FILE) as draft:
            draft.write_text(text + "\n")
    except (OSError, SafetensorError) as error:
        raise InputFileError(folder, f"the checkpoint can't be written: {error}") from error


def load_checkpoint(folder: Path) -> Checkpoint:
    """Read what :func:`save_checkpoint` wrote.

    Raises:
        InputFileError: if a file is absent, damaged or of a newer format.
    """
    path = folder / CONFIG_FILE
    config = read_json(path)
    found = config.pop("format", None)
    if found != FORMAT:
        raise InputFileError(
            path, f"checkpoint format {found!r}", f"this version reads format {FORMAT}"
        )
    return Checkpoint(folder, config, read_safetensors(folder / WEIGHTS_FILE))


def read_json(path: Path) -> dict[str, Any]:
    """The JSON object in a file.

    Raises:
        InputFileError: if the file is absent, huge or no JSON object.
    """
    try:
        if path.stat().st_size > MAX_CONFIG_BYTES:
            raise InputFileError(path, "is far too large for a configuration")
        value = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputFileError(path, f"can't be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise InputFileError(path, f"is not JSON ({error})") from error
    if not isinstance(value, dict):
        raise InputFileError(path, "is not a JSON object")
    return value


def from_config(kind: type[D], values: object, path: Path) -> D:
    """A configuration from the values of ``dataclasses.asdict``.

    Raises:
        InputFileError: if a value is missing, unknown or invalid.
    """
    try:
        return codec.read(kind, values, kind.__name__)
    except ValueError as error:  # of the codec, or of the class
        raise InputFileError(path, str(error)) from error
