"""Models whose files lie beside their folder, folders and zips of them, and what is refused."""

import subprocess
from pathlib import Path
from zipfile import ZipFile

import pytest
from trimesh.creation import box

from app.cli.export import find_assets as assets_to_export
from model.core.errors import InputFileError
from model.io.assets.reader import load_object, reading_notes
from model.io.model_files import find_assets
from model.io.open_asset import open_asset, read_part_files
from tests.app.run_cli import answer, artiworld

URDF = """<robot name="r"><link name="base"><visual><geometry><box size="1 1 1"/></geometry>
</visual></link><link name="door"><visual><geometry><mesh filename="{mesh}"/></geometry></visual>
</link><joint name="hinge" type="revolute"><parent link="base"/><child link="door"/>
<axis xyz="0 0 1"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>"""
MJCF = """<mujoco><compiler meshdir="{dir}"/><asset><mesh name="door" file="door.stl"/></asset>
<worldbody><geom type="box" size="1 1 1"/><body name="door"><joint name="hinge" axis="0 0 1"
range="0 57"/><geom type="mesh" mesh="door"/></body></worldbody></mujoco>"""
SDF = """<sdf version="1.9"><model name="m"><link name="base"><visual name="v"><geometry><box>
<size>1 1 1</size></box></geometry></visual></link><link name="door"><visual name="v"><geometry>
<mesh><uri>{mesh}</uri></mesh></geometry></visual></link><joint name="hinge" type="revolute">
<parent>base</parent><child>door</child><axis><xyz>0 0 1</xyz><limit><lower>0</lower>
<upper>1</upper></limit></axis></joint></model></sdf>"""
LAYOUTS = {  # name → model, its text, mesh, all below the folder that is given
    "urdf and meshes": ("urdf/cab.urdf", URDF.format(mesh="../meshes/door.stl"), "meshes"),
    "package uri": ("urdf/cab.urdf", URDF.format(mesh="package://given/meshes/door.stl"), "meshes"),
    "other package": (
        "src/cab/urdf/cab.urdf",
        URDF.format(mesh="package://cab_meshes/stl/door.stl"),
        "src/cab_meshes/stl",
    ),
    "meshdir": ("objects/cab.xml", MJCF.format(dir="../meshes"), "meshes"),
    "assetdir": ("a/b/cab.xml", MJCF.format(dir="../../c/m").replace("meshdir", "assetdir"), "c/m"),
    "sibling model": (
        "cab/model.sdf",
        SDF.format(mesh="model://other/meshes/door.stl"),
        "other/meshes",
    ),
}


def layout(folder: Path, name: str) -> Path:
    """A model and its mesh as ``name`` says, below ``folder``; returns the model."""
    model, text, meshes = LAYOUTS[name]
    for place in (folder / model).parent, folder / meshes:
        place.mkdir(parents=True, exist_ok=True)
    box((1, 0.1, 1)).export(folder / meshes / "door.stl")
    (folder / model).write_text(text)
    return folder / model


def has_hinge(path: Path) -> bool:
    asset = open_asset(path)
    return asset.element_count == 24 and asset.tree is not None and asset.tree.joints[0].moves


@pytest.mark.parametrize("name", LAYOUTS)
def test_files_within_the_folder_that_was_given_are_read(tmp_path: Path, name: str) -> None:
    layout(tmp_path / "given", name)
    subprocess.run(["git", "init", "-q", tmp_path / "elsewhere"], check=True)
    given = tmp_path / "elsewhere" / ".." / "given"
    (found,) = find_assets([given])
    assert has_hinge(found)
    (again,) = assets_to_export([given])
    obj = load_object(again)
    assert len(obj.parts) == 2 and reading_notes(again, obj) == ()


@pytest.mark.parametrize("name", ["urdf and meshes", "meshdir", "sibling model"])
def test_a_single_file_may_use_its_repository(tmp_path: Path, name: str) -> None:
    model = layout(tmp_path / name, name)
    with pytest.raises(InputFileError) as refused:
        open_asset(model)
    remedy = "other/meshes" if "model" in name else f"give the folder {name!r}"
    assert remedy in str(refused.value)
    subprocess.run(["git", "init", "-q", tmp_path], check=True)
    assert has_hinge(model)


def test_a_folder_of_models_beside_its_meshes_opens(tmp_path: Path) -> None:
    layout(tmp_path, "meshdir").parent.rename(tmp_path / "xml")
    assert len(load_object(tmp_path).parts) == 2


def test_many_models_share_a_folder_of_meshes(tmp_path: Path) -> None:
    for name in ("one", "two"):
        layout(tmp_path, "meshdir").rename(tmp_path / "objects" / f"{name}.xml")
    assert [p.name for p in find_assets([tmp_path])] == ["one.xml", "two.xml"]
    assert all(map(has_hinge, find_assets([tmp_path])))
    report = answer("check", tmp_path, "--no-gate", "--format", "mjcf")  # in processes
    assert report["summary"]["readable"] == 2


def zipped(folder: Path, file: Path) -> Path:
    with ZipFile(file, "w") as archive:
        for path in sorted(folder.rglob("*")):
            archive.write(path, path.relative_to(folder))
    return file


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_zip_is_read_as_its_folder(tmp_path: Path, name: str) -> None:
    layout(tmp_path / "given", name)
    path = zipped(tmp_path / "given", tmp_path / "given.zip")
    assert has_hinge(path)
    source = open_asset(path).source
    assert source is not None and source.path == path
    assert len(load_object(path).parts) == len(read_part_files(path).parts) == 2


def test_nothing_in_a_zip_leaves_it(tmp_path: Path) -> None:
    subprocess.run(["git", "init", "-q", tmp_path], check=True)
    find_assets([layout(tmp_path, "urdf and meshes").parent])
    path = zipped(tmp_path / "urdf", tmp_path / "a.zip")
    secret = path.parent / "meshes" / "door.stl"
    text = URDF.format(mesh="/".join([".."] * 12) + str(secret))
    (tmp_path / "urdf" / "cab.urdf").write_text(text)
    assert has_hinge(tmp_path / "urdf" / "cab.urdf")
    for zip in (path, zipped(tmp_path / "urdf", tmp_path / "b.zip")):
        with pytest.raises(InputFileError, match=r"leads outside|isn't there"):
            open_asset(zip)


def test_commands_take_zips_and_ros_packages(tmp_path: Path) -> None:
    layout(tmp_path / "given", "urdf and meshes")
    path = zipped(tmp_path / "given", tmp_path / "cab.zip")
    for source in (path, tmp_path / "given"):
        out = tmp_path / f"out of {source.name}"
        answer("export", source, "--format", "urdf", "--out", out / "urdf")
        assert (out / "urdf" / "object.urdf").is_file()
        answer("predict", source, "--out", out / "predicted")
        answer("check", source, "--no-gate", "--format", "urdf")


@pytest.mark.parametrize("name", ["a.txt", "a.pdf", "a.obj", "a.xml", "folder", "a.zip"])
def test_what_holds_no_model_is_refused_in_the_same_words(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    box((1, 1, 1)).export(tmp_path / "b.obj")
    if name == "folder":
        path.mkdir()
    elif name == "a.zip":
        (tmp_path / "z").mkdir()
        box((1, 1, 1)).export(tmp_path / "z" / "b.obj")
        zipped(tmp_path / "z", path)
    else:
        path.write_bytes((tmp_path / "b.obj").read_bytes())
    with pytest.raises(InputFileError, match="is no URDF, SDF, MJCF, or USD with joints"):
        load_object(path)
    ran = artiworld("export", path, "--format", "urdf", "--out", tmp_path / "out")
    assert ran.returncode == 2 and "is no URDF, SDF, MJCF, or USD with joints" in ran.stderr
