"""NPZ archives with ``points`` (or ``xyz``, ``vertices``) and, where known, colours and faces.

Also the maps of reconstruction networks (DUSt3R, VGGT, Pi3): points, colours and confidences of
every pixel of several pictures, (V, H, W, 3).
"""

from __future__ import annotations

import io
import zipfile
import zlib
from pathlib import Path

import numpy as np

from model.core.errors import InputFileError
from model.io.formats.loaded import (
    DEFAULT_MAX_BYTES,
    Loaded,
    check_indices,
    colors_from,
    read_bytes,
)

_KEYS = {
    "points": ("points", "xyz", "vertices", "coords", "pos", "world_points", "pts3d"),
    "colors": ("colors", "rgb", "color"),
    "normals": ("normals", "normal"),
    "faces": ("faces", "triangles"),
    "confidence": ("confidence", "conf", "world_points_conf"),
}

MOST_RATIO = 200
"""An archive that unpacks to more than this many times its size holds no scan."""
_RATIO_FROM = 50_000_000


def read_npz(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> Loaded:
    """Read one NPZ file. Pickled objects are never loaded.

    Raises:
        InputFileError: where it is no such archive or has no points.
    """
    data = read_bytes(path, max_bytes)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            # No more than this is read of an entry, whatever it really holds.
            size = sum(i.file_size for i in archive.infolist())
        if size > min(max_bytes, max(_RATIO_FROM, MOST_RATIO * len(data))):
            raise InputFileError(
                path, f"unpacks to {size / 2**30:.2f} GiB, over the limit", "thin the scan first"
            )
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            found = {
                role: next((np.asarray(file[k]) for k in keys if k in file.files), None)
                for role, keys in _KEYS.items()
            }
            keys = ", ".join(file.files)
    except (
        OSError, ValueError, KeyError, EOFError, SyntaxError, TypeError, MemoryError,
        zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError,
    ) as error:  # fmt: skip
        raise InputFileError(path, f"is not an NPZ archive of arrays ({error})") from None
    points, faces = found["points"], found["faces"]
    if points is not None and points.ndim > 2:
        points = points.reshape(-1, points.shape[-1])
    if points is None or points.ndim != 2 or points.shape[1] < 3 or points.dtype.kind not in "fiu":
        raise InputFileError(path, f"has no (N, 3) array 'points'; there are {keys or 'none'}")
    normals, colors = (_fitting(found[k], len(points)) for k in ("normals", "colors"))
    if faces is None or faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
        faces = np.zeros((0, 3), np.int64)
    check_indices(path, faces, len(points))
    if normals is not None and normals.shape[1] != 3:
        normals = None
    single = points.dtype.kind == "f" and points.dtype.itemsize <= 4
    return Loaded(
        np.ascontiguousarray(points[:, :3], np.float32 if single else np.float64),
        faces.astype(np.int64, copy=False),
        normals,
        None if colors is None else colors_from(np.ascontiguousarray(colors)),
        confidence=_confidence(found["confidence"], len(points)) if not len(faces) else None,
    )


def _confidence(value: np.ndarray | None, count: int) -> np.ndarray | None:
    if value is None or value.size != count or value.dtype.kind not in "fiu":
        return None
    return value.reshape(-1)


def _fitting(value: np.ndarray | None, count: int) -> np.ndarray | None:
    if value is not None and value.ndim > 2:
        value = value.reshape(-1, value.shape[-1])
    if value is None or value.ndim != 2 or len(value) != count or value.dtype.kind not in "fiu":
        return None
    return value if value.shape[1] in (3, 4) else None
