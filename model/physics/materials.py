"""Materials of parts: an editable table of densities and wall thicknesses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from model.core.articulated_object import Part
from model.core.errors import ConfigurationError, InputFileError
from model.core.files import read_json
from model.core.resources import static_assets

FORMAT = 1


@dataclass(frozen=True)
class PartMaterial:
    """The material of a part.

    Attributes:
        density: kg/m³.
        thickness: metres, of the walls of hollow parts.
    """

    density: float
    thickness: float


@dataclass(frozen=True)
class MaterialTable:
    """Materials by name, and the material of part names and categories.

    The words of a part's name count first, then the object's category, then ``default``.
    """

    materials: Mapping[str, PartMaterial]
    categories: Mapping[str, str]
    parts: Mapping[str, str]
    default: str

    def of(self, part: Part, category: str | None) -> PartMaterial:
        """Return the material of a part."""
        return self.materials[self.name_of(part, category)]

    def name_of(self, part: Part, category: str | None) -> str:
        """Return the name of a part's material, such as "wood"."""
        words = (part.name or "").lower().replace("_", " ").split()
        named = next((self.parts[w] for w in words if w in self.parts), None)
        known = {k.lower(): v for k, v in self.categories.items()}
        return named or known.get((category or "").lower(), self.default)

    def with_density(self, density: float) -> MaterialTable:
        """Replace the density of all materials, kg/m³."""
        made = {k: replace(m, density=density) for k, m in self.materials.items()}
        return replace(self, materials=made)

    def only(self, material: str) -> MaterialTable:
        """Use one material for everything.

        Raises:
            ConfigurationError: for an unknown material.
        """
        if material not in self.materials:
            known = ", ".join(self.materials)
            raise ConfigurationError(f"no material {material!r}; known are {known}")
        return replace(self, categories={}, parts={}, default=material)


def read_materials(path: str | Path | None = None) -> MaterialTable:
    """Read the bundled table, or one of the same format.

    Raises:
        InputFileError: naming the problem in the file.
    """
    path = static_assets() / "physics" / "materials.json" if path is None else Path(path)
    data = read_json(path)
    try:
        table = _table(data)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise InputFileError(
            path, f"is no table of materials ({error})",
            "it needs materials with density and thickness above 0, categories, parts and default",
        ) from error  # fmt: skip
    used = {table.default, *table.categories.values(), *table.parts.values()}
    unknown = sorted(used - set(table.materials))
    if unknown:
        raise InputFileError(path, f"uses undefined materials: {', '.join(unknown)}")
    return table


def _table(data: Any) -> MaterialTable:
    if data.get("format", FORMAT) > FORMAT:
        raise ValueError(f"format {data['format']} is newer than {FORMAT}")
    materials = {
        str(name): PartMaterial(float(entry["density"]), float(entry["thickness"]))
        for name, entry in data["materials"].items()
    }
    for name, made in materials.items():
        if not (0 < made.density < float("inf") and 0 < made.thickness < float("inf")):
            raise ValueError(f"{name}: density and thickness must be above 0")
    return MaterialTable(
        materials, dict(data.get("categories", {})), dict(data.get("parts", {})),
        str(data["default"]),
    )  # fmt: skip
