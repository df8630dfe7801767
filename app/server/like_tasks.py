"""Jobs that find which accepted object an open one is like, and carry its parts and joints over."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from app.server.segmenting_tasks import session_of
from app.server.tasks import arrays_of
from app.server.tool_tasks import NEW_PART, RegionOffer
from model.core.articulated_object import Part
from model.core.errors import ArtiworldError
from model.core.joint import Joint
from model.core.memory import LruCache
from model.core.progress import Progress, no_progress
from model.geometry.like_object import (
    Example,
    Match,
    best_match,
    carried_joint,
    counterparts,
    example_of,
    surface_points,
)
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


@dataclass(frozen=True)
class CarriedJoints:
    """Joints of an accepted asset on another object's parts.

    Attributes:
        name: of the accepted object. fit: 0..1, of the two objects.
    """

    joints: tuple[Joint, ...] = ()
    name: str = ""
    fit: float = 0.0


def object_name(asset_folder: str) -> str:
    """The name of the object that an accepted asset's folder is named after."""
    return asset_folder.rpartition("-")[0] or asset_folder


def carried_joints(parts: Sequence[Part], asset: Path) -> CarriedJoints:
    """Return an accepted asset's joints on those of ``parts`` that have a counterpart in it.

    Where parent or child has none, a joint is left to the predictor, and so are chains.
    """
    example = _example(asset)
    match = None if example is None else best_match([example], surface_points(parts))
    if match is None or match.fit < FIT:
        return CarriedJoints()
    return CarriedJoints(joints_of(match, parts), object_name(asset.name), match.fit)


def joints_of(match: Match, parts: Sequence[Part]) -> tuple[Joint, ...]:
    """Return the joints of a match's example on the parts that have a counterpart."""
    example = match.example
    of_part = counterparts(match, parts)
    name_of = dict(zip(example.links, example.names, strict=True))
    # A part that was renamed since isn't what the example has there.
    for part in parts:
        link = of_part.get(part.link)
        if link is not None and link != example.root and name_of[link] != part.name:
            del of_part[part.link]
    of_link = {link: part for part, link in of_part.items()}
    bounds = {part.link: part.bounds for part in parts}
    out = []
    for joint in example.joints:
        child, parent = of_link.get(joint.child), of_link.get(joint.parent)
        if child is None or parent is None or joint.mimic is not None:
            continue
        own = example.points[example.part == example.links.index(joint.child)]
        before = np.array([own.min(axis=0), own.max(axis=0)])
        out.append(carried_joint(match, joint, before, bounds[child], child, parent))
    return tuple(out)
