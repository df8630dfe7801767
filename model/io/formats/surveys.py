"""Surveyed clouds: LAS and LAZ (ASPRS LAS 1.4, through laspy), and the units of their coordinate
systems: GeoTIFF keys (OGC 19-008r4) and WKT 1 and 2.

Names of systems are not looked up: their own units count, which both forms state.
"""

from __future__ import annotations

import io
import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.errors import InputFileError
from model.core.packages import require
from model.io.formats.loaded import DARK, DEFAULT_MAX_BYTES, Loaded, colors_from, read_bytes

_METRES = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937, 9005: 0.3047972654, 9036: 1000.0}
"""Metres of the units of length by their EPSG codes: m, foot, US survey foot, Clarke's foot, km."""
_NAMES = {0.3048: "feet", 1200 / 3937: "US survey feet", 1.0: "metres"}
_MODEL, _GEOGRAPHIC, _PROJECTED, _LENGTH, _VERTICAL = 1024, 2048, 3072, 3076, 4099
_GLOBE, _CENTRED = 2, 3
"""Values of the key of the model: longitudes and latitudes, and what counts from the earth's
centre."""
CENTRED = " (geocentric: z is not up)"
_UNIT = re.compile(r'UNIT\s*[\[(]\s*"([^"]*)"\s*,\s*(\d[-+.\deE]*)', re.IGNORECASE)
_HEIGHTS = re.compile(r"\bVERT(?:_CS|CRS|ICALCRS)\s*[\[(]", re.IGNORECASE)
_ON_PLANE = re.compile(
    r"\b(?:PROJCS|PROJCRS|PROJECTEDCRS|LOCAL_CS|ENGCRS|ENGINEERINGCRS)\b", re.IGNORECASE
)
_AT_CENTRE = re.compile(r"\bGEOCCS\b|\bCS\s*[\[(]\s*Cartesian\s*,\s*3", re.IGNORECASE)
_ON_GLOBE = re.compile(r"\bGEOGCS\b|\bCS\s*[\[(]\s*ellipsoidal", re.IGNORECASE)
_TURN = re.compile(r"deg|rad|gon", re.IGNORECASE)


@dataclass(frozen=True)
class Units:
    """Units of a coordinate system.

    Attributes:
        name: of the system; "" where the file names none.
        plane: metres of a unit of x and y; None for longitudes and latitudes.
        height: metres of a unit of z.
        known: whether the file says so.
        unread: code of a unit that isn't known, or 0.
    """

    name: str = ""
    plane: float | None = 1.0
    height: float = 1.0
    known: bool = False
    unread: int = 0

    @property
    def remark(self) -> str:
        """Human-readable."""
        system = f"coordinate system {self.name!r}" if self.name else "no coordinate system stated"
        if not self.known:
            why = f"EPSG:{self.unread} isn't known" if self.unread else "none stated"
            return f"unit: metres taken, {why}; {system}"
        if self.plane is None:
            return f"unit: longitudes and latitudes; {system}"
        units = dict.fromkeys(_unit_name(u) for u in (self.plane, self.height))
        return f"unit: {', heights in '.join(units)}, read as metres; {system}"


def _unit_name(metres: float) -> str:
    same = (name for size, name in _NAMES.items() if abs(metres - size) < 1e-9)
    return next(same, f"{metres:g} m")


def units_of_keys(keys: Mapping[int, int], texts: str, size: float = 0.0) -> Units:
    """Units by GeoTIFF keys: id → code; ``texts`` names the system, ``size`` are the metres of a
    unit of its own."""
    code = keys.get(_PROJECTED) or keys.get(_GEOGRAPHIC)
    name = texts.strip("|\0 ").partition("|")[0] or (f"EPSG:{code}" if code else "")
    height = _METRES.get(keys.get(_VERTICAL, 0))
    if keys.get(_MODEL) == _GLOBE:
        return Units(name, None, height or 1.0, True)
    name += CENTRED * (keys.get(_MODEL) == _CENTRED)
    plane = _METRES.get(keys.get(_LENGTH, 0)) or size
    if not plane:
        return Units(name, unread=keys.get(_LENGTH, 0))
    return Units(name, plane, height or plane, known=True)


def units_of_wkt(text: str) -> Units | None:
    """Units by WKT, compound systems too; None where it can't be read.

    The last unit of a system is that of its axes, as those of its parts stand before.
    """
    name = re.search(r'"([^"]*)"', text)
    if name is None:
        return None
    flat, above = [*_HEIGHTS.split(text, maxsplit=1), ""][:2]
    lengths = [float(s) for unit, s in _UNIT.findall(flat) if not _TURN.search(unit) and float(s)]
    heights = [float(size) for _, size in _UNIT.findall(above) if float(size)] or lengths or [1.0]
    centred = _AT_CENTRE.search(flat) is not None
    if _ON_GLOBE.search(flat) and not (centred or _ON_PLANE.search(flat)):
        return Units(name[1], None, heights[-1], True)
    return Units(name[1] + CENTRED * centred, [1.0, *lengths][-1], heights[-1], bool(lengths))


_NOISE = (7, 18)
"""Classes of low and of high noise."""
_WKT, _GEOTIFF, _SIZE = 2112, (34735, 34737, 34736), 3077
"""Numbers of the records of coordinate systems: WKT; GeoTIFF's keys, texts and doubles; and the key
of the double that is the size of a unit."""
_PANIC = "PanicException"
"""Exception of failing Rust libraries; no ``Exception``."""
_LASZIP = 22204
"""Number of the record that says how points are packed (LASzip, Isenburg 2013)."""
_LARGEST_CHUNK = 1 << 30
"""Bytes; writers pack 50,000 points together, some two megabytes."""
_PACKED = 0x80
"""Bit of the point format that says that points are packed as LAZ."""


def read_las(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> Loaded:
    """Read one LAS or LAZ file; +z up, metres by the units of its coordinate system.

    Points that are flagged as withheld or classified as noise are left out, with their number.

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
            units = _units(file.header)
        points = np.column_stack([cloud.x, cloud.y, cloud.z]).astype(np.float64)
        kept, remarks = _counting(cloud)
        colors = None
        if {"red", "green", "blue"} <= set(cloud.point_format.dimension_names):
            rgb = np.column_stack([cloud.red, cloud.green, cloud.blue]).astype(np.uint16)
            colors = colors_from(rgb)[kept] if rgb.any() else None
        if colors is None and np.asarray(cloud.intensity).any():
            remarks.append(DARK)
    except InputFileError:
        raise
    except BaseException as error:  # laspy and lazrs raise many kinds for damaged files
        if not isinstance(error, Exception) and type(error).__name__ != _PANIC:
            raise
        raise InputFileError(path, f"can't be read as LAS ({error})", "export it again") from None
    if not kept.any():
        why = "has no points" if not len(points) else f"has no points that count ({remarks[0]})"
        raise InputFileError(path, why, "export the scan again")
    if units.plane is None:
        what = f"has longitudes and latitudes ({units.name}), in which nothing has a size"
        raise InputFileError(path, what, "export it in a projected coordinate system, in metres")
    points = points[kept] * [units.plane, units.plane, units.height]
    return Loaded(points, colors=colors, warnings=(units.remark, *remarks))


def _counting(cloud: Any) -> tuple[npt.NDArray[np.bool_], list[str]]:
    """(N,) points that are to be processed, and remarks on the others."""
    withheld = np.asarray(cloud.withheld, bool)
    noise = np.isin(np.asarray(cloud.classification), _NOISE) & ~withheld
    counts = {"flagged as withheld": withheld.sum(), "classified as noise": noise.sum()}
    remarks = [f"{n:,} points {what} are left out" for what, n in counts.items() if n]
    return ~(withheld | noise), remarks


def _units(header: Any) -> Units:
    """By the records of the coordinate system; of the two forms the one that the header names."""
    records = [*header.vlrs, *(header.evlrs or ())]
    text = next((getattr(r, "string", "") for r in records if r.record_id == _WKT), "")
    by_text = units_of_wkt(text) if text.strip("\0 ") else None
    geo = {r.record_id: r for r in records if r.record_id in _GEOTIFF}
    if by_text is not None and (header.global_encoding.wkt or _GEOTIFF[0] not in geo):
        return by_text
    if _GEOTIFF[0] not in geo:
        return by_text or Units()
    names = getattr(geo.get(_GEOTIFF[1]), "strings", ())
    keys = getattr(geo[_GEOTIFF[0]], "geo_keys", ())
    codes = {int(k.id): int(k.value_offset) for k in keys if not k.tiff_tag_location}
    doubles: Any = getattr(geo.get(_GEOTIFF[2]), "doubles", ())
    own = [k.value_offset for k in keys if k.id == _SIZE and k.value_offset < len(doubles)]
    return units_of_keys(codes, " ".join(names), doubles[own[0]].value if own else 0.0)


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
