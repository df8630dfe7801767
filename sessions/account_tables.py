"""Tables of people: accounts, what proves them, who works on what, and the record of it all.

Secrets are stored hashed: passwords with argon2, random ones (invitations, browser sessions,
tokens) with SHA-256, which suffices for 256 random bits. Only a webhook's secret is stored itself,
since it signs.
"""

from __future__ import annotations

from sqlalchemy import Column, ForeignKey, Index, Integer, String, Table, Text

from sessions.database import metadata

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
