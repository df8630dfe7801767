"""Which parts an asset tells by itself."""

import json
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import trimesh

from model.io.assets.asset_folder import write_asset
from model.io.assets.reader import load_object
from model.io.open_asset import open_asset
from model.physics.simulation_values import plain_physics
from model.scenes.asset_parts import known_parts
from model.scenes.jobs import AssetJob, ConvertAsset
from tests.model.scenes import scenes_made as made


def gltf(path: Path, names: tuple[str, ...]) -> Path:
    """The cabinet, 11 boards in all; each of its parts a node, moved and nested."""
    scene = trimesh.Scene()
    lift = trimesh.transformations.translation_matrix((0.5, 1.0, 0.0))
    scene.graph.update(frame_to="wrapper", frame_from="world", matrix=lift)
    for name, mesh in zip(names, made.cabinet_parts().values(), strict=True):
        solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        names = {"node_name": name, "geom_name": f"m {name}", "parent_node_name": "wrapper"}
        scene.add_geometry(solid, transform=np.diag([1.0, -2.0, 1.0, 1.0]), **names)
    path.write_bytes(scene.export(file_type="glb"))
    return path


def test_meshes_that_are_called_after_parts_are_parts(tmp_path: Path) -> None:
    path = gltf(tmp_path / "cab.glb", ("Body", "door_left", "Drawer.001"))
    found = known_parts(path)
    faces = {p.name: len(p.mesh.faces) for p in found.parts if p.mesh is not None}
    assert faces == {"Body": 72, "door_left": 24, "Drawer.001": 48}
    assert found.parts[0].link == "link_0" and found.how == "its named meshes"
    whole = open_asset(path).bounds
    assert np.allclose(np.min([p.bounds[0] for p in found.parts], axis=0), whole[0], atol=1e-6)
    assert np.allclose(np.max([p.bounds[1] for p in found.parts], axis=0), whole[1], atol=1e-6)


@pytest.mark.parametrize("names", [("Object_1", "Object_2", "Object_3"), ("wood", "glass", "1")])
def test_meshes_without_such_a_name_may_be_materials(tmp_path: Path, names: tuple) -> None:
    assert known_parts(gltf(tmp_path / "cab.glb", names)).how == "its connected pieces"


def weighing(kilograms: float) -> str:
    moments = " ".join(f'{k}="0.1"' for k in ("ixx", "iyy", "izz"))
    zeros = " ".join(f'{k}="0"' for k in ("ixy", "ixz", "iyz"))
    return f'<inertial><mass value="{kilograms}"/><inertia {moments} {zeros}/></inertial>'


def robot(**kilograms: float) -> str:
    """A body with a door, which has a grip screwed to it; what each weighs is told."""
    links = "".join(
        f'<link name="{name}">{weighing(kilograms[name]) if name in kilograms else ""}'
        f'<visual><geometry><mesh filename="{name}.ply"/></geometry></visual></link>'
        for name in ("body", "door", "grip")
    )
    return f"""<robot name="r">{links}
<joint name="hinge" type="revolute"><origin xyz="-0.3 -0.151 0"/><axis xyz="0 0 -1"/>
<parent link="body"/><child link="door"/><limit lower="0" upper="1.2"/></joint>
<joint name="screwed" type="fixed"><parent link="door"/><child link="grip"/></joint></robot>"""


@pytest.fixture
def cupboard(tmp_path: Path) -> Path:
    folder = tmp_path / "cupboard"
    folder.mkdir()
    boxes = {
        "body": [[-0.3, -0.13, 0], [0.3, 0.15, 0.4]],
        "door": [[0, 0, 0], [0.6, 0.02, 0.4]],
        "grip": [[0.5, -0.03, 0.1], [0.52, 0, 0.3]],
    }
    for name, bounds in boxes.items():
        trimesh.creation.box(bounds=bounds).export(folder / f"{name}.ply")
    (folder / "object.urdf").write_text(robot(body=9.0, grip=0.2))
    return folder


def masses(asset: Path, out: Path, scale: float = 1.0) -> dict[str, float]:
    size = (scale, scale, scale)
    job = AssetJob("k", asset, size, None, True, "Cabinet", "geometric", 0, False, 120.0)
    report = ConvertAsset(out, {"k": job}, None)("k")
    assert report["state"] == "predicted", report["reason"]
    root = ET.parse(out / "assets" / "k" / "mjcf" / "object.xml")
    return {
        b.get("name", ""): float(weighed.get("mass", 0))
        for b in root.iter("body")
        if (weighed := b.find("inertial")) is not None
    }


def test_a_urdf_tells_masses_at_its_own_size(cupboard: Path, tmp_path: Path) -> None:
    told = masses(cupboard, tmp_path / "out")
    assert told["link_body"] == pytest.approx(9.0)
    assert told["link_door"] != pytest.approx(0.2), "a grip's mass alone is not its door's"
    (cupboard / "object.urdf").write_text(robot(body=9.0, door=9.0, grip=0.2))
    known = known_parts(cupboard).inertials
    assert {k: round(i.mass, 3) for k, i in known.items()} == {"link_body": 9.0, "link_door": 9.2}
    larger = masses(cupboard, tmp_path / "larger", 1.5)
    assert larger["link_body"] != pytest.approx(9.0)


def test_a_urdf_tells_collision_shapes_at_every_size_that_is_no_stretch(
    cupboard: Path, tmp_path: Path
) -> None:
    shape = "<collision><geometry><sphere radius='0.03'/></geometry></collision>"
    text = (cupboard / "object.urdf").read_text()
    (cupboard / "object.urdf").write_text(text.replace("<visual>", shape + "<visual>"))
    counts = {k: len(held) for k, held in known_parts(cupboard).shapes.items()}
    assert counts == {"link_body": 1, "link_door": 2}
    for size in ((1.5, 1.5, 1.5), (1.0, 1.0, 1.5)):
        job = AssetJob("k", cupboard, size, None, True, "Cabinet", "geometric", 0, True, 120.0)
        out = tmp_path / str(size)
        report = ConvertAsset(out, {"k": job}, None)("k")
        assert report["state"] == "predicted", report["reason"]
        root = ET.parse(out / "assets" / "k" / "mjcf" / "object.xml")
        geoms = [g for g in root.iter("geom") if g.get("group") == "3"]
        spheres = [g.get("size") for g in geoms if g.get("type") == "sphere"]
        told = json.loads((out / "assets" / "k" / "provenance.json").read_text())["asset"]["told"]
        if size[0] == size[2]:
            assert spheres == ["0.045"] * 3 and len(geoms) == 3
            assert told["collision"] == ["link_body", "link_door"]
        else:
            assert not spheres and geoms and told["collision"] == []


def test_of_a_saved_asset_only_what_its_source_told(cupboard: Path, tmp_path: Path) -> None:
    obj = load_object(cupboard)
    folder = tmp_path / "asset"
    write_asset(obj, folder, provenance={}, physics=plain_physics(obj))
    assert set(known_parts(folder).inertials) == {"link_body"}
