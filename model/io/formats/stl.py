"""STL, binary and ASCII.

open3d 0.20 and trimesh 5.2 return nothing, without an error, for a binary file that is cut off;
an ASCII file with a byte order mark is empty in the one and fails in the other.
"""

from __future__ import annotations

import codecs
from pathlib import Path

import numpy as np

from model.core.errors import InputFileError
from model.geometry.topology import same_points
from model.io.formats.loaded import DEFAULT_MAX_BYTES, Loaded, numbers, read_bytes

_MAGICS = b"COLOR="
"""In a header where Magics wrote colours; others set the highest bit of attributes."""
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> Loaded:
    """Read one STL file; corners at the same place become one vertex.

    Raises:
        InputFileError: where it is no STL, or cut off.
    """
    data = read_bytes(path, max_bytes).removeprefix(codecs.BOM_UTF8)
    promised = int.from_bytes(data[80:84], "little") if len(data) >= 84 else -1
    room = (len(data) - 84) // _RECORD.itemsize
    # Binary files may begin with "solid" too, so the size decides.
    remarks: tuple[str, ...] = ()
    if promised >= 0 and 84 + promised * _RECORD.itemsize == len(data):
        records = np.frombuffer(data, _RECORD, promised, 84)
        corners = records["corners"].reshape(-1, 3)
        if (records["attribute"] >> 15).any() or _MAGICS in data[:80]:
            remarks = ("colours of STL files are not read",)
    elif data.lstrip()[:5].lower() == b"solid" and _is_ascii(data):
        corners = _ascii(path, data)
    elif 0 < promised <= room:
        corners = np.frombuffer(data, _RECORD, promised, 84)["corners"].reshape(-1, 3)
    else:
        raise InputFileError(
            path,
            f"the header promises {promised} triangles, but there is room for {max(room, 0)}"
            if promised >= 0
            else "is too short for an STL file",
            "the file is cut off or is no STL; export it again",
        )
    first, inverse = same_points(corners)
    return Loaded(corners[first], inverse.reshape(-1, 3), warnings=remarks)


def _is_ascii(data: bytes) -> bool:
    words = data.lower()
    return b"vertex" in words or b"endsolid" in words


def _ascii(path: Path, data: bytes) -> np.ndarray:
    lines = (line.strip() for line in data.decode("latin-1").splitlines())
    kept = [line[6:] for line in lines if line[:6].lower() == "vertex"]
    values = numbers(path, " ".join(kept), "STL vertex")
    if len(values) != 3 * len(kept) or len(kept) % 3:
        what = f"{len(kept)} vertices with {len(values)} numbers are not whole triangles"
        raise InputFileError(path, what, "the file is cut off or damaged")
    return values.reshape(-1, 3)
