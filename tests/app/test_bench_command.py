"""``artiworld bench`` and ``artiworld evaluate``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from app.cli.benchmarks import predictions
from app.cli.benchmarks import predictions as bench_joints
from app.cli.benchmarks import predictions as bench_predict
from app.cli.benchmarks.annotate import STEPS
from app.cli.benchmarks.shapes import chest
from app.cli.main import main
from model import write_asset
from model.evaluation.scans import ScanScore
from model.prediction.registry import load_predictor
from tests.app.run_cli import answer, artiworld, assert_users_mistake
from tests.model.validation.cabinets import cabinet


@pytest.mark.parametrize("drawers", [1, 3, 7])
def test_the_chest_has_drawers_that_slide_out_of_it(drawers):
    made = chest(drawers)
    assert len(made.parts) == drawers + 1
    body, *rest = (part.bounds for part in made.parts)
    for low, high in rest:
        assert (low[1:] > body[0, 1:]).all() and (high[1:] < body[1, 1:]).all()
    tree = load_predictor("geometric").predict(made).tree
    assert tree is not None and tree.root == "link_0"
    for joint in tree.joints:
        assert joint.type == "prismatic"
        np.testing.assert_allclose(np.abs(joint.axis), [1, 0, 0], atol=1e-6)


def test_bench_predict_prints_a_row_for_each_size(monkeypatch, capfd):
    monkeypatch.setattr(bench_predict, "PART_COUNTS", (2, 4))
    monkeypatch.setattr(bench_predict, "REPEATS", 1)
    rows = answer("bench", "predict")["rows"]
    assert [row["parts"] for row in rows] == [2, 4]
    assert all(row["Arti4URDF"] > 0 and row["yardstick"] > 0 for row in rows)
    assert all(row["passes"] < row["token by token passes"] < row["text tokens"] for row in rows)
    monkeypatch.setattr(bench_predict, "PART_COUNTS", (2,))
    assert main(["bench", "predict"]) == 0
    assert "yardstick" in capfd.readouterr().out


def test_bench_joints_takes_each_source_with_names_and_without(monkeypatch, tmp_path, capfd):
    monkeypatch.setattr(bench_joints, "FAMILIES", 1)
    folder = tmp_path / "infinigen" / "box"
    folder.mkdir(parents=True)
    write_asset(cabinet(), folder, provenance={})
    words = ("bench", "joints", "--data", tmp_path, "--half", "all", "--limit", 1)
    report = answer(*words)
    rows = {row["objects"]: row for row in report["table"]}
    held = "procedural, held-out families"
    assert list(rows) == [f"{s}, {n}" for s in ("Infinigen", held) for n in ("names", "no names")]
    assert rows["Infinigen, names"]["number"] == 1 and rows["Infinigen, names"]["TC %"] == 100
    assert rows[f"{held}, names"]["number"] == 1
    earlier = tmp_path / "earlier.json"
    earlier.write_text(json.dumps(report))
    assert "100 (100)" in artiworld(*words, "--before", earlier).stdout


def test_bench_scans_measures_each_named_source_of_a_folder_by_itself(monkeypatch, tmp_path):
    for source in ("infinigen", "simulators"):
        folder = tmp_path / source / "box"
        folder.mkdir(parents=True)
        write_asset(cabinet(), folder, provenance={})
    seen = []

    def measured(config, progress):
        seen.append((config.data.root, config.half))
        return [ScanScore("box", "any", iou=(0.5, 0.6, 0.7), clicks=4, joints=2, right=1)]

    monkeypatch.setattr(predictions, "run_scans", measured)
    words = ("bench", "scans", "--data", tmp_path, "--source", "infinigen", "simulators")
    report = answer(*words, "--half", "choose")
    assert seen == [(tmp_path / s, "choose") for s in ("infinigen", "simulators")]
    rows = [(row["source"], row["joints right"]) for row in report["table"]]
    assert rows == [("infinigen", 0.5), ("simulators", 0.5)]
    assert [scan["source"] for scan in report["scans"]] == ["infinigen", "simulators"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["bench", "scans", "--source", "infinigen"], "--data"),
        (["bench", "sleep"], "sleep"),
        (["bench", "segment", "--sets", "nothing"], "nothing"),
        (["bench", "segment", "--sets", "partnet"], "--data"),
        (["bench", "segment", "--data", "/no/such/folder"], "--data"),
        (["bench", "robot", "--scene", "/no/such/scene.xml"], "/no/such/scene.xml"),
        (["bench", "robot", "--scene", "scene.xml", "--video", "films"], "--video"),
        (["bench", "joints", "--data", "/no/such/folder"], "holds none of partnet_mobility"),
        (["evaluate", "--root", "/no/such/folder"], "/no/such/folder"),
    ],
)
def test_mistakes_are_named(words, message, capfd):
    assert main(words) == 2
    lines = capfd.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and message in lines[0]


def test_bench_ui_measures_a_small_cloud():
    words = ("bench", "ui", "--points", 5000, "--faces", 0, "--clicks", 3)
    (figures,) = answer(*words, "--segmenter", "nearest")
    assert figures["elements"] == 5000
    assert 0 < figures["click_p50_ms"] <= figures["click_p95_ms"]
    assert figures["bytes_a_click"] > 0


def test_evaluate_scores_real_objects(shared_data, tmp_path):
    root = shared_data / "partnet_mobility"
    report = answer("evaluate", "--root", root, "--limit", 2, "--jobs", 1, "--out", tmp_path)
    assert report["predictor"] == "hybrid" and report["summary"]
    assert (tmp_path / "report.md").exists()
    assert_users_mistake(
        artiworld("evaluate", "--root", root, "--predictor", "magic"), "magic", "geometric"
    )


def test_bench_annotate_takes_scans_to_accepted_assets_and_another_checkout_beside_it():
    place = Path(main.__code__.co_filename).parents[2]
    rows = answer(
        "bench", "annotate", "--limit", 1, "--half", "all", "--points", 15_000, "--before", place
    )
    assert [row["code"] for row in rows] == ["today", "before"] * 2
    for row in rows[:2]:
        assert row["state"] == "accepted" and row["person"] > 0
        assert sum(row[step] for step in STEPS) == pytest.approx(row["waiting"], abs=0.1)
    assert rows[2]["waiting"] == rows[0]["waiting"]
