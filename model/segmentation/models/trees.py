"""Boosted decision trees in plain numpy, and their npz file."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from model.segmentation.arrays import Float32, Int32, Int64
from model.segmentation.models.mlp import Mlp, columns, load_mlp, open_npz, save_mlp
from model.segmentation.parallel import mapped

FORMAT = 1
_CHUNK = 2048


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
            x = features[begin : begin + _CHUNK]
            x = np.ascontiguousarray(x if self.picks is None else x[:, self.picks], np.float32)
            row = (np.arange(len(x), dtype=np.int32) * x.shape[1])[:, None]
            flat = x.ravel()
            node = np.tile(self.roots, (len(x), 1))
            for _ in range(self.depth):
                compared = flat.take(self.feature.take(node) + row)
                node = self.child.take(node) + (compared > self.threshold.take(node))
            out[begin : begin + _CHUNK] = self.value.take(node).sum(1)

        mapped(evaluate, range(0, len(features), _CHUNK))
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
    """Read what :func:`save_trees` wrote; arguments and errors as for :func:`.mlp.load_mlp`."""
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
    """Read what :func:`save_trees` or :func:`.mlp.save_mlp` wrote; the same errors."""
    with open_npz(path) as data:
        trees = "trees_format" in data
    return load_trees(path, names) if trees else load_mlp(path, names)
