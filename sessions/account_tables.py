"""Tables of people: accounts, what proves them, who works on what, and the record of it all.

Secrets are stored hashed: passwords with argon2, random ones (invitations, browser sessions,
tokens) with SHA-256, which suffices for 256 random bits. Only a webhook's secret is stored itself,
since it signs.

The audit is a table that is only ever appended to. Decisions about objects aren't repeated there:
the commands say who gave them and when.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from sqlalchemy import (
    Column,
    Connection,
    ForeignKey,
    Index,
    Integer,
    String,
    Table,
    Text,
    insert,
    select,
)

from model.core.errors import ConfigurationError
from sessions.database import Database, commands, metadata, now, objects

_TIME = String(32)  # ISO 8601, UTC; sorts as text


def _account(index: bool | None = None) -> Column[int]:
    return Column("account_id", Integer, ForeignKey("accounts.id"), nullable=False, index=index)


def _object() -> Column[int]:
    return Column("object_id", Integer, ForeignKey("objects.id"), primary_key=True)


accounts = Table(
    "accounts",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("name", Text, nullable=False),
    # The name without case and compatibility forms: nobody signs as somebody else in capitals.
    Column("key", String(255), nullable=False, unique=True),
    Column("role", String(16), nullable=False),
    Column("status", String(16), nullable=False),
    Column("password", Text),
    Column("created", _TIME, nullable=False),
)

invitations = Table(
    "invitations",
    metadata,
    Column("hash", String(64), primary_key=True),
    _account(),
    Column("expires", _TIME, nullable=False),
)

web_sessions = Table(
    "web_sessions",
    metadata,
    Column("hash", String(64), primary_key=True),
    _account(index=True),
    Column("created", _TIME, nullable=False),
    Column("expires", _TIME, nullable=False),
)

tokens = Table(
    "tokens",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("hash", String(64), nullable=False, unique=True),
    _account(index=True),
    Column("label", Text, nullable=False),
    Column("scopes", String(80), nullable=False),
    Column("created", _TIME, nullable=False),
    Column("expires", _TIME, nullable=False),
)

identities = Table(
    "identities",
    metadata,
    Column("issuer", String(255), primary_key=True),
    Column("subject", String(255), primary_key=True),
    _account(index=True),
    Column("since", _TIME, nullable=False),
)

logins = Table(
    "logins",
    metadata,
    Column("state", String(64), primary_key=True),
    Column("browser", String(64), nullable=False),
    Column("nonce", String(64), nullable=False),
    Column("verifier", String(128), nullable=False),
    Column("expires", _TIME, nullable=False),
)

assignments = Table(
    "assignments",
    metadata,
    _object(),
    _account(),
    Column("at", _TIME, nullable=False),
)

presence = Table(
    "presence",
    metadata,
    _object(),
    Column("account_id", Integer, ForeignKey("accounts.id"), primary_key=True),
    Column("since", _TIME, nullable=False),
    Column("until", _TIME, nullable=False),
    Column("lease", _TIME, nullable=False),
)

audit = Table(
    "audit",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("at", _TIME, nullable=False),
    Column("who", Text, nullable=False),
    Column("kind", String(32), nullable=False),
    Column("subject", Text, nullable=False),
    Column("detail", Text, nullable=False),
    Column("address", Text, nullable=False),
    Index("audit_at", "at"),
)

webhooks = Table(
    "webhooks",
    metadata,
    Column("id", Integer, primary_key=True),
    _account(),
    Column("url", Text, nullable=False),
    Column("secret", Text, nullable=False),
    Column("events", Text, nullable=False),
    Column("created", _TIME, nullable=False),
)

deliveries = Table(
    "deliveries",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("webhook_id", Integer, ForeignKey("webhooks.id"), nullable=False),
    Column("event", String(32), nullable=False),
    Column("payload", Text, nullable=False),
    Column("attempts", Integer, nullable=False),
    Column("due", _TIME, nullable=False, index=True),
    Column("problem", Text, nullable=False),
)


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
