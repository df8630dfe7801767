"""PLY: ASCII and binary, clouds and meshes, any order of properties."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.errors import InputFileError
from model.geometry.formats.loaded import (
    DEFAULT_MAX_BYTES,
    WHITE,
    Loaded,
    check_indices,
    colors_from,
    numbers,
    read_bytes,
)
from model.geometry.formats.references import ReferenceRefused, resolve
from model.geometry.formats.textures import TextureError, open_texture
from model.geometry.formats.triangulate import triangulate
from model.geometry.mesh import Material

Array = npt.NDArray[Any]

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_MAX_HEADER = 1 << 16
_COLORS = (
    ("red", "green", "blue"),
    ("r", "g", "b"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
)
_UVS = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
# Gaussian splats store colour as the first spherical-harmonics coefficient (Kerbl et al. 2023).
_SPLAT = ("f_dc_0", "f_dc_1", "f_dc_2")
_SPLAT_SCALE = 0.28209479177387814


@dataclass(frozen=True)
class _Property:
    name: str
    type: str
    count_type: str | None = None  # of a list


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)

    @property
    def smallest(self) -> int:
        """Fewest bytes (binary) that one row can take."""
        return sum(np.dtype(p.count_type or p.type).itemsize for p in self.properties)


@dataclass(frozen=True)
class _Ragged:
    """A list property: rows after each other."""

    values: Array
    sizes: Array


_Table = dict[str, "Array | _Ragged"]


def read_ply(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> Loaded:
    """Read one PLY file.

    Raises:
        InputFileError: where it is no PLY, truncated, or inconsistent.
    """
    data = read_bytes(path, max_bytes)
    style, elements, comments, start = _header(path, data)
    if style == "ascii":
        tables = _ascii(path, data[start:], elements)
    else:
        tables = _binary(path, memoryview(data)[start:], elements, ">" if "big" in style else "<")
    if "vertex" not in tables:
        raise InputFileError(path, "no vertices in it", "a mesh or a point cloud has vertices")
    return _assemble(path, tables, comments)


def _header(path: Path, data: bytes) -> tuple[str, list[_Element], list[str], int]:
    if not data.startswith(b"ply"):
        raise InputFileError(path, "is not a PLY file", "a PLY file begins with 'ply'")
    at = data.find(b"end_header", 0, _MAX_HEADER)
    end = data.find(b"\n", at) if at >= 0 else -1
    if at >= 0 and end < 0 and data.find(b"\r", at) >= 0:
        end = data.find(b"\r", at)
    if end < 0:
        raise InputFileError(path, "the PLY header doesn't end", "the file is cut off or damaged")
    style, elements, comments = "", [], []
    for line in data[:at].decode("latin-1").replace("\r", "\n").split("\n")[1:]:
        words = line.split()
        if not words:
            continue
        try:
            if words[0] == "format":
                style = words[1]
            elif words[0] == "comment":
                comments.append(line.strip()[8:])
            elif words[0] == "element":
                elements.append(_Element(words[1], int(words[2])))
            elif words[0] == "property" and words[1] == "list":
                prop = _Property(words[4], _TYPES[words[3]], _TYPES[words[2]])
                elements[-1].properties.append(prop)
            elif words[0] == "property":
                elements[-1].properties.append(_Property(words[2], _TYPES[words[1]]))
        except (IndexError, KeyError, ValueError):
            raise InputFileError(
                path, f"PLY header line {line.strip()[:60]!r} can't be understood"
            ) from None
    if style not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise InputFileError(path, f"PLY format {style!r} is unknown", "use ascii or binary")
    for e in elements:
        _check_element(path, e, len(data) - end - 1, style)
    return style, elements, comments, end + 1


def _check_element(path: Path, element: _Element, size: int, style: str) -> None:
    """Refuse counts that the file can't hold before anything is allocated for them."""
    smallest = 2 * len(element.properties) - 1 if style == "ascii" else element.smallest
    names = [p.name for p in element.properties]
    if len(set(names)) < len(names):
        raise InputFileError(path, f"PLY element {element.name!r} has a property twice")
    if (
        element.count < 0
        or element.count * max(smallest, 0) > size
        or (element.count and not element.properties)
    ):
        raise InputFileError(
            path,
            f"the header promises {element.count} rows of {element.name!r}, "
            f"but only {size} bytes follow",
            "the file is cut off or damaged",
        )


def _cut_off(path: Path, element: _Element) -> InputFileError:
    return InputFileError(
        path,
        f"ends inside its {element.count} rows of {element.name!r}",
        "the file is cut off; download or export it again",
    )


# Binary


def _binary(
    path: Path, body: memoryview, elements: list[_Element], order: str
) -> dict[str, _Table]:
    tables, at = {}, 0
    for e in elements:
        lists = [p for p in e.properties if p.count_type]
        table: _Table
        if not lists:
            dtype = np.dtype([(p.name, order + p.type) for p in e.properties])
            if at + e.count * dtype.itemsize > len(body):
                raise _cut_off(path, e)
            rows = np.frombuffer(body, dtype, e.count, at)
            table = {p.name: rows[p.name] for p in e.properties}
            at += e.count * dtype.itemsize
        else:
            table, at = _binary_lists(path, body, e, order, at)
        tables.setdefault(e.name, table)
    return tables


def _binary_lists(
    path: Path, body: memoryview, e: _Element, order: str, at: int
) -> tuple[_Table, int]:
    """Rows with lists. Nearly always all lists are as long as in the first row."""
    if e.count == 0:
        empty = np.zeros(0, np.int64)
        return {p.name: _Ragged(empty, empty) if p.count_type else empty for p in e.properties}, at
    sizes = _first_sizes(path, body, e, order, at)
    fields: list[tuple[Any, ...]] = []
    for i, p in enumerate(e.properties):
        if p.count_type:
            fields.append((f"#{i}", order + p.count_type))
            fields.append((f"@{i}", order + p.type, (sizes[i],)))
        else:
            fields.append((f"@{i}", order + p.type))
    dtype = np.dtype(fields)
    if at + e.count * dtype.itemsize <= len(body):
        rows = np.frombuffer(body, dtype, e.count, at)
        if all((rows[f"#{i}"] == n).all() for i, n in sizes.items()):
            table: _Table = {}
            for i, p in enumerate(e.properties):
                column = rows[f"@{i}"]
                table[p.name] = (
                    _Ragged(column.reshape(-1), np.full(e.count, sizes[i], np.int64))
                    if p.count_type
                    else column
                )
            return table, at + e.count * dtype.itemsize
    return _binary_ragged(path, body, e, order, at)


def _first_sizes(path: Path, body: memoryview, e: _Element, order: str, at: int) -> dict[int, int]:
    sizes = {}
    for i, p in enumerate(e.properties):
        width = np.dtype(p.type).itemsize
        if p.count_type:
            count = np.dtype(order + p.count_type)
            if at + count.itemsize > len(body):
                raise _cut_off(path, e)
            sizes[i] = int(np.frombuffer(body, count, 1, at)[0])
            at += count.itemsize
            width *= sizes[i]
        at += width
        if width < 0 or at > len(body):
            raise _cut_off(path, e)
    return sizes


def _binary_ragged(
    path: Path, body: memoryview, e: _Element, order: str, at: int
) -> tuple[_Table, int]:
    """Row by row to find where each property begins, then gathered at once."""
    begins = np.zeros((len(e.properties), e.count), np.int64)
    sizes = np.ones((len(e.properties), e.count), np.int64)
    plan = []
    for p in e.properties:
        count = np.dtype(p.count_type or "u1")
        plan.append((p.count_type is not None, count.itemsize, count.kind == "i",
                     np.dtype(p.type).itemsize))  # fmt: skip
    byteorder, end = ("big" if order == ">" else "little"), len(body)
    if any(p.count_type in ("f4", "f8") for p in e.properties):
        raise InputFileError(path, f"the lists of {e.name!r} are counted in floats")
    for row in range(e.count):
        for i, (is_list, head, signed, width) in enumerate(plan):
            n = 1
            if is_list:
                n = int.from_bytes(body[at : at + head], byteorder, signed=signed)
                at += head
            begins[i, row], sizes[i, row] = at, n
            at += n * width
            if n < 0 or at > end:
                raise _cut_off(path, e)
    table: _Table = {}
    raw = np.frombuffer(body, np.uint8)
    for i, p in enumerate(e.properties):
        dtype = np.dtype(order + p.type)
        total = int(sizes[i].sum())
        inside = np.arange(total) - np.repeat(np.cumsum(sizes[i]) - sizes[i], sizes[i])
        starts = np.repeat(begins[i], sizes[i]) + inside * dtype.itemsize
        picked = raw[starts[:, None] + np.arange(dtype.itemsize)]
        values = np.ascontiguousarray(picked).view(dtype).reshape(-1)
        table[p.name] = _Ragged(values, sizes[i]) if p.count_type else values
    return table, at


# ASCII


def _ascii(path: Path, body: bytes, elements: list[_Element]) -> dict[str, _Table]:
    values = numbers(path, body.decode("latin-1"), "PLY")
    tables, at = {}, 0
    for e in elements:
        width = len(e.properties)
        table: _Table
        if not any(p.count_type for p in e.properties):
            if at + e.count * width > len(values):
                raise _cut_off(path, e)
            rows = values[at : at + e.count * width].reshape(e.count, width)
            table = {p.name: _typed(rows[:, i], p) for i, p in enumerate(e.properties)}
            at += e.count * width
        else:
            table, at = _ascii_lists(path, values, e, at)
        tables.setdefault(e.name, table)
    return tables


def _typed(column: Array, p: _Property) -> Array:
    """ASCII numbers keep double precision; colours need their integer type to be told apart."""
    if p.type in ("f4", "f8"):
        return column
    info = np.iinfo(p.type)
    return np.clip(np.nan_to_num(column), info.min, info.max).astype(p.type)


def _ascii_lists(path: Path, values: Array, e: _Element, at: int) -> tuple[_Table, int]:
    begins = np.zeros((len(e.properties), e.count), np.int64)
    sizes = np.ones((len(e.properties), e.count), np.int64)
    if e.properties and e.count and len(e.properties) == 1 and at < len(values):
        # One list a row, all of one length, is by far the most common.
        n = values[at]
        if 0 <= n <= 4096 and n == int(n) and at + e.count * (int(n) + 1) <= len(values):
            rows = values[at : at + e.count * (int(n) + 1)].reshape(e.count, -1)
            if (rows[:, 0] == n).all():
                name, lengths = e.properties[0].name, np.full(e.count, int(n))
                return {name: _Ragged(rows[:, 1:].reshape(-1), lengths)}, at + rows.size
    end = len(values)
    is_list = [p.count_type is not None for p in e.properties]
    for row in range(e.count):
        for i, listed in enumerate(is_list):
            n = 1
            if listed:
                if at >= end or not 0 <= values[at] <= end:
                    raise _cut_off(path, e)
                n = int(values[at])
                at += 1
            begins[i, row], sizes[i, row] = at, n
            at += n
            if at > end:
                raise _cut_off(path, e)
    table: _Table = {}
    for i, p in enumerate(e.properties):
        total = int(sizes[i].sum())
        inside = np.arange(total) - np.repeat(np.cumsum(sizes[i]) - sizes[i], sizes[i])
        column = values[np.repeat(begins[i], sizes[i]) + inside]
        table[p.name] = _Ragged(column, sizes[i]) if p.count_type else _typed(column, p)
    return table, at


# Meaning


def _assemble(path: Path, tables: dict[str, _Table], comments: list[str]) -> Loaded:
    vertex = tables["vertex"]
    xyz = _columns(vertex, (("x", "y", "z"),))
    if xyz is None:
        raise InputFileError(
            path, "the vertices have no x, y and z", "a PLY vertex needs all three"
        )
    with np.errstate(over="ignore"):
        points = xyz.astype(np.float64 if xyz.dtype == np.float64 else np.float32)
    normals = _columns(vertex, (("nx", "ny", "nz"),))
    colors = _colors(vertex)
    uv = _columns(vertex, _UVS)
    warnings: list[str] = []
    faces, polygon, corner = _faces(path, tables.get("face", {}), points)
    if not len(faces):
        return Loaded(points, normals=normals, colors=colors)
    face = tables["face"]
    face_colors = _colors(face)
    wedge = face.get("texcoord")
    if wedge is not None and isinstance(wedge, _Ragged):
        sizes = _face_lists(face).sizes
        if (wedge.sizes == 2 * sizes).all():
            points, faces = points[faces.reshape(-1)], np.arange(faces.size).reshape(-1, 3)
            colors = (
                None if colors is None else colors[_face_lists(face).values[corner.reshape(-1)]]
            )
            uv = wedge.values.reshape(-1, 2)[corner.reshape(-1)]
    if colors is None and face_colors is not None and uv is None:
        colors = np.repeat(face_colors[polygon], 3, axis=0)
        points, faces = points[faces.reshape(-1)], np.arange(faces.size).reshape(-1, 3)
    material = _material(path, comments, warnings) if uv is not None else None
    if material is None:
        uv = None
    return Loaded(
        points,
        faces,
        None,
        colors if material is None else None,
        uv,
        np.zeros(len(faces), np.int32),
        (material,) if material is not None else (),
        tuple(warnings),
    )


def _face_lists(face: _Table) -> _Ragged:
    value = face.get("vertex_indices", face.get("vertex_index"))
    return value if isinstance(value, _Ragged) else _Ragged(np.zeros(0, np.int64), np.zeros(0, int))


def _faces(path: Path, face: _Table, points: Array) -> tuple[Array, Array, Array]:
    """(F, 3) vertices, (F,) row of the face element, (F, 3) corner in its list."""
    lists = _face_lists(face)
    with np.errstate(invalid="ignore"):
        corners = lists.values.astype(np.int64)
    if not len(corners):
        none = np.zeros((0, 3), np.int64)
        return none, np.zeros(0, np.int64), none
    check_indices(path, corners[:, None], len(points))
    triangles, polygon = triangulate(corners, lists.sizes, points)
    return corners[triangles], polygon, triangles


def _columns(table: _Table, choices: tuple[tuple[str, ...], ...]) -> Array | None:
    for names in choices:
        values = [table.get(n) for n in names]
        found = [v for v in values if isinstance(v, np.ndarray)]
        if len(found) == len(names):
            return np.stack(found, axis=1)
    return None


def _colors(table: _Table) -> Array | None:
    rgb = _columns(table, _COLORS)
    if rgb is None:
        splat = _columns(table, (_SPLAT,))
        if splat is None:
            return None
        return colors_from(np.clip(0.5 + _SPLAT_SCALE * splat, 0.0, 1.0))
    return colors_from(rgb)


def _material(path: Path, comments: list[str], warnings: list[str]) -> Material | None:
    """MeshLab and many scanners name the texture in a comment."""
    named = [c.split(None, 1)[1] for c in comments if c.lower().startswith("texturefile ")]
    if not named:
        return None
    if len(named) > 1:
        warnings.append(f"only the first of {len(named)} textures is used")
    try:
        texture = open_texture(resolve(named[0], path.parent, path.parent))
    except (ReferenceRefused, TextureError) as error:
        warnings.append(f"texture not used: {error}")
        return None
    return Material("textured", WHITE, texture)
