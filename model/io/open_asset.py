"""Open a file or folder of any known format as an :class:`~model.core.asset.Asset`.

:mod:`model.io.geometry_files` tells the up axis that a mesh or cloud file is taken to have. A URDF,
by itself or as a folder with its meshes, is in its root link's frame, +z up; an MJCF in its
world's, +z up.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from model.core.articulated_object import Part, SegmentedObject
from model.core.asset import Asset, Source, UpAxis
from model.core.errors import ConfigurationError, GeometryError, InputFileError, KinematicsError
from model.core.progress import Progress, no_progress
from model.core.textures import one_reading
from model.geometry.splitting import split
from model.io.articulated_asset import open_model
from model.io.formats.loaded import DEFAULT_MAX_BYTES, Loaded, join
from model.io.formats.mtl import MaterialFiles
from model.io.geometry_files import (
    FOLDER_SUFFIXES,
    cleaned,
    default_up_axis,
    far_shift,
    file_digest,
    is_solid,
    load_geometry,
    read_geometry_file,
    shifted,
    to_cloud,
    to_mesh,
    turned_up,
)
from model.io.model_files import (
    MODEL_SUFFIXES,
    Manifest,
    articulated_stage,
    asset_name,
    find_manifest,
    model_of,
)
from model.io.urdf.model import UrdfModel, load_declared
from model.io.zips import unzipped

MOST_REMARKS = 50
"""A person reads no more, and a browser shows each."""


@one_reading()
def open_asset(
    path: str | Path,
    *,
    up_axis: UpAxis | None = None,
    unit_scale: float = 1.0,
    max_bytes: int = DEFAULT_MAX_BYTES,
    files: MaterialFiles | None = None,
    progress: Progress = no_progress,
) -> Asset:
    """Open a file, a URDF or MJCF with its meshes, a folder of part meshes, or a zip of one object.

    Args:
        path: what to open.
        up_axis: the source's up axis; by default declared by the format, see the module's text.
        unit_scale: metres per source unit.
        max_bytes: refuse larger files.
        files: of a single OBJ file: where its materials and textures may lie, read once for
            several such files; by default its own folder.
        progress: called between the steps.

    Returns:
        The asset in metres, +z up. ``asset.warnings`` says what was passed over.

    Raises:
        InputFileError: where it can't be used; the message names the file and a remedy.
        ConfigurationError: on an impossible up axis or unit.
    """
    path = Path(path)
    if up_axis is not None:
        turned_up(up_axis)
    if not (np.isfinite(unit_scale) and unit_scale > 0):
        raise ConfigurationError(f"unit scale {unit_scale} must be a positive number of metres")
    with unzipped(path) as place:
        asset = _opened(place, up_axis, unit_scale, max_bytes, files, progress)
    if place != path and asset.source is not None:
        asset = replace(asset, source=replace(asset.source, path=path))
    if len(asset.warnings) <= MOST_REMARKS:
        return asset
    more = f"{len(asset.warnings) - MOST_REMARKS:,} more remarks of this kind"
    return replace(asset, warnings=(*asset.warnings[:MOST_REMARKS], more))


def _opened(
    path: Path,
    up_axis: UpAxis | None,
    unit_scale: float,
    max_bytes: int,
    files: MaterialFiles | None,
    progress: Progress,
) -> Asset:
    try:
        if path.is_dir():
            model = model_of(path)
            if model is not None:
                return _read_model(path, model, up_axis, unit_scale, max_bytes, progress)
            return _read_folder(path, up_axis, unit_scale, max_bytes, progress)
        if path.suffix.lower() in MODEL_SUFFIXES:
            return _read_model(path, path, up_axis, unit_scale, max_bytes, progress)
        stage = articulated_stage(path, max_bytes)
        if stage is not None:
            return _read_model(path, path, up_axis, unit_scale, max_bytes, progress, stage)
        return read_geometry_file(
            path,
            up_axis=up_axis,
            unit_scale=unit_scale,
            max_bytes=max_bytes,
            files=files,
            progress=progress,
        )
    except (GeometryError, KinematicsError) as error:
        raise InputFileError(path, str(error), "the file is damaged or holds no object") from None
    except MemoryError:
        raise InputFileError(path, "doesn't fit into memory", "thin the scan first") from None


def _read_model(
    path: Path,
    model: Path,
    up_axis: UpAxis | None,
    scale: float,
    max_bytes: int,
    progress: Progress,
    read: UrdfModel | None = None,
) -> Asset:
    progress(0.0, f"reading {model.name}")
    matrix = turned_up(up_axis or "z")
    matrix[:3, :3] *= scale
    given = path if path.is_dir() else None
    found = open_model(model, matrix, max_bytes, progress, read, given)
    return Asset(
        asset_name(path),
        mesh=found.mesh,
        cloud=found.cloud,
        source=Source(path, file_digest(found.files), up_axis or "z", scale),
        element_part=found.element_part,
        part_names=found.part_names,
        category=found.category,
        warnings=found.notes,
        tree=found.tree,
        inertials=found.inertials,
        shapes=found.shapes,
    )


def _read_parts(
    folder: Path,
    manifest: Manifest,
    up_axis: UpAxis | None,
    scale: float,
    max_bytes: int,
    progress: Progress,
) -> tuple[list[Loaded], Source]:
    """Every part in the object's frame, and where they came from."""
    files = MaterialFiles(folder)
    out = []
    for i, entry in enumerate(manifest.entries):
        progress(i / len(manifest.entries), f"reading {entry.path.name}")
        up = up_axis or default_up_axis(entry.path, part_of_folder=True)
        loaded = cleaned(
            entry.path, load_geometry(entry.path, max_bytes, files), turned_up(up), scale
        )
        named = tuple(f"{entry.path.name}: {w}" for w in loaded.warnings)
        out.append(replace(loaded, warnings=named))
    extra = [manifest.path] if manifest.path is not None else []
    digest = file_digest([*(e.path for e in manifest.entries), *extra, *files.paths])
    first = up_axis or default_up_axis(manifest.entries[0].path, part_of_folder=True)
    shift = far_shift(out[0])  # the same for all: they share a frame
    return [shifted(p, shift) for p in out], Source(folder, digest, first, scale, shift)


def _read_folder(
    folder: Path, up_axis: UpAxis | None, unit_scale: float, max_bytes: int, progress: Progress
) -> Asset:
    manifest = find_manifest(folder, FOLDER_SUFFIXES)
    parts, source = _read_parts(folder, manifest, up_axis, unit_scale, max_bytes, progress)
    solid = [is_solid(p) for p in parts]
    if any(solid) and not all(solid):
        cloud = manifest.entries[solid.index(False)].path
        why = "is a cloud among meshes"
        raise InputFileError(cloud, why, "give all parts as meshes or all as clouds")
    whole = join(parts)
    warnings = dict.fromkeys([*manifest.remarks, *(w for p in parts for w in p.warnings)])
    sizes = [len(p.faces) if solid[0] else len(p.vertices) for p in parts]
    inertials, shapes = {}, {}
    if not any(source.shift):
        turned = turned_up(source.up_axis)
        turned[:3, :3] *= unit_scale
        inertials, shapes = load_declared(folder, turned)
    return Asset(
        folder.name,
        mesh=to_mesh(whole) if solid[0] else None,
        cloud=None if solid[0] else to_cloud(whole),
        source=source,
        element_part=np.repeat(np.arange(len(parts), dtype=np.int32), sizes),
        part_names=tuple(e.name or e.link for e in manifest.entries),
        category=manifest.category,
        warnings=tuple(warnings),
        inertials=inertials,
        shapes=shapes,
    )


@one_reading()
def read_part_files(
    path: str | Path, *, up_axis: UpAxis | None = None, unit_scale: float = 1.0
) -> SegmentedObject:
    """Read a folder of part meshes or part clouds, all in one object frame, or any other source
    that tells its parts: a URDF, an MJCF, a glTF or OBJ file whose meshes are called after parts,
    or a zip of one of these.

    The files of a folder are those of ``object.json`` where there is one, else ``link_*`` in
    natural order, else all mesh and cloud files. Each link is called after its file's stem.

    Raises:
        InputFileError: where a part can't be used, or a file tells no parts.
    """
    with unzipped(Path(path)) as place:
        return _part_files(place, up_axis, unit_scale)


def _part_files(path: Path, up_axis: UpAxis | None, unit_scale: float) -> SegmentedObject:
    max_bytes, progress = DEFAULT_MAX_BYTES, no_progress
    if path.is_file() or (path.is_dir() and model_of(path) is not None):
        return _read_declared_parts(path, up_axis, unit_scale, max_bytes, progress)
    manifest = find_manifest(path, FOLDER_SUFFIXES)
    parts, _ = _read_parts(path, manifest, up_axis, unit_scale, max_bytes, progress)
    made = [
        Part(
            e.link,
            mesh=to_mesh(p) if is_solid(p) else None,
            cloud=None if is_solid(p) else to_cloud(p),
            name=e.name,
            remarks=(*manifest.remarks, *p.warnings),
        )
        for e, p in zip(manifest.entries, parts, strict=True)
    ]
    return SegmentedObject(path.name, tuple(made), manifest.category)


def _read_declared_parts(
    path: Path, up_axis: UpAxis | None, scale: float, max_bytes: int, progress: Progress
) -> SegmentedObject:
    asset = open_asset(
        path, up_axis=up_axis, unit_scale=scale, max_bytes=max_bytes, progress=progress
    )
    if asset.element_part is None:
        why = "doesn't tell its parts"
        raise InputFileError(path, why, "cut it with artiworld segment, or serve it")
    parts = split(asset, asset.element_part, dict(enumerate(asset.part_names)))
    return SegmentedObject(asset.name, parts, asset.category, asset.inertials, asset.shapes)
