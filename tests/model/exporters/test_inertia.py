from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from model.exporters.inertia import MIN_MASS, MIN_RADIUS, hull_inertial, inertials_of
from model.geometry.mesh import Mesh
from model.geometry.point_cloud import PointCloud
from model.kinematics.articulated_object import ArticulatedObject, Part
from model.kinematics.joint import Joint
from model.kinematics.tree import KinematicTree


@pytest.mark.parametrize("seed", range(4))
def test_a_convex_body_has_the_inertia_that_trimesh_finds(seed):
    rng = np.random.default_rng(seed)
    body = trimesh.convex.convex_hull(rng.normal(size=(60, 3)) * [1, 0.3, 0.1] + rng.normal(size=3))
    found = hull_inertial(body.vertices, density=500)
    assert found.mass == pytest.approx(500 * body.volume)
    np.testing.assert_allclose(found.center, body.center_mass, atol=1e-9)
    ball = np.eye(3) * 0.4 * found.mass * MIN_RADIUS**2
    np.testing.assert_allclose(found.tensor, 500 * body.moment_inertia + ball, rtol=1e-6, atol=1e-9)


def test_a_body_whose_box_has_its_middle_outside():
    corner = trimesh.convex.convex_hull([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    found = hull_inertial(corner.vertices, density=1)
    assert found.mass == pytest.approx(1 / 6)
    np.testing.assert_allclose(found.center, [0.25, 0.25, 0.25])
    np.testing.assert_allclose(found.tensor, corner.moment_inertia, atol=1e-6)


def test_a_box_of_known_size():
    box = trimesh.creation.box((1, 2, 3)).vertices + np.array([5, 6, 7])
    found = hull_inertial(box, density=10)
    assert found.mass == pytest.approx(60)
    np.testing.assert_allclose(found.center, [5, 6, 7])
    np.testing.assert_allclose(np.diag(found.tensor), [65, 50, 25], rtol=1e-4)


points = st.lists(
    st.tuples(*[st.floats(-10, 10, allow_subnormal=False)] * 3), min_size=1, max_size=12
)


@settings(max_examples=200, deadline=None)
@given(
    points=points, flat=st.sampled_from([(1, 1, 1), (1, 1, 0), (1, 0, 0), (0, 0, 0), (1e-4, 1, 1)])
)
def test_whatever_the_points_the_inertia_is_valid(points, flat):
    found = hull_inertial(np.array(points) * flat)
    assert found.mass >= MIN_MASS
    assert np.isfinite(found.center).all()
    a, b, c = np.linalg.eigvalsh(found.tensor)
    assert a > 0
    assert a + b >= c * (1 - 1e-9)


def test_every_link_but_a_bare_root_has_mass():
    box = trimesh.creation.box()
    tree = KinematicTree(
        ("base", "helper", "link_0", "link_1"),
        (
            Joint("a", "continuous", "base", "helper", origin=(1, 2, 3)),
            Joint("b", "prismatic", "helper", "link_0", lower=0, upper=1),
            Joint("c", "fixed", "link_0", "link_1"),
        ),
    )
    cloud = PointCloud(np.random.default_rng(0).random((50, 3), np.float32))
    parts = (Part("link_0", Mesh(box.vertices, box.faces)), Part("link_1", cloud=cloud))
    found = inertials_of(ArticulatedObject("x", parts, tree))
    assert set(found) == {"helper", "link_0", "link_1"}
    np.testing.assert_allclose(found["helper"].center, [1, 2, 3])
