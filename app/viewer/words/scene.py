"""Words of a whole scene."""

from __future__ import annotations

from typing import Final

from app.viewer.words.common import Message

TITLE: Final = "Scene"
ORIGINAL_COLORS: Final = "Original colors"
ORIGINAL_COLORS_HINT: Final = (
    "Show all objects in their own colors, instead of the colors of states"
)
JOBS: Final[dict[str, str]] = {
    "read": "Reading the scene",
    "shapes": "Reading the assets",
    "copy": "Making a working copy",
    "accept": "Accepting",
    "save": "Saving the scene",
    "report": "Writing the report",
    "prepare": "Predicting joints",
    "parts": "Preparing the view",
}
"""Running jobs, the most important one first."""
PAUSE, RESUME = "Pause prediction", "Resume prediction"
SKIP: Final = "Skip this asset"
PLAY, STOP = "Play all joints (Shift+Space)", "Stop (Space)"
SELECTED: Final = "Selected object"
KIND: Final = "Kind"
ARTICULABLE, STATIC = "Articulable", "Static"
EDIT: Final = "Edit (Enter)"
PICK: Final = "Extract an object"
ACCEPT, ACCEPT_ANYWAY, CHECKING = "Accept (Y)", "Accept anyway (Y)", "Checking…"
INCLUDE: Final = "Include unreviewed"
INCLUDE_HINT: Final = "Unreviewed predictions move, too; otherwise these objects are rigid"
SAVE, SAVING = "Save scene", "Saving the scene…"
REPORT: Final = "Scene report"
JOINTS: Final = "Joints"
NOTHING_SELECTED: Final = "Click an object in the view or in the list. N: lowest confidence first."
NOT_PREDICTED: Final = "Not predicted yet."
PLAY_LATER: Final = "Joints can be played once objects are predicted"
BACK: Final = "Back to the scene (Backspace)"

EXTRACT_HELP: Final = (
    "**Extract an object:** click it (Shift+click removes), or Alt+drag a box around it. Then name "
    "it and extract it."
)
RESTORE_ROOM: Final = "Restore floor and walls"
RESTORE_ROOM_HINT: Final = "They are excluded here, and doors and windows may be among them"
OBJECT_NAME: Final = "Name"
OBJECT_NAME_HINT: Final = "refrigerator, cabinet, oven, …"
EXTRACT: Final = "Extract"
EXTRACT_NOTHING: Final = "select an object of the scene and press “Extract an object”"


def job(name: str, detail: str) -> str:
    """A running job in one line."""
    return f"{JOBS[name]}… {detail}".rstrip()


def file_problems(lines: list[str], more: int) -> str:
    """Unusable content of the scene's file."""
    rest = [f"and {more} more"] if more else []
    return "⚠ About the file:\n" + "\n".join(f"- {line}" for line in [*lines, *rest])


def kind_set(articulable: bool) -> str:
    """A user decided the kind."""
    return f"Set by a user: {'articulable' if articulable else 'static'}."


instances = Message("{count} instances: a decision applies to all.")


def refused(why: str, anyway: bool, findings: bool) -> str:
    """Why it wasn't accepted, and how to go on: accept anyway, or look at the findings."""
    then = "Enter shows the findings." if findings else ""
    if anyway:
        then = "**Press Y again to accept anyway; Enter shows the findings.**"
    return f"⚠ Not accepted: {why} {then}".rstrip()


expected = Message("Expected moving parts: {parts}")
left = Message("⚠ Needs annotation: {reason}")


def decided(state: str, user: str, reason: str) -> str:
    """Author of a decision, and reason for a rejection."""
    return f"{state.capitalize()} by {user}{f': {reason}' * bool(reason)}"


lost = Message("⚠ {count} can't be read.")
NOTHING_ARTICULABLE: Final = "No articulable objects."
EXTRACT_FIRST: Final = "Extract an object first."

# --- notes

STILL_READING: Final = "The scene is still being read."
NOTHING_TO_DECIDE: Final = "Nothing to decide"
NONE_ABOVE: Final = "no predicted object has that confidence and has passed the checks"
NEED_SELECTION: Final = "select an object first: click it, or press N"
undone = Message("Undone: {what}")
is_static = Message("{id} is static: there is nothing to decide")
already_accepted = Message("{id} is already accepted")
already_checking = Message("{id} is already being checked")
has_problems = Message("{id}: {problems}. Press Enter to edit it")
has_errors = Message("{id}: {why} Press Enter to see them; fix them, or accept with a reason")
