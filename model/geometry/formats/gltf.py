"""glTF 2.0: GLB files, and GLTF files with their buffers and images."""

from __future__ import annotations

import base64
import binascii
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt
from PIL import Image

from model.errors import InputFileError
from model.geometry.formats.loaded import (
    DEFAULT_MAX_BYTES,
    Loaded,
    check_indices,
    join,
    read_bytes,
    with_plain_colors,
)
from model.geometry.formats.references import ReferenceRefused, resolve
from model.geometry.formats.srgb import to_srgb
from model.geometry.formats.textures import TextureError, decode
from model.geometry.mesh import Material

Array = npt.NDArray[Any]
Json = dict[str, Any]

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_UNREADABLE = {
    "KHR_draco_mesh_compression": "Draco compression",
    "EXT_meshopt_compression": "meshopt compression",
}
_MAX_CORNERS = 60_000_000
_MAX_NODES = 200_000


def read_gltf(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> Loaded:
    """Read the default scene of a GLB or GLTF file, node transforms applied.

    Raises:
        InputFileError: where it is not glTF 2.0, cut off, or names files outside its folder.
    """
    gltf = open_gltf(path, max_bytes)
    with consistent(path):
        return gltf.scene()


def open_gltf(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> Gltf:
    """The tree of a GLB or GLTF file; meshes are read when they are asked for.

    Raises:
        InputFileError: where it is not glTF 2.0 or cut off.
    """
    data = read_bytes(path, max_bytes)
    tree, binary = _glb(path, data) if data[:4] == b"glTF" else (_json(path, data), None)
    version = str(_dict(tree.get("asset")).get("version", ""))
    if not version.startswith("2"):
        raise InputFileError(
            path, f"is glTF version {version or 'unknown'!r}", "glTF 2.0 is read; export it again"
        )
    for extension in tree.get("extensionsRequired") or ():
        if extension in _UNREADABLE:
            raise InputFileError(
                path, f"uses {_UNREADABLE[extension]}", "export it without compression"
            )
    return Gltf(path, tree, binary, max_bytes)


@contextmanager
def consistent(path: Path) -> Iterator[None]:
    """Say in words what a tree that may hold anything anywhere makes fail."""
    try:
        yield
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputFileError(
            path, f"the glTF inside is inconsistent ({type(error).__name__}: {error})",
            "export it again",
        ) from None  # fmt: skip


def _glb(path: Path, data: bytes) -> tuple[Json, bytes]:
    length = int.from_bytes(data[8:12], "little")
    if len(data) < 20 or length > len(data):
        raise InputFileError(
            path,
            f"is {len(data)} bytes long instead of {length}",
            "the file is cut off; download or export it again",
        )
    at, tree, binary = 12, None, b""
    while at + 8 <= length:
        size = int.from_bytes(data[at : at + 4], "little")
        kind = data[at + 4 : at + 8]
        if at + 8 + size > length:
            raise InputFileError(path, "a chunk is cut off", "download or export it again")
        chunk = data[at + 8 : at + 8 + size]
        if kind == b"JSON" and tree is None:
            tree = _json(path, chunk)
        elif kind == b"BIN\0" and not binary:
            binary = chunk
        at += 8 + size
    if tree is None:
        raise InputFileError(path, "has no JSON chunk", "export it again")
    return tree, binary


def _json(path: Path, data: bytes) -> Json:
    try:
        tree = json.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputFileError(
            path, f"is not glTF: {error}", "a .glb or .gltf file is needed"
        ) from None
    if not isinstance(tree, dict):
        raise InputFileError(path, "is not glTF: no object at its top")
    return tree


def _dict(value: Any) -> Json:
    return value if isinstance(value, dict) else {}


class Gltf:
    """An open file; a call may raise anything that :func:`consistent` puts into words."""

    def __init__(self, path: Path, tree: Json, binary: bytes | None, max_bytes: int) -> None:
        self.path, self.tree, self.binary, self.max_bytes = path, tree, binary, max_bytes
        self.warnings: list[str] = []
        self._buffers: dict[int, bytes] = {}
        self._materials: dict[int | None, Material] = {}
        self._images: dict[int, Image.Image | None] = {}
        self._meshes: dict[int, list[Loaded]] = {}
        self._uv_sets: dict[int | None, int] = {}

    def scene(self) -> Loaded:
        """All meshes of the scene in the root's frame."""
        pieces: list[Loaded] = []
        corners = visited = 0
        stack: list[tuple[int, Array, int]] = [(n, np.eye(4), 0) for n in self.roots()]
        nodes = self.tree.get("nodes") or []
        while stack:
            index, parent, depth = stack.pop()
            node = nodes[index]
            visited += 1
            if depth > len(nodes) or visited > _MAX_NODES:
                raise InputFileError(self.path, "its nodes form a cycle", "export it again")
            world = parent @ node_matrix(node)
            if "mesh" in node:
                for piece in self.mesh(node["mesh"]):
                    pieces.append(piece.moved(world))
                    corners += piece.faces.size + len(piece.vertices)
            if corners > _MAX_CORNERS:
                raise InputFileError(self.path, "its nodes repeat too many triangles")
            stack.extend((c, world, depth + 1) for c in reversed(node.get("children") or []))
        if not pieces:
            raise InputFileError(self.path, "there is no mesh in its scene", "export the object")
        out = joined(pieces)
        return replace(out, warnings=(*dict.fromkeys(self.warnings),))

    def roots(self) -> list[int]:
        """Nodes of the default scene, the last one first."""
        scenes = self.tree.get("scenes") or []
        if scenes:
            return list(reversed(scenes[self.tree.get("scene") or 0].get("nodes") or []))
        nodes = self.tree.get("nodes") or []
        children = {c for n in nodes for c in n.get("children") or []}
        return [i for i in reversed(range(len(nodes))) if i not in children]

    def mesh(self, index: int) -> list[Loaded]:
        """Its primitives in its own frame."""
        if index not in self._meshes:
            found = []
            for primitive in self.tree["meshes"][index]["primitives"]:
                compressed = set(primitive.get("extensions") or {}) & set(_UNREADABLE)
                if compressed:
                    raise InputFileError(
                        self.path,
                        f"uses {_UNREADABLE[compressed.pop()]}",
                        "export it without compression",
                    )
                piece = self._primitive(primitive)
                if piece is not None:
                    found.append(piece)
            self._meshes[index] = found
        return self._meshes[index]

    def _primitive(self, primitive: Json) -> Loaded | None:
        mode = primitive.get("mode", 4)
        attributes = primitive["attributes"]
        if "POSITION" not in attributes or mode in (1, 2, 3):
            return None
        points = self._accessor(attributes["POSITION"], 3).astype(np.float64)
        order = np.arange(len(points))
        if "indices" in primitive:
            order = self._accessor(primitive["indices"], 1)[:, 0].astype(np.int64)
        faces = _faces(order, mode)
        check_indices(self.path, faces, len(points))
        colors = uv = None
        if "COLOR_0" in attributes:
            linear = self._accessor(attributes["COLOR_0"])
            colors = to_srgb(linear)
        material_index = primitive.get("material")
        material = self._material(material_index)
        name = f"TEXCOORD_{self._uv_sets.get(material_index, 0)}"
        if material.texture is not None and name in attributes:
            st = self._accessor(attributes[name], 2).astype(np.float64)
            st = self._transformed(st, material_index)
            uv = np.nan_to_num(np.column_stack([st[:, 0], 1.0 - st[:, 1]]))
        for value in (colors, uv):
            if value is not None and len(value) != len(points):
                raise InputFileError(self.path, "an attribute is shorter than its positions")
        normals = None
        if not len(faces) and "NORMAL" in attributes:
            normals = self._accessor(attributes["NORMAL"], 3)
            normals = normals if len(normals) == len(points) else None
        material_of = np.zeros(len(faces), np.int32)
        out = Loaded(points, faces, normals, colors, uv, material_of, (material,))
        return with_plain_colors(out)

    # Accessors

    def _buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            buffer = self.tree["buffers"][index]
            uri = buffer.get("uri")
            if uri is None:
                if index != 0 or self.binary is None:
                    raise InputFileError(self.path, f"buffer {index} has no data")
                data = self.binary
            else:
                data = self._uri(uri, "buffer")
            if len(data) < int(buffer["byteLength"]):
                raise InputFileError(
                    self.path,
                    f"buffer {index} has {len(data)} bytes instead of {buffer['byteLength']}",
                    "the file is cut off; download or export it again",
                )
            self._buffers[index] = data
        return self._buffers[index]

    def _uri(self, uri: str, what: str) -> bytes:
        if uri.startswith("data:"):
            head, _, body = uri.partition(",")
            try:
                return base64.b64decode(body) if head.endswith("base64") else unquote(body).encode()
            except (binascii.Error, ValueError):
                raise InputFileError(self.path, f"a {what} inside it is damaged") from None
        try:
            target = resolve(unquote(uri), self.path.parent, self.path.parent)
        except ReferenceRefused as error:
            raise InputFileError(self.path, f"{what} {error}", "keep its files beside it") from None
        return read_bytes(target, self.max_bytes)

    def _view(self, index: int) -> tuple[memoryview, int]:
        view = self.tree["bufferViews"][index]
        start, size = int(view.get("byteOffset") or 0), int(view["byteLength"])
        data = self._buffer(view["buffer"])
        if start < 0 or size < 0 or start + size > len(data):
            raise InputFileError(self.path, f"buffer view {index} leaves its buffer")
        return memoryview(data)[start : start + size], int(view.get("byteStride") or 0)

    def _strided(self, view: int, offset: int, count: int, dtype: np.dtype, width: int) -> Array:
        data, stride = self._view(view)
        row = dtype.itemsize * width
        stride = stride or row
        if count == 0:
            return np.zeros((0, width), dtype)
        if (
            min(offset, count) < 0
            or stride < row
            or offset + stride * (count - 1) + row > len(data)
        ):
            raise InputFileError(
                self.path, f"{count} values don't fit into buffer view {view}", "export it again"
            )
        return np.ndarray((count, width), dtype, data, offset, (stride, dtype.itemsize))

    def _accessor(self, index: int, columns: int | None = None) -> Array:
        """(count, width) values, integers brought to 0..1 where they are normalised."""
        a = self.tree["accessors"][index]
        dtype, width, count = (
            np.dtype(_COMPONENTS[a["componentType"]]),
            _WIDTHS[a["type"]],
            a["count"],
        )
        if not isinstance(count, int) or count < 0:
            raise InputFileError(self.path, f"accessor {index} counts {count!r} values")
        if columns is not None and width != columns:
            raise InputFileError(self.path, f"accessor {index} is {a['type']}")
        if "bufferView" in a:
            offset = int(a.get("byteOffset") or 0)
            out = self._strided(a["bufferView"], offset, count, dtype, width)
        else:
            if count > _MAX_CORNERS:
                raise InputFileError(self.path, f"accessor {index} counts {count} values")
            out = np.zeros((count, width), dtype)
        if sparse := a.get("sparse"):
            out = self._sparse(out, sparse, dtype, width)
        if a.get("normalized") and dtype.kind in "iu":
            out = np.maximum(out / float(np.iinfo(dtype).max), -1.0).astype(np.float32)
        return out

    def _sparse(self, dense: Array, sparse: Json, dtype: np.dtype, width: int) -> Array:
        count, at, to = int(sparse["count"]), sparse["indices"], sparse["values"]
        where = self._strided(
            at["bufferView"], int(at.get("byteOffset") or 0), count,
            np.dtype(_COMPONENTS[at["componentType"]]), 1,
        )  # fmt: skip
        values = self._strided(
            to["bufferView"], int(to.get("byteOffset") or 0), count, dtype, width
        )
        out = dense.copy()
        out[where[:, 0]] = values
        return out

    # Materials

    def _material(self, index: int | None) -> Material:
        if index not in self._materials:
            if index is None:
                made = Material("material")
            else:
                entry = self.tree["materials"][index]
                pbr = _dict(entry.get("pbrMetallicRoughness"))
                factor, slot = pbr.get("baseColorFactor"), pbr.get("baseColorTexture")
                old = _dict(
                    _dict(entry.get("extensions")).get("KHR_materials_pbrSpecularGlossiness")
                )
                factor, slot = factor or old.get("diffuseFactor"), slot or old.get("diffuseTexture")
                texture = None if slot is None else self._texture(slot["index"])
                if slot is not None:
                    moved = _dict(_dict(slot.get("extensions")).get("KHR_texture_transform"))
                    self._uv_sets[index] = int(moved.get("texCoord", slot.get("texCoord") or 0))
                rgba = np.asarray(factor or (1.0, 1.0, 1.0, 1.0), np.float64)
                if rgba.shape != (4,) or not np.isfinite(rgba).all():
                    rgba = np.ones(4)
                if entry.get("alphaMode", "OPAQUE") == "OPAQUE":
                    rgba[3] = 1.0
                color = tuple(int(c) for c in to_srgb(rgba[None])[0])
                made = Material(str(entry.get("name") or f"material_{index}"), color, texture)  # type: ignore[arg-type]
            self._materials[index] = made
        return self._materials[index]

    def _transformed(self, st: Array, material: int | None) -> Array:
        """Texture coordinates under KHR_texture_transform."""
        if material is None:
            return st
        pbr = _dict(self.tree["materials"][material].get("pbrMetallicRoughness"))
        extensions = _dict(_dict(pbr.get("baseColorTexture")).get("extensions"))
        moved = extensions.get("KHR_texture_transform")
        if not moved:
            return st
        c, s = np.cos(moved.get("rotation", 0.0)), np.sin(moved.get("rotation", 0.0))
        scaled = st * np.asarray(moved.get("scale", (1.0, 1.0)))
        return scaled @ np.array([[c, s], [-s, c]]).T + np.asarray(moved.get("offset", (0.0, 0.0)))

    def _texture(self, index: int) -> Image.Image | None:
        entry = self.tree["textures"][index]
        source = entry.get("source")
        if source is None:
            webp = _dict(_dict(entry.get("extensions")).get("EXT_texture_webp"))
            source = webp.get("source")
        if source is None:
            self.warnings.append("a texture in a format that isn't read (KTX2) was left out")
            return None
        if source not in self._images:
            image = self.tree["images"][source]
            try:
                if "uri" in image:
                    data = self._uri(image["uri"], "image")
                else:
                    data = bytes(self._view(image["bufferView"])[0])
                self._images[source] = decode(data, f"image {source}")
            except (InputFileError, TextureError) as error:
                problem = error.problem if isinstance(error, InputFileError) else error
                self.warnings.append(f"texture not used: {problem}")
                self._images[source] = None
        return self._images[source]


def joined(pieces: list[Loaded]) -> Loaded:
    """Triangles and points of a scene; points are left out where there are triangles."""
    solid = [p for p in pieces if len(p.faces)]
    return join(solid or pieces)


def _faces(order: Array, mode: int) -> Array:
    if mode == 4:
        return order[: len(order) // 3 * 3].reshape(-1, 3)
    if mode == 5 and len(order) >= 3:
        out = np.stack([order[:-2], order[1:-1], order[2:]], axis=1)
        out[1::2] = out[1::2, ::-1]
        return out
    if mode == 6 and len(order) >= 3:
        return np.stack([np.full(len(order) - 2, order[0]), order[1:-1], order[2:]], axis=1)
    return np.zeros((0, 3), np.int64)


def node_matrix(node: Json) -> Array:
    """(4, 4) parent_from_node, which may scale and shear."""
    if "matrix" in node:
        out = np.asarray(node["matrix"], np.float64).reshape(4, 4).T
    else:
        x, y, z, w = node.get("rotation") or (0.0, 0.0, 0.0, 1.0)
        out = np.eye(4)
        n = x * x + y * y + z * z + w * w
        s = 2.0 / n if n > 1e-12 else 0.0
        out[:3, :3] = [
            [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
        ]
        out[:3, :3] *= np.asarray(node.get("scale") or (1.0, 1.0, 1.0), np.float64)
        out[:3, 3] = node.get("translation") or (0.0, 0.0, 0.0)
    if not np.isfinite(out).all():
        raise ValueError("a node's transform is not finite")
    return out
