"""Records of objects and their history."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from sessions.commands import Command, kind_of
from sessions.review import ReviewState


@dataclass(frozen=True)
class ObjectRecord:
    """One line of the queue.

    Attributes:
        id: in this workspace.
        path: the source, absolute.
        name: short display name.
        sha256: of the source when it was opened first, None where it wasn't read yet.
        state: see :mod:`sessions.review`.
        prompts, parts: how many.
        category: what it is, or None.
        who: author of the last command, "" before the first.
        updated, created: ISO 8601, UTC.
        assigned_to: the annotator whom a rejected object waits for, or None.
        seq: number of the last command.
        changed: whether the source changed since it was annotated (only from ``open_object``).
    """

    id: int
    path: Path
    name: str
    sha256: str | None
    state: ReviewState
    prompts: int
    parts: int
    category: str | None
    who: str
    updated: str
    created: str
    assigned_to: str | None
    seq: int
    changed: bool = False

    @property
    def asset_name(self) -> str:
        """Name of the folder of its accepted asset."""
        plain = re.sub(r"[^A-Za-z0-9._-]+", "_", self.name).strip("._") or "object"
        return f"{plain[:60]}-{self.id}"


@dataclass(frozen=True)
class Entry:
    """One command as it was given.

    Attributes:
        seq: 1 for the first command of an object.
        at: ISO 8601, UTC.
        who: the person.
        command: the decision.
    """

    seq: int
    at: str
    who: str
    command: Command

    @property
    def kind(self) -> str:
        """The command's name in JSON."""
        return kind_of(self.command)


@dataclass(frozen=True)
class PendingAcceptance:
    """An acceptance that began and has not ended.

    Attributes:
        seq: number of the object's last command then.
        comment, override: as the person typed them.
        hold_reason: why validation put it on hold after the person had gone on; "" where it is
            under way, or was cut off.
    """

    seq: int
    comment: str = ""
    override: str = ""
    hold_reason: str = ""


def now(seconds: float = 0.0) -> str:
    """The moment in ``seconds`` as ISO 8601, UTC, microseconds; sorts as text."""
    return (datetime.now(UTC) + timedelta(seconds=seconds)).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
