"""Bad input on the command line: exit code 2, one line that names the file, nothing lost."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from app.cli.main import main
from app.server.display_tasks import open_asset
from app.server.tasks import ReadOptions
from sessions.commands import AddPart, SetCategory
from tests.app.run_cli import (
    artiworld,
    artiworld_process,
    assert_users_mistake,
    box,
    cupboard,
    write_prompts,
)
from tests.builders import ply_head

CLICK = [{"position": [0.0, 0.0, 0.0], "part": 1}]


def ply(path: Path, points: np.ndarray) -> Path:
    """A binary cloud with whatever numbers are in ``points``."""
    header = ply_head(len(points), style="binary_little_endian")
    path.write_bytes(header.encode() + points.astype("<f4").tobytes())
    return path


def empty_file(folder: Path) -> Path:
    path = folder / "empty.ply"
    path.touch()
    return path


def all_nan(folder: Path) -> Path:
    return ply(folder / "nan.ply", np.full((100, 3), np.nan))


def garbage_as_ply(folder: Path) -> Path:
    path = folder / "garbage.ply"
    path.write_text("Dear Sir or Madam,\n" * 50)
    return path


def garbage_as_xyz(folder: Path) -> Path:
    path = folder / "garbage.xyz"
    path.write_text("one two three\nfour five six\n" * 20)
    return path


def garbage_as_obj(folder: Path) -> Path:
    path = folder / "garbage.obj"
    path.write_text("v a b c\nf 1 2 3\n")
    return path


def truncated_glb(folder: Path) -> Path:
    data = trimesh.util.concatenate(cupboard()).export(file_type="glb")
    path = folder / "cut.glb"
    path.write_bytes(data[: len(data) // 2])
    return path


def no_faces(folder: Path) -> Path:
    path = folder / "flat.obj"
    path.write_text("o nothing\n# neither vertices nor faces\n")
    return path


def no_faces_stl(folder: Path) -> Path:
    path = folder / "none.stl"
    path.write_bytes(b"\0" * 80 + struct.pack("<I", 0))
    return path


def one_point(folder: Path) -> Path:
    return ply(folder / "one.ply", np.zeros((1, 3)))


def circle_of_links(folder: Path) -> Path:
    path = folder / "circle.ply"
    path.symlink_to(path.name)
    return path


def missing(folder: Path) -> Path:
    return folder / "nothere.ply"


def unknown_type(folder: Path) -> Path:
    path = folder / "scan.docx"
    path.write_text("x")
    return path


def gltf_that_leaves_its_folder(folder: Path) -> Path:
    (folder.parent / "secret.bin").write_bytes(bytes(36))
    path = folder / "leaves.gltf"
    path.write_text(
        json.dumps(
            {
                "asset": {"version": "2.0"},
                "buffers": [{"uri": "../secret.bin", "byteLength": 36}],
                "bufferViews": [{"buffer": 0, "byteLength": 36}],
                "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
                "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
                "nodes": [{"mesh": 0}],
                "scenes": [{"nodes": [0]}],
            }
        )
    )
    return path


SCANS = [
    empty_file, all_nan, garbage_as_ply, garbage_as_xyz, garbage_as_obj, truncated_glb, no_faces,
    no_faces_stl, one_point, missing, circle_of_links, unknown_type, gltf_that_leaves_its_folder,
]  # fmt: skip


@pytest.mark.parametrize("make", SCANS)
def test_segment_names_the_file_and_leaves_no_output(make, tmp_path, capfd):
    folder = tmp_path / "in"
    folder.mkdir()
    scan = make(folder)
    prompts = write_prompts(tmp_path / "p.json", CLICK)
    out = tmp_path / "out"
    assert main(["segment", str(scan), "--prompts", str(prompts), "--out", str(out)]) == 2
    lines = capfd.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and str(scan.name) in lines[0], lines
    assert not out.exists()


def test_long_names_of_a_folder_of_parts_are_cut_with_a_remark(tmp_path):
    for i in range(2):
        box((i, 0, 0), (i + 0.9, 1, 1)).export(tmp_path / f"link_{i}.ply")
    parts = [{"file": "link_0.ply"}, {"file": "link_1.ply", "name": "door " * 50}]
    described = {"category": "x" * 100_000, "parts": parts}
    (tmp_path / "object.json").write_text(json.dumps(described))
    opened = open_asset(tmp_path, tmp_path / "workspace", ReadOptions())
    assert len(opened.source_parts) == 2
    assert AddPart(1, opened.part_names[1]).name.startswith("door door")
    assert SetCategory(opened.category).category.endswith("x…")
    assert any("100,000 characters" in w for w in opened.warnings)


def test_the_same_through_the_real_program(tmp_path):
    scan = truncated_glb(tmp_path)
    prompts = write_prompts(tmp_path / "p.json", CLICK)
    done = artiworld_process("segment", scan, "--prompts", prompts, "--out", tmp_path / "o")
    assert_users_mistake(done, scan.name)


@pytest.mark.parametrize(
    "make", [m for m in SCANS if m not in (missing, circle_of_links, unknown_type)]
)
def test_predict_names_the_broken_part(make, tmp_path, capfd):
    folder = tmp_path / "parts"
    folder.mkdir()
    cupboard()[0].export(folder / "link_0.obj")
    broken = make(folder)
    broken = broken.rename(folder / f"link_1{broken.suffix}")
    out = tmp_path / "out"
    assert main(["predict", str(folder), "--out", str(out)]) == 2
    lines = capfd.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and broken.name in lines[0], lines
    assert not out.exists()


def test_a_missing_mtl_is_a_note_not_an_end(tmp_path):
    scan = tmp_path / "plain.obj"
    text = cupboard()[0].export(file_type="obj")
    scan.write_text("mtllib nowhere.mtl\nusemtl paint\n" + text)
    prompts = write_prompts(tmp_path / "p.json", [{"position": [0.3, 0.5, 0.4], "part": 1}])
    done = artiworld(
        "segment", scan, "--prompts", prompts, "--out", tmp_path / "o", "--up-axis", "z",
        "--segmenter", "nearest",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "nowhere.mtl" in done.stdout


def test_some_nan_points_are_dropped_with_a_note(tmp_path):
    points = trimesh.sample.sample_surface(cupboard()[0], 2000, seed=0)[0]
    points[::10] = np.nan
    scan = ply(tmp_path / "holes.ply", points)
    prompts = write_prompts(tmp_path / "p.json", [{"position": [0.3, 0.5, 0.4], "part": 1}])
    words = ("--out", tmp_path / "o", "--json", "--segmenter", "nearest")
    done = artiworld("segment", scan, "--prompts", prompts, *words)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["source"]["count"] == 1800
    assert "200 of 2000" in " ".join(report["problems"])


def test_what_was_left_out_is_noted_until_the_export(tmp_path, capsys):
    """From the scan over its parts and the saved asset to what a simulator gets."""
    wall, door = (m.subdivide().subdivide() for m in cupboard())
    whole = trimesh.util.concatenate([wall, door])
    corners = whole.vertices.tolist()
    corners[7], corners[-1] = [np.nan] * 3, [np.inf, 0.0, 0.0]
    scan = tmp_path / "holes.obj"
    rows = [f"v {x} {y} {z}" for x, y, z in corners]
    rows += ["f {} {} {}".format(*(face + 1)) for face in whole.faces]
    scan.write_text("\n".join(rows))
    prompts = write_prompts(tmp_path / "p.json", [{"position": [0.3, -0.02, 0.6], "part": 1}])
    parts, asset, out = tmp_path / "parts", tmp_path / "asset", tmp_path / "out"

    def run(*words: object) -> dict:
        assert main([*map(str, words), "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    cut = run("segment", scan, "--prompts", prompts, "--out", parts, "--up-axis", "z",
              "--segmenter", "nearest")  # fmt: skip
    (remark,) = cut["problems"]
    lost = np.isin(whole.faces, [7, len(corners) - 1]).any(axis=1).sum()
    assert f"2 of {len(corners)} points" in remark and f"{lost} faces" in remark
    assert remark in run("predict", parts, "--out", asset, "--predictor", "geometric")["problems"]
    written = run("export", asset, "--format", "urdf,glb", "--out", out, "--no-collision")
    assert [f["notes"] for f in written["formats"]] == [[remark], [remark]]
    assert open_asset(parts, tmp_path / "workspace", ReadOptions()).warnings == (remark,)


def test_a_damaged_mesh_of_a_urdf_is_noted_at_its_export(tmp_path, capsys):
    points = cupboard()[0].vertices.copy()
    points[3] = np.nan
    ply(tmp_path / "body.ply", points)
    urdf = tmp_path / "a.urdf"
    shape = '<visual><geometry><mesh filename="body.ply"/></geometry></visual>'
    urdf.write_text(f'<robot name="r"><link name="link_0">{shape}</link></robot>')
    words = ["export", urdf, "--format", "glb", "--out", tmp_path / "o", "--no-collision"]
    assert main([*map(str, words), "--json"]) == 0
    (note,) = json.loads(capsys.readouterr().out)["notes"]
    assert note.startswith(f"body.ply: 1 of {len(points)} points")


def test_two_parts_with_no_points(tmp_path):
    folder = tmp_path / "parts"
    folder.mkdir()
    for i in range(2):
        ply(folder / f"link_{i}.ply", np.zeros((0, 3)))
    done = artiworld("predict", folder, "--out", tmp_path / "o")
    assert_users_mistake(done, "link_0.ply")


def test_empty_folder_and_file_as_folder(tmp_path):
    empty = tmp_path / "empty"
    empty.mkdir()
    assert_users_mistake(artiworld("predict", empty, "--out", tmp_path / "o"), "empty")
    file = ply(tmp_path / "a.ply", np.zeros((5, 3)))
    assert_users_mistake(artiworld("predict", file, "--out", tmp_path / "o"), "a.ply", "folder")


@pytest.mark.parametrize(
    "text",
    ["{", "[]", '{"parts": 3}', '{"parts": [{"file": "../outside.obj"}]}',
     '{"parts": [{"file": "/etc/passwd"}]}', '{"parts": [{"file": "gone.obj"}]}'],
)  # fmt: skip
def test_a_wrong_object_json_is_named(text, tmp_path, capfd):
    folder = tmp_path / "parts"
    folder.mkdir()
    cupboard()[0].export(tmp_path / "outside.obj")
    cupboard()[0].export(folder / "link_0.obj")
    (folder / "object.json").write_text(text)
    assert main(["predict", str(folder), "--out", str(tmp_path / "o")]) == 2
    lines = capfd.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and "object.json" in lines[0]


def test_200_disconnected_shells_work(tmp_path):
    rng = np.random.default_rng(0)
    corners = rng.random((200, 3)) * 2
    shells = trimesh.util.concatenate([box(c, c + 0.05) for c in corners])
    shells.export(tmp_path / "shells.stl")
    middle = corners[0] + [0.025, 0.025, 0.05]
    prompts = write_prompts(tmp_path / "p.json", [{"position": middle.tolist(), "part": 1}])
    out = tmp_path / "o"
    done = artiworld("segment", tmp_path / "shells.stl", "--prompts", prompts, "--out", out)
    assert done.returncode == 0, done.stderr
    parts = [trimesh.load(out / f"link_{i}.obj", process=False) for i in (0, 1)]
    assert sum(len(p.faces) for p in parts) == len(shells.faces)


def test_an_unwritable_output_is_named_before_any_work(tmp_path, capfd):
    blocked = tmp_path / "file"
    blocked.write_text("x")
    folder = tmp_path / "parts"
    folder.mkdir()
    cupboard()[0].export(folder / "link_0.obj")
    assert main(["predict", str(folder), "--out", str(blocked / "under")]) == 2
    assert "--out" in capfd.readouterr().err


@pytest.mark.parametrize("out", ["file", "file/under", "n" * 300])
@pytest.mark.parametrize("command", ["predict", "export", "evaluate"])
def test_an_output_that_can_be_no_folder_is_the_users_mistake(
    command: str, out: str, tmp_path: Path, capfd
) -> None:
    (tmp_path / "file").write_text("x")
    (tmp_path / "box.urdf").write_text('<robot name="r"><link name="a"/></robot>')
    words = {
        "predict": [str(tmp_path)],
        "export": [str(tmp_path / "box.urdf"), "--format", "urdf"],
        "evaluate": ["--data", "procedural", "--family", "Box", "--predictor", "geometric"],
    }[command]
    assert main([command, *words, "--out", str(tmp_path / out)]) == 2
    error = capfd.readouterr().err
    assert "--out" in error and error.count("\n") == 1
    assert {path.name for path in tmp_path.iterdir()} == {"file", "box.urdf"}


def test_a_seed_below_zero_and_an_empty_path_are_refused(tmp_path, capfd):
    assert main(["predict", str(tmp_path), "--out", str(tmp_path / "out"), "--seed", "-5"]) == 2
    assert "whole number" in capfd.readouterr().err
    nowhere = str(tmp_path / "nowhere.urdf")
    for words in (["export", nowhere, "--format", "urdf", "--out", "x"], ["check", nowhere]):
        assert main(words) == 2
        assert f"{nowhere}: no such file or folder" in capfd.readouterr().err
