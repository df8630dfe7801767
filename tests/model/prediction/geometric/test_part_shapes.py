"""Boxes, circles, handles and sweeps that the rules stand on."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from model.core.articulated_object import SegmentedObject
from model.prediction.geometric.limits import free_range
from model.prediction.geometric.sampled_object import sample_object
from model.prediction.geometric.shape import fit_box, rotation, roundness
from tests.builders import part
from tests.model.prediction.geometric.archetypes import box, join, rod


def sampled(*meshes):
    parts = tuple(part(f"link_{i}", m) for i, m in enumerate(meshes))
    return sample_object(SegmentedObject("scene", parts))


@settings(max_examples=40)
@given(
    half=st.tuples(*[st.floats(0.05, 1.0)] * 3),
    axis=st.sampled_from([0, 1, 2]),
    angle=st.floats(-0.7, 0.7),
)
def test_a_turned_box_is_found_again(half, axis: int, angle: float) -> None:
    """Its volume is found to 12 %: a turned box is only taken where it is clearly smaller."""
    corners = np.array(np.meshgrid(*[(-h, h) for h in half])).reshape(3, -1).T
    points = corners @ rotation(np.eye(3)[axis], angle).T + (0.3, -0.2, 0.5)
    found = fit_box(points, scanned=False)
    assert np.prod(2 * found.half) <= 1.12 * np.prod(2 * np.asarray(half)) + 2e-3
    assert np.abs(found.local(points)).max(0) == pytest.approx(found.half, abs=1e-6)


def test_round_and_not_round() -> None:
    angles = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles), 0 * angles], 1)
    tall = np.add(np.concatenate([circle, np.add(circle, (0, 0, 1))]), (5, 6, 7))
    found = roundness(tall, np.array([0.0, 0, 1]), scanned=False)
    assert found is not None and found.round
    assert found.center == pytest.approx((5, 6, 7.5), abs=1e-6)
    assert found.radius == pytest.approx(1.0, abs=1e-2)
    square = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    found = roundness(square, np.array([0.0, 0, 1]), scanned=False)
    assert found is not None and not found.round


def test_a_handle_sticks_out_of_its_side() -> None:
    door = join(box((0, 0, 0.5), (0.02, 0.6, 1.0)), box((-0.03, 0.25, 0.5), (0.04, 0.02, 0.2)))
    s = sampled(door, box((0.3, 0, 0.5), (0.5, 0.6, 1.0))).shapes[0]
    panel = s.panel
    front = float(s.box.axes[:, panel.normal] @ (-1.0, 0.0, 0.0))
    handle = panel.beyond(front)
    assert handle is not None and handle.strength > 0.9
    assert panel.beyond(-front) is None
    assert (s.box.axes @ handle.center)[1] > 0.7 * s.box.reach(np.array([0.0, 1.0, 0.0]))


def test_yaw_is_taken_out() -> None:
    turn = rotation(np.array([0.0, 0, 1]), 0.4)
    mesh = box((0, 0, 0), (2, 1, 0.5))
    mesh.vertices = mesh.vertices @ turn.T
    made = sampled(mesh)
    assert np.abs(made.shapes[0].box.axes).max(0) == pytest.approx(1.0, abs=1e-6)
    back = made.frame.object_from_working @ np.array([1.0, 0, 0])
    assert max(abs(back @ turn[:, 0]), abs(back @ turn[:, 1])) == pytest.approx(1.0, abs=1e-4)


def test_sweep_stops_at_the_wall() -> None:
    made = sampled(box((0, 0, 0), (0.2, 0.2, 0.2)), box((1.0, 0, 0), (0.1, 1.0, 1.0)))
    size = made.frame.diagonal
    axis = np.array([1.0, 0, 0])
    center = made.shapes[0].center
    reached = free_range(made, 0, (1,), rotates=False, axis=axis, origin=center, stop=1.0)
    assert reached * size == pytest.approx(0.85, abs=0.05)
    away = free_range(made, 0, (1,), rotates=False, axis=axis, origin=center, stop=-1.0)
    assert away == -1.0


def test_what_touches_at_rest_is_no_collision() -> None:
    """A drawer rubs its rails all the way."""
    rails = join(box((0, -0.26, 0), (1, 0.02, 0.3)), box((0, 0.26, 0), (1, 0.02, 0.3)))
    made = sampled(box((0, 0, 0), (1.0, 0.5, 0.25)), rails)
    axis = np.array([1.0, 0, 0])
    reached = free_range(
        made, 0, (1,), rotates=False, axis=axis, origin=made.shapes[0].center, stop=0.5
    )
    assert reached == 0.5


def test_cover_tells_the_open_side() -> None:
    made = sampled(box((0, 0, 0), (0.5, 0.5, 0.5)), box((0.5, 0, 0), (0.1, 1.0, 1.0)))
    assert made.cover(0, np.array([1.0, 0, 0]), (1,)) > 0.9
    assert made.cover(0, np.array([-1.0, 0, 0]), (1,)) == 0.0
    assert made.cover(0, np.array([0.0, 0, 1.0]), (1,)) == 0.0


def test_gap_between_parts() -> None:
    made = sampled(rod((0, 0, 0), (0, 0, 1), 0.1, 1.0), box((0.3, 0, 0), (0.2, 0.2, 1.0)))
    assert made.gap[0, 1] * made.frame.diagonal == pytest.approx(0.1, abs=0.02)
