"""Welding, adjacency and shells hold on meshes whose vertices are doubled."""

import numpy as np
import pytest
import trimesh

from model.core.geometry import Mesh
from model.geometry.sampling import corner_normals
from model.geometry.topology import connected_shells, face_adjacency, same_points, weld


def soup(mesh: trimesh.Trimesh) -> Mesh:
    """Every face with vertices of its own, as textured meshes have them."""
    return Mesh(
        np.asarray(mesh.triangles).reshape(-1, 3),
        np.arange(3 * len(mesh.faces), dtype=np.int32).reshape(-1, 3),
    )


def test_same_points_agrees_with_unique(rng: np.random.Generator) -> None:
    points = rng.integers(0, 4, (500, 3)) * 0.1 * np.array([1.0, -1.0, 1.0])
    first, inverse = same_points(points)
    np.testing.assert_array_equal(points[first][inverse], points)
    assert len(first) == len(np.unique(points + 0.0, axis=0))


def test_weld_joins_what_is_near(rng: np.random.Generator) -> None:
    box = soup(trimesh.creation.box())
    assert len(np.unique(weld(box))) == 8
    shaken = Mesh(box.vertices + rng.uniform(-2e-7, 2e-7, box.vertices.shape), box.faces)
    assert len(np.unique(weld(shaken))) == 8
    assert len(np.unique(weld(shaken, tolerance=0))) == 36


def test_box_edges_are_convex_right_angles() -> None:
    found = face_adjacency(soup(trimesh.creation.box()))
    assert len(found.pairs) == 18 and (found.pairs[:, 0] < found.pairs[:, 1]).all()
    sharp = found.angle > 0.1
    assert sharp.sum() == 12
    np.testing.assert_allclose(found.angle[sharp], np.pi / 2, atol=1e-6)
    assert found.convex.all()
    np.testing.assert_allclose(found.length[sharp], 1, atol=1e-6)


@pytest.mark.parametrize("flipped", [False, True])
def test_concave_edges_are_told_whatever_the_winding_of_a_face(flipped: bool) -> None:
    """An L: the floor and the wall meet concavely as seen from above."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 1.0]]) + 0.0
    faces = np.array([[0, 1, 2], [1, 0, 3]], np.int32)
    if flipped:
        faces[1] = faces[1, ::-1]
    found = face_adjacency(Mesh(vertices, faces))
    assert len(found.pairs) == 1 and not found.convex[0]
    assert found.angle[0] == pytest.approx(np.pi / 2, abs=1e-6)


def test_adjacency_agrees_with_trimesh() -> None:
    sphere = trimesh.creation.icosphere(2)
    found = face_adjacency(Mesh(sphere.vertices, sphere.faces.astype(np.int32)))
    want = {tuple(sorted(p)) for p in sphere.face_adjacency.tolist()}
    assert {tuple(p) for p in found.pairs.tolist()} == want
    assert found.convex.all()


def test_shells_of_a_pile(rng: np.random.Generator) -> None:
    pieces = [trimesh.creation.box(transform=np.eye(4)) for _ in range(200)]
    for i, piece in enumerate(pieces):
        piece.apply_translation((3 * i, 0, 0))
    mesh = soup(trimesh.util.concatenate(pieces))
    shell = connected_shells(mesh)
    np.testing.assert_array_equal(shell, np.repeat(np.arange(200), 12))
    order = rng.permutation(len(mesh.faces))
    mixed = connected_shells(Mesh(mesh.vertices, mesh.faces[order]))
    # The same partition, numbered by first face.
    assert len(set(zip(mixed.tolist(), shell[order].tolist(), strict=True))) == 200
    assert (np.diff(np.unique(mixed, return_index=True)[1]) > 0).all()


def test_no_faces() -> None:
    empty = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    assert len(connected_shells(empty)) == len(face_adjacency(empty).pairs) == len(weld(empty)) == 0


def test_shading_is_smooth_on_balls_and_sharp_on_boxes() -> None:
    group, normals = corner_normals(soup(trimesh.creation.box()))
    assert len(normals) == 24 and len(np.unique(group)) == 24  # three at each corner
    sphere = trimesh.creation.icosphere(3)
    mesh = soup(sphere)
    group, normals = corner_normals(mesh)
    assert len(normals) == len(sphere.vertices)
    radial = np.einsum("ij,ij->i", normals[group.reshape(-1)], mesh.vertices)
    assert radial.min() > 0.999
