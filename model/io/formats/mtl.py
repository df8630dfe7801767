"""MTL: the materials of OBJ files, and the textures that they name.

Of maps it reads ``norm``, or ``map_Bump`` and ``bump`` where the image holds directions (many
exporters write normal maps so; grey heights are left out), ``map_Ke``, and ``map_ao``, which is
this program's own word for occlusion. Option ``-bm`` scales a normal map, ``-mm 1-s s`` gives
occlusion the strength s. ``Ke`` is sRGB, as ``Kd`` is.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from model.core.errors import InputFileError
from model.core.geometry import Material
from model.core.textures import (
    ImageFile,
    SurfaceMaps,
    TextureError,
    holds_normals,
    left_out,
    open_image_file,
    open_texture,
    to_linear,
)
from model.io.formats.loaded import WHITE, ReferenceRefused, read_bytes, resolve

_MAX_MTL = 64 << 20
# Options of a map_* line and how many values each takes at most.
_SINGLE = "-blendu -blendv -boost -texres -clamp -bm -imfchan -type -cc".split()
_OPTIONS = {**dict.fromkeys(_SINGLE, 1), "-mm": 2, "-o": 3, "-s": 3, "-t": 3}
_LEFT_OUT = {"map_pm": "metallic map", "map_pr": "roughness map", "map_d": "opacity map"}
_NORMALS = ("norm", "map_bump", "bump")
_BRIGHTEST = 1e3
_NUMBER = re.compile(r"^[-+]?[0-9.]+([eE][-+]?\d+)?$")


class MaterialFiles:
    """Reads material files once each, within one folder.

    Args:
        root: folder that no reference may leave.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.paths: list[Path] = []
        self._libraries: dict[Path, tuple[dict[str, Material], tuple[str, ...]]] = {}
        self._textures: dict[Path, Image.Image] = {}
        self._maps: dict[Path, ImageFile] = {}
        self._plain: dict[str, Material] = {}
        self._uv: dict[int, tuple[float, float, float, float]] = {}

    def plain(self, name: str) -> Material:
        """The same grey material for the same name."""
        return self._plain.setdefault(name, Material(name or "material"))

    def mtl_names(self, text: str, folder: Path) -> list[str]:
        """The files that the words of a ``mtllib`` line name: one, whose name may hold spaces, or
        several."""
        words = text.split()
        with suppress(ReferenceRefused, OSError):
            if len(words) < 2 or resolve(text, folder, self.root).is_file():
                return [text]
        return words if all(w.lower().endswith(".mtl") for w in words) else [text]

    def uv_transforms(self, materials: Sequence[Material]) -> npt.NDArray[np.float64] | None:
        """(M, 4) scale and offset of u and v by the options ``-s`` and ``-o`` of ``map_Kd``; None
        where no material has any."""
        if not any(id(m) in self._uv for m in materials):
            return None
        return np.array([self._uv.get(id(m), (1.0, 1.0, 0.0, 0.0)) for m in materials])

    def read(self, library: str, obj: Path, warnings: list[str]) -> dict[str, Material]:
        """Materials of the file ``library`` as named in ``obj``; {} where it can't be used."""
        path = self._existing(library, obj.parent, "material file", warnings)
        if path is None:
            return {}
        if path not in self._libraries:
            mine: list[str] = []
            try:
                text = read_bytes(path, _MAX_MTL).decode("utf-8-sig", "replace")
                self._libraries[path] = (self._parse(text, path, mine), tuple(mine))
                self.paths.append(path)
            except InputFileError as error:
                warnings.append(f"material file {path.name}: {error.problem}; shown plain")
                return {}
        materials, mine_too = self._libraries[path]
        warnings.extend(mine_too)
        return materials

    def _existing(
        self, reference: str, folder: Path, what: str, warnings: list[str]
    ) -> Path | None:
        """The file inside the root; a refused or missing one is looked for beside by its name."""
        problem = f"{what} {reference!r} is missing"
        try:
            path = resolve(reference, folder, self.root)
            if path.is_file():
                return path
        except (ReferenceRefused, OSError) as error:
            problem = f"{what} not used: {error}"
        # Exporters write absolute paths of their own machine; the file often lies beside.
        name = reference.replace("\\", "/").rsplit("/", 1)[-1].strip().strip('"')
        try:
            beside = resolve(name, folder, self.root)
            if beside.is_file():
                return beside
        except (ReferenceRefused, OSError):
            pass
        warnings.append(problem)
        return None

    def _parse(self, text: str, path: Path, warnings: list[str]) -> dict[str, Material]:
        out: dict[str, Material] = {}
        left: set[str] = set()
        name, rows = None, dict[str, str]()
        for line in [*text.splitlines(), "newmtl"]:
            words = line.split("#")[0].strip().split(None, 1)
            if not words:
                continue
            key = words[0].lower()
            if key == "newmtl":
                if name is not None:
                    out[name] = self._material(name, rows, path, warnings, left)
                    left |= {what for key, what in _LEFT_OUT.items() if key in rows}
                name, rows = words[1].strip() if len(words) > 1 else "", {}
            elif len(words) > 1:
                rows.setdefault(key, words[1].strip())
        if left:
            warnings.append(left_out(left))
        return out

    def _material(
        self, name: str, rows: dict[str, str], path: Path, warnings: list[str], left: set[str]
    ) -> Material:
        texture = None
        if "map_kd" in rows:
            texture = self.texture(_map_file(rows["map_kd"]), path, warnings)
        rgb = _floats(rows.get("kd", ""), 3) or (0.8, 0.8, 0.8)
        # Many exporters write a black or a grey Kd beside a texture and mean the texture alone.
        if texture is not None:
            rgb = (1.0, 1.0, 1.0)
        alpha = 1.0
        if d := _floats(rows.get("d", "").removeprefix("-halo"), 1):
            alpha = d[0]
        elif tr := _floats(rows.get("tr", ""), 1):
            alpha = 1.0 - tr[0]
        # Nobody means an invisible surface: some write d 0 or Tr 1 for an opaque one.
        alpha = alpha if alpha > 0.01 else 1.0
        rgba = (*rgb, alpha)
        red, green, blue, opacity = (round(255 * min(max(c, 0.0), 1.0)) for c in rgba)
        color = WHITE if texture is not None and opacity == 255 else (red, green, blue, opacity)
        metallic, roughness = (_share(rows.get(key, "")) for key in ("pm", "pr"))
        maps = self._surface_maps(rows, path, warnings, left)
        material = Material(name or "material", color, texture, metallic, roughness, maps)
        move = _uv_transform(rows.get("map_kd", ""))
        if move != (1.0, 1.0, 0.0, 0.0):
            self._uv[id(material)] = move
        return material

    def _surface_maps(
        self, rows: dict[str, str], path: Path, warnings: list[str], left: set[str]
    ) -> SurfaceMaps:
        normal, scale = None, 1.0
        for key in _NORMALS:
            found = self._map(rows.get(key), path, warnings) if normal is None else None
            if found is not None and key != "norm" and not holds_normals(found):
                left.add("bump map")
            elif found is not None:
                normal, scale = found, _option(rows[key], "-bm", 1.0)
        emissive = self._map(rows.get("map_ke"), path, warnings)
        ke = _floats(rows.get("ke", ""), 3) or (0.0, 0.0, 0.0)
        # As with Kd: a black Ke beside its map means the map alone.
        if emissive is not None and not any(ke):
            ke = (1.0, 1.0, 1.0)
        elif emissive is None and "map_ke" in rows:
            ke = (0.0, 0.0, 0.0)
        red, green, blue = to_linear(np.clip(ke, 0.0, _BRIGHTEST)).tolist()
        occlusion = self._map(rows.get("map_ao"), path, warnings)
        strength = 1.0
        if occlusion is not None:
            strength = min(max(1.0 - _option(rows["map_ao"], "-mm", 0.0), 0.0), 1.0)
        return SurfaceMaps(normal, scale, (red, green, blue), emissive, occlusion, strength)

    def _map(self, value: str | None, path: Path, warnings: list[str]) -> ImageFile | None:
        """The image that a row of the material names; its pixels don't stay in memory."""
        if value is None:
            return None
        target = self._existing(_map_file(value), path.parent, "texture", warnings)
        if target is not None and target not in self._maps:
            try:
                self._maps[target] = open_image_file(target)
                self.paths.append(target)
            except TextureError as error:
                warnings.append(f"{error}; left out")
                return None
        return None if target is None else self._maps[target]

    def texture(self, reference: str, path: Path, warnings: list[str]) -> Image.Image | None:
        """The image that the file ``path`` names; None, with a warning, where it can't be used."""
        target = self._existing(reference, path.parent, "texture", warnings)
        if target is None:
            return None
        if target not in self._textures:
            try:
                self._textures[target] = open_texture(target)
                self.paths.append(target)
            except TextureError as error:
                warnings.append(f"{error}; shown plain")
                return None
        return self._textures[target]


class OneMaterial(MaterialFiles):
    """For objects whose materials come from elsewhere: reads no files, reports none missing.

    Args:
        root: as for :class:`MaterialFiles`.
        material: of all faces.
    """

    def __init__(self, root: Path, material: Material) -> None:
        super().__init__(root)
        self.material = material

    def plain(self, name: str) -> Material:
        """The material."""
        return self.material

    def read(self, library: str, obj: Path, warnings: list[str]) -> dict[str, Material]:
        """No materials."""
        return {}

    def texture(self, reference: str, path: Path, warnings: list[str]) -> Image.Image | None:
        """The material's."""
        return self.material.texture


def _map_file(value: str) -> str:
    """The file name in a line of a map, past its options; it may hold spaces."""
    words = value.split(" ")
    at = 0
    while at < len(words) and words[at].lower() in _OPTIONS:
        room = _OPTIONS[words[at].lower()]
        is_number = words[at].lower() in ("-o", "-s", "-t", "-mm", "-bm")
        at += 1
        while room and at < len(words) - 1 and (not is_number or _NUMBER.match(words[at])):
            at += 1
            room -= 1
    return " ".join(words[at:]).strip()


def _uv_transform(value: str) -> tuple[float, float, float, float]:
    """Scale and offset of u and v in the options of a map's line."""
    words = value.lower().split()
    found = {"-s": [1.0, 1.0], "-o": [0.0, 0.0]}
    for name, numbers in found.items():
        at = words.index(name) + 1 if name in words else len(words)
        for k, word in enumerate(words[at : at + 2]):
            if not _NUMBER.match(word):
                break
            numbers[k] = float(word)
    return found["-s"][0], found["-s"][1], found["-o"][0], found["-o"][1]


def _option(value: str, name: str, default: float) -> float:
    """The first number after an option of a map's line."""
    words = value.lower().split()
    at = words.index(name) + 1 if name in words else len(words)
    found = _floats(" ".join(words[at : at + 1]), 1)
    return default if found is None else found[0]


def _share(text: str) -> float | None:
    found = _floats(text, 1)
    return None if found is None else min(max(found[0], 0.0), 1.0)


def _floats(text: str, count: int) -> tuple[float, ...] | None:
    try:
        values = tuple(float(w) for w in text.split()[:count])
    except ValueError:
        return None
    return values if len(values) == count and all(map(math.isfinite, values)) else None
