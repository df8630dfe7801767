"""The click protocol, the benchmark and the training pieces."""

import json
from unittest.mock import patch

import numpy as np
import pytest

from model.core.asset import Asset
from model.core.errors import ConfigurationError, InputFileError
from model.core.geometry import PointCloud
from model.data.folders import UrdfFolders
from model.data.procedural.families import HELD_OUT
from model.data.procedural.generate import GenerateSettings, generate
from model.data.simulated.scans import SMALL_PARTED, build, random_scan, scan
from model.evaluation.segmentation import (
    BenchConfig,
    BenchRow,
    all_competing,
    one_against_the_rest,
    run,
)
from model.evaluation.segmentation_ablation import SWITCHES, ablate
from model.evaluation.segmentation_clicks import BenchObject, dataset_objects
from model.segmentation.models import Mlp, load_mlp, save_mlp
from model.segmentation.prompts import (
    PartSegmentation,
    Prompts,
    deepest,
    next_click,
    next_part_click,
)
from model.segmentation.scores import read_scorers
from model.training.segmentation.clicks import ClickTraining, train_scorers
from model.training.segmentation.rows import area_under_curve, averaged, fit_ranker

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
    for seed in range(40):
        shape = build(seed)
        seen.add(shape.family)
        assert np.isfinite(shape.mesh.vertices).all()
        assert shape.part.min() == 0 and len(shape.part) == len(shape.mesh.faces)
    assert len(seen) >= 20 and not seen & set(HELD_OUT)
    assert build(1, SMALL_PARTED).family in SMALL_PARTED
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
    wider = load_mlp(tmp_path / "m.npz", ("c", "d", "a", "b"))
    assert np.array_equal(mlp(x), wider(x[:, [2, 2, 0, 1]])), "it takes its own features"
    with pytest.raises(InputFileError, match="other features"):
        load_mlp(tmp_path / "m.npz", ("a", "b", "d"))
    with pytest.raises(InputFileError, match="not there"):
        load_mlp(tmp_path / "none.npz", ())


def test_what_never_varied_in_training_says_nothing():
    """Training knows no clicks on other parts; real ones must not be judged by chance weights."""
    rng = np.random.default_rng(0)
    layers = ((rng.normal(size=(1, 3)).astype(np.float32), np.zeros(1, np.float32)),)
    scale = np.array([1, 1e-6, 1], np.float32)
    mlp = Mlp(("a", "b", "c"), np.zeros(3, np.float32), scale, layers)
    x = rng.normal(size=(10, 3)).astype(np.float32)
    other = x.copy()
    other[:, 1] += 3
    assert np.array_equal(mlp(x), mlp(other))
    other[:, 0] += 3
    assert not np.array_equal(mlp(x), mlp(other))


def test_area_under_curve_of_a_perfect_and_a_blind_score():
    truth = np.array([True, True, False, False])
    assert area_under_curve(np.array([4.0, 3.0, 2.0, 1.0]), truth) == 1.0
    assert area_under_curve(np.array([1.0, 2.0, 3.0, 4.0]), truth) == 0.0


def test_bench_on_procedural_objects():
    few = {"limit": 2, "points": 4000, "parts": 2, "cap": 4}
    report = run(BenchConfig(sets=("procedural",), segmenters=("nearest",), **few))
    summary = report.rows[0].summary()
    assert summary["objects"] == 2 and summary["parts"] == 4
    assert 0 < summary["IoU@1"] <= 1 and 1 <= summary["NoC@80"] <= 20
    assert summary["IoU@1 best of 6"] == summary["IoU@1"]  # the baselines have one answer
    assert json.loads(report.to_json())["rows"][0]["summary"]["parts"] == 4


def test_bench_tells_moving_parts_from_bases():
    row = BenchRow("some", "set", 1, [[0.2, 0.9], [0.6, 0.6]], [[0.2], [0.6]], moves=[False, True])
    summary = row.summary()
    assert summary["IoU@1"] == 0.4 and summary["moving IoU@1"] == 0.6
    assert summary["NoC@80"] == 11 and summary["moving NoC@80"] == 20
    row.moves = [True, True]
    assert not any(name.startswith("moving") for name in row.summary())


def test_bench_says_what_is_offered_without_and_after_one_click():
    report = run(BenchConfig(sets=("procedural",), limit=1, points=6000, parts=2, cap=2))
    summary, row = report.rows[0].summary(), report.rows[0]
    assert len(row.offered) == 2 and all(
        o[0] == c[0] for o, c in zip(row.offered, row.curves, strict=True)
    )
    assert summary["IoU@1"] <= summary["IoU@1 best of 2"] <= summary["IoU@1 best of 6"] <= 1
    assert len(row.proposed) == 2 and 0 <= summary["proposed IoU"] <= 1
    number, right, there, found = row.guesses[0]
    assert 0 <= right <= number and 0 <= found <= there
    assert min(right, 1) == min(found, 1), "a part that is right is one that is found"
    assert len(row.reachable) == 2 and 0.8 < summary["cells IoU"] <= 1
    assert summary["cells NoC@80"] == 1 + 19 * np.mean(np.array(row.reachable) < 0.8)
    report.print_table()


def test_bench_leaves_out_mechanisms():
    config = BenchConfig(sets=("procedural",), limit=1, points=6000)
    names = ("boxes", "penalty of details", "history", "outliers", "trays")
    whole, *others = ablate(config, names)
    assert whole["without"] == "nothing" and whole["objects"] == 1
    assert [row["without"] for row in others] == list(names[:-1]), "a cloud has no trays"
    assert all(float(v) < 1 for row in others for v in row["visible"].split("/"))
    with pytest.raises(ConfigurationError, match="'teeth'"):
        ablate(config, ("teeth",))


@pytest.mark.parametrize("name", SWITCHES)
def test_switches_replace_what_is_there(name: str) -> None:
    for target, value in SWITCHES[name].replaced.items():
        with patch(f"model.segmentation.{target}", value):
            pass


def test_bench_on_real_objects(shared_data):
    few = {"limit": 1, "cap": 2, "data": shared_data}
    report = run(BenchConfig(sets=("partnet-mesh",), segmenters=("nearest",), **few))
    assert report.rows[0].summary()["parts"] >= 2


def test_bench_on_objects_of_ones_own(tmp_path, capsys):
    """Any data set with a tree of links will do; what can't be read is named, and left out."""
    generate(GenerateSettings(tmp_path, ("Safe", "Refrigerator"), n=1))
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "broken.urdf").write_text("<robot")
    few = {"limit": 0, "points": 5000, "parts": 3, "cap": 3, "data": tmp_path}
    report = run(BenchConfig(sets=("urdf-mesh", "urdf-scan"), segmenters=("nearest",), **few))
    for row in report.rows:
        assert row.objects == len(row.seen) == 2
        assert 0 < row.summary()["IoU@1"] <= 1 and 0 < row.summary()["seen all@3"] <= 1
        assert [line.split(":")[0] for line in row.left_out] == ["broken"]
    report.print_table()
    assert capsys.readouterr().out.count("left out: broken") == 1
    with pytest.raises(InputFileError, match="broken"):
        list(dataset_objects(UrdfFolders(tmp_path), "mesh", 1, 0, 20, 5))


def test_a_scan_for_the_benchmark_is_seen_from_where_the_parts_are(tmp_path):
    generate(GenerateSettings(tmp_path, ("Refrigerator",), n=1))
    made = dataset_objects(UrdfFolders(tmp_path), "scan", 20_000, 0, 20, 5)
    (item,) = list(made)
    assert item.front == (-1.0, 0.0, 0.0)  # as all generated objects stand
    points, of_surface = item.asset.element_centers, item.labels >= 0
    middle = points[of_surface].mean(0)
    assert 0.02 < 1 - of_surface.mean() < 0.15
    # Nothing of the back wall but what is seen through the door's gaps.
    back = points[of_surface, 0] > np.quantile(points[:, 0], 0.999) - 0.01
    assert back.mean() < 0.02 and middle[0] < np.ptp(points[:, 0]) / 2 + points[:, 0].min()


def test_strays_are_neither_clicked_nor_counted():
    rng = np.random.default_rng(0)
    flat = np.c_[rng.random((400, 2)), np.zeros(400)]
    air = rng.random((40, 3)) + (0, 0, 2)
    cloud = PointCloud(np.concatenate([flat, air]).astype(np.float32))
    labels = np.r_[(flat[:, 0] > 0.5).astype(np.int16), np.full(40, -1, np.int16)]
    item = BenchObject("plate", "some", Asset("plate", cloud=cloud), labels, (0, 1))
    clicked: list[int] = []

    class All:
        """Says that all is part 1, stray points too."""

        asset = item.asset

        def segment(self, prompts: Prompts) -> PartSegmentation:
            clicked.extend(c.element for c in prompts.clicks)
            return PartSegmentation(np.ones(len(labels), np.int16), "all", 0.0)

        def candidates(self, prompts: Prompts, part: int) -> list:
            return []

    row = BenchRow("all", "some")
    one_against_the_rest(All(), item, BenchConfig(cap=3), row, 0)
    all_competing(All(), item, row)
    assert len(clicked) > 6 and max(clicked) < 400
    assert row.curves[1][0] == pytest.approx((labels == 1).sum() / 400)


def test_the_scorers_can_be_trained_again(tmp_path):
    few = {"held_out": 3, "parts": 2, "first_clicks": 2, "clicks": 3, "networks": 2}
    config = ClickTraining(2, 1, 1, mesh_share=1.0, **few)
    scores = train_scorers(config, tmp_path)
    assert 0 < scores["first_iou"] <= scores["first_best_possible"] <= 1
    first, later = read_scorers(tmp_path)
    assert first is not None and later is not None
    x = np.random.default_rng(0).normal(size=(5, len(first.names))).astype(np.float32)
    assert np.isfinite(first(x)).all() and np.isfinite(later(x)).all()


def test_an_average_answers_with_the_mean():
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(60, 3)).astype(np.float32), rng.random(60)
    group = np.repeat(np.arange(12), 5)
    models = [
        fit_ranker(("a", "b", "c"), x, y, group, np.ones(12), hidden=(4, 3), epochs=2, seed=seed)
        for seed in range(3)
    ]
    mean = np.mean([m(x) for m in models], axis=0)
    np.testing.assert_allclose(averaged(models)(x), mean, atol=1e-6)
