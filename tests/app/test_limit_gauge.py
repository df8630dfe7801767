"""Limits of joints as places in the picture, and back."""

from __future__ import annotations

import math

import numpy as np
import pytest

from app.viewer.picture.joint_handles import LimitGauge, limits_with, snapped
from model.core.joint import Joint

DOOR = Joint("door", "revolute", "base", "link_1", (0, 0, -1), (-0.4, -0.25, 0.3), 0.0, 1.6)
DRAWER = Joint("drawer", "prismatic", "base", "link_1", (0, -1, 0), (0, 0, 0.3), 0.0, 0.35)
RNG = np.random.default_rng(0)
PANEL = RNG.uniform((-0.4, -0.26, 0.0), (0.0, -0.24, 0.6), (500, 3))


@pytest.mark.parametrize("joint", [DOOR, DRAWER])
@pytest.mark.parametrize("q", [-0.3, 0.0, 0.2, 1.2])
def test_a_ray_through_a_place_gives_its_value(joint: Joint, q: float) -> None:
    gauge = LimitGauge.of(joint, PANEL, 1.0)
    for eye in np.array([(-1.0, -2.4, 1.4), (0.8, -2.0, 2.5), (0.2, 1.0, -2.0)]):
        beyond = eye + 1.7 * (gauge.place(q) - eye)
        assert gauge.value(eye, beyond, q + 0.1) == pytest.approx(q, abs=1e-9)


def test_the_arc_lies_outside_of_the_part_and_begins_where_it_is() -> None:
    gauge = LimitGauge.of(DOOR, PANEL, 1.0)
    reach = np.linalg.norm((PANEL - DOOR.origin)[:, :2], axis=1).max()
    assert reach < gauge.radius < 1.1 * reach
    assert gauge.place(0.0)[0] > 0.0 and gauge.place(0.0)[1] == pytest.approx(-0.25, abs=0.01)
    assert gauge.place(math.pi / 2)[1] < -0.5, "it opens to the front"
    lengths = np.linalg.norm(np.diff(gauge.line(0.0, 1.6), axis=1), axis=2)
    assert lengths.sum() == pytest.approx(1.6 * gauge.radius, rel=1e-3)


def test_turns_are_counted_and_an_edge_on_view_follows_the_screen() -> None:
    gauge = LimitGauge.of(DOOR, PANEL, 1.0)
    eye = np.array([0.0, -3.0, 4.0])
    assert gauge.value(eye, gauge.place(0.2), math.tau) == pytest.approx(math.tau + 0.2)
    level = np.array([0.0, -3.0, gauge.center[2]])
    assert gauge.value(level, gauge.place(0.9), 0.8) == pytest.approx(0.9)


def test_values_snap_and_limits_dont_pass_each_other() -> None:
    assert snapped(math.radians(47.2), True, coarse=True) == pytest.approx(math.radians(45))
    assert snapped(0.1234, False, coarse=True) == pytest.approx(0.125)
    assert snapped(0.12344, False, coarse=False) == pytest.approx(0.1234)
    assert limits_with(DRAWER, "lower", 0.5) == (0.35, 0.35)
    assert limits_with(DRAWER, "upper", -0.1) == (0.0, 0.0)


def test_a_knob_has_an_arc_that_can_be_grabbed() -> None:
    turn = np.linspace(0, math.tau, 60, endpoint=False)
    ring = np.stack([0.01 * np.cos(turn), np.full(60, -0.3), 0.01 * np.sin(turn)], axis=1)
    knob = Joint("knob", "revolute", "base", "link_1", (0, -1, 0), (0, -0.3, 0), -1.0, 1.0)
    gauge = LimitGauge.of(knob, ring, 1.0)
    assert gauge.radius == pytest.approx(0.09)
    assert abs(gauge.zero @ gauge.axis) < 1e-9 and np.linalg.norm(gauge.zero) == pytest.approx(1)
