"""Normals and surfaces of clouds."""

import numpy as np
import pytest
import trimesh

from model.core.errors import GeometryError
from model.core.geometry import PointCloud
from model.geometry.reconstruct import mesh_from_cloud
from model.geometry.sampling import estimate_normals


def sampled(shape: trimesh.Trimesh, count: int) -> tuple[PointCloud, np.ndarray]:
    points, face = trimesh.sample.sample_surface(shape, count, seed=2)
    return PointCloud(np.asarray(points, np.float32)), shape.face_normals[face]


@pytest.mark.parametrize("shape", ["box", "ball", "plate"])
def test_normals_point_outwards(shape: str) -> None:
    made = {
        "box": trimesh.creation.box((1, 0.6, 2)),
        "ball": trimesh.creation.icosphere(3),
        "plate": trimesh.creation.box((1, 0.05, 1)),
    }[shape]
    cloud, truth = sampled(made, 8000)
    got = estimate_normals(cloud).normals
    assert got is not None
    cosine = np.einsum("ij,ij->i", got, truth)
    assert (cosine > 0).mean() > 0.97
    assert np.median(cosine) > 0.98
    np.testing.assert_allclose(np.linalg.norm(got, axis=1), 1, atol=1e-5)


def test_surface_of_a_box_with_its_colours() -> None:
    cloud, _ = sampled(trimesh.creation.box((1, 0.6, 2)), 8000)
    colors = np.where(cloud.points[:, 2:] > 0, [[200, 30, 30]], [[30, 30, 200]]).astype(np.uint8)
    mesh = mesh_from_cloud(PointCloud(cloud.points, None, colors))
    assert mesh.face_areas.sum() == pytest.approx(7.6, rel=0.05)
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces)
    assert solid.volume == pytest.approx(1.2, rel=0.05)  # its triangles face outwards
    assert mesh.vertex_colors is not None
    above = mesh.vertices[:, 2] > 0.1
    assert (mesh.vertex_colors[above, 0] > 150).all()
    np.testing.assert_allclose(mesh.bounds, [[-0.5, -0.3, -1], [0.5, 0.3, 1]], atol=0.04)


def test_open_surface_is_not_closed() -> None:
    """Half a ball stays half a ball: nothing is made up where nothing was seen."""
    cloud, _ = sampled(trimesh.creation.icosphere(4), 20_000)
    half = cloud.take(cloud.points[:, 1] < 0)
    mesh = mesh_from_cloud(half)
    assert mesh.vertices[:, 1].max() < 0.12
    assert mesh.face_areas.sum() == pytest.approx(2 * np.pi, rel=0.1)


@pytest.mark.parametrize("count", [4, 12, 60, 200])
def test_few_points_still_give_a_surface(count: int) -> None:
    cloud, _ = sampled(trimesh.creation.icosphere(3), count)
    mesh = mesh_from_cloud(cloud)
    assert len(mesh.faces) >= 4 and np.isfinite(mesh.vertices).all()


def test_flat_clouds(rng: np.random.Generator) -> None:
    points = rng.random((500, 3)).astype(np.float32)
    points[:, 1] = 0.3
    mesh = mesh_from_cloud(PointCloud(points))
    assert mesh.face_areas.sum() == pytest.approx(1, rel=0.1)
    np.testing.assert_allclose(mesh.vertices[:, 1], 0.3, atol=1e-6)


def test_what_spans_no_surface() -> None:
    three = PointCloud(np.eye(3, dtype=np.float32))
    with pytest.raises(GeometryError, match="4 points or more"):
        mesh_from_cloud(three)
    line = np.outer(np.arange(20), [1, 2, 3]).astype(np.float32)
    for points in (line, np.ones((20, 3), np.float32)):
        with pytest.raises(GeometryError, match="one line"):
            mesh_from_cloud(PointCloud(points))
    with pytest.raises(GeometryError, match="at least 3"):
        estimate_normals(PointCloud(np.zeros((2, 3), np.float32)))
