"""The first object of ``make run``, a scan: two doors over a drawer, from clicks to joints."""

import json
from functools import cache

import pytest

from model.core.articulated_object import Part, SegmentedObject
from model.core.files import static_assets
from model.geometry.splitting import split
from model.io.open_asset import open_asset
from model.prediction.registry import load_predictor
from model.segmentation.prompts import Click, Prompts
from model.segmentation.registry import load_segmenter

EXAMPLES = static_assets() / "examples"
CLICKS = 2
"""Of the bundled ones for each part."""
NAMES = {1: "door", 2: "door", 3: "drawer"}


@cache
def clicked_parts(*, named: bool) -> tuple[Part, ...]:
    given = json.loads((EXAMPLES / "refrigerator_scan.prompts.json").read_text())["clicks"]
    clicks = [
        Click(tuple(c["position"]), c["part"])
        for part in NAMES
        for c in [c for c in given if c["part"] == part][:CLICKS]
    ]
    scan = open_asset(EXAMPLES / "refrigerator_scan.ply")
    labels = load_segmenter().encode(scan).segment(Prompts(tuple(clicks))).labels
    return split(scan, labels, NAMES if named else {})


@pytest.mark.parametrize("predictor", ["hybrid", "geometric"])
@pytest.mark.parametrize("named", [False, True])
def test_doors_turn_and_the_drawer_comes_out(named: bool, predictor: str) -> None:
    """Handles stick out of the doors farther than out of the drawer: the fronts still are in one
    plane, and nothing there slides past another panel."""
    parts = clicked_parts(named=named)
    found = load_predictor(predictor).predict(SegmentedObject("refrigerator", parts))
    assert found.tree is not None
    joints = found.tree.joint_of
    assert [joints[f"link_{k}"].type for k in (1, 2, 3)] == ["revolute", "revolute", "prismatic"]
    assert joints["link_1"].axis == pytest.approx((0, 0, -1), abs=0.02)
    assert joints["link_2"].axis == pytest.approx((0, 0, 1), abs=0.02)
    assert joints["link_3"].axis == pytest.approx((0, -1, 0), abs=0.02)
