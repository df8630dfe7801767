"""What a scene tilts doesn't open under gravity in the written scene."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from model.core.articulated_object import ArticulatedObject
from model.core.joint import Joint, Mimic
from model.core.tree import KinematicTree
from model.geometry.splitting import Part
from model.io.export.mjcf import MjcfExporter
from model.io.export.sdf import SdfExporter
from model.io.export.urdf import UrdfExporter
from model.io.urdf.writer import read_urdf_model
from model.physics.simulation_values import PhysicsSettings, holding_load, physics_of
from model.scenes.jobs import ASSETS, MJCF, PREDICTED
from model.scenes.results import Outcome, frictions, standing_urdf
from model.scenes.scene import Decision, SceneObject
from model.scenes.scene_xml import Stand, write_scene_mjcf, write_scene_sdf
from tests.model.scenes.scenes_made import cabinet_parts

DRAWER = Joint("slide", "prismatic", "link_0", "drawer", (1, 0, 0), (0.3, 0, -0.2), 0.0, 0.4)
DOOR = Joint("swing", "revolute", "link_0", "door", (0, 0, 1), (0.29, 0.25, 0.1), 0.0, 1.6)


def cabinet(*joints: Joint) -> ArticulatedObject:
    parts = [Part(k, mesh=m) for k, m in cabinet_parts().items()]
    links = ["link_0", "door", "drawer"]
    named = [Part(k, mesh=p.mesh) for k, p in zip(links, parts, strict=True)]
    return ArticulatedObject("cab", tuple(named), KinematicTree(tuple(links), joints))


def standing(pitch: float, yaw: float = 0.7) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3] = Rotation.from_euler("ZY", [yaw, pitch]).as_matrix()
    return out


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[ArticulatedObject, Path]:
    obj = cabinet(DOOR, DRAWER)
    out = tmp_path_factory.mktemp("scene")
    physics = physics_of(obj, PhysicsSettings(collision=None))
    for name, exporter in ((".", UrdfExporter()), (MJCF, MjcfExporter()), ("sdf", SdfExporter())):
        folder = out / ASSETS / "cab" / name
        folder.mkdir(parents=True, exist_ok=True)
        exporter.export(obj, folder, physics=physics)
    return obj, out


def test_the_friction_is_that_of_the_object_as_it_stands(
    written: tuple[ArticulatedObject, Path],
) -> None:
    obj, out = written
    asset = out / ASSETS / "cab"
    assert frictions(asset, standing(0.0), {}) == {}, "upright it is what the asset says"
    physics = physics_of(obj, PhysicsSettings(collision=None))
    world = standing(0.35)
    found = frictions(asset, world, {})
    for joint in obj.tree.joints:
        load = holding_load(obj.tree, physics.inertials, joint, world[2, :3])
        assert load > 1.0 and found[joint.name] == pytest.approx(1.5 * load, rel=1e-4)
    weight = 9.81 * physics.inertials["drawer"].mass
    assert found["slide"] == pytest.approx(1.5 * weight * math.sin(0.35), rel=1e-3)
    # Tilted the other way gravity shuts it, and nothing is to be held.
    assert frictions(asset, standing(-0.35), {})["slide"] == pytest.approx(0.5)


def test_the_urdf_of_a_tilted_object_has_its_friction(
    written: tuple[ArticulatedObject, Path], tmp_path: Path
) -> None:
    obj, out = written
    folder = tmp_path / ASSETS / "cab"
    folder.mkdir(parents=True)
    physics = physics_of(obj, PhysicsSettings(collision=None))
    UrdfExporter().export(obj, folder, physics=physics)
    tilted_object = SceneObject("c", "c", standing(0.35), np.ones(3))
    outcome = Outcome(tilted_object, Decision(True), state=PREDICTED, key="cab")
    asset = out / ASSETS / "cab"
    upright = frictions(asset, standing(0.0), {})
    assert standing_urdf(outcome, 3, tmp_path, upright) == "assets/cab/object.urdf"
    tilted = frictions(asset, standing(0.35), {})
    assert standing_urdf(outcome, 3, tmp_path, tilted) == "assets/cab/scene_3.urdf"
    told = read_urdf_model(folder / "scene_3.urdf").declared.dynamics
    for name, friction in tilted.items():
        assert told[name].friction == pytest.approx(friction)
        assert (told[name].effort or 0.0) >= 2 * friction


def test_a_tilted_cabinet_stays_shut_in_mujoco(written: tuple[ArticulatedObject, Path]) -> None:
    mujoco = pytest.importorskip("mujoco")
    _, out = written
    asset, world = out / ASSETS / "cab", standing(0.35)
    moved = {}
    for id, friction in (("bare", {}), ("held", frictions(asset, world, {}))):
        path = write_scene_mjcf("s", [Stand(id, "cab", world, friction=friction)], out, "s.xml")
        model = mujoco.MjModel.from_xml_path(str(path))
        data = mujoco.MjData(model)
        for _ in range(round(1 / model.opt.timestep)):
            mujoco.mj_step(model, data)
        moved[id] = np.abs(data.qpos)
    assert (moved["bare"] > 0.2).all() and (moved["held"] < 0.005).all()
    stand = Stand("held", "cab", world, friction={"slide": 12.5})
    path = write_scene_sdf("s", [stand], out, "s.sdf")
    assert "<friction>12.5</friction>" in path.read_text()


def test_what_follows_another_joint_is_read_too(tmp_path: Path) -> None:
    follows = Joint(
        "slide", "prismatic", "link_0", "drawer", (1, 0, 0), (0.3, 0, -0.2), 0.0, 0.4,
        Mimic("swing", 0.25),
    )  # fmt: skip
    obj = cabinet(DOOR, follows)
    physics = physics_of(obj, PhysicsSettings(collision=None))
    UrdfExporter().export(obj, tmp_path, physics=physics)
    world = standing(0.35)
    found = frictions(tmp_path, world, {})
    load = holding_load(obj.tree, physics.inertials, DOOR, world[2, :3])
    assert found["swing"] == pytest.approx(1.5 * load, rel=1e-4)
