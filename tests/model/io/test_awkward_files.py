"""Files of kinds that public bug reports describe, each with what is right.

The files in ``awkward/`` are of our own making. Sources: glTFast 107, glTF-Blender-IO 368, meshlab
39, PCL 1069, urdfdom 195, sdformat 252, assimp 6296, tinyobjloader 112, numpy-stl 154.
"""

from pathlib import Path

import numpy as np
import pytest

from model.core.asset import Asset
from model.core.errors import InputFileError
from model.core.geometry import Mesh
from model.io.open_asset import open_asset
from model.scenes.asset_parts import index_assets
from model.scenes.registry import read_scene
from tests.builders import write_glb

FILES = Path(__file__).parent / "awkward"


def opened(pattern: str) -> Asset:
    (path,) = FILES.glob(pattern)
    return open_asset(path)


def mesh_of(pattern: str) -> Mesh:
    mesh = opened(pattern).mesh
    assert mesh is not None
    return mesh


def volume(mesh: Mesh) -> float:
    a, b, c = mesh.triangles.transpose(1, 0, 2)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6


def test_all_copies_of_an_instanced_mesh_stand_in_their_places() -> None:
    asset = opened("glb_instancing/*/*.glb")
    assert asset.element_part is not None and len(set(asset.element_part.tolist())) == 5
    assert asset.mesh is not None
    middles = [
        asset.mesh.vertices[asset.mesh.faces[asset.element_part == part]].mean((0, 1))[[0, 2]]
        for part in range(1, 5)
    ]
    xs, zs = (sorted({round(float(m[k]), 3) for m in middles}) for k in (0, 1))
    assert len(xs) == len(zs) == 2


def test_the_joints_place_a_skinned_mesh() -> None:
    low, high = mesh_of("glb_skinned/*/*.glb").bounds
    assert low == pytest.approx([-0.3, -0.2, 0.2]) and high == pytest.approx([0.3, 0.2, 1.2])


def test_weights_of_morph_targets_count() -> None:
    mesh = mesh_of("glb_morph/*/*.glb")
    assert np.ptp(mesh.bounds, axis=0)[2] == pytest.approx(2) and volume(mesh) == pytest.approx(2)


def test_meshopt_compression_is_refused_by_name() -> None:
    with pytest.raises(InputFileError, match="EXT_meshopt_compression"):
        opened("glb_meshopt/*/*.glb")


def test_lines_that_are_left_out_are_counted() -> None:
    assert any("lines" in w for w in opened("glb_points_lines/*/*.glb").warnings)


@pytest.mark.parametrize("extension", ["ACME_shape", "KHR_gaussian_splatting", "EXT_nope"])
def test_an_unknown_required_extension_is_refused(extension: str, tmp_path: Path) -> None:
    path = write_glb(tmp_path / "a.glb", {"extensionsRequired": [extension]})
    with pytest.raises(InputFileError, match=extension):
        open_asset(path)


def test_a_node_with_two_parents_is_refused_at_once(tmp_path: Path) -> None:
    nodes = [{"children": [k + 1, k + 1]} for k in range(40)] + [{}]
    path = write_glb(tmp_path / "a.glb", {"nodes": nodes, "scenes": [{"nodes": [0]}]})
    with pytest.raises(InputFileError, match="two parents"):
        open_asset(path)


@pytest.mark.parametrize("kind", ["mtl_only", "mtllib"])
def test_a_byte_order_mark_changes_nothing(kind: str) -> None:
    mesh = mesh_of(f"obj_bom/*{kind}/*.obj")
    assert volume(mesh) == pytest.approx(1) and mesh.materials[0].texture is not None


def test_comments_end_the_line_of_an_obj() -> None:
    assert volume(mesh_of("obj_inline_comment/*/*.obj")) == pytest.approx(1)


def test_scale_and_offset_of_a_map_move_its_coordinates(tmp_path: Path) -> None:
    (folder,) = FILES.glob("obj_map_scale/*")
    text = (folder / "m.mtl").read_text()
    assert "-s 2 2 1 -o 0.25 0 0" in text
    moved = mesh_of("obj_map_scale/*/*.obj")
    for name in ("m.obj", "t.png"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    (tmp_path / "m.mtl").write_text(text.replace("-s 2 2 1 -o 0.25 0 0 ", ""))
    plain = open_asset(tmp_path / "m.obj").mesh
    assert moved.uv is not None and plain is not None and plain.uv is not None
    assert moved.uv == pytest.approx(plain.uv * 2 + [0.25, 0])


def test_several_material_files_are_all_read() -> None:
    colors = [m.base_color[:3] for m in mesh_of("obj_multi_mtllib/*/*.obj").materials]
    assert colors == [(255, 0, 0), (0, 255, 0), (0, 0, 255)]


def test_triangle_strips_are_a_surface() -> None:
    mesh = mesh_of("ply_tristrips/*/*.ply")
    assert len(mesh.vertices) == 8 and len(mesh.faces) == 12
    assert abs(volume(mesh)) == pytest.approx(1)


def test_each_face_has_the_texture_of_its_number() -> None:
    mesh = mesh_of("ply_two_textures/*/*.ply")
    pixels = [m.texture.convert("RGB").getpixel((0, 0)) for m in mesh.materials if m.texture]
    shown = [pixels[k] for k in mesh.face_material]
    assert [int(np.argmax(p)) for p in shown] == [0, 0, 2, 2]


def test_capitals_and_a_byte_order_mark_are_stl() -> None:
    for path in FILES.glob("stl_upper_bom/*/*"):
        mesh = open_asset(path).mesh
        assert mesh is not None and len(mesh.faces) == 12


def test_decimal_commas_are_read() -> None:
    for path in FILES.glob("txt_decimal_comma/*/*"):
        cloud = open_asset(path).cloud
        assert cloud is not None and len(cloud) == 300
        assert cloud.points.min() >= 0 and cloud.points.max() <= 1


def test_a_quaternion_turns_a_urdf_frame() -> None:
    asset = opened("urdf11_quat/*/cab.urdf")
    assert asset.mesh is not None and asset.element_part is not None
    door = asset.mesh.vertices[asset.mesh.faces[asset.element_part == 1]].reshape(-1, 3)
    assert door.min(0)[:2] == pytest.approx([-0.32, -0.8], abs=0.01)
    assert door.max(0)[:2] == pytest.approx([-0.3, -0.2], abs=0.01)


def test_a_texture_of_a_urdf_is_kept() -> None:
    textures = [m.texture for m in mesh_of("urdf_texture/*/cab.urdf").materials]
    (texture,) = [t for t in textures if t is not None]
    assert int(np.argmax(texture.convert("RGB").getpixel((0, 0)))) == 0


def test_a_collada_mesh_of_a_urdf_is_opened() -> None:
    assert opened("urdf_dae/*/cab.urdf").bounds[1][2] == pytest.approx(1.2)


def test_limits_without_numbers_are_named() -> None:
    assert any("lower" in w for w in opened("urdf_limit_effort_only/*/cab.urdf").warnings)


def test_a_follower_without_limits_has_its_leaders_range() -> None:
    tree = opened("urdf_mimic_no_limit/*/cab.urdf").tree
    assert tree is not None
    (follower,) = [j for j in tree.joints if j.mimic]
    leader = next(j for j in tree.joints if j.name == follower.mimic.joint)  # type: ignore[union-attr]
    assert leader.lower is not None and leader.upper is not None and follower.mimic
    ends = sorted(
        follower.mimic.multiplier * q + follower.mimic.offset for q in (leader.lower, leader.upper)
    )
    assert [follower.lower, follower.upper] == pytest.approx(ends)


def test_unknown_items_of_a_urdf_are_counted(tmp_path: Path) -> None:
    text = next(FILES.glob("urdf11_quat/*/cab.urdf")).read_text()
    text = text.replace("<joint ", '<joint wobble="1" ', 1).replace("<axis ", "<spring/><axis ", 1)
    path = tmp_path / "a.urdf"
    path.write_text(text)
    (note,) = [w for w in open_asset(path).warnings if w.startswith("ignored")]
    assert "'wobble'" in note and "<spring>" in note


def test_poses_of_sdf_are_read_as_they_are_written() -> None:
    (path,) = FILES.glob("sdf_pose_attributes/*/room.sdf")
    by_id = {o.id: o.world_from_object for o in read_scene(path).objects}
    quarter = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    for name in ("cabinet_a", "cabinet_b", "cabinet_c"):
        assert by_id[name][:3, :3] == pytest.approx(np.array(quarter), abs=1e-6)
    assert by_id["cabinet_d"][:3, 3] == pytest.approx([7, 10, 0])


def test_a_urdf_of_any_name_is_found() -> None:
    (path,) = FILES.glob("sdf_include_urdf_name/*/room.sdf")
    found = index_assets([path.parent]).find("models/Cabinet/cab.urdf")
    assert found is not None and found.name == "cab.urdf"
