"""Audit log of accounts: a table that is only ever appended to.

Decisions about objects aren't repeated here: the commands say who gave them and when.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from sqlalchemy import Connection, insert, select

from model.core.errors import ConfigurationError
from sessions.account_tables import audit
from sessions.database import Database, commands, objects
from sessions.records import now

EventKind = Literal[
    "login", "login_failed", "logout", "account_added", "invited", "claimed", "role_changed",
    "disabled", "password_changed", "sessions_revoked", "token_made", "token_revoked",
    "assigned", "released", "webhook_added", "webhook_removed", "project_changed",
]  # fmt: skip
EVENT_KINDS: tuple[EventKind, ...] = get_args(EventKind)
MOST_EVENTS = 1000
"""In one answer."""


@dataclass(frozen=True)
class Event:
    """One thing that happened.

    Attributes:
        id: ascending.
        at: ISO 8601, UTC.
        who: the account that did it; "command line" for the machine's own user.
        kind: one of :data:`EVENT_KINDS`.
        subject: name of the account that it was done to, or the object.
        detail: such as the new role.
        address: where the request came from, or "".
    """

    id: int
    at: str
    who: str
    kind: str
    subject: str
    detail: str
    address: str


@dataclass(frozen=True)
class Decision:
    """One command, without its content: :meth:`~sessions.store.Store.history` has that.

    Attributes:
        object: id of the object.
        name: of the object.
        seq: number among the commands of the object.
        at: ISO 8601, UTC.
        who: the account, or the program.
        kind: stored name of the command.
    """

    object: int
    name: str
    seq: int
    at: str
    who: str
    kind: str


def record(
    connection: Connection,
    kind: EventKind,
    who: str,
    subject: str,
    detail: str = "",
    address: str = "",
) -> None:
    """Append an event in the transaction of what it is about."""
    values = {"at": now(), "who": who, "kind": kind, "subject": subject}
    connection.execute(insert(audit).values(**values, detail=detail[:500], address=address))


class AuditLog:
    """Reads the events."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def add(
        self, kind: EventKind, who: str, subject: str, detail: str = "", address: str = ""
    ) -> None:
        """Append one event."""
        with self._database.writing() as connection:
            record(connection, kind, who, subject, detail, address)

    def events(
        self,
        *,
        name: str | None = None,
        kind: str | None = None,
        since: str | None = None,
        before: int | None = None,
        count: int = 200,
    ) -> list[Event]:
        """Return events, the newest first.

        Args:
            name: of the account that did it, or that it was done to.
            kind: one of :data:`EVENT_KINDS`.
            since: ISO 8601, UTC.
            before: only those with a lower id, for the next page.
            count: at most so many, up to :data:`MOST_EVENTS`.

        Raises:
            ConfigurationError: where there is no such kind.
        """
        if kind is not None and kind not in EVENT_KINDS:
            raise ConfigurationError(
                f"there is no event {kind[:40]!r}; choose one of {', '.join(EVENT_KINDS)}"
            )
        wanted = select(audit).order_by(audit.c.id.desc()).limit(min(max(count, 1), MOST_EVENTS))
        if name is not None:
            wanted = wanted.where((audit.c.who == name) | (audit.c.subject == name))
        if kind is not None:
            wanted = wanted.where(audit.c.kind == kind)
        if since is not None:
            wanted = wanted.where(audit.c.at >= since)
        if before is not None:
            wanted = wanted.where(audit.c.id < before)
        with self._database.reading() as connection:
            return [Event(*row) for row in connection.execute(wanted)]

    def decisions(
        self,
        *,
        who: str | None = None,
        object_id: int | None = None,
        kind: str | None = None,
        since: str | None = None,
        first: int = 0,
        count: int = 200,
    ) -> list[Decision]:
        """Return decisions about objects, the newest first.

        Args:
            who: name of the account.
            kind: stored name of the command.
            since: ISO 8601, UTC.
            first: how many of the newest are left out, for the next page.
            count: at most so many, up to :data:`MOST_EVENTS`.
        """
        c = commands.c
        wanted = (
            select(c.object_id, objects.c.name, c.seq, c.at, c.who, c.kind)
            .join(objects, objects.c.id == c.object_id)
            .order_by(c.at.desc(), c.object_id, c.seq.desc())
            .offset(max(first, 0))
            .limit(min(max(count, 1), MOST_EVENTS))
        )
        for column, value in ((c.who, who), (c.object_id, object_id), (c.kind, kind)):
            if value is not None:
                wanted = wanted.where(column == value)
        if since is not None:
            wanted = wanted.where(c.at >= since)
        with self._database.reading() as connection:
            return [Decision(*row) for row in connection.execute(wanted)]
