"""How sure a predictor is of a joint: what it found out, weighed as made objects taught.

What the predictors work with are scores: a softmax over them, or a product of experts, is far surer
than it is right. Here a joint's evidence (log-odds of each decision, and what makes such decisions
go wrong) is weighed by a logistic regression that was fitted to how often joints of procedural
objects are right: type, parent, axis, line and range together
(:mod:`model.training.arti4urdf.confidence`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.errors import InputFileError
from model.core.resources import static_assets

Array = npt.NDArray[np.float64]
Evidence = Mapping[str, float]
"""Name → number of what is known about one joint."""

SHIPPED = static_assets() / "confidence.json"
FORMAT = 1
MOST_ODDS = 6.0
"""Log-odds beyond which a decision's own probability says nothing more."""
SUREST = 0.99
"""No prediction is surer: one joint in a hundred is wrong for a reason that nothing here shows."""


@dataclass(frozen=True)
class Weighing:
    """A logistic regression on a predictor's evidence.

    Attributes:
        names: of the evidence that is read; what is missing counts as its mean.
        mean, scale: of each, on the objects that it was fitted to. weights: a standard deviation's
            worth in log-odds. bias: log-odds at the means.
    """

    names: tuple[str, ...]
    mean: tuple[float, ...]
    scale: tuple[float, ...]
    weights: tuple[float, ...]
    bias: float

    def of(self, evidence: Evidence) -> float:
        """0..1 that a joint is right."""
        odds = self.bias
        for name, mean, scale, weight in zip(
            self.names, self.mean, self.scale, self.weights, strict=True
        ):
            odds += weight * (evidence.get(name, mean) - mean) / scale
        return round(min(1 / (1 + math.exp(-odds)), SUREST), 4)

    def to_json(self) -> dict[str, Any]:
        """As plain lists."""
        return asdict(self)


DECISIONS = {"parent": "what it hangs on", "type": "how it moves", "slot": "its axis"}
DOUBT = math.log(9)
"""Log-odds below which a decision is doubted: nine in ten."""


def doubt(evidence: Evidence) -> str:
    """Which decision the evidence speaks for least, in words; "" where none is doubted."""
    least = {
        told: min((v for k, v in evidence.items() if k.split()[0] == name), default=MOST_ODDS)
        for name, told in DECISIONS.items()
    }
    weakest = min(least, key=lambda told: least[told])
    return f"least sure of {weakest}" if least[weakest] < DOUBT else ""


def log_odds(probability: float) -> float:
    """Of a decision, within ±:data:`MOST_ODDS`."""
    kept = min(max(probability, 1e-6), 1 - 1e-6)
    return min(max(math.log(kept / (1 - kept)), -MOST_ODDS), MOST_ODDS)


def fit(
    names: tuple[str, ...], values: Array, right: Array, weights: Array, penalty: float = 1.0
) -> Weighing:
    """The regression by Newton's method.

    Args:
        names: of the columns. values: (N, F). right: (N,) 0 or 1. weights: (N,) of each joint.
        penalty: on the squared weights, none on the bias.
    """
    mean = np.average(values, axis=0, weights=weights)
    scale = np.sqrt(np.average((values - mean) ** 2, axis=0, weights=weights))
    scale = np.where(scale > 1e-9, scale, 1.0)
    x = np.column_stack([(values - mean) / scale, np.ones(len(values))])
    ridge = np.diag([penalty] * len(names) + [1e-6])
    at = np.zeros(x.shape[1])
    for _ in range(50):
        p = 1 / (1 + np.exp(-x @ at))
        slope = x.T @ (weights * (p - right)) + ridge @ at
        curve = x.T @ (x * (weights * p * (1 - p))[:, None]) + ridge
        step = np.linalg.solve(curve, slope)
        at = at - step
        if np.abs(step).max() < 1e-8:
            break
    told = [tuple(round(float(v), 5) for v in column) for column in (mean, scale, at[:-1])]
    return Weighing(names, told[0], told[1], told[2], round(float(at[-1]), 5))


@lru_cache(maxsize=8)
def weighing_of(predictor: str, path: Path = SHIPPED) -> Weighing:
    """That of a predictor of ours.

    Raises:
        InputFileError: where the file is absent or damaged, or holds none for it.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["format"] != FORMAT:
            raise InputFileError(path, f"has format {data['format']}, this reads {FORMAT}")
        found = data["predictors"][predictor]
        lists = {k: tuple(found[k]) for k in ("names", "mean", "scale", "weights")}
        return Weighing(**lists, bias=float(found["bias"]))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputFileError(path, f"holds no confidence: {error}") from None
