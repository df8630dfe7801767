"""Clouds of several stations of a scanner: E57 (ASTM E2807, through pye57), PTX (Leica's text).

Each station has its own pose, and colours or none. Both formats are in metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.errors import InputFileError
from model.core.packages import require
from model.io.formats.loaded import (
    DARK,
    DEFAULT_MAX_BYTES,
    GREY,
    Loaded,
    colors_from,
    join,
    numbers,
    read_bytes,
    size_of,
)

Array = npt.NDArray[Any]
FloatArray = npt.NDArray[np.float64]
Bytes = npt.NDArray[np.uint8]

_POINT_BYTES = 24
_XYZ = tuple(f"cartesian{a}" for a in "XYZ")
_SPHERE = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_RGB = ("Red", "Green", "Blue")
_COLORLESS = "isColorInvalid"


def _together(path: Path, stations: Sequence[Loaded], system: str) -> Loaded:
    """One cloud; stations without colours are grey where others have some."""
    seen = [s for s in stations if len(s.vertices)]
    if not seen:
        raise InputFileError(path, "has no points", "export the scan again")
    count = "one station" if len(stations) == 1 else f"{len(stations)} stations in their poses"
    whole, remarks = join(seen), [f"unit: metres; {system}; {count}"]
    grey = sum(s.colors is None for s in seen)
    if 0 < grey < len(seen):
        what = f"{grey} of {len(stations)} stations"
        remarks.append(f"{what} without colours: their points are grey")
    return replace(whole, warnings=(*remarks, *whole.warnings))


def read_e57(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> Loaded:
    """Read all scans of one E57 file in their common frame; metres, +z up.

    Raises:
        InputFileError: where it is no such file, damaged, or has no points.
        ConfigurationError: where pye57 isn't installed.
    """
    pye57 = require("pye57", "artiworld[scans]")
    size_of(path, max_bytes)
    stations: list[Loaded] = []
    try:
        file = pye57.E57(str(path))
        try:
            headers = [file.get_header(k) for k in range(file.scan_count)]
            total = sum(header.point_count for header in headers)
            if total * _POINT_BYTES > max_bytes:
                raise InputFileError(path, f"has {total} points, over the limit", "thin the scan")
            stations += (_scan(pye57, file, header) for header in headers)
            root = file.root
            known = root.isDefined("coordinateMetadata") and root["coordinateMetadata"].value()
        finally:
            file.close()
    except InputFileError:
        raise
    except Exception as error:  # libE57 raises its own kinds, and KeyError for missing fields
        reason = str(error).split("\n", 1)[0]
        raise InputFileError(path, f"can't be read as E57 ({reason})", "export it again") from None
    named = " ".join(str(known or "").split())[:80]
    system = f"coordinate system {named!r}" if named else "no coordinate system stated"
    return _together(path, stations, system)


def _scan(pye57: Any, file: Any, header: Any) -> Loaded:
    fields = set(header.point_fields)
    place = _XYZ if fields.issuperset(_XYZ) else _SPHERE
    state = "cartesianInvalidState" if place is _XYZ else "sphericalInvalidState"
    colored = [f"color{c}" for c in _RGB] if all(f"color{c}" in fields for c in _RGB) else []
    read = [*place, *colored, *(f for f in (state, _COLORLESS) if f in fields)]
    data: dict[str, FloatArray] = {}
    count, libe57 = header.point_count, pye57.libe57
    buffers = libe57.VectorSourceDestBuffer()
    for name in read:  # float64 holds what any of the types may be
        data[name] = np.zeros(count)
        buffers.append(
            libe57.SourceDestBuffer(file.image_file, name, data[name], count, True, True)
        )
    header.points.reader(buffers).read()
    valid = data[state] == 0 if state in data else np.ones(header.point_count, bool)
    points = np.column_stack([data[name] for name in place])[valid]
    if place is _SPHERE:
        points = pye57.utils.convert_spherical_to_cartesian(points)
    if header.has_pose():
        points = points @ header.rotation_matrix.T + header.translation
    if not colored:
        return Loaded(points, warnings=(DARK,) * ("intensity" in fields))
    prototype = libe57.StructureNode(header.points.prototype())
    shown = [_byte(data[f"color{c}"][valid], *_limits(header.node, prototype, c)) for c in _RGB]
    colors = np.column_stack([*shown, np.full(len(points), 255, np.uint8)])
    if _COLORLESS not in data:
        return Loaded(points, colors=colors)
    wrong = data[_COLORLESS][valid] != 0
    colors[wrong] = GREY
    lost = f"the colours of {wrong.sum():,} points are marked as invalid: they are grey"
    return Loaded(points, colors=colors, warnings=(lost,) if wrong.any() else ())


def _limits(scan: Any, prototype: Any, color: str) -> tuple[float, float]:
    """Least and greatest value of a colour: the scan's ``colorLimits``, else its type's."""
    if scan.isDefined("colorLimits"):
        limits = scan["colorLimits"]
        if limits.isDefined(f"color{color}Minimum") and limits.isDefined(f"color{color}Maximum"):
            ends = (limits[f"color{color}{end}"] for end in ("Minimum", "Maximum"))
            low, high = (getattr(e, "scaledValue", e.value)() for e in ends)
            if high > low:
                return float(low), float(high)
    node = prototype[f"color{color}"]
    low = getattr(node, "scaledMinimum", node.minimum)()
    high = getattr(node, "scaledMaximum", node.maximum)()
    return (float(low), float(high)) if 0 < high - low < 1e9 else (0.0, 1.0)


def _byte(values: FloatArray, low: float, high: float) -> Bytes:
    share = np.clip((values - low) / (high - low), 0, 1)
    return np.rint(255 * np.nan_to_num(share)).astype(np.uint8)


def read_ptx(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> Loaded:
    """Read all stations of one PTX file in their common frame; metres, +z up.

    Each begins with its columns and rows, four lines of the scanner's position and axes, and four
    of a matrix that rows ``x y z 1`` are multiplied with; then a line ``x y z intensity``, with or
    without ``r g b``, for each column and row. ``0 0 0`` stands for nothing seen.

    Raises:
        InputFileError: where it is no such file, cut off, or has no points.
    """
    text = read_bytes(path, max_bytes).decode("utf-8-sig", "replace")
    lines = [line for line in text.splitlines() if line.strip()]
    stations: list[Loaded] = []
    at = 0
    while at < len(lines):
        head = numbers(path, " ".join(lines[at : at + 10]), "the head of a station")
        whole = len(head) == 30 and 0 < head[0] * head[1] <= len(lines)
        count = int(head[0] * head[1]) if whole else 0
        body = lines[at + 10 : at + 10 + count]
        values = numbers(path, " ".join(body), "points")
        width = len(body[0].split()) if body else 0
        if len(body) < count or width < 3 or len(values) != width * count:
            what = f"station {len(stations) + 1} is not whole"
            raise InputFileError(path, what, "the file is cut off or is no PTX; export it again")
        table = values.reshape(count, width)
        seen = (table[:, :3] != 0).any(1)
        lost = f"{(~seen).sum():,} directions in which nothing was seen are left out"
        matrix = head[14:].reshape(4, 4)
        points = table[seen, :3] @ matrix[:3, :3] + matrix[3, :3]
        colors = colors_from(table[seen, 4:7].astype(np.uint16)) if width >= 7 else None
        remarks = (DARK,) * (width > 3) + (lost,) * (not seen.all())
        stations.append(Loaded(points, colors=colors, warnings=remarks))
        at += 10 + count
    return _together(path, stations, "no coordinate system stated")
