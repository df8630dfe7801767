"""Accounts, what proves them, assignments, presence, audit, webhooks."""

from __future__ import annotations

import unicodedata
from datetime import UTC, datetime

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"

# Authors of results of jobs; no person has these names.
_MACHINES = {
    "segmenter",
    "source file",
    "masks of another system",
    "scene",
    "scripted annotator",
    "anonymous",
}


def upgrade() -> None:
    """Make the tables, and an account to be claimed of each name beside a decision."""
    account = lambda **settings: sa.Column(  # noqa: E731
        "account_id", sa.Integer, sa.ForeignKey("accounts.id"), nullable=False, **settings
    )
    op.create_table(
        "accounts",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("name", sa.Text, nullable=False),
        sa.Column("key", sa.String(255), nullable=False, unique=True),
        sa.Column("role", sa.String(16), nullable=False),
        sa.Column("status", sa.String(16), nullable=False),
        sa.Column("password", sa.Text),
        sa.Column("created", sa.String(32), nullable=False),
    )
    op.create_table(
        "invitations",
        sa.Column("hash", sa.String(64), primary_key=True),
        account(),
        sa.Column("expires", sa.String(32), nullable=False),
    )
    op.create_table(
        "web_sessions",
        sa.Column("hash", sa.String(64), primary_key=True),
        account(index=True),
        sa.Column("created", sa.String(32), nullable=False),
        sa.Column("expires", sa.String(32), nullable=False),
    )
    op.create_table(
        "tokens",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("hash", sa.String(64), nullable=False, unique=True),
        account(index=True),
        sa.Column("label", sa.Text, nullable=False),
        sa.Column("scopes", sa.String(80), nullable=False),
        sa.Column("created", sa.String(32), nullable=False),
        sa.Column("expires", sa.String(32), nullable=False),
    )
    _work_tables(account)
    _claimable_accounts()
    _append_only("audit")
    if op.get_bind().dialect.name == "postgresql":  # SQLite has them since the first format
        _append_only("commands")


def _work_tables(account) -> None:
    op.create_table(
        "assignments",
        sa.Column("object_id", sa.Integer, sa.ForeignKey("objects.id"), primary_key=True),
        account(),
        sa.Column("at", sa.String(32), nullable=False),
    )
    op.create_table(
        "presence",
        sa.Column("object_id", sa.Integer, sa.ForeignKey("objects.id"), primary_key=True),
        sa.Column("account_id", sa.Integer, sa.ForeignKey("accounts.id"), primary_key=True),
        sa.Column("since", sa.String(32), nullable=False),
        sa.Column("until", sa.String(32), nullable=False),
        sa.Column("lease", sa.String(32), nullable=False),
    )
    op.create_table(
        "audit",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("at", sa.String(32), nullable=False),
        sa.Column("who", sa.Text, nullable=False),
        sa.Column("kind", sa.String(32), nullable=False),
        sa.Column("subject", sa.Text, nullable=False),
        sa.Column("detail", sa.Text, nullable=False),
        sa.Column("address", sa.Text, nullable=False),
        sa.Index("audit_at", "at"),
    )
    op.create_table(
        "webhooks",
        sa.Column("id", sa.Integer, primary_key=True),
        account(),
        sa.Column("url", sa.Text, nullable=False),
        sa.Column("secret", sa.Text, nullable=False),
        sa.Column("events", sa.Text, nullable=False),
        sa.Column("created", sa.String(32), nullable=False),
    )
    op.create_table(
        "deliveries",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("webhook_id", sa.Integer, sa.ForeignKey("webhooks.id"), nullable=False),
        sa.Column("event", sa.String(32), nullable=False),
        sa.Column("payload", sa.Text, nullable=False),
        sa.Column("attempts", sa.Integer, nullable=False),
        sa.Column("due", sa.String(32), nullable=False, index=True),
        sa.Column("problem", sa.Text, nullable=False),
    )


def _claimable_accounts() -> None:
    connection = op.get_bind()
    names = connection.execute(
        sa.text("SELECT who FROM commands GROUP BY who ORDER BY MIN(at)")
    ).scalars()
    at = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    by_key: dict[str, str] = {}
    for name in names:
        if name not in _MACHINES:
            by_key.setdefault(unicodedata.normalize("NFKC", name).casefold()[:255], name)
    insert = sa.text(
        "INSERT INTO accounts (name, key, role, status, created) "
        "VALUES (:name, :key, 'annotator', 'unclaimed', :at)"
    )
    for key, name in by_key.items():
        connection.execute(insert, {"name": name, "key": key, "at": at})


def _append_only(table: str) -> None:
    text = f"{table} are only ever appended" if table == "commands" else "audit is append-only"
    if op.get_bind().dialect.name == "sqlite":
        for event in ("UPDATE", "DELETE"):
            op.execute(
                f"CREATE TRIGGER {table}_no_{event.lower()} BEFORE {event} ON {table} "
                f"BEGIN SELECT RAISE(ABORT, '{text}'); END"
            )
    elif op.get_bind().dialect.name == "postgresql":
        op.execute(
            f"CREATE FUNCTION {table}_append_only() RETURNS trigger LANGUAGE plpgsql AS "
            f"$$ BEGIN RAISE EXCEPTION '{text}'; END $$"
        )
        op.execute(
            f"CREATE TRIGGER {table}_append_only BEFORE UPDATE OR DELETE OR TRUNCATE ON {table} "
            f"FOR EACH STATEMENT EXECUTE FUNCTION {table}_append_only()"
        )
