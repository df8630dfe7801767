"""A guess at one joint, with its score and the reason for it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from model.core.joint import JointType

Array = npt.NDArray[np.float64]

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One possible joint of a part, in the working frame.

    Attributes:
        type: joint type.
        axis: (3,) unit; positive q opens. origin: (3,) on the axis.
        lower, upper: rad or diagonals; meaningless for continuous joints.
        score: sum of the cues; only differences between hypotheses of one part mean anything.
        note: the cues in words, for people.
        travel: for a joint that also slides along its axis (a screw cap, a lifting seat): the range
            (diagonals) of the prismatic joint that comes first, on a helper link.
    """

    type: JointType
    axis: Array
    origin: Array
    lower: float = 0.0
    upper: float = 0.0
    score: float = 0.0
    note: str = ""
    travel: tuple[float, float] | None = None

    def scored(self, extra: float, reason: str = "") -> Hypothesis:
        """The same with ``extra`` added to the score."""
        note = f"{self.note}, {reason}" if reason and self.note else reason or self.note
        return replace(self, score=self.score + extra, note=note)


def unit(v: Array) -> Array:
    """``v`` at length 1; +z where it has none."""
    length = float(np.linalg.norm(v))
    return v / length if length > 1e-12 else UP.copy()


def snapped(axis: Array, candidates: Array, tolerance: float = 0.05) -> Array:
    """The nearest of some unit axes (rows), sign kept, where it is within ``tolerance`` rad."""
    dots = candidates @ axis
    k = int(np.argmax(np.abs(dots)))
    if abs(dots[k]) >= np.cos(tolerance):
        return candidates[k] * np.sign(dots[k])
    return axis


def confidence(hypotheses: list[Hypothesis]) -> float:
    """Share of the best in a softmax over the scores, 0..1."""
    if not hypotheses:
        return 0.0
    scores = np.array([h.score for h in hypotheses])
    weights = np.exp(2.0 * (scores - scores.max()))
    return float(weights.max() / weights.sum())
