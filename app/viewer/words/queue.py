"""Words of the queue, and of exporting from it."""

from __future__ import annotations

from typing import Final

from app.viewer.words.common import HELD, STATES, UNREADABLE, Message, plural

TITLE: Final = "Queue"
ON_HOLD_HINT: Final = "Accepted before the checks were done, which then found problems"
UPLOAD: Final = "Add files"
UPLOAD_HINT: Final = (
    "Mesh or scan (GLB, PLY, STL, OBJ, PCD, XYZ). Select an OBJ together with its MTL and "
    "textures, or give a zip"
)
CHECKING: Final = "checking, then accepted"
SAVING: Final = "saving"
PENDING: Final = ("saving", "validating")
"""States of objects that were accepted as far as the person is concerned."""
INTERRUPTED: Final = "acceptance was interrupted"
EMPTY: Final = ("The queue is empty", "Add files, or start with: artiworld serve PATH")
ALL_ACCEPTED: Final = "All other objects are accepted"
restore = Message("Restore {name}")
STATE_ORDER: Final = ("accepted", "submitted", "predicted", "in_progress", "todo", "rejected")

UNDECIDABLE: Final = ("static", "failed", "missing")
"""States of a scene's objects about which there is nothing to decide."""


def progress(counts: dict[str, int], today: int, held: int) -> str:
    """Progress of all objects, and numbers accepted today and on hold."""
    total = sum(count for state, count in counts.items() if state not in UNDECIDABLE)
    done = counts.get("accepted", 0)
    others = [f"{counts[s]} {SHOWN[s]}" for s in (*PENDING, *STATE_ORDER[1:]) if counts.get(s)]
    first = f"**{done}/{total} accepted**" + (f", {today} today" if today else "")
    return " · ".join([first, *([f"**{held} {HELD}** (Shift+Y)"] if held else ()), *others])


def on_hold(name: str, others: int) -> str:
    """The button that opens an object whose acceptance is on hold."""
    return f"On hold: {name}{f' (+{others})' if others else ''}"


NONE_HELD: Final = "Nothing else is on hold"
on_hold_because = Message("on hold: {why}")
# --- the list and the gallery

PAGE_WORDS: Final[dict[str, str]] = {
    "title": TITLE,
    "search": "Search",
    "filter": "Show",
    "sort": "Sort by",
    "sortAgain": "Sort again",
    "all": "All states",
    "gallery": "Gallery or list",
    "empty": "Nothing found. Clear the search, or add files below.",
    "category": "Category",
    "above": "Minimum confidence in percent",
    "pick": "Select",
    "picked": "selected",
    "pickAll": "Select all",
    "clear": "Clear",
    "set": "Set",
    "setCategory": "Set the category of the selected objects",
    "predict": "Predict",
    "accept": "Accept those that passed the checks",
    "check": "Check those that nobody has checked",
    "exportThem": "Export…",
    "exportHint": "Export the selected objects, or all accepted ones",
    "assign": "Assign to",
    "assignHint": "Assign the selected objects",
    "assignTo": "Person",
    "project": "Project",
}
"""Words of the queue that the page's own script shows, by its names for them."""
check_them = Message("Check {count}")
accept_sure = Message("Accept {count} from")
found = Message("{count} objects · {today} accepted today")
SORTS: Final[dict[str, str]] = {
    "order": "Order",
    "name": "Name",
    "category": "Category",
    "state": "State",
    "who": "Person",
    "confidence": "Confidence",
    "recent": "Recent",
}
SHOWN: Final[dict[str, str]] = {
    **STATES,
    "unreadable": UNREADABLE,
    "saving": SAVING,
    "validating": CHECKING,
    "on_hold": HELD,
    "interrupted": INTERRUPTED,
}
IN_TURN: Final = "everybody in turn"
NOBODY: Final = "nobody"
ONLY_MANAGERS: Final = "only a manager may assign objects"
assigned = Message("{count} objects to {whom}")
NOT_A_SHARE: Final = "the confidence must be between 0 and 100 percent"
NO_CATEGORY: Final = "choose a category first"


EXPORT: Final = "Export…"
EXPORT_HINT: Final = "In the formats of simulators, as a download or to a folder"
COLLISION: Final = "Collision"
COLLISIONS: Final[dict[str, str]] = {
    "As saved": "",
    "Hollow": "hollow",
    "Automatic": "auto",
    "Convex pieces": "coacd",
    "One hull a part": "hull",
    "None": "none",
}
"""Label → method; "" is the default, which uses the shapes that a source file declares."""
CHECK: Final = "Read back and compare"
CHECK_HINT: Final = "Each file is read by other software, which must find the same link poses"
PACKAGE: Final = "SimReady package (USD)"
PACKAGE_HINT: Final = "NVIDIA's profile robotics-prop, with thumbnail, metadata and a check"
AUTHOR, LICENSE = "Author", "License"
LICENSE_HINT: Final = "Such as CC-BY-4.0"
FOLDER: Final = "Server folder (empty: download)"
FOLDER_HINT: Final = "A new name below the workspace's exports"
BEGIN, CLOSE = "Export", "Close"
NOTHING_TO_EXPORT: Final = "no accepted object is shown: clear the search or select objects"
NO_FORMAT: Final = "choose at least one format"
NEED_PACKAGE: Final = "a SimReady package names its author and its license"
TAKEN: Final = "that folder exists already: give another name"
BAD_NAME: Final = "a folder's name has only letters, digits, dots, dashes and underscores"
written = Message("Written to {folder}")


def title(count: int) -> str:
    """Title of the dialog."""
    return f"Export {count} {plural('object', count)}"
