"""PLY: ASCII and binary, clouds and meshes, any order of properties.

Libraries read these wrongly: open3d 0.20 fills a file that is cut off up to the promised number of
points, and drops splats' colours, textures and triangle strips; trimesh 5.2 refuses faces of mixed
sizes and drops triangle strips; both keep indices out of range. plyfile is under the GPL.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from model.core.errors import InputFileError
from model.core.geometry import Material
from model.core.textures import TextureError, open_texture
from model.io.formats.loaded import (
    DARK,
    DEFAULT_MAX_BYTES,
    GREY,
    WHITE,
    Loaded,
    ReferenceRefused,
    check_indices,
    colors_from,
    read_bytes,
    resolve,
    triangulate,
)
from model.io.formats.ply_rows import Element, Property, Ragged, Table, read_ascii, read_binary
from model.io.robot_xml import counted

Array = npt.NDArray[Any]

_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_TYPES |= {"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2"}
_TYPES |= {"uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"}
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
_ELEMENTS = ("vertex", "face", "tristrips")
_CONFIDENCE = ("confidence", "conf", "quality")


def read_ply(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> Loaded:
    """Read one PLY file.

    Raises:
        InputFileError: where it is no PLY, truncated, or inconsistent.
    """
    return read_ply_columns(path, (), max_bytes)[0]


def read_ply_columns(
    path: Path,
    extra: tuple[str, ...],
    max_bytes: int = DEFAULT_MAX_BYTES,
    element: Literal["vertex", "face"] = "vertex",
) -> tuple[Loaded, dict[str, Array]]:
    """As :func:`read_ply`, with further properties of the vertices or faces.

    Args:
        extra: names in lower case.
        element: whose.

    Returns:
        What was read, and values by name of those that are there: (V,), or one a face of the file.
        Where texture coordinates or face colours made new vertices, there are none of vertices.

    Raises:
        InputFileError: where it is no PLY, truncated, or inconsistent.
    """
    data = read_bytes(path, max_bytes)
    style, elements, comments, start = _header(path, data)
    if style == "ascii":
        tables = read_ascii(path, data[start:], elements)
    else:
        tables = read_binary(
            path, memoryview(data)[start:], elements, ">" if "big" in style else "<"
        )
    if "vertex" not in tables:
        raise InputFileError(path, "no vertices in it", "a mesh or a point cloud has vertices")
    loaded = _assemble(path, tables, comments)
    others = Counter({e.name: e.count for e in elements if e.name not in _ELEMENTS})
    remarks = counted(others) + [DARK] * (loaded.colors is None and "intensity" in tables["vertex"])
    loaded = replace(loaded, warnings=(*loaded.warnings, *remarks))
    table = tables.get(element, {})
    counts = [len(loaded.vertices)] if element == "vertex" else [len(loaded.faces), loaded.polygons]
    columns = {k.lower(): v for k, v in table.items() if k.lower() in extra}
    fits = {k: v for k, v in columns.items() if isinstance(v, np.ndarray) and len(v) in counts}
    return loaded, fits


def _header(path: Path, data: bytes) -> tuple[str, list[Element], list[str], int]:
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
                elements.append(Element(words[1], int(words[2])))
            elif words[0] == "property" and words[1] == "list":
                prop = Property(words[4], _TYPES[words[3]], _TYPES[words[2]])
                elements[-1].properties.append(prop)
            elif words[0] == "property":
                elements[-1].properties.append(Property(words[2], _TYPES[words[1]]))
        except (IndexError, KeyError, ValueError):
            raise InputFileError(
                path, f"PLY header line {line.strip()[:60]!r} can't be understood"
            ) from None
    if style not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise InputFileError(path, f"PLY format {style!r} is unknown", "use ascii or binary")
    for e in elements:
        _check_element(path, e, len(data) - end - 1, style)
    return style, elements, comments, end + 1


def _check_element(path: Path, element: Element, size: int, style: str) -> None:
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


def _assemble(path: Path, tables: dict[str, Table], comments: list[str]) -> Loaded:
    vertex = tables["vertex"]
    xyz = _columns(vertex, (("x", "y", "z"),))
    if xyz is None:
        why = "the vertices have no x, y and z"
        raise InputFileError(path, why, "a PLY vertex needs all three")
    with np.errstate(over="ignore"):
        points = xyz.astype(np.float64 if xyz.dtype == np.float64 else np.float32)
    normals = _columns(vertex, (("nx", "ny", "nz"),))
    colors = _colors(vertex)
    uv = _columns(vertex, _UVS)
    warnings: list[str] = []
    faces, polygon, corner = _faces(path, tables.get("face", {}), points)
    if not len(faces):
        strips = _strips(path, tables.get("tristrips", {}), len(points))
        confidence = None if len(strips) else _confidence(vertex)
        return Loaded(
            points, strips, None if len(strips) else normals, colors, confidence=confidence
        )
    face = tables["face"]
    face_colors = _colors(face)
    wedge = face.get("texcoord")
    if wedge is not None and isinstance(wedge, Ragged):
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
    materials = _materials(path, comments, warnings) if uv is not None else ()
    if not materials:
        uv = None
    number = face.get("texnumber")
    material_of = np.zeros(len(faces), np.int32)
    if len(materials) > 1 and isinstance(number, np.ndarray) and len(number) > polygon.max():
        material_of = np.clip(number[polygon], 0, len(materials) - 1).astype(np.int32)
    elif len(materials) > 1:
        warnings.append(f"only the first of {len(materials)} textures is used")
        materials = materials[:1]
    return Loaded(
        points,
        faces,
        None,
        None if materials else colors,
        uv,
        material_of,
        materials,
        tuple(warnings),
        polygon=polygon,
        polygons=len(_face_lists(face).sizes),
    )


def _face_lists(face: Table) -> Ragged:
    value = face.get("vertex_indices", face.get("vertex_index"))
    return value if isinstance(value, Ragged) else Ragged(np.zeros(0, np.int64), np.zeros(0, int))


def _faces(path: Path, face: Table, points: Array) -> tuple[Array, Array, Array]:
    """(F, 3) vertices, (F,) row of the face element, (F, 3) corner in its list."""
    lists = _face_lists(face)
    if not len(lists.values):
        none = np.zeros((0, 3), np.int64)
        return none, np.zeros(0, np.int64), none
    check_indices(path, lists.values, len(points), sizes=lists.sizes)
    corners = lists.values.astype(np.int64)
    triangles, polygon = triangulate(path, corners, lists.sizes, points)
    return corners[triangles], polygon, triangles


def _columns(table: Table, choices: tuple[tuple[str, ...], ...]) -> Array | None:
    for names in choices:
        values = [table.get(n) for n in names]
        found = [v for v in values if isinstance(v, np.ndarray)]
        if len(found) == len(names):
            return np.stack(found, axis=1)
    return None


def _colors(table: Table) -> Array | None:
    rgb = _columns(table, _COLORS)
    if rgb is None:
        splat = _columns(table, (_SPLAT,))
        if splat is None:
            return None
        return colors_from(np.clip(0.5 + _SPLAT_SCALE * splat, 0.0, 1.0))
    return colors_from(rgb)


def _confidence(table: Table) -> Array | None:
    """Confidence of each point; of Gaussian splats their opacity, which is stored as a logit."""
    found = _columns(table, tuple((name,) for name in _CONFIDENCE))
    if found is None and all(name in table for name in _SPLAT):
        found = _columns(table, (("opacity",),))
        if found is not None:
            with np.errstate(over="ignore"):
                return 1.0 / (1.0 + np.exp(-found[:, 0].astype(np.float64)))
    return None if found is None else found[:, 0]


def _strips(path: Path, table: Table, count: int) -> Array:
    """(F, 3) triangles of triangle strips, whose parts -1 divides (Stanford's range scans)."""
    lists = _face_lists(table)
    order = np.maximum(lists.values, -1)
    check_indices(path, np.maximum(order, 0), count, sizes=lists.sizes)
    order = order.astype(np.int64)
    ends = np.cumsum(lists.sizes)
    out: list[Array] = []
    for strip in np.split(order, ends[:-1]) if len(order) else ():
        for part in np.split(strip, np.flatnonzero(strip < 0)):
            run = part[part >= 0]
            if len(run) >= 3:
                faces = np.stack([run[:-2], run[1:-1], run[2:]], axis=1)
                faces[1::2] = faces[1::2, ::-1]
                out.append(faces)
    faces = np.concatenate(out) if out else np.zeros((0, 3), np.int64)
    repeats = (faces == np.roll(faces, 1, axis=1)).any(axis=1)  # they turn a strip around
    return faces[~repeats]


def _materials(path: Path, comments: list[str], warnings: list[str]) -> tuple[Material, ...]:
    """MeshLab and many scanners name the textures in comments."""
    named = [c.split(None, 1)[1] for c in comments if c.lower().startswith("texturefile ")]
    out: list[Material] = []
    for name in named:
        try:
            texture = open_texture(resolve(name, path.parent, path.parent))
        except (ReferenceRefused, TextureError) as error:
            warnings.append(f"texture not used: {error}")
            texture = None
        out.append(Material("textured", WHITE if texture else GREY, texture))
    return tuple(out) if any(m.texture for m in out) else ()
