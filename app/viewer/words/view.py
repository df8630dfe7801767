"""Words about looking: views, one part alone, measuring, edges."""

from __future__ import annotations

from typing import Final

from app.viewer.words.message import Message

VIEW_NAMES: Final[dict[str, str]] = {
    "front": "View: front", "back": "View: back", "right": "View: right", "left": "View: left",
    "top": "View: top", "bottom": "View: bottom", "opposite": "View: opposite side",
}  # fmt: skip
FLAT_OR_NOT: Final = "View: perspective or flat"
FLAT, PERSPECTIVE = "Flat view (5: perspective)", "Perspective"
ISOLATE: Final = "Isolate part"
ISOLATE_TIP: Final = "Isolate (/): the selected part alone; again: all"
NOTHING_ISOLATED: Final = "The selected part is not there yet, or is all there is"
MEASURE: Final = "Measure"
MEASURE_TIP: Final = "Measure (Shift+M): click two points; Esc ends"
HINT_FIRST: Final = "Measure: click the first point. Esc ends"
HINT_SECOND: Final = "Click the second point. Esc ends"
HINT_MEASURED: Final = "Click to measure again. Esc ends"
EDGES: Final = "Edges"
EDGES_HINT: Final = "Lines where surfaces bend by more than 30°, on objects without a texture"

steps = Message("{text} (X {x}, Y {y}, Z {z})")


def length(metres: float) -> str:
    """A length in the unit that suits it: mm below 10 cm, cm below 1 m, else m."""
    size = abs(metres)
    if size < 0.1:
        return f"{1000 * metres:.1f} mm"
    return f"{100 * metres:.1f} cm" if size < 1.0 else f"{metres:.3f} m"
