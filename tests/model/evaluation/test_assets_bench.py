"""Which exports engines and validators accept, as ``artiworld bench assets`` measures it."""

from __future__ import annotations

import json
import stat
from pathlib import Path

import pytest

from app.cli.main import main
from model.data.registry import DatasetOptions, open_dataset
from model.evaluation import bench
from model.evaluation.assets import AssetsConfig, beside, row, run, score_object, to_json
from model.evaluation.bench import half_of
from model.io import readback
from model.io.readback import write_and_read
from model.physics.simulation_values import plain_physics
from tests.model.validation.cabinets import DRAWER, cabinet

pytest.importorskip("mujoco")


@pytest.fixture
def one(monkeypatch):
    """A data set of one good and one bad cabinet: the drawer's way is a tenth of a metre back."""
    from dataclasses import replace

    objects = {"good": cabinet(), "bad": cabinet(drawer=replace(DRAWER, axis=(0.0, 1.0, 0.0)))}

    class Two:
        name = "two"

        def ids(self):
            return tuple(objects)

        def load(self, name):
            from model.data.registry import GroundTruth

            return GroundTruth(name, objects[name])

    monkeypatch.setattr(bench, "open_dataset", lambda _: Two())
    return AssetsConfig(
        DatasetOptions("two"), "all", engines=("mujoco",), formats=("mjcf", "glb"), jobs=1
    )


def test_a_row_counts_what_engines_and_readers_take(one):
    scores = run(one)
    by_id = {s.id: s for s in scores}
    assert by_id["good"].engines == {"mujoco": True}
    assert by_id["bad"].engines == {"mujoco": False}
    assert by_id["bad"].problems and by_id["bad"].readers["MuJoCo (mjcf)"]
    assert by_id["good"].shapes > by_id["good"].links == 3
    found = row(one, scores)
    assert (found["n"], found["MuJoCo"], found["other readers"]) == (2, 0.5, 1.0)
    assert found["shapes a link"] > 2
    report = json.loads(json.dumps(to_json([(one, scores)]), allow_nan=False))
    earlier = {"table": [{**report["table"][0], "MuJoCo": 0.25}]}
    (shown,) = beside(report["table"], earlier)
    assert shown["MuJoCo"] == "0.5 (0.25)" and "(" not in shown["objects"]
    assert "(" not in beside(report["table"], {})[0]["MuJoCo"]


def test_an_object_that_cannot_be_read_is_refused_everywhere(one, monkeypatch):
    def broken(_):
        raise ValueError("torn file")

    monkeypatch.setattr(bench, "open_dataset", broken)
    score = score_object(one, "good")
    assert score.engines == {"mujoco": False} and "torn file" in score.problems[0]
    assert row(one, [score])["MuJoCo"] == 0.0


def test_the_halves_share_nothing_and_are_all():
    ids = [str(i) for i in range(11)]
    a, b = (half_of(ids, h, 0, 0) for h in ("choose", "table"))
    assert not set(a) & set(b) and set(a) | set(b) == set(ids)
    assert half_of(ids, "table", 0, 3) == b[:3]


def test_programs_on_the_path_judge_too(tmp_path, monkeypatch):
    for name, code in (("check_urdf", 0), ("gz", 3)):
        program = tmp_path / name
        program.write_text(f"#!/bin/sh\necho 'line 7 is wrong' >&2\nexit {code}\n")
        program.chmod(program.stat().st_mode | stat.S_IEXEC)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    obj = cabinet()
    good = write_and_read(obj, plain_physics(obj), "urdf")
    assert "check_urdf" in good.readers and good.found["check_urdf"] == ()
    bad = write_and_read(obj, plain_physics(obj), "sdf")
    assert bad.found["gz sdf"] == ("gz sdf: line 7 is wrong",) and not bad.fine


def test_khronos_validator_reads_the_issues(monkeypatch):
    said = {"messages": [{"code": "A", "message": "bad", "severity": 0},
                         {"code": "B", "message": "odd", "severity": 1}]}  # fmt: skip
    answer = readback.subprocess.CompletedProcess([], 0, json.dumps(said), "")
    monkeypatch.setattr(readback.subprocess, "run", lambda *_, **__: answer)
    assert readback.gltf_validator(Path("x.glb")) == ["glTF-Validator: A: bad"]


def test_the_bundled_objects_are_a_data_set():
    data = open_dataset(DatasetOptions("bundled"))
    assert len(data.ids()) == 8
    laptop = data.load("laptop")
    assert laptop.object.category == data.category("laptop") == "Laptop"
    assert [j.type for j in laptop.object.tree.joints] == ["revolute"]
    with pytest.raises(Exception, match="no example 'spoon'; there are cabinet"):
        data.load("spoon")


def test_the_command_prints_the_table(one, monkeypatch, capfd, tmp_path):
    monkeypatch.setattr("app.cli.benchmarks.predictions.folder_runs", lambda *_, **__: [one])
    words = ["bench", "assets", "--engine", "mujoco", "--jobs", "1"]
    assert main([*words, "--json"]) == 0
    text = capfd.readouterr().out
    (tmp_path / "old.json").write_text(text)
    assert json.loads(text)["table"][0]["MuJoCo"] == 0.5
    assert main([*words, "--before", str(tmp_path / "old.json")]) == 0
    assert "0.5 (0.5)" in capfd.readouterr().out
    assert main([*words, "--engine", "bullet"]) == 2
