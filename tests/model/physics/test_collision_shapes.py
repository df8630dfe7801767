"""Collision shapes: hollows stay open, everything is covered, neighbours don't touch."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from model.core.articulated_object import ArticulatedObject, Part
from model.core.errors import GeometryError
from model.core.geometry import Mesh, PointCloud
from model.core.joint import Joint
from model.core.shapes import Hull, Primitive, hull_of, hull_of_shape
from model.core.tree import KinematicTree
from model.geometry import reconstruct
from model.geometry.sampling import sample_surface
from model.physics import part_mesh as surfaces_of_parts
from model.physics.collision import build
from model.physics.collision.build import CollisionSettings, collision_of, prepare_bodies
from model.physics.collision.decomposition import coacd_hulls
from model.physics.collision.measure import free_volume, overlaps_of
from model.physics.collision.narrow_phase import PosePath, overlap, overlaps
from model.physics.collision.overlap_resolution import MOST_CORNERS, resolve_overlaps
from model.physics.part_mesh import part_mesh
from model.physics.simulation_values import physics_of
from model.validation.physics import run_physics
from tests.builders import boxes, joined

WALL = 0.01


def tray(x: float = 0.4, y: float = 0.3, z: float = 0.1, w: float = WALL) -> Mesh:
    return boxes(
        ((0, 0, 0), (x, y, w)),
        ((0, 0, 0), (w, y, z)),
        ((x - w, 0, 0), (x, y, z)),
        ((0, 0, 0), (x, w, z)),
        ((0, y - w, 0), (x, y, z)),
    )


def alone(mesh: Mesh | None = None, cloud: PointCloud | None = None) -> ArticulatedObject:
    return ArticulatedObject("x", (Part("link_0", mesh, cloud),), KinematicTree(("link_0",)))


def shapes_of(mesh: Mesh, **options) -> tuple:
    return collision_of(alone(mesh), CollisionSettings(**options))["link_0"]


def inside(shapes, points) -> np.ndarray:
    return np.any([hull_of_shape(s).contains(np.atleast_2d(points)) for s in shapes], axis=0)


def test_a_tray_stays_a_tray():
    mesh = tray()
    shapes = shapes_of(mesh)
    assert len(shapes) == 5 and all(isinstance(s, Primitive) and s.kind == "box" for s in shapes)
    assert not inside(shapes, [0.2, 0.15, 0.05]).any()
    free = free_volume(alone(mesh), {"link_0": shapes})
    assert free.kept > 0.99 and free.kept_by_hull < 0.05


def test_a_tray_of_single_sheets_stays_one_too():
    sheet = boxes(((0, 0, 0), (0.4, 0.3, 0.1)))
    open_top = sheet.take_faces(np.flatnonzero(sheet.face_normals[:, 2] < 0.5))
    shapes = shapes_of(open_top)
    assert 5 <= len(shapes) <= 10
    assert free_volume(alone(open_top), {"link_0": shapes}).kept > 0.97


@pytest.mark.parametrize(
    ("body", "kind", "sizes"),
    [
        (trimesh.creation.box((0.3, 0.2, 0.1)), "box", (0.1, 0.2, 0.3)),
        (trimesh.creation.cylinder(0.05, 0.4, sections=32), "cylinder", (0.05, 0.4)),
        (trimesh.creation.icosphere(3, 0.1), "sphere", (0.1,)),
    ],
)
def test_a_primitive_is_found_whatever_its_pose(body, kind, sizes):
    turned = body.copy()
    turned.apply_transform(trimesh.transformations.rotation_matrix(0.7, [1, 2, 3]))
    turned.apply_translation([1, 2, 3])
    (shape,) = shapes_of(joined(turned))
    assert isinstance(shape, Primitive) and shape.kind == kind
    found = sorted(shape.sizes) if kind == "box" else shape.sizes
    assert found == pytest.approx(sizes, rel=0.03)
    np.testing.assert_allclose(shape.object_from_shape[:3, 3], turned.bounds.mean(0), atol=0.005)


def test_a_solid_with_a_notch_is_filled_and_the_notch_is_free():
    mesh = boxes(((0, 0, 0), (0.3, 0.3, 0.1)), ((0, 0, 0), (0.1, 0.3, 0.3)))
    shapes = shapes_of(mesh)
    assert len(shapes) <= 3
    assert inside(shapes, [[0.05, 0.15, 0.2], [0.2, 0.15, 0.05]]).all()
    assert not inside(shapes, [0.25, 0.15, 0.25]).any()


@pytest.mark.parametrize("budget", [1, 3, 12])
def test_the_budget_is_kept_and_the_surface_is_covered(budget):
    body = trimesh.creation.annulus(0.1, 0.2, 0.05)
    mesh = joined(body)
    shapes = shapes_of(mesh, max_hulls=budget, primitives=False)
    assert 1 <= len(shapes) <= budget
    points = sample_surface(mesh, 500, np.random.default_rng(0))[0].points.astype(float)
    apart = np.min([(points @ s.planes[:, :3].T + s.planes[:, 3]).max(1) for s in shapes], axis=0)
    assert apart.max() < 0.016  # 32 corners stand for a ring of 0.2 m
    assert max(len(s.vertices) for s in shapes) <= 32


def test_a_mesh_that_crosses_itself_and_one_turned_inside_out():
    cross = boxes(((0, 0.1, 0), (0.3, 0.15, 0.3)), ((0.1, 0, 0), (0.15, 0.3, 0.3)))
    third = np.arange(24)[:, None] % 3 == 0
    turned = Mesh(cross.vertices, np.where(third, cross.faces[:, ::-1], cross.faces))
    for mesh in (cross, turned):
        shapes = shapes_of(mesh)
        assert inside(shapes, [[0.02, 0.12, 0.1], [0.12, 0.02, 0.1]]).all()
        assert not inside(shapes, [0.03, 0.03, 0.1]).any()


def test_a_part_without_volume_gets_some():
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    square = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    line = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0.5, 0, 0.0]]), np.array([[0, 1, 2]]))
    for mesh in (square, line):
        (shape,) = shapes_of(mesh)
        assert hull_of_shape(shape).volume > 0 and hull_of_shape(shape).thickness >= 5e-4


def test_a_part_without_geometry_is_named():
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    with pytest.raises(GeometryError, match="link_0"):
        shapes_of(nothing)


def test_half_a_million_faces():
    side = 501
    u, v = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side), indexing="ij")
    z = np.maximum(np.abs(u - 0.5), np.abs(v - 0.5)) ** 4 * 4  # a bowl
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).reshape(-1)
    other = corner + side
    one = np.stack([corner, other, corner + 1], axis=1)
    faces = np.concatenate([one, np.stack([corner + 1, other, other + 1], axis=1)])
    mesh = Mesh(np.stack([u, v, z], axis=2).reshape(-1, 3), faces.astype(np.int32))
    assert len(mesh.faces) == 500_000
    shapes = shapes_of(mesh)
    assert len(shapes) <= 24
    assert not inside(shapes, [0.5, 0.5, 0.15]).any()


def test_a_cloud_alone_keeps_its_hollow():
    points = sample_surface(tray(), 6000, np.random.default_rng(0))[0].points
    shapes = collision_of(alone(cloud=PointCloud(points)))["link_0"]
    assert 2 <= len(shapes) <= 24
    middle = np.column_stack([np.full(40, 0.2), np.full(40, 0.15), np.linspace(0.03, 0.1, 40)])
    assert not inside(shapes, middle).any()


# parts that touch


def chest(gap: float = 0.0) -> ArticulatedObject:
    body = boxes(
        ((0, 0, 0), (0.4, 0.3, WALL)),
        ((0, 0, 0.2), (0.4, 0.3, 0.2 + WALL)),
        ((0, -WALL, 0), (0.4, 0, 0.2)),
        ((0, 0.3, 0), (0.4, 0.3 + WALL, 0.2)),
        ((-WALL, 0, 0), (0, 0.3, 0.2)),
    )
    inner = tray(0.4 - gap, 0.3 - 2 * gap, 0.15)
    moved = Mesh(inner.vertices + [gap, gap, WALL + gap], inner.faces)
    tree = KinematicTree(
        ("link_0", "link_1"),
        (Joint("slide", "prismatic", "link_0", "link_1", (1, 0, 0), (0, 0, 0), 0, 0.3),),
    )
    return ArticulatedObject("chest", (Part("link_0", body), Part("link_1", moved)), tree)


@pytest.mark.parametrize("gap", [0.0, -0.002, 0.003])
def test_a_drawer_without_a_gap_gets_one(gap):
    obj = chest(gap)
    before = collision_of(obj, CollisionSettings(resolve_overlaps=False))
    after = collision_of(obj)
    assert (overlaps_of(obj, before).at_rest > 1e-4) == (gap < 0)
    met = overlaps_of(obj, after)
    assert met.at_rest == 0 and met.links_at_rest == ()
    assert met.over_range["slide"] == 0
    assert free_volume(obj, after).kept > 0.97
    assert not inside(after["link_1"], [0.2, 0.15, 0.1]).any()


def test_a_drawer_that_shares_faces_with_its_chest_slides_in_the_simulator():
    pytest.importorskip("mujoco")
    obj = chest(0.0)
    said = run_physics(obj, physics_of(obj))
    assert said.ran and said.shapes and not said.missed


def test_what_is_cut_at_many_angles_stays_a_body_with_few_corners():
    """A square peg is rounded until it turns in a narrow frame; each cut adds corners."""
    bars = [box_hull((-0.2, -0.2), (-0.055, 0.2)), box_hull((0.055, -0.2), (0.2, 0.2))]
    peg = box_hull((-0.05, -0.05), (0.05, 0.05))
    joint = Joint("turn", "revolute", "link_0", "link_1", (0, 0, 1), (0, 0, 0), 0.0, 3.0)
    tree = KinematicTree(("link_0", "link_1"), (joint,))
    bodies = {"link_0": bars, "link_1": [peg]}
    after = resolve_overlaps(bodies, tree, 0.5, lambda _: (-np.inf, np.inf), frozenset({"link_0"}))
    [rounded] = after["link_1"]
    assert len(rounded.vertices) <= MOST_CORNERS
    assert 0.75 * peg.volume < rounded.volume < 0.95 * peg.volume
    for q in np.linspace(0, 3, 31):
        turned = rounded.moved(tree.pose({"turn": float(q)})["link_1"])
        for bar in bars:
            met = overlap(bar, turned)
            assert met is None or met.depth < 2e-4


def box_hull(low: tuple[float, float], high: tuple[float, float]) -> Hull:
    corners = [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (0, 0.1)]
    found = hull_of(np.array(corners, float))
    assert found is not None
    return found


def telescope(reach: float, give_way: bool = False) -> ArticulatedObject:
    """A tube on a foot, closed above but for a hole, and a rod with a head in it that goes up."""
    tube = trimesh.creation.annulus(0.05, 0.06, 0.3)
    foot = trimesh.creation.box(bounds=[[-0.2, -0.2, -0.17], [0.2, 0.2, -0.15]])
    brim = trimesh.creation.annulus(0.02, 0.06, 0.02)
    brim.apply_translation([0, 0, 0.16])
    rod = trimesh.creation.cylinder(0.015, 0.4)
    rod.apply_translation([0, 0, 0.08])
    head = trimesh.creation.cylinder(0.045, 0.03)
    head.apply_translation([0, 0, -0.1])
    parts = []
    for i, pieces in enumerate(((tube, foot, brim), (rod, head))):
        parts.append(Part(f"link_{i}", joined(trimesh.util.concatenate(pieces))))
    joint = Joint("up", "prismatic", "link_0", "link_1", lower=0, upper=reach, give_way=give_way)
    return ArticulatedObject("x", tuple(parts), KinematicTree(("link_0", "link_1"), (joint,)))


def test_shapes_of_parts_that_pass_each_other_do_so_too():
    obj = telescope(0.22)
    made = collision_of(obj)
    assert overlaps_of(obj, made).over_range["up"] < 1e-6
    rod = sum(hull_of_shape(s).volume for s in made["link_1"])
    assert rod > 0.5 * np.pi * (0.015**2 * 0.37 + 0.045**2 * 0.03)


def test_where_the_parts_collide_so_do_the_shapes_unless_they_are_to_give_way():
    made = collision_of(telescope(0.35))
    assert overlaps_of(telescope(0.35), made).over_range["up"] > 0.01
    made = collision_of(telescope(0.35, give_way=True))
    assert overlaps_of(telescope(0.35), made).over_range["up"] < 1e-6
    assert made["link_0"] and made["link_1"]


def drawer_in_a_chest(told: str, give_way: bool = False) -> ArticulatedObject:
    """A box in a tray, which is lifted out; ``told`` has a box that is too long and so sticks 5 mm
    deep in the tray's end."""
    tray_mesh, box = tray(), boxes(((0.02, 0.02, 0.012), (0.3, 0.28, 0.09)))
    way = {"lower": 0, "upper": 0.2, "give_way": give_way}
    joint = Joint("out", "prismatic", "link_0", "link_1", (0, 0, 1), **way)
    pose = np.eye(4)
    pose[:3, 3] = 0.2075, 0.15, 0.051
    parts = (Part("link_0", tray_mesh), Part("link_1", box))
    shapes = {told: (Primitive("box", pose, (0.375, 0.26, 0.078)),)}
    tree = KinematicTree(("link_0", "link_1"), (joint,))
    return ArticulatedObject("x", parts, tree, shapes=shapes)


def test_shapes_that_are_told_stay_and_the_others_make_room(tmp_path):
    obj = drawer_in_a_chest("link_1")
    for _ in range(2):  # made, and from the store
        made = collision_of(obj, store=tmp_path)
        (kept,) = made["link_1"]
        assert isinstance(kept, Primitive) and kept.sizes == obj.shapes["link_1"][0].sizes
        assert len(made["link_0"]) == 5
        assert overlaps_of(obj, made).at_rest < 1e-6
        build.recent_objects.clear()
    without = replace(obj, shapes={})
    assert all(s.sizes != kept.sizes for s in collision_of(without, store=tmp_path)["link_1"])


def test_shapes_that_are_told_are_cut_only_where_they_are_to_give_way():
    both = {"link_0": collision_of(replace(drawer_in_a_chest("link_1"), shapes={}))["link_0"]}
    obj = drawer_in_a_chest("link_1")
    obj = replace(obj, shapes={**obj.shapes, **both})
    assert collision_of(obj) == obj.shapes
    assert overlaps_of(obj, obj.shapes).over_range["out"] > 0.004
    obj = replace(obj, tree=drawer_in_a_chest("link_1", give_way=True).tree)
    made = collision_of(obj)
    assert overlaps_of(obj, made).over_range["out"] < 1e-6
    assert sum(s is t for s, t in zip(made["link_0"], both["link_0"], strict=True)) >= 4


def test_overlap_of_two_boxes_is_exact():
    a = hull_of(trimesh.creation.box((1, 1, 1)).vertices)
    b = hull_of(trimesh.creation.box((1, 1, 1)).vertices + [0.7, 0.2, 0.1])
    assert a is not None and b is not None
    found = overlap(a, b)
    assert found is not None and found.depth == pytest.approx(0.3)
    np.testing.assert_allclose(found.axis, [1, 0, 0], atol=1e-6)
    assert overlap(a, b, least=0.31) is None
    far = hull_of(trimesh.creation.box((1, 1, 1)).vertices + [0.9, 0.9, 1.01])
    assert far is not None and overlap(a, far) is None
    near = overlap(a, far, least=-0.02)
    assert near is not None and near.depth == pytest.approx(-0.01)
    assert overlap(a, far, least=-0.005) is None


# keeping, coacd, arbitrary input


def test_along_a_way_bodies_overlap_as_they_do_pose_by_pose():
    rng = np.random.default_rng(0)
    made = [hull_of(rng.normal(size=(12, 3)) + 1.2 * rng.normal(size=3)) for _ in range(8)]
    bodies = {"a": made[:4], "b": made[4:]}
    turns = [trimesh.transformations.rotation_matrix(q, (1, 2, 3), (2, 0, 0)) for q in range(40)]
    way = PosePath({"b": np.stack(turns)}, len(turns))
    for least in (0.0, -0.2):
        found = way.overlaps(bodies, [("a", "b")], least)
        alone = [overlaps(bodies, [("a", "b")], {"b": pose}, least) for pose in turns]
        assert any(alone) and not all(alone)
        for at_once, one in zip(found, alone, strict=True):
            assert [(t.i, t.j) for t in at_once] == [(t.i, t.j) for t in one]
            assert [t.depth for t in at_once] == pytest.approx([t.depth for t in one], abs=1e-12)
    bodies["b"] = bodies["b"][1:]
    left = way.overlaps(bodies, [("a", "b")], 0.0)
    assert [(t.i, t.j) for t in left[3]] == [
        (t.i, t.j) for t in overlaps(bodies, [("a", "b")], {"b": turns[3]})
    ]


def test_shapes_are_kept_by_content(tmp_path, monkeypatch):
    obj = chest()
    first = collision_of(obj, store=tmp_path)
    build.recent_objects.clear()
    with monkeypatch.context() as patch:
        patch.setattr(build, "hollow_bodies", None)
        again = collision_of(obj, store=tmp_path)
    assert {k: len(v) for k, v in again.items()} == {k: len(v) for k, v in first.items()}
    for link, shapes in first.items():
        for a, b in zip(shapes, again[link], strict=True):
            np.testing.assert_allclose(hull_of_shape(a).bounds, hull_of_shape(b).bounds)
    for path in tmp_path.glob("*.npz"):
        path.write_bytes(path.read_bytes()[:100])
    build.recent_objects.clear()
    assert collision_of(obj, store=tmp_path).keys() == first.keys()


def scanned_chest() -> ArticulatedObject:
    """The chest as clouds with colours."""
    obj, rng = chest(), np.random.default_rng(0)
    parts = []
    for part in obj.parts:
        points = sample_surface(part.mesh, 1000, rng)[0].points.astype(np.float32)
        colors = rng.integers(0, 255, (len(points), 3)).astype(np.uint8)
        parts.append(Part(part.link, cloud=PointCloud(points, None, colors), name=part.name))
    return ArticulatedObject(obj.name, tuple(parts), obj.tree)


def test_what_is_made_of_parts_before_there_are_joints_is_taken(tmp_path, monkeypatch):
    """By whatever process asks: neither surfaces nor bodies of a scan are made twice."""
    made_here = scanned_chest()
    expected = physics_of(made_here)
    prepare_bodies(scanned_chest().parts, tmp_path)
    build.recent_objects.clear()
    obj = scanned_chest()
    with monkeypatch.context() as patch:
        patch.setattr(build, "hollow_bodies", None)
        patch.setattr(reconstruct, "mesh_from_cloud", None)
        found = physics_of(obj, store=tmp_path)
    for fresh, part in zip(made_here.parts, obj.parts, strict=True):
        before, after = part_mesh(fresh), part_mesh(part)
        np.testing.assert_array_equal(before.vertices, after.vertices)
        np.testing.assert_array_equal(before.faces, after.faces)
        np.testing.assert_array_equal(before.vertex_colors, after.vertex_colors)
        assert before.materials[0].name == after.materials[0].name == "scan"
        mass, told = expected.inertials[part.link], found.inertials[part.link]
        assert told.mass == mass.mass
        assert len(expected.collision[part.link]) == len(found.collision[part.link])
    # What is damaged counts for nothing, and what was asked for long ago goes.
    surfaces = sorted(tmp_path.glob("surface-*.npz"))
    assert len(surfaces) == len(obj.parts)
    surfaces[0].write_bytes(b"PK")
    monkeypatch.setattr(surfaces_of_parts, "MAX_FILES", 1)
    for part in scanned_chest().parts:
        assert len(part_mesh(part, tmp_path).faces)
    assert len(list(tmp_path.glob("surface-*.npz"))) == 1


def test_coacd_answers_or_is_stopped():
    pytest.importorskip("coacd")
    mesh = boxes(((0, 0, 0), (0.3, 0.3, 0.1)), ((0, 0, 0), (0.1, 0.3, 0.3)))
    found = coacd_hulls(mesh, 240.0, mcts_iterations=20, resolution=500)
    assert found is not None and len(found) >= 2
    assert coacd_hulls(mesh, 0.01) is None


NUMBERS = st.floats(-1, 1, allow_subnormal=False)
DUST = np.full((9, 3), 5.8e-112)
DUST[[0, 1, 2], [0, 1, 2]] = 0


@settings(max_examples=20)
@given(hnp.arrays(np.float64, (9, 3), elements=NUMBERS), st.sampled_from([1.0, 1e-3, 1e3]))
@example(DUST, 1.0)
@example(DUST * 1e100, 1.0)
@example(DUST * 1e105, 1.0)
def test_whatever_the_triangles_there_is_a_shape(points, scale):
    mesh = Mesh(points * scale, np.arange(9).reshape(3, 3))
    shapes = collision_of(alone(mesh))["link_0"]
    for shape in shapes:
        hull = hull_of_shape(shape)
        assert hull.volume > 0 and np.isfinite(hull.vertices).all()


@pytest.mark.parametrize("options", [{"max_hulls": 0}, {"max_vertices": 3}])
def test_senseless_settings_are_refused(options):
    with pytest.raises(GeometryError):
        CollisionSettings(**options)
