"""Articulated objects of other people, opened with their parts, names and joints."""

import json
import math
import operator
from pathlib import Path

import numpy as np
import pytest
import trimesh

from model.core.articulated_object import ArticulatedObject, Part
from model.core.asset import Asset
from model.core.errors import InputFileError
from model.core.geometry import Mesh
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.io.asset_cache import load_asset, save_asset
from model.io.assets.asset_folder import write_asset
from model.io.export.registry import load_exporter
from model.io.model_files import find_assets
from model.io.open_asset import open_asset
from model.io.urdf.reader import MOST_LINKS
from model.physics.simulation_values import plain_physics

LIMIT = '<limit lower="0" upper="1.5"/>'


def mesh_of(file: str) -> str:
    return f'<visual><geometry><mesh filename="{file}"/></geometry></visual>'


BOX = '<visual><geometry><box size="1 1 1"/></geometry></visual>'


def link(name: str, inner: str = BOX) -> str:
    return f'<link name="{name}">{inner}</link>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", inner: str = LIMIT) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="1 0 0"/><axis xyz="0 0 1"/>'
        f'<parent link="{parent}"/><child link="{child}"/>{inner}</joint>'
    )


def linked(**links: str) -> str:
    """Several links, each with what is in it."""
    return "".join(link(name, inner) for name, inner in links.items())


def bolt(parent: str, child: str) -> str:
    return joint("bolt", parent, child, "fixed", "")


def robot(folder: Path, *body: str, name: str = "robot") -> Path:
    path = folder / f"{name}.urdf"
    path.write_text(f'<robot name="r">{"".join(body)}</robot>')
    return path


def numbers(asset: Asset) -> list[int]:
    assert asset.element_part is not None
    return list(dict.fromkeys(asset.element_part.tolist()))


def weighing(kilograms: float, moments: str = 'ixx="1" iyy="1" izz="1"', at: str = "0 0 0") -> str:
    return (
        f'<inertial><origin xyz="{at}"/><mass value="{kilograms}"/><inertia {moments}/></inertial>'
    )


def test_what_is_fixed_together_weighs_together_in_the_frame_that_is_asked_for(
    tmp_path: Path,
) -> None:
    links = linked(base=BOX, arm=BOX + weighing(3, at="0 2 0"), tool=weighing(1))
    path = robot(tmp_path, links, joint("turn", "base", "arm"), bolt("arm", "tool"))
    got = open_asset(path, up_axis="y", unit_scale=0.5)
    assert set(got.inertials) == {"link_1"}, "of the base nothing is told"
    found = got.inertials["link_1"]
    # At (1, 2, 0) and (2, 0, 0) of the file; y is up there.
    assert found.mass == 4 and found.center == pytest.approx([0.625, 0.0, 0.75])
    # Before: 5, 2.75 and 5.75 kg m² about x, y and z.
    assert np.diag(found.tensor) == pytest.approx([1.25, 1.4375, 0.6875])
    assert load_asset_again(got, tmp_path).inertials["link_1"].mass == 4


def test_the_mass_of_a_handle_alone_is_not_its_doors(tmp_path: Path) -> None:
    links = linked(base=BOX, door=BOX, handle=BOX + weighing(10))
    path = robot(tmp_path, links, joint("turn", "base", "door"), bolt("door", "handle"))
    assert not open_asset(path).inertials


def load_asset_again(asset: Asset, folder: Path) -> Asset:
    save_asset(asset, folder / "copy")
    return load_asset(folder / "copy")


@pytest.mark.parametrize(
    "wrong",
    [
        weighing(-1),
        weighing(1, 'ixx="1" iyy="1" izz="3"'),
        weighing(1, 'ixx="a" iyy="1" izz="1"'),
        weighing(1, at="0 0"),
        '<inertial><mass value="1"/></inertial>',
    ],
)
def test_a_mass_that_no_body_has_is_left_out_and_told(tmp_path: Path, wrong: str) -> None:
    path = robot(tmp_path, link("base"), link("arm", BOX + wrong), joint("turn", "base", "arm"))
    got = open_asset(path)
    assert not got.inertials and got.tree is not None
    assert any("link 'arm'" in w and "left out" in w for w in got.warnings)


def test_rounded_moments_and_frames_without_mass_are_no_mistake(tmp_path: Path) -> None:
    arm = BOX + weighing(1, 'ixx="0.1" iyy="0.1" izz="0.201"')
    links = linked(base=BOX, arm=arm, tip=weighing(0))
    path = robot(tmp_path, links, joint("turn", "base", "arm"), bolt("arm", "tip"))
    got = open_asset(path)
    assert got.inertials["link_1"].tensor[2, 2] == pytest.approx(0.2) and not got.warnings


def test_effort_and_velocity_of_zero_tell_nothing(tmp_path: Path) -> None:
    limit = '<limit lower="0" upper="1" effort="0" velocity="0"/>'
    path = robot(tmp_path, link("base"), link("arm"), joint("turn", "base", "arm", inner=limit))
    tree = open_asset(path).tree
    assert tree is not None and tree.joints[0].dynamics is None


def test_links_are_parts_and_joints_the_tree(tmp_path: Path) -> None:
    links = linked(handle=BOX, cabinet=BOX, door=BOX, tcp="") + bolt("door", "handle")
    path = robot(tmp_path, links, joint("hinge", "cabinet", "door"), joint("tip", "door", "tcp"))
    asset = open_asset(path)
    assert (asset.name, asset.part_names) == ("robot", ("cabinet", "door"))
    assert numbers(asset) == [1, 0]  # elements come as in the file, the handle with its door
    assert asset.tree is not None and asset.tree.links == ("link_0", "link_1")
    (found,) = asset.tree.joints
    assert (found.name, found.parent, found.child) == ("hinge", "link_0", "link_1")
    assert found.origin == (1.0, 0.0, 0.0) and found.upper == 1.5
    assert asset.warnings == ("joints that carry nothing were left out: tip",)
    save_asset(asset, tmp_path / "kept")
    assert load_asset(tmp_path / "kept").tree == asset.tree


def test_joints_turn_and_grow_with_the_source(tmp_path: Path) -> None:
    follows = '<limit lower="0" upper="1"/><mimic joint="slide" multiplier="2" offset="1"/>'
    joints = joint("slide", "a", "b", "prismatic") + joint("turn", "a", "c", inner=follows)
    path = robot(tmp_path, linked(a=BOX, b=BOX, c=BOX), joints)
    asset = open_asset(path, up_axis="y", unit_scale=0.01)
    assert asset.tree is not None
    slide, turn = asset.tree.joints
    np.testing.assert_allclose(slide.axis, (0, -1, 0), atol=1e-12)
    np.testing.assert_allclose(slide.origin, (0.01, 0, 0), atol=1e-12)
    assert slide.upper == pytest.approx(0.015) and turn.upper == 1.0
    assert turn.mimic is not None
    assert (turn.mimic.multiplier, turn.mimic.offset) == (pytest.approx(200), 1.0)
    assert np.ptp(asset.bounds, axis=0).max() < 0.03


def test_an_empty_root_keeps_its_joints_and_no_part_is_the_base(tmp_path: Path) -> None:
    asset = open_asset(robot(tmp_path, linked(world="", door=BOX), joint("j", "world", "door")))
    assert asset.tree is not None and asset.tree.root == "world"
    assert (numbers(asset), asset.part_names) == ([1], ("", "door"))


def test_where_nothing_moves_links_are_parts_without_joints(tmp_path: Path) -> None:
    asset = open_asset(robot(tmp_path, link("a"), link("b"), joint("j", "a", "b", "fixed", "")))
    assert (numbers(asset), asset.part_names, asset.tree) == ([0, 1], ("a", "b"), None)
    single = open_asset(robot(tmp_path, link("a"), name="single"))
    assert (single.element_part, single.part_names, single.tree) == (None, (), None)


def test_links_called_alike_stay_apart(tmp_path: Path) -> None:
    joints = joint("1", "x", "door") + joint("2", "x", "link_door")
    asset = open_asset(robot(tmp_path, link("x"), link("door"), link("link_door"), joints))
    assert (numbers(asset), asset.part_names) == ([0, 1, 2], ("x", "door", "door"))


def box_part(name: str, at: float, what: str | None) -> Part:
    box = trimesh.creation.box((0.2, 0.2, 0.2))
    return Part(name, Mesh(np.asarray(box.vertices) + (at, 0, 0), np.asarray(box.faces)), name=what)


@pytest.fixture
def cabinet() -> ArticulatedObject:
    body, door = box_part("link_0", 0, "body"), box_part("link_3", 0.21, "door")
    parts = (body, door, box_part("link_2", 0.42, None))
    hinge = Joint("a", "revolute", "link_0", "link_3", (0, 0, 1), (0.1, 0, 0), lower=0, upper=1.2)
    slide = Joint("b", "prismatic", "link_0", "link_2", (1, 0, 0), lower=0, upper=0.1)
    tree = KinematicTree(("link_0", "link_2", "link_3"), (hinge, slide))
    return ArticulatedObject("cabinet", parts, tree, "StorageFurniture")


def check_cabinet(asset: Asset, cabinet: ArticulatedObject, *, category: str | None) -> None:
    assert asset.part_names[0] == "body" and asset.part_names[2:] == ("", "door")
    assert asset.category == category and asset.tree is not None
    assert numbers(asset) == [0, 3, 2]
    for declared in cabinet.tree.joints:
        got = asset.tree.joint_of[declared.child]
        fields = operator.attrgetter("type", "parent", "lower", "upper")
        assert fields(got) == fields(declared)
        np.testing.assert_allclose(got.axis, declared.axis, atol=1e-9)


def test_a_saved_asset_opens_as_it_was_saved(tmp_path: Path, cabinet: ArticulatedObject) -> None:
    folder = tmp_path / "cabinet-1"
    write_asset(cabinet, folder, provenance={})
    assert find_assets([tmp_path]) == [folder]
    check_cabinet(open_asset(folder), cabinet, category="StorageFurniture")
    assert open_asset(folder).name == "cabinet-1"


def test_an_export_opens_with_the_names_of_its_visuals(
    tmp_path: Path, cabinet: ArticulatedObject
) -> None:
    load_exporter("urdf").export(cabinet, tmp_path, physics=plain_physics(cabinet))
    about = {"format": "urdf", "category": "StorageFurniture"}
    (tmp_path / "artiworld.json").write_text(json.dumps(about))
    check_cabinet(open_asset(tmp_path), cabinet, category="StorageFurniture")


def test_names_and_category_of_an_object_json_count(tmp_path: Path) -> None:
    path = robot(tmp_path, link("link_0"), link("link_1"), joint("j", "link_0", "link_1"))
    said = {"category": "Box", "names": {"link_1": "lid"}}
    (tmp_path / "object.json").write_text(json.dumps(said))
    asset = open_asset(path)
    assert (asset.part_names, asset.category) == (("", "lid"), "Box")


def test_meshes_of_a_urdf_are_no_objects_of_their_own(tmp_path: Path) -> None:
    package = tmp_path / "robot"
    for name in ("urdf", "meshes", "scans"):
        (package / name).mkdir(parents=True)
    (package / "package.xml").write_text("<package/>")
    for place in ("meshes/link_0.ply", "meshes/link_1.ply", "scans/chair.ply"):
        trimesh.creation.box().export(package / place)
    named = mesh_of("package://robot/meshes/link_0.ply")
    links = linked(a=named, b=mesh_of("../meshes/link_1.ply"))
    path = robot(package / "urdf", links, joint("j", "a", "b"))
    assert find_assets([tmp_path]) == [package, package / "scans" / "chair.ply"]
    for source in (package, package / "urdf", path):
        asset = open_asset(source)
        assert asset.tree is not None and asset.name == source.stem
    other = robot(package / "urdf", link("a"), name="other")
    assert set(find_assets([package / "urdf"])) == {path, other}
    assert len(find_assets([tmp_path])) == 3


OUTSIDE = "leads outside"
AB = linked(a=BOX, b=BOX)
BAD = {
    "missing mesh": (link("a", mesh_of("no.obj")), "no.obj: the mesh of link 'a' isn't there"),
    "cycle": (AB + link("r") + joint("1", "a", "b") + joint("2", "b", "a"), "cycle: .* hangs on"),
    "two roots": (AB, "2 roots .* by fixed joints"),
    "no links": ("", "at least one link.*xacro"),
    "traversal": (link("a", mesh_of("../../etc/passwd")), OUTSIDE),
    "package traversal": (link("a", mesh_of("package://../../etc/passwd")), OUTSIDE),
    "absolute": (link("a", mesh_of("/etc/passwd")), "absolute path"),
    "address": (link("a", mesh_of("http://example.org/a.obj")), "is an address"),
    "no limits": (AB + joint("j", "a", "b", inner=""), "needs <limit"),
    "nan": (AB + joint("j", "a", "b", inner='<limit upper="nan"/>'), "finite"),
    "too many parts": (
        link("l0") + "".join(link(f"l{i}") + joint(f"j{i}", "l0", f"l{i}") for i in range(1, 1001)),
        "parts",
    ),
    "too many links": ("<link name='a'/>" * (MOST_LINKS + 1), "at most"),
    "nothing seen": ("<link name='a'/>", "no link has a visual"),
}


@pytest.mark.parametrize(("body", "words"), BAD.values(), ids=BAD.keys())
def test_errors_name_the_file_and_what_would_be_right(
    tmp_path: Path, body: str, words: str
) -> None:
    with pytest.raises(InputFileError, match=words) as caught:
        open_asset(robot(tmp_path, body))
    assert str(caught.value).startswith(str(tmp_path))


def test_entities_are_refused(tmp_path: Path) -> None:
    bomb = '<!DOCTYPE r [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]><robot name="r">&b;</robot>'
    (tmp_path / "robot.urdf").write_text(bomb)
    with pytest.raises(InputFileError, match="entities"):
        open_asset(tmp_path / "robot.urdf")


def test_a_real_cabinet_opens_with_its_joints(shared_data: Path) -> None:
    asset = open_asset(shared_data / "partnet_mobility" / "41083")
    assert asset.tree is not None and asset.category == "StorageFurniture"
    assert asset.part_names == ("furniture_body", *["rotation_door"] * 2, *["drawer"] * 2)
    door = asset.tree.joint_of["link_1"]
    assert (door.type, door.upper) == ("revolute", pytest.approx(math.pi / 2))
