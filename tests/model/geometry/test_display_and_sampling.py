"""Light copies stand for the whole; samples are spread by area and coloured as the surface is."""

import time

import numpy as np
import pytest
import trimesh

from model.core.asset import Asset
from model.core.errors import GeometryError
from model.core.geometry import Material, Mesh, PointCloud
from model.geometry.display import display_asset, thin
from model.geometry.sampling import sample_surface


def test_small_assets_are_shown_as_they_are(textured: Mesh, cloud: PointCloud) -> None:
    shown = display_asset(Asset("m", mesh=textured))
    assert shown.mesh is textured
    np.testing.assert_array_equal(shown.element, np.arange(12))
    assert display_asset(Asset("c", cloud=cloud)).cloud is cloud


def test_large_mesh_keeps_shape_colour_and_correspondence() -> None:
    sphere = trimesh.creation.icosphere(6)  # 82k faces
    colors = np.column_stack([(sphere.vertices + 1) * 127, np.full(len(sphere.vertices), 255)])
    mesh = Mesh(
        sphere.vertices, sphere.faces.astype(np.int32), vertex_colors=colors.astype(np.uint8)
    )
    shown = display_asset(Asset("s", mesh=mesh), most=10_000)
    assert shown.mesh is not None and 5_000 < len(shown.mesh.faces) <= 10_000
    assert len(shown.element) == len(shown.mesh.faces)
    assert shown.mesh.face_areas.sum() == pytest.approx(mesh.face_areas.sum(), rel=0.05)
    here, there = shown.mesh.triangles.mean(1), mesh.triangles.mean(1)[shown.element]
    assert np.linalg.norm(here - there, axis=1).max() < 0.1
    assert shown.mesh.vertex_colors is not None
    want = (shown.mesh.vertices + 1) * 127
    assert np.abs(shown.mesh.vertex_colors[:, :3] - want).max() < 12
    again = display_asset(Asset("s", mesh=mesh), most=10_000)
    np.testing.assert_array_equal(again.element, shown.element)


def test_decimated_textures_become_vertex_colours(checker: object) -> None:
    grid = trimesh.creation.box((1, 1, 0.001)).subdivide_to_size(0.02, max_iter=10)
    vertices, faces = np.asarray(grid.vertices), np.asarray(grid.faces, np.int32)
    uv = (vertices[:, :2] + 0.5).astype(np.float32)
    mesh = Mesh(vertices, faces, materials=(Material("t", (255,) * 4, checker),), uv=uv)  # type: ignore[arg-type]
    shown = display_asset(Asset("g", mesh=mesh), most=2000).mesh
    assert shown is not None and shown.vertex_colors is not None
    corner = shown.vertex_colors[
        np.argmin(np.linalg.norm(shown.vertices - (-0.25, 0.25, 0), axis=1))
    ]
    assert corner[0] > 200 and corner[1] < 60 and corner[2] < 60  # red is above on the left


@pytest.mark.parametrize("kind", ["surface", "volume", "line", "outlier", "same"])
def test_thinning_is_even_and_bounded(kind: str, rng: np.random.Generator) -> None:
    points = rng.random((60_000, 3)).astype(np.float32)
    if kind == "surface":
        points[:, 2] = 0
    elif kind == "line":
        points[:, 1:] = 0
    elif kind == "outlier":
        points[0] = 1e6
    elif kind == "same":
        points[:] = 1
    index = thin(points, 5000)
    assert len(index) <= 5000 and len(np.unique(index)) == len(index)
    assert len(index) >= 1500
    np.testing.assert_array_equal(index, thin(points, 5000))
    if kind == "surface":
        from scipy.spatial import KDTree

        gap = KDTree(points[index]).query(points)[0].max()
        assert gap < 0.05  # no hole anywhere


def test_a_million_points_and_faces_are_quick() -> None:
    points = np.random.default_rng(0).random((1_000_000, 3)).astype(np.float32)
    points[:, 2] = 0
    began = time.process_time()
    shown = display_asset(Asset("c", cloud=PointCloud(points)))
    assert len(shown.element) <= 150_000 and time.process_time() - began < 5


def test_samples_are_spread_by_area(rng: np.random.Generator) -> None:
    box = trimesh.creation.box((1, 2, 4))
    mesh = Mesh(np.asarray(box.vertices), np.asarray(box.faces, np.int32))
    cloud, face = sample_surface(mesh, 10_000, rng)
    want = mesh.face_areas / mesh.face_areas.sum() * 10_000
    assert np.abs(np.bincount(face, minlength=12) - want).max() <= 1.0 + 1e-9
    off = np.einsum("ij,ij->i", cloud.points - mesh.triangles[face][:, 0], mesh.face_normals[face])
    assert np.abs(off).max() < 1e-6
    np.testing.assert_allclose(cloud.points.mean(0), 0, atol=0.03)
    assert cloud.normals is not None
    np.testing.assert_allclose(cloud.normals, mesh.face_normals[face], atol=1e-6)
    same, _ = sample_surface(mesh, 100, np.random.default_rng(1))
    other, _ = sample_surface(mesh, 100, np.random.default_rng(1))
    np.testing.assert_array_equal(same.points, other.points)


def test_sample_colours_come_from_texture_and_base(
    textured: Mesh, rng: np.random.Generator
) -> None:
    cloud, face = sample_surface(textured, 6000, rng)
    assert cloud.colors is not None
    np.testing.assert_array_equal(
        cloud.colors[face >= 6], [[240, 120, 30]] * int((face >= 6).sum())
    )
    painted = cloud.colors[face < 6].astype(int)
    # Corners at the middles of blue (0, 0), white (1, 0) and green (1, 1), red opposite at (0, 1):
    # with bilinear weights, the means over this triangle are E[x+y-2xy], E[x] and E[1-y].
    np.testing.assert_allclose(painted.mean(axis=0), [255 / 2, 255 * 2 / 3, 255 * 2 / 3], atol=3)


def test_nothing_to_sample(rng: np.random.Generator, ball: Mesh) -> None:
    flat = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32))
    with pytest.raises(GeometryError, match="without area"):
        sample_surface(flat, 10, rng)
    with pytest.raises(GeometryError, match="at least one"):
        sample_surface(ball, 0, rng)
