"""Credentials of accounts: browser sessions and tokens for scripts. Both can be revoked."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, get_args

from sqlalchemy import Row, delete, insert, select

from model.core.errors import ConfigurationError
from sessions.account_tables import accounts, tokens, web_sessions
from sessions.accounts import COMMAND_LINE, Account, end_credentials
from sessions.audit import record
from sessions.database import Database
from sessions.records import now
from sessions.review import ROLES, Role
from sessions.secrets import digest, new_secret
from sessions.text import clean_text

Scope = Literal["read", "annotate", "review", "manage"]
SCOPES: tuple[Scope, ...] = get_args(Scope)
SCOPES_OF: dict[Role, frozenset[Scope]] = {
    role: frozenset(SCOPES[: 2 + place]) for place, role in enumerate(ROLES)
}
"""Role → what it allows; a token allows at most that."""
SESSION_SECONDS = 30 * 86400.0
TOKEN_DAYS = 90
MOST_TOKEN_DAYS = 730
TOKEN_PREFIX = "awt_"
"""By it secret scanners recognise a token in published files."""


@dataclass(frozen=True)
class Token:
    """A token as it is listed; its secret is shown once, when it is made."""

    id: int
    account: str
    label: str
    scopes: tuple[str, ...]
    created: str
    expires: str


@dataclass(frozen=True)
class Person:
    """Current user, and the permissions of the credentials in use.

    Attributes:
        account: None where nobody has to log in.
        name: stands beside decisions.
        scopes: what is allowed.
        session: the secret of the browser session, where there is one.
    """

    account: Account | None
    name: str
    scopes: frozenset[Scope]
    session: str | None = None

    @property
    def role(self) -> Role:
        """The role that the scopes allow at most."""
        if "manage" in self.scopes:
            return "manager"
        return "reviewer" if "review" in self.scopes else "annotator"


class Credentials:
    """Browser sessions and tokens of a workspace. Methods may be called from any thread."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def begin_session(self, account: Account, address: str = "") -> str:
        """Begin a browser session; returns its secret, for a cookie."""
        secret = new_secret()
        values = {"hash": digest(secret), "account_id": account.id, "created": now()}
        with self._database.writing() as connection:
            old = delete(web_sessions).where(web_sessions.c.expires < now())
            connection.execute(old)
            expires = now(SESSION_SECONDS)
            connection.execute(insert(web_sessions).values(**values, expires=expires))
            record(connection, "login", account.name, account.name, address=address)
        return secret

    def session(self, secret: str) -> Person | None:
        """Return who has that browser session; None where it ended."""
        wanted = (
            select(accounts)
            .join(web_sessions, web_sessions.c.account_id == accounts.c.id)
            .where(web_sessions.c.hash == digest(secret), web_sessions.c.expires > now())
            .where(accounts.c.status == "active")
        )
        with self._database.reading() as connection:
            row = connection.execute(wanted).one_or_none()
        return None if row is None else _person(row, SCOPES, secret)

    def end_session(self, secret: str, address: str = "") -> None:
        """Log out."""
        person = self.session(secret)
        if person is None:
            return
        with self._database.writing() as connection:
            connection.execute(delete(web_sessions).where(web_sessions.c.hash == digest(secret)))
            record(connection, "logout", person.name, person.name, address=address)

    def revoke(self, account: Account, by: str = COMMAND_LINE) -> None:
        """End all browser sessions and tokens of an account."""
        with self._database.writing() as connection:
            end_credentials(connection, account.id)
            record(connection, "sessions_revoked", by, account.name)

    def make_token(
        self,
        account: Account,
        label: str,
        scopes: Iterable[str],
        days: int = TOKEN_DAYS,
        by: str = COMMAND_LINE,
    ) -> str:
        """Make a token; returns its secret, which nothing shows again.

        Raises:
            ConfigurationError: where the role doesn't allow a scope, or a value is unusable.
        """
        asked = [scope for scope in SCOPES if scope in set(scopes)]
        unknown = sorted(set(scopes) - set(SCOPES))
        if unknown or not asked:
            raise ConfigurationError(
                f"scopes must be of {', '.join(SCOPES)}; got {', '.join(unknown) or 'none'}"
            )
        if not SCOPES_OF[account.role].issuperset(asked):
            raise ConfigurationError(f"the role {account.role} doesn't allow {', '.join(asked)}")
        if account.status != "active":
            raise ConfigurationError(f"the account {account.name} is {account.status}")
        if not 1 <= days <= MOST_TOKEN_DAYS:
            raise ConfigurationError(f"a token lasts 1 to {MOST_TOKEN_DAYS} days, not {days}")
        label = clean_text(label, 80, "the token's label") or "token"
        secret = new_secret(TOKEN_PREFIX)
        values = {"hash": digest(secret), "account_id": account.id, "label": label}
        with self._database.writing() as connection:
            connection.execute(
                insert(tokens).values(
                    **values, scopes=" ".join(asked), created=now(), expires=now(days * 86400.0)
                )
            )
            detail = f"{label}: {', '.join(asked)}"
            record(connection, "token_made", by, account.name, detail)
        return secret

    def token(self, secret: str) -> Person | None:
        """Return whose token it is; None where it expired, was revoked or never was."""
        wanted = (
            select(accounts, tokens.c.scopes)
            .join(tokens, tokens.c.account_id == accounts.c.id)
            .where(tokens.c.hash == digest(secret), tokens.c.expires > now())
            .where(accounts.c.status == "active")
        )
        with self._database.reading() as connection:
            row = connection.execute(wanted).one_or_none()
        return None if row is None else _person(row, row.scopes.split())

    def tokens(self, account: Account | None = None) -> list[Token]:
        """Return the tokens of an account, or of all."""
        wanted = select(
            tokens.c.id, accounts.c.name, tokens.c.label, tokens.c.scopes, tokens.c.created,
            tokens.c.expires,
        ).join(accounts, tokens.c.account_id == accounts.c.id).order_by(tokens.c.id)  # fmt: skip
        if account is not None:
            wanted = wanted.where(tokens.c.account_id == account.id)
        with self._database.reading() as connection:
            rows = connection.execute(wanted).all()
        return [Token(*row[:3], tuple(row.scopes.split()), *row[4:]) for row in rows]

    def revoke_token(self, token_id: int, by: str = COMMAND_LINE) -> None:
        """End a token.

        Raises:
            ConfigurationError: where there is none with that id.
        """
        found = next((t for t in self.tokens() if t.id == token_id), None)
        if found is None:
            raise ConfigurationError(f"there is no token {token_id}")
        with self._database.writing() as connection:
            connection.execute(delete(tokens).where(tokens.c.id == token_id))
            record(connection, "token_revoked", by, found.account, found.label)


def _person(row: Row[Any], scopes: Iterable[str], session: str | None = None) -> Person:
    account = Account(row.id, row.name, row.role, row.status)
    allowed: set[Scope] = set(SCOPES_OF[account.role])
    return Person(account, account.name, frozenset(allowed.intersection(scopes)), session)
