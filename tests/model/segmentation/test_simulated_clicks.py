"""The click protocol, the benchmark and the training pieces."""

from __future__ import annotations

import json

import numpy as np
import pytest

from model.errors import InputFileError
from model.segmentation.bench import BenchConfig, run
from model.segmentation.mlp import Mlp, load_mlp, save_mlp
from model.segmentation.simulate import deepest, next_click, next_part_click
from model.segmentation.training.fit import area_under_curve
from model.segmentation.training.scans import FAMILIES, build, random_scan, scan

LINE = np.c_[np.arange(20.0), np.zeros(20), np.zeros(20)]


def test_deepest_is_the_middle():
    region = np.zeros(20, bool)
    region[4:11] = True
    assert deepest(LINE, region) == 7


def test_next_click_goes_to_the_larger_error():
    truth, answer = np.zeros(20, bool), np.zeros(20, bool)
    truth[5:12] = True
    answer[9:18] = True
    assert next_click(LINE, truth, answer) == (14, False)
    answer[16:] = False
    answer[12:14] = False
    found = next_click(LINE, truth, answer)
    assert found is not None and found[1] and 5 <= found[0] <= 8
    assert next_click(LINE, truth, truth) is None


def test_next_part_click_names_the_true_part():
    truth = np.repeat([0, 1, 2], [6, 8, 6])
    answer = truth.copy()
    answer[8:13] = 2
    answer[0] = 1
    assert next_part_click(LINE, truth, answer) == (10, 1)
    assert next_part_click(LINE, truth, truth) is None


def test_procedural_objects_are_sound():
    seen = set()
    for seed in range(60):
        solid = build(seed)
        seen.add(solid.family)
        assert np.isfinite(solid.triangles).all()
        assert solid.part.min() == 0 and len(solid.part) == len(solid.triangles)
    assert len(seen) >= 0.6 * len({f.__name__ for f in FAMILIES})
    data = random_scan(4, 3000)
    assert np.array_equal(data.cloud.points, random_scan(4, 3000).cloud.points)
    front = scan(build(3), 4000, "one-sided", 0.001, 3)
    assert 0 < len(front.cloud) <= 4000 and len(front.labels) == len(front.cloud)


def test_mlp_round_trip(tmp_path):
    rng = np.random.default_rng(0)
    layers = tuple(
        (rng.normal(size=s).astype(np.float32), rng.normal(size=s[0]).astype(np.float32))
        for s in ((4, 3), (1, 4))
    )
    mlp = Mlp(("a", "b", "c"), np.zeros(3, np.float32), np.ones(3, np.float32), layers)
    save_mlp(mlp, tmp_path / "m.npz", {"note": 1})
    again = load_mlp(tmp_path / "m.npz", ("a", "b", "c"))
    x = rng.normal(size=(10, 3)).astype(np.float32)
    assert np.array_equal(mlp(x), again(x))
    with pytest.raises(InputFileError, match="other features"):
        load_mlp(tmp_path / "m.npz", ("a", "b", "d"))
    with pytest.raises(InputFileError, match="not there"):
        load_mlp(tmp_path / "none.npz", ())


def test_area_under_curve_of_a_perfect_and_a_blind_score():
    truth = np.array([True, True, False, False])
    assert area_under_curve(np.array([4.0, 3.0, 2.0, 1.0]), truth) == 1.0
    assert area_under_curve(np.array([1.0, 2.0, 3.0, 4.0]), truth) == 0.0


def test_bench_on_procedural_objects(tmp_path):
    report = run(
        BenchConfig(
            sets=("procedural",),
            segmenters=("nearest",),
            limit=2,
            points=4000,
            parts=2,
            cap=4,
            json_path=tmp_path / "r.json",
        )
    )
    summary = report.rows[0].summary()
    assert summary["objects"] == 2 and summary["parts"] == 4
    assert 0 < summary["IoU@1"] <= 1 and 1 <= summary["NoC@80"] <= 20
    assert json.loads((tmp_path / "r.json").read_text())["rows"][0]["summary"]["parts"] == 4


def test_bench_on_real_objects(shared_data):
    report = run(
        BenchConfig(
            data=shared_data, sets=("partnet-mesh",), segmenters=("nearest",), limit=1, cap=2
        )
    )
    assert report.rows[0].summary()["parts"] >= 2
