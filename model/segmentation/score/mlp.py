"""A small multilayer perceptron in plain numpy, and the npz that holds one."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from numpy.lib.npyio import NpzFile

from model.core.errors import InputFileError
from model.segmentation.parallel import mapped

FORMAT = 1
_CHUNK = 65_536
_CONSTANT = 1e-5
"""Spread of an input that never varied in training, so that no weight of it was learned."""


@dataclass(frozen=True, eq=False)
class Mlp:
    """Standardise, then linear layers with ReLU between them; one output.

    Attributes:
        names: of the input features, checked against the code that makes them.
        mean, scale: (D,) float32 of the training data; what never varied there is left out.
        layers: (weight (out, in), bias (out,)) float32 pairs.
        picks: (D,) columns of what it is asked about, where those are more than its own.
    """

    names: tuple[str, ...]
    mean: npt.NDArray[np.float32]
    scale: npt.NDArray[np.float32]
    layers: tuple[tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]], ...]
    picks: npt.NDArray[np.int64] | None = None

    def __call__(self, features: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """(N,) outputs of (N, D) features."""
        out = np.empty(len(features), np.float32)
        scale = np.where(self.scale > _CONSTANT, self.scale, np.float32(np.inf))

        def answer(begin: int) -> None:
            x = features[begin : begin + _CHUNK]
            x = ((x if self.picks is None else x[:, self.picks]) - self.mean) / scale
            x = np.clip(x, -8, 8)
            for weight, bias in self.layers[:-1]:
                x = np.maximum(x @ weight.T + bias, 0)
            weight, bias = self.layers[-1]
            out[begin : begin + _CHUNK] = (x @ weight.T + bias)[:, 0]

        mapped(answer, range(0, len(features), _CHUNK))
        return out


def save_mlp(mlp: Mlp, path: Path, config: dict[str, object]) -> None:
    """Write ``mlp`` as npz with the training configuration and scores beside the numbers."""
    arrays: dict[str, npt.NDArray] = {
        "format": np.array(FORMAT),
        "names": np.array(mlp.names),
        "mean": mlp.mean,
        "scale": mlp.scale,
        "config": np.array(json.dumps(config, sort_keys=True)),
    }
    for i, (weight, bias) in enumerate(mlp.layers):
        arrays[f"weight_{i}"] = weight
        arrays[f"bias_{i}"] = bias
    np.savez_compressed(path, **arrays)  # type: ignore[arg-type]


def load_mlp(path: Path, names: tuple[str, ...]) -> Mlp:
    """Read what :func:`save_mlp` wrote.

    Args:
        names: of the features that it will be asked about; it may have learned from some of them.

    Raises:
        InputFileError: where the file is absent, newer, or made for other features.
    """
    with open_npz(path) as data:
        found, picks = columns(data, "format", FORMAT, path, names)
        layers = []
        while f"weight_{len(layers)}" in data:
            i = len(layers)
            layers.append((data[f"weight_{i}"], data[f"bias_{i}"]))
        return Mlp(found, data["mean"], data["scale"], tuple(layers), picks)


def open_npz(path: Path) -> NpzFile:
    """What a scorer was written to.

    Raises:
        InputFileError: where it is not there.
    """
    if not path.is_file():
        raise InputFileError(path, "not there", "train it: python -m model.training.segmentation")
    return np.load(path, allow_pickle=False)


def columns(
    data: NpzFile, key: str, version: int, path: Path, names: tuple[str, ...]
) -> tuple[tuple[str, ...], npt.NDArray[np.int64] | None]:
    """Names of what a scorer learned from, and their places in ``names``, None where all the same.

    Args:
        key: of its format; ``version``: that can be read.

    Raises:
        InputFileError: where it is newer, or made for other features.
    """
    if int(data[key]) != version:
        raise InputFileError(path, f"format {int(data[key])}, this version reads {version}")
    found = tuple(str(n) for n in data["names"])
    if not set(found) <= set(names):
        raise InputFileError(path, "made for other features", "train it again")
    return found, None if found == names else np.array([names.index(n) for n in found])
