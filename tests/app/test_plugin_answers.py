"""What a predictor's plug-in gives back is checked before it counts."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from app.server import part_tasks
from app.server.part_tasks import checked
from model.core.articulated_object import Part, Prediction, SegmentedObject
from model.core.errors import ConfigurationError
from model.core.geometry import PointCloud
from model.core.tree import KinematicTree
from model.validation import messages
from model.validation.fixes import checked_ranges
from model.validation.report import Severity
from model.validation.runner import scene_of, validate
from tests.builders import linked, part
from tests.model.validation.cabinets import DOOR, DRAWER, carcass, door_part, drawer_part

PARTS = SegmentedObject("box", (Part("link_0", cloud=PointCloud(np.zeros((1, 3), np.float32))),))


@pytest.mark.parametrize("answer", [None, {}, "URDF"])
def test_no_prediction_is_refused_by_name(answer: object) -> None:
    with pytest.raises(ConfigurationError, match=r"predictor 'theirs' gave a .* instead of"):
        checked("theirs", PARTS, answer)


def test_a_tree_of_other_links_is_a_problem_and_no_crash() -> None:
    good = Prediction(KinematicTree(("link_0",)))
    assert checked("theirs", PARTS, good) is good
    found = checked("theirs", PARTS, Prediction(KinematicTree(("link_7",)), ("slow",)))
    assert found.tree is None and len(found.problems) == 3


@pytest.mark.parametrize(
    ("lower", "note", "severity"),
    [
        (0.0, "", Severity.OK),
        (-0.1, messages.RANGE_CUT, Severity.OK),
        (-0.5, messages.RANGE_REFUSED, Severity.ERROR),  # less than half of it is left
    ],
)
def test_a_predicted_range_has_been_through_the_checks(
    monkeypatch: pytest.MonkeyPatch, lower: float, note: str, severity: Severity
) -> None:
    """A drawer with 3 cm to the back wall is predicted to go in further."""
    drawer = replace(DRAWER, lower=lower)
    parts = part("link_0", *carcass(), name="body"), drawer_part()
    made = linked((drawer,), *parts)
    answer = Prediction(made.tree, notes={"link_2": "Drawer. Range: from a motion sweep"})
    predictor = SimpleNamespace(predict=lambda *_, **__: answer)
    monkeypatch.setattr(part_tasks, "load_predictor", lambda _: predictor)
    monkeypatch.setattr(part_tasks, "segmented_object", lambda _: SegmentedObject("c", parts))
    source: Any = None
    found = part_tasks.predict(source, "theirs", (), 0)
    assert found.tree is not None and found.notes["link_2"].endswith(note)
    joint = found.tree.joint_of["link_2"]
    assert (joint == drawer) == (note != messages.RANGE_CUT) and joint.upper == drawer.upper
    report = validate(replace(made, tree=found.tree), physics=False, fixes=False)
    assert report.severity == severity
    kept = part_tasks.predict(source, "theirs", (drawer,), 0)
    assert kept == answer, "what a person locked stays"


def test_the_axis_of_a_predicted_hinge_is_shifted_where_its_door_would_hit() -> None:
    door = replace(DOOR, origin=(-0.38, -0.002, 0.3))
    scene, _ = scene_of(linked((door,), part("link_0", *carcass(), name="body"), door_part()))
    assert scene is not None
    found = checked_ranges(Prediction(scene.obj.tree), scene, ())
    assert found.tree is not None and found.notes == {"link_1": messages.AXIS_SHIFTED}
    moved = found.tree.joint_of["link_1"]
    assert moved == replace(door, origin=moved.origin) and moved.origin[0] < -0.39
