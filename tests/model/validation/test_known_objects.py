"""Ground truth passes: bundled examples of each kind of joint have no error."""

import pytest

from model.validation.report import Severity
from model.validation.runner import validate
from tests.model.demos import demo_object


@pytest.mark.parametrize("name", ["cabinet", "desk_lamp", "kettle", "oven_scan"])
def test_no_true_joint_of_a_bundled_example_is_broken(name):
    # A scan's shapes take long, and tests/model/physics/test_simulated.py drives them.
    report = validate(demo_object(name), shapes=not name.endswith("_scan"), fixes=False)
    broken = [(j.joint, j.message) for j in report.joints_with(Severity.ERROR)]
    assert not broken
    assert report.physics is not None and report.physics.ran
    assert not report.physics.exploded
