"""Materials of a glTF file: base colours, their textures, and where those lie on a surface."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from PIL import Image, ImageStat

from model.errors import InputFileError
from model.geometry.formats.gltf_buffers import Array, GltfBuffers, Json
from model.geometry.formats.srgb import to_srgb
from model.geometry.formats.textures import TextureError, decode
from model.geometry.mesh import Material


class GltfMaterials:
    """The materials of one file, each read when it is asked for first.

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
        self._uv_sets: dict[int | None, int] = {}

    def material(self, index: int | None) -> Material:
        """A material; None is what a primitive without any has."""
        if index not in self._materials:
            made = Material("material") if index is None else self._made(index)
            self._materials[index] = made
        return self._materials[index]

    def _made(self, index: int) -> Material:
        entry = self.tree["materials"][index]
        pbr = as_dict(entry.get("pbrMetallicRoughness"))
        factor, slot = pbr.get("baseColorFactor"), pbr.get("baseColorTexture")
        old = as_dict(as_dict(entry.get("extensions")).get("KHR_materials_pbrSpecularGlossiness"))
        factor, slot = factor or old.get("diffuseFactor"), slot or old.get("diffuseTexture")
        texture = None if slot is None else self._texture(slot["index"])
        if slot is not None:
            moved = as_dict(as_dict(slot.get("extensions")).get("KHR_texture_transform"))
            self._uv_sets[index] = int(moved.get("texCoord", slot.get("texCoord") or 0))
        rgba = np.asarray(factor or (1.0, 1.0, 1.0, 1.0), np.float64)
        if rgba.shape != (4,) or not np.isfinite(rgba).all():
            rgba = np.ones(4)
        if entry.get("alphaMode", "OPAQUE") == "OPAQUE":
            rgba[3] = 1.0
        color = tuple(int(c) for c in to_srgb(rgba[None])[0])
        name = str(entry.get("name") or f"material_{index}")
        self.left |= _not_read(entry)
        return Material(name, color, texture, *self._surface(pbr, old))  # type: ignore[arg-type]

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
        return f"TEXCOORD_{self._uv_sets.get(material, 0)}"

    def transformed(self, st: Array, material: int | None) -> Array:
        """(N, 2) texture coordinates under KHR_texture_transform."""
        if material is None:
            return st
        pbr = as_dict(self.tree["materials"][material].get("pbrMetallicRoughness"))
        extensions = as_dict(as_dict(pbr.get("baseColorTexture")).get("extensions"))
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
            webp = as_dict(as_dict(entry.get("extensions")).get("EXT_texture_webp"))
            source = webp.get("source")
        if source is None:
            self.warnings.append("a texture in a format that isn't read (KTX2) was left out")
            return None
        if source not in self._images:
            image = self.tree["images"][source]
            try:
                if "uri" in image:
                    data = self._buffers.uri(image["uri"], "image")
                else:
                    data = bytes(self._buffers.view(image["bufferView"])[0])
                self._images[source] = decode(data, f"image {source}")
            except (InputFileError, TextureError) as error:
                problem = error.problem if isinstance(error, InputFileError) else error
                self.warnings.append(f"texture not used: {problem}")
                self._images[source] = None
        return self._images[source]


def _share(value: Any) -> float:
    """A factor of 0..1; what isn't there or is no number is 1, as the standard has it."""
    if isinstance(value, int | float) and math.isfinite(value):
        return min(max(float(value), 0.0), 1.0)
    return 1.0


def _not_read(entry: Json) -> set[str]:
    left = {
        f"{kind} map" for kind in ("normal", "occlusion", "emissive") if f"{kind}Texture" in entry
    }
    glows = any(entry.get("emissiveFactor") or ()) and "emissiveTexture" not in entry
    return left | {"emissive"} if glows else left


def as_dict(value: Any) -> Json:
    """``value`` where it is an object, else an empty one."""
    return value if isinstance(value, dict) else {}
