"""What the formats hold arrives: places, colours, textures, frames, parts."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from model.core.errors import ConfigurationError, InputFileError
from model.core.geometry import Mesh, PointCloud
from model.core.textures import SurfaceMaps
from model.geometry.sampling import face_colors
from model.io.model_files import find_assets
from model.io.open_asset import open_asset, read_part_files
from model.io.write import write_cloud, write_mesh
from tests.builders import ply_head


def ply(path: Path, cloud: PointCloud, style: str) -> Path:
    """A coloured cloud as other programs write it."""
    code = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}[style]
    head = ply_head(len(cloud), "float x y z nx ny nz", "uchar red green blue", style=style)
    if code is None:
        rows = np.column_stack([cloud.points, cloud.normals, cloud.colors])
        body = "\n".join(" ".join(f"{v:.9g}" for v in row) for row in rows).encode()
    else:
        table = np.zeros(len(cloud), [("f", f"{code}f4", 6), ("c", "u1", 3)])
        table["f"], table["c"] = np.column_stack([cloud.points, cloud.normals]), cloud.colors
        body = table.tobytes()
    path.write_bytes(head.encode() + body)
    return path


@pytest.mark.parametrize("style", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_clouds_in_every_encoding(tmp_path: Path, cloud: PointCloud, style: str) -> None:
    got = open_asset(ply(tmp_path / "scan.ply", cloud, style)).cloud
    assert got is not None and got.normals is not None and cloud.normals is not None
    np.testing.assert_array_equal(got.points, cloud.points)
    np.testing.assert_array_equal(got.colors, cloud.colors)
    np.testing.assert_allclose(got.normals, cloud.normals, atol=1e-6)


def test_confidences_of_points_are_read(tmp_path: Path, rng: np.random.Generator) -> None:
    """A scanner's field, a splat's opacity (a logit), and the maps of a reconstruction network."""
    xyz, logits = rng.random((40, 3)), rng.normal(0, 3, 40)
    splat = "float x y z f_dc_0 f_dc_1 f_dc_2 opacity"
    for fields, column in ((splat, logits), ("float x y z confidence", np.abs(logits))):
        colors = np.zeros((40, len(fields.split()) - 5))
        rows = np.column_stack([xyz, colors, column])
        body = "\n".join(" ".join(f"{v:.9g}" for v in row) for row in rows)
        (tmp_path / "scan.ply").write_text(ply_head(40, fields) + body)
        got = open_asset(tmp_path / "scan.ply").cloud
        assert got is not None and got.confidence is not None
        wanted = 1 / (1 + np.exp(-logits)) if "opacity" in fields else column
        np.testing.assert_allclose(got.confidence, wanted, rtol=1e-5)
        some = got.take(np.array([3, 5])).confidence
        assert some is not None and some[1] == got.confidence[5]
    maps = {"points": xyz.reshape(2, 4, 5, 3), "conf": np.abs(logits).reshape(2, 4, 5)}
    np.savez(tmp_path / "maps.npz", colors=xyz.reshape(2, 4, 5, 3), **maps)
    got = open_asset(tmp_path / "maps.npz").cloud
    assert got is not None and got.confidence is not None and got.colors is not None
    np.testing.assert_allclose(got.points, xyz, atol=1e-6)
    np.testing.assert_allclose(got.confidence, np.abs(logits), rtol=1e-6)


def test_ply_polygons_of_different_sizes_ascii_and_binary(tmp_path: Path) -> None:
    """A square pyramid: one quadrilateral and four triangles, with colours at the faces."""
    head = ply_head(5, "double x y z", faces=5, more="uchar red green blue", style="{}")
    points = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (1, 1, 1)]
    faces = [(0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]
    text = "\n".join(" ".join(map(str, p)) for p in points) + "\n"
    text += "\n".join(f"{len(f)} {' '.join(map(str, f))} {10 * i} 0 9" for i, f in enumerate(faces))
    (tmp_path / "a.ply").write_text(head.format("ascii") + text)
    body = np.array(points, "<f8").tobytes()
    for i, f in enumerate(faces):
        body += bytes([len(f)]) + np.array(f, "<i4").tobytes() + bytes([10 * i, 0, 9])
    (tmp_path / "b.ply").write_bytes(head.format("binary_little_endian").encode() + body)
    slant = 4 * 0.5 * 2 * np.sqrt(2)
    for name in ("a.ply", "b.ply"):
        mesh = open_asset(tmp_path / name).mesh
        assert mesh is not None and len(mesh.faces) == 6
        assert mesh.face_areas.sum() == pytest.approx(4 + slant)
        np.testing.assert_array_equal(face_colors(mesh)[:, 0], [0, 0, 10, 20, 30, 40])


def test_obj_ngons_negative_indices_and_materials(tmp_path: Path) -> None:
    (tmp_path / "m.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\nd 0.5\n")
    (tmp_path / "a.obj").write_text(
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0.5 0.25 0\nv 0 1 0\n"
        "usemtl red\nf -5 -4 -3 -2 -1\nv 0 0 2\nv 1 0 2\nv 1 1 2\nusemtl blue\nf 6/1 7/2 8/3\n"
    )
    mesh = open_asset(tmp_path / "a.obj", up_axis="z").mesh
    assert mesh is not None
    # A concave pentagon: the square less the triangle that is cut out of its upper side.
    assert mesh.face_areas.sum() == pytest.approx(1 - 0.5 * 0.75 + 0.5)
    assert [m.base_color for m in mesh.materials] == [(255, 0, 0, 255), (0, 0, 255, 128)]
    np.testing.assert_array_equal(mesh.face_material, [0, 0, 0, 1])


def test_textures_of_obj_and_glb_show_the_same_colours(tmp_path: Path, textured: Mesh) -> None:
    want = face_colors(textured)
    for name in ("a.obj", "a.glb"):
        write_mesh(textured, tmp_path / name)
        got = open_asset(tmp_path / name, up_axis="z" if name == "a.obj" else None)
        assert got.mesh is not None and got.warnings == ()
        # Order of faces may differ between materials: compare by place.
        order = np.lexsort(np.round(got.element_centers, 4).T)
        other = np.lexsort(np.round(textured.triangles.mean(1), 4).T)
        np.testing.assert_allclose(
            face_colors(got.mesh)[order].astype(int), want[other].astype(int), atol=1
        )


def test_what_materials_have_beside_colour(tmp_path: Path, checker: Image.Image) -> None:
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    box = trimesh.creation.box((1, 1, 1))
    shine = Image.new("RGB", (2, 2), (0, 128, 51))  # green is roughness, blue metallic
    material = PBRMaterial(
        metallicFactor=0.5, roughnessFactor=1.0, metallicRoughnessTexture=shine,
        normalTexture=checker, emissiveFactor=[1, 1, 0],
    )  # fmt: skip
    box.visual = TextureVisuals(np.zeros((len(box.vertices), 2)), material=material)
    box.export(tmp_path / "a.glb")
    asset = open_asset(tmp_path / "a.glb")
    assert asset.mesh is not None
    (got,) = asset.mesh.materials
    assert (got.metallic, got.roughness) == pytest.approx((0.1, 128 / 255))
    assert got.maps.emission == (1.0, 1.0, 0.0) and got.maps.normal is not None
    assert asset.warnings == ("a map of metallic and roughness became its mean",)
    (tmp_path / "m.mtl").write_text("newmtl a\nPm 0.75\nPr 2\nmap_Pr r.png\nnewmtl b\nKe 0 0 0\n")
    (tmp_path / "a.obj").write_text("mtllib m.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n")
    asset = open_asset(tmp_path / "a.obj")
    assert asset.mesh is not None
    assert (asset.mesh.materials[0].metallic, asset.mesh.materials[0].roughness) == (0.75, 1.0)
    assert asset.mesh.materials[0].maps == SurfaceMaps()
    assert asset.warnings == ("left out of its materials: roughness map",)


def test_texture_from_another_machine_is_found_beside(tmp_path: Path, checker: Image.Image) -> None:
    checker.save(tmp_path / "wood.png")
    (tmp_path / "m.mtl").write_text("newmtl a\nmap_Kd -s 1 1 1 C:\\Users\\me\\wood.png\n")
    (tmp_path / "a.obj").write_text(
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nusemtl a\nf 1/1 2/2 3/3\n"
    )
    asset = open_asset(tmp_path / "a.obj")
    assert asset.mesh is not None and asset.mesh.materials[0].texture is not None
    assert asset.warnings == ()


def test_glb_nodes_are_placed(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    box = trimesh.creation.box((1, 1, 1))
    for i in range(3):
        matrix = trimesh.transformations.rotation_matrix(0.3 * i, (0, 1, 1), point=(1, 2, 3))
        matrix[0, 3] += 2 * i
        scene.add_geometry(box, node_name=f"n{i}", geom_name="box", transform=matrix)
    scene.export(tmp_path / "s.glb")
    got = open_asset(tmp_path / "s.glb", up_axis="z")
    assert got.mesh is not None and got.mesh.face_areas.sum() == pytest.approx(18)
    np.testing.assert_allclose(got.bounds, scene.bounds, atol=1e-6)


def test_mirrored_node_keeps_the_outside_outside(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box((1, 2, 3)), transform=np.diag([-1.0, 1, 1, 1]))
    scene.export(tmp_path / "s.glb")
    mesh = open_asset(tmp_path / "s.glb").mesh
    assert mesh is not None
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).volume == pytest.approx(6)


@pytest.mark.parametrize("axis", ["x", "y", "z", "-x", "-y", "-z"])
def test_up_axis_is_turned_to_z(tmp_path: Path, axis: str, rng: np.random.Generator) -> None:
    """A column along ``axis`` from 0 to 5 stands on the ground afterwards, not mirrored."""
    points = rng.normal(0, 0.1, (50, 3))
    along, sign = "xyz".index(axis[-1]), -1.0 if axis[0] == "-" else 1.0
    points[:, along] = sign * np.linspace(0, 5, 50)
    np.savetxt(tmp_path / "c.xyz", points)
    got = open_asset(tmp_path / "c.xyz", up_axis=axis)  # type: ignore[arg-type]
    np.testing.assert_allclose(got.element_centers[:, 2], np.linspace(0, 5, 50), atol=1e-6)
    turn, *_ = np.linalg.lstsq(points, got.element_centers, rcond=None)
    assert np.linalg.det(turn) == pytest.approx(1, abs=1e-5)


def test_default_up_axes_and_unit_scale(tmp_path: Path) -> None:
    tall = trimesh.creation.box((1, 3, 0.5))  # 3 along y
    for suffix, axis in ((".obj", 2), (".glb", 2), (".ply", 1), (".stl", 1)):
        tall.export(tmp_path / f"t{suffix}")
        asset = open_asset(tmp_path / f"t{suffix}", unit_scale=0.01)
        size = np.ptp(asset.bounds, axis=0)
        assert int(np.argmax(size)) == axis, suffix
        assert size.max() == pytest.approx(0.03)
        assert asset.source is not None and asset.source.unit_scale == 0.01
    with pytest.raises(ConfigurationError, match="up axis"):
        open_asset(tmp_path / "t.ply", up_axis="w")  # type: ignore[arg-type]
    with pytest.raises(ConfigurationError, match="unit scale"):
        open_asset(tmp_path / "t.ply", unit_scale=0)


@pytest.mark.parametrize("style", ["ascii", "binary", "binary_compressed"])
def test_pcd(tmp_path: Path, cloud: PointCloud, style: str) -> None:
    import open3d as o3d

    pcd = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.points.astype(np.float64)))
    assert cloud.colors is not None and cloud.normals is not None
    pcd.colors = o3d.utility.Vector3dVector(cloud.colors / 255.0)
    pcd.normals = o3d.utility.Vector3dVector(cloud.normals.astype(np.float64))
    path = tmp_path / "a.pcd"
    o3d.io.write_point_cloud(
        str(path), pcd, write_ascii=style == "ascii", compressed=style == "binary_compressed"
    )
    assert f"DATA {style}\n".encode() in path.read_bytes()
    got = open_asset(path).cloud
    assert got is not None and got.normals is not None
    np.testing.assert_allclose(got.points, cloud.points, atol=1e-6)
    np.testing.assert_allclose(got.normals, cloud.normals, atol=1e-5)
    if style != "ascii":  # a float with ten digits doesn't keep the packed bits
        np.testing.assert_array_equal(got.colors, cloud.colors)


@pytest.mark.parametrize(
    ("name", "head", "columns", "separator"),
    [
        ("a.xyz", "", "p", " "), ("a.txt", "", "pc", "\t"),
        ("a.csv", "x,y,z,red,green,blue\n", "pc", ","),
        ("b.csv", "nx;ny;nz;x;y;z\n", "np", ";"), ("a.asc", "# a comment\n", "pn", " "),
        ("a.pts", "200\n", "pic", " "), ("c.txt", "//X Y Z R G B Nx Ny Nz\n", "pcn", " "),
        ("d.xyz", "", "pnc", " "),
    ],
)  # fmt: skip
def test_text_columns(
    tmp_path: Path, cloud: PointCloud, name: str, head: str, columns: str, separator: str
) -> None:
    small = cloud.take(np.arange(200))
    assert small.colors is not None and small.normals is not None
    of = {"p": small.points, "c": small.colors, "n": small.normals, "i": np.full((200, 1), 7)}
    table = np.column_stack([of[c] for c in columns]).astype(np.float64)
    rows = "\n".join(separator.join(f"{v:.9g}" for v in row) for row in table)
    (tmp_path / name).write_text(head + rows + "\n")
    got = open_asset(tmp_path / name).cloud
    assert got is not None
    np.testing.assert_allclose(got.points, small.points, atol=1e-7)
    assert (got.colors is not None) == ("c" in columns)
    assert (got.normals is not None) == ("n" in columns)
    if got.colors is not None:
        np.testing.assert_array_equal(got.colors, small.colors)


def test_part_folder_with_object_json(tmp_path: Path, ball: Mesh, textured: Mesh) -> None:
    write_mesh(textured, tmp_path / "body.obj")
    write_mesh(ball, tmp_path / "knob one.obj")
    tree = {
        "category": "oven",
        "parts": [{"file": "knob one.obj", "name": "knob"}, {"file": "body.obj"}],
    }
    (tmp_path / "object.json").write_text(json.dumps(tree))
    asset = open_asset(tmp_path)
    assert asset.category == "oven" and asset.part_names == ("knob", "body")
    assert asset.element_part is not None
    np.testing.assert_array_equal(np.bincount(asset.element_part), [len(ball.faces), 12])
    assert asset.mesh is not None
    total = ball.face_areas.sum() + textured.face_areas.sum()
    assert asset.mesh.face_areas.sum() == pytest.approx(total, rel=1e-7)
    segmented = read_part_files(tmp_path)
    assert [(p.link, p.name) for p in segmented.parts] == [("knob_one", "knob"), ("body", None)]
    assert segmented.category == "oven"
    np.testing.assert_allclose(segmented.bounds, asset.bounds)  # taken as it is, +z up


def test_part_folder_by_names_in_natural_order(tmp_path: Path, cloud: PointCloud) -> None:
    for i in (10, 2, 0):
        shifted = PointCloud(cloud.points + np.float32(i))
        write_cloud(shifted, tmp_path / f"link_{i}.ply")
    (tmp_path / "notes.txt").write_text("not a part")
    asset = open_asset(tmp_path)
    assert asset.part_names == ("link_0", "link_2", "link_10")
    assert asset.cloud is not None and len(asset.cloud) == 3 * len(cloud)
    assert [p.link for p in read_part_files(tmp_path).parts] == ["link_0", "link_2", "link_10"]


def test_coloured_part_beside_plain_part_keeps_both_looks(tmp_path: Path, textured: Mesh) -> None:
    box = trimesh.creation.box()
    box.visual.vertex_colors = np.tile([9, 99, 199, 255], (8, 1))
    box.export(tmp_path / "link_0.ply")
    write_mesh(textured.take_faces(np.arange(6, 12)), tmp_path / "link_1.obj")
    asset = open_asset(tmp_path)
    assert asset.mesh is not None
    colors = face_colors(asset.mesh)[:, :3]
    np.testing.assert_array_equal(colors[:12], np.tile([9, 99, 199], (12, 1)))
    np.testing.assert_array_equal(colors[12:], np.tile([240, 120, 30], (6, 1)))


MOBILITY = """<robot name="r"><link name="base"/>
<link name="body"><visual><geometry><mesh filename="textured_objs/a.obj"/></geometry></visual>
</link>
<link name="lid"><visual><origin xyz="-1 0 0"/><geometry>
<mesh filename="textured_objs/a.obj" scale="0.5 0.5 0.5"/></geometry></visual></link>
<joint name="j0" type="fixed"><origin rpy="1.5707963267948966 0 0"/><parent link="base"/>
<child link="body"/></joint>
<joint name="j1" type="revolute"><origin xyz="1 5 0"/><axis xyz="0 1 0"/><parent link="body"/>
<child link="lid"/><limit lower="0" upper="1"/></joint></robot>"""


def test_mobility_folder_in_its_rest_pose(tmp_path: Path, checker: Image.Image) -> None:
    (tmp_path / "textured_objs").mkdir()
    (tmp_path / "images").mkdir()
    checker.save(tmp_path / "images" / "t.png")
    objs = tmp_path / "textured_objs"
    (objs / "a.mtl").write_text("newmtl m\nmap_Kd ../images/t.png\n")
    (objs / "a.obj").write_text(
        "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n"
    )
    (tmp_path / "mobility.urdf").write_text(MOBILITY)
    assert find_assets([tmp_path]) == [tmp_path]
    asset = open_asset(tmp_path)
    assert asset.mesh is not None and asset.warnings == ()
    # y up in the body's frame is z up in the base's.
    want = [[0, 0, 0], [1, 0, 0], [0, 0, 1], [0, 0, 5], [0.5, 0, 5], [0, 0, 5.5]]
    np.testing.assert_allclose(asset.mesh.triangles.reshape(-1, 3), want, atol=1e-9)
    assert asset.mesh.uv is not None and asset.mesh.materials[0].texture is not None


def test_find_assets(tmp_path: Path, ball: Mesh, cloud: PointCloud) -> None:
    for name in ("b/scan_10.ply", "b/scan_2.ply", "obj/link_0.ply", "obj/link_1.ply", "x.ply"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        write_cloud(cloud, tmp_path / name)
    write_mesh(ball, tmp_path / "b" / "mesh.obj")
    (tmp_path / "b" / "readme.txt").write_text("1 2 3")
    (tmp_path / "b" / "up").symlink_to(tmp_path)
    found = find_assets([tmp_path, tmp_path / "x.ply"])
    names = [str(p.relative_to(tmp_path)) for p in found]
    assert names == ["b/mesh.obj", "b/scan_2.ply", "b/scan_10.ply", "obj", "x.ply"]


def test_folders_with_many_names_are_searched_once(tmp_path: Path, ball: Mesh) -> None:
    above = tmp_path / "0"
    above.mkdir()
    for level in range(1, 25):  # each links to the next by two names: 2^24 ways down
        folder = tmp_path / str(level)
        folder.mkdir()
        for name in ("a", "b"):
            (above / name).symlink_to(folder)
        above = folder
    write_mesh(ball, above / "ball.ply")
    assert [p.name for p in find_assets([tmp_path / "0"])] == ["ball.ply"]


def test_the_same_bytes_have_the_same_digest(tmp_path: Path, cloud: PointCloud) -> None:
    import hashlib

    write_cloud(cloud, tmp_path / "a.ply")
    source = open_asset(tmp_path / "a.ply").source
    assert source is not None
    assert source.sha256 == hashlib.sha256((tmp_path / "a.ply").read_bytes()).hexdigest()


def test_surveyed_scans_keep_their_detail(tmp_path: Path, rng: np.random.Generator) -> None:
    """Coordinates of millions of metres would be in steps of half a metre as float32."""
    points = rng.random((500, 3))
    far = points + np.array([4_512_334.0, 512_000.0, 120.0])
    np.savetxt(tmp_path / "utm.xyz", far, fmt="%.6f")
    asset = open_asset(tmp_path / "utm.xyz")
    assert asset.cloud is not None and asset.source is not None
    np.testing.assert_allclose(asset.cloud.points + np.array(asset.source.shift), far, atol=2e-6)
    assert any("far from its origin" in w for w in asset.warnings)


def test_gaussian_splats_and_float_colours(tmp_path: Path) -> None:
    head = ply_head(4, "float x y z f_dc_0 f_dc_1 f_dc_2")
    rows = "0 0 0 1.772454 0 -1.772454\n" * 2 + "1 1 1 0 0 0\n0 1 0 0 0 0\n"
    (tmp_path / "s.ply").write_text(head + rows)
    got = open_asset(tmp_path / "s.ply").cloud
    assert got is not None and got.colors is not None
    np.testing.assert_allclose(got.colors[0].astype(int), [255, 128, 0], atol=1)


def star(corners: int) -> str:
    """An OBJ with one concave face, a zigzag ring of area 0.75 · corners · sin(2 π / corners)."""
    turn = 2 * np.pi * np.arange(corners) / corners
    radius = 1 + 0.5 * (np.arange(corners) % 2)
    points = np.stack([radius * np.cos(turn), radius * np.sin(turn), 0 * turn], 1)
    lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in points]
    return "\n".join([*lines, "f " + " ".join(map(str, range(1, corners + 1)))])


def test_a_concave_face_of_many_corners_is_triangulated_or_refused_at_once(tmp_path: Path) -> None:
    path = tmp_path / "star.obj"
    path.write_text(star(8000))
    begun = time.process_time()
    mesh = open_asset(path, up_axis="z").mesh
    assert mesh is not None and mesh.face_areas.sum() == pytest.approx(1.5 * np.pi, rel=1e-5)
    assert (mesh.face_normals[:, 2] > 0).all()
    path.write_text(star(100_000))
    with pytest.raises(InputFileError, match=r"star\.obj: 1 concave face with up to 100,000"):
        open_asset(path, up_axis="z")
    assert time.process_time() - begun < 3  # it was 5.8 s for the first one alone
