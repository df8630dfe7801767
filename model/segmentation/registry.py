"""All segmenters in one table."""

from __future__ import annotations

from model.core.packages import Registry
from model.segmentation.protocol import Segmenter

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
