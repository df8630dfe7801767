"""PhyScene rooms made after its public code: read, converted in place, written back, refused."""

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.cli.main import main
from model.core.errors import InputFileError
from model.data.folders import read_partnet_mobility
from model.io.geometry_files import load_geometry
from model.io.open_asset import open_asset
from model.io.urdf.writer import read_urdf
from model.scenes.asset_parts import index_assets
from model.scenes.registry import read_scene
from model.scenes.unpacking import unpack
from model.scenes.values import rotation_from_quaternion
from tests.model.scenes import scenes_made as made

WEDGE = np.array(
    [[-0.2, 0.0, -0.1], [0.5, 0.0, -0.1], [0.5, 0.0, 0.3], [-0.2, 0.0, 0.3], [0.1, 0.9, 0.05]]
)
"""Nothing of it is symmetric. Y up, as in an OBJ."""
WEDGE_FACES = ((0, 1, 2), (0, 2, 3), (0, 4, 1), (1, 4, 2), (2, 4, 3), (3, 4, 0))
FLAT = (math.pi / 2, 0.0, -math.pi / 2)


def write_obj(path: Path, vertices: np.ndarray, faces: Any = WEDGE_FACES) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [f"v {x:.12g} {y:.12g} {z:.12g}" for x, y, z in vertices.tolist()]
    rows += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    path.write_text("\n".join(rows) + "\n")
    return path


def standing(v: np.ndarray, entry: dict[str, Any]) -> np.ndarray:
    """Where PhyScene puts (N, 3) vertices of the OBJ, brought from Y up to +z up."""
    theta, centroid = entry["theta"], np.array(entry["centroid"])
    c, s = math.cos(theta), math.sin(theta)
    turn = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    placed = (v * entry["scale"] - centroid) @ turn + (np.array(entry["position"]) + centroid)
    return placed @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])


def entry(scale: Any, theta: float, label: str, **more: Any) -> dict[str, Any]:
    centroid = np.array([0.11, 0.45, -0.07])
    position = np.array([1.5, 0.6, -2.25]) - centroid
    pose = {"position": position.tolist(), "centroid": centroid.tolist(), "theta": theta}
    file = {"path": "/data/models/raw_model.obj", "scale": scale, "size": [1, 1, 1]}
    query = {"query_label": label.lower(), "query_size": [1, 1, 1]}
    return {"label": label, **file, **query, **pose, **more}


@pytest.fixture
def assets(tmp_path: Path) -> Path:
    """A 3D-FUTURE model and a PartNet-Mobility object, as their data sets lay them out."""
    folder = tmp_path / "assets"
    write_obj(folder / "3D-FUTURE-model/0a1b/raw_model.obj", WEDGE)
    write_obj(folder / "3D-FUTURE-model/zzzz/raw_model.obj", 3 * WEDGE)
    home = folder / "partnet/45503"
    write_obj(home / "textured_objs/body.obj", WEDGE)
    write_obj(home / "textured_objs/door.obj", WEDGE * [0.9, 0.8, 0.05] + [0.1, 0.05, 0.33])
    hinge, back = "0.4 -0.3 0.2", "-0.4 0.3 -0.2"
    (home / "mobility.urdf").write_text(
        f"""<robot name="partnet"><link name="base"/>
        <link name="link_0"><visual><origin xyz="{back}"/>
        <geometry><mesh filename="textured_objs/door.obj"/></geometry></visual></link>
        <link name="link_1"><visual><geometry><mesh filename="textured_objs/body.obj"/></geometry>
        </visual></link>
        <joint name="joint_1" type="fixed"><origin rpy="{FLAT[0]} {FLAT[1]} {FLAT[2]}"/>
        <parent link="base"/><child link="link_1"/></joint>
        <joint name="joint_0" type="revolute"><origin xyz="{hinge}"/><axis xyz="0 1 0"/>
        <parent link="link_1"/><child link="link_0"/><limit lower="0" upper="1.5"/></joint>
        </robot>"""
    )
    (home / "semantics.txt").write_text("link_0 hinge door\nlink_1 heavy cabinet_body\n")
    (home / "meta.json").write_text('{"model_cat": "StorageFurniture"}')
    return folder


ROOM = {
    "ThreedFront": {"0a1b": [entry(0.8, 0.7, "Chair"), entry(0.8, -2.1, "Chair")]},
    "GPN": {"45503": [entry([0.7, 1.1, 0.9], 2.4, "StorageFurniture", path=["/d/body.obj"])]},
}


def converted(tmp_path: Path, assets: Path, room: Any) -> dict[str, dict[str, Any]]:
    path = made.write_scene(tmp_path / "House_1_room_2_livingroom.json", room)
    out = tmp_path / "out"
    words = ["scene", "convert", str(path), "--assets", str(assets), "--out", str(out)]
    assert main([*words, "--jobs", "1", "--keep-limits", "--json"]) == 0
    return {o["id"]: o for o in json.loads((out / "scene.json").read_text())["objects"]}


def in_world(out: Path, said: dict[str, Any]) -> np.ndarray:
    obj = read_urdf(next((out / said["asset_folder"]).glob("*.urdf")))
    points = np.concatenate([p.mesh.vertices for p in obj.parts if p.mesh is not None])
    w, x, y, z = said["world_from_urdf"]["quaternion_wxyz"]
    turn = rotation_from_quaternion(np.array([x, y, z, w]))
    return points @ turn.T + said["world_from_urdf"]["position"]


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """Largest distance of a point from the nearest of the others, both ways."""
    pairs = np.linalg.norm(a[:, None] - b[None], axis=2)
    return max(pairs.min(axis=0).max(), pairs.min(axis=1).max())


def test_both_kinds_of_models_stand_where_physcene_puts_them(tmp_path: Path, assets: Path) -> None:
    objects = converted(tmp_path, assets, ROOM)
    for i in range(2):
        placed = in_world(tmp_path / "out", objects[f"0a1b_{i}"])
        assert apart(placed, standing(WEDGE, ROOM["ThreedFront"]["0a1b"][i])) < 1e-6
    cabinet = objects["45503_0"]
    assert cabinet["state"] == "predicted" and cabinet["joints"]
    both = np.concatenate([WEDGE, WEDGE * [0.9, 0.8, 0.05] + [0.1, 0.05, 0.33]])
    placed = in_world(tmp_path / "out", cabinet)
    assert apart(placed, standing(both, ROOM["GPN"]["45503"][0])) < 1e-6


def test_it_is_written_back_in_its_own_form(tmp_path: Path, assets: Path) -> None:
    objects = converted(tmp_path, assets, ROOM)
    back = tmp_path / "out/House_1_room_2_livingroom.json"
    written = json.loads(back.read_text())
    urdf = written["GPN"]["45503"][0].pop("articulation")["urdf"]
    assert urdf == objects["45503_0"]["urdf"] and (tmp_path / "out" / urdf).is_file()
    assert written == ROOM
    again, before = read_scene(back), read_scene(tmp_path / back.name)
    assert again.reader == "physcene"
    for a, b in zip(again.objects, before.objects, strict=True):
        assert a.id == b.id and np.allclose(a.world_from_object, b.world_from_object, atol=1e-12)


def test_a_missing_model_is_told_and_no_other_stands_for_it(tmp_path: Path, assets: Path) -> None:
    objects = converted(tmp_path, assets, {"ThreedFront": {"9999": [entry(1, 0, "Chair")]}})
    assert objects["9999_0"]["state"] == "missing" and "9999" in objects["9999_0"]["reason"]
    assert index_assets([assets]).find("raw_model.obj") is None


WARDROBE = {"label": "wardrobe", "position": [1.0, 0.9, -0.5], "scale": [0.6, 0.9, 0.3]}
SOFA = {"label": "sofa", "position": [-1.0, 0.4, 0.5], "scale": [0.9, 0.4, 0.45]}
BOXES = {
    "objects": [
        {**WARDROBE, "theta": math.radians(30), "rot_degree": 30.0},
        {**SOFA, "theta": 0.0, "rot_degree": 0.0},
    ],
    "floor_center": [3.0, 0.0, 4.0],
    "door_box": [[2.0, 0.25, 1.0, 0.9, 0.9, 2.0, 0.0]],
}
FLOOR = np.array([[1.0, 0, 2.5], [5.0, 0, 2.5], [5.0, 0, 5.5], [1.0, 0, 5.5]])
"""4 x 3 m about its middle (3, 0, 4)."""


@pytest.mark.parametrize("exchanged", [False, True])
def test_boxes_stand_on_their_floor_with_its_door(exchanged: bool, tmp_path: Path) -> None:
    order = [0, 2, 1] if exchanged else [0, 1, 2]
    write_obj(tmp_path / "room_2.obj", FLOOR[:, order], ((0, 1, 2), (0, 2, 3)))
    room = {**BOXES, "floor_center": np.array(BOXES["floor_center"])[order].tolist()}
    path = made.write_scene(tmp_path / "House_1_room_2_livingroom_bbox.json", room)
    scene = read_scene(path)
    wardrobe, sofa, building = scene.objects
    assert wardrobe.box == pytest.approx((1.2, 0.6, 1.8)) and sofa.category == "sofa"
    assert np.allclose(wardrobe.world_from_object[:3, 3], [1.0, 0.5, 0.9])
    # Turned about y as seen from above: x towards -z, which is +y here.
    assert np.allclose(wardrobe.world_from_object[:2, 0], [math.cos(math.pi / 6), 0.5])
    assert building.static and not scene.problems
    (file,) = unpack(scene, tmp_path / "unpacked").files.values()
    low, high = open_asset(file).bounds
    # The door's panel is 4 cm thick and stands in the wall x = 2.
    assert np.allclose([low, high], [[-2, -1.5, 0], [2.02, 1.5, 2.0]], atol=1e-6)


def test_boxes_become_the_assets_that_are_called_so(tmp_path: Path) -> None:
    folder = tmp_path / "assets"
    write_obj(folder / "wardrobe.obj", WEDGE)
    objects = converted(tmp_path, folder, BOXES)
    assert objects["wardrobe_0"]["state"] != "plain" and objects["sofa_1"]["state"] == "plain"
    placed = in_world(tmp_path / "out", objects["wardrobe_0"])
    turn = np.array([[math.cos(math.pi / 6), -0.5], [0.5, math.cos(math.pi / 6)]])
    local = (placed[:, :2] - [1.0, 0.5]) @ turn
    assert np.allclose(np.ptp(local, axis=0), [1.2, 0.6], atol=1e-6)
    assert np.allclose(np.ptp(placed[:, 2]), 1.8, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"theta": None}, "theta"),
        ({"theta": math.nan}, "finite"),
        ({"centroid": [0, 0]}, "centroid is"),
        ({"position": None}, "position is missing"),
        ({"scale": 0}, "other than 0"),
        ({"scale": [1, 2]}, "3 numbers"),
    ],
)
def test_a_broken_entry_is_told_and_the_others_stay(
    change: dict[str, Any], told: str, tmp_path: Path
) -> None:
    room = {"ThreedFront": {"a": [{**entry(1, 0, "Chair"), **change}, entry(1, 0, "Chair")]}}
    scene = read_scene(made.write_scene(tmp_path / "room.json", room))
    (problem,) = scene.problems
    assert problem.object == "chair" and told in problem.reason
    assert [o.id for o in scene.objects] == ["a_1"]


def test_broken_files_doors_and_floor_plans_are_told(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match=r"room\.json.*'GPN' is \[1\]"):
        read_scene(made.write_scene(tmp_path / "room.json", {"GPN": [1]}))
    (tmp_path / "room_2.obj").write_text("v 0 0 0\n")
    room = {**BOXES, "door_box": [[0, 0, 1, 0.9, -1, 2, 0], "door"]}
    scene = read_scene(made.write_scene(tmp_path / "House_1_room_2_bbox.json", room))
    assert len(scene.objects) == 2
    assert [p.object for p in scene.problems] == ["room_2.obj", "door 0", "door 1"]


def test_real_objects_turn_as_their_urdf_does(shared_data: Path, tmp_path: Path) -> None:
    folder = shared_data / "partnet_mobility"
    ids = sorted(p.name for p in folder.iterdir() if p.name.isdigit())[::26]
    room = {"GPN": {id: [entry([0.7, 1.1, 0.9], 2.4, "Thing")] for id in ids}}
    for obj in read_scene(made.write_scene(tmp_path / "room.json", room)).objects:
        home = folder / str(obj.asset)
        parts = [p.mesh for p in read_partnet_mobility(home).object.parts if p.mesh is not None]
        points = np.concatenate([m.vertices for m in parts]) * obj.scale
        world = points @ obj.world_from_object[:3, :3].T + obj.world_from_object[:3, 3]
        raw = [load_geometry(f, 10**9).vertices for f in _visuals(home)]
        there = standing(np.concatenate(raw).astype(np.float64), room["GPN"][home.name][0])
        for ends in ("min", "max"):
            assert np.allclose(getattr(world, ends)(0), getattr(there, ends)(0), atol=1e-6), home


def _visuals(home: Path) -> list[Path]:
    text = (home / "mobility.urdf").read_text()
    names = re.findall(r'<visual.*?filename="([^"]+)"', text, re.DOTALL)
    return [home / name for name in dict.fromkeys(names)]
