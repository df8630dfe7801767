"""Jobs that prepare a scan: find what to level and remove, leave it out, bring it back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.server.room_tasks import Removal, removal
from app.server.tasks import ReadOptions, arrays_of, asset_of, working_copy
from model.core.asset import Asset
from model.core.memory import LruCache
from model.core.progress import Progress, no_progress, scaled_progress
from model.geometry import prepare
from model.geometry.cleaning import OBJECT, OUTLIER, SUPPORT, Kinds
from model.geometry.crop import ROOM_METRES, crop, outliers
from model.geometry.crop import floor_and_walls as room_surfaces
from model.geometry.levelling import Levelling
from model.geometry.picking import Camera, Picker, Stroke
from model.geometry.prepare import PrepareProposal, PrepareSettings

Array = npt.NDArray[np.float64]
Vector = tuple[float, float, float]

_SAMPLE = 100_000
"""Points that outlines are measured on."""
_ROOM_SHARE = 0.5
"""Least share of the floor that the walls' outline covers."""
_proposals: LruCache[tuple[Path, Vector | None], PrepareProposal] = LruCache(4)


@dataclass(frozen=True, eq=False)
class ScanProposal:
    """Proposed preparation of an open scan, as the server keeps it.

    Attributes:
        up: the given up direction, or None where it was found.
        object_from_asset: (4, 4) rotation and shift.
        levelling: the up direction in the asset's frame.
        kinds: (D,) int8 kind of each displayed element.
        counts: elements of each kind.
    """

    up: Vector | None
    object_from_asset: Array
    levelling: Levelling
    kinds: Kinds
    counts: tuple[int, ...]


@dataclass(frozen=True)
class Marks:
    """Elements marked for removal.

    Attributes:
        kinds: of elements.
        box: lowest and highest corner in the proposed frame; what lies outside is marked.
        confidence: points with less are marked.
    """

    kinds: tuple[int, ...] = ()
    box: tuple[Vector, Vector] | None = None
    confidence: float = 0.0

    def of(
        self, points: Array, kinds: Kinds, confidence: npt.NDArray[np.float32] | None
    ) -> npt.NDArray[np.bool_]:
        """(N,) whether each element is marked; (N, 3) points are in the proposed frame."""
        out = np.isin(kinds, self.kinds)
        if self.box is not None:
            low, high = self.box
            out |= ((points < low) | (points > high)).any(1)
        if confidence is not None and self.confidence > 0:
            out |= confidence < self.confidence
        return out


def _found(folder: Path, up: Vector | None, progress: Progress) -> PrepareProposal:
    def find() -> PrepareProposal:
        asset = asset_of(folder)
        found = prepare.propose(asset, PrepareSettings(up=up), progress)
        progress(0.9, "looking for walls")
        if not _is_room(asset.element_centers, found):
            return found
        return replace(found, kinds=_room_kinds(asset, found.object_from_source))

    return _proposals.get((folder, up), find)


def _is_room(points: Array, found: PrepareProposal) -> bool:
    """True if the objects on the floor are as wide as a room, and as the floor."""
    every = max(len(points) // _SAMPLE, 1)
    flat = (points[::every] @ found.object_from_source[:3, :3].T)[:, :2]
    stands = found.kinds[::every] == OBJECT
    if not stands.any():
        return False
    whole, object_ = (
        np.ptp(np.percentile(p, [1, 99], axis=0), axis=0) for p in (flat, flat[stands])
    )
    return bool(object_.min() > ROOM_METRES and object_.prod() > _ROOM_SHARE * whole.prod())


def _room_kinds(asset: Asset, frame: Array) -> Kinds:
    """Kinds in a room: floor, ceiling and walls support what stands there."""
    kinds = np.zeros(asset.element_count, np.int8)
    alone = outliers(asset)
    kinds[alone] = OUTLIER
    inside = np.flatnonzero(~alone)
    kinds[inside[room_surfaces(prepare.moved(crop(asset, ~alone), frame))]] = SUPPORT
    return kinds


def propose(
    folder: Path, element: npt.NDArray[np.int32], up: Vector | None,
    progress: Progress = no_progress,
) -> ScanProposal:  # fmt: skip
    """Find the up direction, unless ``up`` gives it, and what isn't the object."""
    found = _found(folder, up, progress)
    counts = np.bincount(found.kinds, minlength=OUTLIER + 1).tolist()
    return ScanProposal(
        up, found.object_from_source, found.levelling, found.kinds[element], tuple(counts)
    )


def marked_elements(
    workspace: Path, left_out: str | None, folder: Path, up: Vector | None, marks: Marks,
    progress: Progress = no_progress,
) -> Removal:  # fmt: skip
    """Elements of an open scan to leave out: the marked ones, and those left out already.

    Raises:
        CommandError: where nothing is marked, or everything.
    """
    found = _found(folder, up, scaled_progress(progress, 0.0, 0.7))
    asset = asset_of(folder)
    progress(0.7, "finding what is marked")
    frame = found.object_from_source
    points = asset.element_centers @ frame[:3, :3].T + frame[:3, 3]
    confidence = None if asset.cloud is None else asset.cloud.confidence
    gone = np.flatnonzero(marks.of(points, found.kinds, confidence))
    return removal(workspace, asset, gone, left_out)


def chosen_elements(workspace: Path, left_out: str | None, folder: Path, chosen: str) -> Removal:
    """Stored elements of an open scan, with what is left out already, to be left out."""
    gone = arrays_of(workspace).get(chosen)
    return removal(workspace, asset_of(folder), gone, left_out)


def restored_elements(
    workspace: Path, left_out: str, path: Path, options: ReadOptions, camera: Camera,
    stroke: Stroke | tuple[Any, Any],
) -> Removal | None:  # fmt: skip
    """Elements that stay left out after those under a stroke or box are restored, or None."""
    gone = arrays_of(workspace).get(left_out)
    picker = Picker(removed_of(path, workspace, options))
    if isinstance(stroke, Stroke):
        back = picker.select_stroke(camera, stroke)
    else:
        back = picker.select_box(camera, *stroke, visible_only=True)
    kept = np.delete(gone, back)
    if not len(kept):
        return None
    return Removal(arrays_of(workspace).put(kept), len(kept))


def removed_of(path: Path, workspace: Path, options: ReadOptions) -> Asset:
    """The elements of a source that are left out, in the object's frame."""
    assert options.left_out is not None
    whole, _ = working_copy(path, workspace, options.as_read)
    gone = np.zeros(whole.element_count, bool)
    gone[arrays_of(workspace).get(options.left_out)] = True
    return prepare.moved(crop(whole, gone), options.frame.object_from_read)
