"""USD as a SimReady package."""

import json
from pathlib import Path

import pytest
from PIL import Image
from pxr import Sdf, Usd, UsdGeom, UsdShade

from app.cli.main import main
from model.core.errors import ConfigurationError, InputFileError
from model.io.assets.asset_folder import write_asset
from model.io.export.simready import (
    REMEMBERED,
    AboutPackage,
    SimReadyExporter,
    qcode_of,
    remembered,
    simready_problems,
    validator_installed,
)
from model.io.readback import read_back
from model.physics.simulation_values import physics_of
from tests.model.io.test_exporters import make_object

ABOUT = AboutPackage("An author", "CC-BY-4.0", "cabinet.glb")


@pytest.fixture(scope="module")
def package(tmp_path_factory) -> tuple[Path, ...]:
    obj = make_object()
    folder = tmp_path_factory.mktemp("package")
    return SimReadyExporter(ABOUT).export(obj, folder, physics=physics_of(obj))


def test_its_layout_metadata_and_thumbnail(package) -> None:
    path = package[0]
    assert path.parts[-3:] == ("my_object", "usd", "my_object.usdc")
    assert [p.name for p in path.parent.glob("*.usd*")] == [path.name]
    assert path.parent / ".thumbs" / "256x256" / "my_object.usdc.png" == package[-1]
    with Image.open(package[-1]) as picture:
        assert picture.size == (256, 256) and len(picture.convert("RGB").getcolors(1 << 16)) > 20
    said = Sdf.Layer.FindOrOpen(str(path)).customLayerData["SimReady_Metadata"]
    assert (said["author"], said["asset_license"]) == ("An author", "CC-BY-4.0")
    assert (said["source_file"], said["category"]) == ("cabinet.glb", "cabinet")
    assert said["rigid_body_count"] == 6 and said["mass"] > 0
    assert read_back("usd", path, make_object()).fine


def test_prims_and_materials_are_labelled_and_meshes_shaded(package) -> None:
    stage = Usd.Stage.Open(str(package[0]))
    labels = {
        str(prim.GetPath()): list(attribute.Get())
        for prim in stage.Traverse()
        if (attribute := prim.GetAttribute("semantics:labels:class"))
    }
    top = str(stage.GetDefaultPrim().GetPath())
    assert labels == {top: ["cabinet"], f"{top}/door": ["door"]}
    for prim in stage.Traverse():
        if prim.IsA(UsdShade.Material):
            assert list(prim.GetAttribute("semantics:labels:material").Get()) == ["wood"]
        if prim.IsA(UsdGeom.Mesh):
            normals = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
            corners = UsdGeom.Mesh(prim).GetFaceVertexIndicesAttr().Get()
            assert len(normals.ComputeFlattened()) == len(corners)


@pytest.mark.parametrize(
    ("about", "says"),
    [
        ({"author": " ", "license": "MIT"}, "names its author: give --author"),
        ({"author": "A", "license": ""}, "names its license: give --license"),
        ({"author": "A", "license": "MIT", "qcode": "15026"}, "must be Q and digits, as Q15026"),
    ],
)
def test_what_it_says_of_itself_is_needed(about, says) -> None:
    with pytest.raises(ConfigurationError, match=says):
        AboutPackage(**about)


def test_qcodes_are_by_category() -> None:
    assert qcode_of("Chair") == qcode_of("chair") == "Q15026"
    assert qcode_of("something") == qcode_of(None) == "Q223557"  # a physical object


def test_from_the_command_line(tmp_path, capsys) -> None:
    asset = write_asset(make_object(), tmp_path / "asset", provenance={}).folder
    profile = ["--profile", "robotics-prop", "--author", "A", "--license", "MIT"]
    assert main(["export", str(asset), "--format", "urdf", "--out", str(tmp_path), *profile]) == 2
    assert "--profile robotics-prop is of --format usd" in capsys.readouterr().err
    out = tmp_path / "out"
    line = ["export", str(asset), "--format", "usd", "--out", str(out), "--check", "--json"]
    assert main([*line, *profile, "--qcode", "Q14745"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert not said["problems"] and "usd-core" in said["readers"]
    validated = "simready-validate" in said["readers"]
    assert validated == validator_installed()
    assert validated or any("artiworld[simready]" in note for note in said["notes"])
    written = out / said["files"][0]["file"]
    assert Sdf.Layer.FindOrOpen(str(written)).customLayerData["SimReady_Metadata"]["qcode"] == (
        "Q14745"
    )


def test_author_and_licence_are_asked_once_a_workspace(tmp_path, capsys) -> None:
    asset = write_asset(make_object(), tmp_path / "assets" / "a", provenance={}).folder
    profile = ["--format", "usd", "--profile", "robotics-prop"]

    def exported(name: str, *words: str) -> dict:
        line = ["export", str(asset), "--out", str(tmp_path / name), "--json", *profile, *words]
        assert main(line) == 0
        file = json.loads(capsys.readouterr().out)["files"][0]["file"]
        return Sdf.Layer.FindOrOpen(str(tmp_path / name / file)).customLayerData[
            "SimReady_Metadata"
        ]

    assert main(["export", str(asset), "--out", str(tmp_path / "x"), *profile]) == 2
    assert "give --author" in capsys.readouterr().err
    exported("one", "--author", "Ann", "--license", "CC0-1.0")
    said = exported("two", "--license", "MIT")
    assert (said["author"], said["asset_license"]) == ("Ann", "MIT")
    assert remembered(tmp_path) == ("Ann", "MIT")
    assert remembered(None) == remembered(tmp_path / "elsewhere") == ("", "")
    (tmp_path / REMEMBERED).write_text("{")
    with pytest.raises(InputFileError, match=r"simready\.json.*delete it"):
        remembered(tmp_path)


@pytest.mark.skipif(not validator_installed(), reason="needs artiworld[simready]")
def test_nvidias_validator_passes_it_and_names_what_is_missing(package, tmp_path) -> None:
    assert simready_problems(package[0]) == []
    bare = tmp_path / "usd" / "object.usdc"
    bare.parent.mkdir()
    bare.write_bytes(package[0].read_bytes())
    found = simready_problems(bare)
    assert any(p.startswith("NP.005: ") for p in found)
    assert any(p.startswith("SR.002: No thumbnail") for p in found)
