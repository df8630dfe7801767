"""Predicted ranges that end at the usual stop of such a part."""

from dataclasses import replace

import numpy as np
import pytest

from model.core.articulated_object import SegmentedObject
from model.prediction.geometric.context import JointProposal, joints_of, usual_stop
from model.prediction.geometric.sampled_object import sample_object
from tests.model.validation.cabinets import box, part


@pytest.mark.parametrize(("name", "metres"), [("power_button", 0.005), ("Keys", 0.005)])
def test_what_is_pressed_stops_after_a_few_millimetres(name, metres):
    assert usual_stop(name) == metres


@pytest.mark.parametrize("name", [None, "drawer", "monkey"])
def test_other_parts_have_no_usual_stop(name):
    assert usual_stop(name) == np.inf


@pytest.mark.parametrize(("travel", "upper"), [(0.5, 0.005), (0.001, 0.002)])
def test_the_smaller_of_both_stops_counts(travel, upper):
    """An object with a diagonal of two metres; travels of proposals are in diagonals."""
    size = 2 / np.sqrt(3)
    base = part("link_0", box([0, 0, 0], [size, size, size]))
    button = part("link_1", box([0.4, -0.02, 0.4], [0.6, 0.0, 0.6]), name="button")
    sampled = sample_object(SegmentedObject("x", (base, button)))
    scale = 2 / sampled.frame.diagonal
    proposal = JointProposal("prismatic", np.array([0.0, 1.0, 0.0]), np.zeros(3), 0.0, travel)
    (joint,) = joints_of(sampled, 1, 0, proposal)
    assert joint.upper == pytest.approx(upper, rel=0.03 if scale != 1 else 1e-6)
    turning = replace(proposal, type="revolute", upper=1.5)
    assert joints_of(sampled, 1, 0, turning)[0].upper == 1.5
