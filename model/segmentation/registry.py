"""The one table of segmenters: ours, and plug-ins of the entry-point group."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from importlib.metadata import entry_points

from model.core.errors import ConfigurationError
from model.core.plug_ins import load_plug_in
from model.segmentation import baselines
from model.segmentation.default import DefaultSegmenter
from model.segmentation.protocol import Segmenter

GROUP = "artiworld.segmenters"
DEFAULT = "default"
POINT_SAM = "point-sam"

_BUILT_IN: dict[str, Callable[[], Segmenter]] = {
    DEFAULT: DefaultSegmenter,
    "region-growing": baselines.region_growing,
    "random-walk": baselines.random_walk,
    "nearest": baselines.nearest_click,
}

SEGMENTERS: list[str] = list(_BUILT_IN)
"""Names of the built-in segmenters; :func:`segmenter_names` adds the plug-ins."""


@lru_cache(maxsize=1)
def _table() -> dict[str, Callable[[], Segmenter]]:
    table = dict(_BUILT_IN)
    for entry in entry_points(group=GROUP):
        # Ours win: a plug-in can't take the place of a built-in without being asked for.
        if entry.name not in table:
            table[entry.name] = partial(
                load_plug_in, entry, "segmenter", Segmenter, "name and encode"
            )
    return table


def _with_weights(name: str) -> Callable[[], Segmenter] | None:
    """The segmenter of a name like ``point-sam:PATH``, or None for other names."""
    kind, colon, path = name.partition(":")
    if not colon or kind != POINT_SAM:
        return None
    from model.segmentation.adapters.point_sam import PointSamSegmenter

    return lambda: PointSamSegmenter(path)


def check_segmenter(name: str) -> None:
    """Refuse a name that :func:`load_segmenter` would refuse; loads no network.

    Raises:
        ConfigurationError, InputFileError: for an unknown name, or weights that aren't there.
    """
    made = _with_weights(name)
    if made is not None:
        made()
    elif name not in _table():
        raise ConfigurationError(
            f"no segmenter is called {name!r}; there are {', '.join(segmenter_names())}, "
            f"and {POINT_SAM}:PATH"
        )


def segmenter_names() -> list[str]:
    """Names that :func:`load_segmenter` knows, the default first."""
    return [DEFAULT, *sorted(n for n in _table() if n != DEFAULT)]


def load_segmenter(name: str = DEFAULT) -> Segmenter:
    """The segmenter called ``name``; ``point-sam:PATH`` is Point-SAM with the weights at PATH.

    Raises:
        ConfigurationError: for an unknown name, or a plug-in that can't be loaded.
        InputFileError: where there are no weights at PATH.
    """
    check_segmenter(name)
    return (_with_weights(name) or _table()[name])()
