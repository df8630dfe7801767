"""Meshes and clouds to files. The same value gives the same bytes.

Coordinates are written as they are, +z up, except in GLB files, which are +y up by their standard:
one mesh, one primitive a material, textures inside. No library writes them here: trimesh leaves out
animations and the strength of what shines, pygltflib only holds the JSON.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from model.core.errors import ConfigurationError, GeometryError
from model.core.files import free_name, written_to
from model.core.geometry import Material, Mesh, PointCloud
from model.core.textures import ImageFile, SurfaceMaps, encode, from_linear, to_linear
from model.geometry.sampling import corner_normals, vertex_colors
from model.io.formats.gltf_data import BRIGHTER

__all__ = ["MESH_SUFFIXES", "GlbBuilder", "mesh_to_glb", "write_cloud", "write_mesh"]


Array = npt.NDArray[Any]
METALLIC, ROUGHNESS = 0.0, 0.9
"""Values of materials that declare none."""
_MIME = {".jpg": "image/jpeg", ".png": "image/png"}


def mesh_to_glb(
    mesh: Mesh,
    *,
    y_up: bool = False,
    smooth: bool = True,
    matt: bool = False,
) -> bytes:
    """``mesh`` as a GLB file; the same mesh gives the same bytes.

    Surfaces are double-sided, and non-metallic and rough where their material doesn't say. Colours
    are brought from sRGB to the linear values that glTF wants.

    Args:
        mesh: needs a face.
        y_up: turn +z up to +y up, as the glTF standard has it. Off, coordinates stay as they are,
            which is what a browser scene that is +z up itself wants.
        smooth: with normals that are smooth but for creases; else viewers shade each face flat.
        matt: take all for non-metallic, rough and without maps: for a screen where colours are to
            be seen, metal without surroundings to reflect would be black, and maps would make what
            is sent up to four times as large.
    """
    builder = GlbBuilder()
    if matt:
        mesh = replace(mesh, materials=tuple(map(_matt, mesh.materials)))
    builder.append("nodes", {"mesh": builder.mesh(mesh, y_up=y_up, smooth=smooth)})
    return builder.finish()


def face_order(mesh: Mesh, *, matt: bool = False) -> npt.NDArray[np.int32]:
    """(F,) the faces of ``mesh`` in the order in which its GLB file has them, all matt or not."""
    materials = tuple(map(_matt, mesh.materials)) if matt else mesh.materials
    return np.argsort(_looks(materials)[mesh.face_material], kind="stable").astype(np.int32)


def _matt(material: Material) -> Material:
    return replace(material, metallic=None, roughness=None, maps=SurfaceMaps())


def _looks(materials: Sequence[Material]) -> Array:
    """The first material that equals each one: fewer primitives draw faster."""
    first: dict[tuple[Any, ...], int] = {}
    keys = [(m.base_color, id(m.texture), m.metallic, m.roughness, m.maps) for m in materials]
    return np.array([first.setdefault(key, i) for i, key in enumerate(keys)])


def packed(tree: str, binary: bytes) -> bytes:
    """A GLB file of its JSON text and its buffer, if any."""
    text = tree.encode()
    chunks = b""
    for kind, data, fill in ((b"JSON", text, b" "), (b"BIN\0", binary, b"\0")):
        if data:
            padded = data + fill * (-len(data) % 4)
            chunks += struct.pack("<I", len(padded)) + kind + padded
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


class GlbBuilder:
    """A glTF tree and its binary buffer while they are written; materials and pictures that are
    there already are used again, as viewers keep one for each entry.

    Attributes:
        binary: the buffer. tree: the JSON document, which shows its first node.
    """

    def __init__(self) -> None:
        self.binary = bytearray()
        self.tree: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "ArtiWorld"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
        }
        self.tree |= {k: [] for k in ("nodes", "meshes", "accessors", "bufferViews", "materials")}
        self._pictures: dict[bytes, int] = {}

    def append(self, key: str, entry: Any) -> int:
        """Append to the list ``key`` of the tree; returns the entry's number."""
        entries = self.tree.setdefault(key, [])
        entries.append(entry)
        return len(entries) - 1

    def view(self, data: bytes, **more: Any) -> int:
        """Append ``data`` to the buffer as a view of its own; ``more`` are its properties."""
        self.binary.extend(b"\0" * (-len(self.binary) % 4))
        place = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)}
        self.binary.extend(data)
        return self.append("bufferViews", place | more)

    def accessor(self, values: Array, kind: str, component: int, view: int, **more: Any) -> int:
        """Append an accessor of the rows of ``values`` in ``view``."""
        entry = {"bufferView": view, "componentType": component, "count": len(values), "type": kind}
        return self.append("accessors", entry | more)

    def finish(self) -> bytes:
        """The bytes of the GLB file."""
        self.binary.extend(b"\0" * (-len(self.binary) % 4))
        if self.binary:
            self.tree["buffers"] = [{"byteLength": len(self.binary)}]
        return packed(json.dumps(self.tree, separators=(",", ":")), bytes(self.binary))

    def mesh(
        self, mesh: Mesh, *, name: str | None = None, y_up: bool = False, smooth: bool = True
    ) -> int:
        """Append a mesh with a primitive a material; returns its number. See
        :func:`mesh_to_glb`."""
        look = _looks(mesh.materials)[mesh.face_material]
        colored = mesh.vertex_colors is not None
        materials = [self._material(mesh.materials[i], colored) for i in np.unique(look)]
        primitives = self._primitives(mesh, look, materials, y_up, smooth)
        named = {} if name is None else {"name": name}
        return self.append("meshes", {"primitives": primitives, **named})

    def _rows(self, values: Array, kind: str, component: int, **more: Any) -> int:
        target = 34963 if kind == "SCALAR" else 34962
        view = self.view(np.ascontiguousarray(values).tobytes(), target=target)
        return self.accessor(values, kind, component, view, **more)

    def _material(self, material: Material, colored: bool) -> int:
        color = np.array(material.base_color, np.float64) / 255.0
        alpha = float(color[3])
        factor = [1.0, 1.0, 1.0, alpha] if colored else [*to_linear(color[:3]).tolist(), alpha]
        surface: dict[str, Any] = {
            "baseColorFactor": [round(float(c), 6) for c in factor],
            "metallicFactor": METALLIC if material.metallic is None else material.metallic,
            "roughnessFactor": ROUGHNESS if material.roughness is None else material.roughness,
        }
        entry: dict[str, Any] = {
            "name": material.name,
            "pbrMetallicRoughness": surface,
            "doubleSided": True,
        }
        if alpha < 1.0:
            entry["alphaMode"] = "BLEND"
        if material.texture is not None:
            surface["baseColorTexture"] = {"index": self._texture(material.texture)}
            if alpha == 1.0 and _has_holes(material.texture):
                entry["alphaMode"] = "MASK"
        self._maps(entry, material.maps)
        made = self.tree["materials"]
        return made.index(entry) if entry in made else self.append("materials", entry)

    def _maps(self, entry: dict[str, Any], maps: SurfaceMaps) -> None:
        if maps.normal is not None:
            slot = {"index": self._texture(maps.normal), "scale": maps.normal_scale}
            entry["normalTexture"] = slot
        if maps.occlusion is not None:
            at, strength = self._texture(maps.occlusion), maps.occlusion_strength
            entry["occlusionTexture"] = {"index": at, "strength": strength}
        if maps.emissive is not None:
            entry["emissiveTexture"] = {"index": self._texture(maps.emissive)}
        if any(maps.emission):
            strength = max(1.0, *maps.emission)
            entry["emissiveFactor"] = [c / strength for c in maps.emission]
            if strength > 1.0:
                entry["extensions"] = {BRIGHTER: {"emissiveStrength": strength}}
                self.tree["extensionsUsed"] = [BRIGHTER]

    def _texture(self, image: Image.Image | ImageFile) -> int:
        file = image if isinstance(image, ImageFile) else ImageFile(*encode(image))
        if file.data not in self._pictures:
            picture = {"bufferView": self.view(file.data), "mimeType": _MIME[file.suffix]}
            source = self.append("images", picture)
            self._pictures[file.data] = self.append("textures", {"source": source})
        return self._pictures[file.data]

    def _primitives(
        self, mesh: Mesh, look: Array, materials: list[int], y_up: bool, smooth: bool
    ) -> list[dict[str, Any]]:
        group, normals = corner_normals(mesh) if smooth else (None, None)
        primitives = []
        for i, material in zip(np.unique(look), materials, strict=True):
            rows = np.flatnonzero(look == i)
            corners = mesh.faces[rows].reshape(-1).astype(np.int64)
            if group is not None and normals is not None:
                key = corners * len(normals) + group[rows].reshape(-1)
                unique, index = np.unique(key, return_inverse=True)
                vertex, normal = unique // len(normals), normals[unique % len(normals)]
            else:
                (vertex, index), normal = np.unique(corners, return_inverse=True), None
            attributes = self._attributes(mesh, vertex, normal, y_up, int(i))
            index = index.reshape(-1)
            small = len(vertex) < 65535
            at = self._rows(
                index.astype("<u2" if small else "<u4"), "SCALAR", 5123 if small else 5125
            )
            primitives.append({"attributes": attributes, "indices": at, "material": material})
        return primitives

    def _attributes(
        self, mesh: Mesh, vertex: Array, normal: Array | None, y_up: bool, material: int
    ) -> dict[str, int]:
        points = _turned(mesh.vertices[vertex], y_up).astype("<f4")
        out = {
            "POSITION": self._rows(
                points, "VEC3", 5126, min=points.min(0).tolist(), max=points.max(0).tolist()
            )
        }
        if normal is not None:
            out["NORMAL"] = self._rows(_turned(normal, y_up).astype("<f4"), "VEC3", 5126)
        if mesh.uv is not None and mesh.materials[material].pictured:
            uv = mesh.uv[vertex]
            st = np.column_stack([uv[:, 0], 1.0 - uv[:, 1]]).astype("<f4")
            out["TEXCOORD_0"] = self._rows(st, "VEC2", 5126)
        if mesh.vertex_colors is not None:
            rgba = mesh.vertex_colors[vertex] / 255.0
            rgba[:, :3] = to_linear(rgba[:, :3])
            short = np.rint(rgba * 65535).astype("<u2")
            out["COLOR_0"] = self._rows(short, "VEC4", 5123, normalized=True)
        return out


def _turned(vectors: Array, y_up: bool) -> Array:
    """(x, y, z) as (x, z, -y) where glTF's +y is to be up."""
    if not y_up:
        return vectors
    return np.stack([vectors[:, 0], vectors[:, 2], -vectors[:, 1]], axis=1)


def _has_holes(image: Image.Image) -> bool:
    """True if parts of it are transparent."""
    if image.mode != "RGBA":
        return False
    lowest = image.getchannel("A").getextrema()[0]
    return isinstance(lowest, (int, float)) and lowest < 128


_CHUNK = 50_000


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
        name = "_".join(m.name.replace("#", "_").split()) or "material"
        out.append(free_name(name, out))
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
