"""Figures with intervals, calibration, comparisons, and pages that hostile names can't break."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from model.core.errors import ConfigurationError, InputFileError
from model.data.registry import DatasetOptions
from model.evaluation.compare import compare
from model.evaluation.html_report import worst_objects, write_html
from model.evaluation.joint_metrics import Execution, JointScore, ObjectScore, tree_edits
from model.evaluation.report import Report, read_report, to_markdown
from model.evaluation.run import EvaluationConfig, evaluate
from model.evaluation.summary import METRICS, bootstrap, calibrate, summarise
from model.geometry import drawing

HOSTILE = '<script>alert("x")</script> | [a](javascript:b) `c`\n# d'


def joint(usable: bool, confidence: float | None = None, apd: float = 0.0) -> JointScore:
    return JointScore(
        "link_1", "revolute", "revolute", True, apd, 0.0, 0.0, 0.0, 0.0, None, 1.0, 1.0,
        usable, usable, confidence,
    )  # fmt: skip


def score(name: str, usable: bool = True, **values: object) -> ObjectScore:
    return ObjectScore(name, "Box", (joint(usable),), tree_right=True, **values)  # type: ignore[arg-type]


def report(scores: list[ObjectScore], name: str = "geometric") -> Report:
    return Report("urdf", name, True, {"seed": 0}, tuple(scores), (0.1,) * len(scores), 1.0)


def test_intervals_hold_the_figure_and_narrow_with_more_objects() -> None:
    few = [score(str(i), i % 2 == 0) for i in range(10)]
    many = [score(str(i), i % 2 == 0) for i in range(1000)]
    a, b = bootstrap(few)["usable"], bootstrap(many)["usable"]
    assert a[0] < 0.5 < a[1] and b[0] < 0.5 < b[1]
    assert b[1] - b[0] == pytest.approx(2 * 1.96 * 0.5 / math.sqrt(1000), rel=0.15)
    assert a[1] - a[0] > 3 * (b[1] - b[0])
    assert bootstrap(few)["usable"] == a
    assert bootstrap(many, seed=1)["usable"] != b
    assert math.isnan(bootstrap(few)["dld"][0])  # no slide, no figure


def test_every_metric_is_defined() -> None:
    assert len({m.key for m in METRICS}) == len(METRICS)
    assert all(m.definition and m.source and m.label for m in METRICS)
    assert set(summarise([score("a")]).values) == {m.key for m in METRICS}


def test_calibration_knows_the_sure_from_the_right() -> None:
    def told(pairs: list[tuple[float, bool]]) -> list[ObjectScore]:
        return [ObjectScore("a", None, tuple(joint(u, c) for c, u in pairs))]

    perfect = calibrate(told([(1.0, True)] * 4 + [(0.0, False)] * 4))
    assert perfect.ece == 0.0 and perfect.brier == 0.0 and perfect.joints == 8
    boasting = calibrate(told([(0.95, False)] * 10))
    assert boasting.ece == pytest.approx(0.95) and len(boasting.bins) == 1
    half = calibrate(told([(0.75, i < 5) for i in range(10)]))
    assert half.ece == pytest.approx(0.25) and half.bins[0].usable == 0.5
    assert math.isnan(calibrate(told([])).ece)


def test_tree_edits_count_wrong_missing_and_extra() -> None:
    truth = {"a": "", "b": "a", "c": "b"}
    assert tree_edits(truth, truth) == 0
    assert tree_edits(truth, {"a": "", "b": "a", "c": "a"}) == 1
    assert tree_edits(truth, {"a": "", "b": "a"}) == 1
    assert tree_edits(truth, truth, extra=2) == 2


def test_a_comparison_says_what_changed() -> None:
    before = report([score(str(i), i < 5) for i in range(10)])
    after = report([score(str(i), i < 9 and i != 0) for i in range(12)], "better")
    made = compare(before, after)
    kinds = {c.object_id: c.kind for c in made.changes}
    assert kinds == {"0": "broken", "5": "mended", "6": "mended", "7": "mended", "8": "mended"}
    assert (made.objects, made.left_out) == (10, 2)
    delta, low, high = made.difference["usable"]
    assert delta == pytest.approx(0.3) and low < delta < high
    assert made.changes[0].new and not made.changes[0].gone
    json.dumps(made.to_json(), allow_nan=False)
    same = compare(before, before)
    assert not same.changes and same.difference["usable"] == (0.0, 0.0, 0.0)
    with pytest.raises(ConfigurationError, match="no object in common"):
        compare(before, report([score("x")]))


def test_reports_are_read_back(tmp_path: Path) -> None:
    run = Execution(False, "link_1: jammed", ("jammed",), 0.1, 0.0, 0.2, 1, 1)
    made = report([score("a", execution=run, part_iou=0.5), score("b", False, problem="boom")])
    made.write(tmp_path)
    again = read_report(tmp_path)
    assert again == made
    assert "Not executable: 1 of 1 objects" in to_markdown([again])
    assert "Not executable" not in to_markdown([report([score("a")])])
    assert again.summary["executable"] == 0.0 and again.summary["joints_executable"] == 0.0
    with pytest.raises(InputFileError, match="evaluation"):
        read_report(tmp_path / "nowhere")
    (tmp_path / "report.json").write_text("{}")
    with pytest.raises(InputFileError, match="no report"):
        read_report(tmp_path)


def test_hostile_names_stay_text(tmp_path: Path) -> None:
    bad = replace(score("x", False), object_id=HOSTILE, category=HOSTILE, problem=HOSTILE)
    made = report([bad], HOSTILE)
    text = to_markdown([made])
    assert "<script" not in text and "\n# d" not in text and "\\| \\[a\\]" in text
    config = EvaluationConfig(DatasetOptions("urdf", tmp_path), jobs=1)
    page = write_html([(config, made)], tmp_path / "page.html", 3).read_text()
    assert "<script" not in page and "&lt;script&gt;" in page
    assert "http" not in page  # nothing is loaded from elsewhere


def test_the_worst_come_first() -> None:
    scores = [score("fine"), score("half", False), replace(score("none", False), tree_edits=3)]
    assert [s.object_id for s in worst_objects(scores, 10)] == ["none", "half"]
    assert len(worst_objects(scores, 1)) == 1


def test_a_page_with_pictures(tmp_path: Path) -> None:
    data = DatasetOptions("procedural", None, families=("Safe",))
    config = EvaluationConfig(data, predictor="truth", jobs=1, timeout=900.0)
    made = evaluate(config)
    assert made.summary["usable"] == 1.0
    wrong = replace(
        made, scores=tuple(replace(s, extra=(("link_0", "prismatic"),)) for s in made.scores)
    )
    page = write_html([(config, wrong)], tmp_path / "page.html", 1).read_text()
    assert page.count("data:image/png;base64,") == 3 and "Safe_0_0" in page


def test_a_render_shows_near_before_far_and_joints_in_colour() -> None:
    data = DatasetOptions("procedural", None, families=("Safe",))
    from model.data.registry import open_dataset

    obj = open_dataset(data).load("Safe_0_0").object
    colors = drawing.part_colors([p.link for p in obj.parts], obj.tree.root)
    plain = np.asarray(drawing.draw(obj, colors=colors))
    joints = np.asarray(drawing.draw(obj, colors=colors, joints=True))
    back = np.asarray(drawing.draw(obj, colors=colors, view=drawing.View(azimuth=0.0)))
    assert plain.shape == (260, 300, 3) and (plain != drawing.BACKGROUND).any()
    assert (joints == drawing.TURN).all(axis=2).sum() > 30
    door = next(c for link, c in colors.items() if link != obj.tree.root)

    def orange(picture: np.ndarray) -> int:
        """Pixels in the door's hue."""
        r, g, b = (picture[..., k].astype(int) for k in range(3))
        return int(((r - b > 60) & (r > g)).sum())

    assert door == drawing.PALETTE[1]
    assert orange(plain) > 500 > orange(back)  # the door is in front
    assert drawing.png(drawing.draw(obj))[:4] == b"\x89PNG"
