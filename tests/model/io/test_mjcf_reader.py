"""MJCF read into what a URDF is read into: exports of ours come back, and other people's open."""

import math
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial import KDTree

from model.core.asset import Asset
from model.core.errors import ConfigurationError, InputFileError
from model.core.shapes import Primitive
from model.io.assets.reader import load_object
from model.io.export.mjcf import MjcfExporter
from model.io.export.registry import write_object
from model.io.model_files import find_assets
from model.io.open_asset import open_asset
from model.physics.simulation_values import physics_of
from tests.model.demos import demo_object

BOX = '<geom type="box" size="0.1 0.2 0.3"/>'


def written(folder: Path, body: str, name: str = "robot.xml") -> Path:
    path = folder / name
    path.write_text(f'<mujoco model="robot"><compiler angle="radian"/>{body}</mujoco>')
    return path


def opened(folder: Path, body: str) -> Asset:
    return open_asset(written(folder, body))


def tree_of(asset: Asset):
    assert asset.tree is not None
    return asset.tree


def bounds(asset: Asset, part: int) -> np.ndarray:
    assert asset.mesh is not None and asset.element_part is not None
    corners = asset.mesh.triangles[asset.element_part == part].reshape(-1, 3)
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


@pytest.mark.parametrize("name", ["cabinet", "desk_lamp"])
def test_an_export_of_ours_opens_as_it_was(name: str, tmp_path: Path) -> None:
    obj = demo_object(name)
    physics = physics_of(obj)
    out = tmp_path / name
    files = write_object(obj, MjcfExporter(), out, physics=physics)
    assert find_assets([tmp_path]) == [out], "its meshes are no objects"
    for path in (files[0], out):
        asset = open_asset(path)
        assert asset.part_names == tuple(p.name or "" for p in obj.parts)
        assert asset.element_count == sum(len(p.mesh.faces) for p in obj.parts if p.mesh)
        assert not asset.warnings
        assert tree_of(asset).links == obj.tree.links
        for joint in obj.tree.joints:
            back = tree_of(asset).joint_of[joint.child]
            assert (back.name, back.type, back.parent) == (joint.name, joint.type, joint.parent)
            assert back.axis == pytest.approx(joint.axis, abs=1e-7)
            assert (back.lower, back.upper) == pytest.approx((joint.lower, joint.upper))
            off = np.subtract(back.origin, joint.origin)
            assert np.linalg.norm(np.cross(off, joint.axis)) < 1e-7
            own = physics.dynamics[joint.name]
            assert back.dynamics is not None
            assert back.dynamics.damping == pytest.approx(own.damping)
            assert back.dynamics.friction == pytest.approx(own.friction)
        for i, part in enumerate(obj.parts):
            assert bounds(asset, i) == pytest.approx(part.bounds, abs=1e-6)
        for link, inertial in physics.inertials.items():
            back = asset.inertials[link]
            assert back.mass == pytest.approx(inertial.mass)
            assert back.center == pytest.approx(inertial.center, abs=1e-6)
            assert back.tensor == pytest.approx(inertial.tensor, rel=1e-4, abs=1e-6)
        assert {k: len(s) for k, s in asset.shapes.items()} == {
            k: len(s) for k, s in physics.collision.items()
        }
    assert [p.name for p in load_object(files[0]).parts] == [p.name for p in obj.parts]


def test_meshes_lie_where_mujoco_has_them(tmp_path: Path) -> None:
    """Scaled, mirrored, moved within their asset, and by MuJoCo to their centre of mass."""
    box = trimesh.creation.box(extents=(0.3, 0.4, 0.5)).apply_translation((0.2, 0.3, 0.1))
    box.export(tmp_path / "a.stl")
    text = """<asset>
      <mesh name="m" file="a.stl" scale="2 3 -4" refpos="1 2 3" refquat="0.7 0.1 0.2 0.5"/>
      <mesh name="inline" vertex="0 0 0  1 0 0  0 1 0  0 0 2"/></asset><worldbody>
      <body name="b" pos="1 1 1" euler="0.3 0.2 0.1"><joint name="j" ref="0.2" range="0 1"/>
      <geom type="mesh" mesh="m" pos="0.1 0.2 0.3" euler="1 0 0"/>
      <geom type="mesh" mesh="inline" euler="0 1 0"/><geom type="capsule" size="0.1 0.4"/>
      <geom type="ellipsoid" size="0.1 0.2 0.3" pos="1 0 0"/></body></worldbody>"""
    path = written(tmp_path, text)
    asset = open_asset(path)
    assert asset.mesh is not None
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mine = KDTree(asset.mesh.vertices)
    for g in (0, 1):
        v = model.mesh_vertadr[g]
        local = model.mesh_vert[v : v + model.mesh_vertnum[g]]
        world = local @ data.geom_xmat[g].reshape(3, 3).T + data.geom_xpos[g]
        assert mine.query(world)[0].max() < 1e-5
    volume = trimesh.Trimesh(asset.mesh.vertices, asset.mesh.faces, process=False).volume
    assert volume > 0.3 * 0.4 * 0.5 * 24, "mirrored faces look outwards"
    joint = tree_of(asset).joints[0]
    assert (joint.lower, joint.upper) == pytest.approx((-0.2, 0.8)), "0 is how it stands"


def test_joints_masses_and_shapes_are_told(tmp_path: Path) -> None:
    text = """<worldbody><geom type="plane" size="9 9 1"/>
      <body name="case" pos="0 0 1"><inertial pos="0 0 0.1" mass="7" diaginertia="1 1 1"/>
        <geom type="box" size="0.5 0.5 0.5" contype="0" conaffinity="0" group="2"/>
        <geom type="cylinder" size="0.4 0.5" group="3"/>
        <body name="glued"><geom type="sphere" size="0.1" group="2" contype="0" conaffinity="0"/>
          <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>
        <body name="drawer" pos="0 -0.5 0"><joint name="pull" type="slide" axis="0 -2 0"
          range="0 0.4" damping="3" frictionloss="0.5" actuatorfrcrange="-8 8"/>
          <geom type="box" size="0.4 0.02 0.2" mass="2"/></body>
        <body name="dial"><joint name="turn" axis="0 0 1"/>
          <geom type="sphere" size="0.1"/></body>
        <body name="flap"><joint name="flap" axis="1 0 0" range="0 1"/>
          <geom type="sphere" size="0.1"/></body></body></worldbody>
      <equality><joint joint1="flap" joint2="pull" polycoef="0.1 2 0 0 0"/></equality>
      <actuator><motor joint="turn"/></actuator>"""
    asset = opened(tmp_path, text)
    tree = tree_of(asset)
    assert asset.part_names == ("case", "drawer", "dial", "flap")
    pull, turn, flap = (tree.joint_of[f"link_{i}"] for i in (1, 2, 3))
    assert (pull.type, pull.axis, pull.lower, pull.upper) == ("prismatic", (0, -1, 0), 0, 0.4)
    assert pull.dynamics is not None
    assert (pull.dynamics.damping, pull.dynamics.friction, pull.dynamics.effort) == (3, 0.5, 8)
    assert (turn.type, turn.dynamics) == ("continuous", None)
    assert flap.mimic is not None
    assert (flap.mimic.joint, flap.mimic.multiplier, flap.mimic.offset) == ("pull", 2, 0.1)
    masses = {link: i.mass for link, i in asset.inertials.items()}
    assert masses == pytest.approx({"link_0": 8, "link_1": 2}), "of the others nothing is said"
    (cylinder,) = asset.shapes["link_0"]
    assert isinstance(cylinder, Primitive) and cylinder.sizes == pytest.approx((0.4, 1.0))
    (own,) = asset.shapes["link_1"]
    assert isinstance(own, Primitive) and own.sizes == pytest.approx((0.8, 0.04, 0.4))
    assert bounds(asset, 0)[1, 2] == pytest.approx(1.5) and "plane" in asset.warnings[-1]
    assert asset.warnings[0] == "not kept: actuators"


def test_what_is_seen_goes_by_groups(tmp_path: Path) -> None:
    """What shares its group with geoms made for looking at is seen as well; what doesn't isn't."""
    text = """<worldbody><body name="a"><geom type="box" size="1 1 1"/>
      <geom type="box" size="0.1 0.1 0.1" pos="0 0 3" contype="0" conaffinity="0" group="1"/>
      <geom type="box" size="0.1 0.1 0.1" pos="0 0 4" group="1"/>
      <geom type="box" size="5 5 5" rgba="1 1 1 0"/></body></worldbody>"""
    asset = opened(tmp_path, text)
    assert asset.mesh is not None
    assert asset.mesh.vertices[:, 2].min() == pytest.approx(2.9) and len(asset.mesh.faces) == 24


def test_looks(tmp_path: Path) -> None:
    Image.new("RGB", (2, 2), (200, 100, 0)).save(tmp_path / "t.png")
    square = trimesh.creation.box((1, 1, 1))
    uv = np.asarray(square.vertices[:, :2]) + 0.5
    square.visual = trimesh.visual.TextureVisuals(uv=uv)
    square.export(tmp_path / "b.obj")
    text = f"""<asset><texture name="t" type="2d" file="t.png"/>
      <texture name="gone" type="2d" file="gone.png"/>
      <material name="wood" texture="t" metallic="0.5"/><material name="no" texture="gone"/>
      <mesh name="b" file="b.obj"/></asset><worldbody>
      <geom type="mesh" mesh="b" material="wood"/><geom size="0.1" material="wood"/>
      <geom size="0.1" material="no"/><geom size="0.1" rgba="0 0 1 1"/>
      {BOX}</worldbody>"""
    asset = opened(tmp_path, text)
    assert asset.mesh is not None
    pictured, mean, gone, blue, plain = asset.mesh.materials
    assert pictured.texture is not None and pictured.metallic == 0.5
    assert mean.base_color == (200, 100, 0, 255) and mean.texture is None, "it has no coordinates"
    assert gone.base_color == (255, 255, 255, 255) and blue.base_color == (0, 0, 255, 255)
    assert plain.base_color == (200, 200, 200, 255)
    assert any("gone.png" in w for w in asset.warnings)


def test_balls_free_bodies_and_endless_slides(tmp_path: Path) -> None:
    text = f"""<worldbody><body name="a"><freejoint name="f"/>{BOX}
      <body name="b"><joint name="s" type="ball"/>{BOX}</body>
      <body name="c"><joint name="l" type="slide" stiffness="3"/>{BOX}</body></body>
      <body name="z"><freejoint/>{BOX}</body></worldbody>"""
    asset = opened(tmp_path, text)
    tree = tree_of(asset)
    chain = [tree.joint_of["link_1"]]
    while chain[-1].parent != "link_0":
        chain.append(tree.joint_of[chain[-1].parent])
    assert [(j.name, j.upper) for j in chain] == [(f"s_{w}", math.pi) for w in "zyx"]
    said = " | ".join(asset.warnings)
    for words in ("'a' is free", "'z' is free", "'s' is a ball", "without limits", "a spring"):
        assert words in said
    alone = opened(tmp_path, f'<worldbody><body name="a"><freejoint/>{BOX}</body></worldbody>')
    assert not alone.warnings, "an object that stands free has nothing to be told of"


def test_includes_and_folders(tmp_path: Path) -> None:
    (tmp_path / "robot" / "meshes").mkdir(parents=True)
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "robot" / "meshes" / "b.stl")
    (tmp_path / "robot" / "body.xml").write_text(
        '<mujoco><compiler meshdir="meshes"/><asset><mesh file="b.stl"/></asset><worldbody>'
        '<body name="b"><joint/><geom type="mesh" mesh="b"/></body></worldbody></mujoco>'
    )
    scene = written(
        tmp_path / "robot", '<include file="body.xml"/><worldbody><light/></worldbody>', "s.xml"
    )
    asset = open_asset(tmp_path / "robot")
    assert asset.part_names == ("", "b") and asset.element_count == 12
    assert find_assets([tmp_path]) == [scene], "what it is made of is none"


HOSTILE = {
    "missing mesh": ('<asset><mesh name="m" file="no.stl"/></asset>', r"no\.stl: the mesh 'm'"),
    "mesh outside": ('<asset><mesh name="m" file="../no.stl"/></asset>', "leads outside"),
    "folder outside": (
        '<compiler meshdir="../.."/><asset><mesh name="m" file="x.stl"/></asset>',
        "leads outside",
    ),
    "texture outside": ('<asset><texture name="t" file="/etc/hosts"/></asset>', "absolute"),
    "include outside": ('<include file="../other.xml"/>', "leads outside"),
    "include missing": ('<include file="other.xml"/>', r"other\.xml: is included by robot\.xml"),
    "include of itself": ('<include file="robot.xml"/>', "more than 100 files"),
    "other models": ('<worldbody><attach model="a" body="b" prefix="c"/></worldbody>', "attaches"),
    "not a number": (f'<worldbody><body pos="nan 0 0">{BOX}</body></worldbody>', "pos='nan 0 0'"),
    "infinite": ('<worldbody><geom size="inf"/></worldbody>', "size='inf'"),
    "far": (f'<worldbody><body name="q" pos="1e9 0 0">{BOX}</body></worldbody>', "body 'q'"),
    "too many": (
        f'<worldbody><replicate count="99999999" offset="1 0 0">{BOX}</replicate></worldbody>',
        "99,999,999 geoms",
    ),
    "too deep": (f"<worldbody>{'<body>' * 999}{BOX}{'</body>' * 999}</worldbody>", "nests more"),
    "no size": ('<worldbody><geom size="0"/></worldbody>', "MuJoCo can't load it"),
    "unknown word": (f'<worldbody><body foo="1">{BOX}</body></worldbody>', "'foo'"),
    "nothing seen": ('<worldbody><geom type="plane" size="1 1 1"/></worldbody>', "can be seen"),
    "limits of none": (
        f'<worldbody><body><joint name="a"/>{BOX}</body></worldbody><equality>'
        '<joint joint1="a" joint2="b" polycoef="x"/></equality>',
        "polycoef",
    ),
}


@pytest.mark.parametrize(("body", "words"), HOSTILE.values(), ids=HOSTILE.keys())
def test_bad_files_are_refused_by_name(tmp_path: Path, body: str, words: str) -> None:
    (tmp_path / "other.xml").write_text("<mujoco/>")
    (tmp_path / "in").mkdir()
    with pytest.raises(InputFileError, match=words) as caught:
        opened(tmp_path / "in", body)
    assert str(tmp_path / "in") in str(caught.value)


def test_large_files_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "b.stl")
    shown = '<worldbody><geom type="mesh" mesh="b"/></worldbody>'
    path = written(tmp_path, f'<asset><mesh file="b.stl"/></asset>{shown}')
    with pytest.raises(InputFileError, match=r"b\.stl"):
        open_asset(path, max_bytes=100)
    monkeypatch.setattr("model.io.robot_xml.MAX_BYTES", 10)
    with pytest.raises(InputFileError, match=r"robot\.xml: is larger"):
        open_asset(path)


def test_other_xml_and_doctypes_are_none(tmp_path: Path) -> None:
    path = tmp_path / "a.xml"
    path.write_text("<scene/>")
    with pytest.raises(InputFileError, match="begins with <scene>"):
        open_asset(path)
    with pytest.raises(InputFileError, match="nothing in it can be opened"):
        find_assets([tmp_path])
    path.write_text('<!DOCTYPE m [<!ENTITY a "b">]><mujoco>&a;</mujoco>')
    with pytest.raises(InputFileError, match="DTD"):
        open_asset(path)


def test_without_mujoco_the_line_that_installs_it_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ConfigurationError, match=r"install 'artiworld\[physics\]'"):
        opened(tmp_path, f"<worldbody>{BOX}</worldbody>")
