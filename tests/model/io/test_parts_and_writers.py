"""Cutting loses nothing; what is written is what was meant, to the byte."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from model.core.asset import Asset
from model.core.errors import ConfigurationError, GeometryError, InputFileError
from model.core.geometry import Material, Mesh, PointCloud
from model.core.textures import encode
from model.geometry.sampling import face_colors
from model.geometry.splitting import split
from model.io.open_asset import open_asset
from model.io.write import face_order, mesh_to_glb, write_cloud, write_mesh
from tests.builders import read_glb


@settings(max_examples=40, deadline=None)
@given(st.lists(st.integers(-1, 5), min_size=80, max_size=80), st.integers(0, 3))
def test_every_face_is_in_exactly_one_part(labels: list[int], seed: int) -> None:
    sphere = trimesh.creation.icosphere(1)
    rng = np.random.default_rng(seed)
    mesh = Mesh(
        sphere.vertices * rng.uniform(0.1, 10),
        sphere.faces.astype(np.int32),
        rng.integers(0, 3, 80).astype(np.int32),
        tuple(Material(n) for n in "abc"),
    )
    parts = split(Asset("s", mesh=mesh), np.array(labels), {1: "door"})
    merged = np.maximum(labels, 0)
    assert [p.link for p in parts] == [f"link_{i}" for i in np.unique(merged)]
    for part in parts:
        index = int(part.link.removeprefix("link_"))
        assert part.mesh is not None and part.name == ("door" if index == 1 else None)
        np.testing.assert_array_equal(part.mesh.triangles, mesh.triangles[merged == index])
        names = [part.mesh.materials[m].name for m in part.mesh.face_material]
        assert names == ["abc"[m] for m in mesh.face_material[merged == index]]
    total = sum(p.mesh.face_areas.sum() for p in parts if p.mesh is not None)
    assert total == pytest.approx(mesh.face_areas.sum(), abs=1e-6)


def test_clouds_are_cut_by_points(cloud: PointCloud, rng: np.random.Generator) -> None:
    labels = rng.integers(-1, 3, len(cloud))
    parts = split(Asset("c", cloud=cloud), labels)
    assert sum(len(p.cloud) for p in parts if p.cloud is not None) == len(cloud)
    assert parts[1].cloud is not None and parts[1].cloud.normals is not None
    np.testing.assert_array_equal(parts[1].cloud.points, cloud.points[labels == 1])


def test_labels_that_do_not_fit(cloud: PointCloud) -> None:
    asset = Asset("c", cloud=cloud)
    for labels in (np.zeros(3, int), np.zeros(len(cloud)), np.full(len(cloud), -2)):
        with pytest.raises(GeometryError, match="label"):
            split(asset, labels)


def test_textured_parts_share_their_texture_files(tmp_path: Path, textured: Mesh) -> None:
    parts = split(Asset("t", mesh=textured), np.array([0, 1, 2] * 4))
    for part in parts:
        assert part.mesh is not None
        write_mesh(part.mesh, tmp_path / f"{part.link}.obj")
    assert len(list(tmp_path.glob("*.png"))) == 2
    back = open_asset(tmp_path)
    assert back.mesh is not None and back.warnings == ()
    assert back.mesh.face_areas.sum() == pytest.approx(6, abs=1e-6)
    index = np.concatenate([np.arange(12)[i::3] for i in range(3)])
    np.testing.assert_allclose(back.mesh.triangles, textured.triangles[index], atol=1e-8)
    np.testing.assert_array_equal(face_colors(back.mesh), face_colors(textured)[index])


def test_photographs_are_not_compressed_again(tmp_path: Path, rng: np.random.Generator) -> None:
    Image.fromarray(rng.integers(0, 256, (16, 16, 3), np.uint8)).save(tmp_path / "p.jpg")
    (tmp_path / "m.mtl").write_text("newmtl a\nmap_Kd p.jpg\n")
    (tmp_path / "a.obj").write_text(
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl a\nf 1/1 2/2 3/3\n"
    )
    mesh = open_asset(tmp_path / "a.obj").mesh
    assert mesh is not None and mesh.materials[0].texture is not None
    original = (tmp_path / "p.jpg").read_bytes()
    assert encode(mesh.materials[0].texture) == (original, ".jpg")
    assert original in mesh_to_glb(mesh)
    smaller = mesh.materials[0].texture.resize((4, 4))
    assert encode(smaller)[0] != original  # a changed image is not the old file


@pytest.mark.parametrize("suffix", [".obj", ".glb", ".ply", ".stl"])
def test_meshes_come_back_in_place_and_the_same_bytes(
    tmp_path: Path, textured: Mesh, suffix: str
) -> None:
    path = tmp_path / f"a{suffix}"
    files = write_mesh(textured, path)
    assert files[0] == path and all(f.is_file() for f in files)
    first = [f.read_bytes() for f in files]
    assert [f.read_bytes() for f in write_mesh(textured, path)] == first
    back = open_asset(path, up_axis="z" if suffix == ".obj" else None).mesh
    assert back is not None
    key, other = (np.sort(np.round(m.triangles.mean(1), 5), axis=0) for m in (back, textured))
    np.testing.assert_allclose(key, other, atol=1e-5)


def test_vertex_colours_come_back(tmp_path: Path, ball: Mesh, rng: np.random.Generator) -> None:
    rgba = np.column_stack(
        [rng.integers(0, 256, (len(ball.vertices), 3)), np.full(len(ball.vertices), 255)]
    )
    mesh = Mesh(ball.vertices, ball.faces, vertex_colors=rgba.astype(np.uint8))
    want = face_colors(mesh)
    for suffix in (".obj", ".glb", ".ply"):
        write_mesh(mesh, tmp_path / f"a{suffix}")
        back = open_asset(tmp_path / f"a{suffix}").mesh
        assert back is not None
        assert np.abs(face_colors(back).astype(int) - want).max() <= 1, suffix


def test_faces_of_a_glb_come_material_by_material() -> None:
    import io

    box = trimesh.creation.box((1, 2, 3))
    materials = tuple(Material(str(c), (c, 0, 0, 255)) for c in (10, 90, 200))
    mesh = Mesh(
        np.asarray(box.vertices),
        np.asarray(box.faces, np.int32),
        materials=materials,
        face_material=(np.arange(12) * 7 % 3).astype(np.int32),
    )
    scene = trimesh.load(io.BytesIO(mesh_to_glb(mesh)), file_type="glb")
    written = np.concatenate([g.triangles for g in scene.geometry.values()])
    np.testing.assert_allclose(written, mesh.triangles[face_order(mesh)], atol=1e-6)
    # On a screen, where all is matt, the first and the last material are one.
    shiny = replace(materials[0], metallic=1.0)
    mesh = replace(mesh, materials=(*materials[:2], shiny))
    scene = trimesh.load(io.BytesIO(mesh_to_glb(mesh, matt=True)), file_type="glb")
    written = np.concatenate([g.triangles for g in scene.geometry.values()])
    np.testing.assert_allclose(written, mesh.triangles[face_order(mesh, matt=True)], atol=1e-6)
    assert not np.array_equal(face_order(mesh), face_order(mesh, matt=True))


def test_glb_is_what_other_programs_read(textured: Mesh) -> None:
    import io

    scene = trimesh.load(io.BytesIO(mesh_to_glb(textured)), file_type="glb")
    assert isinstance(scene, trimesh.Scene)
    np.testing.assert_allclose(scene.bounds, textured.bounds, atol=1e-6)  # as it is, z up
    assert scene.area == pytest.approx(6, rel=1e-6)
    kinds = {g.visual.material.name: g.visual.material for g in scene.geometry.values()}
    assert set(kinds) == {"tex", "orange"}
    assert kinds["tex"].baseColorTexture is not None
    for name, want in (("tex", (0, 0.9)), ("orange", (0.75, 0.25))):
        material = kinds[name]
        assert (material.metallicFactor, material.roughnessFactor) == pytest.approx(want)
        assert material.doubleSided
    normals = [g.vertex_normals for g in scene.geometry.values()]
    assert all(np.allclose(np.abs(n).max(axis=1), 1, atol=1e-6) for n in normals)
    turned = trimesh.load(io.BytesIO(mesh_to_glb(textured, y_up=True)), file_type="glb")
    assert turned.bounds.shape == (2, 3)


@pytest.mark.parametrize("suffix", [".obj", ".glb"])
def test_metal_and_roughness_come_back_from_cut_parts(
    tmp_path: Path, textured: Mesh, suffix: str
) -> None:
    labels = np.repeat(np.array([0, 1], np.int32), 6)
    for part in split(Asset("cube", mesh=textured), labels):
        assert part.mesh is not None
        write_mesh(part.mesh, tmp_path / f"{part.link}{suffix}")
    plain, shiny = (open_asset(tmp_path / f"link_{i}{suffix}").mesh for i in (0, 1))
    assert plain is not None and shiny is not None
    (material,) = shiny.materials
    assert (material.metallic, material.roughness) == (0.75, 0.25)
    if suffix == ".obj":  # a material that doesn't say goes on not saying
        assert plain.materials[0].metallic is None and plain.materials[0].roughness is None


def test_a_screen_shows_all_matt(textured: Mesh) -> None:
    tree, _ = read_glb(mesh_to_glb(textured, matt=True))
    assert {m["pbrMetallicRoughness"]["metallicFactor"] for m in tree["materials"]} == {0.0}


def test_glass_is_blended(textured: Mesh) -> None:
    import io

    glass = Mesh(textured.vertices, textured.faces, materials=(Material("g", (90, 90, 255, 80)),))
    scene = trimesh.load(io.BytesIO(mesh_to_glb(glass)), file_type="glb")
    (geometry,) = scene.geometry.values()
    assert geometry.visual.material.alphaMode == "BLEND"


def test_clouds_are_read_by_others(tmp_path: Path, cloud: PointCloud) -> None:
    import open3d as o3d

    write_cloud(cloud, tmp_path / "a.ply")
    first = (tmp_path / "a.ply").read_bytes()
    write_cloud(cloud, tmp_path / "a.ply")
    assert (tmp_path / "a.ply").read_bytes() == first
    other = o3d.io.read_point_cloud(str(tmp_path / "a.ply"))
    np.testing.assert_allclose(np.asarray(other.points), cloud.points, atol=1e-7)
    np.testing.assert_allclose(np.asarray(other.normals), cloud.normals, atol=1e-7)
    assert cloud.colors is not None
    np.testing.assert_allclose(np.asarray(other.colors) * 255, cloud.colors, atol=0.01)


def test_what_cannot_be_written(tmp_path: Path, ball: Mesh, cloud: PointCloud) -> None:
    with pytest.raises(ConfigurationError, match=r"\.obj, \.glb, \.ply, \.stl"):
        write_mesh(ball, tmp_path / "a.fbx")
    with pytest.raises(ConfigurationError, match=r"\.ply"):
        write_cloud(cloud, tmp_path / "a.xyz")
    with pytest.raises(GeometryError, match="without faces"):
        write_mesh(Mesh(ball.vertices, ball.faces[:0]), tmp_path / "a.obj")
    with pytest.raises(InputFileError, match="can't be written"):
        write_mesh(ball, tmp_path / "gone" / "a.stl")
