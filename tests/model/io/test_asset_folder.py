"""A saved asset: complete, loadable elsewhere, never half written."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yourdfpy
from PIL import Image

from model.core.articulated_object import ArticulatedObject, Part
from model.core.asset import Asset
from model.core.errors import GeometryError, InputFileError
from model.core.geometry import Material, Mesh, PointCloud
from model.core.joint import Joint, Mimic
from model.core.tree import KinematicTree
from model.geometry.splitting import split
from model.io.assets import asset_folder
from model.io.assets.asset_folder import load_object, read_provenance, reload_check, write_asset
from model.io.export.part_files import file_stems
from model.io.file_names import FileNames
from model.io.urdf.writer import read_urdf
from model.physics.simulation_values import physics_of
from tests.builders import joined, slide

PROVENANCE = {"who": "ana", "source": {"path": "scan.ply", "sha256": "00"}, "prompts": []}
JOINTS = (
    Joint("fix", "fixed", "base", "link_0"),
    Joint("hinge", "revolute", "link_0", "link_1", (0, 0.6, 0.8), (0.5, 0.1, 0.2), 0, 1.5),
    Joint("turn", "continuous", "link_1", "helper", (0, 1, 0), (0.3, 0.2, 0.1)),
    slide("slide", "link_2", 0.3, parent="helper", origin=(1, 0, 0), mimic=Mimic("hinge", 0.2)),
)
TREE = KinematicTree(("base", "link_0", "link_1", "helper", "link_2"), JOINTS)


def textured_asset() -> Asset:
    """A ball in three materials, one of them with a texture."""
    ball = trimesh.creation.icosphere(3, 0.5)
    rng = np.random.default_rng(0)
    texture = Image.fromarray(rng.integers(0, 255, (8, 8, 3), dtype=np.uint8))
    materials = (
        Material("wood", (200, 100, 50, 255)),
        Material("cloth", texture=texture),
        Material("glass", (0, 0, 255, 128)),
    )
    mesh = Mesh(
        np.asarray(ball.vertices),
        np.asarray(ball.faces),
        np.arange(len(ball.faces), dtype=np.int32) % 3,
        materials,
        uv=np.asarray(ball.vertices[:, :2] + 0.5, np.float32),
    )
    return Asset("ball", mesh)


def textured_object() -> tuple[ArticulatedObject, Asset]:
    asset = textured_asset()
    assert asset.mesh is not None
    labels = np.digitize(asset.element_centers[:, 2], [-0.1, 0.2])
    parts = split(asset, labels, {1: "door", 2: "lid"})
    return ArticulatedObject("ball", parts, TREE, category="Ball"), asset


def cloud_object(points: int = 1500) -> tuple[ArticulatedObject, Asset]:
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(points, 3))
    ball /= 2 * np.linalg.norm(ball, axis=1, keepdims=True)
    colors = rng.integers(0, 255, (points, 3)).astype(np.uint8)
    asset = Asset("scan", cloud=PointCloud(ball.astype(np.float32), colors=colors))
    parts = split(asset, np.digitize(ball[:, 2], [-0.1, 0.2]), {})
    return ArticulatedObject("scan", parts, TREE), asset


def plain_colors(mesh: Mesh) -> dict[str, tuple[int, ...]]:
    return {m.name: m.base_color for m in mesh.materials if m.texture is None}


def test_everything_is_there_and_comes_back(tmp_path):
    obj, asset = textured_object()
    files = write_asset(obj, tmp_path / "out" / "ball", provenance=PROVENANCE, original=asset)
    assert files.urdf.is_file() and files.tree.is_file() and files.provenance.is_file()
    assert {link: p.name for link, p in files.meshes.items()} == {
        link: f"{link}.obj" for link in ("link_0", "door_1", "lid_2")
    }
    assert files.clouds == {}
    assert reload_check(files.folder) == []

    back = load_object(files.folder)
    assert (back.name, back.category) == ("ball", "Ball")
    assert [(p.link, p.name) for p in back.parts] == [
        ("link_0", None),
        ("door_1", "door"),
        ("lid_2", "lid"),
    ]
    for old, new in zip(obj.parts, back.parts, strict=True):
        assert old.mesh is not None and new.mesh is not None
        np.testing.assert_allclose(new.mesh.triangles, old.mesh.triangles, atol=1e-8)
        assert plain_colors(new.mesh) == plain_colors(old.mesh) != {}
        textures = [m.texture for m in new.mesh.materials if m.texture is not None]
        assert len(textures) == 1
        np.testing.assert_array_equal(
            np.asarray(textures[0].convert("RGB")), np.asarray(asset.mesh.materials[1].texture)
        )


def test_areas_add_up(tmp_path):
    obj, asset = textured_object()
    files = write_asset(obj, tmp_path / "ball", provenance={}, original=asset)
    assert asset.mesh is not None
    whole = asset.mesh.face_areas.sum()
    written = sum(p.mesh.face_areas.sum() for p in read_urdf(files.urdf).parts if p.mesh)
    assert written == pytest.approx(whole, rel=1e-6)
    faces = sum(entry["faces"] for entry in read_provenance(files.folder)["asset"]["parts"])
    assert faces == len(asset.mesh.faces)


def test_parts_that_do_not_add_up_are_refused_before_anything_is_written(tmp_path):
    obj, asset = textured_object()
    tree = KinematicTree(("link_0", "link_1"), (TREE.joints[1],))
    with pytest.raises(GeometryError, match="area"):
        write_asset(
            ArticulatedObject("x", obj.parts[:2], tree),
            tmp_path / "x",
            provenance={},
            original=asset,
        )
    obj, asset = cloud_object()
    with pytest.raises(GeometryError, match="points"):
        write_asset(
            ArticulatedObject("x", obj.parts[:2], tree),
            tmp_path / "x",
            provenance={},
            original=asset,
        )
    assert not list(tmp_path.iterdir())


def test_provenance_tells_where_it_comes_from(tmp_path):
    obj, asset = textured_object()
    folder = write_asset(obj, tmp_path / "a", provenance=PROVENANCE, original=asset).folder
    data = json.loads((folder / "provenance.json").read_text())
    assert data["who"] == "ana" and data["source"]["sha256"] == "00"
    kept = data["asset"]
    assert kept["format"] == 1 and kept["written"].endswith("+00:00")
    assert kept["versions"]["artiworld"] and kept["original"]["faces"] == len(asset.mesh.faces)
    for name, digest in kept["files"].items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest
    beside = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    assert beside == {*kept["files"], "provenance.json"}


def test_a_scanned_part_keeps_its_cloud_and_gets_a_mesh(tmp_path):
    obj, asset = cloud_object()
    files = write_asset(obj, tmp_path / "scan", provenance={}, original=asset)
    assert set(files.clouds) == set(files.meshes) == {"link_0", "link_1", "link_2"}
    assert reload_check(files.folder) == []
    assert "link_0.obj" in files.urdf.read_text() and ".ply" not in files.urdf.read_text()
    for old, new in zip(obj.parts, load_object(files.folder).parts, strict=True):
        assert new.mesh is not None and new.cloud is not None and old.cloud is not None
        np.testing.assert_array_equal(new.cloud.points, old.cloud.points)
        np.testing.assert_array_equal(new.cloud.colors, old.cloud.colors)
        np.testing.assert_allclose(new.mesh.bounds, old.cloud.bounds, atol=0.15)


@pytest.mark.parametrize(
    "points",
    [
        [[0, 0, 0]],
        [[0, 0, 0], [1, 0, 0]],
        [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [4, 0, 0]],
        [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0.5, 0.5, 0]],
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
    ],
)
def test_a_part_of_few_points_still_loads_everywhere(tmp_path, points):
    few = PointCloud(np.array(points, np.float32), colors=np.full((len(points), 3), 9, np.uint8))
    obj, _ = cloud_object()
    obj = replace(obj, parts=(*obj.parts[:2], Part("link_2", cloud=few)))
    files = write_asset(obj, tmp_path / "few", provenance={})
    assert reload_check(files.folder) == []


def test_shapes_that_were_to_give_way_are_known_when_the_asset_is_read(tmp_path):
    boxes = [Part(f"link_{i}", joined(trimesh.creation.box())) for i in range(2)]
    boxes[0] = replace(boxes[0], link="base")
    joints = (Joint("slide", "prismatic", "base", "link_1", lower=0, upper=1, give_way=True),)
    obj = ArticulatedObject("x", tuple(boxes), KinematicTree(("base", "link_1"), joints))
    write_asset(obj, tmp_path / "x", provenance={})
    assert load_object(tmp_path / "x").tree.joints == joints
    stored = replace(obj, tree=obj.tree.with_joint(replace(joints[0], give_way=False)))
    write_asset(stored, tmp_path / "x", provenance={})
    assert load_object(tmp_path / "x").tree == stored.tree


@pytest.mark.parametrize("corners", [3, 4])
def test_a_flat_mesh_still_loads_everywhere(tmp_path, corners):
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0.5], [0, 1, 0.5]])[:corners]
    faces = np.array([[0, 1, 2], [0, 2, 3]])[: corners - 2]
    obj, _ = textured_object()
    obj = replace(obj, parts=(*obj.parts[:2], Part("link_2", Mesh(square, faces))))
    files = write_asset(obj, tmp_path / "flat", provenance={})
    assert reload_check(files.folder) == []


def test_odd_names_become_safe_files(tmp_path):
    obj, _ = textured_object()
    names = {"link_0": "Tür/../x", "link_1": "a b", "link_2": 'A_B"<&'}
    tree = KinematicTree(
        tuple(names.get(n, n) for n in TREE.links),
        tuple(
            replace(j, parent=names.get(j.parent, j.parent), child=names.get(j.child, j.child))
            for j in TREE.joints
        ),
    )
    parts = tuple(replace(p, link=names[p.link]) for p in obj.parts)
    files = write_asset(ArticulatedObject("o", parts, tree), tmp_path / "odd", provenance={})
    assert reload_check(files.folder) == []
    assert {p.parent for p in files.meshes.values()} == {files.folder / "meshes"}
    stems = file_stems(["link_0", "a b", "A_B", "..", "", "a/b"])
    assert stems["link_0"] == "link_0"
    assert len({s.lower() for s in stems.values()}) == 6
    assert all(s.replace("_", "").isalnum() for s in stems.values())


def test_yourdfpy_sees_the_parts_where_they_are(tmp_path):
    obj, _ = textured_object()
    files = write_asset(obj, tmp_path / "ball", provenance={})
    names = FileNames.of(obj).links
    robot = yourdfpy.URDF.load(str(files.urdf))
    q = {"hinge": 0.7, "turn": 2.0}
    robot.update_cfg(q)
    posed = obj.pose(q)
    for part in obj.parts:
        assert part.mesh is not None
        mine = trimesh.transform_points(part.mesh.vertices, posed[part.link])
        theirs = np.concatenate(
            [
                trimesh.transform_points(robot.scene.geometry[name].vertices, matrix)
                for node in robot.scene.graph.nodes_geometry
                if robot.scene.graph.transforms.parents[node] == names[part.link]
                for matrix, name in [robot.scene.graph.get(node)]
            ]
        )
        np.testing.assert_allclose(theirs.min(0), mine.min(0), atol=1e-6)
        np.testing.assert_allclose(theirs.max(0), mine.max(0), atol=1e-6)


def test_an_asset_is_replaced_whole(tmp_path):
    obj, _ = textured_object()
    folder = write_asset(obj, tmp_path / "a", provenance={"version": 1}).folder
    (folder / "meshes" / "stale.obj").write_text("old")
    write_asset(replace(obj, name="second"), folder, provenance={"version": 2})
    assert read_provenance(folder)["version"] == 2
    assert not (folder / "meshes" / "stale.obj").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize("step", ["write_urdf_of", "tree_to_json", "file_sha256"])
def test_a_failure_leaves_the_old_asset_as_it_was(tmp_path, monkeypatch, step):
    obj, _ = textured_object()
    folder = write_asset(obj, tmp_path / "a", provenance={"version": 1}).folder
    before = {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}

    def full(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(asset_folder, step, full)
    with pytest.raises(InputFileError, match="No space left"):
        write_asset(obj, folder, provenance={"version": 2})
    assert {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()} == before
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize("read", [load_object, read_provenance])
def test_an_asset_comes_back_after_a_kill_between_the_renames(tmp_path, monkeypatch, read):
    obj, _ = textured_object()
    folder = write_asset(obj, tmp_path / "a", provenance={"version": 1}).folder

    class Killed(BaseException):
        pass

    moves: list[Path] = []
    rename = Path.rename

    def killed(self, target):
        moves.append(self)
        if len(moves) == 3:  # the place is taken; aside with the old one; now the new one
            raise Killed
        return rename(self, target)

    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr(Path, "rename", killed)
        write_asset(replace(obj, name="second"), folder, provenance={"version": 2})
    assert not folder.exists()
    read(folder)
    assert read_provenance(folder)["version"] == 1 and reload_check(folder) == []


def test_an_asset_with_shapes_loads_everywhere(tmp_path):
    obj, asset = textured_object()
    # Slices of a ball in one another's way all round take long to be given room.
    short = tuple(
        j if j.type == "fixed" else replace(j, type="prismatic", lower=0.0, upper=0.05)
        for j in obj.tree.joints
    )
    obj = replace(obj, tree=replace(obj.tree, joints=short))
    physics = physics_of(obj)
    files = write_asset(obj, tmp_path / "a", provenance={}, original=asset, physics=physics)
    assert reload_check(files.folder) == []
    text = files.urdf.read_text()
    assert text.count("<collision>") == sum(len(held) for held in physics.collision.values()) > 0
    assert "<dynamics damping=" in text
    hulls = sorted((files.folder / "meshes" / "collision").iterdir())
    recorded = read_provenance(files.folder)["asset"]["files"]
    assert {p.relative_to(files.folder).as_posix() for p in hulls} <= set(recorded)


def test_a_folder_of_other_things_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("precious")
    obj, _ = textured_object()
    with pytest.raises(InputFileError, match="not a saved asset"):
        write_asset(obj, tmp_path, provenance={})
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_part_without_geometry_is_named(tmp_path):
    nothing = Part("link_2", Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)))
    obj, _ = textured_object()
    with pytest.raises(GeometryError, match="link_2"):
        write_asset(replace(obj, parts=(*obj.parts[:2], nothing)), tmp_path / "a", provenance={})
    assert not list(tmp_path.iterdir())


def damage_tree(folder: Path) -> None:
    data = json.loads((folder / "tree.json").read_text())
    data["children"][0]["joint_type"] = "prismatic"
    (folder / "tree.json").write_text(json.dumps(data))


def damage_mesh(folder: Path) -> None:
    path = folder / "meshes" / "door_1.obj"
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:-40]))


def damage_urdf(folder: Path) -> None:
    path = folder / "object.urdf"
    path.write_text(path.read_text().replace('mass value="', 'mass value="-'))


@pytest.mark.parametrize(
    ("damage", "word"),
    [
        (damage_tree, "prismatic"),
        (damage_mesh, "door_1: area"),
        (damage_urdf, "MuJoCo"),
        (lambda f: (f / "object.urdf").write_text("<robot"), "well-formed"),
        (lambda f: (f / "meshes" / "lid_2.obj").unlink(), "lid_2"),
        (lambda f: (f / "provenance.json").unlink(), "provenance.json"),
        (lambda f: (f / "tree.json").unlink(), "tree.json"),
        (lambda f: next((f / "meshes").glob("texture_*")).unlink(), "texture_"),
    ],
)
def test_damage_is_found(tmp_path, damage, word):
    obj, asset = textured_object()
    folder = write_asset(obj, tmp_path / "a", provenance={}, original=asset).folder
    damage(folder)
    problems = reload_check(folder)
    assert any(word in p for p in problems), problems


def test_a_newer_format_is_refused(tmp_path):
    obj, _ = textured_object()
    folder = write_asset(obj, tmp_path / "a", provenance={}).folder
    data = read_provenance(folder)
    data["asset"]["format"] = 99
    (folder / "provenance.json").write_text(json.dumps(data))
    with pytest.raises(InputFileError, match="newer"):
        load_object(folder)


@pytest.mark.parametrize("name", ["45213", "102411", "100234", "dex_cup"])
def test_real_objects_are_saved_and_load_again(shared_data, tmp_path, name):
    obj = read_urdf(shared_data / "partnet_mobility" / name / "mobility.urdf")
    files = write_asset(obj, tmp_path / name, provenance={})
    assert reload_check(files.folder, configurations=2) == []
