"""Every scene reader: one contract, and what broken scenes get told."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import trimesh

from model.core.errors import ConfigurationError, InputFileError
from model.io.open_asset import open_asset
from model.scenes.native_format import scene_to_json
from model.scenes.readers.houses import THICKNESS
from model.scenes.registry import SCENE_READERS, load_reader, read_scene
from model.scenes.unpacking import unpack
from tests.model.scenes import scenes_made as made

CABINET_BOUNDS = np.array([[-0.3, -0.25, -0.4], [0.32, 0.25, 0.4]])

WHOLE = {
    "artiworld": ("scene.json", made.own()),
    "lisdf": ("w.lisdf", made.lisdf()),
    "holodeck": ("house.json", made.holodeck()),
    "mesatask": ("layout.json", made.mesatask()),
    "internscenes": ("layout.json", made.internscenes()),
    "optiscene": ("cabinet.txt", made.optiscene()),
    "physcene": ("room.json", made.physcene()),
    "gltf": ("cabinet.glb", made.write_gltf),
    "usd": ("cabinet.usda", made.write_usd),
}
"""The same cabinet at the same place in each format."""


def test_every_reader_is_covered() -> None:
    assert {*WHOLE, "scan"} == set(
        SCENE_READERS.built_in
    )  # a scan has no turned cabinet to compare


@pytest.mark.parametrize("name", WHOLE)
def test_recognised_and_read_alike(name: str, tmp_path: Path) -> None:
    file, value = WHOLE[name]
    scene = read_scene(made.write_scene(tmp_path / file, value))
    assert scene.reader == name and not scene.problems
    obj, *rocks = scene.objects
    assert len(rocks) == {"gltf": 2, "usd": 1}.get(name, 0)
    assert obj.id and "cabinet" in obj.description and obj.asset is not None
    assert "cab" in obj.asset
    placed = obj.placed(CABINET_BOUNDS)
    turn = placed.world_from_asset[:3, :3]
    assert np.allclose(turn[:, 0], [math.cos(made.YAW), math.sin(made.YAW), 0], atol=1e-9)
    assert np.allclose(placed.scale, 1.0)
    point = np.zeros(3) if obj.anchor == "origin" else CABINET_BOUNDS.mean(0)
    assert np.allclose(turn @ point + placed.world_from_asset[:3, 3], made.POSITION, atol=1e-9)


@pytest.mark.parametrize("name", WHOLE)
def test_written_as_our_own_it_reads_back_the_same(name: str, tmp_path: Path) -> None:
    file, value = WHOLE[name]
    scene = read_scene(made.write_scene(tmp_path / file, value))
    again = read_scene(made.write_scene(tmp_path / "again.json", scene_to_json(scene)))
    for a, b in zip(scene.objects, again.objects, strict=True):
        assert np.allclose(a.world_from_object, b.world_from_object, atol=1e-12)
        assert (a.id, a.asset, a.anchor, a.fit, a.room) == (b.id, b.asset, b.anchor, b.fit, b.room)


@pytest.mark.parametrize("name", SCENE_READERS.built_in)
@pytest.mark.parametrize(
    "text", ["", "{", "garbage \x00", "[" * 100_000, "9" * 5000, "{}", "[1, 2]", "<sdf/>"]
)
def test_garbage_is_one_clear_error(name: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / (WHOLE[name][0] if name in WHOLE else "room.ply")
    path.write_text(text)
    try:
        scene = load_reader(name).read(path)
    except InputFileError as error:
        assert str(path) in str(error)
    else:  # a list of anything is a list of broken objects
        assert not scene.objects and all(p.skipped for p in scene.problems)


@pytest.mark.parametrize(
    ("file", "start", "told"),
    [
        ("big.json", b'{"objects": [', "line 1, column"),
        ("big.gltf", b'{"nodes": [', "not glTF"),
        ("big.txt", b'[Design] {"objects": [', "no JSON with a list"),
        ("big.usda", b"#usda 1.0\n(", "no USD stage"),
        ("big.ply", b"ply\nformat ascii 1.0\nproperty int instance\nend_header\n", "PLY"),
    ],
)
def test_a_large_file_of_garbage_is_told_at_once(
    file: str, start: bytes, told: str, tmp_path: Path
) -> None:
    path = tmp_path / file
    # usd-core takes its time to refuse text.
    count = 2_400_000 if file != "big.usda" else 50_000
    path.write_bytes(start + b'{"assetId": nonsense},' * count)
    with pytest.raises(InputFileError, match=told):
        read_scene(path)


def _mesatask_with(**changes: object) -> dict:
    layout = made.mesatask()
    broken = {**layout["objects"][0], "instance": "broken", **changes}
    layout["objects"].insert(0, {k: v for k, v in broken.items() if v != "gone"})
    return layout


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"position": "gone"}, "position is missing"),
        ({"rotation": [0, 0, 0, 0]}, "is zero"),
        ({"rotation": [0, 0, 1]}, "4 numbers"),
        ({"scale_factor": [1, math.nan, 1]}, "finite"),
        ({"scale_factor": [1, 0, 1]}, "other than 0"),
        ({"position": [10**400, 0, 0]}, "finite"),
        ({"position": [1e30, 0, 0]}, "from the origin"),
        ({"position": [True, 0, 0]}, "3 numbers"),
        ({"retrieved_uid": None}, "retrieved_uid"),
        ({"instance": ""}, "instance"),
    ],
)
def test_a_broken_object_is_told_and_the_rest_goes_on(
    changes: dict, told: str, tmp_path: Path
) -> None:
    scene = read_scene(made.write_scene(tmp_path / "layout.json", _mesatask_with(**changes)))
    assert [o.id for o in scene.objects] == ["cabinet_1"]
    (problem,) = scene.problems
    assert problem.skipped and told in problem.reason


def test_ids_that_are_there_twice_stay_apart(tmp_path: Path) -> None:
    layout = made.mesatask()
    layout["objects"] *= 3
    scene = read_scene(made.write_scene(tmp_path / "layout.json", layout))
    assert [o.id for o in scene.objects] == ["cabinet_1", "cabinet_1_2", "cabinet_1_3"]
    assert len(scene.problems) == 2 and not any(p.skipped for p in scene.problems)


def test_what_a_scene_file_says_in_vain_is_told(tmp_path: Path) -> None:
    first = {**made.own()["objects"][0], "rotation": [0, 0, 90]}
    objects = [{**first, "id": f"c{i}", "position": [1000 * i, 400, 0]} for i in range(4)]
    path = made.write_scene(tmp_path / "s.json", {**made.own(objects), "units": "mm"})
    scene = read_scene(path)
    told = " ".join(p.text for p in scene.problems)
    assert len(scene.objects) == 4 and not any(p.skipped for p in scene.problems)
    assert "'units'" in told and "'rotation' of 4 objects" in told and "1000 m" in told
    good = made.write_scene(tmp_path / "good.json", made.own())
    assert read_scene(good).problems == ()
    again = scene_to_json(scene, {"c0": {"state": "static", "base": "free", "held": "x"}})
    problems = read_scene(made.write_scene(tmp_path / "again.json", again)).problems
    assert not [p for p in problems if "means nothing" in p.reason]


@pytest.mark.parametrize("mirror", [[-1, -2, 1], [-1, 1, 1], [3, -1, 1], [1, 1, -2], [-1, -1, -1]])
def test_mirrors_are_kept_along_x_alone(mirror: list[float], tmp_path: Path) -> None:
    """Every other mirroring is that one and a turn, so that the asset stays the right way up."""
    own = made.own([{**made.own()["objects"][0], "scale": mirror}])
    told = " ".join(map(str, mirror))
    layout = made.mesatask()
    layout["objects"][0]["scale_factor"] = mirror
    sdf = made.lisdf().replace("<scale>1.0<", f"<scale>{told}<")
    assert told in sdf
    for file, value in (("s.json", own), ("layout.json", layout), ("w.lisdf", sdf)):
        scene = read_scene(made.write_scene(tmp_path / file, value))
        assert not scene.problems
        (obj,) = scene.objects
        np.testing.assert_allclose(
            obj.world_from_object[:3, :3] * obj.scale, made.world_pose()[:3, :3] * mirror, atol=1e-9
        )
        assert np.sign(obj.scale).tolist() == [np.sign(mirror).prod(), 1, 1]
        (again,) = read_scene(
            made.write_scene(tmp_path / "again.json", scene_to_json(scene, {}))
        ).objects
        assert again.scale.tolist() == obj.scale.tolist()
        np.testing.assert_allclose(again.world_from_object, obj.world_from_object, atol=1e-12)


def test_words_of_mesatask_are_centimetres(tmp_path: Path) -> None:
    said = {"instance": "pot_1", "description": "a pot with a lid", "z_rotation": 90}
    said |= {"size": [20, 30, 10], "position": [50, 60, 5]}
    layout = {"item_placement_zone": [0, 100, 0, 100], "objects": [said]}
    (obj,) = read_scene(made.write_scene(tmp_path / "out.json", layout)).objects
    assert np.allclose(obj.world_from_object[:3, 3], [0.5, 0.6, 0.05])
    assert obj.fit == pytest.approx((0.2, 0.3, 0.1)) and obj.asset is None
    placed = obj.placed([[0, 0, 0], [1, 1, 1]])
    corner = placed.world_from_asset[:3, :3] @ (placed.scale * 1.0)
    assert np.allclose(corner + placed.world_from_asset[:3, 3], [0.5 - 0.15, 0.7, 0.1])


def test_what_stands_on_furniture_of_a_house_is_read_too(tmp_path: Path) -> None:
    house = made.holodeck()
    house["objects"][0]["children"] = [{**house["objects"][0], "id": "mug|1"}]
    scene = read_scene(made.write_scene(tmp_path / "house.json", house))
    assert [o.place for o in scene.objects] == [("objects", 0), ("objects", 0, "children", 0)]
    assert scene.objects[1].room == "kitchen" and scene.frame.left_handed


def corners(*points: tuple[float, float, float]) -> list[dict[str, float]]:
    return [{"x": x, "y": y, "z": z} for x, y, z in points]


def test_floors_and_walls_of_a_house_are_solids_with_openings(tmp_path: Path) -> None:
    house = made.holodeck()
    house["rooms"][0]["floorPolygon"] = corners(
        (0, 0, 0), (0, 0, 4), (2, 0, 4), (2, 0, 2), (5, 0, 2), (5, 0, 0)
    )
    wall = corners((0, 0, 0), (0, 2.5, 0), (0, 2.5, 4), (0, 0, 4))
    other = corners((0, 0, 4), (0, 2.5, 4), (2, 2.5, 4), (2, 0, 4))
    walls = {"a": wall, "a|exterior": wall, "b": other, "bad": wall[:3]}
    house["walls"] = [{"id": id, "polygon": polygon} for id, polygon in walls.items()]
    house["walls"].append({"id": "open", "polygon": wall, "empty": True})
    hole = corners((0.5, 0, 0), (1.4, 2.1, 0))
    house["doors"] = [{"id": "d", "wall0": "a", "wall1": "b", "holePolygon": hole}]
    scene = read_scene(made.write_scene(tmp_path / "house.json", house))
    assert [o.id for o in scene.objects] == ["cabinet-0 (kitchen)", "building"]
    assert [p.object for p in scene.problems] == ["bad"] and scene.objects[1].static
    found = unpack(scene, tmp_path / "inside").files[scene.objects[1].asset or ""]
    mesh = open_asset(found).mesh
    assert mesh is not None
    hole = 0.9 * 2.1
    volume = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).volume
    assert volume == pytest.approx(THICKNESS * (14 + 10 - hole + 5 - hole), rel=1e-6)
    at = np.round(mesh.vertices[mesh.vertices[:, 2] > 0.01], 6)
    along_a = at[np.abs(at[:, 0]) < THICKNESS, 1]
    along_b = at[at[:, 1] > 4 - THICKNESS / 2, 0]
    assert {0.5, 1.4} < set(along_a)
    # From the far end of wall b, as it is told from behind.
    assert {0.0, 0.6, 1.5, 2.0} < set(along_b) and not {0.5, 1.4} & set(along_b)


def test_unity_turns_the_other_way(tmp_path: Path) -> None:
    house = made.holodeck()
    house["objects"][0]["rotation"] = {"x": 0, "y": 90, "z": 0}
    (obj,) = read_scene(made.write_scene(tmp_path / "house.json", house)).objects
    # In Unity a quarter turn about y takes z to x: our y to our x.
    assert np.allclose(obj.world_from_object[:3, :3] @ [0, 1, 0], [1, 0, 0], atol=1e-9)


def test_plain_boxes_of_sdf(tmp_path: Path) -> None:
    box = (
        '<model name="floor"><pose>1 0 0 0 0 0</pose><link name="l"><pose>0 2 0 0 0 0</pose>'
        "<collision name='c'><geometry><box><size>4 5 0.1</size></box></geometry></collision>"
        "</link></model><model name='ball'/>"
    )
    scene = read_scene(made.write_scene(tmp_path / "w.sdf", made.lisdf(box)))
    (floor,) = scene.objects
    assert floor.box == (4, 5, 0.1) and np.allclose(floor.world_from_object[:3, 3], [1, 2, 0])
    assert [p.object for p in scene.problems] == ["ball"]


def test_xml_entities_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "w.lisdf"
    path.write_text('<!DOCTYPE a [<!ENTITY b "c">]><sdf><world name="&b;"/></sdf>')
    with pytest.raises(InputFileError, match="entities"):
        read_scene(path)


def test_unknown_formats_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="holodeck"):
        load_reader("nonsense")
    path = tmp_path / "x.json"
    path.write_text(json.dumps({"a": 1}))
    with pytest.raises(InputFileError, match="no scene of a known format"):
        read_scene(path)


def test_real_kitchens(shared_data: Path) -> None:
    for path in sorted((shared_data / "scenes_lisdf").glob("*.lisdf")):
        scene = read_scene(path)
        assert scene.objects, path.name
