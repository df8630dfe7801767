"""The input of all jobs of the worker processes: an asset's working copy, and stored arrays.

Jobs are top-level functions of the modules ``*_tasks``, called by name in another process. Each
worker keeps results in small caches of its own; the server only holds what a browser shows.
Geometry passes between processes as a folder of memory-mapped arrays.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.asset import Asset, UpAxis
from model.core.errors import ArtiworldError, CommandError
from model.core.memory import LruCache
from model.core.progress import Progress, no_progress
from model.geometry.crop import crop
from model.geometry.prepare import moved
from model.geometry.splitting import split_faces
from model.io.asset_cache import load_asset, save_asset
from model.io.model_files import files_named_by, is_model
from model.io.open_asset import open_asset
from sessions.document import SOURCE_FRAME, FaceCut, ObjectFrame
from sessions.storage import ArrayFiles

Stamp = tuple[tuple[str, int, int], ...]
PIXELS_KEPT = 1 << 27
"""Texture pixels in a worker's memory, 3 or 4 bytes each; the last asset stays in any case."""


@dataclass(frozen=True)
class ReadOptions:
    """Options for reading a source.

    Attributes:
        up_axis: None is the format's default.
        unit_scale: metres per unit.
        frame: the object's frame in that of the source as it is read.
        left_out: reference of the stored elements to leave out, or None.
        face_cuts: cuts that split the remaining faces, in order.
    """

    up_axis: UpAxis | None = None
    unit_scale: float = 1.0
    left_out: str | None = None
    face_cuts: tuple[FaceCut, ...] = ()
    frame: ObjectFrame = SOURCE_FRAME

    @property
    def as_read(self) -> ReadOptions:
        """The options of the whole source in its own frame."""
        return ReadOptions(self.up_axis, self.unit_scale)


def working_copy(
    path: Path, workspace: Path, options: ReadOptions, progress: Progress = no_progress
) -> tuple[Asset, Path]:
    """Return the asset of ``path`` and the folder of its arrays, writing the folder if needed."""
    identity = (str(path.resolve()), stamp(path), options.up_axis, options.unit_scale)
    if options.left_out is not None:
        identity = (*identity, options.left_out)
    if options.frame != SOURCE_FRAME:
        identity = (*identity, options.frame)
    if options.face_cuts:
        identity = (*identity, options.face_cuts)
    key = hashlib.sha256(repr(identity).encode()).hexdigest()[:24]
    folder = workspace / "cache" / key
    asset = _saved(folder)
    if asset is None:
        if options.face_cuts:
            before = replace(options, face_cuts=options.face_cuts[:-1])
            asset, _ = working_copy(path, workspace, before, progress)
            asset = _split(asset, options.face_cuts[-1], workspace)
        elif options != options.as_read:
            asset, _ = working_copy(path, workspace, options.as_read, progress)
            if options.left_out is not None:
                asset = _without(asset, arrays_of(workspace).get(options.left_out))
            if options.frame != SOURCE_FRAME:
                asset = moved(asset, options.frame.object_from_read)
        else:
            asset = open_asset(
                path, up_axis=options.up_axis, unit_scale=options.unit_scale, progress=progress
            )
        progress(0.6, "Saving a working copy")
        save_asset(asset, folder, lambda there: _saved(there) is not None)
    return asset, folder


def _saved(folder: Path) -> Asset | None:
    try:
        return load_asset(folder)
    except ArtiworldError:
        return None


def _without(asset: Asset, elements: npt.NDArray[np.int64]) -> Asset:
    keep = np.ones(asset.element_count, bool)
    if len(elements) and elements[-1] >= len(keep):
        raise CommandError("the file has fewer elements than when some were left out: undo that")
    keep[elements] = False
    return crop(asset, keep)


def _split(asset: Asset, cut: FaceCut, workspace: Path) -> Asset:
    elements = arrays_of(workspace).get(cut.elements)
    if asset.mesh is None or (len(elements) and elements[-1] >= asset.element_count):
        raise CommandError("the file has fewer faces than when some were cut: undo that")
    chosen = np.zeros(asset.element_count, bool)
    chosen[elements] = True
    split = split_faces(asset.mesh, chosen, cut.planes)
    part = None if asset.element_part is None else asset.element_part[split.parent]
    return replace(asset, mesh=split.mesh, element_part=part)


def stamp(path: Path) -> Stamp:
    """Return names, sizes and times of a path's files: a working copy is valid while they stay."""
    if is_model(path):
        files = [path, *(m for m in files_named_by(path) if m.is_file())]
        return tuple((f.name, f.stat().st_size, f.stat().st_mtime_ns) for f in files)
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())[:5000]
    return tuple((f.name, f.stat().st_size, f.stat().st_mtime_ns) for f in files)


def stamp_if_there(path: Path) -> Stamp:
    """Like :func:`stamp`; () where there is no file."""
    try:
        return stamp(path)
    except OSError:
        return ()


_assets: LruCache[tuple[Path, bool], Asset] = LruCache(8, PIXELS_KEPT)


def asset_of(folder: Path, *, textures: bool = True) -> Asset:
    """Return the asset saved in a folder; without textures it is there at once."""
    load = partial(load_asset, folder, textures=textures)
    return _assets.get((folder, textures), load, weigh=pixels_of)


def pixels_of(asset: Asset) -> int:
    """Number of pixels of an asset's textures, which are in memory."""
    if asset.mesh is None:
        return 0
    images = {id(m.texture): m.texture for m in asset.mesh.materials if m.texture is not None}
    return sum(image.width * image.height for image in images.values())


def arrays_of(workspace: Path) -> Any:
    """Return the workspace's arrays."""
    return ArrayFiles(workspace / "arrays")
