"""Files with one mesh or cloud to :class:`~model.core.asset.Asset` values, and checks on them.

Up axis by default: glTF and GLB are +y up by their standard; a single OBJ file is taken as +y up,
as modelling tools write it; PLY, STL, PCD, NPZ, text, LAS, E57 and PTX are +z up. USD
and COLLADA files state their axis and unit, which are applied. Folders of part meshes lie in
one object frame that is +z up already, whatever their format, except for glTF.

Every reader's result is checked for NaN, units, up axis, and whether there is an object.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.asset import Asset, Source, UpAxis
from model.core.errors import ConfigurationError, InputFileError
from model.core.files import file_sha256
from model.core.geometry import Material, Mesh, PointCloud, affine
from model.core.names import named_parts
from model.core.progress import Progress, no_progress
from model.io.formats.dae import read_dae
from model.io.formats.gltf import read_gltf
from model.io.formats.loaded import DEFAULT_MAX_BYTES, WORLD_FROM_UP, Loaded, size_of
from model.io.formats.mtl import MaterialFiles
from model.io.formats.obj import read_obj
from model.io.formats.pcd import read_pcd
from model.io.formats.ply import read_ply
from model.io.formats.points import read_npz, read_text
from model.io.formats.stations import read_e57, read_ptx
from model.io.formats.stl import read_stl
from model.io.formats.surveys import read_las
from model.io.formats.usd import read_usd

MIN_POINTS = 4
"""Fewest points that span a body."""

_FAR = 1e4  # metres from the origin where float32 counts in millimetres
_AS_POINTS = "; taken as points"
_FARTHEST = 1e9  # metres; beyond lie damaged numbers, not objects


def cleaned(path: Path, loaded: Loaded, turn: npt.NDArray[Any], scale: float) -> Loaded:
    """``loaded`` in metres and +z up, without what is not a number.

    Args:
        path: for messages.
        loaded: as the format's reader gave it.
        turn: (4, 4) rotation to +z up.
        scale: metres per unit.

    Raises:
        InputFileError: where no object is left.
    """
    loaded = _finite(path, loaded, scale)
    matrix = turn.copy()
    matrix[:3, :3] *= scale
    if not (matrix == np.eye(4)).all():
        loaded = loaded.moved(matrix)
    if len(loaded.faces):
        loaded = _solid(loaded)
    if not len(loaded.faces):
        loaded = _points(path, loaded)
    if not np.ptp(loaded.vertices, axis=0).any():
        raise InputFileError(path, "all its points are at one place", "an object has an extent")
    return loaded


def far_shift(loaded: Loaded) -> tuple[float, float, float]:
    """Whole metres to take off what lies so far from its origin that float32 gets coarse.

    Surveyed scans have coordinates of millions of metres, where float32 counts in steps of 0.5 m.
    """
    low, high = loaded.vertices.min(axis=0), loaded.vertices.max(axis=0)
    middle = (low.astype(np.float64) + high) / 2
    if np.linalg.norm(middle) < max(_FAR, 10.0 * float(np.linalg.norm(high - low))):
        return (0.0, 0.0, 0.0)
    x, y, z = np.rint(middle).tolist()
    return (x, y, z)


def shifted(loaded: Loaded, shift: tuple[float, float, float]) -> Loaded:
    """Move by minus ``shift``, with a warning."""
    if shift == (0.0, 0.0, 0.0):
        return loaded
    warning = "lies far from its origin: moved by ({:g}, {:g}, {:g}) m".format(*(-s for s in shift))
    vertices = loaded.vertices.astype(np.float64) - shift
    return replace(loaded, vertices=vertices, warnings=(*loaded.warnings, warning))


def is_solid(loaded: Loaded) -> bool:
    """True if it is a mesh, not a cloud."""
    return len(loaded.faces) > 0


def to_mesh(loaded: Loaded) -> Mesh:
    """The :class:`Mesh` of cleaned geometry."""
    colors = loaded.colors
    return Mesh(
        _locked(loaded.vertices, np.float64),
        _locked(loaded.faces, np.int32),
        _locked(loaded.face_material, np.int32),
        loaded.materials or (Material(),),
        None if loaded.uv is None else _locked(loaded.uv, np.float32),
        None if colors is None else _locked(colors, np.uint8),
    )


def to_cloud(loaded: Loaded) -> PointCloud:
    """The :class:`PointCloud` of cleaned geometry."""
    return PointCloud(
        _locked(loaded.vertices, np.float32),
        None if loaded.normals is None else _locked(loaded.normals, np.float32),
        None if loaded.colors is None else _locked(loaded.colors[:, :3], np.uint8),
        None
        if loaded.confidence is None
        else _locked(np.nan_to_num(loaded.confidence, posinf=1.0, neginf=0.0), np.float32),
    )


def _locked(array: npt.NDArray[Any], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """A read-only array of its own, so that the types need not copy it again."""
    out = np.ascontiguousarray(array, dtype)
    if out.flags.writeable:
        out.flags.writeable = False
    return out


def _finite(path: Path, loaded: Loaded, scale: float) -> Loaded:
    """Without the vertices that are NaN, infinite or absurdly far, and the faces on them."""
    with np.errstate(invalid="ignore"):
        good = np.all(np.abs(loaded.vertices) <= _FARTHEST / scale, axis=1)
    bad = int(len(good) - np.count_nonzero(good))
    if not bad:
        return loaded
    if bad == len(good):
        why = f"all {bad} points are NaN or infinite"
        raise InputFileError(path, why, "export the object again")
    warning = f"{bad} of {len(good)} points are NaN or infinite and were left out"
    face_good = np.all(good[loaded.faces], axis=1)
    if len(face_good) and not face_good.any():
        loaded = replace(loaded, faces=loaded.faces[:0], face_material=loaded.face_material[:0])
        face_good = face_good[:0]
    lost = int(len(face_good) - np.count_nonzero(face_good))
    if lost:
        warning += f", with {lost} faces"
    number = np.cumsum(good) - 1
    material = loaded.face_material
    return replace(
        _taken(loaded, good),
        faces=number[loaded.faces[face_good]],
        face_material=material[face_good] if len(material) else material,
        warnings=(*loaded.warnings, warning),
    )


def _taken(loaded: Loaded, index: npt.NDArray[Any]) -> Loaded:
    """The vertices at ``index`` with their attributes; faces are left alone."""

    def pick(values: npt.NDArray[Any] | None) -> npt.NDArray[Any] | None:
        return None if values is None else values[index]

    return replace(
        loaded,
        vertices=loaded.vertices[index],
        normals=pick(loaded.normals),
        colors=pick(loaded.colors),
        uv=pick(loaded.uv),
        confidence=pick(loaded.confidence),
    )


def _solid(loaded: Loaded) -> Loaded:
    """Only the vertices that faces use; no faces at all where none has an area."""
    t = loaded.vertices[loaded.faces]
    cross = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    if not cross.any():
        warning = f"none of its {len(loaded.faces)} faces has an area{_AS_POINTS}"
        return replace(
            loaded,
            faces=loaded.faces[:0],
            face_material=loaded.face_material[:0],
            warnings=(*loaded.warnings, warning),
        )
    used = np.zeros(len(loaded.vertices), bool)
    used[loaded.faces.reshape(-1)] = True
    if not used.all():
        number = np.cumsum(used) - 1
        loaded = replace(_taken(loaded, used), faces=number[loaded.faces])
    material = loaded.face_material
    if not len(material):
        material = np.zeros(len(loaded.faces), np.int32)
    return replace(loaded, normals=None, face_material=material)


def _points(path: Path, loaded: Loaded) -> Loaded:
    count = len(loaded.vertices)
    if count < MIN_POINTS:
        what = "a single point" if count == 1 else f"{count} points"
        flat = [w.removesuffix(_AS_POINTS) for w in loaded.warnings if w.endswith(_AS_POINTS)]
        if flat:
            raise InputFileError(path, f"{flat[0]}, they lie in {what}", "export the object again")
        raise InputFileError(
            path,
            f"holds {what} and no faces" if count else "holds neither points nor faces",
            f"a cloud needs {MIN_POINTS} points or more, a mesh one face or more",
        )
    normals, warnings = _unit(loaded.normals, loaded.warnings)
    return replace(loaded, normals=normals, uv=None, materials=(), warnings=warnings)


def _unit(
    normals: npt.NDArray[Any] | None, warnings: tuple[str, ...]
) -> tuple[npt.NDArray[Any] | None, tuple[str, ...]]:
    """Normals of length one, or None where some are no directions."""
    if normals is None:
        return None, warnings
    length = np.linalg.norm(normals.astype(np.float64), axis=1)
    with np.errstate(invalid="ignore"):
        bad = int(np.count_nonzero(~((length > 1e-12) & (length < np.inf))))
    if bad:
        if bad < len(length):
            warnings = (
                *warnings,
                f"{bad} of {len(length)} normals are no directions; all left out",
            )
        return None, warnings
    return normals / length[:, None].astype(normals.dtype), warnings


Piece = tuple[str, bool]
"""Name of a piece of a file, and whether the centre of its box is its origin."""
_Reader = Callable[[Path, int], Loaded]
_READERS: dict[str, _Reader] = {".ply": read_ply, ".obj": read_obj, ".glb": read_gltf}
_READERS |= {".gltf": read_gltf, ".stl": read_stl, ".pcd": read_pcd}
_READERS |= dict.fromkeys((".xyz", ".xyzrgb", ".xyzn"), read_text)
_READERS |= {".las": read_las, ".laz": read_las, ".e57": read_e57, ".ptx": read_ptx}
_READERS |= {".dae": read_dae}
_READERS |= dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), read_usd)
_READERS |= {**dict.fromkeys((".pts", ".asc", ".txt", ".csv"), read_text), ".npz": read_npz}
SUFFIXES: tuple[str, ...] = tuple(_READERS)
"""Suffixes of the meshes and clouds that can be opened."""

STAGES = (".usd", ".usda", ".usdc")
"""Suffixes of USD stages, which are scenes unless one is named as a single object."""

_TOO_COMMON = (".txt", ".csv", ".npz")  # in a folder these are rarely clouds
FOLDER_SUFFIXES: tuple[str, ...] = tuple(s for s in SUFFIXES if s not in (*_TOO_COMMON, *STAGES))
"""Suffixes that are picked up when a folder is searched."""

_Y_UP = (".glb", ".gltf")

_DECLARED_UP = (*_Y_UP, *STAGES, ".usdz", ".dae", ".urdf", ".sdf", ".xml", ".mjcf")


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
    if up_axis not in WORLD_FROM_UP:
        raise ConfigurationError(f"up axis {up_axis!r} is none of {', '.join(WORLD_FROM_UP)}")
    return affine(WORLD_FROM_UP[up_axis])


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
    for textured in (read_obj, read_dae):
        if reader is textured and files is not None:
            return textured(path, max_bytes, files=files)
    return reader(path, max_bytes)


def read_geometry_file(
    path: Path,
    *,
    up_axis: UpAxis | None = None,
    unit_scale: float = 1.0,
    max_bytes: int = DEFAULT_MAX_BYTES,
    files: MaterialFiles | None = None,
    progress: Progress = no_progress,
    piece: Piece | None = None,
) -> Asset:
    """Read one file with a mesh or a cloud; see :func:`model.io.open_asset.open_asset`.

    Args:
        piece: the only one of its named pieces that is taken; all where it has none of that name,
            with a warning.

    Raises:
        InputFileError: where it can't be used.
        GeometryError: where it holds no object.
    """
    progress(0.0, f"reading {path.name}")
    loaded = load_geometry(path, max_bytes, files)
    if piece is not None:
        loaded = _only(loaded, *piece)
    up = up_axis or default_up_axis(path)
    progress(0.7, "checking")
    return _asset_of(path, path.stem, loaded, file_digest([path]), up, unit_scale)


def _only(loaded: Loaded, name: str, centered: bool) -> Loaded:
    names, sizes = zip(*loaded.pieces, strict=True) if loaded.pieces else ((), ())
    wanted = np.repeat([n == name for n in names], sizes).astype(bool)
    if not wanted.any() or len(wanted) != len(loaded.faces):
        whole = f"the whole mesh is read: it has no submesh {name!r}"
        return replace(loaded, warnings=(*loaded.warnings, whole))
    faces, material = loaded.faces[wanted], loaded.face_material
    corners = loaded.vertices[faces.reshape(-1)]
    middle = (corners.min(0) + corners.max(0)) / 2 if centered else np.zeros(3)
    return replace(
        loaded,
        vertices=loaded.vertices - middle,
        faces=faces,
        face_material=material[wanted] if len(material) else material,
        pieces=(),
        polygon=None,
    )


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
            name,
            mesh=to_mesh(loaded),
            source=source,
            element_part=parts,
            part_names=names,
            warnings=loaded.warnings,
        )
    cloud = to_cloud(loaded)
    return Asset(name, cloud=cloud, source=source, warnings=loaded.warnings)


def _named_parts(loaded: Loaded) -> tuple[npt.NDArray[np.int32] | None, tuple[str, ...]]:
    """Part of each face and names by part, where the file's meshes are called after parts."""
    runs, sizes = zip(*loaded.pieces, strict=True) if loaded.pieces else ((), ())
    names = tuple(dict.fromkeys(runs)) if loaded.names_join else runs
    numbers = named_parts(names)
    if numbers is None or sum(sizes) != len(loaded.faces):  # damaged faces were left out
        return None, ()
    plain = ("".join(c for c in name if c.isprintable()) for name in names)
    called = dict(zip(numbers, plain, strict=True))
    listed = tuple(called.get(i, "") for i in range(max(numbers) + 1))
    of_run = [numbers[names.index(name)] for name in runs] if loaded.names_join else numbers
    return np.repeat(np.asarray(of_run, np.int32), sizes), listed


def file_digest(paths: Sequence[Path]) -> str:
    """SHA-256 of one file's bytes, or of the sorted digests of several files."""
    digests = [file_sha256(path) for path in dict.fromkeys(paths)]
    if len(digests) == 1:
        return digests[0]
    return hashlib.sha256("\n".join(sorted(digests)).encode()).hexdigest()
