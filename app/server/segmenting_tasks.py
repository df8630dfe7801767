"""Jobs that answer clicks: the elements under a ray, in a box or under a stroke, and the labels for
the prompts. An asset is encoded once, then segmented after each change of prompts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.server.tasks import arrays_of, asset_of, pixels_of
from model.core.asset import Asset
from model.core.memory import LruCache
from model.core.progress import Progress, no_progress
from model.geometry.crop import largest_component
from model.geometry.picking import Camera, Pick, Picker, Stroke
from model.segmentation.prompts import Click, Prompts, Region
from model.segmentation.registry import load_segmenter

ENCODINGS_KEPT = 8
"""Encodings kept, where several people have to share a lane."""
MAX_ELEMENTS_KEPT = 400_000
"""Elements (or nodes, where there are more) of all encodings kept; one takes 1 to 3 kB. The last
encoding is kept whatever its size."""


@dataclass(frozen=True)
class StoredRegion:
    """A :class:`Region` whose elements are stored in the workspace."""

    part: int
    elements: str
    positive: bool = True


@dataclass(frozen=True, eq=False)
class SegmentationAnswer:
    """Labels as the server needs them: the reference of the stored array, and those displayed."""

    prompts_key: str
    labels: str
    display_labels: npt.NDArray[np.int16]
    counts: dict[int, int]
    segmenter: str
    seconds: float


_encodings: LruCache[tuple[Path, str], Any] = LruCache(ENCODINGS_KEPT, MAX_ELEMENTS_KEPT)
_regions: LruCache[tuple[Path, str], npt.NDArray[np.int64]] = LruCache(100)


def encode(folder: Path, segmenter: str, progress: Progress = no_progress) -> None:
    """Encode an asset and index it for rays, before the first click needs either."""
    session_of(folder, segmenter, progress)
    picker_of(folder)


def session_of(folder: Path, segmenter: str, progress: Progress = no_progress) -> Any:
    """Return the encoded asset, from this process's cache where it is there."""
    asset = asset_of(folder)
    return _encodings.get(
        (folder, segmenter),
        lambda: load_segmenter(segmenter).encode(asset, progress),
        _weight(asset),
        lambda session: max(_weight(asset), _nodes(session)),
    )


def _weight(asset: Asset) -> int:
    """Elements, and the textures that the encoding refers to: 1,000 pixels take 3 kB, too."""
    return asset.element_count + pixels_of(asset) // 1000


def _nodes(session: Any) -> int:
    """Return the number of an encoding's nodes; a mesh of few faces has many."""
    encoding = getattr(session, "encoding", None)
    return 0 if encoding is None else len(encoding.nodes)


def segment(
    folder: Path,
    workspace: Path,
    segmenter: str,
    items: tuple[Click | StoredRegion, ...],
    prompts_key: str,
    element: npt.NDArray[np.int32] | None,
    progress: Progress = no_progress,
    *,
    keep: bool = True,
) -> SegmentationAnswer:
    """Segment by prompts; stores the labels of all elements and returns those displayed.

    Args:
        keep: whether to keep the encoding for more clicks.
    """
    if keep:
        session = session_of(folder, segmenter, progress)
    else:
        session = load_segmenter(segmenter).encode(asset_of(folder), progress)
    answer = session.segment(prompts_of(workspace, items))
    return _answer(workspace, answer, prompts_key, element)


@dataclass(frozen=True)
class Hidden:
    """Parts that a person has hidden: picking goes through them.

    Attributes:
        workspace: folder of the stored labels.
        labels: reference of the stored (E,) labels.
        parts: ids of the hidden parts.
    """

    workspace: Path
    labels: str
    parts: tuple[int, ...]


Point = tuple[float, float, float]
Aim = tuple[Point, Point, Hidden | None]
"""Origin and direction of a ray, and what it passes through."""
Shape = Stroke | tuple[tuple[float, float], tuple[float, float]]
"""A stroke on the screen, or two corners of a box."""
_pickers: LruCache[Path, Picker] = LruCache(8)
_hidden: LruCache[Hidden, npt.NDArray[np.bool_]] = LruCache(4)


def picker_of(folder: Path) -> Picker:
    """Return the picker of an asset, cached in this process."""
    return _pickers.get(folder, lambda: Picker(asset_of(folder, textures=False)))


def prepare_picking(folder: Path) -> None:
    """Build the ray structure before the first click needs it."""
    picker_of(folder)


def _elements_of(hidden: Hidden | None) -> npt.NDArray[np.bool_] | None:
    """Return the (E,) mask of hidden elements."""
    if hidden is None:
        return None
    return _hidden.get(
        hidden, lambda: np.isin(arrays_of(hidden.workspace).get(hidden.labels), hidden.parts)
    )


def pick(
    folder: Path, origin: Point, direction: Point, hidden: Hidden | None = None
) -> Pick | None:
    """Return what a ray hits, or None for the background."""
    return picker_of(folder).pick(
        np.asarray(origin), np.asarray(direction), hidden=_elements_of(hidden)
    )


def select(
    folder: Path,
    workspace: Path,
    camera: Camera,
    shape: Shape,
    hidden: Hidden | None,
    *,
    one_piece: bool = False,
) -> tuple[str, int]:
    """Store the visible elements in a box or under a stroke; returns reference and number.

    Args:
        one_piece: of a scan only the largest connected component.
    """
    picker, ignored = picker_of(folder), _elements_of(hidden)
    if isinstance(shape, Stroke):
        chosen = picker.select_stroke(camera, shape, hidden=ignored)
    else:
        chosen = picker.select_box(camera, *shape, visible_only=True, hidden=ignored)
    cloud = asset_of(folder, textures=False).cloud
    if one_piece and cloud is not None and len(chosen):
        chosen = chosen[largest_component(cloud.points[chosen])]
    return arrays_of(workspace).put(np.asarray(chosen, np.int64)), len(chosen)


def click(
    folder: Path,
    workspace: Path,
    segmenter: str,
    items: tuple[Click | StoredRegion, ...] | None,
    aim: Aim,
    part: int,
    positive: bool,
    element: npt.NDArray[np.int32] | None,
    found: Callable[[Click | None], None],
    progress: Progress = no_progress,
) -> SegmentationAnswer | None:
    """Answer a click in one job: ``found`` gets its prompt, then the labels are computed.

    Args:
        items: the prompts before it; None: only its place is asked for.
        found: gets the prompt, or None where the ray hits nothing.

    Returns:
        The labels, for no key of prompts; None where there is no prompt, or no ``items``.
    """
    hit = pick(folder, *aim)
    if hit is None:
        found(None)
        return None
    x, y, z = (float(v) for v in hit.position)
    prompt = Click((x, y, z), part, positive, int(hit.element))
    found(prompt)
    if items is None:
        return None
    return segment(folder, workspace, segmenter, (*items, prompt), "", element, progress)


def source_regions(asset: Asset, workspace: Path) -> dict[int, tuple[str, int]]:
    """Return the parts of the source file: part → stored elements and their number."""
    part = asset.element_part
    if part is None:
        return {}
    arrays = arrays_of(workspace)
    out = {}
    for i in np.unique(part[part >= 0]):
        elements = np.flatnonzero(part == i).astype(np.int64)
        out[int(i)] = (arrays.put(elements), len(elements))
    return out


def prompts_of(workspace: Path, items: tuple[Click | StoredRegion, ...]) -> Prompts:
    """Return prompts with the elements of their regions."""
    return Prompts(
        tuple(
            p
            if isinstance(p, Click)
            else Region(p.part, _elements(workspace, p.elements), p.positive)
            for p in items
        )
    )


def _elements(workspace: Path, ref: str) -> npt.NDArray[np.int64]:
    return _regions.get((workspace, ref), lambda: arrays_of(workspace).get(ref))


def _answer(
    workspace: Path, answer: Any, prompts_key: str, element: npt.NDArray[np.int32] | None
) -> SegmentationAnswer:
    labels = np.where(answer.labels < 0, 0, answer.labels).astype(np.int16)
    ids, counts = np.unique(labels, return_counts=True)
    return SegmentationAnswer(
        prompts_key=prompts_key,
        labels=arrays_of(workspace).put(labels),
        display_labels=labels if element is None else labels[element],
        counts={int(i): int(n) for i, n in zip(ids, counts, strict=True)},
        segmenter=answer.segmenter,
        seconds=answer.seconds,
    )


def display_labels(
    workspace: Path, labels: str, element: npt.NDArray[np.int32]
) -> npt.NDArray[np.int16]:
    """Return the stored labels of the displayed elements."""
    return arrays_of(workspace).get(labels)[element].astype(np.int16)
