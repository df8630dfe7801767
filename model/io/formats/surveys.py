"""Surveyed clouds: LAS and LAZ (ASPRS LAS 1.4, through laspy), E57 (ASTM E2807, through pye57)."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np

from model.core.errors import InputFileError
from model.core.packages import require
from model.io.formats.loaded import DEFAULT_MAX_BYTES, Loaded, colors_from, read_bytes, size_of

_PANIC = "PanicException"
"""Exception of failing Rust libraries; no ``Exception``."""
_LASZIP = 22204
"""Number of the record that says how points are packed (LASzip, Isenburg 2013)."""
_LARGEST_CHUNK = 1 << 30
"""Bytes; writers pack 50,000 points together, some two megabytes."""
_PACKED = 0x80
"""Bit of the point format that says that points are packed as LAZ."""


def read_las(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> Loaded:
    """Read one LAS or LAZ file; +z up, in the unit of its coordinate system, mostly metres.

    Raises:
        InputFileError: where it is no such file, damaged, or has no points.
        ConfigurationError: where laspy isn't installed.
    """
    laspy = require("laspy", "artiworld[scans]")
    data = read_bytes(path, max_bytes)
    if not data.startswith(b"LASF"):
        raise InputFileError(path, "is not a LAS file", "a LAS or LAZ file begins with 'LASF'")
    if not _plausible(data):  # laspy would count through billions of records
        raise InputFileError(path, "has a damaged LAS header", "export it again")
    try:
        with laspy.open(io.BytesIO(data)) as file:
            declared = int(file.header.point_count) * int(file.header.point_format.size)
            if declared > max_bytes:
                raise InputFileError(path, "unpacks to more than the limit", "thin the scan first")
            cloud = file.read()
        points = np.column_stack([cloud.x, cloud.y, cloud.z]).astype(np.float64)
        names = set(cloud.point_format.dimension_names)
        colors = None
        if {"red", "green", "blue"} <= names:
            rgb = np.column_stack([cloud.red, cloud.green, cloud.blue]).astype(np.uint16)
            colors = colors_from(rgb) if rgb.any() else None
    except InputFileError:
        raise
    except BaseException as error:  # laspy and lazrs raise many kinds for damaged files
        if not isinstance(error, Exception) and type(error).__name__ != _PANIC:
            raise
        raise InputFileError(path, f"can't be read as LAS ({error})", "export it again") from None
    if not len(points):
        raise InputFileError(path, "has no points", "export the scan again")
    return Loaded(points, colors=colors)


def _plausible(data: bytes) -> bool:
    """True if the records that the header declares fit into the file (LAS 1.4, table 3)."""
    if len(data) < 227 or data[24] != 1 or data[25] > 4:
        return False
    size, start, records = struct.unpack_from("<HII", data, 94)
    extended = (
        struct.unpack_from("<QI", data, 235) if data[25] == 4 and len(data) >= 247 else (0, 0)
    )
    return (
        size <= start <= len(data)
        and records * 54 <= start
        and extended[0] <= len(data)
        and extended[1] * 60 <= len(data)
        and (not data[104] & _PACKED or _few_chunks(data, start))
    )


def _few_chunks(data: bytes, start: int) -> bool:
    """True if a LAZ file can hold the chunks that its table declares: lazrs ends the process where
    it gets no memory for them."""
    if start + 8 > len(data):
        return False
    (at,) = struct.unpack_from("<q", data, start)
    if at == -1:  # written to a stream
        (at,) = struct.unpack_from("<q", data, len(data) - 8)
    if not start <= at <= len(data) - 8:
        return False
    _, chunks = struct.unpack_from("<II", data, at)
    return chunks <= len(data) and _chunk_bytes(data) <= _LARGEST_CHUNK


def _chunk_bytes(data: bytes) -> int:
    """Unpacked bytes of a chunk, by the record of LASzip; 0 where their sizes vary."""
    at, _, records = struct.unpack_from("<HII", data, 94)
    (point,) = struct.unpack_from("<H", data, 105)
    for _ in range(records):
        if at + 70 > len(data):
            break
        number, size = struct.unpack_from("<HH", data, at + 18)
        if data[at + 2 : at + 16] == b"laszip encoded" and number == _LASZIP:
            (points,) = struct.unpack_from("<I", data, at + 54 + 12)
            return 0 if points == 2**32 - 1 else points * point
        at += 54 + size
    return 0


_POINT_BYTES = 24


def read_e57(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> Loaded:
    """Read all scans of one E57 file in their common frame; metres, +z up.

    Raises:
        InputFileError: where it is no such file, damaged, or has no points.
        ConfigurationError: where pye57 isn't installed.
    """
    pye57 = require("pye57", "artiworld[scans]")
    if size_of(path) > max_bytes:
        raise InputFileError(path, "is over the limit of bytes", "thin the scan first")
    points: list[np.ndarray] = []
    colors: list[np.ndarray | None] = []
    try:
        file = pye57.E57(str(path))
        try:
            total = sum(file.get_header(k).point_count for k in range(file.scan_count))
            if total * _POINT_BYTES > max_bytes:
                raise InputFileError(path, f"has {total} points, over the limit", "thin the scan")
            for k in range(file.scan_count):
                data = file.read_scan(k, colors=True, ignore_missing_fields=True)
                points.append(np.column_stack([data[f"cartesian{a}"] for a in "XYZ"]))
                shown = [data.get(f"color{c}") for c in ("Red", "Green", "Blue")]
                colors.append(None if any(c is None for c in shown) else np.column_stack(shown))  # type: ignore[arg-type]
        finally:
            file.close()
    except InputFileError:
        raise
    except Exception as error:  # libE57 raises its own kinds, and KeyError for missing fields
        raise InputFileError(path, f"can't be read as E57 ({error})", "export it again") from None
    if not sum(map(len, points)):
        raise InputFileError(path, "has no points", "export the scan again")
    rgb = None
    if all(c is not None for c in colors):
        rgb = colors_from(np.concatenate(colors).astype(np.uint16))  # type: ignore[arg-type]
    return Loaded(np.concatenate(points).astype(np.float64), colors=rgb)
