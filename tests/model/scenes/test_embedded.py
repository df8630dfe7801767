"""Scenes that hold their geometry: GLB, USD and scanned rooms."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import KDTree

from model.core.errors import InputFileError
from model.io.open_asset import open_asset, read_part_files
from model.scenes.asset_parts import known_parts
from model.scenes.registry import read_scene, recognised
from model.scenes.scene import Scene, SceneObjectError
from model.scenes.unpacking import Unpacked, placed_frame, unpack
from tests.builders import ply_head, read_glb
from tests.model.scenes import scenes_made as made


def unpacked(path: Path, folder: Path) -> tuple[Scene, Unpacked]:
    scene = read_scene(path)
    return scene, unpack(scene, folder)


def in_world(scene: Scene, found: Unpacked, name: str) -> np.ndarray:
    """(V, 3) of an object as it will stand."""
    obj = next(o for o in scene.objects if o.id == name)
    assert obj.asset is not None
    path = found.files[obj.asset]
    if path.is_dir():
        points = np.concatenate([p.mesh.vertices for p in read_part_files(path).parts if p.mesh])
    else:
        asset = open_asset(path)
        points = asset.mesh.vertices if asset.mesh is not None else asset.cloud.points  # type: ignore[union-attr]
    bounds = np.stack([points.min(0), points.max(0)])
    placed = obj.placed(bounds)
    turn, at = placed.world_from_asset[:3, :3], placed.world_from_asset[:3, 3]
    return (placed.scale * points) @ turn.T + at


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """The farthest that a point of one lies from the other."""
    return max(KDTree(a).query(b)[0].max(), KDTree(b).query(a)[0].max())


CABINET = np.concatenate([m.vertices for m in made.cabinet_parts().values()])


@pytest.mark.parametrize("kind", ["gltf", "usd y", "usd z", "usda mm"])
def test_objects_stand_where_they_stood(kind: str, tmp_path: Path) -> None:
    if kind == "gltf":
        path = made.write_gltf(tmp_path / "room.glb")
    else:
        pytest.importorskip("pxr")
        up, unit = ("Z", 1.0) if kind == "usd z" else ("Y", 0.001 if "mm" in kind else 0.01)
        path = made.write_usd(tmp_path / "room.usda", up, unit)
    scene, found = unpacked(path, tmp_path / "out")
    assert not found.problems
    expected = CABINET @ made.world_pose()[:3, :3].T + made.POSITION
    points = in_world(scene, found, "cabinet")
    assert len(points) == len(expected) and apart(points, expected) < 1e-6
    cabinet = next(o for o in scene.objects if o.id == "cabinet")
    parts = known_parts(found.files[cabinet.asset or ""])
    assert [p.name for p in parts.parts] == ["body", "door", "drawer"]
    before = {f: f.read_bytes() for f in (tmp_path / "out").rglob("*") if f.is_file()}
    unpack(scene, tmp_path / "out")
    assert before == {f: f.read_bytes() for f in (tmp_path / "out").rglob("*") if f.is_file()}


def test_equal_rocks_are_equal_files(tmp_path: Path) -> None:
    scene, found = unpacked(made.write_gltf(tmp_path / "room.glb"), tmp_path / "out")
    rocks = [found.files[o.asset or ""] for o in scene.objects if o.id.startswith("rock")]
    assert len(rocks) == 2 and rocks[0].read_bytes() == rocks[1].read_bytes()


def test_mirrors_and_shears_go_into_the_geometry() -> None:
    pose, scale, rest = placed_frame(np.diag([2.0, 3.0, 4.0, 1.0]))
    assert np.allclose(scale, [2, 3, 4]) and np.allclose(rest, np.eye(3))
    for world in (np.diag([-1.0, 1, 1, 1]), np.eye(4) + np.diag([0.5, 0, 0], 1)):
        pose, scale, rest = placed_frame(world)
        assert np.allclose(pose, np.eye(4)) and np.allclose(rest, world[:3, :3])
    for world in (np.diag([1.0, 0, 1, 1]), np.diag([np.nan, 1, 1, 1]), np.ones((4, 4))):
        with pytest.raises(SceneObjectError):
            placed_frame(world)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"scale": [1, float("nan"), 1]}, "not finite"),
        ({"scale": [1, 0, 1]}, "leaves nothing"),
        ({"rotation": [0, 0, 0, 0]}, "is zero"),
        ({"translation": "here"}, "can't be read"),
        ({"matrix": [1, 2, 3]}, "can't be read"),
    ],
)
def test_a_broken_node_is_told_and_the_rest_goes_on(
    change: dict, told: str, tmp_path: Path
) -> None:
    tree = _gltf_tree(made.write_gltf(tmp_path / "room.glb"))
    node = next(n for n in tree["nodes"] if n.get("name") == "rock_0")
    node.pop("matrix", None)
    node.update(change)
    path = tmp_path / "broken.gltf"
    path.write_text(json.dumps(tree))
    scene = read_scene(path)
    assert [o.id for o in scene.objects] == ["cabinet", "rock_1"]
    (problem,) = scene.problems
    assert problem.object == "rock_0" and told in problem.reason


def _gltf_tree(path: Path) -> dict:
    """The tree with its buffer inside, as text."""
    tree, binary = read_glb(path.read_bytes())
    text = base64.b64encode(binary).decode()
    tree["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{text}"
    return tree


def test_unknown_meshes_and_equal_names(tmp_path: Path) -> None:
    tree = _gltf_tree(made.write_gltf(tmp_path / "room.glb"))
    for node in tree["nodes"]:
        if str(node.get("name")).startswith("rock"):
            node["name"] = "rock"
    next(n for n in tree["nodes"] if n.get("name") == "rock")["mesh"] = 99
    path = tmp_path / "broken.gltf"
    path.write_text(json.dumps(tree))
    scene, found = unpacked(path, tmp_path / "out")
    assert [o.id for o in scene.objects] == ["cabinet", "rock", "rock_2"]
    assert len(found.files) == 2 and len(found.problems) == 1
    cycle = {**tree, "nodes": [{"children": [0], "mesh": 0}], "scenes": [{"nodes": [0]}]}
    path.write_text(json.dumps(cycle))
    with pytest.raises(InputFileError, match="cycle"):
        read_scene(path)


def test_a_mesh_whose_faces_have_no_area_becomes_points(tmp_path: Path) -> None:
    """The second object's corners all lie on one line."""
    points = np.array(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], "<f4"
    )
    index = np.array([0, 1, 2, 3, 4, 5, 4, 5, 6], "<u2")
    data = points.tobytes() + index.tobytes()

    def mesh(first: int, count: int) -> dict[str, Any]:
        accessor = {"bufferView": 1, "byteOffset": 2 * first, "componentType": 5123, "count": count}
        tree["accessors"].append({**accessor, "type": "SCALAR"})
        place = {"attributes": {"POSITION": 0}, "indices": len(tree["accessors"]) - 1}
        return {"primitives": [place]}

    tree: dict[str, Any] = {
        "asset": {"version": "2.0"}, "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0, "name": "solid"}, {"mesh": 1, "name": "line"}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 7}],
        "bufferViews": [{"buffer": 0, "byteLength": 84},
                        {"buffer": 0, "byteOffset": 84, "byteLength": 18}],
        "buffers": [{"byteLength": len(data), "uri": "data:application/octet-stream;base64,"
                     + base64.b64encode(data).decode()}],
    }  # fmt: skip
    tree["meshes"] = [mesh(0, 3), mesh(3, 6)]
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    _, found = unpacked(tmp_path / "a.gltf", tmp_path / "out")
    assert [p.suffix for p in found.files.values()] == [".glb", ".ply"] and not found.problems


def test_broken_prims_are_told_and_the_rest_goes_on(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    path = made.write_usd(tmp_path / "room.usda", "Z", 1.0)
    from pxr import Gf, Usd, UsdGeom  # type: ignore[import-not-found]

    stage = Usd.Stage.Open(str(path))
    flat = UsdGeom.Xform.Define(stage, "/World/flat")
    flat.AddScaleOp().Set(Gf.Vec3f(0, 1, 1))
    UsdGeom.Cube.Define(stage, "/World/flat/c")
    bad = UsdGeom.Mesh.Define(stage, "/World/bad/m")
    bad.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
    bad.CreateFaceVertexCountsAttr([3])
    bad.CreateFaceVertexIndicesAttr([0, 1, 9])
    UsdGeom.PointInstancer.Define(stage, "/World/trees")
    UsdGeom.Xform.Define(stage, "/World/hidden").MakeInvisible()
    UsdGeom.Cube.Define(stage, "/World/hidden/c")
    UsdGeom.Xform.Define(stage, "/World/can").GetPrim().SetCustomData({"category": "trash can"})
    can = UsdGeom.Cylinder.Define(stage, "/World/can/c")
    can.CreateHeightAttr(0.5)
    can.CreateRadiusAttr(0.2)
    can.CreateAxisAttr("X")
    can.CreateDisplayColorAttr([(1.0, 0.0, 0.0)])
    stage.GetRootLayer().Save()
    scene, found = unpacked(path, tmp_path / "out")
    assert [o.id for o in scene.objects] == ["cabinet", "rock", "bad", "can"]
    assert {p.object for p in scene.problems} == {"flat", "/World/trees"}
    (problem,) = found.problems.values()
    assert "vertex 9" in problem
    last = scene.objects[-1]
    assert last.category == "trash can"
    asset = open_asset(found.files[last.asset or ""])
    assert np.allclose(np.ptp(asset.bounds, axis=0), [0.5, 0.4, 0.4], atol=1e-3)
    assert asset.mesh is not None and asset.mesh.materials[0].base_color[:3] == (255, 0, 0)


def test_sizes_of_optiscene_come_from_its_prompt(tmp_path: Path) -> None:
    path = made.write_scene(tmp_path / "a.txt", made.optiscene())
    (obj,) = read_scene(path).objects
    assert obj.fit == (0.62, 0.5, 0.8) and obj.room == "kitchen"
    more = [
        {"object": "bed", "coordinates": [{"x": 0, "y": None, "z": 0}]},
        {"object": "", "coordinates": [{"x": 0, "y": 0, "z": 0}]},
        {"object": "desk", "coordinates": [{"x": 1, "y": 0, "z": 0}], "rotate": [{"angle": "?"}]},
        {"object": "lamp", "coordinates": [{"x": 1, "y": 0, "z": 0}]},
        {"object": "lamp", "coordinates": [{"x": 2, "y": 0, "z": 0}]},
        3,
    ]
    scene = read_scene(made.write_scene(path, made.optiscene(more)))
    assert [o.id for o in scene.objects] == ["lamp", "lamp_2"]
    assert [p.skipped for p in scene.problems] == [True, True, True, False, True]


@pytest.mark.parametrize("labels", [True, False])
def test_a_scanned_room_is_cut_by_labels_or_boxes(labels: bool, tmp_path: Path) -> None:
    path = made.write_scan(tmp_path / "room.ply", labels)
    assert recognised(path)
    scene, found = unpacked(path, tmp_path / "out")
    name = "cabinet 4" if labels else "my cabinet"
    ids = [o.id for o in scene.objects]
    rest = ["other furniture 5", "building"] if labels else []
    assert ids == [name, *rest, "background"]
    cabinet, last = scene.objects[0], scene.objects[-1]
    assert cabinet.category == "cabinet" and cabinet.static is None and last.static
    assert cabinet.obstacle and not last.obstacle
    if labels:  # the splinter stays in the background
        assert [p.object for p in scene.problems] == ["other furniture 6"]
    every = np.concatenate([in_world(scene, found, i) for i in ids])
    whole = open_asset(path).cloud
    assert whole is not None and len(every) == len(whole)
    assert apart(every, whole.points.astype(float)) < 1e-6
    assert len(in_world(scene, found, name)) == pytest.approx(9000, rel=0.01)


def test_labels_that_dont_fit_are_told(tmp_path: Path) -> None:
    path = made.write_scan(tmp_path / "room.ply")
    beside = tmp_path / "room_labels.npz"
    np.savez(beside, instance=np.zeros(3, int))
    with pytest.raises(InputFileError, match="each of the"):
        read_scene(path)
    np.savez(beside, other=np.zeros(3, int))
    with pytest.raises(InputFileError, match="no array 'instance'"):
        read_scene(path)
    beside.write_bytes(b"PK\x03\x04 garbage")
    with pytest.raises(InputFileError, match="NPZ"):
        read_scene(path)
    beside.unlink()
    assert not recognised(path)
    bare = read_scene(path, "scan")
    assert [o.id for o in bare.objects] == ["room"] and bare.objects[0].static
    assert "pick objects out" in bare.problems[0].reason
    boxes = [{"id": "a"}, {"id": "b", "center": [9, 9, 9], "size": [1, 1, 1]}, 7,
             {"id": "c", "center": [1, 2, 0.5], "size": [1, float("nan"), 1]},
             {"id": "d", "center": [1, 2, 0.5], "size": [2, 2, 2]},
             {"id": "d", "center": [2.6, 0.1, 0.2], "size": [1, 1, 1]}]  # fmt: skip
    (tmp_path / "room_boxes.json").write_text(json.dumps({"objects": boxes}))
    scene = read_scene(path)
    assert [o.id for o in scene.objects] == ["d", "background"]
    assert [p.object for p in scene.problems] == ["a", "b", "objects 2", "c", "d"]


def test_labels_inside_the_ply_and_faces_of_a_mesh(tmp_path: Path) -> None:
    corners = np.concatenate([m.vertices for m in made.cabinet_parts().values()])
    faces, at = [], 0
    for mesh in made.cabinet_parts().values():
        faces += [f"3 {a + at} {b + at} {c + at}" for a, b, c in mesh.faces]
        at += len(mesh.vertices)
    more = np.concatenate([corners, corners + [3, 0, 0]])
    rows = [f"{x} {y} {z} {int(i >= at)}" for i, (x, y, z) in enumerate(more)]
    other = [" ".join(["3", *(str(int(v) + at) for v in f.split()[1:])]) for f in faces]
    head = ply_head(len(rows), "float x y z", "int instance", faces=2 * len(faces))
    path = tmp_path / "room.ply"
    path.write_text(head + "\n".join([*rows, *faces, *other]) + "\n")
    scene, found = unpacked(path, tmp_path / "out")
    assert [o.id for o in scene.objects] == ["object 0", "object 1"]
    mesh = open_asset(found.files[scene.objects[0].asset or ""]).mesh
    assert mesh is not None and len(mesh.faces) == len(faces)


def test_the_real_room(shared_data: Path, tmp_path: Path) -> None:
    path = shared_data / "scans" / "scannet" / "scene0011_00.ply"
    scene, found = unpacked(path, tmp_path / "out")
    assert not found.problems
    named = {o.id: o.category for o in scene.objects}
    assert named["refrigerator 27"] == "refrigerator" and named["cabinet 1"] == "cabinet"
    crop = open_asset(path.with_name("scene0011_00_i27_refrigerator.ply")).cloud
    assert crop is not None
    cut = in_world(scene, found, "refrigerator 27")
    assert len(cut) == len(crop) and apart(cut, crop.points.astype(float)) < 1e-6
