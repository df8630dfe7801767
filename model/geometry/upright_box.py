"""The tightest upright box around points."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def box_yaw(flat: npt.NDArray[np.floating[Any]], gain: float = 0.8) -> float:
    """Return the yaw in (-π/4, π/4] of the smallest upright box around points.

    Args:
        flat: (N, 2) x and y, metres.
        gain: another angle than the best so far must bring the area below this share of it.
    """
    best, least = 0.0, np.inf
    for yaw in np.radians([0, *range(-44, 46, 2)]):
        turned = flat @ np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        low, high = np.percentile(turned, (1, 99), axis=0)
        area = float(np.prod(high - low + 1e-9))
        if area < least * gain:
            best, least = float(yaw), area
    return best
