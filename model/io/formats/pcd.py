"""PCD (Point Cloud Library): ascii, binary and binary_compressed.

trimesh 5.2 has no reader. open3d 0.20 returns no points and no error for a file that is cut off,
and drops colours in columns r, g and b.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.errors import InputFileError
from model.io.formats.loaded import (
    DARK,
    DEFAULT_MAX_BYTES,
    GREY,
    Loaded,
    colors_from,
    numbers,
    read_bytes,
)

Array = npt.NDArray[Any]
_KINDS = {"F": "f", "I": "i", "U": "u"}
_MAX_RATIO = 128  # LZF can't compress further: 264 bytes in 3


@dataclass(frozen=True)
class _Header:
    names: tuple[str, ...]
    dtypes: tuple[str, ...]
    counts: tuple[int, ...]
    points: int
    data: str
    start: int

    @property
    def row(self) -> int:
        return sum(np.dtype(t).itemsize * c for t, c in zip(self.dtypes, self.counts, strict=True))


def read_pcd(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> Loaded:
    """Read one PCD file.

    Raises:
        InputFileError: where it is no PCD, cut off or inconsistent.
    """
    data = read_bytes(path, max_bytes)
    header = _header(path, data)
    columns = {
        "ascii": _ascii,
        "binary": _binary,
        "binary_compressed": _compressed,
    }[header.data](path, header, data[header.start :])
    if not {"x", "y", "z"} <= set(columns):
        raise InputFileError(path, "has no fields x, y and z", f"there are {', '.join(columns)}")
    points = np.stack([columns[n] for n in "xyz"], axis=1)
    normals = None
    if {"normal_x", "normal_y", "normal_z"} <= set(columns):
        normals = np.stack([columns[f"normal_{n}"] for n in "xyz"], axis=1)
    lost = _lost_colors(columns) if header.data == "ascii" else 0
    remarks = (f"{lost:,} of {len(points):,} colours are 'nan' and were taken as grey",)
    colors, remarks = _colors(columns), remarks[: lost > 0]
    remarks += (DARK,) * (colors is None and "intensity" in columns)
    return Loaded(points, normals=normals, colors=colors, warnings=remarks)


def _header(path: Path, data: bytes) -> _Header:
    fields: dict[str, list[str]] = {}
    at = 0
    while "DATA" not in fields:
        end = data.find(b"\n", at, at + 65536)
        if end < 0 or at > 1 << 20:
            raise InputFileError(path, "the PCD header doesn't end", "a PCD file has a DATA line")
        words = data[at:end].decode("latin-1").split("#")[0].split()
        at = end + 1
        if words:
            fields[words[0].upper()] = words[1:]
    try:
        names = fields.get("FIELDS") or fields["COLUMNS"]
        sizes = [int(v) for v in fields["SIZE"]]
        kinds = [_KINDS[v.upper()] for v in fields["TYPE"]]
        counts = [int(v) for v in fields.get("COUNT", ["1"] * len(names))]
        width, height = int(fields["WIDTH"][0]), int(fields.get("HEIGHT", ["1"])[0])
        points = int(fields["POINTS"][0]) if "POINTS" in fields else width * height
        style = fields["DATA"][0].lower()
        dtypes = tuple(f"<{k}{s}" for k, s in zip(kinds, sizes, strict=True))
        for d in dtypes:
            np.dtype(d)
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise InputFileError(
            path, f"the PCD header can't be understood ({error})", "save it as PCD 0.7"
        ) from None
    if not len(names) == len(dtypes) == len(counts):
        raise InputFileError(path, "FIELDS, SIZE, TYPE and COUNT differ in length")
    if style not in ("ascii", "binary", "binary_compressed"):
        raise InputFileError(path, f"DATA {style!r} is unknown", "ascii, binary, binary_compressed")
    out = _Header(tuple(names), dtypes, tuple(counts), points, style, at)
    room = (len(data) - at) * (_MAX_RATIO if style == "binary_compressed" else 1)
    least = 2 * len(names) - 1 if style == "ascii" else out.row
    if points < 0 or min(counts) < 0 or points * least > room or out.row == 0:
        raise _cut_off(path, out, len(data) - at)
    return out


def _cut_off(path: Path, header: _Header, size: int) -> InputFileError:
    return InputFileError(
        path,
        f"the header promises {header.points} points, but only {size} bytes follow",
        "the file is cut off or damaged",
    )


def _ascii(path: Path, header: _Header, body: bytes) -> dict[str, Array]:
    values = numbers(path, body.decode("latin-1"), "PCD")
    width = sum(header.counts)
    if len(values) < header.points * width:
        raise _cut_off(path, header, len(body))
    rows = values[: header.points * width].reshape(header.points, width)
    out, at = {}, 0
    for name, dtype, count in zip(header.names, header.dtypes, header.counts, strict=True):
        if count:
            column = rows[:, at]
            # Packed colours are written as the float that has their bits, or as an integer.
            if name in ("rgb", "rgba") and dtype[1] != "f":
                column = np.clip(np.nan_to_num(column), 0, 2**32 - 1).astype(np.uint32)
            elif name in ("rgb", "rgba"):
                with np.errstate(over="ignore"):
                    column = column.astype(np.float32)
            out[name] = column
        at += count
    return out


def _binary(path: Path, header: _Header, body: bytes) -> dict[str, Array]:
    dtype = np.dtype(
        [
            (f"{i}", t, (c,))
            for i, (t, c) in enumerate(zip(header.dtypes, header.counts, strict=True))
        ]
    )
    if header.points * dtype.itemsize > len(body):
        raise _cut_off(path, header, len(body))
    rows = np.frombuffer(body, dtype, header.points)
    return {
        name: rows[f"{i}"][:, 0]
        for i, (name, count) in enumerate(zip(header.names, header.counts, strict=True))
        if count
    }


def _compressed(path: Path, header: _Header, body: bytes) -> dict[str, Array]:
    """Column after column, LZF-compressed as one block."""
    if len(body) < 8:
        raise _cut_off(path, header, len(body))
    packed, size = (int(v) for v in np.frombuffer(body, "<u4", 2))
    if packed > len(body) - 8 or size != header.points * header.row:
        raise _cut_off(path, header, len(body))
    raw = lzf_decompress(body[8 : 8 + packed], size)
    if raw is None:
        raise InputFileError(path, "the compressed points are damaged", "save the file again")
    out, at = {}, 0
    for name, dtype, count in zip(header.names, header.dtypes, header.counts, strict=True):
        column = np.frombuffer(raw, dtype, header.points * count, at)
        if count:
            out[name] = column.reshape(header.points, count)[:, 0]
        at += column.nbytes
    return out


def lzf_decompress(data: bytes, size: int) -> bytes | None:
    """The ``size`` bytes that LZF (Marc Lehmann's format) packed into ``data``; None if damaged."""
    out = bytearray()
    at, end = 0, len(data)
    while at < end and len(out) <= size:
        control = data[at]
        at += 1
        if control < 32:
            out += data[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if length == 7:
            if at >= end:
                return None
            length += data[at]
            at += 1
        if at >= end:
            return None
        offset = ((control & 31) << 8) + data[at] + 1
        at += 1
        begin = len(out) - offset
        if begin < 0:
            return None
        length += 2
        if offset >= length:
            out += out[begin : begin + length]
        else:  # the run repeats itself
            out += (out[begin:] * (length // offset + 1))[:length]
    return bytes(out) if len(out) == size and at <= end else None


def _lost_colors(columns: dict[str, Array]) -> int:
    """Make packed colours grey that a text has as "nan": as a float the bits say no number."""
    packed = columns.get("rgb", columns.get("rgba"))
    if packed is None or packed.dtype.kind != "f":
        return 0
    lost = np.isnan(packed)
    packed.view(np.uint32)[lost] = int.from_bytes(bytes(GREY[:3]), "big")
    return int(lost.sum())


def _colors(columns: dict[str, Array]) -> Array | None:
    packed = columns.get("rgb", columns.get("rgba"))
    if packed is not None and packed.dtype.itemsize == 4:
        bits = np.ascontiguousarray(packed).view(np.uint32)
        return colors_from(
            np.stack([(bits >> s) & 255 for s in (16, 8, 0)], axis=1).astype(np.uint8)
        )
    for names in (("r", "g", "b"), ("red", "green", "blue")):
        if set(names) <= set(columns):
            return colors_from(np.stack([columns[n] for n in names], axis=1))
    return None
