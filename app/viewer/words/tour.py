"""Words of the tour."""

from __future__ import annotations

from typing import Final

from app.viewer.words.message import Message

TOUR: Final = "Tour"
TOUR_TIP: Final = "Tour: from a mesh to moving joints in a minute"
STEPS: Final[tuple[str, ...]] = (
    "Click on a door of the cabinet. The part takes shape; Shift+click removes excess.",
    "Press 2 and click on a drawer, then 3 for the next one. All parts, in the rail of tools at "
    "the left, proposes them all at once.",
    "Name the parts at the right (Shift+1 is a door, Shift+2 a drawer) and choose the category. "
    "Then press P: the joints are predicted.",
    "Space plays the joints. Drag the slider at the right, and correct type, axis or limits.",
    "Open Review: the checks list the joints, worst first. Y accepts the object, X rejects it.",
    "That is all. N opens the next object, ? shows all keys, and this tour is in the rail.",
)
"""Each ends by itself once it is done, but the last one."""
NEXT, SKIP, END = "Next", "Skip the tour", "End the tour"
place = Message("{number} of {total}")
