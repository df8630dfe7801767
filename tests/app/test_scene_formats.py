"""Scenes that hold their geometry, end to end, and what is written read back by other software."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from defusedxml import ElementTree

from model.core.articulated_object import ArticulatedObject
from model.io.formats.gltf import open_gltf
from model.io.open_asset import open_asset
from model.io.urdf.writer import read_urdf
from model.io.write import write_cloud
from model.scenes.registry import read_scene
from tests.app.test_scene_command import convert, objects_of, world_of
from tests.model.scenes import scenes_made as made

pytest.importorskip("pxr", reason="USD needs usd-core (artiworld[usd])")


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A GLB with the cabinet, a rock before its door, and one far away, in all formats."""
    folder = tmp_path_factory.mktemp("room")
    path = made.write_gltf(folder / "room.glb", near=True)
    words = "--formats sdf,usd --collision --predictor geometric"
    summary = convert(path, made.make_assets(folder / "assets"), folder / "out", *words.split())
    assert summary["states"] == {"predicted": 1, "static": 2}
    assert {"scene.sdf", "scene.usda", "scene.xml", "room.glb"} <= set(summary["files"])
    return folder / "out"


@pytest.fixture(scope="module")
def stage_room(room: Path) -> Path:
    """The same as a USD stage in centimetres, converted."""
    path = made.write_usd(room.parent / "room.usda")
    out = room.parent / "out of usd"
    convert(path, room.parent / "assets", out, "--predictor", "geometric")
    return out


def cabinet_of(out: Path) -> tuple[ArticulatedObject, np.ndarray, dict]:
    """The articulated object, world_from_urdf, and what the scene says of it."""
    entry = next(e for e in objects_of(out).values() if e["state"] == "predicted")
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = world_of(entry)
    return read_urdf(out / entry["urdf"]), world, entry


@pytest.mark.parametrize("converted", ["room", "stage_room"])
def test_the_articulated_object_stands_in_place(
    converted: str, request: pytest.FixtureRequest
) -> None:
    obj, world, entry = cabinet_of(request.getfixturevalue(converted))
    points = np.concatenate([p.mesh.vertices for p in obj.parts if p.mesh is not None])
    points = points @ world[:3, :3].T + world[:3, 3]
    cabinet = np.concatenate([m.vertices for m in made.cabinet_parts().values()])
    expected = cabinet @ made.world_pose()[:3, :3].T + made.POSITION
    assert np.abs(points.min(0) - expected.min(0)).max() < 1e-6
    assert np.abs(points.max(0) - expected.max(0)).max() < 1e-6
    assert entry["id"] == "cabinet"


def test_the_glb_comes_back_with_the_urdf_in_its_extras(room: Path) -> None:
    before, after = open_gltf(room.parent / "room.glb"), open_gltf(room / "room.glb")
    said = {n["name"]: n.pop("extras", {}).get("articulation") for n in after.tree["nodes"]}
    assert after.binary == before.binary and after.tree == before.tree
    (urdf,) = [v["urdf"] for v in said.values() if v]
    assert said["cabinet"] and (room / urdf).is_file()
    assert len(read_scene(room / "room.glb").objects) == 3


def test_the_stage_comes_back_as_a_layer_over_it(stage_room: Path) -> None:
    from pxr import Usd, UsdGeom  # type: ignore[import-not-found]

    stage = Usd.Stage.Open(str(stage_room / "room_articulated.usda"))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    assert stage.GetPrimAtPath("/World/cabinet/door").GetTypeName() == "Mesh"
    data = stage.GetPrimAtPath("/World/cabinet").GetCustomDataByKey("artiworld")
    assert (stage_room / data["urdf"]).is_file()
    assert "artiworld" not in (stage_room.parent / "room.usda").read_text()


def test_usd_core_opens_the_scene_and_its_joints_meet(room: Path) -> None:
    from pxr import Usd, UsdGeom, UsdPhysics  # type: ignore[import-not-found]

    stage = Usd.Stage.Open(str(room / "scene.usda"))
    places = UsdGeom.XformCache()
    obj, world, entry = cabinet_of(room)
    key = "artiworld:name"

    def world_of_prim(prim: Usd.Prim) -> np.ndarray:
        return np.array(places.GetLocalToWorldTransform(prim)).T

    links = {
        p.GetCustomDataByKey(key): p
        for p in stage.Traverse()
        if p.HasAPI(UsdPhysics.RigidBodyAPI) and str(p.GetPath()).startswith("/World/cabinet/")
    }
    for part in obj.parts:
        (joint,) = [j for j in obj.tree.joints if j.child == part.link] or [None]
        origin = np.array([*(joint.origin if joint else (0, 0, 0)), 1.0])
        assert np.allclose(world_of_prim(links[part.link])[:3, 3], (world @ origin)[:3], atol=1e-6)
    frames, limits = 0, {}
    for prim in stage.Traverse():
        joint = UsdPhysics.Joint(prim)
        if not joint:
            continue
        ends = []
        for body, at, turn in (
            (joint.GetBody0Rel(), joint.GetLocalPos0Attr(), joint.GetLocalRot0Attr()),
            (joint.GetBody1Rel(), joint.GetLocalPos1Attr(), joint.GetLocalRot1Attr()),
        ):
            targets = body.GetTargets()
            frame = world_of_prim(stage.GetPrimAtPath(targets[0])) if targets else np.eye(4)
            local = np.eye(4)
            q = turn.Get()
            from scipy.spatial.transform import Rotation

            local[:3, :3] = Rotation.from_quat([*q.GetImaginary(), q.GetReal()]).as_matrix()
            local[:3, 3] = at.Get()
            ends.append(frame @ local)
        assert np.allclose(ends[0], ends[1], atol=1e-5), prim.GetPath()
        frames += 1
        name = prim.GetCustomDataByKey(key)
        if name and prim.HasAttribute("physics:upperLimit"):
            unit = math.pi / 180 if prim.GetTypeName() == "PhysicsRevoluteJoint" else 1.0
            limits[name] = prim.GetAttribute("physics:upperLimit").Get() * unit
    assert frames == 2 + 3  # two joints, three bases held to the world
    assert {j.name: j.upper for j in obj.tree.joints} == pytest.approx(limits, abs=1e-4)
    assert entry["shortened"]  # the rock before the door


def test_the_sdf_world_says_the_same(room: Path) -> None:
    root = ElementTree.parse(room / "scene.sdf").getroot()
    models = {m.get("name"): m for m in root.findall("world/model")}
    assert set(models) == {"cabinet", "rock_0", "rock_1"}
    obj, world, _ = cabinet_of(room)
    pose = [float(v) for v in models["cabinet"].findtext("pose").split()]
    assert np.allclose(pose[:3], world[:3, 3], atol=1e-6)
    assert math.isclose(pose[5], made.YAW, abs_tol=1e-6)
    for joint in obj.tree.joints:
        (told,) = [j for j in models["cabinet"].findall("joint") if j.get("name") == joint.name]
        assert float(told.findtext("axis/limit/upper")) == pytest.approx(joint.upper, abs=1e-6)
    for uri in root.iter("uri"):
        assert open_asset(room / uri.text, up_axis="z").mesh is not None


def test_bullet_loads_the_sdf_world(room: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bullet = pytest.importorskip("pybullet")
    monkeypatch.chdir(room)  # Bullet takes relative files from where it runs
    root = ElementTree.parse("scene.sdf").getroot()
    for model in root.findall("world/model"):
        for joint in model.findall("joint"):
            if joint.findtext("parent") == "world":  # Bullet's reader is older than these
                model.remove(joint)
    Path("bullet.sdf").write_bytes(xml.etree.ElementTree.tostring(root))
    client = bullet.connect(bullet.DIRECT)
    try:
        bodies = bullet.loadSDF("bullet.sdf", physicsClientId=client)
        counts = {b: bullet.getNumJoints(b, physicsClientId=client) for b in bodies}
        joints = [(b, j) for b, count in counts.items() for j in range(count)]
        moving = [bullet.getJointInfo(*joint, physicsClientId=client)[2] for joint in joints]
        assert len(bodies) == 3
        assert sum(m in (bullet.JOINT_REVOLUTE, bullet.JOINT_PRISMATIC) for m in moving) == 2
    finally:
        bullet.disconnect(client)


def test_mujoco_steps_it_with_collision_shapes(room: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(room / "scene.xml"))
    data = mujoco.MjData(model)
    assert (model.geom_contype != 0).any()
    for _ in range(round(1 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    assert np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()
    assert np.abs(data.qvel).max() < 50


def cabinet_clicks(folder: Path) -> str:
    """``--clicks`` for the door and the drawer of the cabinet in a scanned room."""
    pose = made.world_pose()

    def click(local: tuple[float, float, float], part: int) -> dict:
        at = pose[:3, :3] @ np.array(local) + pose[:3, 3]
        return {"position": at.tolist(), "part": part}

    places = [((0, 0.25, 0), 0), ((0.3, 0, -0.15), 1), ((0.3, 0, 0.25), 2), ((0, -0.25, 0), 0)]
    clicks = {"category": "cabinet", "clicks": [click(*place) for place in places]}
    clicks["parts"] = [{"id": 1, "name": "door"}, {"id": 2, "name": "drawer"}]
    (folder / "clicks.json").write_text(json.dumps(clicks))
    return f"cabinet 4={folder / 'clicks.json'}"


def test_a_scanned_room_is_articulated_by_clicks(tmp_path: Path) -> None:
    path = made.write_scan(tmp_path / "room.ply")
    words = ("--keep-limits", "--clicks", cabinet_clicks(tmp_path), "--predictor", "geometric")
    summary = convert(path, made.make_assets(tmp_path / "assets"), tmp_path / "out", *words)
    entries = objects_of(tmp_path / "out")
    assert entries["cabinet 4"]["state"] == "predicted", entries["cabinet 4"]["reason"]
    assert summary["states"] == {"predicted": 1, "static": 3}
    turn, at = world_of(entries["cabinet 4"])
    clouds = sorted((tmp_path / "out" / entries["cabinet 4"]["asset_folder"]).glob("meshes/*.ply"))
    assert len(clouds) == 3
    points = [c.points for f in clouds if (c := open_asset(f).cloud) is not None]
    every = np.concatenate(points) @ turn.T + at
    whole = open_asset(path).cloud
    assert whole is not None
    from scipy.spatial import KDTree

    assert KDTree(whole.points.astype(float)).query(every)[0].max() < 1e-6
    assert len(every) == sum(len(p) for p in points) > 8900


def test_what_was_scanned_stays_where_it_was(tmp_path: Path) -> None:
    """A chair whose points are half in the leftovers, and which stands a little in the door."""
    from pxr import Usd  # type: ignore[import-not-found]

    mujoco = pytest.importorskip("mujoco")
    path = made.write_scan(tmp_path / "room.ply")
    cloud = open_asset(path).cloud
    assert cloud is not None
    with np.load(tmp_path / "room_labels.npz") as file:
        instance, classes = file["instance"].copy(), file["segment20"].copy()
    pose, chair = made.world_pose(), np.flatnonzero(instance == 5)
    rng = np.random.default_rng(0)
    local = rng.uniform((0.29, -0.15, -0.4), (0.6, 0.15, 0.0), (len(chair), 3))
    points = cloud.points.copy()
    points[chair] = local @ pose[:3, :3].T + pose[:3, 3]
    classes[chair] = 4
    instance[chair[::2]] = -1
    write_cloud(replace(cloud, points=points), path)
    np.savez(tmp_path / "room_labels.npz", instance=instance, segment20=classes)
    out = tmp_path / "out"
    words = "--predictor geometric --collision --keep-limits --formats usd --clicks"
    assets = made.make_assets(tmp_path / "assets")
    convert(path, assets, out, *words.split(), cabinet_clicks(tmp_path))
    entries = objects_of(out)
    assert entries["chair 5"]["kind"] == "chair" and entries["chair 5"]["base"] == "fixed"
    passes = entries["cabinet 4"]["passes"]
    assert {(p["link"], p["through"]) for p in passes} == {("door_1", "chair 5")}
    model = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    before, solid = data.xpos.copy(), model.geom_contype > 0
    touched = {model.body(model.geom_bodyid[g]).name for g in np.flatnonzero(solid)}
    assert "building/base" in touched and "background/base" not in touched
    mujoco.mj_step(model, data, nstep=750)
    assert np.abs(data.xpos - before).max() < 0.01
    stage = Usd.Stage.Open(str(out / "scene.usda"))
    pairs = {p: p.GetRelationship("physics:filteredPairs") for p in stage.Traverse()}
    filtered = [(str(p.GetPath()), str(t)) for p in pairs for t in pairs[p].GetTargets()]
    apart = [pair for pair in filtered if len({path.split("/")[2] for path in pair}) > 1]
    assert apart == [("/World/cabinet_4/door_1", "/World/chair_5/base")]
    ball = mujoco.MjSpec.from_file(str(out / "scene.xml"))
    body = ball.worldbody.add_body(name="ball", pos=[-0.5, 0.0, 0.2])
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.05, 0, 0], mass=0.1)
    model = ball.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=750)
    assert abs(data.body("ball").xpos[2] - 0.05) < 0.03  # the floor carries it


def test_clicks_for_nobody_or_beside_it_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from app.cli.main import main

    path = made.write_scan(tmp_path / "room.ply")
    far = {"clicks": [{"position": [30, 0, 0], "part": 1}]}
    (tmp_path / "c.json").write_text(json.dumps(far))
    words = ["scene", "convert", str(path), "--out", str(tmp_path / "out"), "--jobs", "1"]
    assert main([*words, "--clicks", f"cabinet={tmp_path / 'c.json'}"]) == 2
    assert "cabinet 4" in capsys.readouterr().err
    assert main([*words, "--clicks", f"cabinet 4={tmp_path / 'c.json'}", "--json"]) == 0
    entry = objects_of(tmp_path / "out")["cabinet 4"]
    assert entry["state"] == "failed" and "clicks[0]" in entry["reason"]
