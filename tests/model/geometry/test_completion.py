"""What scans don't show is made up: closed parts, thick doors, trays, openings for them."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from model.core.articulated_object import ArticulatedObject, Part
from model.core.geometry import Mesh, PointCloud
from model.core.joint import Joint, motion
from model.core.progress import Cancelled
from model.core.tree import KinematicTree
from model.geometry.completion import BOARD, OPENING, SURFACE, THICKNESS, TRAY, as_scanned, complete
from model.geometry.reconstruct import closed_solid
from tests.scanned_cabinet import DEPTH, HEIGHT, SPLIT, WIDTH, cabinet, sheet


def solid_of(part: Part) -> trimesh.Trimesh:
    assert part.mesh is not None
    return trimesh.Trimesh(part.mesh.vertices, part.mesh.faces)


@pytest.fixture(scope="module")
def scan() -> ArticulatedObject:
    return cabinet()


@pytest.fixture(scope="module")
def completed(scan: ArticulatedObject) -> dict[str, Part]:
    return {p.link: p for p in complete(scan).parts}


def test_every_part_is_closed_and_its_points_stay(scan, completed):
    for before in scan.parts:
        part, solid = completed[before.link], solid_of(completed[before.link])
        assert part.cloud is before.cloud
        assert solid.is_watertight and solid.volume > 0
        assert np.isfinite(solid.vertices).all()
        np.testing.assert_allclose(solid.bounds[1][[0, 2]], part.cloud.bounds[1][[0, 2]], atol=0.03)
    assert completed["link_0"].completed == (SURFACE, OPENING)
    assert completed["link_1"].completed == (THICKNESS, TRAY)
    assert completed["link_2"].completed == (THICKNESS,)


def test_a_door_gets_the_thickness_of_a_board_towards_the_inside(completed):
    door = solid_of(completed["link_2"])
    assert door.bounds[0][1] == pytest.approx(0, abs=0.006)
    assert door.bounds[1][1] == pytest.approx(BOARD, abs=0.004)
    assert door.volume == pytest.approx(WIDTH * (HEIGHT - SPLIT) * BOARD, rel=0.15)


def test_a_tray_fits_behind_a_drawers_front(completed):
    tray = solid_of(completed["link_1"])
    assert 0.8 * DEPTH < tray.extents[1] < DEPTH
    inside = [[WIDTH / 2, DEPTH / 2, SPLIT / 2], [WIDTH / 2, DEPTH / 2, HEIGHT / 2]]
    assert not tray.contains(inside).any(), "it is open at the top"
    bottom = tray.vertices[tray.vertices[:, 1] > 3 * BOARD]
    assert bottom[:, 2].min() > 0.01
    assert bottom[:, 0].min() > 0.01 and bottom[:, 0].max() < WIDTH - 0.01
    # A box of boards, far from a block.
    assert 0.05 < tray.volume / tray.convex_hull.volume < 0.35


def test_the_body_has_a_back_a_bottom_and_room(completed):
    body = solid_of(completed["link_0"])
    wall = BOARD / 2
    there = [(WIDTH / 2, DEPTH - wall, 0.5), (WIDTH / 2, DEPTH / 2, HEIGHT - wall)]
    assert body.contains(there).all()
    free = [(WIDTH / 2, DEPTH / 2, z) for z in (SPLIT / 2, 0.55)]
    free += [(WIDTH / 2, 0.01, 0.15), (WIDTH / 2, 0.01, 0.5)]
    assert not body.contains(free).any()
    assert 0.1 < body.volume / (WIDTH * DEPTH * HEIGHT) < 0.5


def test_nothing_made_up_meets_the_body_over_the_range(scan, completed):
    body = solid_of(completed["link_0"])
    for joint in scan.tree.joints:
        moving = solid_of(completed[joint.child])
        points = moving.sample(1500, seed=0)
        if isinstance(points, tuple):
            points = points[0]
        made = points[points[:, 1] > 0.006]  # behind what was scanned
        for q in np.linspace(0, joint.upper, 6):
            pose = motion(joint, q)
            hits = body.contains(made @ pose[:3, :3].T + pose[:3, 3])
            assert not hits.any(), (joint.name, q)


def test_colours_come_from_the_points(completed):
    drawer = completed["link_1"].mesh
    assert drawer is not None and drawer.vertex_colors is not None
    front = drawer.vertices[:, 1] < 0.005
    assert (drawer.vertex_colors[front][:, 0] > 150).all()
    assert (drawer.vertex_colors[:, 0] > drawer.vertex_colors[:, 2]).all()


def test_the_same_scan_gives_the_same_surfaces():
    once, again = (complete(cabinet(300)).parts for _ in range(2))
    for part, other in zip(once, again, strict=True):
        assert part.mesh is not None and other.mesh is not None
        np.testing.assert_array_equal(part.mesh.vertices, other.mesh.vertices)


def test_tiny_and_flat_parts_stay_as_they_are_with_a_remark(scan):
    rng = np.random.default_rng(1)
    knob = Part("link_3", cloud=sheet((0.3, -0.02, 0.1), (0.01, 0, 0), (0, 0, 0.01), 40, rng))
    line = sheet((0.1, -0.02, 0.5), (0.2, 0, 0), (0, 0, 0), 500, rng)
    points = line.points.copy()
    points[:, 1:] = points[0, 1:]
    wire = Part("link_4", cloud=PointCloud(points, None, line.colors))
    base = scan.parts[0]
    links = ("link_0", "link_3", "link_4")
    spin = [
        Joint(f"spin_{k}", "continuous", "link_0", k, (0, 1, 0), (0.3, 0, 0.1)) for k in links[1:]
    ]
    obj = ArticulatedObject("odd", (base, knob, wire), KinematicTree(links, tuple(spin)))
    found = {p.link: p for p in complete(obj).parts}
    assert found["link_0"].completed == (SURFACE,)
    for part in (found["link_3"], found["link_4"]):
        assert part.mesh is None and part.completed == ()
        assert f"{part.link} could not be completed" in part.remarks[-1]


def test_meshes_are_no_scans_and_stay():
    scan, box = cabinet(300), trimesh.creation.box((0.6, 0.02, 0.5))
    part = Part("link_2", Mesh(np.asarray(box.vertices), np.asarray(box.faces)))
    obj = replace(scan, parts=(*scan.parts[:2], part))
    found = complete(obj).parts
    assert found[2] is part and TRAY in found[1].completed


def test_it_can_be_taken_away_again(scan, completed):
    for before, after in zip(scan.parts, as_scanned(tuple(completed.values())), strict=True):
        assert after.mesh is None and after.completed == ()
        assert after.cloud is before.cloud


def test_it_can_be_cancelled(scan):
    seen: list[float] = []

    def progress(fraction: float, message: str) -> None:
        seen.append(fraction)
        if message.startswith("closing"):
            raise Cancelled

    with pytest.raises(Cancelled):
        complete(scan, progress)
    assert seen == sorted(seen)


def test_a_table_gets_no_walls_between_its_legs():
    rng = np.random.default_rng(2)
    top = trimesh.creation.box((1.0, 0.6, 0.03))
    top.apply_translation((0, 0, 0.7))
    shapes = [top]
    for x in (-0.45, 0.45):
        for y in (-0.25, 0.25):
            leg = trimesh.creation.box((0.05, 0.05, 0.68))
            leg.apply_translation((x, y, 0.34))
            shapes.append(leg)
    points, normals = [], []
    for shape, share in zip(shapes, (20_000, 5000, 5000, 5000, 5000), strict=True):
        at, face = trimesh.sample.sample_surface(shape, share, seed=int(rng.integers(99)))[:2]
        points.append(at)
        normals.append(shape.face_normals[face])
    at, facing = np.concatenate(points), np.concatenate(normals)
    seen = facing[:, 2] > -0.5  # nobody looks from below
    cloud = PointCloud(at[seen].astype(np.float32), facing[seen].astype(np.float32))
    solid = closed_solid(cloud, BOARD)
    assert solid is not None
    mesh = solid.to_mesh()
    found = trimesh.Trimesh(mesh.vert_properties[:, :3], mesh.tri_verts)
    assert found.is_watertight
    between = [(0, 0, 0.3), (0, 0.25, 0.3), (0.45, 0, 0.3)]
    assert not found.contains(between).any()
    assert found.contains([(0, 0, 0.7), (0.45, 0.25, 0.3)]).all()
