import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from model.core.articulated_object import ArticulatedObject, Inertial, Part
from model.core.errors import ConfigurationError, InputFileError
from model.core.geometry import Mesh, PointCloud
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.physics.inertia import (
    MIN_MASS,
    MIN_RADIUS,
    PartMaterial,
    hull_inertial,
    inertial_problems,
    inertials_of,
    read_materials,
)


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


@settings(max_examples=200)
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


WOOD = PartMaterial(600.0, 0.012)


def of_material(body: trimesh.Trimesh, material: PartMaterial = WOOD):
    part = Part("link_0", Mesh(np.asarray(body.vertices), np.asarray(body.faces)))
    obj = ArticulatedObject("x", (part,), KinematicTree(("link_0",)))
    return inertials_of(obj, material_of=lambda _: material)["link_0"]


def test_a_board_is_solid_and_a_large_block_is_hollow():
    board = trimesh.creation.box((1.0, 0.5, 0.02)).apply_translation([3, 2, 1])
    found = of_material(board)
    assert found.mass == pytest.approx(600 * 0.01)
    np.testing.assert_allclose(found.center, [3, 2, 1], atol=1e-9)
    wanted = 6.0 * np.array([0.5**2 + 0.02**2, 1 + 0.02**2, 1 + 0.5**2]) / 12
    np.testing.assert_allclose(np.diag(found.tensor), wanted, rtol=1e-3)
    block = trimesh.creation.box((1, 1, 1))
    found = of_material(block)
    assert found.mass == pytest.approx(600 * 6 * 0.012)
    # A thin cubic shell: 5/18 of the mass times the edge squared.
    np.testing.assert_allclose(np.diag(found.tensor), 5 / 18 * found.mass, rtol=1e-3)


def test_an_open_sheet_weighs_its_area_and_one_of_two_sides_no_more():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    one = of_material(trimesh.Trimesh(square, faces, process=False))
    both = np.concatenate([faces, faces[:, ::-1]])
    two = of_material(trimesh.Trimesh(square, both, process=False))
    assert one.mass == pytest.approx(7.2) and two.mass == pytest.approx(7.2)


@settings(max_examples=100)
@given(points=points, flat=st.sampled_from([(1, 1, 1), (1, 1, 0), (1, 0, 0), (1e-4, 1, 1)]))
def test_whatever_the_mesh_its_mass_is_valid(points, flat):
    at = np.array(points) * flat
    faces = np.random.default_rng(0).integers(0, len(at), (6, 3))
    found = of_material(trimesh.Trimesh(at, faces, process=False))
    assert inertial_problems({"link_0": found}) == [] and found.mass >= MIN_MASS


def test_invalid_inertia_is_named():
    thin = Inertial(1.0, np.zeros(3), np.diag([1.0, 1.0, 3.0]))
    assert "triangle" in inertial_problems({"a": thin})[0]
    assert "above 0" in inertial_problems({"a": Inertial(0.0, np.zeros(3), np.eye(3))})[0]


def test_the_table_knows_parts_categories_and_a_default(tmp_path):
    table = read_materials()
    box = Mesh(trimesh.creation.box().vertices, trimesh.creation.box().faces)
    glass = table.of(Part("a", box, name="glass_door"), "Oven")
    assert glass == table.materials["glass"]
    assert table.of(Part("a", box, name="door"), "oven") == table.materials["metal"]
    assert table.of(Part("a", box), None) == table.materials[table.default]
    assert table.only("paper").of(Part("a", box, name="glass"), "Oven").density == 700
    assert table.with_density(5).of(Part("a", box), "Oven").density == 5
    with pytest.raises(ConfigurationError, match="wood"):
        table.only("unobtainium")
    path = tmp_path / "mine.json"
    named = '{{"materials": {}, "default": "a"}}'
    heavy = '{"a": {"density": -1, "thickness": 1}}'
    for text in ("{", "{}", named.format(heavy), named.format("{}")):
        path.write_text(text)
        with pytest.raises(InputFileError, match=r"mine\.json"):
            read_materials(path)
