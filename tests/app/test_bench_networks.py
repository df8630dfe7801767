"""``artiworld bench networks`` with small networks: every figure is there and makes sense."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

pytest.importorskip("torch", reason="needs the extra network")
for _name in ("transformers", "accelerate", "peft"):
    pytest.importorskip(_name, reason="needs the extra train")

from app.cli.benchmarks import networks as bench_networks  # noqa: E402
from app.cli.benchmarks.networks import NetworksConfig, measure, tables  # noqa: E402
from app.cli.main import main  # noqa: E402
from model.prediction.arti4urdf.language_model import DecoderConfig  # noqa: E402
from model.prediction.arti4urdf.point_bert import PointBertConfig  # noqa: E402
from model.segmentation.adapters.point_sam_network import PointSamConfig  # noqa: E402
from model.training.arti4urdf.config import FullConfig  # noqa: E402

TINY = DecoderConfig(3000, 64, 96, 2, 4, 2)
SMALL = NetworksConfig(
    sizes={"tiny": TINY},
    train=True,
    encoder=PointBertConfig(depth=1),
    point_sam=PointSamConfig(64, 2, 48, 24, 32, 40, 64, 8),
    points=3000,
    steps=2,
    clicks=3,
    parts=2,
    training=FullConfig(points=64, groups=8, neighbours=4),
)


def test_every_figure_is_measured_beside_its_baseline():
    report = measure(SMALL)
    (row,) = report["Arti4URDF"]
    for way in ("all weights", "LoRA", "float32"):
        trained = row[f"training, {way}"]
        assert trained["s an object"] > 0 and trained["tokens an object"] > 100
        assert all(map(math.isfinite, trained["loss"]))
        # It begins as ignorant as a draw among all tokens is.
        assert abs(trained["loss"][0] - math.log(TINY.vocab_size)) < 1
    predicted = row["predicting"]
    assert predicted["answer tokens"] > 50 and predicted["token by token s"] > 0
    assert 0 < predicted["of which clouds s"] < predicted["s an object"]
    clicked = report["Point-SAM"]
    assert clicked["times as fast"] > 1
    shown = tables(report)
    assert len(shown) == 5
    assert all(rows and all(len(r) == len(rows[0]) for r in rows) for _, rows in shown)


def test_a_network_that_does_not_fit_is_reported_and_the_rest_measured(monkeypatch):
    import torch

    def too_large(*_):
        raise torch.OutOfMemoryError("CUDA out of memory")

    monkeypatch.setattr(bench_networks, "load_model", too_large)
    report = measure(replace(SMALL, points=500, clicks=1))
    (row,) = report["Arti4URDF"]
    assert row["training, LoRA"] == bench_networks.TOO_LARGE
    assert row["predicting"]["s an object"] > 0
    titles = dict(tables(report))
    (title,) = (t for t in titles if "LoRA" in t)
    assert bench_networks.TOO_LARGE in titles[title][0].values()


def test_unknown_sizes_are_named(capfd):
    assert main(["bench", "networks", "--sizes", "3b"]) == 2
    error = capfd.readouterr().err
    assert "3b" in error and "1.7b" in error
