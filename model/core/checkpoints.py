"""Strict reading of published weights; nothing here imports torch at its top."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from model.core.errors import InputFileError


def read_safetensors(path: Path) -> dict[str, Any]:
    """All tensors of a safetensors file by name, on the CPU.

    Raises:
        InputFileError: if the file is absent or damaged.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    if not path.is_file():
        raise InputFileError(path, "no such file", "give a complete folder of weights")
    try:
        return load_file(path)
    except (SafetensorError, OSError, ValueError) as error:
        raise InputFileError(path, f"is no safetensors file, or a damaged one ({error})") from error


def strict_load(module: Any, state: Mapping[str, Any], path: Path, *, dtype: Any = None) -> None:
    """Load ``state`` into ``module``; every name and shape must match, every number be finite.

    Args:
        module: a torch module; on the meta device the tensors of ``state`` become its own.
        state: tensors by name.
        path: where they come from, for the error.
        dtype: of the weights afterwards; None keeps the module's, or on the meta device the file's.

    Raises:
        InputFileError: naming what is missing, unknown, of another shape or not finite.
    """
    expected = module.state_dict()
    problems = _differences(expected, state)
    if problems:
        raise InputFileError(path, "; ".join(problems), "give weights of this architecture")
    broken = [n for n, v in state.items() if v.is_floating_point() and not v.isfinite().all()]
    if broken:
        raise InputFileError(path, f"numbers that are not finite in {_some(broken)}")
    if dtype is not None:
        state = {n: v.to(dtype) if v.is_floating_point() else v for n, v in state.items()}
    on_meta = any(value.is_meta for value in expected.values())
    module.load_state_dict(state, strict=True, assign=on_meta)
    if dtype is not None:
        module.to(dtype)


def _differences(expected: Mapping[str, Any], state: Mapping[str, Any]) -> list[str]:
    missing = [name for name in expected if name not in state]
    unknown = [name for name in state if name not in expected]
    other = [
        f"{name} {list(state[name].shape)} instead of {list(value.shape)}"
        for name, value in expected.items()
        if name in state and state[name].shape != value.shape
    ]
    kinds = (("missing", missing), ("unknown", unknown), ("of another shape:", other))
    return [f"{kind} {_some(names)}" for kind, names in kinds if names]


def _some(names: Iterable[str], shown: int = 4) -> str:
    names = list(names)
    more = f" and {len(names) - shown} more" if len(names) > shown else ""
    return ", ".join(names[:shown]) + more
