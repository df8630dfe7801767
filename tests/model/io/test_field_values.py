"""What files say beside shapes: looks, ranges, couplings and groups are read as meant, or told."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from trimesh.creation import box

from model.core.joint import Joint, Mimic
from model.io.assets.reader import load_object
from model.io.export.registry import export
from model.io.masks import with_masks
from model.io.open_asset import open_asset
from model.physics.simulation_values import physics_of
from model.validation.runner import validate
from tests.builders import box as solid
from tests.builders import boxes, gltf_of, linked, part, ply_head, write_glb

CUBE = boxes(((0, 0, 0), (1, 1, 1)))
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
URDF = """<robot name="r"><link name="base"><visual><geometry><box size="1 1 1"/></geometry>
</visual></link><link name="door"><visual><origin xyz="0 1 0"/><geometry>{door}</geometry></visual>
{more}</link><joint name="hinge" type="revolute"><parent link="base"/><child link="door"/>
<axis xyz="0 0 1"/>{limit}<dynamics damping="0.7" friction="0.2"/></joint></robot>"""
BOX, LIMIT = '<box size="1 0.1 1"/>', '<limit lower="0" upper="1" effort="10" velocity="2"/>'
MJCF = """<mujoco><compiler autolimits="true"/><asset>
<texture name="t" type="2d" file="t.png"/><material name="m" texture="t" texrepeat="4 2.5"/>
<mesh name="door" file="door.obj"/></asset><worldbody><geom type="box" size="1 1 1"/>
<body name="a"><joint name="ja" type="slide" range="{range}"/><geom type="box" size="1 1 1"/></body>
<body name="b"><joint name="jb" type="slide" range="-9 9"/>
<geom type="mesh" mesh="door" material="m"/></body></worldbody>
<equality><joint joint1="jb" joint2="ja" polycoef="{terms}"/></equality></mujoco>"""


def cubes(*names: str) -> str:
    """Lines of an OBJ: cubes of quads along x, each below its line of ``names``."""
    out = []
    for k, name in enumerate(names):
        corners = [(x + 2 * k, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
        out += ["v {} {} {}".format(*corner) for corner in corners] + [name]
        out += ["f " + " ".join(str(8 * k + i + 1) for i in quad) for quad in QUADS]
    return "\n".join(out)


def urdf(folder: Path, door: str = BOX, limit: str = LIMIT, more: str = "") -> Path:
    (folder / "cab.urdf").write_text(URDF.format(door=door, limit=limit, more=more))
    return folder / "cab.urdf"


def mjcf(folder: Path, range: str = "-1.5 0", terms: str = "0 1") -> Path:
    Image.new("RGB", (4, 4), (255, 0, 0)).save(folder / "t.png")
    uv = "vt 0 0\nvt 0.8 0\nvt 0.8 1\nvt 0 1\n"
    corners = "v 0 0 0\nv 1 0 0\nv 1 0 1\nv 0 0 1\nv 0 1 0\n"
    faces = "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\nf 1/1 4/4 5/2\nf 1/1 5/2 2/2\n"
    (folder / "door.obj").write_text(uv + corners + faces)
    (folder / "a.xml").write_text(MJCF.format(range=range, terms=terms))
    return folder / "a.xml"


@pytest.mark.parametrize("mode", ["I;16", "LA", "P", "1", "CMYK", "F"])
def test_textures_of_all_modes_keep_their_colour(tmp_path: Path, mode: str) -> None:
    right, name = {"P": (255, 128, 0), "CMYK": (255, 128, 0)}.get(mode, (128,) * 3), "t.png"
    image = Image.new("RGB", (8, 8), right)
    if mode == "I;16":
        image = Image.fromarray(np.full((8, 8), 128 * 257, np.uint16))
    elif mode == "F":
        image, name = Image.fromarray(np.full((8, 8), 0.502, np.float32)), "t.tif"
    elif mode == "CMYK":
        image, name = image.convert(mode), "t.jpg"
    elif mode == "1":
        right, image = (255, 255, 255), Image.new("1", (8, 8), 1)
    else:
        image = image.convert(mode, palette=Image.Palette.ADAPTIVE)
    image.save(tmp_path / name)
    (tmp_path / "m.mtl").write_text(f"newmtl m\nmap_Kd {name}\n")
    faces = "v 0 0 0\nv 1 0 0\nv 0 0 1\nv 0 1 0\nvt 0.1 0.1\nvt 0.9 0.9\nusemtl m\nf 1/1 2/2 3/1\n"
    (tmp_path / "a.obj").write_text(f"mtllib m.mtl\n{faces}f 1/1 3/2 4/1\n")
    pixel = lambda image: np.asarray(image.convert("RGB"))[4, 4]  # noqa: E731
    asset = open_asset(tmp_path / "a.obj")
    assert asset.mesh is not None and asset.mesh.materials[0].texture is not None
    assert np.abs(pixel(asset.mesh.materials[0].texture) - np.array(right, int)).max() <= 8
    path = urdf(tmp_path, '<mesh filename="a.obj"/>')
    for format in ("urdf", "mjcf", "sdf"):
        export(path, format, tmp_path / format)
        (image,) = {p for p in (tmp_path / format).rglob("*") if p.suffix in (".png", ".jpg")}
        assert np.abs(pixel(Image.open(image)) - np.array(right, int)).max() <= 8


@pytest.mark.parametrize(
    ("more", "right"),
    [
        ("0.8 0.4 0.2 1", (204, 102, 51, 255)),
        ("200 100 50 255", (200, 100, 50, 255)),
        ("0.8 0.4 0.2 0.6", (204, 102, 51, 153)),
        ("1 0.8 0.4 0.2", (204, 102, 51, 255)),  # a weight before the colour
        ("1 0.8 0.4 0.2 0.6", (204, 102, 51, 153)),
    ],
)
def test_obj_vertices_with_alpha_or_weight(tmp_path: Path, more: str, right: tuple) -> None:
    corners = "".join(f"v {x} {y} 0 {more}\n" for x, y in ((0, 0), (1, 0), (0, 1)))
    (tmp_path / "a.obj").write_text(corners + "f 1 2 3\n")
    mesh = open_asset(tmp_path / "a.obj").mesh
    assert mesh is not None and mesh.vertex_colors is not None
    assert mesh.vertex_colors.tolist() == [list(right)] * 3


@pytest.mark.parametrize(
    ("heads", "names", "order"),
    [
        (("o body", "o door_1"), ("body", "door_1"), [0, 1]),
        (("o Cab\ng lid", "g body"), ("body", "lid"), [1, 0]),
        (("g drawer", "g case", "g drawer"), ("case", "drawer"), [1, 0, 1]),
        (("g wood", "g steel"), (), None),
    ],
)
def test_objects_and_groups_of_an_obj_are_parts(
    tmp_path: Path, heads: tuple[str, ...], names: tuple[str, ...], order: list[int] | None
) -> None:
    (tmp_path / "a.obj").write_text(cubes(*heads))
    asset = open_asset(tmp_path / "a.obj")
    assert asset.part_names == names
    found = None if asset.element_part is None else asset.element_part.tolist()
    assert found == (None if order is None else np.repeat(order, 12).tolist())


@pytest.mark.parametrize("file", ["a.obj", "a.ply"])
def test_masks_may_count_the_faces_of_the_file(tmp_path: Path, file: str) -> None:
    text = cubes("", "")
    if file == "a.ply":
        rows = [line.split() for line in text.splitlines()]
        faces = ["4 " + " ".join(str(int(i) - 1) for i in r[1:]) for r in rows if r[:1] == ["f"]]
        body = [" ".join(r[1:]) for r in rows if r[:1] == ["v"]]
        text = ply_head(16, faces=12) + "\n".join(body + faces)
    (tmp_path / file).write_text(text)
    np.save(tmp_path / "m.npy", np.repeat([0, 1], 6))
    asset = with_masks(open_asset(tmp_path / file), tmp_path / "m.npy")
    assert asset.element_part is not None and asset.mesh is not None
    x = asset.mesh.triangles[..., 0].mean(1) > 1.5
    assert len({*zip(asset.element_part.tolist(), x.tolist(), strict=True)}) == 2


def test_points_beside_triangles_are_counted(tmp_path: Path) -> None:
    tree = gltf_of(12)
    tree["meshes"][0]["primitives"].append({**tree["meshes"][0]["primitives"][0], "mode": 0})
    corners = np.float32(CUBE.triangles[:4].reshape(-1, 3)).tobytes()
    path = write_glb(tmp_path / "a.glb", tree, corners)
    assert open_asset(path).warnings == ("12 points beside the triangles are left out",)


def test_colours_that_a_text_lost_are_told(tmp_path: Path) -> None:
    head = "VERSION .7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH 4\n"
    rows = "0 0 0 nan\n1 0 0 nan\n0 1 0 1e-38\n0 0 1 1e-38\n"
    (tmp_path / "a.pcd").write_text(f"{head}HEIGHT 1\nPOINTS 4\nDATA ascii\n{rows}")
    asset = open_asset(tmp_path / "a.pcd")
    assert asset.cloud is not None and asset.cloud.colors is not None
    assert asset.cloud.colors[0].tolist() == [200, 200, 200]
    assert "2 of 4 colours" in asset.warnings[0]


def test_lines_in_collada_are_left_out_with_a_remark(tmp_path: Path) -> None:
    collada = pytest.importorskip("collada")
    file = collada.Collada()
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    source = collada.source.FloatSource("v", corners.ravel(), ("X", "Y", "Z"))
    geometry = collada.geometry.Geometry(file, "g", "tetra", [source])
    inputs = collada.source.InputList()
    inputs.addInput(0, "VERTEX", "#v")
    faces = np.array([0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3])
    geometry.primitives.append(geometry.createTriangleSet(faces, inputs, "m"))
    geometry.primitives.append(geometry.createLineSet(np.arange(4), inputs, "m"))
    file.geometries.append(geometry)
    node = collada.scene.Node("n", children=[collada.scene.GeometryNode(geometry, [])])
    file.scenes.append(collada.scene.Scene("s", [node]))
    file.scene = file.scenes[0]
    file.write(str(tmp_path / "a.dae"))
    asset = open_asset(tmp_path / "a.dae")
    assert asset.element_count == 4 and asset.warnings == ("1 pieces of lines are left out",)


def test_meshes_that_never_were_are_passed_over(tmp_path: Path) -> None:
    box((1, 1, 1)).export(tmp_path / "there.obj")
    (tmp_path / "empty.obj").write_text("# no faces\nmtllib new.mtl\n")
    more = "".join(
        f'<{tag}><geometry><mesh filename="{name}.obj"/></geometry></{tag}>'
        for name in ("gone", "empty")
        for tag in ("visual", "collision")
    )
    asset = open_asset(urdf(tmp_path, '<mesh filename="there.obj"/>', more=more))
    assert asset.element_count == 24 and asset.shapes == {}
    assert asset.warnings == (
        "mesh 'gone.obj' of link 'door' isn't there: left out",
        "mesh 'empty.obj' of link 'door' is empty: left out",
    )


def test_an_empty_range_is_told_on_opening(tmp_path: Path) -> None:
    limit = '<limit effort="0" lower="0" upper="0" velocity="0"/>'
    (told,) = open_asset(urdf(tmp_path, limit=limit)).warnings
    assert "'hinge' can't move" in told and "predict" in told
    assert open_asset(urdf(tmp_path)).warnings == ()


@pytest.mark.parametrize(
    ("range", "terms", "right"),
    [
        ("-1.5 0", "0.2 -0.5 0 0 0", (-0.5, 0.2)),
        ("-1.5 0", "0 0 1 0 0", (-1.5, 0.0)),  # its chord
        ("0 2", "0.1 0 1 0 0", (2.0, 0.1)),
        ("-1 2", "0 0 0 1 0", (4.0, 0.0)),  # from rest to the far end
        ("1 2", "0 0 1 0 0", (3.0, -2.0)),
    ],
)
def test_couplings_of_mjcf_are_lines_or_chords(
    tmp_path: Path, range: str, terms: str, right: tuple[float, float]
) -> None:
    asset = open_asset(mjcf(tmp_path, range, terms))
    assert asset.tree is not None
    mimic = asset.tree.by_name["jb"].mimic
    assert mimic is not None
    assert (mimic.multiplier, mimic.offset) == pytest.approx(right)
    assert any("along a curve" in w for w in asset.warnings) == any(map(float, terms.split()[2:]))


def test_mujoco_repeats_textures(tmp_path: Path) -> None:
    mesh = open_asset(mjcf(tmp_path)).mesh
    assert mesh is not None and mesh.uv is not None
    door = mesh.uv[mesh.faces[-4:].ravel()]
    assert door.max(0) == pytest.approx([3.2, 3.0])  # 0.5 of an image is cut off below
    assert door.min(0) == pytest.approx([0.0, 0.5])


def test_effort_goes_into_mjcf_and_back(tmp_path: Path) -> None:
    path = urdf(tmp_path)
    written = export(path, "mjcf", tmp_path / "out", physics=physics_of(load_object(path)))
    assert 'actuatorfrcrange="-10 10"' in written[0].read_text()
    tree = open_asset(written[0]).tree
    assert tree is not None and (found := tree.joints[0].dynamics) is not None
    assert (found.damping, found.friction, found.effort) == (0.7, 0.2, 10)


def test_a_follower_is_checked_where_its_leader_takes_it() -> None:
    base = part("base", solid((-0.3, -0.2, 0), (0.3, 0.2, 0.8)))
    doors = [
        part("left", solid((-0.3, -0.22, 0), (0, -0.2, 0.8)), name="left door"),
        part("right", solid((0, -0.22, 0), (0.3, -0.2, 0.8)), name="right door"),
    ]
    leader = Joint("j", "revolute", "base", "left", (0, 0, -1), (-0.3, -0.2, 0), 0.0, 1.57)
    follower = Joint(
        "k", "revolute", "base", "right", (0, 0, 1), (0.3, -0.2, 0), -3.0, 3.0, Mimic("j", 1, 0.5)
    )
    report = validate(linked([leader, follower], base, *doors), engines=())
    kinds = {f.kind for j in report.joints if j.joint == "k" for f in j.findings}
    assert not kinds & {"collision", "jammed"}
