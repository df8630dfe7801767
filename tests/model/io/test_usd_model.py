"""USD stages with joints are opened as articulated objects."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdPhysics

from app.cli.commands import ServeCommand
from app.cli.serve import scene_to_open
from model.core.composite_joints import Composite, composite_of
from model.core.errors import InputFileError
from model.io.export.registry import load_exporter, write_object
from model.io.model_files import read_model
from model.io.open_asset import open_asset
from model.io.usd_model import read_usd_model
from model.physics.simulation_values import plain_physics
from tests.model.io.test_exporters import make_object


def test_an_export_comes_back_with_names_and_couplings(tmp_path) -> None:
    obj = make_object()
    path = write_object(obj, load_exporter("usd"), tmp_path, physics=plain_physics(obj))[0]
    asset = open_asset(path)
    assert asset.part_names[:2] == ("base", "door") and asset.category == "cabinet"
    assert asset.tree is not None and asset.tree.by_name["follow"].mimic is not None


def stage_of(path: Path, *, up: str = "y", unit: float = 0.01) -> Usd.Stage:
    """A cabinet, a door open by 20° and a drawer, in centimetres and y-up by default."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, getattr(UsdGeom.Tokens, up))
    UsdGeom.SetStageMetersPerUnit(stage, unit)
    top = UsdGeom.Xform.Define(stage, "/thing")
    stage.SetDefaultPrim(top.GetPrim())
    for name, place, size, turn in (
        ("cabinet", (0, 50, 0), (60, 100, 40), 0.0),
        ("door", (-30, 50, 21), (30, 50, 2), 20.0),
        ("drawer", (15, 50, 10), (25, 20, 30), 0.0),
    ):
        body = UsdGeom.Xform.Define(stage, f"/thing/{name}")
        body.AddTranslateOp().Set(Gf.Vec3d(*place))
        body.AddRotateYOp().Set(turn)
        UsdPhysics.RigidBodyAPI.Apply(body.GetPrim())
        cube = UsdGeom.Cube.Define(stage, f"/thing/{name}/shape")
        cube.CreateSizeAttr(1.0)
        cube.AddScaleOp().Set(Gf.Vec3f(*size))
        UsdPhysics.CollisionAPI.Apply(cube.GetPrim())
    return stage


def joined(stage: Usd.Stage, kind: str, zero: str, one: str, **values: object) -> UsdPhysics.Joint:
    joint = getattr(UsdPhysics, kind).Define(stage, f"/thing/{zero or 'world'}_{one}")
    if zero:
        joint.CreateBody0Rel().SetTargets([f"/thing/{zero}"])
    joint.CreateBody1Rel().SetTargets([f"/thing/{one}"])
    for name, value in values.items():
        set_value = getattr(joint, f"Create{name}Attr")
        set_value(Gf.Vec3f(*value) if isinstance(value, tuple) else value)
    return joint


def hinge(stage: Usd.Stage) -> None:
    limits = {"LowerLimit": -10.0, "UpperLimit": 90.0}
    at = {"LocalPos0": (-30, 0, 21), "LocalPos1": (0, 0, 0)}
    joined(stage, "RevoluteJoint", "cabinet", "door", Axis="Y", **limits, **at)


def test_units_up_axis_and_an_open_door(tmp_path) -> None:
    stage = stage_of(tmp_path / "a.usda")
    hinge(stage)
    # Written the other way round: the cabinet moves against the drawer.
    limits = {"LowerLimit": -20.0, "UpperLimit": 0.0}
    at = {"LocalPos0": (0, 0, 0), "LocalPos1": (15, 0, 10)}
    joined(stage, "PrismaticJoint", "drawer", "cabinet", Axis="Z", **limits, **at)
    joined(stage, "FixedJoint", "", "cabinet", LocalPos0=(0, 50, 0))
    stage.Save()
    model = read_usd_model(tmp_path / "a.usda")
    assert model is not None and model.notes == () and model.tree.root == "cabinet"
    door, drawer = (model.tree.joint_of[n] for n in ("door", "drawer"))
    # +y of the file is +z here, its +z is -y.
    np.testing.assert_allclose(door.axis, (0, 0, 1), atol=1e-6)
    np.testing.assert_allclose(door.origin, (-0.3, -0.21, 0.5), atol=1e-6)
    # It stands 20° open: its range is counted from there.
    np.testing.assert_allclose((door.lower, door.upper), np.radians((-30, 70)), atol=1e-6)
    assert drawer.parent == "cabinet" and drawer.type == "prismatic"
    np.testing.assert_allclose(drawer.axis, (0, 1, 0), atol=1e-6)  # turned round
    np.testing.assert_allclose((drawer.lower, drawer.upper), (-0.2, 0.0), atol=1e-6)
    asset = open_asset(tmp_path / "a.usda")
    assert asset.mesh is not None
    np.testing.assert_allclose(asset.mesh.bounds[:, 2], (0, 1), atol=1e-6)
    assert sorted(asset.part_names) == ["cabinet", "door", "drawer"]


def test_loops_other_joints_and_loose_bodies_are_told(tmp_path) -> None:
    stage = stage_of(tmp_path / "a.usda")
    hinge(stage)
    joined(stage, "DistanceJoint", "door", "drawer")
    joined(stage, "PrismaticJoint", "cabinet", "drawer", Axis="X", LocalPos1=(1, 0, 0))
    stage.Save()
    model = read_usd_model(tmp_path / "a.usda")
    assert model is not None and len(model.tree.joints) == 2
    notes = " | ".join(model.notes)
    assert "of type PhysicsDistanceJoint: read as fixed" in notes
    assert "closes a loop: left out" in notes and "m apart" in notes


@pytest.mark.parametrize(("cone", "swing"), [(30.0, 30), (-1.0, 90)])
def test_a_spherical_joint_becomes_three_turns(tmp_path, cone, swing) -> None:
    stage = stage_of(tmp_path / "a.usda")
    where = {"Axis": "Z", "LocalPos0": (15, 0, 10)}
    joined(stage, "SphericalJoint", "cabinet", "drawer", ConeAngle0Limit=cone, **where)
    stage.Save()
    model = read_usd_model(tmp_path / "a.usda")
    assert model is not None and not any("read as fixed" in note for note in model.notes)
    assert composite_of(model.tree, "drawer", lambda n: "helper" not in n) == Composite("ball")
    tilts = [j for j in model.tree.joints if j.child.startswith("helper")]
    assert [np.degrees(j.upper) for j in tilts] == pytest.approx([swing, swing])
    # The file's +z, its twist, is -y here; all turn about one point.
    np.testing.assert_allclose(model.tree.joint_of["drawer"].axis, (0, -1, 0), atol=1e-6)
    np.testing.assert_allclose(tilts[0].origin, (0.15, -0.1, 0.5), atol=1e-6)


def test_what_is_no_object_with_joints_is_opened_as_before(tmp_path) -> None:
    stage = stage_of(tmp_path / "still.usda")
    joined(stage, "FixedJoint", "cabinet", "door")
    stage.Save()
    assert read_usd_model(tmp_path / "still.usda") is None
    assert open_asset(tmp_path / "still.usda").tree is None
    with pytest.raises(InputFileError, match="holds no object with joints, or several"):
        read_model(tmp_path / "still.usda")
    stage = stage_of(tmp_path / "several.usda")
    hinge(stage)
    for name in ("lid", "box"):
        body = UsdGeom.Cube.Define(stage, f"/thing/{name}")
        UsdPhysics.RigidBodyAPI.Apply(body.GetPrim())
    joined(stage, "RevoluteJoint", "box", "lid", Axis="X")
    stage.Save()
    assert read_usd_model(tmp_path / "several.usda") is None
    served = ServeCommand(paths=(tmp_path / "several.usda",))
    assert scene_to_open(served) == tmp_path / "several.usda"
    stage = stage_of(tmp_path / "one.usda")
    hinge(stage)
    stage.Save()
    assert scene_to_open(ServeCommand(paths=(tmp_path / "one.usda",))) is None


def test_a_joint_to_nothing_is_refused_and_one_without_range_is_told(tmp_path) -> None:
    stage = stage_of(tmp_path / "a.usda")
    hinge(stage)
    joined(stage, "PrismaticJoint", "cabinet", "drawer", Axis="Z", LocalPos0=Gf.Vec3f(15, 0, 10))
    stage.Save()
    model = read_usd_model(tmp_path / "a.usda")
    assert model is not None and any("has no range" in note for note in model.notes)
    joined(stage, "RevoluteJoint", "cabinet", "nowhere", Axis="X")
    stage.Save()
    with pytest.raises(InputFileError, match="names /thing/nowhere, which isn't on the stage"):
        read_usd_model(tmp_path / "a.usda")
