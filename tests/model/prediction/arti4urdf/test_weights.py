"""The shipped weights: they load, fit the vocabulary, and read what they are given."""

import json
import shutil
from pathlib import Path

import pytest

pytest.importorskip("torch", reason="torch is not installed")

from model.core.errors import InputFileError
from model.prediction.arti4urdf.network import SHIPPED, load_weights, vocabulary_hash
from model.prediction.arti4urdf.vocabulary import SIZE, TOKENS
from model.training.arti4urdf.small_trainer import (
    both,
    foreign_wholes,
    probe,
    shuffled_clouds,
    shuffled_shapes,
    unseen_samples,
    without_rules,
)

MOST_BYTES = 25 * 2**20


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
    """A smoke test of what ``artiworld bench weights`` measures on more objects."""
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
