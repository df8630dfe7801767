"""Small trained models in plain numpy, perceptrons and boosted trees, and their npz files."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from numpy.lib.npyio import NpzFile

from model.core.errors import InputFileError
from model.segmentation.arrays import Float32, Int32, Int64, mapped

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


_TREE_CHUNK = 2048


@dataclass(frozen=True, eq=False)
class Trees:
    """Sums the values of the leaves that an input reaches, one in each tree.

    Attributes:
        names: of the input features, checked against the code that makes them.
        feature: (N,) int32 column that a node compares.
        threshold: (N,) float32; inputs up to it go to ``child``, larger ones to the node after it.
            A leaf is its own child with an infinite threshold.
        child: (N,) int32.
        value: (N,) float32 of leaves.
        roots: (T,) int32. depth: comparisons to the deepest leaf.
        picks: (D,) columns of the given features that they read, None for all.
    """

    names: tuple[str, ...]
    feature: Int32
    threshold: Float32
    child: Int32
    value: Float32
    roots: Int32
    depth: int
    picks: Int64 | None = None

    def __call__(self, features: Float32) -> Float32:
        """(N,) outputs of (N, D) features."""
        out = np.empty(len(features), np.float32)

        def evaluate(begin: int) -> None:
            x = features[begin : begin + _TREE_CHUNK]
            x = np.ascontiguousarray(x if self.picks is None else x[:, self.picks], np.float32)
            row = (np.arange(len(x), dtype=np.int32) * x.shape[1])[:, None]
            flat = x.ravel()
            node = np.tile(self.roots, (len(x), 1))
            for _ in range(self.depth):
                compared = flat.take(self.feature.take(node) + row)
                node = self.child.take(node) + (compared > self.threshold.take(node))
            out[begin : begin + _TREE_CHUNK] = self.value.take(node).sum(1)

        mapped(evaluate, range(0, len(features), _TREE_CHUNK))
        return out


Scorer = Mlp | Trees
"""Ranks proposals by their features."""


def save_trees(trees: Trees, path: Path, config: dict[str, object]) -> None:
    """Write ``trees`` as npz with the training configuration and scores beside the numbers."""
    np.savez_compressed(
        path,
        trees_format=np.array(FORMAT),
        names=np.array(trees.names),
        feature=trees.feature.astype(np.int16),
        threshold=trees.threshold,
        child=trees.child,
        value=trees.value,
        roots=trees.roots,
        depth=np.array(trees.depth),
        config=np.array(json.dumps(config, sort_keys=True)),
    )


def load_trees(path: Path, names: tuple[str, ...]) -> Trees:
    """Read what :func:`save_trees` wrote; arguments and errors as for :func:`load_mlp`."""
    with open_npz(path) as data:
        found, picks = columns(data, "trees_format", FORMAT, path, names)
        return Trees(
            found,
            data["feature"].astype(np.int32),
            data["threshold"],
            data["child"],
            data["value"],
            data["roots"],
            int(data["depth"]),
            picks,
        )


def save_scorer(scorer: Scorer, path: Path, config: dict[str, object]) -> None:
    """Write ``scorer`` as npz with the training configuration and scores beside the numbers."""
    if isinstance(scorer, Trees):
        save_trees(scorer, path, config)
    else:
        save_mlp(scorer, path, config)


def load_scorer(path: Path, names: tuple[str, ...]) -> Scorer:
    """Read what :func:`save_trees` or :func:`save_mlp` wrote; the same errors."""
    with open_npz(path) as data:
        trees = "trees_format" in data
    return load_trees(path, names) if trees else load_mlp(path, names)
