"""The plain baseline: every part is hinged at the longest edge of its bounding box."""

from __future__ import annotations

import itertools
import math

import numpy as np

from model.core.articulated_object import Prediction, SegmentedObject
from model.core.joint import Joint
from model.core.tree import KinematicTree

LONGEST_EDGE = "longest edge"
"""Its name among predictors of an evaluation."""


def longest_edge(segmented: SegmentedObject) -> Prediction:
    """The part with the largest box is the base; the others turn by a quarter about that of their
    four longest edges which is nearest to its middle. Nothing else is looked at."""
    base = max(segmented.parts, key=lambda p: float(np.prod(np.ptp(p.bounds, axis=0))))
    middle = base.bounds.mean(axis=0)
    joints = []
    for part in segmented.parts:
        if part is base:
            continue
        along = int(np.argmax(np.ptp(part.bounds, axis=0)))
        corners = [
            np.array([part.bounds[side, axis] for axis, side in enumerate(sides)], np.float64)
            for sides in itertools.product((0, 1), repeat=3)
            if not sides[along]
        ]
        x, y, z = min(corners, key=lambda corner: float(np.linalg.norm(corner - middle))).tolist()
        i, j, k = np.eye(3)[along].tolist()
        joints.append(Joint(
            f"joint_{part.link}", "revolute", base.link, part.link, (i, j, k), (x, y, z),
            0.0, math.pi / 2,
        ))  # fmt: skip
    links = tuple(p.link for p in segmented.parts)
    return Prediction(KinematicTree(links, tuple(joints)))
