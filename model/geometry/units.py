"""Sizes that suggest a wrong unit."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.core.motion_lexicon import CATEGORY_ALIASES

UNITS = {"metres": 1.0, "centimetres": 0.01, "millimetres": 0.001, "inches": 0.0254}
"""Metres per unit."""
LARGEST, SMALLEST = 30.0, 0.005
"""Metres: plausible range of an object's longest side, a choice."""
_GUESSED = ("metres", "centimetres", "millimetres")


USUAL_HEIGHTS: dict[str, tuple[float, float]] = {
    "bottle": (0.15, 0.35), "bucket": (0.2, 0.4), "cart": (0.8, 1.1), "chair": (0.75, 1.2),
    "coffeemachine": (0.25, 0.45), "dishwasher": (0.8, 0.9), "display": (0.35, 0.6),
    "door": (1.9, 2.4), "foldingchair": (0.75, 1.0), "globe": (0.25, 0.5),
    "kettle": (0.18, 0.3), "kitchenpot": (0.1, 0.3), "microwave": (0.25, 0.45),
    "oven": (0.55, 1.0), "printer": (0.15, 0.5), "refrigerator": (1.5, 1.9), "safe": (0.2, 0.8),
    "storagefurniture": (0.4, 2.2), "suitcase": (0.5, 0.8), "table": (0.4, 1.1),
    "toaster": (0.17, 0.25), "toilet": (0.7, 0.9), "trashcan": (0.3, 1.1),
    "washingmachine": (0.8, 0.9),
}  # fmt: skip
"""Category → metres of usual outer heights, roughly: they only raise a question."""
_UNUSUAL = 1.4
"""Factor beyond the usual range that is asked about: small refrigerators exist."""


@dataclass(frozen=True)
class UnusualHeight:
    """A height that is unusual for a category.

    Attributes:
        low, high: the usual range, metres.
        question: human-readable, such as "4.3 m high; oven: usually 0.55 to 1 m.".
        proposed: its middle.
    """

    low: float
    high: float
    question: str

    @property
    def proposed(self) -> float:
        """Metres to scale to."""
        return math.sqrt(self.low * self.high)


def unusual_height(category: str | None, height: float) -> UnusualHeight | None:
    """Check a height in metres against those of a category; None where it is usual or unknown."""
    category = (category or "").lower()
    usual = USUAL_HEIGHTS.get(category.replace(" ", ""))
    if usual is None or usual[0] / _UNUSUAL <= height <= usual[1] * _UNUSUAL:
        return None
    low, high = usual
    text = f"{height:.2g} m high; {category}: usually {low:.2g} to {high:.2g} m."
    return UnusualHeight(low, high, text)


def category_of(name: str) -> str | None:
    """The category with a usual height in an object's name; the thing comes last."""
    words = re.findall(r"[a-z]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower())
    for end in range(len(words), 0, -1):
        for start in (end - 2, end - 1):
            word = "".join(words[max(start, 0) : end])
            if (category := CATEGORY_ALIASES.get(word, word)) in USUAL_HEIGHTS:
                return category
    return None


@dataclass(frozen=True)
class OddSize:
    """An implausible size.

    Attributes:
        question: human-readable, such as "1000 m tall: is the file in millimetres?".
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
