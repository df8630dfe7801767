"""Fits the choice of motions: ``python -m model.training.arti4urdf.motions --help``.

Procedural objects, corrupted as in the network's training, and a folder of URDF objects with and
without names are predicted; trees learn which candidates have the axis and the line of the true
joint. The scores beside the weights are of trial fits, on what each left out: a fifth of the
objects of that folder, or one of its categories.
"""

from __future__ import annotations

import argparse
import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.errors import ArtiworldError
from model.core.pool import robust_map
from model.data.registry import DatasetOptions, open_dataset
from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.choosing import (
    NAMES,
    SHIPPED,
    MotionRanker,
    geometric_prior,
    log_share,
    motion_features,
    network_odds,
)
from model.prediction.arti4urdf.decoding import same_motion
from model.prediction.arti4urdf.predictor import hybrid, make_prompt
from model.prediction.arti4urdf.structure import read_structure
from model.segmentation.models import Trees, save_trees
from model.training.arti4urdf.samples import (
    BUDGET,
    MOST_PARTS,
    TYPES,
    draw_truth,
    family_of,
    label,
    training_families,
)
from model.training.segmentation.rows import plain_trees

Floats = npt.NDArray[np.float32]
FIXED = TYPES.index("fixed")
FOLDS = 5
"""Shares of the objects, each of which one trial fit leaves out."""
OTHERS = 3.0
"""Weight of the other generator's rows: its objects are fewer than ours. Not tuned."""
BOOSTING: dict[str, Any] = {"objective": "binary", "learning_rate": 0.05, "num_leaves": 16}
BOOSTING |= {"min_data_in_leaf": 30, "lambda_l2": 5.0, "feature_fraction": 0.2}
BOOSTING |= {"bagging_fraction": 0.7, "bagging_freq": 1, "num_threads": 1, "verbosity": -1}
BOOSTING |= {"deterministic": True, "force_row_wise": True}
"""LightGBM's settings. Slow steps on few features lose nothing on categories that were left out:
docs/research/predictor.md has others."""
TREES = 300


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a training object.

    Attributes:
        object_id, category: of the object; the category is "" for procedural ones.
        named: whether names were given. moves: whether its true joint moves.
        features: (K, F) of its candidates.
        right: (K,) which have the true axis and line.
        same: (K, K) which have the same motion.
        rules: (K,) log-probabilities by the rules. present: index of the answer's, -1 for none.
    """

    object_id: str
    category: str
    named: bool
    moves: bool
    features: Floats
    right: npt.NDArray[np.bool_]
    same: npt.NDArray[np.bool_]
    rules: npt.NDArray[np.float64]
    present: int


def parts_of(data: DatasetOptions | None, seed: int, task: tuple[str, bool, int]) -> list[Part]:
    """The parts of one object; none where it can't be read or expressed.

    Args:
        data: the folder; None for procedural objects.
        seed: random seed of the procedural objects.
        task: id, whether names are given, seed of the surface samples. A procedural object's id is
            its index, and it decides on its names itself.
    """
    object_id, named, number = task
    try:
        if data is None:
            index = int(object_id)
            truth, named = draw_truth(family_of(training_families(), index), seed, index)
            category = ""
        else:
            folder = open_dataset(data)
            truth, category = folder.load(object_id), folder.category(object_id) or ""
        segmented = truth.segmented(names=named)
        if not 2 <= len(segmented.parts) <= MOST_PARTS:
            return []
        structure = read_structure(segmented, number, budget=BUDGET)
        labels = label(structure, truth.object)
    except ArtiworldError:
        return []
    if labels is None:
        return []
    prompt = make_prompt(structure, segmented, number)
    rules, same = geometric_prior(structure), same_motion(prompt)
    prior = hybrid().prior(rules)
    answer = hybrid().answer(prompt, structure, {}, prior)
    out: list[Part] = []
    for i in range(len(segmented.parts)):
        odds = network_odds(answer, i)
        slots, features = motion_features(prompt.arrays, i, odds, rules[i], same[i])
        if labels.parents[i] < 0 or not len(slots):
            continue
        present = np.flatnonzero(slots == answer.decisions[i].slot)
        out.append(
            Part(
                truth.id,
                category,
                named,
                bool(labels.types[i] != FIXED),
                features,
                labels.right[i, slots],
                same[i][np.ix_(slots, slots)],
                rules[i][v.SLOT_IDS][slots],
                int(present[0]) if len(present) else -1,
            )
        )
    return out


def _grow(parts: Sequence[Part], seed: int) -> Trees:
    import lightgbm  # pyright: ignore[reportMissingImports]

    weight = np.concatenate([np.full(len(p.right), OTHERS if p.category else 1.0) for p in parts])
    right = np.concatenate([p.right for p in parts]).astype(np.int64)
    data = lightgbm.Dataset(np.concatenate([p.features for p in parts]), right, weight=weight)
    grown = lightgbm.train({**BOOSTING, "seed": seed}, data, TREES).dump_model()
    return plain_trees(NAMES, grown["tree_info"])


def accuracy(parts: Sequence[Part], fold: npt.NDArray[np.int64], seed: int) -> dict[str, float]:
    """Share of moving joints with the true axis and line before and after, each fold left out."""
    hits: dict[bool, list[tuple[bool, bool]]] = {True: [], False: []}
    for left in sorted(set(fold[fold >= 0].tolist())):
        ranker = MotionRanker(
            _grow([p for p, f in zip(parts, fold, strict=True) if f != left], seed)
        )
        for p in (p for p, f in zip(parts, fold, strict=True) if f == left and p.moves):
            odds = ranker.trees(p.features)
            likely = log_share(odds)
            chosen = ranker.chosen(p.present, likely, p.rules, p.same) if p.present >= 0 else -1
            before, after = (k >= 0 and bool(p.right[k]) for k in (p.present, chosen))
            hits[p.named].append((before, after))
    out: dict[str, float] = {}
    for named, kind in ((True, "names"), (False, "no names")):
        if hits[named]:
            before, after = np.mean(hits[named], axis=0)
            out |= {f"{kind}, before": round(before, 3), f"{kind}, after": round(after, 3)}
    return out


def folds(parts: Sequence[Part], key: str) -> npt.NDArray[np.int64]:
    """(N,) fold of each part by its object or its category; -1 of procedural ones."""
    values = [str(getattr(p, key)) for p in parts]
    if key == "category":
        place = {c: k for k, c in enumerate(sorted(set(values)))}
        return np.array([place[c] if c else -1 for c in values])
    return np.array(
        [
            zlib.crc32(v.encode()) % FOLDS if p.category else -1
            for v, p in zip(values, parts, strict=True)
        ]
    )


def collect(
    data: DatasetOptions | None, tasks: Sequence[tuple[str, bool, int]], seed: int, jobs: int
) -> list[Part]:
    """The parts of all objects, in the order of ``tasks``; see :func:`parts_of`."""
    found = dict(robust_map(partial(parts_of, data, seed), tasks, jobs))
    return [part for task in tasks for part in found[task] or ()]


def main(arguments: Sequence[str] | None = None) -> None:
    """Collect the samples, fit, and write the weights."""
    parser = argparse.ArgumentParser(description="Fit the choice of motions.")
    parser.add_argument("--samples", type=int, default=2000, help="procedural objects")
    parser.add_argument("--urdf", type=Path, help="folder of URDF objects to learn from as well")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=4242)
    parser.add_argument("--out", type=Path, default=SHIPPED)
    args = parser.parse_args(arguments)
    made = [(str(k), False, k) for k in range(args.samples)]
    parts = collect(None, made, args.seed, args.jobs)
    scores: dict[str, Any] = {"procedural": args.samples, "seed": args.seed}
    if args.urdf is not None:
        data = DatasetOptions("urdf", args.urdf)
        ids = open_dataset(data).ids()
        tasks = [(i, named, k) for k, i in enumerate(ids) for named in (True, False)]
        parts += collect(data, tasks, args.seed, args.jobs)
        scores["objects"] = len(ids)
        for key in ("object_id", "category"):
            scores[f"left out by {key}"] = accuracy(parts, folds(parts, key), args.seed)
    scores["parts"] = len(parts)
    save_trees(_grow(parts, args.seed), args.out, scores)
    print(json.dumps(scores))


if __name__ == "__main__":
    main()
