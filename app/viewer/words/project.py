"""Words of the project page."""

from __future__ import annotations

from typing import Final

from app.viewer.words.message import Message

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
COLUMNS: Final = (
    "Person", "Objects", "Accepted", "Accepted/h", "Active", "Waiting", "Clicks", "Corrections",
)  # fmt: skip
ACCEPTED: Final = "accepted"
DAY: Final = "day (UTC)"
HOURS, MINUTES = "active hours", "active minutes"
ACTIVE_HINT: Final = "Times between actions; pauses of more than 30 s left out. Days of UTC."
accepted_of = Message("{accepted} of {total} accepted ({share} %)")


def ago(seconds: float) -> str:
    """How long ago something was."""
    if seconds < 60:
        return "just now"
    for size, unit in ((86400, "d"), (3600, "h"), (60, "min")):
        if seconds >= size:
            return f"{int(seconds // size)} {unit} ago"
    return ""
