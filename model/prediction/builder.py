"""Assembly of a prediction from its parts' joints, with explanations and calibrated confidence.

The scores of the predictors (a softmax, or a product of experts) are overconfident. Instead a
logistic regression weighs a joint's evidence: log-odds of each decision, and circumstances in which
such decisions fail. It was fitted to how often joints of procedural objects are right in type,
parent, axis, line and range together (:mod:`model.training.arti4urdf.confidence`).
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterable, Mapping
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Part, Prediction
from model.core.errors import InputFileError, KinematicsError
from model.core.files import static_assets
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.kinematics.siblings import share_confidence

SWITCHES = (
    *"network, names, front, contact with other parts, leaves of one front, chains".split(", "),
    *"usual motions of a category, handles, barrels, ajar panels, adjacent panels".split(", "),
    *"sliding past, drop-down doors, bails, pins at ends, swept ranges".split(", "),
    *"shut panels start at zero, usual stops".split(", "),
)
"""Mechanisms of the hybrid that ``without:NAME`` leaves out, to measure what each is worth."""
LEFT_OUT: ContextVar[str] = ContextVar("LEFT_OUT", default="")


def left_out(mechanism: str) -> bool:
    """True while a prediction does without one of :data:`SWITCHES`."""
    return LEFT_OUT.get() == mechanism


COLLISION_FREE = "Range: from a motion sweep"
CHAIN_PLANE = "normal to the plane of its chain"
FREE_AXIS = "Axis: from the network alone"
LOCKED = "Locked joint"


def as_on(objects: int) -> str:
    """Remark that joints of accepted objects were compared."""
    return f"Compared with {objects} accepted object{'s' * (objects != 1)}"


def explain(title: str, reasons: Iterable[str] = (), *more: str) -> str:
    """As in "Hinge: opposite the handle, at visible barrels. Range: from a motion sweep".

    Args:
        title: of the motion. reasons: for its place. more: further sentences, "" for none.
    """
    because = ", ".join(reasons)
    first = f"{title}: {because}" if because else title
    return ". ".join(filter(None, (first, *more)))


Array = npt.NDArray[np.float64]
Evidence = Mapping[str, float]
"""Name → number, for one joint."""

BELIEF = 16
"""Joints of accepted objects that a confidence counts as; chosen on Infinigen's choosing half."""
SHIPPED = static_assets() / "confidence.json"
FORMAT = 1
MAX_LOG_ODDS = 6.0
"""Log-odds of one decision are clipped to this: beyond it they carry no information."""
MAX_CONFIDENCE = 0.99
"""One joint in a hundred is wrong for a reason that no evidence shows."""
EXPERIENCE = "experience"
"""Evidence that is a probability by itself: of joints that are as accepted ones were."""
DECISIONS = {"parent": "parent", "type": "joint type", "slot": "axis"}
"""First word of an evidence's name → the decision that it concerns."""
DOUBT = math.log(9)
"""Log-odds below which a decision is in doubt: 90 %."""


@dataclass(frozen=True)
class ConfidenceModel:
    """A logistic regression on a predictor's evidence.

    Attributes:
        names: of the evidence that it reads; missing evidence counts as its mean.
        mean, scale: of each over the objects of the fit. weights: log-odds per standard deviation.
        bias: log-odds at the means.
    """

    names: tuple[str, ...]
    mean: tuple[float, ...]
    scale: tuple[float, ...]
    weights: tuple[float, ...]
    bias: float

    def confidence(self, evidence: Evidence) -> float:
        """Probability that the joint is right, 0..1."""
        odds = self.bias
        for name, mean, scale, weight in zip(
            self.names, self.mean, self.scale, self.weights, strict=True
        ):
            odds += weight * (evidence.get(name, mean) - mean) / scale
        known = evidence.get(EXPERIENCE, 1 / (1 + math.exp(-odds)))
        return round(min(known, MAX_CONFIDENCE), 4)


def least_certain(evidence: Evidence) -> str:
    """A sentence that names the least certain decision; "" if none is in doubt."""
    least = {
        decision: min((v for k, v in evidence.items() if k.split()[0] == name), default=math.inf)
        for name, decision in DECISIONS.items()
    }
    weakest = min(least, key=lambda decision: least[decision])
    return f"Least certain: {weakest}" if least[weakest] < DOUBT else ""


def log_odds(probability: float) -> float:
    """Log-odds within ±:data:`MAX_LOG_ODDS`."""
    clipped = min(max(probability, 1e-6), 1 - 1e-6)
    return min(max(math.log(clipped / (1 - clipped)), -MAX_LOG_ODDS), MAX_LOG_ODDS)


def fit(
    names: tuple[str, ...], values: Array, right: Array, weights: Array, penalty: float = 1.0
) -> ConfidenceModel:
    """Fit the regression by Newton's method.

    Args:
        names: of the columns. values: (N, F). right: (N,) 0 or 1. weights: (N,) of the joints.
        penalty: on the squared weights, not on the bias.
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
    columns = [tuple(round(float(v), 5) for v in column) for column in (mean, scale, at[:-1])]
    return ConfidenceModel(names, *columns, bias=round(float(at[-1]), 5))


@lru_cache(maxsize=8)
def load_confidence(predictor: str, path: Path = SHIPPED) -> ConfidenceModel:
    """The confidence model of a built-in predictor.

    Raises:
        InputFileError: if the file is absent or damaged, or has no model of this predictor.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["format"] != FORMAT:
            raise InputFileError(path, f"has format {data['format']}, expected {FORMAT}")
        found = data["predictors"][predictor]
        lists = {k: tuple(found[k]) for k in ("names", "mean", "scale", "weights")}
        return ConfidenceModel(**lists, bias=float(found["bias"]))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputFileError(path, f"holds no confidence model: {error}") from None


def unknown_link(joint: Joint) -> str:
    """The problem of a locked joint whose child is no link."""
    return f"locked joint {joint.name!r} has the unknown child link {joint.child!r}"


@dataclass(eq=False)
class PredictionBuilder:
    """Collects joints with their evidence and assembles the prediction.

    Attributes:
        parts: of the object. locked: joints fixed by a person, kept unchanged.
        confidence_model: of the predictor. problems: human-readable.
        evidence: child link → evidence of its joint.
        alternatives: see :class:`~model.core.articulated_object.Prediction`.
        checked: numbers of right joints and of all, of accepted objects of the kind; they raise
            a confidence that is lower.
    """

    parts: tuple[Part, ...]
    locked: tuple[Joint, ...]
    confidence_model: ConfidenceModel
    problems: list[str] = field(default_factory=list)
    evidence: dict[str, Evidence] = field(default_factory=dict)
    alternatives: dict[str, tuple[Joint, ...]] = field(default_factory=dict)
    checked: tuple[int, int] = 0, 0
    _joints: list[Joint] = field(default_factory=list)
    _helpers: list[str] = field(default_factory=list)
    _notes: dict[str, str] = field(default_factory=dict)
    _started: float = field(default_factory=time.perf_counter)

    def add(self, joints: list[Joint], evidence: Evidence, note: str) -> None:
        """Add the joints of one part, that of its helper link first."""
        link = joints[-1].child
        self._joints += joints
        self._helpers += [j.child for j in joints[:-1]]
        self.evidence[link] = evidence
        self._notes[link] = ". ".join(filter(None, (note, least_certain(evidence))))

    def build(
        self, backend: str, seed: int, text: Callable[[KinematicTree], str] = lambda tree: ""
    ) -> Prediction:
        """The prediction; ``text`` writes its raw text."""
        tree = self._tree()
        right, joints = self.checked
        own = {k: self.confidence_model.confidence(e) for k, e in self.evidence.items()}
        raised = {k: max(c, (BELIEF * c + right) / (BELIEF + joints)) for k, c in own.items()}
        if tree is not None:
            raised = share_confidence(raised, tree, self.parts)
        confidence = {k: round(min(c, MAX_CONFIDENCE), 4) for k, c in raised.items()}
        confidence |= {j.child: 1.0 for j in self.locked}
        return Prediction(
            tree,
            tuple(self.problems),
            confidence,
            backend,
            seed,
            time.perf_counter() - self._started,
            "" if tree is None else text(tree),
            self._notes | {j.child: LOCKED for j in self.locked},
            alternatives=self.alternatives,
        )

    def _tree(self) -> KinematicTree | None:
        links = tuple(p.link for p in self.parts)
        known = {*links, *self._helpers}
        ends = (end for j in self.locked for end in (j.parent, j.child) if end not in known)
        links = (*links, *self._helpers, *dict.fromkeys(ends))
        taken = {j.name for j in self.locked}
        joints = (
            replace(j, name=f"{j.name}_predicted") if j.name in taken else j for j in self._joints
        )
        try:
            return KinematicTree(links, (*joints, *self.locked))
        except KinematicsError as error:
            self.problems += error.problems
            return None
