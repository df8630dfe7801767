"""Points as NPZ archives and as text: XYZ, TXT, CSV, PTS and the like.

Archives hold ``points`` (or ``xyz``, ``vertices``) and, where known, colours and faces; also the
maps of reconstruction networks (DUSt3R, VGGT, Pi3): points, colours and confidences of every pixel
of several pictures, (V, H, W, 3).

trimesh 5.2 reads XYZ only, and decimal commas as separators; open3d 0.20 reads neither headings nor
commas, and returns no points without an error.
"""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.errors import InputFileError
from model.io.formats.loaded import (
    DEFAULT_MAX_BYTES,
    Loaded,
    check_indices,
    colors_from,
    numbers,
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
ARCHIVE_ERRORS = (OSError, ValueError, KeyError, EOFError, SyntaxError, TypeError, MemoryError)
ARCHIVE_ERRORS += (zipfile.BadZipFile, zlib.error, RuntimeError)


def npz_arrays(
    path: Path, wanted: Collection[str], max_bytes: int = DEFAULT_MAX_BYTES
) -> tuple[dict[str, np.ndarray], list[str]]:
    """The arrays of an NPZ file whose names in lower case are ``wanted``, and the names of all.

    Raises:
        InputFileError: where it is no such archive, or unpacks to far more than its size.
    """
    data = read_bytes(path, max_bytes)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            # No more than this is read of an entry, whatever it really holds.
            size = sum(i.file_size for i in archive.infolist())
        if size > min(max_bytes, max(_RATIO_FROM, MOST_RATIO * len(data))):
            why = f"unpacks to {size / 2**30:.2f} GiB, over the limit"
            raise InputFileError(path, why, "thin the scan first")
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            kept = [k for k in file.files if k.lower() in wanted]
            return {k.lower(): np.asarray(file[k]) for k in kept}, file.files
    except ARCHIVE_ERRORS as error:
        raise InputFileError(path, f"is not an NPZ archive of arrays ({error})") from None


def read_npz(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> Loaded:
    """Read one NPZ file. Pickled objects are never loaded.

    Raises:
        InputFileError: where it is no such archive or has no points.
    """
    held, names = npz_arrays(path, [k for keys in _KEYS.values() for k in keys], max_bytes)
    found = {role: next((held[k] for k in keys if k in held), None) for role, keys in _KEYS.items()}
    keys = ", ".join(names)
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


Array = npt.NDArray[Any]
_COMMA_NUMBER = re.compile(r"[-+]?\d+(,\d+)?([eE][-+]?\d+)?")
_LONGEST_LINE = 100_000
_SEPARATORS = str.maketrans({",": " ", ";": " ", "\t": " ", "|": " "})
_NAMES = {
    "x": ("x", "px", "//x", "x [m]"),
    "y": ("y", "py", "y [m]"),
    "z": ("z", "pz", "z [m]"),
    "r": ("r", "red"),
    "g": ("g", "green"),
    "b": ("b", "blue"),
    "nx": ("nx", "normal_x", "normalx"),
    "ny": ("ny", "normal_y", "normaly"),
    "nz": ("nz", "normal_z", "normalz"),
}


def read_text(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> Loaded:
    """Read points from columns of numbers.

    A heading line names the columns (``x,y,z,red,green,blue,nx,ny,nz``) where there is one. Else
    three are xyz; six are xyz and RGB or normals, which their values tell apart; nine are both;
    what follows is passed over. A PTS file has an intensity after xyz, which is passed over too.

    Raises:
        InputFileError: where a line is no row of numbers.
    """
    data = read_bytes(path, max_bytes)
    if b"\0" in data[:4096]:
        raise InputFileError(path, "is not text", "a text cloud has a row x y z for each point")
    text = data.decode("utf-8-sig", "replace")
    if "\r" in text and "\n" not in text:
        text = text.replace("\r", "\n")
    _check_lines(path, text)
    if _decimal_commas(text):
        text = text.replace(",", ".")
    text = text.translate(_SEPARATORS)
    head, text = _heading(text)
    values, width = _rows(path, text)
    table = values.reshape(-1, width)
    if head is not None and len(head) == width:
        columns = _named(head)
        if columns is not None:
            return _pick(table, *columns)
    if width < 3:
        why = f"has {width} columns"
        raise InputFileError(path, why, "a text cloud has a row x y z for each point")
    return _guess(table, path.suffix.lower() == ".pts")


def _check_lines(path: Path, text: str) -> None:
    """Refuse lines that hold no row: splitting one of 200 MB takes minutes and gigabytes."""
    at = 0
    while at + _LONGEST_LINE < len(text):
        end = text.rfind("\n", at, at + _LONGEST_LINE)
        if end < 0:
            raise InputFileError(
                path,
                f"has a line of more than {_LONGEST_LINE:,} characters",
                "each row needs a line of its own, as in x y z or x y z r g b",
            )
        at = end + 1


def _decimal_commas(text: str) -> bool:
    """True if numbers are written as in 0,55: each word of the first rows is one number."""
    rows = [
        w
        for line in text.split("\n", 50)[:50]
        if len(w := re.split(r"[\s;|]+", line.strip(" ;"))) > 1
    ]
    words = [w for row in rows for w in row if any(c.isdigit() for c in w)]
    numbers_ = [w for w in words if _COMMA_NUMBER.fullmatch(w)]
    return len(numbers_) > 2 and len(numbers_) == len(words) and any("," in w for w in words)


def _heading(text: str) -> tuple[list[str] | None, str]:
    """Names of the columns and the remaining text; comments and a leading count are skipped."""
    head, at = None, 0
    while (end := text.find("\n", at)) >= 0:
        line = text[at:end]
        words = line.split()
        is_comment = not words or words[0].startswith(("#", "//"))
        if not is_comment and _all_numbers(words):
            after = text.find("\n", end + 1)
            second = text[end + 1 : len(text) if after < 0 else after].split()
            return head, text[end + 1 if len(words) == 1 and len(second) >= 3 else at :]
        if not is_comment and head is not None:
            break
        names = [w.strip('"').lower() for w in line.lstrip("#/ ").split()]
        if names and (not is_comment or "x" in names):
            head = names
        at = end + 1
    return head, text[at:]


def _all_numbers(words: list[str]) -> bool:
    try:
        for w in words:
            float(w)
    except ValueError:
        return False
    return True


def _rows(path: Path, text: str) -> tuple[Array, int]:
    """All numbers, and how many are in a row."""
    first = next((line for line in text.split("\n", 50) if line.strip()), "")
    width = len(first.split())
    rows = text.count("\n") + (0 if text.endswith("\n") else 1)
    if width:
        try:
            values = numbers(path, text, "points")
            if len(values) == rows * width:
                return values, width
        except InputFileError:
            pass
    kept = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split("#")[0].split()
        if not words:
            continue
        if len(words) != width or not _all_numbers(words):
            raise InputFileError(
                path,
                f"data line {number} is {line.strip()[:60]!r}",
                f"each row needs {max(width, 3)} numbers, as in x y z or x y z r g b",
            )
        kept.append(" ".join(words))
    if not kept:
        raise InputFileError(path, "has no row of numbers", "each row needs x y z")
    return numbers(path, "\n".join(kept), "points"), width


def _named(head: list[str]) -> tuple[list[int], list[int] | None, list[int] | None] | None:
    at = {key: head.index(n) for key, names in _NAMES.items() for n in names if n in head}
    groups = [
        [at[k] for k in keys if k in at] for keys in (("x", "y", "z"), "rgb", ("nx", "ny", "nz"))
    ]
    xyz, rgb, normals = (g if len(g) == 3 else None for g in groups)
    return None if xyz is None else (xyz, rgb, normals)


def _guess(table: Array, intensity: bool) -> Loaded:
    width = table.shape[1]
    starts = {6: (3,), 7: (3,), 8: (3,), 9: (3, 6), 10: (3, 6, 7)}.get(
        width, (3,) if width > 10 else ()
    )
    if intensity and width >= 7:
        starts = (4, 7) if width >= 10 else (4,)
    colors = normals = None
    for s in starts:
        block = table[:, s : s + 3]
        if normals is None and _unit(block):
            normals = [s, s + 1, s + 2]
        elif colors is None and _color(block):
            colors = [s, s + 1, s + 2]
    return _pick(table, [0, 1, 2], colors, normals)


def _unit(block: Array) -> bool:
    sample = block[:: max(1, len(block) // 1000)]
    length = np.linalg.norm(sample, axis=1)
    return bool(len(length) and np.mean(np.abs(length - 1.0) < 0.02) > 0.9)


def _color(block: Array) -> bool:
    if not len(block) or not np.isfinite(block).all():
        return False
    low, high = block.min(), block.max()
    whole = (block == np.rint(block)).all()
    return bool(low >= 0 and (high <= 1 or (high <= 255 and whole)))


def _pick(table: Array, xyz: list[int], rgb: list[int] | None, normals: list[int] | None) -> Loaded:
    colors = None
    if rgb is not None:
        block = table[:, rgb]
        whole = len(block) and (block == np.rint(block)).all() and block.max() > 1
        colors = colors_from(block.clip(0, 255).astype(np.uint8) if whole else block)
    return Loaded(
        table[:, xyz], normals=None if normals is None else table[:, normals], colors=colors
    )
