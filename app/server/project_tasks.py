"""The job behind the project page; see :mod:`app.server.tasks`."""

from __future__ import annotations

from pathlib import Path

from sessions.command_log import read_work
from sessions.project import Overview, overview


def project_overview(
    workspace: Path, database: str | None, now: float, only: str | None
) -> Overview:
    """Read the log of a workspace and summarise it; see :func:`sessions.project.overview`."""
    return overview(read_work(workspace, database), now, only)
