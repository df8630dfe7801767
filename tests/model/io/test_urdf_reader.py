"""What other people's URDF files hold, good and bad."""

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yourdfpy

from model.core.composite_joints import Composite, composite_of
from model.core.errors import InputFileError
from model.core.geometry import rotation_from_rpy
from model.io.urdf.writer import read_urdf, read_urdf_model


def robot(body: str) -> str:
    return f'<?xml version="1.0"?><robot name="r">{body}</robot>'


def joint(name: str, parent: str, child: str, type_: str = "fixed", inner: str = "") -> str:
    return (
        f'<joint name="{name}" type="{type_}"><parent link="{parent}"/>'
        f'<child link="{child}"/>{inner}</joint>'
    )


def links(*names: str, geometry: str = '<sphere radius="1"/>') -> str:
    visual = f"<visual><geometry>{geometry}</geometry></visual>"
    return "".join(f'<link name="{n}">{visual}</link>' for n in names)


@pytest.fixture
def write(tmp_path):
    def write_(text: str):
        path = tmp_path / "robot.urdf"
        path.write_text(text, encoding="utf-8")
        return path

    return write_


def problem(path) -> str:
    with pytest.raises(InputFileError) as caught:
        read_urdf(path)
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_origins_and_rotations_are_composed(write):
    first = joint("a", "base", "link_0", inner='<origin xyz="1 2 3" rpy="0.3 -0.2 1.1"/>')
    inner = '<origin xyz="0.5 0 -1" rpy="1 2 3"/><axis xyz="0 0 1"/>'
    inner += '<limit lower="-1" upper="2" effort="1" velocity="1"/>'
    second = joint("b", "link_0", "link_1", "revolute", inner)
    path = write(robot(links("base", "link_0", "link_1") + first + second))
    tree = read_urdf_model(path).tree
    reference = yourdfpy.URDF.load(str(path), load_meshes=False)
    rest = reference.get_transform("link_1", "base")
    opened = tree.by_name["b"]
    np.testing.assert_allclose(opened.origin, rest[:3, 3], atol=1e-12)
    np.testing.assert_allclose(opened.axis, rest[:3, 2], atol=1e-12)
    reference.update_cfg({"b": 0.7})
    posed = reference.get_transform("link_1", "base")
    np.testing.assert_allclose(tree.pose({"b": 0.7})["link_1"] @ rest, posed, atol=1e-9)


def test_rpy_turns_about_fixed_axes():
    quarter = math.pi / 2
    turned = rotation_from_rpy([quarter, 0, quarter]) @ [0, 1, 0]
    np.testing.assert_allclose(turned, [0, 0, 1], atol=1e-12)


def test_long_axes_are_normalised_and_noted(write):
    slide = joint("s", "a", "b", "prismatic", '<axis xyz="0 2 0"/><limit lower="0" upper="1"/>')
    path = write(robot(links("a", "b") + slide))
    model = read_urdf_model(path)
    slide = model.tree.by_name["s"]
    assert slide.axis == (0, 1, 0) and slide.upper == 1
    assert any("normalised" in n and "'s'" in n for n in model.notes)


def test_what_is_not_supported_is_noted(write):
    body = links("a", "b", "c", "d", "e", "h") + joint("p", "a", "b", "planar")
    body += joint("f", "a", "c", "floating")
    ranges = (("i", "d", "-inf", "inf"), ("w", "e", 1, -2), ("e", "h", -1e300, 1e300))
    for name, child, low, high in ranges:
        body += joint(name, "a", child, "revolute", f'<limit lower="{low}" upper="{high}"/>')
    model = read_urdf_model(write(robot(body)))
    types = {j.name: j.type for j in model.tree.joints}
    kinds = {"p": "continuous", "f": "fixed", "i": "continuous", "w": "revolute", "e": "continuous"}
    assert types == dict.fromkeys(("joint_helper_b", "joint_helper_b_2"), "prismatic") | kinds
    swapped = model.tree.by_name["w"]
    assert (swapped.lower, swapped.upper) == (-2, 1)
    assert sorted(n.split("'")[1] for n in model.notes) == ["e", "f", "i", "p", "w"]
    assert composite_of(model.tree, "b", "abcdeh".__contains__) == Composite("planar")


def test_helpers_are_renamed_so_that_they_never_look_like_parts(write):
    empty = '<link name="base"/><link name="link_0_helper"/>'
    chain = joint("a", "base", "link_0_helper") + joint("b", "link_0_helper", "link_0")
    path = write(robot(links("link_0") + empty + chain))
    obj = read_urdf(path)
    assert obj.tree.links == ("link_0", "base", "helper_0")
    assert [p.link for p in obj.parts] == ["link_0"]


def test_primitives_keep_their_size_and_colour(write):
    path = write(
        robot(
            '<link name="link_0"><visual><origin xyz="1 0 0"/>'
            '<geometry><box size="2 4 6"/></geometry>'
            '<material name="m"><color rgba="1 0 0 1"/></material></visual>'
            '<visual><geometry><cylinder radius="0.1" length="9"/></geometry></visual></link>'
        )
    )
    part = read_urdf(path).parts[0]
    assert part.mesh is not None
    np.testing.assert_allclose(part.bounds, [[-0.1, -2, -4.5], [2, 2, 4.5]], atol=1e-9)
    assert part.mesh.materials[0].base_color == (255, 0, 0, 255)


def test_collision_geometry_only_where_nothing_is_visible(write):
    path = write(robot(links("link_0").replace("visual", "collision")))
    model = read_urdf_model(path)
    assert [v.link for v in model.visuals] == ["link_0"] and "collision" in model.notes[0]


def pair(kind: str = "fixed", inner: str = "") -> str:
    """Two links and a joint between them."""
    return robot(links("a", "b") + joint("j", "a", "b", kind, inner))


AB, CD = joint("j", "a", "b"), joint("k", "c", "d")
LOOP = joint("j", "b", "c") + joint("k", "c", "b")
BOMB = '<!DOCTYPE r [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]><robot name="&b;"/>'
ORPHAN = '<joint name="j" type="fixed"><child link="a"/></joint>'
TWICE = "joint 'j' is there twice|'nowhere' doesn't exist|two parents|2 roots"
BAD = {
    "number with a comma": (
        pair(inner='<origin xyz="0.01, 0 0"/>'),
        "joint 'j'|'0.01,'|<origin>|xyz",
    ),
    "two numbers for three": (pair(inner='<origin xyz="0 0"/>'), "joint 'j'|3 finite numbers"),
    "not a number": (pair(inner='<origin xyz="nan 0 0"/>'), "joint 'j'|finite"),
    "all problems of a tree at once": (
        robot(links("a", "b", "c", "d") + AB + CD + joint("j", "nowhere", "b")),
        TWICE,
    ),
    "a cycle": (robot(links("a", "b", "c") + LOOP), "cycle: |b → c"),
    "everything is a child": (robot(links("a", "b") + AB + joint("k", "b", "a")), "no root"),
    "a joint onto itself": (robot(links("a") + joint("j", "a", "a")), "parent and child"),
    "no parent": (robot(links("a") + ORPHAN), "joint 'j'|<parent"),
    "no limits": (pair("prismatic"), "joint 'j'|prismatic|<limit"),
    "unknown type": (pair("hinge"), "joint 'j'|'hinge'|revolute"),
    "zero axis": (pair("continuous", '<axis xyz="0 0 0"/>'), "joint 'j'|axis"),
    "mimic of nobody": (pair("continuous", '<mimic joint="z"/>'), "'j' mimics 'z'"),
    "no link": (robot(""), "at least one link"),
    "other XML": ("<sdf/>", "<sdf>|<robot>"),
    "not XML": ("solid cube", "well-formed"),
    "cut off": ('<robot name="r"><link name="a">', "well-formed"),
    "empty": ("", "well-formed"),
    "unknown geometry": (robot(links("a", geometry="<torus/>")), "link 'a'|<torus>"),
    "no geometry": (robot('<link name="a"><visual/></link>'), "link 'a'|no geometry"),
    "huge size": (robot(links("a", geometry='<box size="1 1e300 1"/>')), "link 'a'|1e+06 m"),
    "huge scale": (
        robot(links("a", geometry='<mesh filename="a.obj" scale="1 1 1e300"/>')),
        "link 'a'|scale",
    ),
    "huge offset": (pair(inner='<origin xyz="1e300 0 0"/>'), "joint 'j'|away"),
    "huge limit": (pair("prismatic", '<limit upper="1e300"/>'), "joint 'j'|limit|1e+06 m"),
    "negative size": (robot(links("a", geometry='<sphere radius="-1"/>')), "link 'a'|above 0"),
    "entities": (
        '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot name="&x;"/>',
        "entities",
    ),
    "billion laughs": (BOMB, "entities"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_files_are_named_with_what_is_wrong(write, case):
    text, words = BAD[case]
    message = problem(write(text))
    for word in words.split("|"):
        assert word in message, message
    assert "\n" not in message


@pytest.mark.parametrize(
    "filename",
    [
        "../secret.obj",
        "meshes/../../secret.obj",
        "..\\secret.obj",
        "/etc/passwd",
        "file:///etc/passwd",
        "C:\\secret.obj",
        "http://example.org/a.obj",
        "package://r/../../secret.obj",
        "",
    ],
)
def test_meshes_cannot_leave_the_folder(tmp_path, filename):
    (tmp_path / "secret.obj").write_text("v 0 0 0\n")
    folder = tmp_path / "robot"
    folder.mkdir()
    path = folder / "robot.urdf"
    path.write_text(robot(links("a", geometry=f'<mesh filename="{filename}"/>')))
    assert "link 'a'" in problem(path)


def test_a_symbolic_link_cannot_leave_the_folder(tmp_path):
    (tmp_path / "secret.obj").write_text("v 0 0 0\n")
    folder = tmp_path / "robot"
    folder.mkdir()
    (folder / "inside.obj").symlink_to(tmp_path / "secret.obj")
    path = folder / "robot.urdf"
    path.write_text(robot(links("a", geometry='<mesh filename="inside.obj"/>')))
    assert "outside" in problem(path)


def test_data_sets_of_symbolic_links_open(tmp_path):
    """Each file, or its folder, is a link to where it lies."""
    there = tmp_path / "there"
    (there / "meshes").mkdir(parents=True)
    (there / "meshes" / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (there / "robot.urdf").write_text(robot(links("a", geometry='<mesh filename="meshes/a.obj"/>')))
    (tmp_path / "by folder").symlink_to(there)
    (tmp_path / "by file" / "meshes").mkdir(parents=True)
    for name in ("robot.urdf", "meshes/a.obj"):
        (tmp_path / "by file" / name).symlink_to(there / name)
    for folder in ("by folder", "by file"):
        path = tmp_path / folder / "robot.urdf"
        for root in (None, tmp_path / folder, tmp_path / "by file"):
            (visual,) = read_urdf_model(path, root=root).by_link["a"]
            assert visual.file is not None and visual.file.is_file(), (folder, root)


def test_a_missing_mesh_is_named(write):
    message_of = write(robot(links("link_7", geometry='<mesh filename="gone.obj"/>')))
    with pytest.raises(InputFileError, match=r"gone\.obj.*link_7"):
        read_urdf(message_of)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputFileError, match=r"gone\.urdf"):
        read_urdf(tmp_path / "gone.urdf")


def test_real_files_whose_numbers_are_separated_by_commas(shared_data):
    files = sorted((shared_data / "articulated_free" / "habitat").glob("*/*.urdf"))
    assert files
    for path in files:
        model = read_urdf_model(path)
        assert "separated by commas" in model.notes[0], path
        assert all(v.file is not None and v.file.is_file() for v in model.visuals)
    fridge = shared_data / "articulated_free" / "habitat" / "fridge" / "fridge.urdf"
    (door,) = read_urdf_model(fridge).by_link["bottom_door"]
    base = read_urdf_model(fridge).tree.joint_of["bottom_door"].origin
    offset = np.linalg.norm(door.object_from_geometry[:3, 3] - base)
    assert offset == pytest.approx(math.hypot(0.01, 0.33))


@pytest.mark.parametrize(
    "name", ["/data/robots/meshes/x.stl", "../meshes/x.stl", "package://other/a/meshes/x.stl"]
)
def test_meshes_that_are_found_only_by_the_end_of_their_path_are_noted_once(write, name):
    path = write(
        robot(links("a", "b", geometry=f'<mesh filename="{name}"/>') + joint("j", "a", "b"))
    )
    mesh = path.parent / "meshes" / "x.stl"
    mesh.parent.mkdir()
    trimesh.creation.box((1, 2, 3)).export(mesh)
    model = read_urdf_model(path)
    assert [v.file for v in model.visuals] == [mesh, mesh]
    (note,) = model.notes
    assert repr(name) in note and str(mesh) in note
    plain = write(path.read_text().replace(name, "meshes/x.stl"))
    assert read_urdf_model(plain).notes == ()


@pytest.mark.parametrize("text", ["1,2,3", "1, 2, 3", "1 , 2 ,3"])
def test_commas_between_numbers_are_read_and_noted(write, text):
    path = write(robot(links("a", geometry=f'<box size="{text}"/>')))
    model = read_urdf_model(path)
    assert model.visuals[0].primitive == ("box", (1.0, 2.0, 3.0))
    (note,) = model.notes
    assert "separated by commas" in note and repr(text) in note
    with pytest.raises(InputFileError, match="not a number"):
        read_urdf_model(path, lenient=True)


@pytest.mark.parametrize("text", ["1, 2 3", "1,0 2,0 3,0", "1,, 2, 3", "1, 2, 3,", "1,5 2 3"])
def test_commas_that_may_mean_something_else_are_a_mistake(write, text):
    assert "is not a number" in problem(write(robot(links("a", geometry=f'<box size="{text}"/>'))))


def ros_package(folder: Path, filename: str) -> Path:
    """A URDF in ``urdf/`` whose mesh lies in ``meshes/`` beside, as ROS packages have it."""
    for name in ("urdf", "meshes"):
        (folder / name).mkdir(parents=True)
    trimesh.creation.box((1, 1, 1)).export(folder / "meshes" / "x.stl")
    path = folder / "urdf" / "r.urdf"
    path.write_text(robot(links("a", geometry=f'<mesh filename="{filename}"/>')))
    return path


@pytest.mark.parametrize(
    "filename",
    ["package://pkg/meshes/x.stl", "../meshes/x.stl", "package://any_name/meshes/x.stl"],
)
def test_a_package_is_the_root_of_its_urdf(tmp_path, filename):
    path = ros_package(tmp_path / "pkg", filename)
    with pytest.raises(InputFileError):  # without a package.xml nothing above the URDF is read
        read_urdf(path)
    (tmp_path / "pkg" / "package.xml").write_text("<package/>")
    assert len(read_urdf(path).parts) == 1


def test_meshes_cannot_leave_the_package(tmp_path):
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "secret.stl")
    path = ros_package(tmp_path / "pkg", "../../secret.stl")
    (tmp_path / "pkg" / "package.xml").write_text("<package/>")
    assert "outside" in problem(path)


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply"])
def test_a_mesh_without_looks_has_the_urdf_s_colour(tmp_path, suffix):
    trimesh.creation.box((1, 1, 1)).export(
        tmp_path / f"x{suffix}", **({"include_color": False} if suffix == ".obj" else {})
    )
    look = '<material name="m"><color rgba="1 0 0 1"/></material>'
    visual = f'<visual><geometry><mesh filename="x{suffix}"/></geometry>{look}</visual>'
    path = tmp_path / "r.urdf"
    path.write_text(robot(f'<link name="a">{visual}</link>'))
    assert [m.base_color for m in read_urdf(path).parts[0].mesh.materials] == [(255, 0, 0, 255)]


def test_a_mesh_keeps_its_own_colours(tmp_path):
    (tmp_path / "x.mtl").write_text("newmtl blue\nKd 0 0 1\n")
    (tmp_path / "x.obj").write_text(
        "mtllib x.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl blue\nf 1 2 3\n"
    )
    look = '<material name="m"><color rgba="1 0 0 1"/></material>'
    visual = f'<visual><geometry><mesh filename="x.obj"/></geometry>{look}</visual>'
    path = tmp_path / "r.urdf"
    path.write_text(robot(f'<link name="a">{visual}</link>'))
    assert read_urdf(path).parts[0].mesh.materials[0].base_color == (0, 0, 255, 255)


def test_all_real_objects_move_as_in_yourdfpy(shared_data):
    """yourdfpy stretches prismatic motion by the axis' length; we normalise, as the format says."""
    files = sorted((shared_data / "partnet_mobility").glob("*/mobility.urdf"))
    assert files
    rng = np.random.default_rng(0)
    for path in files:
        model = read_urdf_model(path)
        reference = yourdfpy.URDF.load(str(path), load_meshes=False)
        names = [link.name for link in reference.robot.links]
        # The same order, but helpers that look like parts have other names.
        renamed = dict(zip(names, model.tree.links, strict=True))
        root = reference.base_link
        rest = {n: reference.get_transform(n, root) for n in names}
        q = {j.name: float(rng.uniform(-2, 2)) for j in model.tree.joints if j.moves}
        reference.update_cfg(
            {
                j.name: q[j.name] / (np.linalg.norm(j.axis) if j.type == "prismatic" else 1.0)
                for j in reference.robot.joints
                if j.name in q
            }
        )
        posed = model.tree.pose(q)
        for name in names:
            seen = reference.get_transform(name, root)
            np.testing.assert_allclose(posed[renamed[name]] @ rest[name], seen, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "joint", "upper"),
    [("45213", "joint_0", 2.26), ("41083", "joint_2", 0.64), ("12553", "joint_0", 1.57)],
)
def test_real_doors_and_drawers_are_free_in_their_annotated_range(shared_data, name, joint, upper):
    from model.kinematics.sweep import free_range

    obj = read_urdf(shared_data / "partnet_mobility" / name / "mobility.urdf")
    assert obj.tree.by_name[joint].upper == pytest.approx(upper, abs=0.01)
    low, high = free_range(obj, joint)
    assert high > upper
    assert low > -0.1  # closed: it can't go on inwards
