"""Scanned rooms: leaving out floor and walls, cutting out objects."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from app.server import tasks
from model.core.asset import Asset
from model.core.errors import CommandError
from model.core.files import draft_of
from model.core.progress import Progress, no_progress
from model.geometry.crop import crop, outliers
from model.geometry.crop import floor_and_walls as room_surfaces
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
    """An object cut out of a scan; see :class:`sessions.tool_commands.CropOut`."""

    name: str
    path: Path
    elements: str
    count: int
    position: tuple[float, float, float]


@dataclass(frozen=True)
class Picked:
    """A part as an object of its own, and the file of the rest, in its former frame."""

    crop: Crop
    rest: Path


def floor_and_walls(
    folder: Path, workspace: Path, left_out: str | None, progress: Progress = no_progress
) -> Removal:
    """Find floor, ceiling, walls and outliers, and add what was left out before.

    Raises:
        CommandError: where there are none, or nothing would be left.
    """
    asset = tasks.asset_of(folder)
    progress(0.05, "Finding outliers")
    gone = outliers(asset)
    progress(0.4, "Finding floor and walls")
    inside = np.flatnonzero(~gone)
    border = room_surfaces(crop(asset, ~gone))
    if not border.any():
        raise CommandError("no floor, ceiling or wall was found: this looks like a single object")
    gone[inside[border]] = True
    return removal(workspace, asset, np.flatnonzero(gone), left_out)


def leave_out_part(
    folder: Path, workspace: Path, labels: str, part: int, left_out: str | None
) -> Removal:
    """Return the elements of one part, and what was left out before."""
    mine = np.flatnonzero(tasks.arrays_of(workspace).get(labels) == part)
    return removal(workspace, tasks.asset_of(folder), mine, left_out)


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
        whole = np.union1d(whole, tasks.arrays_of(workspace).get(left_out))
    return Removal(tasks.arrays_of(workspace).put(whole), len(whole))


def in_source(workspace: Path, elements: Elements, left_out: str | None) -> Elements:
    """Return the (K,) elements as elements of the whole source, some of which is left out."""
    if left_out is None:
        return elements
    out = tasks.arrays_of(workspace).get(left_out)
    # The k-th remaining element is k plus the number of those left out before it.
    before = out - np.arange(len(out))
    return elements + np.searchsorted(before, elements, side="right")


def cut_out(
    folder: Path,
    workspace: Path,
    labels: str,
    part: int,
    left_out: str | None,
    name: str,
    progress: Progress = no_progress,
) -> Crop:
    """Write one part as an object of its own, on its own origin.

    Raises:
        CommandError: where the part is empty, or the whole scan.
    """
    asset = tasks.asset_of(folder)
    mine = tasks.arrays_of(workspace).get(labels) == part
    if not mine.any():
        raise CommandError("this part is empty: click on the object, or draw a box around it")
    if mine.all():
        raise CommandError("this part is the whole scan")
    progress(0.1, "Cutting it out")
    cut = crop(asset, mine)
    low, high = cut.bounds
    origin = np.array([*np.rint((low + high)[:2] / 2 * GRID) / GRID, low[2]])
    elements = in_source(workspace, np.flatnonzero(mine), left_out)
    ref = tasks.arrays_of(workspace).put(elements)
    plain = re.sub(r"[^A-Za-z0-9._-]+", "_", name).strip("._")[:60] or "object"
    progress(0.6, "Writing it")
    path = _write(cut, workspace / "crops" / ref[:16] / plain, origin)
    x, y, z = (float(v) for v in origin)
    return Crop(plain, path, ref, int(mine.sum()), (x, y, z))


def pick_out(
    copy: Path,
    folder: Path,
    workspace: Path,
    labels: str,
    part: int,
    left_out: str | None,
    name: str,
    progress: Progress = no_progress,
) -> Picked:
    """Like :func:`cut_out`, and write the rest of the working copy, too.

    Raises:
        CommandError: where the part is empty, or the whole scan.
    """
    cut = cut_out(folder, workspace, labels, part, left_out, name, progress)
    progress(0.7, "Writing the rest")
    whole, _ = tasks.working_copy(copy, workspace, tasks.ReadOptions())
    kept = np.ones(whole.element_count, bool)
    kept[tasks.arrays_of(workspace).get(cut.elements)] = False
    rest = _write(crop(whole, kept), cut.path.with_name(f"without_{cut.name}"), np.zeros(3))
    return Picked(cut, rest)


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
