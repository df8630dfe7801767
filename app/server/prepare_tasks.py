"""Jobs that prepare a scan: what to level and remove, leaving it out and bringing it back; in rooms
floor and walls, and cutting out objects.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.server.tasks import ReadOptions, arrays_of, asset_of, working_copy
from model.core.asset import Asset
from model.core.errors import CommandError
from model.core.files import draft_of
from model.core.memory import LruCache
from model.core.progress import Progress, no_progress, scaled_progress
from model.geometry import prepare
from model.geometry.cleaning import OBJECT, OUTLIER, SUPPORT, Kinds
from model.geometry.crop import ROOM_METRES, crop, outliers
from model.geometry.crop import floor_and_walls as room_surfaces
from model.geometry.levelling import Levelling
from model.geometry.picking import Camera, Picker, Stroke
from model.geometry.prepare import PrepareProposal, PrepareSettings
from model.io.write import write_cloud, write_mesh

GRID = 128.0
"""Origins lie on multiples of 1/128 m: subtracting one from a float32 is almost exact."""
Elements = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Removal:
    """Elements of the whole source to leave out."""

    elements: str
    count: int


@dataclass(frozen=True)
class Crop:
    """An object cut out of a scan; see :class:`sessions.tool_commands.CropOut`.

    Attributes:
        rest: file of the rest of a working copy, in its frame; None where that isn't written.
    """

    name: str
    path: Path
    elements: str
    count: int
    position: tuple[float, float, float]
    rest: Path | None = None


def floor_and_walls(
    workspace: Path, left_out: str | None, folder: Path, progress: Progress = no_progress
) -> Removal:
    """Find floor, ceiling, walls and outliers, and add what was left out before.

    Raises:
        CommandError: where there are none, or nothing would be left.
    """
    asset = asset_of(folder)
    kinds = _room_kinds(asset, None, progress)
    if not (kinds == SUPPORT).any():
        raise CommandError("no floor, ceiling or wall was found: this looks like a single object")
    return removal(workspace, asset, np.flatnonzero(kinds != OBJECT), left_out)


def leave_out_part(
    workspace: Path, left_out: str | None, folder: Path, labels: str, part: int
) -> Removal:
    """Return the elements of one part, and what was left out before."""
    mine = np.flatnonzero(arrays_of(workspace).get(labels) == part)
    return removal(workspace, asset_of(folder), mine, left_out)


def removal(workspace: Path, asset: Asset, gone: Elements, left_out: str | None) -> Removal:
    """Elements of an open scan and what is left out already, as elements of the whole source.

    Raises:
        CommandError: where these are none, or all.
    """
    if len(gone) >= asset.element_count:
        raise CommandError("nothing would be left of the scan")
    if not len(gone):
        raise CommandError("there is nothing to leave out")
    whole = in_source(workspace, gone, left_out)
    if left_out is not None:
        whole = np.union1d(whole, arrays_of(workspace).get(left_out))
    return Removal(arrays_of(workspace).put(whole), len(whole))


def in_source(workspace: Path, elements: Elements, left_out: str | None) -> Elements:
    """Return the (K,) elements as elements of the whole source, some of which is left out."""
    if left_out is None:
        return elements
    out = arrays_of(workspace).get(left_out)
    # The k-th remaining element is k plus the number of those left out before it.
    before = out - np.arange(len(out))
    return elements + np.searchsorted(before, elements, side="right")


def cut_out(
    workspace: Path,
    left_out: str | None,
    folder: Path,
    labels: str,
    part: int,
    name: str,
    copy: Path | None = None,
    progress: Progress = no_progress,
) -> Crop:
    """Write one part as an object of its own, on its own origin.

    Args:
        copy: the working copy whose rest is written, too.

    Raises:
        CommandError: where the part is empty, or the whole scan.
    """
    asset, arrays = asset_of(folder), arrays_of(workspace)
    mine = arrays.get(labels) == part
    if not mine.any():
        raise CommandError("this part is empty: click on the object, or draw a box around it")
    if mine.all():
        raise CommandError("this part is the whole scan")
    progress(0.1, "Cutting it out")
    cut = crop(asset, mine)
    low, high = cut.bounds
    origin = np.array([*np.rint((low + high)[:2] / 2 * GRID) / GRID, low[2]])
    elements = in_source(workspace, np.flatnonzero(mine), left_out)
    ref = arrays.put(elements)
    plain = re.sub(r"[^A-Za-z0-9._-]+", "_", name).strip("._")[:60] or "object"
    progress(0.6, "Writing it")
    path, rest = _write(cut, workspace / "crops" / ref[:16] / plain, origin), None
    if copy is not None:
        progress(0.7, "Writing the rest")
        whole, _ = working_copy(copy, workspace, ReadOptions())
        kept = np.ones(whole.element_count, bool)
        kept[elements] = False
        rest = _write(crop(whole, kept), path.with_name(f"without_{plain}"), np.zeros(3))
    x, y, z = (float(v) for v in origin)
    return Crop(plain, path, ref, int(mine.sum()), (x, y, z), rest)


def _write(asset: Asset, stem: Path, origin: npt.NDArray[np.float64]) -> Path:
    """Write the asset about ``origin``; at the origin a cloud keeps its exact coordinates."""
    if asset.mesh is not None:
        path = stem.with_name(f"{stem.name}.glb")
        with draft_of(path) as draft:
            write_mesh(replace(asset.mesh, vertices=asset.mesh.vertices - origin), draft)
        return path
    assert asset.cloud is not None
    path = stem.with_name(f"{stem.name}.ply")
    points = asset.cloud.points.astype(np.float64) - origin
    with draft_of(path) as draft:
        write_cloud(replace(asset.cloud, points=points.astype(np.float32)), draft)
    return path


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


def _room_kinds(
    asset: Asset, frame: Array | None = None, progress: Progress = no_progress
) -> Kinds:
    """Kinds in a room: floor, ceiling and walls support what stands there.

    Args:
        frame: (4, 4) in which it is upright; None is its own.
    """
    progress(0.05, "Finding outliers")
    kinds = np.zeros(asset.element_count, np.int8)
    alone = outliers(asset)
    kinds[alone] = OUTLIER
    inside = np.flatnonzero(~alone)
    progress(0.4, "Finding floor and walls")
    rest = crop(asset, ~alone)
    kinds[inside[room_surfaces(rest if frame is None else prepare.moved(rest, frame))]] = SUPPORT
    return kinds


def propose(
    folder: Path,
    element: npt.NDArray[np.int32],
    up: Vector | None,
    progress: Progress = no_progress,
) -> ScanProposal:
    """Find the up direction, unless ``up`` gives it, and what isn't the object."""
    found = _found(folder, up, progress)
    counts = np.bincount(found.kinds, minlength=OUTLIER + 1).tolist()
    return ScanProposal(
        up, found.object_from_source, found.levelling, found.kinds[element], tuple(counts)
    )


def marked_elements(
    workspace: Path,
    left_out: str | None,
    folder: Path,
    up: Vector | None,
    marks: Marks,
    progress: Progress = no_progress,
) -> Removal:
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
    workspace: Path,
    left_out: str,
    path: Path,
    options: ReadOptions,
    camera: Camera,
    stroke: Stroke | tuple[Any, Any],
) -> Removal | None:
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
