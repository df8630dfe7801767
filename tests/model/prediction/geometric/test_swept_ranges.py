"""How far parts move before they run into what holds them."""

import pytest

from model.core.articulated_object import SegmentedObject
from model.core.joint import Joint
from model.data.procedural.generate import make
from model.prediction.geometric.predictor import GeometricPredictor

PREDICTOR = GeometricPredictor()


def found_and_true(family: str, seed: int, name: str) -> list[tuple[Joint, Joint]]:
    """Of each part of that name the joint that is predicted, and its true one."""
    truth = make(family, seed)
    prediction = PREDICTOR.predict(
        SegmentedObject(family, truth.object.parts, truth.object.category)
    )
    out = []
    for part in truth.object.parts:
        if part.name == name:
            found = prediction.joint(part.link)
            if found is not None:  # one of two alike is the base
                out.append((found, truth.object.tree.joint_of[part.link]))
    assert out
    return out


@pytest.mark.parametrize("seed", [101, 202])
def test_crossed_legs_turn_until_they_meet(seed: int) -> None:
    """A folding chair's legs had turned through each other, up to 166°."""
    for found, expected in found_and_true("FoldingChair", seed, "leg"):
        assert found.upper == pytest.approx(expected.upper, abs=0.15)


def test_a_thin_lid_shuts_where_it_meets_its_box() -> None:
    """It is thinner than what parts may be mistaken by, and had passed through the box's walls."""
    lid, true = found_and_true("Box", 101, "lid")[0]
    assert lid.lower == pytest.approx(true.lower, abs=0.15)
