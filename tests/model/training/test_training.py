"""Labels, samples on disk, and resumable runs of the small model."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed")

import torch

from model.core.errors import ArtiworldError, ConfigurationError
from model.data.procedural.generate import family_names
from model.evaluation.joint_metrics import score_object
from model.prediction.arti4urdf.answer import joints_of_decision
from model.prediction.arti4urdf.language_model import DecoderConfig
from model.prediction.arti4urdf.network import ArtiModel, ModelConfig, load_weights
from model.prediction.arti4urdf.point_bert import PointBertConfig
from model.prediction.arti4urdf.predictor import make_prompt
from model.prediction.arti4urdf.structure import read_structure, structure_arrays
from model.prediction.arti4urdf.vocabulary import SIZE, TYPES, Grammar
from model.prediction.builder import PredictionBuilder, load_confidence
from model.training.arti4urdf import batches, confidence
from model.training.arti4urdf.batches import (
    Augmentation,
    augmented,
    batch_loss,
    collate,
    teacher_forced,
)
from model.training.arti4urdf.config import LOG, TrainingConfig, rate
from model.training.arti4urdf.samples import (
    HELD_OUT,
    Sample,
    draw_truth,
    generate_samples,
    label,
    read_shard,
    training_families,
    write_shard,
)
from model.training.arti4urdf.small_trainer import export_weights, train

TINY = TrainingConfig(
    ModelConfig(
        PointBertConfig(24, 1, 2, 8, 8, 16, 8, 64, 6, 0.0, "layer", True, False),
        DecoderConfig(SIZE, 32, 48, 1, 2, 1, head_dim=16),
        32,
    ),
    batch=4,
    steps=8,
    every=4,
    warmup=2,
)


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    families = ("StorageFurniture", "Bottle", "Laptop", "Cart")
    return [s for s in generate_samples(families, 21, range(8)) if s is not None]


@pytest.fixture(scope="module")
def data(samples: list[Sample], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("samples")
    write_shard(samples, folder / "a.npz")
    return folder


@pytest.mark.parametrize("family", ["StorageFurniture", "Bottle", "Chair", "Scissors", "Composite"])
@pytest.mark.parametrize("index", [1, 2])
def test_choices_that_follow_the_labels_are_usable(
    family: str, index: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth, named = draw_truth(family, 31, index)
    segmented = truth.segmented(names=named)
    structure = read_structure(segmented, budget=8000)
    labels = label(structure, truth.object)
    assert labels is not None
    grammars: list[Grammar] = []

    class Recorded(Grammar):
        def __init__(self, *settings: object, **more: object) -> None:
            super().__init__(*settings, **more)  # type: ignore[arg-type]
            grammars.append(self)

    monkeypatch.setattr(batches, "Grammar", Recorded)
    teacher_forced(make_prompt(structure, segmented, 0), labels, np.random.default_rng(0))
    builder = PredictionBuilder(structure.sampled.parts, (), load_confidence("hybrid"))
    for i, decision in enumerate(grammars[0].decisions):
        if i != grammars[0].root:
            builder.add(joints_of_decision(structure, i, decision), {}, "")
    prediction = builder.build("labels", 0)
    assert not prediction.problems
    score = score_object(truth.object, prediction.tree)
    assert score.tree_right
    assert score.usable, [j for j in score.joints if not j.usable]


def test_samples_survive_the_disk(samples: list[Sample], data: Path) -> None:
    found = read_shard(data / "a.npz")
    assert [s.id for s in found] == [s.id for s in samples]
    for a, b in zip(found, samples, strict=True):
        assert a.names == b.names and a.category == b.category
        assert np.allclose(a.arrays.points, b.arrays.points, atol=1e-3)
        assert np.allclose(a.arrays.relations, b.arrays.relations, atol=1e-3)
        assert np.array_equal(a.labels.right, b.labels.right)


def test_candidates_and_labels_follow_the_rotation(samples: list[Sample]) -> None:
    """Correct candidates keep the true axis and line under rotations and reflections."""
    how = Augmentation(shuffle=True, nameless=0, plain=0, jitter=0)
    for seed, sample in enumerate(samples * 3):
        prompt, labels = augmented(sample, how, np.random.default_rng(seed))
        scalars, vectors = prompt.arrays.candidate_scalars, prompt.arrays.candidate_vectors
        for part, slot in np.argwhere(labels.right):
            assert scalars[part, slot, 0] == 1
            sign = 1 if labels.same_sign[part, slot] else -1
            assert sign * vectors[part, slot, 0] @ labels.axis[part] > 0.99
            if TYPES[labels.types[part]] != "prismatic":
                off = vectors[part, slot, 1] - labels.line[part]
                assert np.linalg.norm(np.cross(off, labels.axis[part])) < 0.06


def test_inverse_rotations_and_double_reflections_are_identities() -> None:
    truth, _ = draw_truth("StorageFurniture", 5, 0)
    structure = read_structure(truth.segmented())
    arrays = structure_arrays(structure, np.random.default_rng(0))
    twice = arrays.turned(1, False).turned(3, False)
    assert np.allclose(twice.candidate_vectors, arrays.candidate_vectors, atol=1e-5)
    assert np.allclose(twice.box, arrays.box, atol=1e-5)
    mirrored = arrays.turned(0, True).turned(0, True)
    assert np.allclose(mirrored.candidate_vectors, arrays.candidate_vectors, atol=1e-5)


def test_learning_lowers_the_loss(samples: list[Sample]) -> None:
    torch.manual_seed(0)
    model = ArtiModel(TINY.model)
    rng = np.random.default_rng(0)
    batch = collate([teacher_forced(*augmented(s, batches.PLAIN, rng), rng) for s in samples[:4]])
    optimizer = torch.optim.AdamW(model.parameters(), lr=3e-3)
    first = last = float(batch_loss(model, batch).total.detach())
    for _ in range(60):
        loss = batch_loss(model, batch)
        optimizer.zero_grad()
        loss.total.backward()
        optimizer.step()
        last = float(loss.total.detach())
    assert last < 0.3 * first
    missing = [n for n, p in model.named_parameters() if p.grad is None]
    assert missing == []


def test_a_resumed_run_equals_an_uninterrupted_one(data: Path, tmp_path: Path) -> None:
    whole = train(TINY, data, tmp_path / "whole", validation=data)
    slices = tmp_path / "slices"
    for _ in range(3):
        train(TINY, data, slices, validation=data, seconds=0)
    train(TINY, data, slices, validation=data)
    a, b = (torch.load(f / "state.pt", weights_only=True) for f in (whole, slices))
    assert a["step"] == b["step"] == TINY.steps
    for name, value in a["average"].items():
        if value.is_cuda:  # sums come in no order there
            torch.testing.assert_close(value, b["average"][name], rtol=1e-2, atol=1e-3)
        else:
            assert torch.equal(value, b["average"][name]), name
    entries = [json.loads(line) for line in (whole / LOG).read_text().splitlines()]
    assert [e["step"] for e in entries] == [4, 8]
    assert all(0 <= e["valid type"] <= 1 for e in entries)


def test_weights_of_a_run_load_again(data: Path, tmp_path: Path) -> None:
    run = train(replace(TINY, steps=2, every=2), data, tmp_path / "run")
    export_weights(run, tmp_path / "weights", version="test 1")
    model, version = load_weights(tmp_path / "weights")
    assert version == "test 1"
    state = torch.load(run / "state.pt", map_location="cpu", weights_only=True)["average"]
    for name, value in model.state_dict().items():
        assert torch.allclose(value, state[name], atol=2e-2, rtol=1e-2), name


def test_mistakes_are_named(data: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="no shards"):
        train(TINY, tmp_path / "empty", tmp_path / "out")
    train(replace(TINY, steps=1), data, tmp_path / "run")
    with pytest.raises(ConfigurationError, match="another run"):
        train(replace(TINY, learning_rate=1.0, steps=1), data, tmp_path / "run")
    with pytest.raises(ArtiworldError, match="train first"):
        export_weights(tmp_path / "nothing", tmp_path / "w", version="")


def test_the_schedule_rises_and_falls() -> None:
    rates = [rate(TINY, k) for k in range(TINY.steps)]
    top = int(np.argmax(rates))
    assert rates[: top + 1] == sorted(rates[: top + 1])
    assert rates[top:] == sorted(rates[top:], reverse=True)


def test_held_out_families_are_not_trained_on() -> None:
    assert not set(HELD_OUT) & set(training_families())
    assert len(training_families()) >= 40


def test_confidence_is_fitted_to_the_outcome_of_joints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stopped run resumes, and its result can be loaded."""

    def made(predictors: tuple[str, ...], object_id: str) -> list[confidence.JointRow]:
        assert object_id not in asked
        asked.append(object_id)
        rng = np.random.default_rng(int(object_id.rsplit("_", 1)[1]))
        odds = rng.normal(1.0, 2.0, 4)
        right = rng.random(4) < 1 / (1 + np.exp(-odds))
        return [
            confidence.JointRow(name, object_id, {"score": float(3 * x)}, bool(r))
            for name in predictors
            for x, r in zip(odds, right, strict=True)
        ]

    asked: list[str] = []
    monkeypatch.setattr(confidence, "joint_rows", made)
    with pytest.raises(ConfigurationError, match="too few"):
        confidence.fit_confidence(tmp_path / "run", None, samples=10)
    with pytest.raises(ConfigurationError, match="too few"):
        # One of each family: all of them are for testing.
        confidence.fit_confidence(tmp_path / "run", None, samples=len(family_names()))
    assert not asked
    weights = tmp_path / "weights"
    found = confidence.fit_confidence(tmp_path / "run", weights, samples=400)
    assert len(asked) == 400
    record = found["record"]["hybrid"]
    assert record["calibration_error"] < 0.1 and record["brier"] < record["brier_of_the_mean"]
    load_confidence.cache_clear()
    confidence_model = load_confidence("geometric", weights / "confidence.json")
    expected = pytest.approx(1 / (1 + np.exp(-1.0)), abs=0.06)
    assert confidence_model.confidence({"score": 3.0}) == expected
    load_confidence.cache_clear()


def test_rows_of_a_procedural_object() -> None:
    rows = confidence.joint_rows(("geometric",), "Lamp_5_0")
    assert rows and all(r.predictor == "geometric" and r.object_id == "Lamp_5_0" for r in rows)
    assert len({tuple(r.evidence) for r in rows}) == 1
