"""Words of the review step, and of rejecting."""

from __future__ import annotations

from typing import Final

from app.server.open_object import INTERRUPTED
from app.viewer.words.common import STATES, Message, plural
from model.validation.report import FixKind, Severity
from sessions.review import RejectReason

OVERRIDE: Final = "Reason for override"
OVERRIDE_HINT: Final = "Required where the checks found errors"
COMMENT: Final = "Comment"
AUTO_ADVANCE: Final = "Auto-advance"
AUTO_ADVANCE_HINT: Final = "Go to the next object after a decision, lowest confidence first"
COMPLETE: Final = "Fill in surfaces that the scan missed"
COMPLETE_HINT: Final = (
    "The saved asset gets closed surfaces, thick doors, trays behind drawers and openings for "
    "them. The scanned points are saved as they are"
)
DOWNLOAD: Final = "Download asset"
HISTORY: Final = "History"
HISTORY_EMPTY: Final = "No changes yet."
TABLE_HEAD: Final = "| Joint | Type | Range | Confidence |"
NO_JOINTS: Final = "No joints yet. Predict them first (P)."
PROBLEMS: Final = "**Warnings of the prediction:**"
STALE: Final = "parts changed since the prediction"
WAITING: Final = "**Will be accepted when the checks pass.** Esc cancels."
WRITING: Final = "**Accepting:** its asset is being written."
ACCEPTING: Final = "Accepting…"
ALREADY_ACCEPTED: Final = ("Already accepted", "Reopen it to edit it")
NOT_ACCEPTED_YET: Final = "Not accepted yet"
ON_HOLD: Final = "On hold"
NOT_ACCEPTED: Final = "Not accepted"
REJECTED: Final = "Rejected"
ASSET_MISSING: Final = "the asset isn't on this server's disk: accept again"


SUBMIT: Final = "Submit (Y)"
SUBMITTED: Final = "Submitted"
ABOUT: Final = "Comment on"
NO_COMMENTS: Final = "No comment is open"
NEXT_COMMENT: Final = "Next (Shift+C)"
PIN, ADD_COMMENT = "Pin in 3D", "Add comment"
PIN_HINT: Final = "Pin the comment to the place that is clicked next"
HINT_PIN: Final = "Click the place that the comment is about"
NEED_COMMENT: Final = "write the comment first"
COMMENTED: Final = "Comment added"
comment_button = Message("Comment {number}: {text}")


def comments_left(left: int, total: int) -> str:
    """Number of open comments."""
    return f"Comments: {left} of {total} open"


def done_button(number: int, done: bool) -> str:
    """Marks a comment as done, or opens it again."""
    return f"Open comment {number} again" if done else f"Comment {number} is done"


to_reviewer = Message("{name}: waits for a reviewer")
about_joint = Message("About the joint of {part}")
about_place = Message("About the place {place} m")


def accept(edited: bool, warned: bool, errors: bool) -> str:
    """The button that accepts.

    Args:
        edited: the user changed joints.
        warned: the warnings were shown.
        errors: the checks found errors.
    """
    if warned or errors:
        return "Accept anyway (Y)"
    return "Accept with edits (Y)" if edited else "Accept (Y)"


saved_in = Message("Saved in {folder}")


def pending(shown: str, held: str) -> str:
    """Progress of an acceptance by the state that is shown, and why it is ``held``; "" for none."""
    return {
        "saving": WRITING,
        "validating": WAITING,
        "on_hold": f"**On hold:** {held}",
        "interrupted": f"**{INTERRUPTED}.**",
    }.get(shown, "")


def state(state: str, user: str) -> str:
    """The state, and who decided it."""
    if user and state == STATES["predicted"]:
        return f"**Predicted** by {user}, waiting for review"
    return f"**{state.capitalize()}**" + (f" by {user}" if user else "")


from_file = Message("**From {name}**")
reason = Message("Reason: {text}")
comment = Message("“{text}”")
override = Message("Accepted with errors: “{text}”")
about = Message("{name}: {text}")
sent_back = Message("{name}: back to annotation")
joint_changed = Message("change the joint of {part}")
# --- rejecting

REASONS: Final[dict[RejectReason, str]] = {
    "range": "range",
    "axis": "axis",
    "type": "type",
    "parts": "parts",
    "not_articulated": "not articulated",
    "other": "other",
}
"""Recorded reason → its name."""
REJECT: Final = "Reject (X)"
CANCEL_REJECTION: Final = "Cancel rejection (Esc)"
REASON_LABEL: Final = "Reason"
ask_reason = Message("Why reject {name}?")


def reason_buttons() -> tuple[str, ...]:
    """The reasons with their numbers."""
    return tuple(f"{k} {word}" for k, word in enumerate(REASONS.values(), 1))


def reason_keys() -> str:
    """The same as keys."""
    return f"{' · '.join(reason_buttons())} · Esc cancels"


def bad_reason() -> str:
    """Another number was pressed."""
    return f"choose a reason: 1 to {len(REASONS)}, or Esc"


# --- the checks

SIGNS: Final[dict[Severity, str]] = {
    Severity.OK: "✓",
    Severity.WARNING: "▲",
    Severity.ERROR: "✖",
}
SEVERITIES: Final[dict[Severity, str]] = {
    Severity.OK: "OK",
    Severity.WARNING: "warning",
    Severity.ERROR: "error",
}
FINDINGS: Final = "Findings, worst first"
SHOW_WORST: Final = "Show the worst pose (Tab: next)"
FIX: Final = "Fix"
FIXES: Final[dict[FixKind, str]] = {
    "like": "Move like",
    "flip": "Flip",
    "shift": "Shift axis",
    "limits": "Fit limits",
    "shrink": "Shrink colliders",
    "size": "Use",
}
FIXED: Final = "Fixed"
NO_POSE: Final = "No pose to show"
ALL_OK: Final = ("No warnings", "Accept with Y")
STILL_CHECKING: Final = "the checks are still running"
NOTHING_MOVES: Final = "no moving joints"


def checks(counts: dict[Severity, int]) -> str:
    """The result in one line: "Checks: ✖ 1 error · ▲ 4 warnings · ✓ 3 OK"."""
    words = {
        s: w if s == Severity.OK else plural(w, counts.get(s, 0)) for s, w in SEVERITIES.items()
    }
    parts = [f"{SIGNS[s]} {n} {words[s]}" for s, n in counts.items() if n]
    return f"**Checks: {' · '.join(parts) or NOTHING_MOVES}**"


checks_failed = Message("⚠ **The checks failed:** {why}")


def checking(share: float, detail: str) -> str:
    """Progress of the checks, 0..1."""
    return f"*Checking the joints… {100 * share:.0f} % {detail}".rstrip() + "*"


no_physics = Message("*Physics: {why}*")


def finding(severity: Severity, titles: list[str]) -> str:
    """Joints with the same findings."""
    *others, last = titles if len(titles) < 3 else (*titles[:2], f"{len(titles) - 2} more")
    named = f"{', '.join(others)} and {last}" if others else last
    return f"{SIGNS[severity]} {named}: {SEVERITIES[severity]}"[:60]


also = Message("Also {titles}")


more_findings = Message("… and {count} more (Tab).")
fixed = Message("{message} Undo with Ctrl+Z.")


def moment(kind: str, metres: float) -> str:
    """Label next to a contact."""
    millimetres = f"{1000 * metres:.0f} mm"
    if kind in ("detached", "floating"):
        return f"{millimetres} gap"
    return f"{millimetres} deep"
