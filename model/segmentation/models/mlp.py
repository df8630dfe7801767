"""A small multilayer perceptron in plain numpy, and its npz file."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from numpy.lib.npyio import NpzFile

from model.core.errors import InputFileError
from model.segmentation.arrays import Float32, Int64
from model.segmentation.parallel import mapped

FORMAT = 1
_CHUNK = 65_536
_CONSTANT = 1e-5
"""Least spread of an input in training; one that varied less has no learned weight."""


@dataclass(frozen=True, eq=False)
class Mlp:
    """Standardise, then linear layers with ReLU between them; one output.

    Attributes:
        names: of the input features, checked against the code that makes them.
        mean, scale: (D,) float32 of the training data; constant inputs are ignored.
        layers: (weight (out, in), bias (out,)) float32 pairs.
        picks: (D,) columns of the given features that it reads, None for all.
    """

    names: tuple[str, ...]
    mean: Float32
    scale: Float32
    layers: tuple[tuple[Float32, Float32], ...]
    picks: Int64 | None = None

    def __call__(self, features: Float32) -> Float32:
        """(N,) outputs of (N, D) features."""
        out = np.empty(len(features), np.float32)
        scale = np.where(self.scale > _CONSTANT, self.scale, np.float32(np.inf))

        def evaluate(begin: int) -> None:
            x = features[begin : begin + _CHUNK]
            x = ((x if self.picks is None else x[:, self.picks]) - self.mean) / scale
            # In float64, and rounded once: the same numbers from every processor's kernels.
            x = np.clip(x, -8, 8, dtype=np.float64)
            for weight, bias in self.layers[:-1]:
                x = np.maximum(x @ weight.T + bias, 0)
            weight, bias = self.layers[-1]
            out[begin : begin + _CHUNK] = (x @ weight.T + bias)[:, 0]

        mapped(evaluate, range(0, len(features), _CHUNK))
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
        names: of the features that it will be given; it may read only some of them.

    Raises:
        InputFileError: if the file is absent, newer, or made for other features.
    """
    with open_npz(path) as data:
        found, picks = columns(data, "format", FORMAT, path, names)
        layers = []
        while f"weight_{len(layers)}" in data:
            i = len(layers)
            layers.append((data[f"weight_{i}"], data[f"bias_{i}"]))
        return Mlp(found, data["mean"], data["scale"], tuple(layers), picks)


def open_npz(path: Path) -> NpzFile:
    """Open a model's file.

    Raises:
        InputFileError: if it is absent.
    """
    if not path.is_file():
        raise InputFileError(path, "not there", "train it: python -m model.training.segmentation")
    return np.load(path, allow_pickle=False)


def columns(
    data: NpzFile, key: str, version: int, path: Path, names: tuple[str, ...]
) -> tuple[tuple[str, ...], Int64 | None]:
    """Names of a model's input features, and their places in ``names`` (None if all match).

    Args:
        key: of its format. version: that this code reads.

    Raises:
        InputFileError: if it is newer, or made for other features.
    """
    if int(data[key]) != version:
        raise InputFileError(path, f"format {int(data[key])}, this version reads {version}")
    found = tuple(str(n) for n in data["names"])
    if not set(found) <= set(names):
        raise InputFileError(path, "made for other features", "train it again")
    return found, None if found == names else np.array([names.index(n) for n in found])
