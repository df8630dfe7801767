"""Words of the joints step."""

from __future__ import annotations

from typing import Final

from app.viewer.words.common import Message
from model.core.composite_joints import COMPOSITES
from model.core.joint import value_text

EMPTY: Final = "No joints yet. Click the moving parts, then predict."
ASK_CATEGORY: Final = "**What is the object?**"
PART_NAME: Final = "Part name"
CATEGORY: Final = "Category"
ALL_NAMED: Final = "All parts are named; rename them in Annotate"
FOLDER: Final = "Selected joint"
ALL_JOINTS: Final = "All joints"
ROW_EDIT: Final = "Edit"
JOINT: Final = "Joint"
TYPE: Final = "Type"
MOTION: Final = "Motion"
MOTIONS: Final = {row.title: kind for kind, row in COMPOSITES.items()}
"""Entry of the list → kind of the motion."""
MOTION_HINT: Final = "Screw, ball and others take several joints"
PITCH: Final = "Pitch [mm a turn]"
PITCH_START: Final = 4.0
"""mm a turn of a new screw, about that of a bottle's cap."""
FOLLOWS: Final = "Follows"
FOLLOWS_HINT: Final = "As gears do: this joint moves with another one"
RATIO: Final = "Ratio"
RATIO_HINT: Final = "Radians or metres for each radian or metre of the other joint"
LIKELY: Final = "Likely (M)"
LIKELY_HINT: Final = "The likeliest motions by the prediction; 2 and 3 have numbered axes"
ONE_LIKELY: Final = "The prediction has no other motion for this joint"
PARENT: Final = "Parent"
SET_PARENT: Final = "Set parent"
HINT_PARENT: Final = "Click the part that carries it, in the tree or the picture. Esc ends"
AXIS: Final = "Axis"
SET_AXIS: Final = "Set axis"
SET_AXIS_ACTIONS: Final = ("X", "Y", "Z", "Flip (F)")
ALIGN_AXIS: Final = "Align axis"
ALIGN_AXIS_ACTIONS: Final[dict[str, str]] = {
    "Longest": "axis Long",
    "Middle": "axis Middle",
    "Shortest": "axis Short",
}
"""Button → what the axis is snapped to."""
ALIGN_AXIS_HINT: Final = "Align to the part's longest, middle or shortest side"
ORIGIN: Final = "Origin [mm]"
SNAP_ORIGIN: Final = "Snap origin"
SNAP_ORIGIN_ACTIONS: Final[dict[str, str]] = {
    "Box edge": "Box edge",
    "Contact": "Contact",
    "Center": "Centre",
}
LIMITS: Final = "Limits"
FREE_RANGE, CLOSED = "Collision-free", "Closed at 0"
LIMITS_HINT: Final = (
    "Collision-free: as far as nothing collides. Closed at 0: the scanned pose becomes a limit"
)
HANDLES: Final = "Axis handles (G)"
FILE_NAME: Final = "Joint name"
FILE_NAME_HINT: Final = "Used in URDF and other exports"
COPY: Final = "Copy to equal parts"
COPY_HINT: Final = "Parts of the same shape get this joint, mirrored ones its mirror image"
NONE_EQUAL: Final = "No other part has this shape"
COPIED: Final = "Copied"
copied = Message("to {titles}")
LOCK: Final = "Lock joint"
LOCK_HINT: Final = "New predictions leave it unchanged"
NO_JOINT: Final = "No joint."
SELECT_JOINT: Final = ("Select a joint first", "Tab selects the next one")
NEED_JOINT: Final = "select a joint first: click a part, or press Tab"
UNCHANGED: Final = "No change"
ALREADY_THERE: Final[dict[str, str]] = {
    "Box edge": "The axis is on an edge of the part's box",
    "Contact": "The axis is where the parts touch",
    "Centre": "The origin is at the center of the part's box",
    "free range": "The range ends where the part would collide",
    "closed": "One limit is 0",
}
ALREADY_ALIGNED: Final = "The axis is aligned to that side of the part's box"
SET_MANUALLY: Final = "Set manually."
UNLIMITED: Final = "unlimited"
EDITED: Final = "edited"
NEW: Final = "new, not predicted"
BEYOND_A_TURN: Final = "The range exceeds one turn; a continuous joint has no limits."
SCAN_OUTSIDE: Final = "The scanned pose (0) is outside the range."


def likely(rank: int, type: str, axis: str) -> str:
    """A motion of the prediction, as in "2 revolute -Z"; ``axis`` is "" where it has none."""
    return f"{rank} {type} {axis}".rstrip()


def ask_name(part: str, other_selected: bool) -> str:
    """Ask what an unnamed part is; the selected joint may be of another part."""
    return f"**What is {part}?**" + " (The selected part is named.)" * other_selected


def ask_why(settled: bool) -> str:
    """Reason to give a name or category."""
    if settled:
        return "The next prediction uses it (P)."
    return "Naming this improves the prediction."


def reset_to(file: bool) -> str:
    """The button that drops edits."""
    return "Reset to the file's joint" if file else "Reset to prediction"


def limit(which: str, unit: str) -> str:
    """A field for the "lower" or "upper" limit."""
    return f"{which.capitalize()} [{unit}]"


def limit_label(which: str, value: float, rotates: bool) -> str:
    """Beside a limit's grip in the picture."""
    return f"{which} {value_text(value, rotates)}"


def pose(name: str, unit: str) -> str:
    """A slider that moves a joint."""
    return f"{name or 'Pose'} [{unit}]"


def confidence(share: float) -> str:
    """Confidence of a prediction, 0..1."""
    return f"{100 * share:.0f}\u00a0%"  # never alone on the next line


span = Message("{lower} to {upper}")


def tree_line(kind: str, confidence: str, locked: bool, odd_range: bool, collides: bool) -> str:
    """A joint of the tree; ``kind`` holds type and range, ``confidence`` may say "edited"."""
    sure = f"confidence\u00a0{confidence}" if confidence.endswith("%") else confidence
    marks = (locked, "locked"), (odd_range, "⚠ range"), (collides, "⚠ collision")
    words = [kind, sure, *(word for marked, word in marks if marked)]
    return " · ".join(w for w in words if w)


follows = Message("follows {leader}")


def edited(file: str, note: str) -> str:
    """A joint was edited; ``note`` says how it was predicted, where it isn't from a ``file``."""
    axis = f"axis in {file}" if file else f"predicted axis{f' ({note})' * bool(note)}"
    return f"Edited. The gray arrow is the {axis}."


def collision(other: str, at: str, millimetres: float) -> str:
    """The first collision over a joint's range."""
    return (
        f"⚠ Collides{f' with {other}' * bool(other)} at {at}, penetration {millimetres:.1f} mm "
        "(red ball)."
    )


carries = Message("{part} can't hang on {other}: this would create a cycle")
no_limits = Message("a {kind} joint has no limits: choose another type first")
gone = Message("{title} no longer exists: select again")
