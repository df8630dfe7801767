"""Ground truth passes: the bundled examples wholly, a data set with few exceptions."""

from __future__ import annotations

import pytest

from model.validation.runner import run_gate
from tests.model.demos import DEMOS, demo_object


@pytest.mark.parametrize("name", DEMOS)
def test_no_true_joint_of_a_bundled_example_is_broken(name):
    # A scan's shapes take long, and tests/model/physics/test_simulated.py drives them.
    report = run_gate(demo_object(name), shapes=not name.endswith("_scan"), mends=False)
    broken = [(j.joint, j.sentence) for j in report.with_verdict("broken")]
    assert not broken
    assert report.physics is not None and report.physics.ran
    assert not report.physics.exploded
