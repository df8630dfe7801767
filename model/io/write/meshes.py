"""Meshes and clouds to files. The same value gives the same bytes.

Coordinates are written as they are, +z up, except in GLB files, which are +y up by their standard.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.errors import ConfigurationError, GeometryError
from model.core.files import written_to
from model.core.mesh import Material, Mesh
from model.core.point_cloud import PointCloud
from model.core.textures import encode
from model.geometry.appearance import vertex_colors
from model.io.formats.srgb import from_linear
from model.io.write.glb import mesh_to_glb

Array = npt.NDArray[Any]
_CHUNK = 50_000

__all__ = ["MESH_SUFFIXES", "mesh_to_glb", "write_cloud", "write_mesh"]


def write_mesh(mesh: Mesh, path: str | Path) -> tuple[Path, ...]:
    """Write ``mesh`` in the format that the suffix names: .obj, .glb, .ply or .stl.

    OBJ keeps everything: beside it go an MTL of the same stem (see ``model.io.formats.mtl``)
    and the textures, which are called after their content, so that parts in one folder share them.
    GLB keeps everything in float32.
    PLY has colours at the vertices, STL has none.

    Returns:
        The files that hold it, ``path`` first.

    Raises:
        ConfigurationError: for another suffix.
        GeometryError: where the mesh has no face.
        InputFileError: where it can't be written.
    """
    path = Path(path)
    writer = _WRITERS.get(path.suffix.lower())
    if writer is None:
        raise ConfigurationError(
            f"{path.name}: meshes are written as {', '.join(_WRITERS)}, not {path.suffix!r}"
        )
    if not len(mesh.faces):
        raise GeometryError(f"{path.name}: a mesh without faces can't be written")
    return writer(mesh, path)


def write_cloud(cloud: PointCloud, path: str | Path) -> tuple[Path, ...]:
    """Write ``cloud`` as a binary PLY with its normals, colours and confidences.

    Raises:
        ConfigurationError: for another suffix than .ply.
        InputFileError: where it can't be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".ply":
        raise ConfigurationError(f"{path.name}: clouds are written as .ply, not {path.suffix!r}")
    columns: list[tuple[str, str, Array]] = [
        (name, "f4", cloud.points[:, k]) for k, name in enumerate("xyz")
    ]
    if cloud.normals is not None:
        columns += [(f"n{name}", "f4", cloud.normals[:, k]) for k, name in enumerate("xyz")]
    if cloud.colors is not None:
        columns += _color_columns(cloud.colors)
    if cloud.confidence is not None:
        columns.append(("confidence", "f4", cloud.confidence))
    return _write(path, _ply_header(len(cloud), columns, None) + _rows(columns))


def _write(path: Path, data: bytes) -> tuple[Path, ...]:
    with written_to(path, "check space and permissions"):
        path.write_bytes(data)
    return (path,)


# PLY


def _color_columns(colors: Array) -> list[tuple[str, str, Array]]:
    names = ("red", "green", "blue", "alpha")
    return [(names[k], "u1", colors[:, k]) for k in range(colors.shape[1])]


def _ply_header(count: int, columns: list[tuple[str, str, Array]], faces: int | None) -> bytes:
    words = {"f4": "float", "f8": "double", "u1": "uchar"}
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    lines += [f"property {words[kind]} {name}" for name, kind, _ in columns]
    if faces is not None:
        lines += [f"element face {faces}", "property list uchar int vertex_indices"]
    return "\n".join([*lines, "end_header", ""]).encode()


def _rows(columns: list[tuple[str, str, Array]]) -> bytes:
    rows = np.zeros(len(columns[0][2]), [(name, f"<{kind}") for name, kind, _ in columns])
    for name, _, values in columns:
        rows[name] = values
    return rows.tobytes()


def _write_ply(mesh: Mesh, path: Path) -> tuple[Path, ...]:
    vertices = mesh.vertices
    kind = "f4" if (vertices.astype(np.float32) == vertices).all() else "f8"
    columns = [(name, kind, vertices[:, k]) for k, name in enumerate("xyz")]
    plain = mesh.vertex_colors is None and mesh.materials == (Material(),)
    if not plain:
        columns += _color_columns(vertex_colors(mesh))
    faces = np.zeros(len(mesh.faces), [("n", "u1"), ("corner", "<i4", 3)])
    faces["n"], faces["corner"] = 3, mesh.faces
    head = _ply_header(len(vertices), columns, len(faces))
    return _write(path, head + _rows(columns) + faces.tobytes())


# STL and GLB


def _write_stl(mesh: Mesh, path: Path) -> tuple[Path, ...]:
    rows = np.zeros(
        len(mesh.faces), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    )
    rows["normal"], rows["corners"] = mesh.face_normals, mesh.triangles
    head = b"ArtiWorld".ljust(80, b"\0") + len(rows).to_bytes(4, "little")
    return _write(path, head + rows.tobytes())


def _write_glb(mesh: Mesh, path: Path) -> tuple[Path, ...]:
    return _write(path, mesh_to_glb(mesh, y_up=True))


# OBJ


def _write_obj(mesh: Mesh, path: Path) -> tuple[Path, ...]:
    names = _material_names(mesh.materials)
    used = np.unique(mesh.face_material)
    mtl = path.with_suffix(".mtl")
    lines: list[str] = []
    textures: list[Path] = []
    for i in used:
        files = _image_files(mesh.materials[i], path.parent)
        textures += files.values()
        lines += _mtl(mesh.materials[i], names[i], {key: f.name for key, f in files.items()})
    pieces = [f"# ArtiWorld, metres, +z up\nmtllib {mtl.name}\n"]
    if mesh.vertex_colors is None:
        pieces.append(_lines("v %.9g %.9g %.9g\n", mesh.vertices + 0.0))
    else:
        table = np.column_stack([mesh.vertices + 0.0, mesh.vertex_colors[:, :3] / 255.0])
        pieces.append(_lines("v %.9g %.9g %.9g %.4f %.4f %.4f\n", table))
    if mesh.uv is not None:
        pieces.append(_lines("vt %.7g %.7g\n", mesh.uv + np.float32(0)))
    starts = np.flatnonzero(np.diff(mesh.face_material, prepend=-1))
    for start, rows in zip(starts, np.split(mesh.faces, starts[1:]), strict=True):
        pieces.append(f"usemtl {names[mesh.face_material[start]]}\n")
        if mesh.uv is None:
            pieces.append(_lines("f %d %d %d\n", rows + 1))
        else:
            pieces.append(_lines("f %d/%d %d/%d %d/%d\n", np.repeat(rows + 1, 2, axis=1)))
    _write(path, "".join(pieces).encode())
    _write(mtl, "".join(lines).encode())
    return (path, mtl, *dict.fromkeys(textures))


def _lines(form: str, table: Array) -> str:
    """One line of ``form`` a row."""
    out = []
    for at in range(0, len(table), _CHUNK):
        rows = table[at : at + _CHUNK]
        out.append((form * len(rows)) % tuple(rows.reshape(-1).tolist()))
    return "".join(out)


def _material_names(materials: tuple[Material, ...]) -> list[str]:
    """Names without white space, each once."""
    out: list[str] = []
    for m in materials:
        stem = name = "_".join(m.name.replace("#", "_").split()) or "material"
        number = 2
        while name in out:
            name, number = f"{stem}_{number}", number + 1
        out.append(name)
    return out


def _image_files(material: Material, folder: Path) -> dict[str, Path]:
    """MTL's word for each image of a material, and the file that it was written to."""
    maps = material.maps
    images = {"norm": maps.normal, "map_Ke": maps.emissive, "map_ao": maps.occlusion}
    named = {key: (i.data, i.suffix) for key, i in images.items() if i is not None}
    if material.texture is not None:
        named = {"map_Kd": encode(material.texture), **named}
    return {key: _write_texture(*image, folder) for key, image in named.items()}


def _mtl(material: Material, name: str, images: dict[str, str]) -> list[str]:
    red, green, blue, alpha = (c / 255.0 for c in material.base_color)
    out = [f"newmtl {name}\n", f"Kd {red:.6g} {green:.6g} {blue:.6g}\n", f"d {alpha:.6g}\n"]
    for key, value in (("Pm", material.metallic), ("Pr", material.roughness)):
        if value is not None:
            out.append(f"{key} {value:.6g}\n")
    maps = material.maps
    if any(maps.emission):
        red, green, blue = from_linear(np.array(maps.emission)).tolist()
        out.append(f"Ke {red:.6g} {green:.6g} {blue:.6g}\n")
    options = {}
    if maps.normal_scale != 1.0:
        options["norm"] = f"-bm {maps.normal_scale:.6g} "
    if maps.occlusion_strength != 1.0:
        strength = maps.occlusion_strength
        options["map_ao"] = f"-mm {1.0 - strength:.6g} {strength:.6g} "
    return [*out, *(f"{key} {options.get(key, '')}{file}\n" for key, file in images.items())]


def _write_texture(data: bytes, suffix: str, folder: Path) -> Path:
    """The texture's file, named by its content; an existing one is kept."""
    path = folder / f"texture_{hashlib.sha256(data).hexdigest()[:12]}{suffix}"
    if not path.exists():
        _write(path, data)
    return path


_WRITERS: dict[str, Callable[[Mesh, Path], tuple[Path, ...]]] = {
    ".obj": _write_obj,
    ".glb": _write_glb,
    ".ply": _write_ply,
    ".stl": _write_stl,
}
MESH_SUFFIXES: tuple[str, ...] = tuple(_WRITERS)
"""Suffixes of the mesh files that can be written."""
