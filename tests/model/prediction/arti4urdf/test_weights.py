"""The shipped weights: they load, fit the vocabulary, and read what they are given."""

import json
import shutil
from pathlib import Path

import pytest

pytest.importorskip("torch", reason="torch is not installed")

from model.core.errors import InputFileError
from model.prediction.arti4urdf.vocabulary import SIZE, TOKENS
from model.prediction.arti4urdf.weights import SHIPPED, load_weights, vocabulary_hash
from model.training.arti4urdf.samples import Sample, draw_truth, make_sample, training_families
from tests.model.prediction.arti4urdf.probes import (
    both,
    foreign_wholes,
    probe,
    shuffled_clouds,
    shuffled_shapes,
    without_rules,
)

MOST_BYTES = 25 * 2**20


@pytest.fixture(scope="module")
def fresh() -> list[Sample]:
    """Objects that no training saw (another seed), without names.

    Of half as many, two decisions that turn over can hide what a whole cloud is worth.
    """
    families = training_families()
    truths = [draw_truth(families[k % len(families)], 77_001, k)[0] for k in range(64)]
    found = [make_sample(t, named=False, seed=k) for k, t in enumerate(truths)]
    return [s for s in found if s is not None]


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


def test_shuffling_the_shapes_of_the_parts_hurts(fresh: list[Sample]) -> None:
    """Release gate: types must hang on the shapes, names hidden."""
    model, _ = load_weights()
    assert probe(model, fresh).types - probe(model, fresh, shuffled_shapes).types >= 0.10


def test_shuffling_the_clouds_alone_hurts(fresh: list[Sample]) -> None:
    """Release gate against an encoder that has collapsed; the rules' judgements are hidden."""
    model, _ = load_weights()
    plain = probe(model, fresh, without_rules)
    assert plain.types - probe(model, fresh, both(without_rules, shuffled_clouds)).types >= 0.03


def test_another_objects_whole_cloud_costs_something(fresh: list[Sample]) -> None:
    """Release gate: the right answer becomes less likely; few decisions turn over."""
    model, _ = load_weights()
    own = probe(model, fresh, without_rules)
    foreign = probe(model, fresh, both(without_rules, foreign_wholes))
    assert foreign.surprise > own.surprise


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
