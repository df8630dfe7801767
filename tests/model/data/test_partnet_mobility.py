"""PartNet-Mobility folders: a made one with every quirk, and the real ones where they are."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from model.core.errors import InputFileError
from model.core.tree import KinematicTree
from model.data.folders import PartNetMobility, export_parts, read_partnet_mobility
from model.data.registry import Dataset
from model.io.merging import rigid_groups
from model.io.urdf.reader import read_urdf_model

URDF = """<?xml version="1.0"?>
<robot name="made">
  <link name="base"/>
  <link name="link_0">
    <visual name="door-1"><origin xyz="-1 0 0"/>
      <geometry><mesh filename="textured_objs/door.obj"/></geometry></visual>
  </link>
  <link name="handle_link">
    <visual><origin xyz="-1 0.5 0.1"/><geometry><box size="0.1 0.2 0.02"/></geometry></visual>
  </link>
  <link name="link_1">
    <visual name="body"><geometry><mesh filename="textured_objs/body.obj" scale="2 2 2"/>
    </geometry></visual>
  </link>
  <link name="link_2">
    <visual name="cap"><geometry><mesh filename="textured_objs/cap.obj"/></geometry></visual>
  </link>
  <link name="link_2_helper"/>
  <joint name="joint_1" type="fixed"><origin rpy="1.5707963267948966 0 -1.5707963267948966"/>
    <parent link="base"/><child link="link_1"/></joint>
  <joint name="joint_0" type="revolute"><origin xyz="1 0 0"/><axis xyz="0 -1 0"/>
    <parent link="link_1"/><child link="link_0"/><limit lower="1.5" upper="-0.1"/></joint>
  <joint name="handle_joint" type="fixed">
    <parent link="link_0"/><child link="handle_link"/></joint>
  <joint name="joint_3" type="prismatic"><axis xyz="0 1 0"/>
    <parent link="link_1"/><child link="link_2_helper"/><limit lower="0" upper="0.2"/></joint>
  <joint name="joint_2" type="continuous"><axis xyz="0 1 0"/>
    <parent link="link_2_helper"/><child link="link_2"/></joint>
</robot>
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    out = tmp_path / "set" / "7"
    (out / "textured_objs").mkdir(parents=True)
    for name, size, at in (
        ("door", (0.1, 2.0, 1.0), (1, 0, 0)),
        ("body", (1.0, 1.0, 1.0), (0, 0, 0)),
        ("cap", (0.5, 0.2, 0.5), (0, 1.1, 0)),
    ):
        mesh = trimesh.creation.box(extents=size)
        mesh.apply_translation(at)
        (out / "textured_objs" / f"{name}.obj").write_text(trimesh.exchange.obj.export_obj(mesh))
    (out / "mobility.urdf").write_text(URDF)
    (out / "semantics.txt").write_text(
        "link_0 hinge rotation_door\nlink_1 free bottle_body\nlink_2 slider+ rotation_lid\n"
    )
    (out / "meta.json").write_text(json.dumps({"model_cat": "Bottle"}))
    return out


def test_quirks_of_a_folder(folder: Path) -> None:
    truth = read_partnet_mobility(folder)
    obj = truth.object
    assert obj.category == "Bottle"
    assert {p.link: p.name for p in obj.parts} == {
        "link_0": "rotation_door",
        "link_1": "bottle_body",
        "link_2": "rotation_lid",
    }
    assert obj.tree.root == "link_1"
    assert "helper_2" in obj.tree.links and not any(
        x.startswith("link_") for x in obj.tree.links if "helper" in x
    )
    slide, turn = obj.tree.joint_of["helper_2"], obj.tree.joint_of["link_2"]
    assert (slide.type, turn.type, turn.parent) == ("prismatic", "continuous", "helper_2")
    # Y up in the file, +z up here; x of the file is -y here.
    assert slide.axis == pytest.approx((0, 0, 1), abs=1e-9)
    door = obj.tree.joint_of["link_0"]
    assert door.axis == pytest.approx((0, 0, -1), abs=1e-9)
    assert door.origin == pytest.approx((0, -1, 0), abs=1e-9)
    assert (door.lower, door.upper) == (-0.1, 1.5)
    assert any("merged" in n for n in truth.notes)
    bounds = {p.link: p.bounds for p in obj.parts}
    assert bounds["link_1"][1] == pytest.approx((1, 1, 1), abs=1e-6)
    assert bounds["link_2"][1][2] == pytest.approx(1.2, abs=1e-6)


def test_the_urdf_counts_where_the_other_description_differs(folder: Path) -> None:
    limit = {"a": 90, "b": 0, "noLimit": False}
    nodes = [
        {"id": 0, "joint": "slider", "jointData": {"limit": limit}},
        {"id": 1, "joint": "free", "jointData": {}},
        {"id": 2, "joint": "slider", "jointData": {"limit": {**limit, "a": 0.5}}},
    ]
    (folder / "mobility_v2.json").write_text(json.dumps(nodes))
    truth = read_partnet_mobility(folder)
    assert truth.object.tree.joint_of["link_0"].type == "revolute"
    said = [n for n in truth.notes if "mobility_v2" in n]
    assert len(said) == 2 and "slider" in said[0] and "another range" in said[1]


def test_textures_lie_beside_the_meshes_folder(folder: Path) -> None:
    (folder / "images").mkdir()
    Image.new("RGB", (4, 4), (200, 30, 10)).save(folder / "images" / "texture_1.jpg")
    (folder / "textured_objs" / "cap.mtl").write_text("newmtl m\nmap_Kd ../images/texture_1.jpg\n")
    (folder / "textured_objs" / "cap.obj").write_text(
        "mtllib cap.mtl\nv 0 1 0\nv 1 1 0\nv 0 1 1\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\n"
        "f 1/1 2/2 3/3\n"
    )
    parts = read_partnet_mobility(folder).object.parts
    (cap,) = (p for p in parts if p.mesh is not None and len(p.mesh.faces) == 1)
    assert cap.mesh is not None and any(m.texture is not None for m in cap.mesh.materials)
    assert not any(p.remarks for p in parts)


def test_names_can_be_kept_back(folder: Path) -> None:
    truth = read_partnet_mobility(folder)
    bare = truth.segmented(names=False)
    assert bare.category is None and all(p.name is None for p in bare.parts)
    assert truth.segmented().category == "Bottle"


def test_names_from_the_json_where_there_is_no_text(folder: Path) -> None:
    (folder / "semantics.txt").unlink()
    nodes = [{"id": 0, "name": "door"}, {"id": 1, "name": "body"}]
    (folder / "mobility_v2.json").write_text(json.dumps(nodes))
    names = {p.link: p.name for p in read_partnet_mobility(folder).object.parts}
    assert names == {"link_0": "door", "link_1": "body", "link_2": None}


def test_what_is_missing_is_named(folder: Path) -> None:
    (folder / "textured_objs" / "cap.obj").unlink()
    remarks = read_partnet_mobility(folder).notes
    assert any("'cap.obj' of link" in r and "isn't there" in r for r in remarks)
    with pytest.raises(InputFileError, match=r"mobility\.urdf"):
        read_partnet_mobility(folder.parent / "8")
    with pytest.raises(InputFileError, match=r"no PartNet-Mobility object"):
        PartNetMobility(folder / "textured_objs").ids()


def test_is_a_dataset(folder: Path) -> None:
    data = PartNetMobility(folder.parent)
    assert isinstance(data, Dataset)
    assert data.ids() == ("7",)
    assert data.load("7").id == "7"


@pytest.mark.parametrize("with_names", [True, False])
def test_exported_parts_are_read_back(folder: Path, tmp_path: Path, with_names: bool) -> None:
    from model.io.open_asset import read_part_files

    truth = read_partnet_mobility(folder)
    rng = np.random.default_rng(5)
    export_parts(truth, tmp_path / "out", with_names=with_names, rng=rng)
    back = read_part_files(tmp_path / "out")
    assert back.category == ("Bottle" if with_names else None)
    by_link = {p.link: p for p in back.parts}
    for part in truth.object.parts:
        other = by_link[part.link]
        assert other.name == (part.name if with_names else None)
        assert other.bounds == pytest.approx(part.bounds, abs=1e-5)
        assert part.mesh is not None and other.mesh is not None
        assert other.mesh.face_areas.sum() == pytest.approx(part.mesh.face_areas.sum(), rel=1e-4)


def test_real_objects_agree_with_yourdfpy(shared_data: Path) -> None:
    """Every link of every eighth object is where another reader has it, at random joint values."""
    import yourdfpy

    data = PartNetMobility(shared_data / "partnet_mobility")
    ids = data.ids()
    rng = np.random.default_rng(0)
    for object_id in ids[::8]:
        obj = data.load(object_id).object
        path = data.root / object_id / "mobility.urdf"
        other = yourdfpy.URDF.load(str(path), load_meshes=False, build_collision_scene_graph=False)
        for joint in other.joint_map.values():
            # Some axes are not of unit length; yourdfpy takes them as they are.
            if joint.axis is not None and np.linalg.norm(joint.axis) > 0:
                joint.axis = joint.axis / np.linalg.norm(joint.axis)
        base = other.base_link
        carried = carriers(read_urdf_model(path).tree, obj.tree, other)
        assert set(carried) == set(other.link_map), object_id
        rest = {link: other.get_transform(link, base) for link in carried}
        for _ in range(2):
            q = {j.name: float(rng.uniform(-1, 1)) for j in obj.tree.joints}
            other.update_cfg({n: q[n] for n in other.actuated_joint_names})
            posed = obj.pose(q)
            for link, world_from_link in rest.items():
                expected = other.get_transform(link, base)
                moved = posed[carried[link]] if carried[link] else np.eye(4)
                assert np.allclose(moved @ world_from_link, expected, atol=1e-6), (object_id, link)
    assert len(ids) >= 79


def carriers(whole: KinematicTree, tree: KinematicTree, other) -> dict[str, str]:
    """Link in the file → the link of the merged tree that carries it, "" for the empty root."""
    written = {j.child: other.joint_map[j.name].child for j in whole.joints}
    written[whole.root] = other.base_link
    out: dict[str, str] = {}
    for links in rigid_groups(whole).values():
        found = {name for x in links for name in (x, f"link_{x}") if name in tree.links}
        assert len(found) <= 1
        out |= {written[x]: next(iter(found), "") for x in links}
    return out
