"""Words of the annotate step and of its tools."""

from __future__ import annotations

from typing import Final

from app.server.tool_tasks import NEXT_MASK
from app.viewer.words.common import Message, plural

# --- what to do next

CLICK_A_PART: Final = (
    "**Pick a name, then click that part.** Shift+click removes. **1**, **2**, … select a part."
)
REFINE: Final = "**Refine:** click to add, Shift+click to remove."
REFINE_WITH_MASKS: Final = (
    "**Refine:** **Tab** shows other masks; click to add, Shift+click to remove."
)
DELETE_PART: Final = "**Delete** deletes the part."
IS_ACCEPTED: Final = "**Accepted.** Reopen it in Review to edit it."
IS_ROOM: Final = (
    "**A room?** Exclude floor and walls first. "
    "Then click an object, or Alt+drag a box around it, and extract it."
)
IN_ROOM: Final = (
    "**Click an object**, or Alt+drag a box around it, and extract it. "
    "Shift+click removes; **Tab** shows other masks."
)
extracting = Message(
    "**Part {part}** will be extracted. To separate neighbors with one common front, "
    "press **K** and click above and below the border."
)
INSTRUCTIONS: Final = "Instructions (Shift+I)"
NO_INSTRUCTIONS: Final = "The project has no instructions"

# --- category and parts

CATEGORY: Final = ("Category", "Other category")
SUGGESTIONS: Final = "Shift+0"
SUGGESTIONS_HINT: Final = (
    "Suggestions, from the file's name and the objects before; Shift+0 takes the first one"
)
NO_SUGGESTION: Final = "No category is suggested"
PARTS: Final = "Parts"
PART: Final = "Part"
ADD_PART: Final = "Add part"
DELETE_THIS: Final = "Delete (Delete)"
PART_NAME: Final = ("Part name", "Other name")
UNNAMED, BASE = "part", "base"
DELETE: Final = "Delete"
DELETE_ELSEWHERE: Final = "Parts are deleted in the Annotate step"
DELETE_BASE: Final = "Part 0 is the base and can't be deleted"


def part_hide(hidden: bool) -> str:
    """The button that hides a part."""
    return "Show (H)" if hidden else "Hide (H)"


def part_button(part: int, name: str, share: str, hidden: bool) -> str:
    """A part in the list."""
    words = [str(part), name[:24], share]
    return " · ".join(w for w in words if w) + (" (hidden)" if hidden else "")


of_a_kind = Message("{known} accepted objects")


def take_alike(count: int, name: str) -> str:
    """The button that takes the parts that accepted objects have."""
    return f"Like {name}: take {count} {plural('part', count)} (Enter)"


def alike_taken(count: int, name: str) -> tuple[str, str]:
    """Their parts were taken: title and text."""
    text = f"{count} {plural('part', count)} with names. P predicts their joints; undo reverts"
    return f"Like {name}", text


category_set = Message("Category: {category}")
name_set = Message("Part {part}: {name}")
NOT_COMPARED: Final = "Busy: only this part is named"


def named_too(name: str, count: int) -> tuple[str, str]:
    """Parts of the same shape got the same name: title and text."""
    return SAME_SHAPE, f"{count} more {plural('part', count)} named {name}. Undo reverts all"


# --- tools

SAME_SHAPE: Final = "Same shape"
TOOL_ROWS: Final[tuple[dict[str, str], ...]] = (
    {"lasso": "Lasso", "brush": "Brush", "cut": "Line", "rectangle": "Rectangle"},
    {NEXT_MASK: "Next", "connected": "Connected", "grow": "Grow", "shrink": "Shrink"},
    {"same shape": SAME_SHAPE, "mirror": "Mirror", "propose": "All parts"},
    {"merge": "Merge", "split": "Split", "leftovers": "Fragments"},
)
"""The tool's recorded name → its button, by what they are for."""
TOOL_TIPS: Final[dict[str, str]] = {
    "lasso": "Lasso (L): draw around what to add; Shift subtracts",
    "brush": "Brush (I): paint what to add; Shift subtracts; [ ] size",
    "cut": "Cut along a line (K): click two points",
    "rectangle": "Cut out a rectangle (K, K): click opposite corners of a door or drawer",
    NEXT_MASK: "Larger mask for the last click (Tab; Shift+Tab: smaller; Alt+wheel)",
    "connected": "Connected (O): add everything connected to the last click",
    "grow": "Grow (U) by one ring of neighbors, never across a gap",
    "shrink": "Shrink (J) by one ring of neighbors",
    "same shape": "Same shape (Z): find all pieces of this shape, such as knobs",
    "mirror": "Mirror: the counterpart across the symmetry plane",
    "propose": "All parts: propose all moving parts",
    "merge": "Merge (M): click the part to merge into the selected one",
    "split": "Split: one part per connected piece",
    "leftovers": "Fragments: assign small pieces to the part that they touch",
}
PREVIEW: Final = "Preview"
PREVIEW_HINT: Final = "Preview (V): dots show what a click would select"
TOUCH: Final = "Touch screen"
TOUCH_HINT: Final = "Touch screen: taps select, without keys"
CUT, CUT_RECTANGLE, NEXT = "Cut", "Cut a rectangle", "Next mask"
NOTHING_FOUND: Final[dict[str, str]] = {
    "split": "The part is one connected piece",
    "same shape": "No similar parts found",
    "leftovers": "There are no fragments",
    "mirror": "No counterpart, or it is a part already",
    "propose": "No more parts found: click on one",
    NEXT_MASK: "No other mask: click on the part first",
    "merge": "That is the selected part: select the part to keep, then click the other one",
}
NO_CHANGE: Final = "Nothing to change"
CANCELLED: Final = "Cancelled. Nothing was changed"
MERGE: Final = "Merge"
NO_PARTS: Final = "No parts yet: click on one first"
SHARED_TRIANGLE: Final = (
    "Both clicks are on one triangle",
    "It belongs to the last one. To cut it: K for a line, K twice for a rectangle",
)
NOTHING_THERE: Final = "Nothing there"
CLICK_WAITS: Final = "It waits for the workers and counts when they are done"
CLICK_PASSED: Final = (
    "Not counted",
    "The object, the step or the tool changed before the workers could answer: do it again",
)
BASE_IS_FIXED: Final = "The base doesn't move"
merge_with = Message("Merge with part {part}")


def found(count: int) -> str:
    """A tool made new parts."""
    return f"{count} new {plural('part', count)}. Undo reverts"


def connected(count: int, kind: str, share: str) -> str:
    """Number of elements ("face" or "point") that were added."""
    return f"Connected: {count:,} {plural(kind, count)}, {share} of all"


def nothing_under(tool: str) -> tuple[str, str]:
    """A stroke or box that selects nothing: title and text."""
    return f"Nothing under the {tool}", "Draw over the object"


# --- below the picture

hint_label = Message("New {name}: click on it · Esc cancels")
HINT_MERGE: Final = "Merge: click the part to merge into the selected one · Esc cancels"
HINT_CUT: Final = (
    "Cut: click the first point (Shift+click: three points) · K: rectangle · Esc cancels"
)
HINT_CORNER: Final = "Cut a rectangle: click a corner of a door or drawer · Esc cancels"
HINT_OPPOSITE: Final = (
    "Cut a rectangle: click the opposite corner (Shift: no snapping) · Esc cancels"
)
HINT_STROKES: Final[dict[str, str]] = {
    "lasso": "Lasso: draw around what to add · Shift subtracts · Esc ends",
    "brush": "Brush: paint what to add · Shift subtracts · [ ] size · Esc ends",
}
HINT_INEFFECTIVE: Final = "Clicks change little here · Tab: other mask · L: lasso · K: cut"


hint_finds = Message(
    "Similar part {at} of {count} · Enter: take all · ← →: next · Delete: leave out · Esc: cancel"
)


def hint_points(left: int) -> str:
    """Points that a cut still needs."""
    return f"Cut: {left} more {plural('point', left)} · Esc cancels"


hint_mask = Message("Mask {number} of {total}: {share} · Tab: larger · Shift+Tab: smaller")
# --- prompts

PROMPTS: Final = "Prompts"
PROMPTS_REMOVE: Final = "Remove clicks"
PROMPT_LIST: Final = "Clicks"
PROMPT_ACTIONS: Final = ("Last", "Of this part", "All")
NO_PROMPTS: Final = "No prompts yet."
NONE_ON_PART: Final = "This part has no prompts"
OTHER_MASK: Final = "other mask"
OTHER_TOOLS: Final[dict[str, str]] = {"box": "Box", "source": "From the file"}
"""Recorded names that no button has."""
prompt_count = Message("{here} on this part, {total} in total.")


def prompt_click(sign: str, position: tuple[float, float, float]) -> str:
    """A click, in metres."""
    x, y, z = position
    return f"{sign}  {x:.3f}, {y:.3f}, {z:.3f} m"


def prompt_region(sign: str, tool: str, count: int, kind: str) -> str:
    """A region of elements ("face" or "point")."""
    return f"{sign}  {tool_label(tool)} · {count:,} {plural(kind, count)}"


def tool_label(tool: str) -> str:
    """A recorded tool as on its button."""
    labels = {name: label for row in TOOL_ROWS for name, label in row.items()}
    return (labels | OTHER_TOOLS).get(tool, tool.capitalize())


# --- source

EXTRACT_FOLDER: Final = "Extract from a scan"
EXCLUDE: Final = "Exclude"
EXCLUDE_ACTIONS: Final = ("Floor and walls", "This part")
EXCLUDE_HINT: Final = "Excluded geometry is ignored until it is restored"
EXCLUDE_ROOM: Final = "Exclude floor and walls"
EXCLUDE_BASE: Final = "select the part to exclude; the base stays"
RESTORE_ALL: Final = "Restore all"
EXTRACT: Final = "Extract this part as an object"
EXTRACT_HINT: Final = "It joins the queue and keeps its place in this scan"
EXTRACT_BASE: Final = "select the part to extract; part 0 is the rest of the scan"
EXTRACT_IN_SCENE: Final = "in a scene, go back and press “Extract an object”"
EXTRACT_HELP: Final = (
    "For a scan of several objects: exclude floor and walls, select one object with clicks or a "
    "box, and extract it."
)


def extracted_from(scene: str, position: tuple[float, float, float]) -> str:
    """Position of an extracted object in its scene, in metres."""
    x, y, z = position
    return f"Extracted from {scene}, where its origin is at {x:.3f}, {y:.3f}, {z:.3f} m."


def excluded(what: str, count: int) -> str:
    """Elements of the source that are ignored."""
    return f"Excluded: {what}, {count:,} {plural('element', count)}."


extracted = Message("Extracted: {names}.")
