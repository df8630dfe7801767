"""The command line, as a person or a script uses it."""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yourdfpy

from app.cli import export
from app.cli.commands import COMMANDS
from app.cli.export import Crashed, run_all
from app.cli.main import main, parse
from app.cli.options import shown
from app.cli.reference import commands
from app.server.ending import write_crash
from model.core.errors import KinematicsError
from model.io.assets.reader import read_provenance
from tests.app.job_functions import crash_on
from tests.app.run_cli import (
    BASE_CLICK,
    DOOR_CLICK,
    HANDLE_CLICK,
    answer,
    artiworld,
    artiworld_process,
    assert_users_mistake,
    cupboard,
    write_prompts,
)

NEAREST = ("--segmenter", "nearest")
HEAVY = ("torch", "viser", "open3d", "scipy", "mujoco", "sqlalchemy", "trimesh", "numpy", "rich")


@pytest.fixture(scope="module")
def scan(tmp_path_factory) -> Path:
    """A cupboard as one mesh, +z up, metres."""
    path = tmp_path_factory.mktemp("scan") / "cupboard.ply"
    trimesh.util.concatenate(cupboard()).export(path)
    return path


@pytest.fixture(scope="module")
def segmented(scan, tmp_path_factory) -> tuple[Path, dict]:
    folder = tmp_path_factory.mktemp("segmented")
    prompts = write_prompts(
        folder / "prompts.json",
        {
            "format": 1,
            "category": "cupboard",
            "parts": [{"id": 1, "name": "door"}],
            "clicks": [DOOR_CLICK, HANDLE_CLICK, BASE_CLICK],
        },
    )
    return folder / "out", answer("segment", scan, "--prompts", prompts, "--out", folder / "out")


@pytest.fixture
def parts(tmp_path) -> Path:
    """The cupboard as two files."""
    folder = tmp_path / "parts"
    folder.mkdir()
    for i, mesh in enumerate(cupboard()):
        mesh.export(folder / f"link_{i}.obj")
    return folder


# Help, and what it costs


def test_help_imports_nothing_heavy():
    pages = [["--help"], ["serve", "--help"], ["predict", "--help"], ["bench", "ui", "--help"]]
    code = (
        "import sys\nfrom app.cli.main import main\n"
        f"assert not any(main(words) for words in {pages!r})\n"
        f"print([m for m in {HEAVY!r} if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.strip() == "[]"
    assert "usage: artiworld" in done.stdout


def test_help_is_quick():
    before = os.times()
    done = artiworld_process("--help")
    after = os.times()
    assert after.children_user - before.children_user < 0.5
    for command in COMMANDS:
        assert f"\n  {command} " in done.stdout


def test_version():
    assert artiworld("--version").stdout.startswith("artiworld ")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "COMMAND"),
        (["segmnt"], "segment"),
        (["segment"], "--out"),
        (["segment", "a.ply", "--prompts", "p", "--out", "o", "--up-axis", "w"], "--up-axis"),
        (
            ["segment", "a.ply", "--prompts", "p", "--out", "o", "--unit-scale", "-1"],
            "--unit-scale",
        ),
        (
            ["segment", "a.ply", "--prompts", "p", "--out", "o", "--unit-scale", "nan"],
            "--unit-scale",
        ),
        (["predict", "x", "--out", "y", "--seed", "one"], "--seed"),
        (["predict", "x", "--out", "y", "--pred", "geometric"], "--pred"),
    ],
)
def test_wrong_usage_is_one_line(words, message, capsys):
    assert main(words) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and message in lines[0] and "--help" in lines[0]


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (["serve", "a", "--backend", "http://gpu:1", "b"], "paths"),
        (["serve", "--port", "0", "a", "--scene", "b"], "paths"),
        (["export", "a", "--format", "urdf", "b", "--out", "o"], "assets"),
        (["check", "a", "--json", "b"], "assets"),
        (["check", "--json", "--", "a", "b"], "assets"),
    ],
)
def test_paths_stand_before_between_and_after_options(words, name):
    paths = getattr(parse(words)[0], name)
    assert [str(path) for path in paths] == ["a", "b"]


@pytest.mark.parametrize(
    ("name", "value"),
    [("prepare", f"--up={up}") for up in ("-z", "-x", "-1,0,0.5", "-.5,0,1")]
    + [("segment", "--up-axis=-z"), ("predict", "--up-axis=-x")],
)
def test_a_value_may_begin_with_a_minus(name, value):
    words = [name, "a.ply", "--out", "o"]
    assert parse([*words, *value.split("=")]) == parse([*words, value])


def test_options_of_a_benchmark_may_stand_before_it():
    assert parse(["bench", "--half", "choose", "scans", "--json"]) == parse(
        ["bench", "scans", "--half", "choose", "--json"]
    )
    assert parse(["release", "w", "--name", "n"]) == parse(["release", "create", "w", "--name=n"])


# segment


def test_segment_writes_every_face_into_exactly_one_part(scan, segmented):
    folder, report = segmented
    whole = trimesh.load(scan, process=False)
    files = [part["file"] for part in report["parts"]]
    assert files == ["link_0.obj", "link_1.obj"]
    pieces = [trimesh.load(folder / f, process=False) for f in files]
    assert sum(len(p.faces) for p in pieces) == len(whole.faces)
    assert math.isclose(sum(p.area for p in pieces), whole.area, rel_tol=1e-6)
    assert report["parts"][1]["name"] == "door"
    door = pieces[1].bounds
    np.testing.assert_allclose(door, [[0.0, -0.05, 0.0], [0.6, -0.002, 0.8]], atol=1e-6)


def test_segment_reports_parts_and_source(segmented):
    folder, report = segmented
    assert json.loads((folder / "object.json").read_text()) == report
    assert report["format"] == 1 and report["category"] == "cupboard"
    assert report["source"]["count"] == sum(part["count"] for part in report["parts"])
    assert len(report["source"]["sha256"]) == 64
    assert report["segmenter"] and report["problems"] == []


def test_segment_replaces_its_own_result_and_nothing_else(scan, tmp_path):
    out = tmp_path / "out"

    def regions(*parts: int) -> Path:
        chosen = [{"part": p, "elements": [p, p + 10]} for p in parts]
        return write_prompts(tmp_path / "p.json", {"regions": chosen})

    def cut(prompts: Path, out: Path):
        return artiworld("segment", scan, "--prompts", prompts, "--out", out, *NEAREST)

    assert cut(regions(1, 9), out).returncode == 0
    assert (out / "link_9.obj").is_file()
    assert cut(regions(1), out).returncode == 0
    assert sorted(p.name for p in out.iterdir()) == [
        "link_0.mtl", "link_0.obj", "link_1.mtl", "link_1.obj", "object.json",
    ]  # fmt: skip
    (out / "object.json").unlink()
    for folder in (out, tmp_path / "theirs"):
        folder.mkdir(exist_ok=True)
        (folder / "thesis.tex").write_text("x")
        before = sorted(folder.iterdir())
        assert_users_mistake(cut(regions(1), folder), "holds other files")
        assert sorted(folder.iterdir()) == before


def test_segment_asks_about_a_file_in_millimetres(tmp_path):
    mesh = trimesh.util.concatenate(cupboard())
    mesh.apply_scale(1000)
    mesh.export(tmp_path / "scan.stl")
    prompts = write_prompts(tmp_path / "p.json", {"regions": [{"part": 1, "elements": [0, 1]}]})
    words = ("--prompts", prompts, "--out", tmp_path / "out", "--json", *NEAREST)
    report = json.loads(artiworld("segment", tmp_path / "scan.stl", *words).stdout)
    assert "is the file in millimetres? If so, give --unit-scale 0.001" in report["problems"][-1]


def test_predict_takes_what_segment_wrote(segmented, tmp_path):
    folder, _ = segmented
    out = tmp_path / "asset"
    done = artiworld("predict", folder, "--out", out)
    assert done.returncode == 0, done.stderr
    assert "revolute" in done.stdout and "door" in done.stdout
    prediction = json.loads((out / "prediction.json").read_text())
    (joint,) = prediction["joints"]
    assert (joint["type"], joint["parent"], joint["child"]) == ("revolute", "base", "door_1")
    np.testing.assert_allclose(np.abs(joint["axis"]), [0, 0, 1], atol=1e-6)
    assert abs(joint["origin"][0]) < 0.03 and abs(joint["origin"][1]) < 0.05
    assert prediction["category"] == "cupboard"


def test_segment_of_a_cloud_gives_clouds(tmp_path):
    points = np.concatenate([trimesh.sample.sample_surface(m, 4000, seed=1)[0] for m in cupboard()])
    trimesh.PointCloud(points).export(tmp_path / "scan.ply")
    prompts = write_prompts(
        tmp_path / "p.json", [DOOR_CLICK, {"point": [0.3, 0.5, 0.4], "part": 1, "label": 0}]
    )
    out = tmp_path / "out"
    done = artiworld("segment", tmp_path / "scan.ply", "--prompts", prompts, "--out", out)
    assert done.returncode == 0, done.stderr
    report = json.loads((out / "object.json").read_text())
    assert [p["file"] for p in report["parts"]] == ["link_0.ply", "link_1.ply"]
    assert sum(p["count"] for p in report["parts"]) == 8000
    assert len(trimesh.load(out / "link_1.ply").vertices) == report["parts"][1]["count"]


def test_regions_count_exactly(scan, tmp_path):
    prompts = write_prompts(tmp_path / "p.json", {"regions": [{"part": 3, "elements": [5, 6, 7]}]})
    found = answer("segment", scan, "--prompts", prompts, "--out", tmp_path / "out", *NEAREST)
    assert {p["file"]: p["count"] for p in found["parts"]}["link_3.obj"] == 3


def test_up_axis_and_unit_turn_the_frame_of_the_clicks(tmp_path):
    meshes = cupboard()
    turn = trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0))  # +z up to +y up
    whole = trimesh.util.concatenate(meshes)
    whole.apply_transform(turn)
    whole.apply_scale(1000.0)
    whole.export(tmp_path / "millimetres.stl")
    prompts = write_prompts(tmp_path / "p.json", [DOOR_CLICK, HANDLE_CLICK, BASE_CLICK])
    out = tmp_path / "out"
    words = ("segment", tmp_path / "millimetres.stl", "--prompts", prompts, "--out", out)
    turned = (*words, "--unit-scale", "0.001")
    assert_users_mistake(artiworld(*turned), "p.json", "clicks[0].position", "away")
    done = artiworld(*turned, "--up-axis", "y")
    assert done.returncode == 0, done.stderr
    np.testing.assert_allclose(
        trimesh.load(out / "link_1.obj").bounds, [[0, -0.05, 0], [0.6, -0.002, 0.8]], atol=1e-5
    )


def test_segment_never_overwrites_its_input(scan, tmp_path):
    prompts = write_prompts(tmp_path / "p.json", [DOOR_CLICK])
    done = artiworld("segment", scan, "--prompts", prompts, "--out", scan.parent)
    assert_users_mistake(done, "--out", str(scan.parent))
    done = artiworld("segment", scan, "--prompts", prompts, "--out", prompts)
    assert_users_mistake(done, "--out", "is a file")


# predict


def test_predict_writes_a_urdf_that_other_readers_open(parts, tmp_path):
    out = tmp_path / "asset"
    prediction = answer("predict", parts, "--out", out, "--category", "cupboard")
    assert prediction == json.loads((out / "prediction.json").read_text())
    robot = yourdfpy.URDF.load(str(out / "object.urdf"))
    assert set(robot.link_map) == set(prediction["links"]) >= {"base", "link_1"}
    assert robot.base_link == prediction["base"] == "base"
    (moving,) = [j for j in robot.joint_map.values() if j.type != "fixed"]
    (predicted,) = [j for j in prediction["joints"] if j["type"] != "fixed"]
    assert (moving.name, moving.type) == (predicted["name"], "revolute")
    assert [moving.limit.lower, moving.limit.upper] == pytest.approx(predicted["limits"], abs=1e-6)
    assert 0.0 <= predicted["confidence"] <= 1.0
    for name in ("tree.json", "provenance.json", "meshes"):
        assert (out / name).exists()
    for key in ("backend", "seconds", "problems", "seed"):
        assert key in prediction
    assert prediction["category"] == "cupboard"


def test_predict_warns_of_a_misspelt_category(parts, tmp_path):
    done = artiworld("predict", parts, "--out", tmp_path / "asset", "--category", "cabnit")
    assert done.returncode == 0, done.stderr
    assert "note: category 'cabnit' is none that is known; did you mean 'cabinet'?" in done.stdout


def test_predict_is_repeatable_and_replaces_its_own_result(parts, tmp_path):
    out = tmp_path / "asset"
    texts = []
    for _ in range(2):
        assert artiworld("predict", parts, "--out", out, "--seed", "3").returncode == 0
        texts.append((out / "object.urdf").read_bytes())
    assert texts[0] == texts[1]


def test_object_json_names_files_names_and_category(parts, tmp_path):
    (parts / "link_0.obj").rename(parts / "body.obj")
    (parts / "link_1.obj").rename(parts / "front.obj")
    (parts / "object.json").write_text(
        json.dumps(
            {
                "category": "oven",
                "parts": [{"file": "front.obj", "name": "door"}, {"file": "body.obj"}],
            }
        )
    )
    found = answer("predict", parts, "--out", tmp_path / "o")
    assert found["category"] == "oven"
    assert {p["link"]: p["name"] for p in found["parts"]} == {"front": "door", "body": None}
    assert found["base"] == "body"


def test_predict_keeps_other_peoples_files(parts, tmp_path):
    out = tmp_path / "full"
    out.mkdir()
    (out / "thesis.tex").write_text("x")
    assert_users_mistake(artiworld("predict", parts, "--out", out), "full", "other files")
    assert [p.name for p in out.iterdir()] == ["thesis.tex"]
    assert_users_mistake(artiworld("predict", parts, "--out", parts), "--out")


def test_predict_and_export_agree_on_the_mass(segmented, tmp_path, capfd):
    parts = str(segmented[0])
    assert main(["predict", parts, "--out", str(tmp_path / "a")]) == 0
    assert "no collision shapes (--collision makes them)" in capfd.readouterr().out
    report = answer("predict", parts, "--out", str(tmp_path / "b"), "--collision")
    assert (
        main(["export", str(tmp_path / "a"), "--format", "urdf", "--out", str(tmp_path / "c")]) == 0
    )
    plain, shaped, exported = (
        (tmp_path / name / "object.urdf").read_text() for name in ("a", "b", "c")
    )
    masses = [re.findall(r'<mass value="[^"]+"', text) for text in (plain, shaped, exported)]
    assert masses[0] == masses[1] == masses[2]
    assert "<collision>" not in plain and shaped.count("<collision>") == report["collision_shapes"]
    assert report["kilograms"] > 0


def test_unknown_names_list_the_known_ones(parts, scan, tmp_path):
    done = artiworld("predict", parts, "--out", tmp_path / "o", "--predictor", "magic")
    assert_users_mistake(done, "magic", "geometric")
    prompts = write_prompts(tmp_path / "p.json", [DOOR_CLICK])
    done = artiworld(
        "segment", scan, "--prompts", prompts, "--out", tmp_path / "o", "--segmenter", "magic"
    )
    assert_users_mistake(done, "magic", "default")


# export


@pytest.fixture(scope="module")
def asset(segmented, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("asset") / "out"
    assert main(["predict", str(segmented[0]), "--out", str(out)]) == 0
    return out


def test_export_lists_many_collision_shapes_in_one_row(capfd):
    shapes = [{"file": f"meshes/collision/link_0_{i}.obj", "bytes": 100} for i in range(24)]
    files = [{"file": "object.urdf", "bytes": 7}, {"file": "meshes/link_0.obj", "bytes": 9}]
    export.print_files({"asset": "a", "format": "urdf", "files": files + shapes}, Path("o"))
    out = capfd.readouterr().out
    assert "object.urdf" in out and "meshes/link_0.obj" in out
    assert "meshes/collision/ · 24 files" in out and "2,400" in out and "link_0_3" not in out


@pytest.mark.parametrize("form", ["urdf", "mjcf", "glb", "usd"])
def test_export_writes_files_that_other_programs_open(asset, form, tmp_path, capfd):
    report = answer("export", str(asset), "--format", form, "--out", str(tmp_path / "out"))
    assert report["format"] == form
    first = tmp_path / "out" / report["files"][0]["file"]
    assert first.stat().st_size == report["files"][0]["bytes"] > 0
    if form == "urdf":
        assert len(yourdfpy.URDF.load(str(first)).actuated_joints) == 1
    elif form == "mjcf":
        mujoco = pytest.importorskip("mujoco")
        assert mujoco.MjModel.from_xml_path(str(first)).njnt == 1
    elif form == "usd":
        stage = pytest.importorskip("pxr.Usd").Stage.Open(str(first))
        assert stage.GetDefaultPrim()
    else:
        assert len(trimesh.load(first).geometry) >= 2


@pytest.mark.parametrize("metres", [0.003, 0.03, 30.0])  # most tests have 0.3 to 3 m
def test_objects_of_any_size_pass_every_command(metres, tmp_path):
    parts, out = tmp_path / "parts", tmp_path / "out"
    parts.mkdir()
    for i, mesh in enumerate(cupboard()):
        mesh.apply_scale(metres / 0.8)
        mesh.export(parts / f"link_{i}.obj")
    options = "--up-axis", "z", "--json"
    done = artiworld("predict", parts, "--out", tmp_path / "asset", "--collision", *options)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["joints"][0]["type"] == "revolute"
    done = artiworld("check", tmp_path / "asset", "--format", "urdf", "--no-cache", "--json")
    assert done.returncode in (0, 1) and "error" not in json.loads(done.stdout), done.stdout
    words = "--format", "all", "--check", "--out", out, "--no-cache", "--json"
    done = artiworld("export", tmp_path / "asset", *words)
    assert done.returncode == 0, done.stdout + done.stderr
    for form in json.loads(done.stdout)["formats"]:
        assert form["readers"] and not form["problems"]


@pytest.mark.parametrize("metres", [0.003, 30.0])
def test_scans_of_any_size_are_completed(metres, tmp_path):
    parts = tmp_path / "parts"
    parts.mkdir()
    for i, mesh in enumerate(cupboard()):
        mesh.apply_scale(metres / 0.8)
        trimesh.PointCloud(mesh.sample(2000, seed=i)).export(parts / f"link_{i}.ply")
    done = artiworld("predict", parts, "--out", tmp_path / "asset", "--complete", "--json")
    assert done.returncode == 0, done.stderr
    completed = read_provenance(tmp_path / "asset")["asset"]["completed"]
    assert sorted(completed) == ["base", "link_1"]


@pytest.fixture
def cupboards(asset, tmp_path) -> Path:
    """A folder of two assets, one of them damaged."""
    folder = tmp_path / "assets"
    shutil.copytree(asset, folder / "good")
    shutil.copytree(asset, folder / "bad")
    (folder / "bad" / "object.urdf").write_text("<robot")
    return folder


def test_one_bad_asset_does_not_end_the_export_of_a_folder(cupboards, tmp_path, capfd):
    words = ["export", str(cupboards), "--format", "urdf,mjcf", "--format", "sdf", "--check",
             "--out", str(tmp_path / "o"), "--no-cache", "--jobs", "1", "--json"]  # fmt: skip
    assert main(words) == 2
    report = json.loads(capfd.readouterr().out)
    assert (report["written"], report["failed"]) == (1, 1)
    bad, good = report["assets"]
    assert "well-formed" in bad["error"] and sum(good["collision_shapes"].values()) > 0
    assert [f["format"] for f in good["formats"]] == ["urdf", "mjcf", "sdf"]
    assert all(f["readers"] and not f["problems"] for f in good["formats"])
    assert (tmp_path / "o" / "good" / "sdf" / "model.sdf").is_file()
    assert not (tmp_path / "o" / "bad").exists()


def test_export_options_reach_the_files(asset, tmp_path, capfd):
    base = ["export", str(asset), "--format", "urdf", "--no-cache", "--json"]

    def text(name: str, *options: str) -> str:
        assert main([*base, "--out", str(tmp_path / name), *options]) == 0
        return (tmp_path / name / "object.urdf").read_text()

    def mass(text: str) -> float:
        return sum(map(float, re.findall(r'<mass value="([^"]+)"', text)))

    plain = text("plain", "--material", "wood", "--density", "500")
    heavy = text("heavy", "--material", "wood", "--density", "1000", "--no-collision",
                 "--turning", "0.5,0.25", "--sliding", "7,8")  # fmt: skip
    assert mass(heavy) == pytest.approx(2 * mass(plain), rel=1e-6)
    assert "<collision>" in plain and "<collision>" not in heavy
    assert 'damping="0.5" friction="0.25"' in heavy or 'damping="7" friction="8"' in heavy
    capfd.readouterr()
    for wrong, message in (
        (["--method", "magic"], "hollow"),
        (["--density", "-3"], "--density"),
        (["--material", "kryptonite"], "wood"),
        (["--turning", "much"], "--turning"),
        (["--max-hulls", "0"], "max_hulls"),
    ):
        assert main([*base, "--out", str(tmp_path / "x"), *wrong]) == 2
        assert message in capfd.readouterr().err


def test_check_tells_good_from_bad(cupboards, capfd):
    words = ["check", str(cupboards), "--format", "urdf,glb", "--no-cache", "--jobs", "1"]
    assert main([*words, "--json", "--no-gate"]) == 1
    report = json.loads(capfd.readouterr().out)
    bad, good = report["assets"]
    assert not bad["fine"] and "well-formed" in bad["error"]
    assert good["fine"] and good["inertia_problems"] == [] and good["kilograms"] > 0
    assert good["collision"]["overlap_at_rest_m"] == 0
    assert good["collision"]["free_kept"] > good["collision"]["free_kept_by_one_hull"]
    assert report["summary"]["fine"] == 1 and report["summary"]["unreadable"] == 1
    words = ["check", str(cupboards / "good"), "--format", "glb", "--no-cache"]
    assert main(words) == 0
    out = capfd.readouterr().out
    assert "1 of 1 can be read back; validation: 1 fine," in out and "note:" not in out


def test_changes_on_reading_a_urdf_are_noted(cupboards, tmp_path, capfd):
    urdf = cupboards / "good" / "object.urdf"
    urdf.write_text(re.sub(r'<axis xyz="[^"]*"', '<axis xyz="0 0 2"', urdf.read_text()))
    given = [str(cupboards), "--jobs", "1", "--no-cache"]
    main(["check", *given, "--format", "urdf", "--no-gate", "--no-collision"])
    main(["export", *given, "--format", "urdf,sdf", "--out", str(tmp_path / "o"), "--no-collision"])
    out = " ".join(capfd.readouterr().out.split())
    assert out.count("axis of length 2 was normalised") == 2
    about = json.loads((tmp_path / "o" / "good" / "sdf" / "artiworld.json").read_text())
    assert (about["format"], about["asset"]) == ("sdf", "good")
    assert any("axis of length 2" in note for note in about["notes"])
    assert about["predictor"].startswith("hybrid")
    assert str(tmp_path) not in json.dumps(about), "an export names no folders of this machine"


def test_a_joint_predicted_with_low_confidence_is_a_warning(parts, tmp_path, capfd):
    out = tmp_path / "asset"
    assert main(["predict", str(parts), "--out", str(out), "--category", "cupboard"]) == 0
    prediction = json.loads((out / "prediction.json").read_text())
    prediction["joints"][0]["confidence"] = 0.02
    (out / "prediction.json").write_text(json.dumps(prediction))
    words = ["check", str(out), "--format", "glb", "--no-cache", "--no-collision", "--json"]

    def verdicts() -> list[str]:
        capfd.readouterr()
        main(words)
        (row,) = json.loads(capfd.readouterr().out)["assets"]
        return [f["kind"] for j in row["gate"]["joints"] for f in j["findings"]]

    assert verdicts() == ["unsure"]
    main(words[:-1])
    assert "Low confidence (2 %)" in capfd.readouterr().out, "the reason is printed"
    # What somebody changed since is no prediction any more.
    urdf = (out / "object.urdf").read_text()
    upper = re.search(r' upper="[^"]+"', urdf)
    assert upper is not None
    (out / "object.urdf").write_text(urdf.replace(upper.group(), ' upper="0.5"'))
    assert verdicts() == []


def test_a_joint_with_an_error_fails_the_check(cupboards, capfd):
    urdf = cupboards / "good" / "object.urdf"
    text = urdf.read_text()
    axis = re.search(r'<axis xyz="[^"]+"', text)
    assert axis is not None
    urdf.write_text(text.replace(axis.group(), '<axis xyz="1 0 0"'))
    words = ["check", str(urdf), "--format", "glb", "--no-cache"]
    assert main([*words, "--json"]) == 1
    report = json.loads(capfd.readouterr().out)
    (row,) = report["assets"]
    assert row["readable"] and not row["fine"] and row["gate"]["verdict"] == "broken"
    assert report["summary"]["readable"] == 1 and report["summary"]["fine"] == 0
    assert main([*words, "--allow-broken"]) == 0
    out = capfd.readouterr().out
    assert "validation: 0 fine, 0 with warnings, 1 with errors" in out
    assert "_hinge" in out


def test_a_worker_that_crashes_ends_nothing():
    assert [type(a) for _, a in sorted(run_all(crash_on, ["fine", "crash", "fine"], 2))] == [
        str, Crashed, str
    ]  # fmt: skip


def test_export_names_mistakes(asset, tmp_path, capfd):
    for words, message in (
        ([str(asset), "--format", "dwg", "--out", str(tmp_path / "o")], "mjcf"),
        ([str(tmp_path), "--format", "urdf", "--out", str(tmp_path / "o")], "object.urdf"),
        ([str(asset), "--format", "urdf", "--out", str(asset)], "--out"),
    ):
        assert main(["export", *words]) == 2
        lines = capfd.readouterr().err.strip().splitlines()
        assert len(lines) == 1 and message in lines[0]


# Our own faults


def test_our_fault_is_code_1_with_details_in_a_file(monkeypatch, tmp_path, capsys):
    def broken(*_, **__):
        raise ZeroDivisionError("deep inside")

    monkeypatch.setattr("app.cli.predict.predict", broken)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["artiworld", "serve", "--token", "secret", "--database=pw"])
    assert main(["predict", "x", "--out", "y"]) == 1
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and "deep inside" in lines[0]
    (log,) = (tmp_path / "artiworld").iterdir()
    assert str(log) in lines[0]
    text = log.read_text()
    assert "ZeroDivisionError" in text and "in broken" in text
    assert "secret" not in text and "pw" not in text


def test_no_option_with_a_secret_gets_into_the_file(monkeypatch, tmp_path):
    named = [name for _, command in commands() for name in shown(command)]
    options = {name.split()[0] for name in named if name.startswith("--")}
    found = {o for o in options if re.search("token|secret|password|key|datab", o)}
    assert found >= {"--token", "--backend-token", "--database"}
    urls = {o for o in options if o.endswith(("url", "backend", "predictor"))}
    assert "--finder-url" in urls
    words = [w for o in sorted(found) for w in (o, "hush", f"{o}=hush")]
    words += [w for o in sorted(urls) for w in (o, "https://me:hush@h/v1", f"{o}=http://hush@h/v1")]
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["artiworld", "serve", *words, "kept"])
    text = write_crash(RuntimeError("no answer from https://me:hush@h/v1")).read_text()
    assert "hush" not in text and "…@h/v1" in text and "kept" in text


def test_debug_shows_the_traceback(monkeypatch, capsys):
    def broken(*_, **__):
        raise ZeroDivisionError("deep inside")

    monkeypatch.setattr("app.cli.predict.predict", broken)
    for words in (["--debug", "predict"], ["predict", "--debug"]):
        assert main([*words, "x", "--out", "y"]) == 1
        assert "in broken" in capsys.readouterr().err


def test_several_problems_are_still_one_line(monkeypatch, capsys):
    def broken(*_, **__):
        raise KinematicsError(["first\nproblem", "second"])

    monkeypatch.setattr("app.cli.predict.predict", broken)
    assert main(["predict", "x", "--out", "y"]) == 2
    assert capsys.readouterr().err == "artiworld: first problem; second\n"


def test_no_tree_is_code_1_with_the_reason_in_a_file(monkeypatch, parts, tmp_path, capsys):
    from model.core.articulated_object import Prediction

    class Silent:
        name = "silent"

        def predict(self, segmented, **_):
            return Prediction(None, ("the model gave nothing",), backend="silent 1")

    monkeypatch.setattr("app.cli.predict.load_predictor", lambda name: Silent())
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    out = tmp_path / "out"
    for _ in range(2):
        assert main(["predict", str(parts), "--out", str(out)]) == 1
        assert "the model gave nothing" in capsys.readouterr().err
    kept = json.loads((out / "prediction.json").read_text())
    assert kept["joints"] == [] and kept["problems"] == ["the model gave nothing"]
    monkeypatch.undo()
    assert main(["predict", str(parts), "--out", str(out)]) == 0


def test_generate_makes_objects_that_evaluate_reads(tmp_path):
    done = artiworld("generate", "--family", "safe", "Laptop", "--n", 1, "--out", tmp_path / "made")
    assert done.returncode == 0, done.stderr
    folders = sorted(p.name for p in (tmp_path / "made").iterdir())
    assert len(folders) == 2
    scored = artiworld("evaluate", "--root", tmp_path / "made", "--jobs", 1, "--json")
    assert scored.returncode == 0, scored.stderr
    assert_users_mistake(
        artiworld("generate", "--family", "Spaceship", "--out", tmp_path / "x"), "Spaceship"
    )


def test_a_file_is_no_folder_to_write_to(tmp_path, capfd):
    (tmp_path / "taken").touch()
    for words in (["generate", "--family", "Safe"], ["train", "--samples", "1"]):
        assert main([*words, "--out", str(tmp_path / "taken")]) == 2
        assert "taken is a file; give a folder" in capfd.readouterr().err


def test_a_mistake_names_the_option_that_was_given(tmp_path, capsys):
    taken = tmp_path / "taken"
    taken.touch()
    assert main(["evaluate", "--data", "procedural", "--export", str(taken)]) == 2
    assert "--export" in (error := capsys.readouterr().err) and "--out" not in error
    assert main(["scene", "inspect", str(tmp_path)]) == 2
    assert "is a folder; name the scene's file" in capsys.readouterr().err
    assert main(["train", "--preset", "nope", "--out", str(tmp_path / "run")]) == 2
    assert "confidence" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["generate", "--famly", "Oven", "--out", "x"], "(did you mean --family?); see"),
        (["scene", "inspect", "home.json", "--asets=x"], "(did you mean --assets?); see"),
        (["check", "a", "--zzz", "b"], "artiworld check: unrecognized arguments: --zzz b; see"),
    ],
)
def test_a_misspelt_option_gets_a_hint(words, hint, capsys):
    assert main(words) == 2
    assert hint in capsys.readouterr().err
