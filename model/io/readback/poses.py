"""Comparison of the link poses that a reader reports with ``pose(q)``."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from model.io.assets.reload import Poses

TOLERANCE = 1e-5
"""Metres and entries of rotation matrices, in the size of the pose where that is above 1."""


def pose_problems(
    reader: str, expected: Poses, seen: Mapping[str, np.ndarray], tolerance: float = TOLERANCE
) -> list[str]:
    """Links that are elsewhere, or missing."""
    out: list[str] = []
    for link, pose in expected.items():
        if link not in seen:
            out.append(f"{reader} doesn't know the link {link!r}")
            continue
        error = float(np.abs(pose - seen[link]).max())
        scale = max(1.0, float(np.abs(pose).max()))
        if not error <= tolerance * scale:
            shown = "not a number" if math.isnan(error) else f"off by {error:.3g}"
            out.append(f"{reader} puts {link!r} elsewhere, {shown}")
    return out
