"""The port that every segmenter fits: ours, and networks that others published."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from model.core.asset import Asset
from model.core.progress import Progress, no_progress
from model.segmentation.prompts import PartSegmentation, Prompts


@runtime_checkable
class SegmentationSession(Protocol):
    """An asset encoded once. Lives in the worker process; holds caches, never decisions."""

    asset: Asset

    def segment(self, prompts: Prompts) -> PartSegmentation:
        """Labels for all elements.

        The answer depends on ``prompts`` alone (same prompts, same labels, whatever was asked
        before), so undo is asking again with one prompt less. Every clicked element is on the
        side where it was clicked. Without prompts everything belongs to the base.

        Raises:
            PromptError: where a prompt doesn't fit the asset.
        """
        ...

    def candidates(self, prompts: Prompts, part: int) -> list[npt.NDArray[np.bool_]]:
        """Other sensible masks for ``part``, (E,) each, best first; may be empty."""
        ...


@runtime_checkable
class Segmenter(Protocol):
    """Turns an asset into a :class:`SegmentationSession`."""

    name: str

    def encode(self, asset: Asset, progress: Progress = no_progress) -> SegmentationSession:
        """Do once what doesn't depend on prompts. May take seconds; reports progress."""
        ...
