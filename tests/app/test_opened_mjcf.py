"""An MJCF in the app and on the command line, as a URDF."""

from __future__ import annotations

import io
import json
import shutil
import zipfile
from pathlib import Path

import pytest
import trimesh

from app.cli.commands import ServeCommand
from app.cli.main import main
from app.cli.serve import scene_to_open
from app.server import display_tasks
from app.server.tasks import ReadOptions, stamp
from app.server.uploads import keep_upload
from model.core.errors import InputFileError
from model.io.assets.reader import load_object
from model.io.model_files import find_assets
from model.io.open_asset import open_asset

MJCF = """<!-- a comment --><mujoco model="cupboard"><compiler angle="radian" meshdir="meshes"/>
<asset><mesh name="body" file="body.stl"/><mesh name="door" file="door.stl"/></asset><worldbody>
<body name="body"><inertial pos="0 0 0.2" mass="7" diaginertia="0.3 0.3 0.3"/>
<geom type="mesh" mesh="body" contype="0" conaffinity="0"/>
<geom type="box" size="0.3 0.14 0.2" pos="0 0.01 0.2" group="3"/>
<body name="door" pos="-0.3 -0.151 0"><joint name="hinge" axis="0 0 -1" range="0 1.2"
damping="0.7"/><inertial pos="0.3 0 0.2" mass="2.5" diaginertia="0.1 0.1 0.1"/>
<geom type="mesh" mesh="door" contype="0" conaffinity="0"/>
<geom type="box" size="0.29 0.009 0.19" pos="0.3 0.01 0.2" group="3"/></body></body>
</worldbody></mujoco>"""


@pytest.fixture
def mjcf(tmp_path: Path) -> Path:
    folder = tmp_path / "cupboard"
    (folder / "meshes").mkdir(parents=True)
    body = trimesh.creation.box(bounds=[[-0.3, -0.13, 0], [0.3, 0.15, 0.4]])
    body.export(folder / "meshes" / "body.stl")
    door = trimesh.creation.box(bounds=[[0, 0, 0], [0.6, 0.02, 0.4]])
    door.export(folder / "meshes" / "door.stl")
    (folder / "cupboard.xml").write_text(MJCF)
    return folder / "cupboard.xml"


def zipped(folder: Path) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for path in sorted(p for p in folder.rglob("*") if p.is_file()):
            archive.write(path, path.relative_to(folder.parent))
    return out.getvalue()


def test_it_opens_with_its_parts_and_joints(mjcf: Path, tmp_path: Path) -> None:
    for path in (mjcf, mjcf.parent):
        found = display_tasks.open_asset(path, tmp_path / "workspace", ReadOptions(None, 1.0))
        assert found.part_names == ("body", "door")
        told = found.source_joints
        assert told is not None and told.file == "cupboard.xml"
        assert told.tree.joint_of["link_1"].upper == 1.2


def test_a_zip_of_it_opens(mjcf: Path, tmp_path: Path) -> None:
    kept = keep_upload(tmp_path / "up", "cupboard.zip", zipped(mjcf.parent), 10**8)
    (found,) = find_assets([kept])
    assert open_asset(found).part_names == ("body", "door")


def test_alone_it_is_taken_where_it_names_no_files(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="its meshes are missing"):
        keep_upload(tmp_path, "a.xml", MJCF.encode(), 10**8)
    boxes = b"<mujoco><worldbody><geom size='1'/></worldbody></mujoco>"
    assert open_asset(keep_upload(tmp_path, "a.xml", boxes, 10**8)).mesh is not None


def test_it_is_no_scene_and_its_meshes_count(mjcf: Path) -> None:
    assert scene_to_open(ServeCommand(paths=(mjcf,))) is None
    assert {name for name, _, _ in stamp(mjcf)} == {"cupboard.xml", "body.stl", "door.stl"}


def test_the_scene_of_all_objects_beside_them_is_no_object(mjcf: Path, tmp_path: Path) -> None:
    home = tmp_path / "home"
    (home / "assets").mkdir(parents=True)
    shutil.copytree(mjcf.parent, home / "assets" / "cupboard")
    shutil.copy(mjcf, home / "scene.xml")
    assert len(find_assets([home])) == 2
    (home / "scene.json").write_text("{}")
    (found,) = find_assets([home])
    assert found.is_relative_to(home / "assets")


def test_commands_take_it(mjcf: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["predict", str(mjcf), "--out", str(tmp_path / "p"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [p["name"] for p in told["parts"]] == ["body", "door"]
    assert told["collision_from_source"] == ["body_0", "door_1"]
    masses = {k: i.mass for k, i in load_object(tmp_path / "p").inertials.items()}
    assert masses == {"body_0": 7.0, "door_1": 2.5}
    words = ["export", str(mjcf), "--format", "urdf", "--out", str(tmp_path / "e"), "--check"]
    assert main([*words, "--json"]) == 0
    notes = json.loads(capsys.readouterr().out)["notes"]
    assert notes == ["all collision shapes are the file's own"]
    back = load_object(tmp_path / "e" / "object.urdf")
    hinge = back.tree.joint_of["door"]
    assert hinge.upper == 1.2 and hinge.dynamics is not None and hinge.dynamics.damping == 0.7
    assert {k: i.mass for k, i in back.inertials.items()} == {"body": 7.0, "door": 2.5}
    assert main(["check", str(mjcf), "--format", "urdf,mjcf", "--json"]) == 0
    row = json.loads(capsys.readouterr().out)["assets"][0]
    assert row["fine"] and row["kilograms"] == 9.5 and row["gate"]["verdict"] == "fine"


def test_a_mistake_in_it_is_the_users(
    mjcf: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (mjcf.parent / "meshes" / "door.stl").unlink()
    assert main(["export", str(mjcf), "--format", "urdf", "--out", str(tmp_path / "e")]) == 2
    assert "door.stl: the mesh 'door' of cupboard.xml isn't there" in capsys.readouterr().err
