"""One contract for all export formats, and what each format must keep."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest
import trimesh
from PIL import Image
from pxr import Usd, UsdGeom, UsdPhysics, UsdShade
from scipy.spatial.transform import Rotation

from model.core.articulated_object import ArticulatedObject, Part
from model.core.errors import ConfigurationError, InputFileError
from model.core.geometry import Material, Mesh, PointCloud
from model.core.joint import Joint, Mimic
from model.core.shapes import Primitive, Solid
from model.core.tree import KinematicTree
from model.data.folders import MjcfFolder
from model.io.assets.asset_folder import write_asset
from model.io.assets.reader import load_object, mujoco_problems, object_from_links, reading_notes
from model.io.export import registry
from model.io.export.formats import documented
from model.io.export.registry import Exporter, export, exporter_names, load_exporter, write_object
from model.io.export.urdf import losses_of
from model.io.open_asset import open_asset
from model.io.readback import read_back
from model.io.urdf.writer import read_urdf
from model.physics.simulation_values import Physics, PhysicsSettings, physics_of, whose_shapes
from tests.builders import read_glb

TREE = KinematicTree(
    ("base", "door", "link_2", "helper", "link_3", "link_4"),
    (
        Joint("hinge", "revolute", "base", "door", (0, 0.6, 0.8), (0.5, 0.1, 0.2), -0.2, 2.5),
        Joint("turn <&>", "continuous", "door", "link_2", (0, 1, 0), (0.3, 0.2, 0.1)),
        Joint("slide", "prismatic", "base", "helper", (1, 0, 0), (1, 0, 0), 0, 0.3),
        Joint(
            "follow", "revolute", "helper", "link_3", (0, 0, 1), (0, 1, 0), -1, 1,
            Mimic("hinge", -0.5, 0.1),
        ),
        Joint("fix", "fixed", "link_3", "link_4"),
    ),
)  # fmt: skip


def box_mesh(shift: float, *materials: Material, uv: bool = False) -> Mesh:
    box = trimesh.creation.box((0.2, 0.3, 0.4)).apply_translation([shift, 0, 0])
    which = np.arange(len(box.faces), dtype=np.int32) % max(len(materials), 1)
    return Mesh(
        np.asarray(box.vertices),
        np.asarray(box.faces),
        which,
        materials or (Material(),),
        np.asarray(box.vertices[:, :2], np.float32) if uv else None,
    )


def make_object() -> ArticulatedObject:
    """Textures, several materials, vertex colours, a cloud, a flat mesh."""
    rng = np.random.default_rng(0)
    picture = Image.fromarray(rng.integers(0, 255, (4, 4, 3), dtype=np.uint8))
    colored = box_mesh(0.9)
    colors = np.tile(np.array([250, 10, 20, 255], np.uint8), (len(colored.vertices), 1))
    red = Material("red", (255, 0, 0, 255), metallic=0.75, roughness=0.25)
    pictured = Material("pic", texture=picture)
    parts = (
        Part("base", box_mesh(0, red, pictured, uv=True)),
        Part("door", box_mesh(0.5, pictured, uv=True), name="door"),
        Part("link_2", cloud=PointCloud(rng.random((200, 3), np.float32) * 0.1)),
        Part("link_3", Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]), np.array([[0, 1, 2]]))),
        Part("link_4", Mesh(colored.vertices, colored.faces, vertex_colors=colors)),
    )  # fmt: skip
    return ArticulatedObject("my <object>", parts, TREE, category="Cabinet")


@pytest.fixture(scope="module")
def obj() -> ArticulatedObject:
    return make_object()


@pytest.fixture(scope="module")
def asset(obj, tmp_path_factory) -> Path:
    return write_asset(obj, tmp_path_factory.mktemp("assets") / "a", provenance={}).folder


@pytest.fixture(scope="module")
def exported(asset, tmp_path_factory):
    """Format → files, each exported once."""
    return {n: export(asset, n, tmp_path_factory.mktemp("out") / n) for n in exporter_names()}


@pytest.fixture(scope="module")
def physics(obj) -> Physics:
    return physics_of(obj)


@pytest.fixture(scope="module")
def whole(obj, physics, tmp_path_factory):
    """Format → files with collision shapes, masses and dynamics."""
    out: dict[str, tuple[Path, ...]] = {}
    for name in registry.EXPORTERS.built_in:
        folder = tmp_path_factory.mktemp("whole") / name
        out[name] = write_object(obj, load_exporter(name), folder, physics=physics)
    return out


def test_what_mujoco_leaves_out_of_a_urdf_is_told(obj):
    assert losses_of(obj)[0].startswith("link_3 is flat, which MuJoCo refuses in a URDF")
    whole = replace(obj, parts=(*obj.parts[:3], replace(obj.parts[3], mesh=obj.parts[4].mesh),
                                obj.parts[4]))  # fmt: skip
    assert losses_of(whole) == ()


def test_the_built_in_formats_are_there():
    assert exporter_names()[:3] == ("urdf", "mjcf", "glb")


@pytest.mark.parametrize("name", registry.EXPORTERS.built_in)
class TestContract:
    def test_it_is_an_exporter(self, name):
        made = load_exporter(name)
        assert isinstance(made, Exporter) and made.name == name
        assert made.description and "\n" not in made.description

    def test_it_says_what_it_wrote(self, exported, name):
        files = exported[name]
        folder = files[0].parent
        assert folder.name == name
        assert len(files) == len(set(files))
        assert all(p.is_file() and p.stat().st_size and p.is_relative_to(folder) for p in files)

    def test_the_folder_can_be_moved(self, exported, name):
        """No file names a place outside of the folder."""
        folder = exported[name][0].parent
        for path in folder.rglob("*"):
            data = path.read_bytes() if path.is_file() else b""
            assert str(folder).encode() not in data and b"../" not in data

    def test_it_can_be_written_again(self, asset, tmp_path, name):
        first = {p: p.read_bytes() for p in export(asset, name, tmp_path / "again")}
        assert {p: p.read_bytes() for p in export(asset, name, tmp_path / "again")} == first

    def test_a_folder_that_cannot_be_written_is_named(self, asset, tmp_path, name):
        (tmp_path / "file").write_text("")
        with pytest.raises(InputFileError, match="file"):
            export(asset, name, tmp_path / "file" / "out")

    def test_progress_ends_at_one(self, obj, tmp_path, name):
        seen: list[float] = []
        load_exporter(name).export(obj, tmp_path, progress=lambda f, m: seen.append(f))
        assert seen == sorted(seen) and seen[-1] == 1.0


def settings(obj) -> list[dict[str, float]]:
    rng = np.random.default_rng(0)
    free = [j.name for j in obj.tree.joints if j.moves and j.mimic is None]
    return [{n: float(rng.uniform(-2, 2)) for n in free} for _ in range(5)]


@pytest.mark.parametrize("name", registry.EXPORTERS.built_in)
def test_other_readers_put_every_link_where_pose_does(whole, obj, name):
    for seed in range(2):
        back = read_back(name, whole[name][0], obj, seed=seed)
        assert back.readers and back.problems == ()


@pytest.mark.parametrize("name", registry.EXPORTERS.built_in)
def test_a_link_elsewhere_is_noticed(whole, obj, name):
    moved = replace(obj.tree.by_name["slide"], axis=(0.0, 1.0, 0.0))
    wrong = replace(obj, tree=obj.tree.with_joint(moved))
    assert any("helper" in p for p in read_back(name, whole[name][0], wrong).problems)


def test_collision_shapes_are_in_every_format_that_has_them(whole, physics):
    count = sum(len(held) for held in physics.collision.values())
    ros = whole["ros"][0].parent / "urdf" / "object.urdf"
    for path in (whole["urdf"][0], ros):
        assert path.read_text().count("<collision>") == count
    assert whole["sdf"][0].read_text().count("<collision name=") == count
    root = ET.parse(whole["mjcf"][0]).getroot()
    assert sum(g.get("group") == "3" for g in root.iter("geom")) == count
    stage = Usd.Stage.Open(str(whole["usd"][0]))
    colliders = [p for p in stage.Traverse() if p.HasAPI(UsdPhysics.CollisionAPI)]
    assert len(colliders) == count


def test_shapes_of_the_source_are_what_they_were_in_every_format(tmp_path):
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", (0.3, 0.2, 0.1)).as_matrix()
    kinds = {"box": (0.1, 0.2, 0.3), "cylinder": (0.1, 0.3), "sphere": (0.1,),
             "capsule": (0.1, 0.2)}  # fmt: skip
    stairs = trimesh.boolean.union(
        [trimesh.creation.box(bounds=[[0, 0, 0], high]) for high in ((2, 1, 1), (1, 1, 2))]
    )
    solid = Solid(np.asarray(stairs.vertices), np.asarray(stairs.faces, np.int32))
    held = (*(Primitive(kind, pose, sizes) for kind, sizes in kinds.items()), solid)
    tree = KinematicTree(
        ("link_0", "door"), (Joint("hinge", "revolute", "link_0", "door", lower=0, upper=1),)
    )
    parts = (Part("link_0", box_mesh(0)), Part("door", box_mesh(0.5)))
    obj = ArticulatedObject("o", parts, tree, shapes={"door": held})
    made = physics_of(obj)
    assert made.declared_shapes == ("door",) and made.collision["link_0"]
    assert whose_shapes(obj, made) == (
        "collision shapes of door are the file's own, those of link_0 are made"
    )
    files = {}
    for name in ("urdf", "mjcf", "sdf", "usd"):
        files[name] = write_object(obj, load_exporter(name), tmp_path / name, physics=made)[0]
        assert not read_back(name, files[name], obj).problems
    again = load_object(files["urdf"]).shapes["door"]
    assert [getattr(s, "kind", "mesh") for s in again] == [
        "box", "cylinder", "sphere", "mesh", "mesh",
    ]  # fmt: skip
    assert again[1].object_from_shape == pytest.approx(pose) and again[1].sizes == (0.1, 0.3)
    kept = again[4]
    assert isinstance(kept, Solid) and trimesh.Trimesh(
        kept.vertices, kept.faces
    ).volume == pytest.approx(3), "as it is, not its hull"
    (door,) = (e for e in ET.parse(files["sdf"]).iter("link") if e.get("name") == "door")
    shapes = [e.find("geometry")[0] for e in door.iter("collision")]
    assert [s.tag for s in shapes] == [*kinds, "mesh"] and shapes[4].get("optimization") is None
    model = mujoco.MjModel.from_xml_path(str(files["mjcf"]))
    body = model.body("door").id
    felt = [g for g in range(model.ngeom) if model.geom_bodyid[g] == body and model.geom_group[g]]
    felt = [g for g in felt if model.geom_group[g] == 3]
    assert model.geom_type[felt].tolist() == [6, 5, 2, 3, 7]
    volume = trimesh.Trimesh(stairs.vertices).convex_hull.volume
    hull = next((tmp_path / "mjcf" / "meshes" / "collision").glob("door_*.obj"))
    assert trimesh.load(hull).volume == pytest.approx(volume)
    stage = Usd.Stage.Open(str(files["usd"]))
    types = [
        p.GetTypeName() for p in stage.Traverse()
        if p.HasAPI(UsdPhysics.CollisionAPI) and "door" in str(p.GetPath())
    ]  # fmt: skip
    assert types == ["Cube", "Cylinder", "Sphere", "Capsule", "Mesh"]
    ours = physics_of(obj, PhysicsSettings(declared_shapes=False))
    assert not ours.declared_shapes and whose_shapes(obj, ours) == ""


def test_usd_has_limits_drives_mass_textures_and_the_mimic(whole, physics):
    stage = Usd.Stage.Open(str(whole["usd"][0]))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
    joints = {p.GetName(): p for p in stage.Traverse() if p.IsA(UsdPhysics.Joint)}
    hinge = UsdPhysics.RevoluteJoint(joints["hinge"])
    assert hinge.GetUpperLimitAttr().Get() == pytest.approx(np.degrees(2.5))
    drive = UsdPhysics.DriveAPI(joints["hinge"], "angular")
    wanted = physics.dynamics["hinge"].damping * np.pi / 180
    assert drive.GetDampingAttr().Get() == pytest.approx(wanted)
    follow = joints["follow"]
    assert follow.GetAttribute("physxMimicJoint:rotX:gearing").Get() == pytest.approx(0.5)
    door = next(p for p in stage.Traverse() if p.GetName() == "door")
    mass = UsdPhysics.MassAPI(door).GetMassAttr().Get()
    assert mass == pytest.approx(physics.inertials["door"].mass, rel=1e-6)
    files = [p.GetAttribute("inputs:file").Get() for p in stage.Traverse()]
    pictures = {f.resolvedPath for f in files if f is not None}
    assert pictures and all(Path(p).is_file() for p in pictures)


def test_usd_materials_read_the_colours_of_vertices(tmp_path):
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], np.int32)
    rgba = np.array([[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [9, 9, 9, 128]])
    for alpha in (255, 128):
        rgba[3, 3] = alpha
        mesh = Mesh(corners, faces, vertex_colors=rgba.astype(np.uint8))
        coloured = ArticulatedObject("c", (Part("link_0", mesh),), KinematicTree(("link_0",)))
        folder = tmp_path / str(alpha)
        (path,) = write_object(coloured, load_exporter("usd"), folder)
        stage = Usd.Stage.Open(str(path))
        visual = next(p for p in stage.Traverse() if p.GetName() == "visual")
        shown = UsdGeom.Gprim(visual).GetDisplayColorAttr().Get()
        np.testing.assert_allclose(np.array(shown)[:3], np.eye(3), atol=1e-6)
        material, _ = UsdShade.MaterialBindingAPI(visual).ComputeBoundMaterial()
        surface = material.ComputeSurfaceSource()[0]
        assert surface.GetIdAttr().Get() == "UsdPreviewSurface"
        for name, primvar in (("diffuseColor", "displayColor"), ("opacity", "displayOpacity")):
            source = surface.GetInput(name).GetConnectedSource()
            if name == "opacity" and alpha == 255:
                assert source is None
                continue
            reader = UsdShade.Shader(source[0].GetPrim())
            assert reader.GetInput("varname").Get() == primvar
            assert UsdGeom.PrimvarsAPI(visual).HasPrimvar(primvar)


def test_a_free_base_falls_and_a_fixed_one_does_not(obj, tmp_path):
    for fixed in (True, False):
        physics = physics_of(obj, PhysicsSettings(collision=None, fixed_base=fixed))
        folder = tmp_path / str(fixed)
        path = write_object(obj, load_exporter("mjcf"), folder, physics=physics)[0]
        model = mujoco.MjModel.from_xml_path(str(path))
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, nstep=100)
        assert (data.body("base").xpos[2] > -0.01) == fixed


def test_a_ros_package_has_what_ros_asks_for(whole):
    folder = whole["ros"][0].parent
    package = ET.parse(folder / "package.xml").getroot()
    name = package.findtext("name")
    assert name == "my_object_description" and package.get("format") == "3"
    assert f"project({name})" in (folder / "CMakeLists.txt").read_text()
    compile((folder / "launch" / "display.launch.py").read_text(), "launch", "exec")
    files = re.findall(r'filename="([^"]+)"', (folder / "urdf" / "object.urdf").read_text())
    assert files
    for file in files:
        start, _, rest = file.removeprefix("package://").partition("/")
        assert file.startswith("package://") and start == name and (folder / rest).is_file()


def test_urdf_reads_back(exported, obj):
    path = exported["urdf"][0]
    back = read_urdf(path)
    assert {p.link for p in back.parts} == {p.link for p in obj.parts}
    for q in settings(obj):
        for link, pose in obj.pose(q).items():
            np.testing.assert_allclose(back.pose(q)[link], pose, atol=1e-9)
    assert mujoco_problems(path, obj, settings(obj)) == []


def test_mjcf_moves_the_same(exported, obj):
    assert mujoco_problems(exported["mjcf"][0], obj, settings(obj)) == []


def test_mjcf_shows_the_parts_where_they_are_with_their_textures(exported, obj):
    model = mujoco.MjModel.from_xml_path(str(exported["mjcf"][0]))
    data = mujoco.MjData(model)
    q = {"hinge": 0.8, "slide": 0.2}
    for name, value in obj.tree.joint_values(q).items():
        data.qpos[model.joint(name).qposadr[0]] = value
    mujoco.mj_kinematics(model, data)
    posed = obj.pose(q)
    corners: dict[str, list[np.ndarray]] = {}
    for i in range(model.ngeom):
        mesh = model.geom_dataid[i]
        start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        local = model.mesh_vert[start : start + count]
        here = local @ data.geom_xmat[i].reshape(3, 3).T + data.geom_xpos[i]
        corners.setdefault(model.body(model.geom_bodyid[i]).name, []).append(here)
    for part in obj.parts:
        if part.mesh is None:
            continue
        mine = trimesh.transform_points(part.mesh.vertices, posed[part.link])
        theirs = np.concatenate(corners[part.link])
        np.testing.assert_allclose(theirs.min(0), mine.min(0), atol=1e-5)
        np.testing.assert_allclose(theirs.max(0), mine.max(0), atol=1e-5)
    assert model.ntex == 1  # shared by the two parts
    textured = [i for i in range(model.nmat) if (model.mat_texid[i] >= 0).any()]
    assert len(textured) == 2
    assert model.neq == 1 and (model.mesh_texcoordadr[:3] >= 0).all()
    red = model.mat("link_4_0").rgba
    np.testing.assert_allclose(red, np.array([250, 10, 20, 255]) / 255, atol=1e-3)


def test_mjcf_joint_kinds_and_ranges(exported):
    root = ET.parse(exported["mjcf"][0]).getroot()
    joints = {j.get("name"): (j.get("type"), j.get("range")) for j in root.iter("joint")}
    assert joints["hinge"] == ("hinge", "-0.2 2.5")
    assert joints["turn <&>"] == ("hinge", None)
    assert joints["slide"] == ("slide", "0 0.3")


def glb_array(tree: dict, binary: bytes, index: int) -> np.ndarray:
    entry = tree["accessors"][index]
    view = tree["bufferViews"][entry["bufferView"]]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[entry["type"]]
    start = view["byteOffset"]
    flat = np.frombuffer(binary[start : start + view["byteLength"]], "<f4")
    return flat.reshape(entry["count"], width)


def glb_worlds(tree: dict, changed: dict[int, dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Node name → (4, 4) with some nodes' translation or rotation replaced."""
    out: dict[str, np.ndarray] = {}

    def walk(index: int, above: np.ndarray) -> None:
        node = {**tree["nodes"][index], **changed.get(index, {})}
        local = np.eye(4)
        local[:3, :3] = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).as_matrix()
        local[:3, 3] = node.get("translation", [0, 0, 0])
        world = above @ local
        if "name" in node:  # a mesh whose name a link has is found by that of its node's parent
            out[node["name"]] = world
        for child in node.get("children", []):
            walk(child, world)

    walk(tree["scenes"][0]["nodes"][0], np.eye(4))
    return out


def test_glb_animations_are_the_joints(exported, obj):
    tree, binary = read_glb(exported["glb"][0].read_bytes())
    names = [a["name"] for a in tree["animations"]]
    assert names == ["all joints", "hinge", "turn <&>", "slide"]
    up = np.eye(4)
    up[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    hinge = tree["animations"][1]
    assert len(hinge["channels"]) == 2  # its follower moves along
    times = glb_array(tree, binary, hinge["samplers"][0]["input"])[:, 0]
    assert times[0] == 0 and (np.diff(times) > 0).all()
    expected_q = {0: 0.0, 8: 2.5, 16: -0.2, 24: 0.0}
    for key, q in expected_q.items():
        changed: dict[int, dict[str, np.ndarray]] = {}
        for channel in hinge["channels"]:
            sampler = hinge["samplers"][channel["sampler"]]
            value = glb_array(tree, binary, sampler["output"])[key]
            changed[channel["target"]["node"]] = {channel["target"]["path"]: value}
        worlds = glb_worlds(tree, changed)
        for link, pose in object_from_links(obj, {"hinge": q}).items():
            np.testing.assert_allclose(worlds[link], up @ pose, atol=1e-6)


def test_glb_holds_a_shared_texture_once(exported):
    tree, _ = read_glb(exported["glb"][0].read_bytes())
    # Viewers keep a picture for each entry, whatever bytes it names; two parts have this one.
    assert len(tree["images"]) == len(tree["textures"]) == 1
    assert [m["name"] for m in tree["materials"]].count("pic") == 1


def test_metallic_and_roughness_are_in_every_format(exported):
    tree, _ = read_glb(exported["glb"][0].read_bytes())
    surfaces = {m["name"]: m["pbrMetallicRoughness"] for m in tree["materials"]}
    assert [surfaces["red"][f"{k}Factor"] for k in ("metallic", "roughness")] == [0.75, 0.25]
    model = mujoco.MjModel.from_xml_path(str(exported["mjcf"][0]))
    assert {0.75, -1.0} == set(model.mat_metallic) and 0.25 in model.mat_roughness
    parts = {p.link: p for p in MjcfFolder(exported["mjcf"][0].parent).load("object").object.parts}
    assert parts["link_base"].mesh.materials[0].metallic == 0.75
    for name in ("urdf", "sdf"):
        mtl = exported[name][0].parent / "meshes" / "base.mtl"
        assert "Pm 0.75\nPr 0.25\n" in mtl.read_text()
    stage = Usd.Stage.Open(str(exported["usd"][0]))
    at = f"{stage.GetDefaultPrim().GetPath()}/Looks/red/surface"
    look = UsdShade.Shader(stage.GetPrimAtPath(at))
    assert [look.GetInput(n).Get() for n in ("metallic", "roughness")] == [0.75, 0.25]


def test_glb_keyframes_never_turn_the_long_way(exported):
    tree, binary = read_glb(exported["glb"][0].read_bytes())
    for animation in tree["animations"]:
        for channel in animation["channels"]:
            if channel["target"]["path"] == "rotation":
                keys = glb_array(tree, binary, animation["samplers"][channel["sampler"]]["output"])
                steps = np.abs((keys[1:] * keys[:-1]).sum(1))
                assert steps.min() > np.cos(np.pi / 4)  # less than a quarter turn a step


def test_glb_opens_in_trimesh_with_everything_in_place(exported, obj):
    scene = trimesh.load_scene(exported["glb"][0])
    at_rest = np.stack([p.bounds for p in obj.parts if p.mesh is not None])
    low, high = at_rest[:, 0].min(0), at_rest[:, 1].max(0)
    expected = np.array([[low[0], low[2], -high[1]], [high[0], high[2], -low[1]]])
    # The follower's offset moves link_3 and link_4 at rest already in simulators, not in the file.
    np.testing.assert_allclose(scene.bounds, expected, atol=1e-5)
    materials = {
        getattr(g.visual.material, "name", None)
        for g in scene.geometry.values()
        if hasattr(g.visual, "material")
    }
    assert {"red", "pic"} <= materials


def test_glb_is_read_again_with_the_names_of_its_parts(obj, tmp_path):
    """A file of ours opened as one mesh without parts: its meshes were called after links."""
    # What people typed is no link's name, by which nodes that move are known.
    names = {"link_2": "drawer", "link_3": "helper"}
    parts = [replace(p, name=names.get(p.link, p.name)) for p in obj.parts]
    named = replace(obj, parts=tuple(parts))
    files = load_exporter("glb").export(named, tmp_path)
    assert read_back("glb", files[0], named, configurations=1).problems == ()
    again = open_asset(files[0])
    assert again.element_part is not None and again.part_names[0] == "base"
    declared = {"door", "drawer", "helper", "link_4"}  # two links are called so, too
    assert set(again.part_names[1:]) == declared


def test_a_bare_urdf_can_be_exported(exported, tmp_path, obj):
    files = export(exported["urdf"][0], "mjcf", tmp_path / "m")
    assert mujoco_problems(files[0], obj, settings(obj)) == []


@pytest.mark.parametrize("name", ["urdf", "ros"])
def test_every_urdf_that_is_written_can_be_exported_again(exported, tmp_path, obj, name):
    (urdf,) = [f for f in exported[name] if f.suffix == ".urdf"]
    files = export(urdf, "glb", tmp_path / "g")
    assert read_back("glb", files[0], obj, configurations=1).problems == ()


def test_what_reading_a_urdf_changed_is_told(tmp_path):
    path = tmp_path / "a.urdf"
    shape = '<visual><geometry><box size="1, 2, 3"/></geometry></visual>'
    path.write_text(f'<robot name="r"><link name="a">{shape}</link></robot>')
    assert load_object(path).parts
    (note,) = reading_notes(path, load_object(path))
    assert "separated by commas" in note


def test_a_mesh_is_no_asset(tmp_path):
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "chair.glb")
    with pytest.raises(InputFileError, match=r"is no URDF.*segment and predict"):
        export(tmp_path / "chair.glb", "urdf", tmp_path / "x")


def test_unknown_formats_name_the_known_ones(asset, tmp_path):
    with pytest.raises(ConfigurationError, match=r"'usdz'.*urdf, mjcf, glb"):
        export(asset, "usdz", tmp_path / "x")
    assert not (tmp_path / "x").exists()


def test_what_is_no_asset_is_refused(tmp_path):
    with pytest.raises(InputFileError, match=re.escape("object.urdf")):
        export(tmp_path, "urdf", tmp_path / "x")


@pytest.mark.parametrize("name", ["7167", "100234"])
@pytest.mark.parametrize("format", registry.EXPORTERS.built_in)
def test_real_objects_can_be_exported(shared_data, tmp_path, name, format):
    path = shared_data / "partnet_mobility" / name / "mobility.urdf"
    files = export(path, format, tmp_path / "out")
    obj = read_urdf(path)
    assert read_back(format, files[0], obj, configurations=2).problems == ()
    if format == "glb":
        assert len(trimesh.load_scene(files[0]).geometry) >= len(obj.parts)


def test_the_document_has_the_tables_of_formats():
    text = (Path(__file__).parents[3] / "docs/formats.md").read_text()
    for table in documented():
        assert "\n".join(table) in text, "\n".join(table)
