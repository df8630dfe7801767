"""Probes of the network's use of its input: the loss in quality when that is shuffled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from model.core.progress import Progress, no_progress
from model.prediction.arti4urdf.network import ArtiModel, Prompt, whole_cloud
from model.prediction.arti4urdf.structure import POINTS
from model.training.arti4urdf.batches import (
    PLAIN,
    augmented,
    batch_loss,
    by_kind,
    collate,
    teacher_forced,
    without_judgements,
)
from model.training.arti4urdf.samples import Sample, draw_truth, make_sample, training_families

Change = Callable[[Sequence[Prompt], np.random.Generator], list[Prompt]]


@dataclass(frozen=True)
class Probe:
    """Share of right decisions, by kind, over the objects without names and category.

    Attributes:
        types, slots: joint types; candidates.
        trees: parents.
        surprise: mean negative log-likelihood of the right decisions; tells small differences.
    """

    types: float
    slots: float
    trees: float
    surprise: float


def unseen_samples(count: int, progress: Progress = no_progress) -> list[Sample]:
    """Objects without names, by a seed that no training used."""
    families, found = training_families(), []
    for k in range(count):
        progress(k / count, f"object {k + 1} of {count}")
        truth, _ = draw_truth(families[k % len(families)], 77_001, k)
        found.append(make_sample(truth, named=False, seed=k))
    return [s for s in found if s is not None]


def probe(model: ArtiModel, samples: Sequence[Sample], change: Change | None = None) -> Probe:
    """Teacher-forced accuracy after ``change`` of the prompts."""
    rng = np.random.default_rng(0)
    how = replace(PLAIN, nameless=1.0)
    pairs = [augmented(s, how, rng) for s in samples if not any(s.names)]
    prompts = [prompt for prompt, _ in pairs]
    if change is not None:
        prompts = change(prompts, rng)
    step = model.config.json_step
    taught_pairs = zip(prompts, (labels for _, labels in pairs), strict=True)
    targets = [
        teacher_forced(prompt, labels, rng, json_step=step) for prompt, labels in taught_pairs
    ]
    model.eval()
    with torch.no_grad():
        batches = [
            batch_loss(model, collate(targets[start : start + 32]))
            for start in range(0, len(targets), 32)
        ]
    kinds = np.concatenate([b.kinds for b in batches])
    mean = by_kind(kinds, torch.cat([b.hits for b in batches]))
    surprise = float(torch.cat([b.losses for b in batches]).double().mean())
    return Probe(mean.get("type", 0.0), mean.get("slot", 0.0), mean.get("child", 0.0), surprise)


def shuffled_clouds(prompts: Sequence[Prompt], rng: np.random.Generator) -> list[Prompt]:
    """Every part gets the cloud of another part of its object, placed and sized as its own."""
    return [_with_shapes(p, p.arrays.points[_elsewhere(len(p.arrays), rng)]) for p in prompts]


def shuffled_shapes(prompts: Sequence[Prompt], rng: np.random.Generator) -> list[Prompt]:
    """Every part gets all that is read of another part's shape: cloud, looks and candidates.

    Places, sizes and relations stay.
    """
    out = []
    for prompt in prompts:
        arrays, order = prompt.arrays, _elsewhere(len(prompt.arrays), rng)
        moved = _with_shapes(prompt, arrays.points[order]).arrays
        features = {
            name: getattr(arrays, name)[order]
            for name in ("scalars", "vectors", "candidate_scalars", "candidate_vectors")
        }
        out.append(replace(prompt, arrays=replace(moved, **features)))
    return out


def foreign_wholes(prompts: Sequence[Prompt], rng: np.random.Generator) -> list[Prompt]:
    """Every prompt gets the global cloud of another object."""
    order = _elsewhere(len(prompts), rng)
    return [
        replace(p, whole=whole_cloud(prompts[int(k)].arrays, POINTS))
        for p, k in zip(prompts, order, strict=True)
    ]


def without_rules(prompts: Sequence[Prompt], rng: np.random.Generator) -> list[Prompt]:
    """Without the judgements of the geometric rules, which say the shape in another way."""
    del rng
    return [replace(p, arrays=without_judgements(p.arrays)) for p in prompts]


def both(first: Change, second: Change) -> Change:
    """One change after the other."""
    return lambda prompts, rng: second(first(prompts, rng), rng)


def _elsewhere(count: int, rng: np.random.Generator) -> np.ndarray:
    """A permutation that leaves nothing in place, where there is one."""
    order = rng.permutation(count)
    out = np.empty(count, np.int64)
    out[order] = np.roll(order, 1)
    return out


def _with_shapes(prompt: Prompt, points: np.ndarray) -> Prompt:
    arrays = prompt.arrays
    low, high = points.min(1, keepdims=True), points.max(1, keepdims=True)
    unit = (points - (low + high) / 2) / np.maximum((high - low) / 2, 1e-6)
    placed = unit * arrays.box[:, None, 3:] + arrays.box[:, None, :3]
    return replace(prompt, arrays=replace(arrays, points=placed.astype(np.float32)))
