"""Words of the queue."""

from __future__ import annotations

from typing import Final

from app.viewer.words.message import Message

TITLE: Final = "Queue"
SEARCH_HINT: Final = "Part of the name"
ON_HOLD_HINT: Final = "Accepted before the checks were done, which then found problems"
UPLOAD: Final = "Add files"
UPLOAD_HINT: Final = (
    "Mesh or scan (GLB, PLY, STL, OBJ, PCD, XYZ). Select an OBJ together with its MTL and "
    "textures, or give a zip"
)
CHECKING: Final = "checking, then accepted"
SAVING: Final = "saving"
INTERRUPTED: Final = "acceptance was interrupted"
EMPTY: Final = ("The queue is empty", "Start with: artiworld serve PATH")
ALL_ACCEPTED: Final = "All other objects are accepted"
progress = Message("**{accepted} of {total}** accepted")
restore = Message("Restore {name}")


def on_hold(name: str, others: int) -> str:
    """The button that opens an object whose acceptance is on hold."""
    return f"On hold: {name}{f' (+{others})' if others else ''}"


on_hold_because = Message("on hold: {why}")
