"""Wavefront OBJ with MTL and textures."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.errors import InputFileError
from model.core.geometry import Material
from model.core.names import named_parts
from model.io.formats.loaded import (
    DEFAULT_MAX_BYTES,
    Loaded,
    check_indices,
    colors_from,
    numbers,
    read_bytes,
    triangulate,
)
from model.io.formats.mtl import MaterialFiles
from model.io.robot_xml import counted

Array = npt.NDArray[Any]

_PASSED_OVER = {"l": "lines", "p": "points"} | dict.fromkeys(("curv", "surf"), "curved shapes")
_COMMENT = re.compile(r"(?m)(?:^|(?<=\s))#.*$")


@dataclass
class _Lines:
    """The lines of an OBJ by kind, with the group and material in force."""

    v: list[str] = field(default_factory=list)
    vt: list[str] = field(default_factory=list)
    f: list[str] = field(default_factory=list)
    # For each f line: how many v and vt came before, and the material's number.
    v_before: list[int] = field(default_factory=list)
    vt_before: list[int] = field(default_factory=list)
    material: list[int] = field(default_factory=list)
    libraries: dict[str, None] = field(default_factory=dict)  # in their order
    lost: Counter[str] = field(default_factory=Counter)
    names: list[str] = field(default_factory=lambda: [""])
    # Of each object (o) and group (g): its first f line, and its name.
    begins: dict[str, list[tuple[int, str]]] = field(
        default_factory=lambda: {"o": [(0, "")], "g": [(0, "")]}
    )


def read_obj(
    path: Path,
    max_bytes: int = DEFAULT_MAX_BYTES,
    *,
    root: Path | None = None,
    files: MaterialFiles | None = None,
) -> Loaded:
    """Read one OBJ file; a missing MTL or texture becomes a warning.

    Args:
        path: the file.
        max_bytes: refuse larger ones.
        root: folder that its references may not leave; by default the file's own.
        files: cache of material files and textures to share between several OBJ files.

    Raises:
        InputFileError: where it is no OBJ or inconsistent.
    """
    lines = _sort_lines(read_bytes(path, max_bytes))
    if not lines.v:
        raise InputFileError(path, "no vertices in it", "an OBJ file has lines 'v x y z'")
    files = files or MaterialFiles(root or path.parent)
    vertices, colors = _vertices(path, lines.v)
    if not lines.f:
        return Loaded(vertices, colors=colors)
    corner_v, corner_t, sizes = _faces(path, lines, len(vertices))
    triangles, polygon = triangulate(path, corner_v, sizes, vertices)
    used_material = np.asarray(lines.material, np.int64)[polygon]
    warnings = counted(lines.lost)
    materials, face_material = _materials(path, lines, used_material, files, warnings)
    flat = triangles.reshape(-1)
    uv_index = corner_t[flat]
    textured = any(m.pictured for m in materials)
    if textured and lines.vt and (uv_index >= 0).any():
        uv = _uv(path, lines.vt)
        check_indices(
            path,
            np.maximum(corner_t, 0),
            len(uv),
            sizes=sizes,
            written=corner_t + 1,
            what="texture coordinate",
        )
        moves = files.uv_transforms(materials)
        own = np.repeat(face_material, 3) if moves is not None else np.zeros(len(flat), np.int64)
        key = (corner_v[flat] * (len(uv) + 1) + uv_index + 1) * len(materials) + own
        unique, inverse = np.unique(key, return_inverse=True)
        unique, own = np.divmod(unique, len(materials))
        which, t = unique // (len(uv) + 1), unique % (len(uv) + 1) - 1
        vertices, colors = vertices[which], None if colors is None else colors[which]
        uv = np.where((t >= 0)[:, None], uv[t], 0.0)
        if moves is not None:
            uv = uv * moves[own, :2] + moves[own, 2:]
        faces = inverse.reshape(-1, 3)
    else:
        uv, faces = None, corner_v[flat].reshape(-1, 3)
    return Loaded(
        vertices,
        faces,
        None,
        colors,
        uv,
        face_material,
        materials,
        tuple(dict.fromkeys(warnings)),
        pieces=_pieces(lines, polygon),
        names_join=True,
        polygon=polygon,
        polygons=len(lines.f),
    )


def _sort_lines(data: bytes) -> _Lines:
    text = _COMMENT.sub("", data.decode("utf-8-sig", "replace")).replace("\t", " ")
    if "\\\n" in text or "\\\r\n" in text:
        text = text.replace("\\\r\n", " ").replace("\\\n", " ")
    out = _Lines()
    v, vt, f, material = out.v, out.vt, out.f, 0
    numbers_of = {"": 0}
    for raw in text.splitlines():
        head, _, rest = raw.lstrip().partition(" ")
        if head == "v":
            v.append(rest)
        elif head == "f":
            f.append(rest)
            out.v_before.append(len(v))
            out.vt_before.append(len(vt))
            out.material.append(material)
        elif head == "vt":
            vt.append(rest)
        elif head == "usemtl":
            name = rest.strip()
            material = numbers_of.setdefault(name, len(numbers_of))
            if material == len(out.names):
                out.names.append(name)
        elif head == "mtllib":
            out.libraries[rest.strip()] = None
        elif head in out.begins:
            out.begins[head].append((len(f), rest.strip()))
        elif head in _PASSED_OVER:
            out.lost[_PASSED_OVER[head]] += 1
    return out


def _pieces(lines: _Lines, polygon: Array) -> tuple[tuple[str, int], ...]:
    """Objects, or groups where these alone are called after parts, with their numbers of triangles;
    a name may come again."""
    found = []
    for begins in lines.begins.values():
        ends = np.searchsorted(polygon, [at for at, _ in begins] + [len(lines.f)])
        runs = zip((name for _, name in begins), np.diff(ends).tolist(), strict=True)
        found.append(tuple((name, count) for name, count in runs if count))
    several = [runs for runs in found if len({name for name, _ in runs}) > 1]
    named = [runs for runs in several if named_parts(list(dict(runs)))]
    return next(iter(named or several), ())


def _table(path: Path, lines: list[str], what: str) -> list[Array] | Array:
    """(N, C) numbers of lines that are equally long, else one array a line."""
    values = numbers(path, "\n".join(lines), what)
    width = len(lines[0].split())
    if width and len(values) == width * len(lines):
        return values.reshape(len(lines), width)
    return [numbers(path, line.split("#")[0], what) for line in lines]


def _vertices(path: Path, lines: list[str]) -> tuple[Array, Array | None]:
    table = _table(path, lines, "vertex")
    if isinstance(table, list):
        short = next((i for i, row in enumerate(table) if len(row) < 3), None)
        if short is not None:
            raise _short(path, "v", short, lines[short], "three numbers")
        return np.array([row[:3] for row in table]), None
    if table.shape[1] < 3:
        raise _short(path, "v", 0, lines[0], "three numbers")
    colors, width = None, table.shape[1]
    if width in (6, 7, 8):  # x y z, a weight or none, r g b, alpha or none
        weighted = width == 8 or (width == 7 and _is_weight(table))
        colors = colors_from(np.ascontiguousarray(table[:, 3 + weighted :]))
    return np.ascontiguousarray(table[:, :3]), colors


def _is_weight(table: Array) -> bool:
    """True if the fourth of seven numbers is a weight of 1, and the last no opaque alpha."""
    return bool((table[:, 3] == 1).all() and not np.isin(table[:, 6], (1, 255)).all())


def _uv(path: Path, lines: list[str]) -> Array:
    table = _table(path, lines, "texture coordinate")
    if isinstance(table, list):
        table = np.array([[*row[:2], 0.0, 0.0][:2] for row in table])
    if table.shape[1] < 2:
        table = np.column_stack([table, np.zeros(len(table))])
    return np.nan_to_num(table[:, :2], posinf=0.0, neginf=0.0)


def _short(path: Path, kind: str, number: int, line: str, need: str) -> InputFileError:
    return InputFileError(
        path, f"line {kind!r} number {number + 1} is {line[:60]!r}", f"it needs {need}"
    )


def _faces(path: Path, lines: _Lines, vertex_count: int) -> tuple[Array, Array, Array]:
    """Corners' vertices and texture coordinates (-1: none), from 0, and corners a face."""
    text = [line.split("#")[0] if "#" in line else line for line in lines.f]
    sizes = np.array([len(line.split()) for line in text], np.int64)
    if (sizes < 1).any():
        raise _short(path, "f", int((sizes < 1).argmax()), "", "three corners or more")
    joined = "\n".join(text)
    total = int(sizes.sum())
    filled = joined.replace("//", "/0/")
    slashes, rest = divmod(filled.count("/"), total)
    if rest == 0 and slashes <= 2:
        values = numbers(path, filled.replace("/", " "), "face")
        if len(values) == total * (slashes + 1):
            table = values.reshape(total, slashes + 1)
            return _absolute(path, lines, sizes, table, vertex_count)
    rows = []
    for number, line in enumerate(text):
        for word in line.split():
            bits = [b or "0" for b in word.split("/")]
            try:
                rows.append([int(b) for b in [*bits, "0"][:2]])
            except ValueError:
                raise _short(path, "f", number, line, "corners such as 1 or 1/1/1") from None
    try:
        table = np.array(rows, np.float64).reshape(total, 2)
    except OverflowError:
        raise InputFileError(path, "a face has an absurd index", "the file is damaged") from None
    return _absolute(path, lines, sizes, table, vertex_count)


def _absolute(
    path: Path, lines: _Lines, sizes: Array, table: Array, vertex_count: int
) -> tuple[Array, Array, Array]:
    """Indices from 0; negative ones count back from where the face stands."""
    if not np.isfinite(table).all() or (table != np.rint(table)).any():
        raise InputFileError(path, "a face has an index that is no whole number")
    index = np.clip(table, -(2**53), 2**53).astype(np.int64)
    v = index[:, 0]
    if (v < 0).any():
        v = np.where(v < 0, v + np.repeat(lines.v_before, sizes) + 1, v)
    v = v - 1
    check_indices(path, v, vertex_count, sizes=sizes, written=table[:, 0])
    t = index[:, 1] if index.shape[1] > 1 else np.zeros(len(index), np.int64)
    if (t < 0).any():
        t = np.where(t < 0, np.maximum(t + np.repeat(lines.vt_before, sizes) + 1, 0), t)
    return v, t - 1, sizes


def _materials(
    path: Path, lines: _Lines, used: Array, files: MaterialFiles, warnings: list[str]
) -> tuple[tuple[Material, ...], Array]:
    """The materials that faces use, and each face's."""
    known: dict[str, Material] = {}
    for library in lines.libraries:
        for each in files.mtl_names(library, path.parent):
            for name, material in files.read(each, path, warnings).items():
                known.setdefault(name, material)
    kept, face_material = np.unique(used, return_inverse=True)
    out = []
    for k in kept:
        name = lines.names[k]
        if name and name not in known and known:
            warnings.append(f"material {name!r} is in no MTL file")
        out.append(known.get(name) or files.plain(name))
    return tuple(out), face_material.reshape(-1).astype(np.int32)
