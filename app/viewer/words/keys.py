"""Words of the sheet of keys and of the command palette, and about looking: views, one part alone,
measuring, edges.
"""

from __future__ import annotations

from typing import Final

from app.viewer.words.common import Message

TITLE: Final = "Keys and mouse"
CLOSE: Final = "Close (Esc)"
MESSAGES, NO_MESSAGES = "Messages", "No messages yet"
SHEET: Final[tuple[tuple[str, str], ...]] = (
    ("Click", "add to the selected part"),
    ("Shift + click", "remove from it"),
    ("1 … 9, 0", "select a part; 0 is the base"),
    ("Shift + 1 … 6, 0", "the next click makes a door, …; 0: suggested category"),
    ("Tab, Shift+Tab", "larger, smaller mask (Alt + wheel); next joint or finding"),
    ("Alt + drag", "box (Shift subtracts)"),
    ("L + drag", "lasso (Shift subtracts)"),
    ("I + drag", "brush, [ ] size (Shift subtracts)"),
    ("K", "cut along a line"),
    ("K, K", "cut out a rectangle"),
    ("M", "merge with the part clicked next; in Joints see below"),
    ("O", "add everything connected"),
    ("U, J", "grow, shrink"),
    ("Z", "find the same shape"),
    ("V", "preview on or off"),
    ("H, Delete", "hide, delete the part"),
    ("Esc", "cancel; also a waiting acceptance"),
    ("P", "predict joints"),
    ("Space, Shift+Space", "play or stop; the whole scene"),
    ("R, C", "reset pose, frame object"),
    ("M; T, F", "joint: next likely motion; next type, flip axis"),
    ("G", "axis handles on or off"),
    ("Drag a limit's grip", "set the limit; Shift snaps to 5° or 5 mm"),
    ("Number pad 1, 3, 7; 9; 5; 0", "front, right, top (Ctrl: back …); opposite; flat; four"),
    ("/; Shift+M", "isolate the part; measure between two clicks"),
    ("F8", "read the latest messages again"),
    ("Y; Shift+Y", "accept; again: accept anyway; what is on hold"),
    ("X, then 1 … 6", "reject, with a reason"),
    ("N, B; Shift+I, C", "next, previous object; instructions, comment"),
    ("Enter; Backspace", "prepare a scan, apply what is shown; scene: edit, go back"),
    ("Prepare: Tab; 1, 3, 7", "other up direction; front, side, top"),
    ("Prepare: R, F, G", "rotate 90°, flip, rotation handle"),
    ("Prepare: K; K, K; M", "level by floor, by edge; measure"),
    ("Prepare: Delete", "remove what is grey"),
    ("Ctrl+Z, Ctrl+Shift+Z", "undo, redo"),
    ("Ctrl+K; F6", "command palette; panels by keyboard"),
    ("Drag, right drag, wheel", "orbit, pan, zoom to the pointer"),
    ("Double click; drag a number", "frame (in Annotate: Ctrl); change it (Shift: fine)"),
    ("W A S D Q E, arrows", "move the camera"),
)
"""Each fits a line of the sheet, and all of them a small screen."""

UNDO, REDO = "Undo", "Redo"
PREDICT: Final = "Predict joints"
PLAY, PLAY_SCENE = "Play joints", "Play all joints of the scene"
RESET_POSE: Final = "Reset pose"
NEXT_CHOICE, PREVIOUS_MASK = "Next joint, mask or finding", "Previous mask"
NEXT_TYPE, FLIP_AXIS, HANDLES = "Next joint type", "Flip axis", "Axis handles"
HIDE, DELETE = "Hide or show part", "Delete part"
TAKE_CATEGORY: Final = "Take the suggested category"
CUT: Final = "Tool: Cut along a line or a rectangle"
PREVIEW: Final = "Preview"
EXCLUDE_ROOM, EXTRACT = "Exclude floor and walls", "Extract this part as an object"
ACCEPT, HELD, REJECT = "Accept", "Open what is on hold", "Reject"
NEXT, PREVIOUS = "Next object", "Previous object"
FRAME: Final = "Frame object"
INSTRUCTIONS: Final = "Instructions"
NEXT_COMMENT: Final = "Next open comment"
PREPARE: Final = "Prepare, or apply what is proposed"
EDIT_IN_SCENE, BACK = "Edit the selected object", "Back to the scene"


def select_part(part: int) -> str:
    """Select a part by its number."""
    return f"Select {f'part {part}' if part else 'the base'}"


name_part = Message("Part name {number}: for the next click")
tool = Message("Tool: {label}")
step = Message("Step: {name}")


VIEW_NAMES: Final[dict[str, str]] = {
    "front": "View: front",
    "back": "View: back",
    "right": "View: right",
    "left": "View: left",
    "top": "View: top",
    "bottom": "View: bottom",
    "opposite": "View: opposite side",
}
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
