import numpy as np
import pytest

from model.core.errors import KinematicsError
from model.core.joint import Joint
from model.kinematics.snapping import axis_along_box, box_of, origin_on_box_edge, origin_on_contact


def door(**changes: object) -> Joint:
    values = {
        "name": "j",
        "type": "revolute",
        "parent": "link_0",
        "child": "link_1",
        "axis": (0.0, 0.0, 1.0),
        "origin": (0.1, 0.0, 0.3),
        "lower": 0.0,
        "upper": 1.5,
    }
    return Joint(**{**values, **changes})  # type: ignore[arg-type]


def panel(yaw: float = 0.0) -> np.ndarray:
    """A 0.4 × 0.02 × 0.6 m panel about (1, 2, 0.5), turned about z."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.5, 0.5, (2000, 3)) * (0.4, 0.02, 0.6)
    corners = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T * (0.4, 0.02, 0.6)
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    return np.concatenate([points, corners]) @ turn.T + (1.0, 2.0, 0.5)


@pytest.mark.parametrize("yaw", [0.0, 0.4, 1.1])
def test_the_box_is_tight_and_sorted(yaw: float) -> None:
    box = box_of(panel(yaw))
    np.testing.assert_allclose(2 * box.half, (0.6, 0.4, 0.02), atol=1e-6)
    np.testing.assert_allclose(box.center, (1.0, 2.0, 0.5), atol=1e-6)
    np.testing.assert_allclose(np.abs(box.axes[:, 0]), (0, 0, 1), atol=1e-6)
    np.testing.assert_allclose(box.axes.T @ box.axes, np.eye(3), atol=1e-9)


@pytest.mark.parametrize("yaw", [0.0, 0.4])
def test_an_edge_snap_lands_on_the_nearest_edge_and_keeps_the_side(yaw: float) -> None:
    points = panel(yaw)
    box = box_of(points)
    wide = box.axes[:, 1]
    near = box.center - 0.19 * wide
    for sign in (1.0, -1.0):
        joint = door(axis=(0.02, 0.0, sign), origin=tuple(near))
        snapped = origin_on_box_edge(joint, box)
        np.testing.assert_allclose(snapped.axis, (0, 0, sign), atol=1e-6)
        offset = np.asarray(snapped.origin) - box.center
        assert offset @ wide == pytest.approx(-0.2, abs=1e-6)


def test_an_edge_snap_needs_an_axis_along_an_edge() -> None:
    box = box_of(panel())
    with pytest.raises(KinematicsError, match="choose the axis first"):
        origin_on_box_edge(door(axis=(1.0, 0.0, 1.0)), box)


def test_box_axes_by_length() -> None:
    box = box_of(panel())
    assert np.abs(axis_along_box(door(), box, "Short").axis) == pytest.approx([0, 1, 0])
    assert axis_along_box(door(axis=(0, 0, -1)), box, "Long").axis == pytest.approx((0, 0, -1))


def test_contact_snap_finds_the_hinge_line() -> None:
    rng = np.random.default_rng(1)
    child = rng.uniform(0, 1, (4000, 3)) * (0.5, 0.0, 0.8)
    parent = rng.uniform(0, 1, (4000, 3)) * (0.0, 0.4, 0.8)
    joint = door(axis=(0.1, 0.0, 1.0), origin=(0.3, 0.1, 0.1))
    snapped = origin_on_contact(joint, child, parent, reach=0.01)
    assert abs(snapped.axis[2]) > 0.999
    assert np.abs(snapped.origin[:2]) == pytest.approx([0, 0], abs=0.015)


def frame(inside: float = 0.02) -> np.ndarray:
    """What a flush door lies on all round, ``inside`` its outline, and the body behind it."""
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.5, 0.5, (40000, 3)) * (0.4, 0.0, 0.6)
    edge = np.max(np.abs(points) / (0.2 - inside, 1.0, 0.3 - inside), axis=1)
    points[:, 1] = np.where((edge > 0.95) & (edge <= 1.0), 0.012, 0.3)
    return points + (1.0, 2.0, 0.5)


@pytest.mark.parametrize("side", [-1, 1])
def test_contact_snap_leaves_a_flush_door_on_its_hinged_side(side: int) -> None:
    child = panel()
    origin = (1.0 + 0.15 * side, 2.0, 0.4)
    snapped = origin_on_contact(door(origin=origin), child, frame(0.0), reach=0.007)
    assert snapped.origin[:2] == pytest.approx((1.0 + 0.2 * side, 2.01), abs=0.003)
    assert snapped.axis == pytest.approx((0, 0, 1), abs=1e-6)


def test_contact_snap_refuses_a_face_that_says_no_line() -> None:
    with pytest.raises(KinematicsError, match="touch over a face"):
        origin_on_contact(door(origin=(0.82, 2.0, 0.4)), panel(), frame(0.06), reach=0.007)


def test_contact_snap_of_a_knob_or_a_pin_takes_the_middle() -> None:
    rng = np.random.default_rng(4)
    angle, height = rng.uniform(0, 2 * np.pi, 4000), rng.uniform(0, 0.5, 4000)
    ring = np.stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), height], axis=1)
    snapped = origin_on_contact(door(), ring, ring * (1.02, 1.02, 0.3), reach=0.003)
    assert snapped.origin[:2] == pytest.approx((0, 0), abs=0.005)
    rod = rng.uniform(0, 1, (4000, 3)) * (1.0, 0.02, 0.02)
    snapped = origin_on_contact(door(), rod, rod * (0.05, 1.0, 1.0), reach=0.005)
    assert snapped.origin[0] == pytest.approx(0.025, abs=0.02)


def test_contact_snap_says_when_nothing_touches() -> None:
    """By the links, for which the screens have names; the joint's own name is none of theirs."""
    far = np.random.default_rng(2).uniform(0, 1, (100, 3))
    with pytest.raises(KinematicsError, match=rf"^{door().child} and {door().parent} don't touch"):
        origin_on_contact(door(), far, far + (5.0, 0.0, 0.0), reach=0.01)
