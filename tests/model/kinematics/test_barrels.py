"""Hinge barrels tell where a hinge is; other round things near it don't."""

import numpy as np
import pytest
import trimesh

from model.core.articulated_object import Part
from model.core.geometry import PointCloud
from model.core.joint import Joint
from model.kinematics.snapping import barrel_line, on_barrels
from tests.builders import part

AXIS = np.array((0.0, 0.0, 1.0))
HINGE = Joint("j", "revolute", "link_0", "link_1", (0, 0, 1), (0, 0, 0.3), 0.0, 1.5)


def board() -> trimesh.Trimesh:
    """A door of 0.5 x 0.02 x 0.8 m whose hinge edge is x = 0, its back y = 0."""
    return trimesh.creation.box((0.5, 0.02, 0.8)).apply_translation((0.25, -0.01, 0.4))


def rod(x: float, y: float, z: float, radius: float, length: float) -> trimesh.Trimesh:
    made = trimesh.creation.cylinder(radius, length, sections=12)
    return made.apply_translation((x, y, z))


WALL = trimesh.creation.box((0.02, 0.4, 0.8)).apply_translation((-0.011, 0.2, 0.4))


def test_knuckles_of_both_parts_make_one_line() -> None:
    door = part("link_1", board(), rod(0.002, -0.025, 0.1, 0.006, 0.05))
    frame = part("link_0", WALL, rod(0.002, -0.025, 0.7, 0.006, 0.05))
    found = barrel_line((door, frame), AXIS, np.zeros(3), 0.03, 0.015)
    assert found is not None and found.count == 2
    assert found.point[:2] == pytest.approx((0.002, -0.025), abs=1e-6)
    assert found.radius == pytest.approx(0.006, abs=1e-4)
    assert found.length == pytest.approx(0.65, abs=1e-6)
    moved = on_barrels(HINGE, door, frame)
    assert moved is not None and moved.axis == HINGE.axis
    assert moved.origin[:2] == pytest.approx((0.002, -0.025), abs=1e-6)


@pytest.mark.parametrize(
    "other",
    [
        rod(0.002, -0.025, 0.4, 0.02, 0.05),  # too thick
        rod(0.002, -0.025, 0.4, 0.006, 0.005),  # a screw's head
        rod(0.09, -0.05, 0.4, 0.006, 0.3),  # a handle's bar
        trimesh.creation.box((0.01, 0.01, 0.05)).apply_translation((0.002, -0.025, 0.4)),
        rod(0, 0, 0, 0.006, 0.05).apply_transform(
            trimesh.geometry.align_vectors((0, 0, 1), (0, 1, 0))
        ),
    ],
)
def test_other_things_near_the_hinge_are_no_barrels(other: trimesh.Trimesh) -> None:
    door, frame = part("link_1", board(), other), part("link_0", WALL)
    assert barrel_line((door, frame), AXIS, np.zeros(3), 0.03, 0.015) is None


def test_one_knuckle_moves_no_joint_but_a_piano_hinge_does() -> None:
    frame = part("link_0", WALL)
    short = part("link_1", board(), rod(0.0, -0.025, 0.4, 0.006, 0.05))
    assert on_barrels(HINGE, short, frame) is None
    long = part("link_1", board(), rod(0.0, -0.025, 0.4, 0.006, 0.7))
    moved = on_barrels(HINGE, long, frame)
    assert moved is not None and moved.origin[1] == pytest.approx(-0.025, abs=1e-6)


def test_clouds_have_none() -> None:
    points = np.random.default_rng(0).random((500, 3))
    cloud = Part("link_1", cloud=PointCloud(points.astype(np.float32)))
    assert barrel_line((cloud,), AXIS, np.zeros(3), 1.0, 1.0) is None
    assert on_barrels(HINGE, cloud, cloud) is None
