"""The port of segmenters, and the table of them all: the default, baselines, networks, plug-ins."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from model.core.asset import Asset
from model.core.packages import Registry
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


DEFAULT = "default"
POINT_SAM = "point-sam"

SEGMENTERS = Registry[Segmenter](
    "segmenter",
    Segmenter,
    "name and encode",
    {
        DEFAULT: "model.segmentation.default:DefaultSegmenter",
        "nearest": "model.segmentation.baselines:nearest_click",
        "random-walk": "model.segmentation.baselines:random_walk",
        "region-growing": "model.segmentation.baselines:region_growing",
    },
    group="artiworld.segmenters",
    parametrised={POINT_SAM: "model.segmentation.adapters.point_sam:PointSamSegmenter"},
    argument="PATH",
)


def check_segmenter(name: str) -> None:
    """Refuse a name that :func:`load_segmenter` would refuse; loads no network.

    Raises:
        ConfigurationError, InputFileError: for an unknown name, or weights that aren't there.
    """
    SEGMENTERS.check(name)
    if name.startswith(f"{POINT_SAM}:"):
        SEGMENTERS.load(name)  # checks that its file exists, and reads nothing yet


def segmenter_names() -> list[str]:
    """Names that :func:`load_segmenter` knows, the default first."""
    return list(SEGMENTERS.names())


def load_segmenter(name: str = DEFAULT) -> Segmenter:
    """The segmenter called ``name``; ``point-sam:PATH`` is Point-SAM with the weights at PATH.

    Raises:
        ConfigurationError: for an unknown name, or a plug-in that can't be loaded.
        InputFileError: if there are no weights at PATH.
    """
    return SEGMENTERS.load(name)
