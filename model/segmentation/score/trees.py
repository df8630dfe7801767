"""Boosted decision trees in plain numpy, and the npz that holds them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.segmentation.parallel import mapped
from model.segmentation.score.mlp import Mlp, columns, load_mlp, open_npz, save_mlp

FORMAT = 1
_CHUNK = 2048


@dataclass(frozen=True, eq=False)
class Trees:
    """The sum of what the leaves say that an input comes to, one in each tree.

    Attributes:
        names: of the input features, checked against the code that makes them.
        feature: (N,) int32 column that a node asks about.
        threshold: (N,) float32; inputs up to it go to ``child``, larger ones to the node after it.
            A leaf is its own child, and its threshold is infinite.
        child: (N,) int32.
        value: (N,) float32 what a leaf says.
        roots: (T,) int32. depth: questions until the last leaf is reached.
        picks: (D,) columns of what they are asked about, where those are more than their own.
    """

    names: tuple[str, ...]
    feature: npt.NDArray[np.int32]
    threshold: npt.NDArray[np.float32]
    child: npt.NDArray[np.int32]
    value: npt.NDArray[np.float32]
    roots: npt.NDArray[np.int32]
    depth: int
    picks: npt.NDArray[np.int64] | None = None

    def __call__(self, features: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """(N,) outputs of (N, D) features."""
        out = np.empty(len(features), np.float32)

        def answer(begin: int) -> None:
            x = features[begin : begin + _CHUNK]
            x = np.ascontiguousarray(x if self.picks is None else x[:, self.picks], np.float32)
            row = (np.arange(len(x), dtype=np.int32) * x.shape[1])[:, None]
            flat = x.ravel()
            node = np.tile(self.roots, (len(x), 1))
            for _ in range(self.depth):
                asked = flat.take(self.feature.take(node) + row)
                node = self.child.take(node) + (asked > self.threshold.take(node))
            out[begin : begin + _CHUNK] = self.value.take(node).sum(1)

        mapped(answer, range(0, len(features), _CHUNK))
        return out


Scorer = Mlp | Trees
"""What ranks hypotheses by what they show."""


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
    """Read what :func:`save_trees` wrote.

    Args:
        names: of the features that they will be asked about; they may ask for some of them.

    Raises:
        InputFileError: where the file is absent, newer, or made for other features.
    """
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
