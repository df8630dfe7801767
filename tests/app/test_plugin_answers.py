"""What a predictor's plug-in gives back is checked before it counts."""

from __future__ import annotations

import numpy as np
import pytest

from app.server.part_tasks import checked
from model.core.articulated_object import Part, Prediction, SegmentedObject
from model.core.errors import ConfigurationError
from model.core.geometry import PointCloud
from model.core.tree import KinematicTree

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
