"""Calibration of a predictor's confidence."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.evaluation.joint_metrics import ObjectScore

BINS = 10


@dataclass(frozen=True)
class CalibrationBin:
    """Joints of similar confidence.

    Attributes:
        low, high: of the bin, 0..1. joints: in it.
        confidence: their mean. usable: share of usable joints.
    """

    low: float
    high: float
    joints: int
    confidence: float
    usable: float


@dataclass(frozen=True)
class Calibration:
    """Reliability of a predictor (Guo et al., *On Calibration*, 2017).

    Attributes:
        bins: those that hold a joint.
        joints: with a confidence.
        ece: expected calibration error, the mean gap between confidence and the share of usable
            joints, weighted by the joints of each bin; NaN without any.
        brier: mean squared gap between confidence and usable (1) or not (0).
    """

    bins: tuple[CalibrationBin, ...]
    joints: int
    ece: float
    brier: float


def calibrate(scores: Iterable[ObjectScore], *, bins: int = BINS) -> Calibration:
    """Compare confidences with the joints' usability; extra joints are left out."""
    pairs = [
        (j.confidence, float(j.usable))
        for o in scores
        for j in o.joints
        if j.present and j.confidence is not None
    ]
    if not pairs:
        return Calibration((), 0, math.nan, math.nan)
    confidence, right = np.array(pairs).T
    return compared(confidence, right, bins=bins)


def compared(
    confidence: npt.NDArray[np.floating],
    right: npt.NDArray[np.floating],
    weights: npt.NDArray[np.floating] | None = None,
    *,
    bins: int = BINS,
) -> Calibration:
    """Compare (N,) confidences with (N,) outcomes, 1 or 0, with optional ``weights`` (N,)."""
    weights = np.ones(len(confidence)) if weights is None else weights
    place = np.minimum((confidence * bins).astype(int), bins - 1)
    found, ece = [], 0.0
    for k in np.unique(place):
        here = place == k
        mean, usable = (
            float(np.average(values[here], weights=weights[here])) for values in (confidence, right)
        )
        found.append(
            CalibrationBin(float(k / bins), float((k + 1) / bins), int(here.sum()), mean, usable)
        )
        ece += float(weights[here].sum()) * abs(mean - usable)
    brier = float(np.average((confidence - right) ** 2, weights=weights))
    return Calibration(tuple(found), len(confidence), ece / float(weights.sum()), brier)
