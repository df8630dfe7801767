"""Files and folders to :class:`~model.core.asset.Asset` values.

Up axis by default: glTF and GLB are +y up by their standard; a single OBJ file is taken as +y up,
as modelling tools write it; PLY, STL, PCD, NPZ and text are +z up. Folders of part meshes lie in
one object frame that is +z up already, whatever their format, except for glTF. A URDF, by itself
or as a folder with its meshes, is in its root link's frame, +z up; an MJCF in its world's, +z up.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Part, SegmentedObject
from model.core.asset import Asset, Source, UpAxis
from model.core.errors import ConfigurationError, GeometryError, InputFileError, KinematicsError
from model.core.progress import Progress, no_progress
from model.geometry.parts import split
from model.io.declared_physics_file import load_told
from model.io.formats.gltf import read_gltf
from model.io.formats.loaded import DEFAULT_MAX_BYTES, Loaded, join, size_of
from model.io.formats.mtl import MaterialFiles
from model.io.formats.npz import read_npz
from model.io.formats.obj import read_obj
from model.io.formats.pcd import read_pcd
from model.io.formats.ply import read_ply
from model.io.formats.stl import read_stl
from model.io.formats.text import read_text
from model.io.mjcf.source import MJCF_SUFFIXES, is_mjcf
from model.io.model_files import MODEL_SUFFIXES, files_named_by, is_model
from model.io.part_folder import Manifest, find_manifest, is_part_folder, natural_key
from model.io.source_checks import cleaned, far_shift, is_solid, shifted, to_cloud, to_mesh
from model.io.urdf.model import MOBILITY, PACKAGE, is_urdf, package_root

_READERS: dict[str, Callable[[Path, int], Loaded]] = {
    ".ply": read_ply, ".obj": read_obj, ".glb": read_gltf, ".gltf": read_gltf, ".stl": read_stl,
    ".pcd": read_pcd, ".xyz": read_text, ".xyzrgb": read_text, ".xyzn": read_text,
    ".pts": read_text, ".asc": read_text, ".txt": read_text, ".csv": read_text, ".npz": read_npz,
}  # fmt: skip
SUFFIXES: tuple[str, ...] = tuple(_READERS)
"""Suffixes of the meshes and clouds that can be opened."""

_TOO_COMMON = (".txt", ".csv", ".npz")  # in a folder these are rarely clouds
FOLDER_SUFFIXES: tuple[str, ...] = tuple(s for s in SUFFIXES if s not in _TOO_COMMON)
"""Suffixes that are picked up when a folder is searched."""

_WHOLE_FOLDER = (MOBILITY, "object.urdf", "object.xml")
"""URDFs and MJCFs that stand for their folder, which is called after the object."""
_Y_UP = (".glb", ".gltf")

_WORLD_FROM_SOURCE: dict[str, list[list[int]]] = {
    "z": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "y": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    "x": [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
    "-z": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "-y": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "-x": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
}


def default_up_axis(path: Path, *, part_of_folder: bool = False) -> UpAxis:
    """The up axis that a file is taken to have where nobody says: see the module's text."""
    suffix = path.suffix.lower()
    if suffix in _Y_UP or (suffix == ".obj" and not part_of_folder):
        return "y"
    return "z"


def turned_up(up_axis: UpAxis) -> np.ndarray:
    """(4, 4) rotation that turns ``up_axis`` to +z. From y it is a quarter turn about x.

    Raises:
        ConfigurationError: for an axis that is none.
    """
    if up_axis not in _WORLD_FROM_SOURCE:
        raise ConfigurationError(f"up axis {up_axis!r} is none of {', '.join(_WORLD_FROM_SOURCE)}")
    out = np.eye(4)
    out[:3, :3] = _WORLD_FROM_SOURCE[up_axis]
    return out


def read_asset(
    path: str | Path,
    *,
    up_axis: UpAxis | None = None,
    unit_scale: float = 1.0,
    max_bytes: int = DEFAULT_MAX_BYTES,
    files: MaterialFiles | None = None,
    progress: Progress = no_progress,
) -> Asset:
    """Open a file, a URDF or MJCF with its meshes, or a folder of part meshes.

    Args:
        path: what to open.
        up_axis: the source's up axis; by default told by the format, see the module's text.
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
    try:
        if path.is_dir():
            model = model_of(path)
            if model is not None:
                return _read_model(path, model, up_axis, unit_scale, max_bytes, progress)
            return _read_folder(path, up_axis, unit_scale, max_bytes, progress)
        if path.suffix.lower() in MODEL_SUFFIXES:
            return _read_model(path, path, up_axis, unit_scale, max_bytes, progress)
        return _read_file(path, up_axis, unit_scale, max_bytes, files, progress)
    except (GeometryError, KinematicsError) as error:
        raise InputFileError(path, str(error), "the file is damaged or holds no object") from None
    except MemoryError:
        raise InputFileError(path, "doesn't fit into memory", "thin the scan first") from None


def refusal(path: Path) -> InputFileError | None:
    """Why a file can't be opened whatever is in it: a pipe, a device, empty, or of no known type.

    None for folders, and where only reading it can tell.
    """
    if path.is_dir():
        return None
    try:
        size_of(path)
    except InputFileError as error:
        return error
    if path.suffix.lower() in MJCF_SUFFIXES and not is_mjcf(path):
        return InputFileError(
            path, "doesn't begin with <mujoco>", "of XML files URDF and MJCF can be opened"
        )
    if path.suffix.lower() in (*_READERS, *MODEL_SUFFIXES):
        return None
    what = f"files of type {path.suffix!r}" if path.suffix else "files without a suffix"
    return InputFileError(
        path, f"{what} can't be opened", f"use one of {', '.join((*SUFFIXES, *MODEL_SUFFIXES))}"
    )


def asset_name(path: Path) -> str:
    """What people call a file or folder: ``object.urdf``, ``object.xml`` and ``mobility.urdf``,
    as all are called so, have their folder's name."""
    if path.name in _WHOLE_FOLDER:
        path = path.absolute().parent
    return path.name if path.is_dir() else path.stem


def model_of(folder: Path) -> Path | None:
    """The URDF or MJCF that tells what is in a folder; None where its part meshes do, or nothing.

    It is one that stands for its folder (``mobility.urdf``, ``object.urdf``, ``object.xml``), else
    the only URDF there, or the only one in ``urdf/`` of a ROS package, else the only MJCF.
    """
    named = _whole(folder)
    if named is not None or is_part_folder(folder, FOLDER_SUFFIXES):
        return named
    return _only_urdf(folder) or _urdf_of_package(folder) or _only_mjcf(folder)


def _whole(folder: Path) -> Path | None:
    return next((p for n in _WHOLE_FOLDER if is_model(p := folder / n)), None)


def _urdf_of_package(folder: Path) -> Path | None:
    return _only_urdf(folder / "urdf") if (folder / PACKAGE).is_file() else None


def _only_urdf(folder: Path) -> Path | None:
    found = [p for p in folder.iterdir() if is_urdf(p)] if folder.is_dir() else []
    return found[0] if len(found) == 1 else None


def _only_mjcf(folder: Path) -> Path | None:
    """The one that no other includes; None where a URDF is there, too."""
    if not folder.is_dir() or any(map(is_urdf, folder.iterdir())):
        return None
    found = [p for p in folder.iterdir() if is_mjcf(p)]
    if len(found) > 1:
        included = {each for p in found for each in files_named_by(p)}
        found = [p for p in found if p.absolute() not in included]
    return found[0] if len(found) == 1 else None


def _load(path: Path, max_bytes: int, files: MaterialFiles | None = None) -> Loaded:
    problem = refusal(path)
    if problem is not None:
        raise problem
    reader = _READERS[path.suffix.lower()]
    if reader is read_obj and files is not None:
        return read_obj(path, max_bytes, files=files)
    return reader(path, max_bytes)


def _read_file(
    path: Path, up_axis: UpAxis | None, unit_scale: float, max_bytes: int,
    files: MaterialFiles | None, progress: Progress,
) -> Asset:  # fmt: skip
    progress(0.0, f"reading {path.name}")
    loaded = _load(path, max_bytes, files)
    up = up_axis or default_up_axis(path)
    progress(0.7, "checking")
    return _asset(path, path.stem, loaded, _digest([path]), up, unit_scale)


def _asset(path: Path, name: str, loaded: Loaded, sha256: str, up: UpAxis, scale: float) -> Asset:
    loaded = cleaned(path, loaded, turned_up(up), scale)
    shift = far_shift(loaded)
    loaded = shifted(loaded, shift)
    source = Source(path, sha256, up, scale, shift)
    if is_solid(loaded):
        parts, names = _named_parts(loaded)
        return Asset(
            name, mesh=to_mesh(loaded), source=source, element_part=parts, part_names=names,
            warnings=loaded.warnings,
        )  # fmt: skip
    cloud = to_cloud(loaded)
    return Asset(name, cloud=cloud, source=source, warnings=loaded.warnings)


def _named_parts(loaded: Loaded) -> tuple[npt.NDArray[np.int32] | None, tuple[str, ...]]:
    """Part of each face and names by part, where the file's meshes are called after parts."""
    from model.core.part_names import named_parts

    names, sizes = zip(*loaded.pieces, strict=True) if loaded.pieces else ((), ())
    numbers = named_parts(names)
    if numbers is None or sum(sizes) != len(loaded.faces):  # damaged faces were left out
        return None, ()
    plain = ("".join(c for c in name if c.isprintable()) for name in names)
    called = dict(zip(numbers, plain, strict=True))
    listed = tuple(called.get(i, "") for i in range(max(numbers) + 1))
    return np.repeat(np.asarray(numbers, np.int32), sizes), listed


def _read_model(
    path: Path, model: Path, up_axis: UpAxis | None, scale: float, max_bytes: int,
    progress: Progress,
) -> Asset:  # fmt: skip
    from model.io.open_asset import open_model

    progress(0.0, f"reading {model.name}")
    matrix = turned_up(up_axis or "z")
    matrix[:3, :3] *= scale
    found = open_model(model, matrix, max_bytes, progress)
    return Asset(
        asset_name(path),
        mesh=found.mesh,
        cloud=found.cloud,
        source=Source(path, _digest(found.files), up_axis or "z", scale),
        element_part=found.element_part,
        part_names=found.part_names,
        category=found.category,
        warnings=found.notes,
        tree=found.tree,
        inertials=found.inertials,
        shapes=found.shapes,
    )


def _read_parts(
    folder: Path, manifest: Manifest, up_axis: UpAxis | None, scale: float, max_bytes: int,
    progress: Progress,
) -> tuple[list[Loaded], Source]:  # fmt: skip
    """Every part in the object's frame, and where they came from."""
    files = MaterialFiles(folder)
    out = []
    for i, entry in enumerate(manifest.entries):
        progress(i / len(manifest.entries), f"reading {entry.path.name}")
        up = up_axis or default_up_axis(entry.path, part_of_folder=True)
        loaded = cleaned(entry.path, _load(entry.path, max_bytes, files), turned_up(up), scale)
        told = tuple(f"{entry.path.name}: {w}" for w in loaded.warnings)
        out.append(replace(loaded, warnings=told))
    extra = [manifest.path] if manifest.path is not None else []
    digest = _digest([*(e.path for e in manifest.entries), *extra, *files.paths])
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
        raise InputFileError(
            cloud, "is a cloud among meshes", "give all parts as meshes or all as clouds"
        )
    whole = join(parts)
    warnings = dict.fromkeys([*manifest.remarks, *(w for p in parts for w in p.warnings)])
    sizes = [len(p.faces) if solid[0] else len(p.vertices) for p in parts]
    inertials, shapes = {}, {}
    if not any(source.shift):
        turned = turned_up(source.up_axis)
        turned[:3, :3] *= unit_scale
        inertials, shapes = load_told(folder, turned)
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


def read_part_files(
    path: str | Path,
    *,
    up_axis: UpAxis | None = None,
    unit_scale: float = 1.0,
    max_bytes: int = DEFAULT_MAX_BYTES,
    progress: Progress = no_progress,
) -> SegmentedObject:
    """Read a folder of part meshes or part clouds, all in one object frame, or any other source
    that tells its parts: a URDF, an MJCF, a glTF file whose meshes are called after parts.

    The files of a folder are those of ``object.json`` where there is one, else ``link_*`` in
    natural order, else all mesh and cloud files. Each link is called after its file's stem.

    Raises:
        InputFileError: where a part can't be used, or a file tells no parts.
    """
    path = Path(path)
    if path.is_file() or (path.is_dir() and model_of(path) is not None):
        return _read_told_parts(path, up_axis, unit_scale, max_bytes, progress)
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


def _read_told_parts(
    path: Path, up_axis: UpAxis | None, scale: float, max_bytes: int, progress: Progress
) -> SegmentedObject:
    asset = read_asset(
        path, up_axis=up_axis, unit_scale=scale, max_bytes=max_bytes, progress=progress
    )
    if asset.element_part is None:
        raise InputFileError(
            path, "doesn't tell its parts", "cut it with artiworld segment, or serve it"
        )
    parts = split(asset, asset.element_part, dict(enumerate(asset.part_names)))
    return SegmentedObject(asset.name, parts, asset.category, asset.inertials, asset.shapes)


def find_assets(paths: Iterable[str | Path]) -> list[Path]:
    """What can be opened among ``paths``: files as they are, folders searched in depth.

    A folder with a ``mobility.urdf``, an ``object.urdf``, an ``object.xml``, an ``object.json`` or
    ``link_*`` meshes is one item. What a URDF or MJCF in the folder is made of is none, nor is the
    MJCF of a converted scene. A file that is named directly is always in, so that opening it can
    say what is wrong with it.

    Raises:
        InputFileError: where a path doesn't exist or a folder holds nothing that can be opened.
    """
    out: list[Path] = []
    for path in map(Path, paths):
        if not path.exists():
            raise InputFileError(path, "no such file or folder", "check the path")
        found = _without_pieces(_search(path, set())) if path.is_dir() else [path]
        if not found:
            looked = ", ".join((*FOLDER_SUFFIXES, *MODEL_SUFFIXES))
            raise InputFileError(path, "nothing in it can be opened", f"looked for {looked}")
        out.extend(found)
    return list(dict.fromkeys(out))


def _search(folder: Path, seen: set[Path]) -> list[Path]:
    """What can be opened in ``folder``, but for folders in ``seen``, which takes up all visited."""
    real = folder.resolve()
    if real in seen:  # a link back up, or another name of a folder
        return []
    seen.add(real)
    if _whole(folder) is not None:
        return [folder]
    out: list[Path] = []
    try:
        entries = sorted(folder.iterdir(), key=natural_key)
    except OSError:
        return []
    if is_part_folder(folder, FOLDER_SUFFIXES):
        return [folder, *(p for p in entries if is_model(p))]
    for entry in entries:
        if entry.name.startswith("."):
            continue
        if entry.is_dir():
            out.extend(_search(entry, seen))
        elif entry.is_file() and (
            entry.suffix.lower() in FOLDER_SUFFIXES
            or (is_model(entry) and not (entry.name == "scene.xml" and _is_scene(folder)))
        ):
            out.append(entry)
    urdf = _urdf_of_package(folder)
    if urdf is not None:  # the package is called after the object, its folder urdf/ isn't
        return [folder, *(p for p in out if p not in (urdf, urdf.parent))]
    return out


def _is_scene(folder: Path) -> bool:
    """Whether ``scene convert`` wrote it: its MJCF is of all its objects together."""
    return (folder / "scene.json").is_file() and (folder / "assets").is_dir()


def _without_pieces(found: list[Path]) -> list[Path]:
    """Without the meshes, the folders of part meshes, and the MJCFs that a URDF or MJCF among
    ``found`` names."""
    models = [model_of(p) if p.is_dir() else p for p in found]
    outside = (  # what a model has in its own folder isn't found beside that folder
        m for m, p in zip(models, found, strict=True)
        if m is not None and is_model(m) and (m == p or package_root(m) != m.parent)
    )  # fmt: skip
    pieces = {piece for model in outside for piece in files_named_by(model)}
    homes = {piece.parent for piece in pieces}

    def is_piece(path: Path, model: Path | None) -> bool:
        if path.is_dir():
            return model is None and path.absolute() in homes
        return path.absolute() in pieces

    return [p for p, model in zip(found, models, strict=True) if not is_piece(p, model)]


def _digest(paths: Sequence[Path]) -> str:
    """SHA-256 of one file's bytes, or of the sorted digests of several files."""
    digests = []
    for path in dict.fromkeys(paths):
        with path.open("rb") as file:
            digests.append(hashlib.file_digest(file, "sha256").hexdigest())
    if len(digests) == 1:
        return digests[0]
    return hashlib.sha256("\n".join(sorted(digests)).encode()).hexdigest()
