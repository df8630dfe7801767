"""Assembly of a prediction from the joints of its parts."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from model.core.articulated_object import Prediction
from model.core.errors import KinematicsError
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.prediction.confidence import ConfidenceModel, Evidence, least_certain
from model.prediction.explanation import LOCKED


def unknown_link(joint: Joint) -> str:
    """The problem of a locked joint whose child is no link."""
    return f"locked joint {joint.name!r} has the unknown child link {joint.child!r}"


@dataclass(eq=False)
class PredictionBuilder:
    """Collects joints with their evidence and assembles the prediction.

    Attributes:
        links: of the parts. locked: joints fixed by a person, kept unchanged.
        confidence_model: of the predictor. problems: human-readable.
        evidence: child link → evidence of its joint.
        alternatives: see :class:`~model.core.articulated_object.Prediction`.
    """

    links: tuple[str, ...]
    locked: tuple[Joint, ...]
    confidence_model: ConfidenceModel
    problems: list[str] = field(default_factory=list)
    evidence: dict[str, Evidence] = field(default_factory=dict)
    alternatives: dict[str, tuple[Joint, ...]] = field(default_factory=dict)
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
        confidence = {k: self.confidence_model.confidence(e) for k, e in self.evidence.items()}
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
        known = {*self.links, *self._helpers}
        ends = (end for j in self.locked for end in (j.parent, j.child) if end not in known)
        links = (*self.links, *self._helpers, *dict.fromkeys(ends))
        taken = {j.name for j in self.locked}
        joints = (
            replace(j, name=f"{j.name}_predicted") if j.name in taken else j for j in self._joints
        )
        try:
            return KinematicTree(links, (*joints, *self.locked))
        except KinematicsError as error:
            self.problems += error.problems
            return None
