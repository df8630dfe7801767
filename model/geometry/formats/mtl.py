"""MTL: the materials of OBJ files, and the textures that they name."""

from __future__ import annotations

import math
import re
from pathlib import Path

from PIL import Image

from model.errors import InputFileError
from model.geometry.formats.loaded import WHITE, read_bytes
from model.geometry.formats.references import ReferenceRefused, resolve
from model.geometry.formats.textures import TextureError, left_out, open_texture
from model.geometry.mesh import Material

_MAX_MTL = 64 << 20
# Options of a map_* line and how many values each takes at most.
_OPTIONS = {
    "-blendu": 1, "-blendv": 1, "-boost": 1, "-mm": 2, "-o": 3, "-s": 3, "-t": 3, "-texres": 1,
    "-clamp": 1, "-bm": 1, "-imfchan": 1, "-type": 1, "-cc": 1,
}  # fmt: skip
_LEFT_OUT = {
    "norm": "normal map", "map_bump": "normal map", "bump": "normal map",
    "map_ke": "emissive", "map_pm": "metallic map", "map_pr": "roughness map",
}  # fmt: skip
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
        self._plain: dict[str, Material] = {}

    def plain(self, name: str) -> Material:
        """The same grey material for the same name."""
        return self._plain.setdefault(name, Material(name or "material"))

    def read(self, library: str, obj: Path, warnings: list[str]) -> dict[str, Material]:
        """Materials of the file ``library`` as named in ``obj``; {} where it can't be used."""
        path = self._existing(library, obj.parent, "material file", warnings)
        if path is None:
            return {}
        if path not in self._libraries:
            mine: list[str] = []
            try:
                text = read_bytes(path, _MAX_MTL).decode("utf-8", "replace")
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
        # Exporters leave the absolute path of their own machine; the file often lies beside.
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
                    out[name] = self._material(name, rows, path, warnings)
                    left |= _not_read(rows)
                name, rows = words[1].strip() if len(words) > 1 else "", {}
            elif len(words) > 1:
                rows.setdefault(key, words[1].strip())
        if left:
            warnings.append(left_out(left))
        return out

    def _material(
        self, name: str, rows: dict[str, str], path: Path, warnings: list[str]
    ) -> Material:
        texture = None
        if "map_kd" in rows:
            texture = self._texture(_map_file(rows["map_kd"]), path, warnings)
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
        return Material(name or "material", color, texture, metallic, roughness)

    def _texture(self, reference: str, path: Path, warnings: list[str]) -> Image.Image | None:
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


def _map_file(value: str) -> str:
    """The file name in a ``map_Kd`` line, past its options; it may hold spaces."""
    words = value.split(" ")
    at = 0
    while at < len(words) and words[at].lower() in _OPTIONS:
        room = _OPTIONS[words[at].lower()]
        is_number = words[at].lower() in ("-o", "-s", "-t")
        at += 1
        while room and at < len(words) - 1 and (not is_number or _NUMBER.match(words[at])):
            at += 1
            room -= 1
    return " ".join(words[at:]).strip()


def _not_read(rows: dict[str, str]) -> set[str]:
    """What a material has that :class:`Material` has no place for."""
    left = {what for key, what in _LEFT_OUT.items() if key in rows}
    return left | {"emissive"} if any(_floats(rows.get("ke", ""), 3) or ()) else left


def _share(text: str) -> float | None:
    found = _floats(text, 1)
    return None if found is None else min(max(found[0], 0.0), 1.0)


def _floats(text: str, count: int) -> tuple[float, ...] | None:
    try:
        values = tuple(float(w) for w in text.split()[:count])
    except ValueError:
        return None
    return values if len(values) == count and all(map(math.isfinite, values)) else None
