import numpy as np
import pytest
import trimesh

from model.core.articulated_object import Part
from model.core.errors import GeometryError
from model.core.geometry import Mesh, PointCloud
from model.kinematics.contact import contact_between, contact_tolerance, contacts


def box(link: str, low, high, cloud: bool = False) -> Part:
    mesh = trimesh.creation.box(bounds=[low, high])
    if cloud:
        points, _ = trimesh.sample.sample_surface(mesh, 6000, seed=0)
        return Part(link, cloud=PointCloud(np.asarray(points, np.float32)))
    return Part(link, Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces)))


@pytest.mark.parametrize("cloud", [False, True])
def test_a_door_touches_its_frame_along_the_hinge(cloud):
    post = box("post", [-0.1, 0, 0], [0, 0.1, 2], cloud)
    door = box("door", [0.003, 0, 0], [0.8, 0.02, 2], cloud)
    found = contact_between(post, door)
    assert found.touches
    assert found.distance == pytest.approx(0.003, abs=0.003 if cloud else 1e-6)
    line = found.line
    np.testing.assert_allclose(np.abs(line.direction), [0, 0, 1], atol=0.03)
    assert line.length == pytest.approx(2, abs=0.1)
    assert line.linearity > 0.95
    np.testing.assert_allclose(line.point, [0, 0.01, 1], atol=0.06)
    assert 0 < found.share_b < 0.2


def test_only_pairs_that_touch_are_listed_in_the_order_of_the_parts():
    parts = [
        box("c", [2, 0, 0], [3, 1, 1]),
        box("a", [0, 0, 0], [1, 1, 1]),
        box("b", [1, 0, 0], [2, 1, 1]),
        box("far", [5, 5, 5], [6, 6, 6]),
    ]
    assert [(c.a, c.b) for c in contacts(parts)] == [("c", "b"), ("a", "b")]


def test_the_tolerance_decides():
    a, b = box("a", [0, 0, 0], [1, 1, 1]), box("b", [1.05, 0, 0], [2, 1, 1])
    assert not contact_between(a, b).touches
    assert contact_between(a, b, 0.06).touches
    assert contact_between(a, b).distance == pytest.approx(0.05, abs=1e-6)
    assert contacts([a, b], 0.06)[0].distance == pytest.approx(0.05, abs=1e-6)
    with pytest.raises(GeometryError, match="don't touch"):
        _ = contact_between(a, b, 0.01).line


def test_a_flat_contact_is_no_line():
    lid = box("lid", [0, 0, 1], [1, 1, 1.1])
    found = contact_between(box("pot", [0, 0, 0], [1, 1, 1]), lid)
    assert found.line.linearity < 0.3
    np.testing.assert_allclose(found.centroid, [0.5, 0.5, 1], atol=0.03)


def test_a_sparse_cloud_gets_a_wider_tolerance():
    dense, sparse = box("a", [0, 0, 0], [1, 1, 1], True), box("b", [0, 0, 0], [1, 1, 1], True)
    assert sparse.cloud is not None
    sparse = Part("b", cloud=sparse.cloud.take(np.arange(0, 6000, 60)))
    assert contact_tolerance([sparse]) > 3 * contact_tolerance([dense])


def test_size_plays_no_part():
    for scale in (1e-3, 1e3):
        a = box("a", [0, 0, 0], [scale, scale, scale])
        b = box("b", [scale, 0, 0], [2 * scale, scale, scale])
        assert contact_between(a, b).line.length == pytest.approx(np.sqrt(2) * scale, rel=0.3)


def test_a_part_without_geometry_is_named():
    empty = Part("nothing", Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)))
    with pytest.raises(GeometryError, match="nothing"):
        contact_between(box("a", [0, 0, 0], [1, 1, 1]), empty)
    assert contacts([empty, box("a", [0, 0, 0], [1, 1, 1])]) == ()
