"""Scenes whose collisions are known, as closed meshes, badly wound ones, and clouds."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from model.core.articulated_object import ArticulatedObject, Part
from model.core.errors import KinematicsError
from model.core.geometry import Mesh, PointCloud
from model.core.joint import Joint, Mimic
from model.kinematics.surface import surface_of
from model.kinematics.sweep import free_range, sweep_joint, sweep_path
from tests.builders import box, linked, slide, two

KINDS = ("mesh", "badly wound", "cloud")
BOARD = 0.02


def part(link: str, kind: str, *pieces: trimesh.Trimesh, noise: float = 0.0) -> Part:
    rng = np.random.default_rng(1)
    whole = trimesh.util.concatenate(pieces)
    faces = np.array(whole.faces)
    if kind == "cloud":
        points, _ = trimesh.sample.sample_surface(whole, 20_000, seed=1)
        points = points + rng.normal(0, noise, points.shape) if noise else points
        return Part(link, cloud=PointCloud(np.asarray(points, np.float32)))
    if kind == "badly wound":
        over = rng.random(len(faces)) < 0.5
        faces[over] = faces[over, ::-1]
    return Part(link, Mesh(np.asarray(whole.vertices), faces))


def door_and_wall(kind: str, noise: float = 0.0) -> ArticulatedObject:
    """A door that meets a wall flat at exactly 90°."""
    joint = Joint("j", "revolute", "link_0", "link_1", lower=0, upper=math.radians(135))
    return two(
        joint,
        part("link_0", kind, box([-0.1, 0.1, 0], [0, 1, 2]), noise=noise),
        part("link_1", kind, box([0, -BOARD, 0], [0.8, 0, 2]), noise=noise),
    )


def drawer(kind: str, *, gap: float = 0.05, side: float = 0.002, plate: bool = False):
    """A drawer in a carcass: ``gap`` to the back wall, ``side`` to the other boards, and a front
    plate that overlaps the carcass' front."""
    w = BOARD
    carcass = [
        box([-0.3 - w - side, 0, 0], [-0.3 - side, 0.6, 0.5]),
        box([0.3 + side, 0, 0], [0.3 + side + w, 0.6, 0.5]),
        box([-0.3 - w - side, 0, -w - side], [0.3 + w + side, 0.6, -side]),
        box([-0.3 - w - side, 0.5 + gap, 0], [0.3 + w + side, 0.5 + gap + w, 0.5]),
    ]
    boards = [
        box([-0.3, 0, 0], [0.3, w, 0.2]),
        box([-0.3, 0, 0], [-0.3 + w, 0.5, 0.2]),
        box([0.3 - w, 0, 0], [0.3, 0.5, 0.2]),
        box([-0.3, 0.5 - w, 0], [0.3, 0.5, 0.2]),
        box([-0.3, 0, 0], [0.3, 0.5, w / 2]),
    ]
    if plate:
        boards.append(box([-0.3 - w, -w, -w], [0.3 + w, 0, 0.2 + w]))
    joint = Joint("j", "prismatic", "link_0", "link_1", (0, -1, 0), lower=-0.3, upper=0.6)
    return two(joint, part("link_0", kind, *carcass), part("link_1", kind, *boards))


def knob(kind: str) -> ArticulatedObject:
    """A knob with a pointer; its shaft goes through the panel that it touches."""
    cap = trimesh.creation.cylinder(0.02, 0.03).apply_translation([0, 0, 0.015])
    shaft = trimesh.creation.cylinder(0.005, 0.05)
    pointer = box([-0.005, 0, 0], [0.005, 0.03, 0.03])
    return two(
        Joint("j", "continuous", "link_0", "link_1"),
        part("link_0", kind, box([-0.3, -0.2, -0.02], [0.3, 0.2, 0])),
        part("link_1", kind, cap, shaft, pointer),
    )


@pytest.mark.parametrize("kind", KINDS)
def test_a_door_stops_flat_at_the_wall(kind):
    obj = door_and_wall(kind)
    lower, upper = np.degrees(free_range(obj, "j"))
    assert upper == pytest.approx(90, abs=1.5 if kind == "cloud" else 0.1)
    assert lower == pytest.approx(-180)
    sweep = sweep_joint(obj, "j", samples=28)
    angle = np.degrees(sweep.q)
    assert not sweep.collides[angle < 90].any()
    assert sweep.collides[angle > 93].all()
    # The door's far edge is 0.8 m from the hinge: it is that deep in the wall's plane at most.
    last = sweep.depth[-1]
    assert last == pytest.approx(0.8 * math.sin(math.radians(45)), abs=0.05)
    assert sweep.others[-1] == "link_0" and sweep.others[0] is None
    assert np.isnan(sweep.where[0]).all() and np.isfinite(sweep.where[-1]).all()


@pytest.mark.parametrize("kind", KINDS)
def test_a_drawer_leaves_freely_and_stops_at_the_back(kind):
    obj = drawer(kind)
    lower, upper = free_range(obj, "j")
    assert lower == pytest.approx(-0.05, abs=0.01 if kind == "cloud" else 1e-3)
    assert upper > 0.9
    sweep = sweep_joint(obj, "j")
    assert not sweep.collides[sweep.q > -0.05].any()
    deep = sweep.q < -0.1
    np.testing.assert_allclose(sweep.depth[deep], -sweep.q[deep] - 0.05, atol=0.01)
    # The place is where the drawer's back is by then.
    assert sweep.where[0][1] == pytest.approx(0.5 + 0.3, abs=0.35)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("side", [0.002, 0.0])
def test_touching_at_rest_is_no_collision_but_pushing_is(kind, side):
    against_the_wall = drawer(kind, gap=0.0, side=side)
    lower, upper = free_range(against_the_wall, "j")
    assert lower == pytest.approx(0, abs=0.005)
    assert upper > 0.9


@pytest.mark.parametrize("kind", ["mesh", "badly wound"])
def test_a_front_plate_stops_the_drawer_one_way_only(kind):
    lower, upper = free_range(drawer(kind, plate=True), "j")
    assert lower == pytest.approx(0, abs=1e-3)
    assert upper > 0.9


@pytest.mark.parametrize("kind", KINDS)
def test_a_knob_turns_all_around(kind):
    obj = knob(kind)
    assert np.degrees(free_range(obj, "j")) == pytest.approx([-180, 180])
    assert not sweep_joint(obj, "j").collides.any()


def test_noise_of_a_scan_moves_the_limit_a_little_only():
    lower, upper = np.degrees(free_range(door_and_wall("cloud", noise=0.003), "j"))
    assert upper == pytest.approx(90, abs=5)
    assert lower == pytest.approx(-180)


def test_single_sheets_stop_each_other():
    """Two squares without thickness, as scans have them: nothing is inside of anything."""
    square = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    above = square.copy().apply_translation([0, 0, 0.4])
    joint = Joint("j", "prismatic", "link_0", "link_1", (0, 0, -1), lower=0, upper=1)
    for flipped in (False, True):
        if flipped:
            above.invert()
        obj = two(joint, part("link_0", "mesh", square), part("link_1", "mesh", above))
        assert free_range(obj, "j") == (
            pytest.approx(-1.47, abs=0.01),
            pytest.approx(0.4, abs=1e-3),
        )
        assert sweep_joint(obj, "j").depth[-1] == pytest.approx(0.6, abs=1e-3)


def test_a_thin_wall_is_not_jumped_over():
    wall = box([0.5, -1, -1], [0.501, 1, 1])
    ball = trimesh.creation.icosphere(2, 0.05)
    joint = Joint("j", "prismatic", "link_0", "link_1", (1, 0, 0), lower=0, upper=3)
    obj = two(joint, part("link_0", "mesh", wall), part("link_1", "mesh", ball))
    assert free_range(obj, "j")[1] == pytest.approx(0.45, abs=0.01)
    assert sweep_joint(obj, "j", samples=4).collides.tolist() == [False, True, True, True]


def test_a_thin_post_is_met_between_the_samples_of_the_mover():
    post = box([0.3, 0.5, -2], [0.31, 0.51, 2])
    joint = Joint("j", "revolute", "link_0", "link_1", lower=0, upper=math.pi)
    door = part("link_1", "mesh", box([0, -0.01, -1], [0.9, 0, 1]))
    found = free_range(two(joint, part("link_0", "mesh", post), door), "j")[1]
    assert found == pytest.approx(math.atan2(0.5, 0.31), abs=0.01)


def lid_in_a_rim(overlap: float) -> ArticulatedObject:
    """A round lid that lifts out of a tight rim which reaches ``overlap`` over its edge."""
    lid = trimesh.creation.cylinder(0.1, 0.03, sections=64).apply_translation([0, 0, 0.115])
    rim = trimesh.creation.annulus(0.1 - overlap, 0.13, 0.01, sections=64)
    rim.apply_translation([0, 0, 0.145])
    floor = box([-0.15, -0.15, 0], [0.15, 0.15, 0.1])
    joint = Joint("j", "prismatic", "link_0", "link_1", lower=0, upper=0.1)
    return two(joint, part("link_0", "mesh", floor, rim), part("link_1", "mesh", lid))


def test_an_overlap_by_a_hairs_breadth_is_that_deep_and_no_more():
    """Lifted out, the lid is far beyond the rim that it passed; wrong with it is the breadth."""
    narrow = sweep_joint(lid_in_a_rim(0.0008), "j")
    assert not narrow.collides.any()
    assert narrow.free == (0.0, 0.1)
    wide = sweep_joint(lid_in_a_rim(0.015), "j")
    assert wide.collides[-1]
    assert wide.depth[-1] > 0.05
    assert wide.free[1] == pytest.approx(0.01, abs=1e-3)


def test_a_way_through_joint_space_meets_what_no_joint_meets_alone():
    """Two doors that slide towards each other: each alone is free, both together are not."""
    floor = part("base", "mesh", box([-1, -1, -0.2], [1, 1, -0.1]))
    left = part("link_1", "mesh", box([-0.8, 0, 0], [-0.05, 0.02, 1]))
    right = part("link_2", "mesh", box([0.05, 0, 0], [0.8, 0.02, 1]))
    doors = (
        slide("a", "link_1", 0.09, parent="base"),
        slide("b", "link_2", 0.09, -1, parent="base"),
    )
    obj = linked(doors, floor, left, right)
    assert not sweep_joint(obj, "a").collides.any()
    assert not sweep_joint(obj, "b").collides.any()
    way = [{"a": t, "b": t} for t in np.linspace(0, 0.09, 10)]
    found = sweep_path(obj, way)
    assert found.pairs[-1] == ("link_1", "link_2")
    assert found.depth[-1] == pytest.approx(0.08, abs=1e-3)
    assert found.depth[4] == 0
    assert abs(found.where[-1][0]) < 0.05
    other = sweep_path(obj, way, pairs={frozenset(("base", "link_1"))})
    assert other.pairs == (None,) * 10


def test_what_hangs_on_the_joint_moves_along():
    """The handle on the door hits the wall before the door does."""
    joints = (
        Joint("j", "revolute", "link_0", "link_1", lower=0, upper=2),
        Joint("fix", "fixed", "link_1", "link_2"),
    )
    handle = part("link_2", "mesh", box([0.6, 0, 0.9], [0.7, 0.06, 1.1]))
    obj = linked(joints, *door_and_wall("mesh").parts, handle)
    upper = math.degrees(free_range(obj, "j")[1])
    assert 80 < upper < 89
    sweep = sweep_joint(obj, "j", samples=101)
    first = np.flatnonzero(sweep.collides)[0]
    assert 0.85 < sweep.where[first][2] < 1.15


def test_a_follower_counts_too():
    """Two sliding doors that mimic each other meet in the middle."""
    follower = slide("b", "link_2", 1, -1, parent="base", mimic=Mimic("a"))
    obj = linked(
        (slide("a", "link_1", 1, parent="base"), follower),
        part("base", "mesh", box([-2, -1, -0.2], [2, 1, -0.1])),
        part("link_1", "mesh", box([-1, 0, 0], [-0.2, 0.02, 1])),
        part("link_2", "mesh", box([0.2, 0, 0], [1, 0.02, 1])),
    )
    assert free_range(obj, "a")[1] == pytest.approx(0.2, abs=1e-3)
    alone = obj.tree.with_joint(replace(follower, mimic=None))
    assert free_range(replace(obj, tree=alone), "a")[1] == pytest.approx(0.4, abs=1e-3)


def test_the_size_of_the_object_plays_no_part():
    for scale in (0.01, 100.0):
        scene = door_and_wall("mesh")
        parts = tuple(
            Part(p.link, replace(p.mesh, vertices=p.mesh.vertices * scale)) for p in scene.parts
        )
        upper = free_range(replace(scene, parts=parts), "j")[1]
        assert math.degrees(upper) == pytest.approx(90, abs=0.1)


def test_a_joint_can_be_tried_before_it_is_set():
    scene = door_and_wall("mesh")
    other = replace(scene.tree.joints[0], axis=(0, 0, -1))
    assert np.degrees(free_range(scene, other)) == pytest.approx([-90, 180], abs=0.1)


def test_empty_parts_are_passed_over():
    scene = door_and_wall("mesh")
    nothing = Part("link_0", Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)))
    obj = replace(scene, parts=(nothing, scene.parts[1]))
    assert not sweep_joint(obj, "j").collides.any()


def test_a_fixed_or_missing_joint_is_named():
    scene = door_and_wall("mesh")
    with pytest.raises(KinematicsError, match=r"no joint 'hinge'; known are j"):
        sweep_joint(scene, "hinge")
    fixed = replace(scene.tree.joints[0], type="fixed")
    with pytest.raises(KinematicsError, match="fixed"):
        free_range(scene, fixed)


@pytest.mark.parametrize("kind", ["mesh", "cloud"])
def test_what_rays_hit_is_made_once_for_all_numbers_of_samples(kind):
    door = door_and_wall(kind).parts[0]
    few, many = surface_of(door, 300), surface_of(replace(door, name="door"), 900)
    assert few.triangles is many.triangles
    assert (len(few.points), len(many.points)) == (300, 900)
    if kind == "cloud":
        np.testing.assert_array_equal(few.points, many.points[:300])
        assert few.spacing == pytest.approx(many.spacing * 3**0.5)
