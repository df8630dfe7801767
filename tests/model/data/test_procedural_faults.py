"""Faults of procedural objects, one at a time."""

import numpy as np
import pytest

from model.core.errors import ConfigurationError
from model.data.procedural.corruption import FAULTS
from model.data.procedural.generate import ProceduralSet


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_gives_clouds_with_a_true_tree(fault: str) -> None:
    clean = ProceduralSet(seed=3, families=("WashingMachine",))
    data = ProceduralSet(seed=3, families=("WashingMachine",), fault=fault)
    assert data.ids() == clean.ids()
    truth, again = data.load(data.ids()[0]), data.load(data.ids()[0])
    assert all(part.cloud is not None for part in truth.object.parts)
    for part, same in zip(truth.object.parts, again.object.parts, strict=True):
        np.testing.assert_array_equal(part.cloud.points, same.cloud.points)
    moving = [j for j in truth.object.tree.joints if j.moves]
    before = [j for j in clean.load(data.ids()[0]).object.tree.joints if j.moves]
    assert len(moving) <= len(before)
    if fault in ("clouds", "noise", "outliers", "bleed", "turned"):
        assert sorted(j.type for j in moving) == sorted(j.type for j in before)


def test_an_unknown_fault_names_the_known() -> None:
    with pytest.raises(ConfigurationError, match=r"no fault 'rust'.*one-sided"):
        ProceduralSet(fault="rust")
