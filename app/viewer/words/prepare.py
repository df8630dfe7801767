"""Words of the prepare step."""

from __future__ import annotations

from typing import Final

import numpy as np

from app.viewer.words.common import Message
from model.geometry.cleaning import CLUTTER, OUTLIER, SUPPORT

PREPARE: Final = "Prepare (Enter)"
APPLY: Final = "Apply (Enter)"
CONTINUE: Final = "Annotate (Enter)"

# --- what was found

SEARCHING: Final = "*Finding the floor and the upright direction…*"
APPLIED_WHEN_FOUND: Final = "Applied once floor and orientation are found · again: go on without"
NOT_FOUND: Final = "**Auto** finds floor and orientation."
UPRIGHT: Final = "**Upright,** nothing to remove."
GIVEN: Final = "**Shown in another direction.**"
DOUBTFUL: Final = "**Maybe not upright;** the up direction is uncertain."
DISCARDS: Final = "⚠ Changes here discard parts and joints; undo restores them."
KINDS: Final[dict[int, str]] = {
    SUPPORT: "Support",
    CLUTTER: "Other objects",
    OUTLIER: "Outliers",
}
KINDS_HINT: Final = "Support: table, floor and walls. What is checked is grey: Enter removes it"


def tilted(tilt: float, up: tuple[float, float, float], confidence: float) -> str:
    """Likely up direction: radians of tilt, the direction, confidence 0..1."""
    sure = f"(confidence {100 * confidence:.0f}\u00a0%)"
    axis = int(np.abs(up).argmax())
    if abs(up[axis]) > np.cos(np.radians(3)):
        return f"**{'−' if up[axis] < 0 else ''}{'XYZ'[axis]} is up in this file** {sure}."
    return f"**Tilted by {np.degrees(tilt):.0f}°** {sure}."


def kind(kind: int, count: int) -> str:
    """A kind of elements that don't belong to the object, and their number."""
    return f"{KINDS[kind]} ({f'{count:,}' if count < 10_000 else f'{count / 1000:,.0f}k'})"


def enter(levels: bool, removes: bool) -> str:
    """Effect of Enter now; "" if it changes nothing."""
    does = ["levels it"] * levels + ["removes what is grey"] * removes
    text = f"**Enter** {' and '.join(does)}." if does else ""
    return f"{text} **Tab:** other directions." if levels else text


def also(kinds: dict[int, int]) -> str:
    """Other kinds of elements in the scan."""
    names = [KINDS[k].lower() for k in kinds]
    return f"Found: {' · '.join(names)}." if names else ""


def applied(tilt: float, kinds: tuple[int, ...], more: bool, size: str = "") -> str:
    """Label of a step for undo: radians of tilt, kinds removed, whether more is, the size given."""
    parts = [f"level by {np.degrees(tilt):.0f}°"] * bool(tilt) + [size] * bool(size)
    removed = [KINDS[k].lower() for k in kinds] + ["marked points"] * more
    if removed:
        parts.append(f"remove {', '.join(removed)}")
    return "; ".join(parts) or "prepare"


# --- orientation

LEVEL: Final = "Level by"
LEVEL_ACTIONS: Final = ("Auto", "Floor", "Edge", "Handle")
LEVEL_HINT: Final = (
    "Floor (K): click three points of it. Edge (K twice): click the lower and the upper end of an "
    "upright edge. Handle (G): drag the rings"
)
ROTATE: Final = "Rotate 90°"
ROTATE_ACTIONS: Final = ("X", "Y", "Z", "View")
ROTATE_HINT: Final = "View (R): about the direction of view. F flips the object upside down"
VIEW: Final = "View"
VIEW_ACTIONS: Final = ("Front", "Side", "Top")
VIEW_HINT: Final = "Keys 1, 3, 7"
bold = Message("**{text}**")
rotated = Message("rotate 90° about {axis}")
TURNED: Final = "rotate by the handle"
FLIPPED: Final = "flip upside down"

# --- size

HEIGHT: Final = "Height [m]"
UNIT: Final = "File's unit"
SCALE: Final = "Scale"
SCALE_ACTIONS: Final = ("Set", "Measure")
MEASURE_HINT: Final = (
    "Set: scale to the height above. Measure (M): click two points, type the length between them, "
    "then Set"
)
SAME_PLACE: Final = "the points are at one place or in one line: click others"
BAD_SIZE: Final = "a size must be a positive number of metres"
LENGTH: Final = "Length [m]"
resized = Message("{metres} m high")
measured = Message("a length of {metres} m")
unit_set = Message("read in {unit}")
use_height = Message("Use {metres:.2g} m")

# --- cleaning

REMOVE: Final = "Remove"
REMOVE_ACTIONS: Final = ("Grey", "Lasso", "Brush", "Restore")
REMOVE_HINT: Final = (
    "Grey (Del): removes what is grey. Lasso (L), brush (I) and box (Alt+drag) remove what they "
    "cover; with Shift they restore it. Restore: brings everything back"
)
CONFIDENCE: Final = "Min. confidence"
CROP: Final = "Crop box"
CROP_AXES: Final = ("Crop X", "Crop Y", "Crop Z")
NOTHING_MARKED: Final = "Nothing is marked"
removed = Message("Removed: {count:,}.")
by_hand = Message("points under the {tool}")

# --- below the picture

HINTS: Final[dict[str, str]] = {
    "floor": "Floor: click three points of it · K: upright edge · Esc cancels",
    "edge": "Upright edge: click its lower, then its upper end · Esc cancels",
    "length": "Length: click two points · Esc cancels",
}
HINT_STROKES: Final[dict[str, str]] = {
    "lasso": "Lasso: draw around what to remove · Shift restores · Esc ends",
    "brush": "Brush: paint what to remove · Shift restores · [ ] size · Esc ends",
}
