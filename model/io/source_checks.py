"""Checks on every reader's result: NaN, units, up axis, and whether there is an object."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.errors import InputFileError
from model.core.mesh import Material, Mesh
from model.core.point_cloud import PointCloud
from model.io.formats.loaded import Loaded

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
        raise InputFileError(
            path, f"all {bad} points are NaN or infinite", "export the object again"
        )
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
            loaded, faces=loaded.faces[:0], face_material=loaded.face_material[:0],
            warnings=(*loaded.warnings, warning),
        )  # fmt: skip
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
