"""The shipped weights: they load, fit the vocabulary, and read what they are given."""

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed")
import torch

from model.core.errors import InputFileError
from model.prediction.arti4urdf.network import (
    SHIPPED,
    ArtiModel,
    Prompt,
    load_weights,
    vocabulary_hash,
    whole_cloud,
)
from model.prediction.arti4urdf.structure import POINTS
from model.prediction.arti4urdf.vocabulary import SIZE, TOKENS
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

MOST_BYTES = 25 * 2**20
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


def unseen_samples(count: int) -> list[Sample]:
    """Objects without names, by a seed that no training used."""
    families, found = training_families(), []
    for k in range(count):
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
    loss = torch.no_grad()(batch_loss)
    batches = [loss(model, collate(targets[k : k + 32])) for k in range(0, len(targets), 32)]
    kinds = np.concatenate([b.kinds for b in batches])
    mean = by_kind(kinds, torch.cat([b.hits for b in batches]))
    surprise = float(torch.cat([b.losses for b in batches]).mean())
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


def test_the_vocabulary_is_the_one_the_weights_know() -> None:
    config = json.loads((SHIPPED / "config.json").read_text())
    assert config["vocabulary"] == vocabulary_hash()
    assert len(set(TOKENS)) == SIZE
    assert config["model"]["decoder"]["vocab_size"] == SIZE


def test_the_weights_are_small_and_say_where_they_come_from() -> None:
    assert sum(f.stat().st_size for f in SHIPPED.iterdir()) < MOST_BYTES
    model, version = load_weights()
    assert version
    assert not model.training
    record = json.loads((SHIPPED / "config.json").read_text())["record"]
    assert record["training"]["seed"] is not None and record["log"]["step"] > 0


def test_the_network_reads_shapes_clouds_and_wholes() -> None:
    """What the network loses where its input is shuffled shows that it reads it."""
    model, _ = load_weights()
    samples = unseen_samples(8)
    plain, bare = probe(model, samples), probe(model, samples, without_rules)
    assert probe(model, samples, shuffled_shapes).types < plain.types
    assert probe(model, samples, both(without_rules, shuffled_clouds)).surprise > bare.surprise
    assert probe(model, samples, both(without_rules, foreign_wholes)).surprise != bare.surprise


def test_weights_of_another_vocabulary_are_refused(tmp_path: Path) -> None:
    folder = tmp_path / "weights"
    shutil.copytree(SHIPPED, folder)
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(config | {"vocabulary": "0" * 16}))
    with pytest.raises(InputFileError, match="another vocabulary"):
        load_weights(folder)
    (folder / "config.json").write_text(json.dumps(config | {"model": {"decoder": 3}}))
    with pytest.raises(InputFileError):
        load_weights(folder)
    with pytest.raises(InputFileError):
        load_weights(tmp_path / "nothing")
