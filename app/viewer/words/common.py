"""Words that several screens share, those above every step, and those of the tour; and messages
with places for values.
"""

from __future__ import annotations

from string import Formatter
from typing import Final

from app.server.scene_state import HELD


class Message(str):
    """A text with named places, ``"{count} of {total}"``; a call fills them in their order."""

    __slots__ = ()

    @property
    def places(self) -> tuple[str, ...]:
        """The names, in order, each once."""
        found = (name for _, name, _, _ in Formatter().parse(self) if name)
        return tuple(dict.fromkeys(found))

    def __call__(self, *values: object) -> str:
        """Fill the places."""
        return self.format(**dict(zip(self.places, values, strict=True)))


NONE: Final = "—"
OTHER: Final = "Other…"
SELECTED: Final = "▸ "
CHOSEN: Final = "● "
EDITED: Final = " ✎"
CANCEL: Final = "Cancel"
HISTORY_ACTIONS: Final = ("Undo", "Redo")
PLAY_ONE: Final = "▶ / ■"
EDIT: Final = "Edit"
NAVIGATE: Final = "Navigate"
PREVIOUS_NEXT: Final = ("Previous (B)", "Next (N)")
USER_NAME: Final = "Your name"
USER_NAME_HINT: Final = "Recorded with your decisions"

account = Message("{name} · {role} · [account](/login)")
also_here = Message("Also here: {names}")
works_on_it = Message("{name} (works on it)")

STATES: Final[dict[str, str]] = {
    "todo": "to do",
    "in_progress": "in progress",
    "predicted": "to review",
    "submitted": "submitted",
    "accepted": "accepted",
    "rejected": "rejected",
}
SCENE_STATES: Final[dict[str, str]] = {
    **{state: word for state, word in STATES.items() if state != "submitted"},
    "on_hold": HELD,
    "validating": "checking",
    "static": "static",
    "failed": "failed",
    "missing": "missing",
}
UNREADABLE: Final = "unreadable"
FROM_FILE: Final = "joints from the file"
REOPEN: Final = "Reopen to edit"
REOPEN_HINT: Final = "It is accepted: nothing changes until it is reopened"

# --- above every step

RETRY: Final = "Retry"
REMOVE: Final = "Remove"
REMOVE_HINT: Final = "Removes it from the queue; the file and all decisions stay"
CANCEL_ACCEPTANCE, CHECKING = "Cancel acceptance (Esc)", "Checking…"
UNDO_TIP, REDO_TIP = "Undo (Ctrl+Z)", "Redo (Ctrl+Shift+Z)"
PLAY, RESET_POSE = "Play / stop (Space)", "Reset pose (R)"
STEP_TIPS: Final[dict[str, str]] = {
    "Prepare": "Level, size and clean the scan",
    "Annotate": "Click on each part that moves",
    "Joints": "How the parts move",
    "Review": "Checks, then accept or reject",
}
DONE, ATTENTION, REFUSED = "done", "needs a decision", "rejected"
STALE: Final = "⚠ Parts changed since the prediction. Predict again (P)"
NEW_FIXED: Final = "is new and stays fixed until you predict again (P)"
PREDICT: Final = "Predict joints (P)"
PREDICT_LOCALLY: Final = "Predict on this machine"
JOBS: Final[dict[str, str]] = {
    "open": "Opening",
    "save": "Saving",
    "predict": "Predicting joints",
    "room": "Processing the scan",
    "prepare": "Finding the floor and the upright direction",
    "segment": "Segmenting",
    "encode": "Preparing",
    "tool": "Proposing parts",
}
"""Running jobs, the most important one first."""
KEYS_BUTTON: Final = "Keys and mouse (?)"
SIMPLE_LIGHT: Final = "Simple lighting"
SIMPLE_LIGHT_HINT: Final = "No reflections; much faster where the browser has no GPU"


def job(name: str, percent: str, detail: str) -> str:
    """A running job in one line."""
    return f"{JOBS[name]}… {percent}{detail}".rstrip()


def size(count: int, kind: str, millimetres: tuple[float, float, float]) -> str:
    """Elements ("face" or "point") and extent of an object."""
    x, y, z = millimetres
    return f"{count:,} {plural(kind, count)} · {x:.0f} × {y:.0f} × {z:.0f} mm"


def rejected_by(user: str, reason: str, comment: str) -> str:
    """Why an object came back to its annotator."""
    return f"⚠ Rejected by {user}: {reason}{f': “{comment}”' if comment else ''}".rstrip(": ")


warning = Message("⚠ {text}")


def plural(noun: str, count: int) -> str:
    """A regular English noun as it stands beside a count."""
    return f"{noun}{'s'[: count != 1]}"


# --- notes

UNDO_EMPTY: Final = "Nothing to undo"
REDO_EMPTY: Final = "Nothing to redo"
NOT_POSSIBLE: Final = "Not possible"
INTERNAL_ERROR: Final = ("Internal error", "Your work is saved; details are in the server's log")
CANNOT_OPEN: Final = "Can't open this file"
TOO_FAST: Final = ("Not accepted yet", "The object has only just appeared: press again")
NO_JOINTS: Final = "No joints yet"
PREDICT_FIRST: Final = "Predict them first (P)"
NAMES_EARLIER: Final = "Names are given in Annotate and Joints"


def need_object(in_scene: bool) -> str:
    """Why a command can't be carried out where no object is open."""
    where = "select one in the scene and press Enter" if in_scene else "select one in the queue"
    return f"no object is open: {where}"


TOUR: Final = "Tour"
TOUR_TIP: Final = "Tour: from a mesh to moving joints in a minute"
STEPS: Final[tuple[str, ...]] = (
    "Press Shift+1 for a door, and click on one of the cabinet. The part takes shape; Shift+click "
    "removes excess.",
    "Shift+2 and a click make a drawer, and so on. All parts, in the rail of tools at the left, "
    "proposes them all at once.",
    "Choose the category at the right. Then press P: the joints are predicted.",
    "Space plays the joints. Drag the slider at the right, and correct type, axis or limits.",
    "Open Review: the checks list the joints, worst first. Y accepts the object, X rejects it.",
    "Done. N opens the next object, ? shows all keys, and this tour is in the rail.",
)
"""Each ends by itself once it is done, but the last one."""
NEXT, SKIP, END = "Next", "Skip the tour", "End the tour"
place = Message("{number} of {total}")
