"""Whether a predictor's confidence means what it says."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from model.evaluation.joint_metrics import ObjectScore

BINS = 10


@dataclass(frozen=True)
class CalibrationBin:
    """Joints of similar confidence.

    Attributes:
        low, high: of the bin, 0..1. joints: in it.
        confidence: their mean. usable: share of them that were usable.
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
    """Compare confidences with what became of the joints; extra joints are left out."""
    pairs = [
        (j.confidence, float(j.usable))
        for o in scores
        for j in o.joints
        if j.present and j.confidence is not None
    ]
    if not pairs:
        return Calibration((), 0, math.nan, math.nan)
    sure, right = np.array(pairs).T
    place = np.minimum((sure * bins).astype(int), bins - 1)
    found = []
    for k in np.unique(place):
        here = place == k
        found.append(
            CalibrationBin(
                float(k / bins),
                float((k + 1) / bins),
                int(here.sum()),
                float(sure[here].mean()),
                float(right[here].mean()),
            )
        )
    ece = sum(b.joints * abs(b.confidence - b.usable) for b in found) / len(pairs)
    return Calibration(tuple(found), len(pairs), ece, float(np.mean((sure - right) ** 2)))
