"""Files with one mesh or cloud to :class:`~model.core.asset.Asset` values.

Up axis by default: glTF and GLB are +y up by their standard; a single OBJ file is taken as +y up,
as modelling tools write it; PLY, STL, PCD, NPZ, text, LAS and E57 are +z up. USD
and COLLADA files state their axis and unit, which are applied. Folders of part meshes lie in
one object frame that is +z up already, whatever their format, except for glTF.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.core.asset import Asset, Source, UpAxis
from model.core.errors import ConfigurationError, InputFileError
from model.core.files import file_sha256
from model.core.part_names import named_parts
from model.core.progress import Progress, no_progress
from model.core.rotations import affine
from model.io.formats.dae import read_dae
from model.io.formats.e57 import read_e57
from model.io.formats.gltf import read_gltf
from model.io.formats.las import read_las
from model.io.formats.loaded import DEFAULT_MAX_BYTES, Loaded, size_of
from model.io.formats.mtl import MaterialFiles
from model.io.formats.npz import read_npz
from model.io.formats.obj import read_obj
from model.io.formats.pcd import read_pcd
from model.io.formats.ply import read_ply
from model.io.formats.stl import read_stl
from model.io.formats.text import read_text
from model.io.formats.usd import read_usd
from model.io.source_checks import cleaned, far_shift, is_solid, shifted, to_cloud, to_mesh

_READERS: dict[str, Callable[[Path, int], Loaded]] = {
    ".ply": read_ply, ".obj": read_obj, ".glb": read_gltf, ".gltf": read_gltf, ".stl": read_stl,
    ".pcd": read_pcd, ".xyz": read_text, ".xyzrgb": read_text, ".xyzn": read_text,
    ".las": read_las, ".laz": read_las, ".e57": read_e57, ".dae": read_dae,
    ".usd": read_usd, ".usda": read_usd, ".usdc": read_usd, ".usdz": read_usd,
    ".pts": read_text, ".asc": read_text, ".txt": read_text, ".csv": read_text, ".npz": read_npz,
}  # fmt: skip
SUFFIXES: tuple[str, ...] = tuple(_READERS)
"""Suffixes of the meshes and clouds that can be opened."""

STAGES = (".usd", ".usda", ".usdc")
"""Suffixes of USD stages, which are scenes unless one is named as a single object."""

_TOO_COMMON = (".txt", ".csv", ".npz")  # in a folder these are rarely clouds
FOLDER_SUFFIXES: tuple[str, ...] = tuple(s for s in SUFFIXES if s not in (*_TOO_COMMON, *STAGES))
"""Suffixes that are picked up when a folder is searched."""

_Y_UP = (".glb", ".gltf")

_DECLARED_UP = (*_Y_UP, *STAGES, ".usdz", ".dae", ".urdf", ".sdf", ".xml", ".mjcf")

_WORLD_FROM_SOURCE: dict[str, list[list[int]]] = {
    "z": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "y": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    "x": [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
    "-z": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "-y": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "-x": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
}


def default_up_axis(path: Path, *, part_of_folder: bool = False) -> UpAxis:
    """The default up axis of a file, see the module's docstring."""
    suffix = path.suffix.lower()
    if suffix in _Y_UP or (suffix == ".obj" and not part_of_folder):
        return "y"
    return "z"


def declares_up(path: Path) -> bool:
    """True if the format of a file or folder declares the up axis."""
    return path.is_dir() or path.suffix.lower() in _DECLARED_UP


def turned_up(up_axis: UpAxis) -> np.ndarray:
    """(4, 4) rotation that turns ``up_axis`` to +z. From y it is a quarter turn about x.

    Raises:
        ConfigurationError: for an axis that is none.
    """
    if up_axis not in _WORLD_FROM_SOURCE:
        raise ConfigurationError(f"up axis {up_axis!r} is none of {', '.join(_WORLD_FROM_SOURCE)}")
    return affine(_WORLD_FROM_SOURCE[up_axis])


def unknown_type(path: Path, suffixes: Sequence[str]) -> InputFileError:
    """The error for a file whose suffix is none of ``suffixes``."""
    what = f"files of type {path.suffix!r}" if path.suffix else "files without a suffix"
    return InputFileError(path, f"{what} can't be opened", f"use one of {', '.join(suffixes)}")


def load_geometry(path: Path, max_bytes: int, files: MaterialFiles | None = None) -> Loaded:
    """One mesh or cloud as its file has it.

    Raises:
        InputFileError: for a file that is no regular one, empty, or of no known type.
    """
    size_of(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise unknown_type(path, SUFFIXES)
    if reader is read_obj and files is not None:
        return read_obj(path, max_bytes, files=files)
    return reader(path, max_bytes)


def read_geometry_file(
    path: Path,
    *,
    up_axis: UpAxis | None = None,
    unit_scale: float = 1.0,
    max_bytes: int = DEFAULT_MAX_BYTES,
    files: MaterialFiles | None = None,
    progress: Progress = no_progress,
) -> Asset:
    """Read one file with a mesh or a cloud; see :func:`model.io.open_asset.open_asset`.

    Raises:
        InputFileError: where it can't be used.
        GeometryError: where it holds no object.
    """
    progress(0.0, f"reading {path.name}")
    loaded = load_geometry(path, max_bytes, files)
    up = up_axis or default_up_axis(path)
    progress(0.7, "checking")
    return _asset_of(path, path.stem, loaded, file_digest([path]), up, unit_scale)


def _asset_of(
    path: Path, name: str, loaded: Loaded, sha256: str, up: UpAxis, scale: float
) -> Asset:
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
    names, sizes = zip(*loaded.pieces, strict=True) if loaded.pieces else ((), ())
    numbers = named_parts(names)
    if numbers is None or sum(sizes) != len(loaded.faces):  # damaged faces were left out
        return None, ()
    plain = ("".join(c for c in name if c.isprintable()) for name in names)
    called = dict(zip(numbers, plain, strict=True))
    listed = tuple(called.get(i, "") for i in range(max(numbers) + 1))
    return np.repeat(np.asarray(numbers, np.int32), sizes), listed


def file_digest(paths: Sequence[Path]) -> str:
    """SHA-256 of one file's bytes, or of the sorted digests of several files."""
    digests = [file_sha256(path) for path in dict.fromkeys(paths)]
    if len(digests) == 1:
        return digests[0]
    return hashlib.sha256("\n".join(sorted(digests)).encode()).hexdigest()
