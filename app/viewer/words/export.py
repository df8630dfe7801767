"""Words of exporting."""

from __future__ import annotations

from typing import Final

from app.viewer.words.common import plural
from app.viewer.words.message import Message

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
FOLDER: Final = "Folder"
FOLDER_HINT: Final = "A new name below the workspace's exports; empty for a download"
BEGIN, CLOSE = "Export", "Close"
NO_FORMAT: Final = "choose at least one format"
NEED_PACKAGE: Final = "a SimReady package names its author and its license"
TAKEN: Final = "that folder exists already: give another name"
BAD_NAME: Final = "a folder's name has only letters, digits, dots, dashes and underscores"
written = Message("Written to {folder}")
too_large = Message("too large to download: it is in {folder}")


def title(count: int) -> str:
    """Title of the dialog."""
    return f"Export {count} {plural('object', count)}"
