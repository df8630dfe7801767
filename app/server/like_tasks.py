"""Jobs that find which accepted object an open one is like, and carry its parts over."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from app.server.segmenting_tasks import session_of
from app.server.tasks import arrays_of
from app.server.tool_tasks import NEW_PART, RegionOffer
from model.core.errors import ArtiworldError
from model.core.memory import LruCache
from model.core.progress import Progress, no_progress
from model.geometry.like_object import Example, best_match, example_of
from model.io.assets.reader import load_object
from model.segmentation.registry import DEFAULT
from model.segmentation.similar import carry_over

LIKE = "like"
"""First word of the recorded tool; the second one is the asset's folder."""
FIT, AGREEMENT = 0.9, 0.6
"""Least fit and agreement of an offer; chosen on 37 objects scanned twice (docs/annotate.md)."""
CLOSE_FIT, LITTLE_AGREEMENT = 0.97, 0.2
"""The same where the shapes hardly differ: clicks that are answered badly are those to save."""
_KEPT = 256

_examples: LruCache[tuple[Path, int], Example | None] = LruCache(_KEPT)


@dataclass(frozen=True)
class LikeOffer:
    """Parts that an accepted object has where this one has them, too.

    Attributes:
        folder: name of the accepted asset's folder.
        regions: of the parts. names: of the parts, in the same order.
        category: of the accepted object.
    """

    folder: str
    regions: tuple[RegionOffer, ...]
    names: tuple[str | None, ...]
    category: str | None


def find_alike(
    folder: Path, workspace: Path, assets: Sequence[Path], progress: Progress = no_progress
) -> LikeOffer | None:
    """Return the parts of the accepted asset that fits best; None where none fits well.

    Args:
        folder: of the working copy. assets: folders of accepted assets, likeliest first.
    """
    session = session_of(folder, DEFAULT)
    if session.encoding.room is not None:
        return None
    examples = []
    for k, asset in enumerate(assets):
        progress(0.6 * k / len(assets), "Looking for an object like it")
        example = _example(asset)
        if example is not None:
            examples.append(example)
    match = best_match(examples, session.encoding.nodes.points)
    if match is None or match.fit < FIT:
        return None
    progress(0.8, "Looking for an object like it")
    parts = carry_over(session, match)
    least = LITTLE_AGREEMENT if match.fit >= CLOSE_FIT else AGREEMENT
    if not parts.links or parts.agreement < least:
        return None
    regions, names = [], []
    of_link = dict(zip(match.example.links, match.example.names, strict=True))
    for part, link in sorted(parts.links.items()):
        elements = np.flatnonzero(parts.labels == part).astype(np.int64)
        ref = arrays_of(workspace).put(elements)
        regions.append(RegionOffer(NEW_PART, ref, len(elements)))
        names.append(of_link[link])
    return LikeOffer(match.example.name, tuple(regions), tuple(names), match.example.category)


def _example(asset: Path) -> Example | None:
    """An accepted asset to compare with; None where its folder is gone or damaged."""

    def read() -> Example | None:
        with contextlib.suppress(ArtiworldError):
            return example_of(load_object(asset), asset.name)
        return None

    with contextlib.suppress(OSError):
        return _examples.get((asset, asset.stat().st_mtime_ns), read)
    return None


def object_name(asset_folder: str) -> str:
    """The name of the object that an accepted asset's folder is named after."""
    return asset_folder.rpartition("-")[0] or asset_folder
