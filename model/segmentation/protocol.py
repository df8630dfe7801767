"""The port of segmenters: the default one, baselines, adapters of published networks, plug-ins."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from model.core.asset import Asset
from model.core.progress import Progress, no_progress
from model.segmentation.arrays import Bool
from model.segmentation.prompts import PartSegmentation, Prompts


@runtime_checkable
class SegmentationSession(Protocol):
    """An asset encoded once. It lives in the worker process and holds caches, never decisions."""

    asset: Asset

    def segment(self, prompts: Prompts) -> PartSegmentation:
        """Labels for all elements.

        They depend on ``prompts`` only, whatever was asked before: undo is asking again with one
        prompt less. Every clicked element has the part that its click demands. Without prompts
        everything belongs to the base.

        Raises:
            PromptError: if a prompt doesn't fit the asset.
        """
        ...

    def candidates(self, prompts: Prompts, part: int) -> list[Bool]:
        """Other masks (E,) for the latest click of ``part``, best first; may be empty."""
        ...


@runtime_checkable
class Segmenter(Protocol):
    """Turns an asset into a :class:`SegmentationSession`."""

    name: str

    def encode(self, asset: Asset, progress: Progress = no_progress) -> SegmentationSession:
        """Compute everything that doesn't depend on prompts. May take seconds; reports progress."""
        ...
