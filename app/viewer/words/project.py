"""Words of the project page."""

from __future__ import annotations

from typing import Final

from app.viewer.words.common import Message
from model.validation.report import Kind

TITLE: Final = "Project"
TODAY: Final = "Today"
LAST_DAYS: Final = "Last two weeks"
RECENT: Final = "Worked on last"
READING: Final = "Adding up the figures…"
NOBODY: Final = "Nobody has worked on it today."
NOTHING: Final = "Nothing was worked on yet. Open an object and click on a part that moves."
DOWNLOAD: Final = "Download CSV"
DOWNLOAD_HINT: Final = "A row for each day and person"
FILE: Final = "artiworld_work.csv"
CLOSE: Final = "Close"
COLUMNS: Final = tuple(
    "Person Objects Accepted Accepted/h Active Waiting Clicks Corrections".split()
)
ACCEPTED: Final = "accepted"
DAY: Final = "day (UTC)"
HOURS, MINUTES = "active hours", "active minutes"
ACTIVE_HINT: Final = (
    "Times between actions; pauses of more than 30 s left out. Days of UTC. Accepted/h from ten "
    "accepted objects or an hour on."
)
TOO_FEW: Final = "too few"
DIALOGS: Final = (
    ("labels", "Instructions and labels", "What people read beside the picture, and which names"),
    ("checks", "Checks and export", "Which checks must pass, and how assets are written"),
)
LEARN: Final = "Learn"
LEARN_HINT: Final = (
    "Let predictions follow the joints of accepted objects of the same category and part names"
)
LEARNING: Final = "Learning from accepted objects"
MANAGERS_ONLY: Final = "only managers may let predictions learn"
LEARNED: Final = "Learned"
NOT_BETTER: Final = "No better"
NAME: Final = "Name"
INSTRUCTIONS: Final = "Instructions"
MARKDOWN: Final = "Markdown; images are shown as links"
LABELS: Final = "Labels"
LABELS_HINT: Final = "A line for each category, then its parts: Oven: door, knob"
STRICT: Final = "Only these names"
STRICT_HINT: Final = "Other names are errors of the checks"
SAVE, CANCEL = "Save", "Cancel"
SAVED: Final = "The settings are saved; all screens use them"
REQUIRED: Final = "**Required checks:** what they find prevents acceptance, with no override."
EXPORT: Final = "**Export and releases** begin with:"
KINDS: Final[dict[Kind, str]] = {
    "geometry": "Empty parts",
    "jammed": "Blocked at rest",
    "floating": "Not attached",
    "limits": "Limits",
    "collision": "Collisions",
    "detached": "Comes off",
    "physics": "Simulation",
    "combination": "Two joints",
    "siblings": "Unlike equal parts",
    "size": "Unusual size",
    "unsure": "Low confidence",
    "name": "Other names",
}
FORM: Final = "Release as"
FORMS: Final[dict[str, str]] = {
    "Folder": "folder",
    "WebDataset": "webdataset",
    "Hugging Face": "huggingface",
}


def form_label(form: str) -> str:
    """The label of a release's form."""
    return next((k for k, v in FORMS.items() if v == form), "Folder")


accepted_of = Message("{accepted} of {total} accepted ({share} %)")


def ago(seconds: float) -> str:
    """Time since an event."""
    if seconds < 60:
        return "just now"
    for size, unit in ((86400, "d"), (3600, "h"), (60, "min")):
        if seconds >= size:
            return f"{int(seconds // size)} {unit} ago"
    return ""


learned = Message(
    "Predictions follow {objects} accepted objects (version {version}): of their joints "
    "{after} % come out as accepted, {before} % without"
)
not_better = Message(
    "Predictions stay as they are: following {objects} accepted objects, {after} % of the joints "
    "come out as accepted, {before} % without"
)
