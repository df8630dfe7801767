"""``artiworld evaluate`` as a user runs it: several methods in one table, reports, comparisons."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from app.cli.evaluate import annotate_all
from app.cli.main import main
from app.cli.simulated_annotator import BY_HAND, AnnotatorConfig, annotate
from model.data.registry import DatasetOptions, open_dataset
from model.io.export.urdf import UrdfExporter

MADE = tuple("--data procedural --family Safe Laptop --jobs 1 --timeout 900".split())


def written(folder: Path, *ids: str) -> Path:
    """The truth of made objects as somebody's predictions."""
    data = open_dataset(DatasetOptions("procedural", families=("Safe", "Laptop")))
    for object_id in ids:
        (folder / object_id).mkdir(parents=True)
        UrdfExporter().export(data.load(object_id).object, folder / object_id)
    return folder


def test_several_methods_in_one_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    theirs = written(tmp_path / "theirs", "Safe_0_0")
    out = tmp_path / "out"
    options = ("--predictor", "geometric,truth", "--predictions", f"oracle={theirs}")
    assert main(["evaluate", *MADE, *options, "--out", str(out), "--json"]) == 0
    runs = {r["predictor"]: r for r in json.loads(capsys.readouterr().out)["runs"]}
    assert set(runs) == {"geometric", "truth", "oracle"}
    assert runs["truth"]["summary"]["usable"] == 1.0
    # One of two objects is there: the other one counts against the method.
    assert runs["oracle"]["summary"]["usable"] == 0.5
    assert runs["oracle"]["summary"]["failed"] == 1 and runs["oracle"]["frame"] == "as it is"
    figures = runs["oracle"]["summary"]
    assert figures["apd"] == pytest.approx(0.0, abs=1e-12)
    assert figures["apd_all"] == pytest.approx(math.pi / 2 / 4)  # one of four is missing
    for name in runs:
        assert (out / name / "report.json").is_file()
    table = (out / "report.md").read_text()
    assert "paper's own data" in table and "oracle" in table
    assert "<img" in (out / "report.html").read_text()

    compared = tmp_path / "compared"
    words = ["--compare", str(out / "oracle"), str(out / "truth"), "--out", str(compared)]
    assert main(["evaluate", *words]) == 0
    assert "fixed Laptop_0_0" in capsys.readouterr().out
    assert "fixed" in (compared / "comparison.md").read_text()


def test_objects_are_exported_for_predict(tmp_path: Path) -> None:
    parts = tmp_path / "parts"
    assert main(["evaluate", *MADE, "--split", "category:Safe", "--export", str(parts)]) == 0
    assert [p.name for p in parts.iterdir()] == ["Safe_0_0"]
    described = json.loads((parts / "Safe_0_0" / "object.json").read_text())
    assert described["category"] == "Safe" and len(described["parts"]) > 1
    assert main(["predict", str(parts / "Safe_0_0"), "--out", str(tmp_path / "predicted")]) == 0
    assert (tmp_path / "predicted" / "object.urdf").is_file()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--data", "nothing"), "partnet-mobility"),
        (("--data", "urdf"), "--root"),
        ((*MADE, "--split", "half"), "held-out"),
        ((*MADE, "--predictor", "nobody"), "geometric"),
        ((*MADE, "--predictor", "geometric,geometric"), "NAME=DIR"),
        ((*MADE, "--predictions", "/nowhere"), "no such folder"),
        ((*MADE, "--predictions", "x=/nowhere", "--yaw"), "--yaw"),
        ((*MADE, "--person", "--segmentation"), "together"),
        ((*MADE, "--person", "--predictor", "nobody"), "geometric"),
        (("--compare", "/nowhere", "/nowhere"), "evaluation"),
        ((*MADE, "--limit", "0"), "limit"),
    ],
)
def test_mistakes_are_reported_in_one_line(
    words: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", *words]) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith("artiworld") and message in error


def test_segmentation_by_simulated_clicks(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = ["--segmentation", "--limit", "1", "--points", "2500", "--out", str(out), "--json"]
    assert main(["evaluate", *words]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [r["dataset"] for r in rows] == [
        *"procedural procedural-noisy procedural-one-sided".split()
    ]
    for row in rows:
        assert 0 < row["summary"]["IoU@1"] <= 1 and 1 <= row["summary"]["NoC@90"] <= 20
    assert json.loads((out / "segmentation.json").read_text())["rows"]


def test_the_annotator_ends_with_the_right_object() -> None:
    """Clicks, names, prediction and corrections go through a session; by hand takes more."""
    data = DatasetOptions("procedural", families=("Safe",))
    config = AnnotatorConfig(data, ("geometric",), points=6000)
    report = annotate_all(config, ["Safe_0_0"], 1)
    predicted, by_hand = report.scores
    assert (predicted.predictor, by_hand.predictor) == ("geometric", BY_HAND)
    assert predicted.right and by_hand.right, (predicted.why, by_hand.why)
    assert predicted.clicks == by_hand.clicks >= predicted.parts
    assert by_hand.wrong == by_hand.joints > 0
    # Each moving joint needs a type, most an axis, an origin or limits as well.
    assert predicted.corrections < by_hand.corrections >= by_hand.joints
    assert predicted.commands > predicted.clicks + predicted.corrections
    assert json.dumps(report.to_json()) and "geometric" in report.to_markdown()


def test_an_object_that_cannot_be_annotated_is_reported() -> None:
    data = DatasetOptions("procedural", families=("Safe",))
    found = annotate(AnnotatorConfig(data, ("geometric",)), "Spaceship_0_0")
    assert [s.predictor for s in found] == ["geometric", BY_HAND]
    assert not any(s.right for s in found) and "Spaceship" in found[0].why


def test_a_mistake_is_one_line_without_a_bar_before_it(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "--data", "partnet-mobility"]) == 2
    error = capfd.readouterr().err
    assert error.startswith("artiworld: ") and error.count("\n") == 1
