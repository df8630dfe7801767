"""Faces split along planes: the surface stays what it was."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from model.core.errors import GeometryError
from model.core.geometry import Mesh
from model.geometry.splitting import Plane, share_crossed, split_faces
from tests.builders import spans


def _box(scale: float = 1.0) -> Mesh:
    box = trimesh.creation.box((scale, scale, scale))
    return Mesh(box.vertices, box.faces)


def _textured() -> Mesh:
    """A unit square of two triangles with a seam along the diagonal: six vertices, u = x, v = y."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    colors = np.concatenate([255 * corners[:, :2], np.full((6, 2), 255)], 1).astype(np.uint8)
    uv = corners[:, :2].astype(np.float32)
    return Mesh(corners, np.arange(6).reshape(2, 3), uv=uv, vertex_colors=colors)


def _unit(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (vector / np.linalg.norm(vector)).tolist()
    return (x, y, z)


def _solid(mesh: Mesh) -> trimesh.Trimesh:
    out = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    out.merge_vertices()
    return out


@settings(max_examples=60)
@given(st.tuples(*[st.floats(-1, 1)] * 3), st.floats(-0.6, 0.6), st.integers(0, 2**12 - 1))
def test_a_closed_box_stays_closed_whatever_is_cut(normal, offset, chosen):
    normal = np.array(normal)
    if np.linalg.norm(normal) < 0.1:
        return
    mesh = _box()
    n = _unit(normal)
    plane = Plane((offset * n[0], offset * n[1], offset * n[2]), n)
    split = split_faces(mesh, np.array([chosen >> k & 1 for k in range(12)], bool), [plane])
    solid = _solid(split.mesh)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(1.0)
    assert (np.diff(split.parent) >= 0).all()
    area = np.bincount(split.parent, split.mesh.face_areas, 12)
    np.testing.assert_allclose(area, mesh.face_areas, rtol=1e-9)
    # No face that was chosen lies on both sides.
    own = np.array([chosen >> k & 1 for k in range(12)], bool)[split.parent]
    apart = plane.distance(split.mesh.vertices)[split.mesh.faces]
    assert not ((apart.min(1) < -1e-4) & (apart.max(1) > 1e-4))[own].any()
    middle = plane.distance(split.mesh.triangles.mean(1))
    assert split.inside[own & (middle > 1e-4)].all()
    assert not split.inside[own & (middle < -1e-4)].any()
    assert not split.inside[~own].any()


def test_a_rectangle_is_cut_out_exactly():
    mesh = _box(2.0)
    front = np.asarray(mesh.face_normals)[:, 1] < -0.5
    sides = spans("-.5 -1 0 1 0 0  .25 -1 0 -1 0 0  0 -1 -.75 0 0 1  0 -1 .5 0 0 -1")
    split = split_faces(mesh, front, [Plane(p, n) for p, n in sides])  # type: ignore[arg-type]
    assert split.mesh.face_areas[split.inside].sum() == pytest.approx(0.75 * 1.25)
    cut = split.mesh.triangles[split.inside].reshape(-1, 3)
    np.testing.assert_allclose(cut.min(0), [-0.5, -1, -0.75], atol=1e-9)
    np.testing.assert_allclose(cut.max(0), [0.25, -1, 0.5], atol=1e-9)
    assert _solid(split.mesh).is_watertight


def test_texture_and_colours_are_interpolated_over_a_seam():
    planes = [Plane((0.3, 0, 0), (1, 0, 0)), Plane((0, 0.5, 0), (0, 1, 0))]
    split = split_faces(_textured(), np.array([True, False]), planes)
    mesh = split.mesh
    assert mesh.uv is not None and mesh.vertex_colors is not None
    np.testing.assert_allclose(mesh.uv, mesh.vertices[:, :2], atol=1e-6)
    np.testing.assert_allclose(mesh.vertex_colors[:, :2], 255 * mesh.vertices[:, :2], atol=1)
    # The other triangle has the new vertices of the diagonal too: no crack opens there.
    edge = np.isclose(mesh.vertices[:, 0], mesh.vertices[:, 1])
    places, counts = np.unique(mesh.vertices[edge].round(9), axis=0, return_counts=True)
    assert len(places) == 4 and (counts == 2).all()


def test_vertices_on_the_plane_make_no_slivers():
    split = split_faces(_box(), np.ones(12, bool), [Plane((0.5 - 1e-7, 0, 0), (1, 0, 0))])
    assert len(split.mesh.faces) == 12
    assert split.inside.sum() == 2  # those on the plane


def test_coarse_faces_are_told_from_fine_ones():
    plane = [Plane((0.1, 0, 0), (1, 0, 0))]
    assert share_crossed(_box(), np.ones(12, bool), plane) > 0.5
    sphere = trimesh.creation.icosphere(6)
    fine = Mesh(sphere.vertices, sphere.faces)
    assert share_crossed(fine, np.ones(len(fine.faces), bool), plane) < 0.02
    assert share_crossed(_box(), np.zeros(12, bool), plane) == 0.0


def test_bad_planes_and_choices_are_told():
    with pytest.raises(GeometryError, match="length 1"):
        Plane((0, 0, 0), (0, 0, 2))
    with pytest.raises(GeometryError, match="finite"):
        Plane((0, 0, float("nan")), (0, 0, 1))
    with pytest.raises(GeometryError, match="12 entries"):
        split_faces(_box(), np.ones(3, bool), [])
