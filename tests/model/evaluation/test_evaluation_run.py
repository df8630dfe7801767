"""A whole run on a made data set: failures, crashes, resuming, reports, the command line."""

import json
import math
import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from model.core.articulated_object import Prediction
from model.core.errors import ConfigurationError, InputFileError
from model.core.joint import motion
from model.data.registry import DatasetOptions
from model.evaluation.report import (
    COLUMNS,
    PAPER_ROWS,
    read_report,
    score_from_json,
    score_to_json,
    write_markdown,
)
from model.evaluation.run import Corruption, EvaluationConfig, corrupt, evaluate, visible
from model.prediction import registry as predictors

URDF = """<robot name="made"><link name="base"/>
<link name="link_0"><visual><geometry><mesh filename="door.obj"/></geometry></visual></link>
<link name="link_1"><visual><geometry><mesh filename="body.obj"/></geometry></visual></link>
<joint name="joint_1" type="fixed"><parent link="base"/><child link="link_1"/></joint>
<joint name="joint_0" type="revolute"><origin xyz="-0.5 -0.5 0"/><axis xyz="0 0 1"/>
<parent link="link_1"/><child link="link_0"/><limit lower="0" upper="1.6"/></joint></robot>"""


def of(root: Path) -> DatasetOptions:
    return DatasetOptions("partnet-mobility", root)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Four good cupboards and one that is broken."""
    out = tmp_path / "data"
    for i in range(5):
        folder = out / f"{i}"
        folder.mkdir(parents=True)
        door = trimesh.util.concatenate(
            [
                trimesh.creation.box(extents=(0.04, 1.0, 1.0)),
                trimesh.creation.box(extents=(0.06, 0.03, 0.3)).apply_translation((-0.05, 0.4, 0)),
            ]
        )
        # The mesh of a link stands in the link's frame.
        door.apply_translation((-0.02, 0.5, 0))
        walls = [
            trimesh.creation.box(extents=(1, 0.05, 1)).apply_translation((0, s * 0.475, 0))
            for s in (-1, 1)
        ]
        back = trimesh.creation.box(extents=(0.05, 1, 1)).apply_translation((0.475, 0, 0))
        top = [
            trimesh.creation.box(extents=(1, 1, 0.05)).apply_translation((0, 0, s * 0.475))
            for s in (-1, 1)
        ]
        body = trimesh.util.concatenate([*walls, back, *top])
        for name, mesh in (("door", door), ("body", body)):
            (folder / f"{name}.obj").write_text(trimesh.exchange.obj.export_obj(mesh))
        (folder / "no.obj").write_text("v 0 0\n")
        (folder / "mobility.urdf").write_text(
            URDF if i != 2 else URDF.replace("door.obj", "no.obj")
        )
        (folder / "semantics.txt").write_text("link_0 hinge door\nlink_1 heavy furniture_body\n")
        (folder / "meta.json").write_text('{"model_cat": "StorageFurniture"}')
    return out


@pytest.mark.parametrize("jobs", [1, 2])
def test_one_bad_object_does_not_end_the_run(root: Path, jobs: int) -> None:
    report = evaluate(EvaluationConfig(of(root), predictor="geometric", jobs=jobs))
    by_id = {s.object_id: s for s in report.scores}
    assert list(by_id) == ["0", "1", "2", "3", "4"]
    assert "no.obj" in by_id["2"].problem and not by_id["2"].usable
    for i in "0134":
        assert by_id[i].usable, by_id[i]
    assert report.summary["usable"] == pytest.approx(4 / 5)
    assert report.summary.failed == 1


def test_what_is_wrong_with_the_question_is_said_first(root: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="geometric"):
        evaluate(EvaluationConfig(of(root), predictor="nobody"))
    with pytest.raises(ConfigurationError, match="partnet-mobility"):
        evaluate(EvaluationConfig(DatasetOptions("nothing", root)))
    with pytest.raises(InputFileError):
        evaluate(EvaluationConfig(of(tmp_path / "nowhere")))
    with pytest.raises(ConfigurationError, match="limit"):
        evaluate(EvaluationConfig(of(root), predictor="geometric", limit=0))


class Breaking:
    """Fails in each way by the object's name."""

    name = "breaking"

    def predict(self, segmented, *, locked=(), seed=0, progress=None) -> Prediction:
        if segmented.name == "0":
            raise RuntimeError("boom")
        if segmented.name == "1":
            os._exit(3)
        if segmented.name == "3":
            time.sleep(60)
        return Prediction(None, ("nothing came out",))


def test_crashes_hangs_and_exceptions_are_failures(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(predictors.PREDICTORS.built_in, "breaking", Breaking)
    report = evaluate(EvaluationConfig(of(root), predictor="breaking", jobs=2, timeout=2.0))
    problems = {s.object_id: s.problem for s in report.scores}
    assert "boom" in problems["0"]
    assert "died" in problems["1"]
    assert "2 s" in problems["3"]
    assert problems["4"] == "nothing came out"
    assert report.summary.missing == 4 and report.summary["tc"] == 0.0


def test_a_stopped_run_goes_on(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    asked: list[str] = []
    geometric = predictors.load_predictor("geometric")

    class Counting:
        name = "counting"

        def predict(self, segmented, **options) -> Prediction:
            asked.append(segmented.name)
            return geometric.predict(segmented, **options)

    monkeypatch.setitem(predictors.PREDICTORS.built_in, "counting", Counting)
    config = EvaluationConfig(of(root), predictor="counting", jobs=1, out=out)
    evaluate(config)
    log = out / "objects.jsonl"
    lines = log.read_text().splitlines()
    log.write_text("\n".join(lines[:3]) + "\n" + lines[3][: len(lines[3]) // 2])  # torn

    asked.clear()
    report = evaluate(config)
    assert len(report.scores) == 5
    assert asked == ["3", "4"]  # 0 and 1 were there; 2 can't be read

    other = replace(config, names=False)
    asked.clear()
    evaluate(other)
    assert asked == ["0", "1", "3", "4"]  # other settings start anew


def test_reports(root: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    report = evaluate(EvaluationConfig(of(root), predictor="geometric", jobs=1, limit=3, out=out))
    report.write(out)
    assert len(report.scores) == 3
    data = json.loads((out / "report.json").read_text())
    assert data["format_version"] == 2
    assert data["summary"]["objects"] == 3
    assert len(data["objects"]) == 3
    for s in report.scores:
        again = score_from_json(json.loads(json.dumps(score_to_json(s))))
        assert again == s
    assert read_report(out).scores == report.scores
    text = write_markdown([report], out / "report.md").read_text()
    for name, *_ in PAPER_ROWS:
        assert f"{name} \\[paper's own data\\]" in text
    assert all(c in text for c in COLUMNS)
    assert "NaN" not in (out / "report.json").read_text()


def test_a_turned_object_is_the_same_object(root: Path) -> None:
    from model.data.folders import PartNetMobility

    truth = PartNetMobility(root).load("0")
    turned = corrupt(truth, Corruption(yaw=0.7), np.random.default_rng(0))
    c, s = math.cos(0.7), math.sin(0.7)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    before, after = truth.object.tree.joint_of["link_0"], turned.object.tree.joint_of["link_0"]
    door = next(p for p in truth.object.parts if p.link == "link_0").mesh
    other = next(p for p in turned.object.parts if p.link == "link_0").mesh
    assert door is not None and other is not None
    homogeneous = np.column_stack([door.vertices, np.ones(len(door.vertices))])
    opened = (homogeneous @ motion(before, 0.9).T)[:, :3] @ turn.T
    also = np.column_stack([other.vertices, np.ones(len(other.vertices))]) @ motion(after, 0.9).T
    assert np.allclose(opened, also[:, :3], atol=1e-9)


def test_a_scan_sees_one_side(root: Path) -> None:
    from model.data.folders import PartNetMobility

    truth = PartNetMobility(root).load("0")
    seen = corrupt(truth, Corruption(scan=True, noise=0.0, view=math.pi), np.random.default_rng(0))
    clouds = {p.link: p.cloud for p in seen.object.parts}
    assert all(c is not None for c in clouds.values())
    body = clouds["link_1"].points
    # The door hides the inside: what is left of the body is its roof and its front rim.
    assert (body[:, 2] > 0.4).mean() > 0.8
    assert len(clouds["link_0"]) > len(body) * 0.3


def test_visibility() -> None:
    near, far = np.array([[1.0, 0, 0]]), np.array([[-1.0, 0, 0], [-1.0, 0.5, 0]])
    mask = visible(np.concatenate([near, far]), np.zeros(3), 2.0, 0.0, 0.0)
    assert mask.tolist() == [True, False, True]
