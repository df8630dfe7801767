"""Units of a surveyed cloud's coordinate system: GeoTIFF keys (OGC 19-008r4) and WKT 1 and 2.

Names of systems are not looked up: their own units count, which both forms state.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

_METRES = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937, 9005: 0.3047972654, 9036: 1000.0}
"""Metres of the units of length by their EPSG codes: m, foot, US survey foot, Clarke's foot, km."""
_NAMES = {0.3048: "feet", 1200 / 3937: "US survey feet", 1.0: "metres"}
_MODEL, _GEOGRAPHIC, _PROJECTED, _LENGTH, _VERTICAL = 1024, 2048, 3072, 3076, 4099
_GLOBE = 2
"""Value of the key of the model for longitudes and latitudes."""
_UNIT = re.compile(r'UNIT\s*[\[(]\s*"([^"]*)"\s*,\s*(\d[-+.\deE]*)', re.IGNORECASE)
_HEIGHTS = re.compile(r"\bVERT(?:_CS|CRS|ICALCRS)\s*[\[(]", re.IGNORECASE)
_ON_PLANE = re.compile(
    r"\b(?:PROJCS|PROJCRS|PROJECTEDCRS|LOCAL_CS|ENGCRS|ENGINEERINGCRS)\b", re.IGNORECASE
)
_ON_GLOBE = re.compile(r"\bGEOGCS\b|\bCS\s*[\[(]\s*ellipsoidal", re.IGNORECASE)
_TURN = re.compile(r"deg|rad|gon", re.IGNORECASE)


@dataclass(frozen=True)
class Units:
    """Units of a coordinate system.

    Attributes:
        name: of the system; "" where the file names none.
        plane: metres of a unit of x and y; None for longitudes and latitudes.
        height: metres of a unit of z.
        known: whether the file says so.
    """

    name: str = ""
    plane: float | None = 1.0
    height: float = 1.0
    known: bool = False

    @property
    def remark(self) -> str:
        """Human-readable."""
        system = f"coordinate system {self.name!r}" if self.name else "no coordinate system stated"
        if not self.known:
            return f"unit: metres taken, none stated; {system}"
        if self.plane is None:
            return f"unit: longitudes and latitudes; {system}"
        units = dict.fromkeys(_unit_name(u) for u in (self.plane, self.height))
        return f"unit: {', heights in '.join(units)}, read as metres; {system}"


def _unit_name(metres: float) -> str:
    same = (name for size, name in _NAMES.items() if abs(metres - size) < 1e-9)
    return next(same, f"{metres:g} m")


def units_of_keys(keys: Mapping[int, int], texts: str) -> Units:
    """Units by GeoTIFF keys: id → code; ``texts`` names the system."""
    code = keys.get(_PROJECTED) or keys.get(_GEOGRAPHIC)
    name = texts.strip("|\0 ").partition("|")[0] or (f"EPSG:{code}" if code else "")
    height = _METRES.get(keys.get(_VERTICAL, 0))
    if keys.get(_MODEL) == _GLOBE:
        return Units(name, None, height or 1.0, True)
    plane = _METRES.get(keys.get(_LENGTH, 0))
    if plane is None:
        return Units(name)
    return Units(name, plane, height or plane, known=True)


def units_of_wkt(text: str) -> Units | None:
    """Units by WKT, compound systems too; None where it can't be read.

    The last unit of a system is that of its axes, as those of its parts stand before.
    """
    name = re.search(r'"([^"]*)"', text)
    if name is None:
        return None
    flat, above = [*_HEIGHTS.split(text, maxsplit=1), ""][:2]
    lengths = [float(s) for unit, s in _UNIT.findall(flat) if not _TURN.search(unit) and float(s)]
    heights = [float(size) for _, size in _UNIT.findall(above) if float(size)] or lengths or [1.0]
    if _ON_PLANE.search(flat) and lengths:
        return Units(name[1], lengths[-1], heights[-1], known=True)
    if _ON_GLOBE.search(flat):
        return Units(name[1], None, heights[-1], True)
    return Units(name[1])
