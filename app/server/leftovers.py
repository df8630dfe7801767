"""Removal of files that killed processes left half-written in a workspace.

Each server holds a shared lock on the workspace as long as it runs. One that gets it alone, because
no other server runs, removes the unfinished files first.
"""

from __future__ import annotations

import fcntl
import logging
import shutil
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from model.core.files import OLD
from model.io.assets.reader import recover

log = logging.getLogger(__name__)
LOCK = ".lock"
_UNFINISHED = (
    "arrays/*/.*", "drafts/.*", "uploads/.*", "uploads/*/.*", "cache/.*", "cache/*/.*",
    "collision/.*", "scenes/.*", "scenes/report-*/.*", "scenes/saved-*/.*", "crops/*/.*",
    "assets/.*", "thumbnails/.*", "thumbnails/*.part", "exports/.*", "learned/.*", "releases/.*",
    "storage/.*",
)  # fmt: skip
"""Names of unfinished drafts of :func:`~model.core.files.draft_of`, a dot before the name, and of
the thumbnails of former versions."""


class WorkspaceLease:
    """A server's share of a workspace, until it is closed or its process ends.

    Args:
        workspace: the folder, which is there.
    """

    def __init__(self, workspace: Path) -> None:
        self._file: BinaryIO | None = None
        try:
            self._file = (workspace / LOCK).open("ab")
            with suppress(BlockingIOError):
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                remove_leftovers(workspace)
            fcntl.flock(self._file, fcntl.LOCK_SH)
        except OSError as error:  # read-only, or a file system without locks: nothing is removed
            log.info("%s can't be locked (%s)", workspace, error.strerror)

    def close(self) -> None:
        """Give it back."""
        if self._file is not None:
            self._file.close()


def unfinished(workspace: Path) -> list[Path]:
    """Files and folders that aren't whole: being written, or left by a process that was killed."""
    found = (path for pattern in _UNFINISHED for path in workspace.glob(pattern))
    return [path for path in found if not path.is_symlink()]  # but second annotations' sources


def remove_leftovers(workspace: Path) -> list[Path]:
    """Remove what is unfinished, and put back assets whose replacement was cut off.

    Only for a workspace in which nobody writes.

    Returns:
        What was removed.
    """
    found = unfinished(workspace)
    for path in found:
        if path.name.endswith(OLD) and path.parent.name == "assets":
            recover(path.with_name(path.name[1:].removesuffix(OLD).rpartition(".")[0]))
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            with suppress(OSError):
                path.unlink(missing_ok=True)
    removed = [path for path in found if not path.exists()]
    if removed:
        log.info("removed %d unfinished files of processes that were killed", len(removed))
    return removed
