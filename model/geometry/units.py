"""Sizes that suggest a wrong unit."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

UNITS = {"metres": 1.0, "centimetres": 0.01, "millimetres": 0.001, "inches": 0.0254}
"""Metres per unit."""
LARGEST, SMALLEST = 30.0, 0.005
"""Metres: plausible range of an object's longest side, a choice."""
_GUESSED = ("metres", "centimetres", "millimetres")


@dataclass(frozen=True)
class OddSize:
    """An implausible size.

    Attributes:
        question: for people, such as "1000 m tall: is the file in millimetres?".
        unit: one of :data:`UNITS` that makes it about a metre, or None.
    """

    question: str
    unit: str | None


def odd_size(bounds: npt.ArrayLike, unit_scale: float) -> OddSize | None:
    """Check the size of a single object; None if plausible.

    Args:
        bounds: (2, 3) lowest and highest corner, metres, +z up.
        unit_scale: metres per unit with which the file was read.
    """
    low, high = np.asarray(bounds, np.float64)
    side = int((high - low).argmax())
    size = float((high - low)[side])
    if SMALLEST <= size <= LARGEST or size <= 0:
        return None
    shown = f"{size:.0f} m" if size > LARGEST else f"{1000 * size:.2g} mm"
    text = f"{shown} {'tall' if side == 2 else 'wide'}"
    made = {unit: size / unit_scale * UNITS[unit] for unit in _GUESSED}
    unit = min(made, key=lambda u: abs(math.log(made[u])))
    if not SMALLEST <= made[unit] <= LARGEST:
        return OddSize(f"{text}: is the file's unit right?", None)
    return OddSize(f"{text}: is the file in {unit}?", unit)
