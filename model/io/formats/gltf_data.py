"""The contents of a glTF file: buffers, views and accessors; materials, textures and maps."""

from __future__ import annotations

import base64
import binascii
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeGuard, TypeVar
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageStat

from model.core.errors import InputFileError
from model.core.geometry import Material
from model.core.textures import ImageFile, SurfaceMaps, TextureError, decode, image_file, to_srgb
from model.io.formats.loaded import ReferenceRefused, check_count, read_bytes, resolve

Array = npt.NDArray[Any]
Json = dict[str, Any]

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


class GltfBuffers:
    """The accessors of one file; a buffer is read on first use.

    Args:
        tree: its JSON.
        binary: the chunk of a GLB, else None.
        max_bytes: of each file beside it.
    """

    def __init__(self, path: Path, tree: Json, binary: bytes | None, max_bytes: int) -> None:
        self._buffers: dict[int, bytes] = {}
        self.path, self.tree, self.binary, self.max_bytes = path, tree, binary, max_bytes

    def _buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            buffer = self.tree["buffers"][index]
            uri = buffer.get("uri")
            if uri is None:
                if index != 0 or self.binary is None:
                    raise InputFileError(self.path, f"buffer {index} has no data")
                data = self.binary
            else:
                data = self.uri(uri, "buffer")
            if len(data) < int(buffer["byteLength"]):
                raise InputFileError(
                    self.path,
                    f"buffer {index} has {len(data)} bytes instead of {buffer['byteLength']}",
                    "the file is cut off; download or export it again",
                )
            self._buffers[index] = data
        return self._buffers[index]

    def uri(self, uri: str, what: str) -> bytes:
        """Bytes at an address inside the file; ``what`` names them in errors."""
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

    def view(self, index: int) -> tuple[memoryview, int]:
        """A buffer view and its stride, 0 where its values lie one after the other."""
        view = self.tree["bufferViews"][index]
        start, size = int(view.get("byteOffset") or 0), int(view["byteLength"])
        data = self._buffer(view["buffer"])
        if start < 0 or size < 0 or start + size > len(data):
            raise InputFileError(self.path, f"buffer view {index} leaves its buffer")
        return memoryview(data)[start : start + size], int(view.get("byteStride") or 0)

    def _strided(self, view: int, offset: int, count: int, dtype: np.dtype, width: int) -> Array:
        data, stride = self.view(view)
        row = dtype.itemsize * width
        stride = stride or row
        if count == 0:
            return np.zeros((0, width), dtype)
        if (
            min(offset, count) < 0
            or stride < row
            or offset + stride * (count - 1) + row > len(data)
        ):
            why = f"{count} values don't fit into buffer view {view}"
            raise InputFileError(self.path, why, "export it again")
        return np.ndarray((count, width), dtype, data, offset, (stride, dtype.itemsize))

    def accessor(self, index: int, columns: int | None = None) -> Array:
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
            check_count(self.path, values=count)
            out = np.zeros((count, width), dtype)
        if sparse := a.get("sparse"):
            out = self._sparse(out, sparse, dtype, width)
        if a.get("normalized") and dtype.kind in "iu":
            out = np.maximum(out / float(np.iinfo(dtype).max), -1.0).astype(np.float32)
        return out

    def _sparse(self, dense: Array, sparse: Json, dtype: np.dtype, width: int) -> Array:
        count, at, to = int(sparse["count"]), sparse["indices"], sparse["values"]
        where = self._strided(
            at["bufferView"],
            int(at.get("byteOffset") or 0),
            count,
            np.dtype(_COMPONENTS[at["componentType"]]),
            1,
        )
        values = self._strided(
            to["bufferView"], int(to.get("byteOffset") or 0), count, dtype, width
        )
        out = dense.copy()
        out[where[:, 0]] = values
        return out


T = TypeVar("T")

BRIGHTER = "KHR_materials_emissive_strength"
_BRIGHTEST = 1e6
Layout = tuple[int, tuple[float, ...]]
"""Set of texture coordinates, and what moves them: offset, scale, rotation; empty for nothing."""


class GltfMaterials:
    """The materials of one file, each read on first use.

    Attributes:
        warnings: textures that couldn't be used.
        left: what materials have that :class:`Material` has no place for.
    """

    def __init__(self, buffers: GltfBuffers) -> None:
        self.warnings: list[str] = []
        self.left: set[str] = set()
        self.tree = buffers.tree
        self._buffers = buffers
        self._materials: dict[int | None, Material] = {}
        self._images: dict[int, Image.Image | None] = {}
        self._files: dict[int, ImageFile | None] = {}
        self._layouts: dict[int | None, Layout] = {}

    def material(self, index: int | None) -> Material:
        """A material; None stands for a primitive without one."""
        if index not in self._materials:
            made = Material("material") if index is None else self._made(index)
            self._materials[index] = made
        return self._materials[index]

    def _made(self, index: int) -> Material:
        entry = self.tree["materials"][index]
        pbr = as_dict(entry.get("pbrMetallicRoughness"))
        factor, slot = pbr.get("baseColorFactor"), pbr.get("baseColorTexture")
        old = extension(entry, "KHR_materials_pbrSpecularGlossiness")
        factor, slot = factor or old.get("diffuseFactor"), slot or old.get("diffuseTexture")
        texture = None if slot is None else self._texture(slot["index"])
        mode = entry.get("alphaMode") or "OPAQUE"
        if texture is not None and mode == "OPAQUE" and texture.mode != "RGB":
            texture = texture.convert("RGB")
        maps = self._maps(entry, None if texture is None else _layout(as_dict(slot)), index)
        rgba = np.asarray(factor or (1.0, 1.0, 1.0, 1.0), np.float64)
        if rgba.shape != (4,) or not np.isfinite(rgba).all():
            rgba = np.ones(4)
        if mode == "OPAQUE" or (mode == "MASK" and texture is None):
            rgba[3] = float(mode == "OPAQUE" or rgba[3] >= entry.get("alphaCutoff", 0.5))
        if extension(entry, "KHR_materials_transmission").get("transmissionFactor"):
            self.left.add("light that shines through")
        color = tuple(int(c) for c in to_srgb(rgba[None])[0])
        name = str(entry.get("name") or f"material_{index}")
        return Material(name, color, texture, *self._surface(pbr, old), maps)  # type: ignore[arg-type]

    def _maps(self, entry: Json, layout: Layout | None, index: int) -> SurfaceMaps:
        """The maps that lie as the colour texture does, or as the first of them."""
        found: dict[str, ImageFile] = {}
        slots = {kind: entry.get(f"{kind}Texture") for kind in ("normal", "emissive", "occlusion")}
        for kind, slot in slots.items():
            image = None if slot is None else self._file(slot["index"], kind)
            if slot is None or image is None:
                continue
            layout = layout or _layout(slot)
            if _layout(slot) == layout:
                found[kind] = image
            else:
                self.left.add(f"{kind} map with texture coordinates of its own")
        if layout is not None:
            self._layouts[index] = layout
        emission = _emission(entry)
        # Skip the factor of a dropped map: alone it would make the whole surface glow.
        if "emissive" not in found and slots["emissive"] is not None:
            emission = (0.0, 0.0, 0.0)
        if not any(emission):
            found.pop("emissive", None)
        scale = as_dict(slots["normal"]).get("scale")
        strength = as_dict(slots["occlusion"]).get("strength")
        return SurfaceMaps(
            normal=found.get("normal"),
            normal_scale=float(scale) if "normal" in found and _is_number(scale) else 1.0,
            emission=emission,
            emissive=found.get("emissive"),
            occlusion=found.get("occlusion"),
            occlusion_strength=_share(strength) if "occlusion" in found else 1.0,
        )

    def _surface(self, pbr: Json, old: Json) -> tuple[float | None, float | None]:
        """Metallic and roughness; a map of them becomes its mean."""
        slot = pbr.get("metallicRoughnessTexture")
        if old and slot is None and not {"metallicFactor", "roughnessFactor"} & set(pbr):
            if "specularGlossinessTexture" in old:
                self.left.add("specular and glossiness map")
                return 0.0, None
            return 0.0, 1.0 - _share(old.get("glossinessFactor"))
        metallic, roughness = (_share(pbr.get(k)) for k in ("metallicFactor", "roughnessFactor"))
        image = None if slot is None else self._texture(slot["index"])
        if image is not None:
            _, green, blue = ImageStat.Stat(image.convert("RGB")).mean
            metallic, roughness = metallic * blue / 255.0, roughness * green / 255.0
            self.warnings.append("a map of metallic and roughness became its mean")
        return metallic, roughness

    def uv_set(self, material: int | None) -> str:
        """The attribute with the texture coordinates of a material that was asked for before."""
        return f"TEXCOORD_{self._layouts.get(material, (0, ()))[0]}"

    def transformed(self, st: Array, material: int | None) -> Array:
        """(N, 2) texture coordinates under KHR_texture_transform."""
        _, moved = self._layouts.get(material, (0, ()))
        if not moved:
            return st
        *offset, across, up, rotation = moved
        c, s = np.cos(rotation), np.sin(rotation)
        return (st * (across, up)) @ np.array([[c, s], [-s, c]]).T + offset

    def _texture(self, index: int) -> Image.Image | None:
        return self._kept(self._images, index, "texture", decode)

    def _file(self, index: int, kind: str) -> ImageFile | None:
        """As :meth:`_texture`, but the pixels don't stay in memory."""
        return self._kept(self._files, index, f"{kind} map", image_file)

    def _kept(
        self, kept: dict[int, T | None], index: int, what: str, read: Callable[[bytes, str], T]
    ) -> T | None:
        """An image of a texture, read once; None, with a remark, where that can't be done."""
        source = self._source(index)
        if source is None:
            return None
        if source not in kept:
            try:
                kept[source] = read(self._data(source), f"image {source}")
            except (InputFileError, TextureError) as error:
                self._unusable(what, error)
                kept[source] = None
        return kept[source]

    def _unusable(self, what: str, error: InputFileError | TextureError) -> None:
        problem = error.problem if isinstance(error, InputFileError) else error
        self.warnings.append(f"{what} not used: {problem}")

    def _source(self, index: int) -> int | None:
        """The image of a texture."""
        entry = self.tree["textures"][index]
        source = entry.get("source")
        if source is None:
            source = extension(entry, "EXT_texture_webp").get("source")
        if source is None:
            self.warnings.append("a texture in a format that isn't read (KTX2) was left out")
            return None
        return int(source)

    def _data(self, source: int) -> bytes:
        image = self.tree["images"][source]
        if "uri" in image:
            return self._buffers.uri(image["uri"], "image")
        return bytes(self._buffers.view(image["bufferView"])[0])


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and math.isfinite(value)


def _share(value: Any) -> float:
    """A factor of 0..1; 1, the standard's default, if absent or invalid."""
    return min(max(float(value), 0.0), 1.0) if _is_number(value) else 1.0


def _emission(entry: Json) -> tuple[float, float, float]:
    """Linear RGB; black if absent or invalid."""
    factor = entry.get("emissiveFactor")
    if not (isinstance(factor, list) and len(factor) == 3 and all(map(_is_number, factor))):
        return (0.0, 0.0, 0.0)
    declared = extension(entry, BRIGHTER).get("emissiveStrength")
    strength = float(declared) if _is_number(declared) else 1.0
    red, green, blue = (min(max(float(c) * strength, 0.0), _BRIGHTEST) for c in factor)
    return (red, green, blue)


def _layout(slot: Json) -> Layout:
    moved = extension(slot, "KHR_texture_transform")
    at = int(moved.get("texCoord", slot.get("texCoord") or 0))
    offset, scale = moved.get("offset", (0.0, 0.0)), moved.get("scale", (1.0, 1.0))
    values = tuple(map(float, (*offset, *scale, moved.get("rotation", 0.0))))
    if len(values) != 5:
        raise ValueError("a texture's transform needs two numbers for offset and scale")
    return at, () if values == (0.0, 0.0, 1.0, 1.0, 0.0) else values


def extension(entry: Json, name: str) -> Json:
    """The content of an extension in an entry; empty without it."""
    return as_dict(as_dict(entry.get("extensions")).get(name))


def as_dict(value: Any) -> Json:
    """``value`` where it is an object, else an empty one."""
    return value if isinstance(value, dict) else {}
