"""The port that every predictor fits: geometry alone, and Arti4URDF."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from model.core.articulated_object import Prediction, SegmentedObject
from model.core.joint import Joint
from model.core.progress import Progress, no_progress


@runtime_checkable
class Predictor(Protocol):
    """Parts in, kinematic tree out."""

    name: str

    def predict(
        self,
        segmented: SegmentedObject,
        *,
        locked: tuple[Joint, ...] = (),
        seed: int = 0,
        progress: Progress = no_progress,
    ) -> Prediction:
        """Predict the tree of ``segmented``.

        Args:
            segmented: parts; category and part names are hints that may be missing.
            locked: joints that a person has fixed; they are returned unchanged.
            seed: the only source of randomness.
            progress: may raise :class:`~model.core.progress.Cancelled`.
        """
        ...
