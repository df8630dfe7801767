"""GLB files: one mesh, one primitive a material, textures inside."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from model.core.mesh import Material, Mesh
from model.core.surface_maps import ImageFile, SurfaceMaps
from model.core.textures import encode
from model.geometry.shading import corner_normals
from model.io.formats.gltf_materials import BRIGHTER
from model.io.formats.srgb import to_linear

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
    builder = _Builder()
    if matt:
        mesh = replace(mesh, materials=tuple(map(_matt, mesh.materials)))
    look = _looks(mesh.materials)[mesh.face_material]
    for i in np.unique(look):
        builder.material(mesh.materials[i], mesh.vertex_colors is not None)
    builder.geometry(mesh, look, y_up, smooth)
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


class GlbTree:
    """A glTF tree and its binary buffer while they are written.

    Attributes:
        binary: the buffer. tree: the JSON document.
    """

    def __init__(self) -> None:
        self.binary = bytearray()
        self.tree: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "ArtiWorld"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
        }

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


class _Builder(GlbTree):
    def __init__(self) -> None:
        super().__init__()
        self.tree |= {"nodes": [{"mesh": 0}]}
        self.tree |= {k: [] for k in ("meshes", "accessors", "bufferViews", "materials")}
        self._images: dict[int | ImageFile, int] = {}

    def rows(self, values: Array, kind: str, component: int, **more: Any) -> int:
        target = 34963 if kind == "SCALAR" else 34962
        view = self.view(np.ascontiguousarray(values).tobytes(), target=target)
        return self.accessor(values, kind, component, view, **more)

    def material(self, material: Material, colored: bool) -> None:
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
            surface["baseColorTexture"] = {"index": self.texture(material.texture)}
            if alpha == 1.0 and _has_holes(material.texture):
                entry["alphaMode"] = "MASK"
        self.maps(entry, material.maps)
        self.tree["materials"].append(entry)

    def maps(self, entry: dict[str, Any], maps: SurfaceMaps) -> None:
        if maps.normal is not None:
            slot = {"index": self.texture(maps.normal), "scale": maps.normal_scale}
            entry["normalTexture"] = slot
        if maps.occlusion is not None:
            at, strength = self.texture(maps.occlusion), maps.occlusion_strength
            entry["occlusionTexture"] = {"index": at, "strength": strength}
        if maps.emissive is not None:
            entry["emissiveTexture"] = {"index": self.texture(maps.emissive)}
        if any(maps.emission):
            strength = max(1.0, *maps.emission)
            entry["emissiveFactor"] = [c / strength for c in maps.emission]
            if strength > 1.0:
                entry["extensions"] = {BRIGHTER: {"emissiveStrength": strength}}
                self.tree["extensionsUsed"] = [BRIGHTER]

    def texture(self, image: Image.Image | ImageFile) -> int:
        key = image if isinstance(image, ImageFile) else id(image)
        if key not in self._images:
            if isinstance(image, ImageFile):
                data, suffix = image.data, image.suffix
            else:
                data, suffix = encode(image)
            picture = {"bufferView": self.view(data), "mimeType": _MIME[suffix]}
            source = self.append("images", picture)
            self._images[key] = self.append("textures", {"source": source})
        return self._images[key]

    def geometry(self, mesh: Mesh, look: Array, y_up: bool, smooth: bool) -> None:
        group, normals = corner_normals(mesh) if smooth else (None, None)
        primitives = []
        for i in np.unique(look):
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
            at = self.rows(
                index.astype("<u2" if small else "<u4"), "SCALAR", 5123 if small else 5125
            )
            primitives.append(
                {"attributes": attributes, "indices": at, "material": len(primitives)}
            )
        self.tree["meshes"] = [{"primitives": primitives}]

    def _attributes(
        self, mesh: Mesh, vertex: Array, normal: Array | None, y_up: bool, material: int
    ) -> dict[str, int]:
        points = _turned(mesh.vertices[vertex], y_up).astype("<f4")
        out = {
            "POSITION": self.rows(
                points, "VEC3", 5126, min=points.min(0).tolist(), max=points.max(0).tolist()
            )
        }
        if normal is not None:
            out["NORMAL"] = self.rows(_turned(normal, y_up).astype("<f4"), "VEC3", 5126)
        if mesh.uv is not None and mesh.materials[material].pictured:
            uv = mesh.uv[vertex]
            st = np.column_stack([uv[:, 0], 1.0 - uv[:, 1]]).astype("<f4")
            out["TEXCOORD_0"] = self.rows(st, "VEC2", 5126)
        if mesh.vertex_colors is not None:
            rgba = mesh.vertex_colors[vertex] / 255.0
            rgba[:, :3] = to_linear(rgba[:, :3])
            short = np.rint(rgba * 65535).astype("<u2")
            out["COLOR_0"] = self.rows(short, "VEC4", 5123, normalized=True)
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
