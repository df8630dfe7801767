"""Proofs of an account: browser sessions, tokens for scripts, and an organisation's provider.

Browser sessions and tokens can be revoked. Identities are people whom an OpenID Connect provider
knows; logins through it that are under way are kept here too.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, get_args

from sqlalchemy import Connection, Row, delete, insert, select

from model.core.errors import ConfigurationError
from sessions.account_tables import (
    accounts,
    identities,
    invitations,
    logins,
    record,
    tokens,
    web_sessions,
)
from sessions.accounts import (
    COMMAND_LINE,
    Account,
    digest,
    end_credentials,
    enter_account,
    keep_a_manager,
    name_key,
    new_secret,
    set_values,
    usable_name,
)
from sessions.checks import clean_text
from sessions.database import Database, now
from sessions.review import ROLES, Role

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
        shown = (tokens.c.id, accounts.c.name, tokens.c.label, tokens.c.scopes, tokens.c.created)
        wanted = select(*shown, tokens.c.expires).order_by(tokens.c.id)
        wanted = wanted.join(accounts, tokens.c.account_id == accounts.c.id)
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


LOGIN_SECONDS = 600.0
"""Longest time at the provider's page."""


class Identities:
    """Maps issuer and subject to accounts. Methods may be called from any thread."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def begin(self, state: str, browser: str, nonce: str, verifier: str) -> None:
        """Store a login that begins; any server of the workspace may finish it.

        Args:
            state, browser: secrets that the provider's answer and the browser's cookie must have.
            nonce, verifier: that the ID token must have, and that the code is exchanged with.
        """
        values = {"state": digest(state), "browser": digest(browser), "nonce": nonce}
        with self._database.writing() as connection:
            connection.execute(delete(logins).where(logins.c.expires < now()))
            expires = now(LOGIN_SECONDS)
            connection.execute(insert(logins).values(**values, verifier=verifier, expires=expires))

    def take(self, state: str, browser: str) -> tuple[str, str] | None:
        """End a login; returns nonce and verifier once, and None for anything else."""
        mine = logins.c.state == digest(state)
        with self._database.writing() as connection:
            row = connection.execute(select(logins).where(mine)).one_or_none()
            connection.execute(delete(logins).where(mine))
        if row is None or row.expires < now() or row.browser != digest(browser):
            return None
        return row.nonce, row.verifier

    def account(
        self, issuer: str, subject: str, name: str, role: Role | None, *, anybody: bool
    ) -> Account:
        """Return the account of a person whom the provider has identified.

        The first login claims an invited account of that name, or the one beside old decisions
        that was invited; it never takes an account that has a password.

        Args:
            name: of the person at the provider; counts at the first login only.
            role: from the provider; None: that of the invitation, or annotator.
            anybody: whether people without an invitation get an account, too.

        Raises:
            ConfigurationError: where the person isn't invited, or the account is disabled.
        """
        known = (identities.c.issuer == issuer) & (identities.c.subject == subject)
        wanted = select(accounts).join(identities, identities.c.account_id == accounts.c.id)
        with self._database.writing() as connection:
            row = connection.execute(wanted.where(known)).one_or_none()
            if row is None:
                account = self._first(connection, name, role, anybody)
                values = {"issuer": issuer, "subject": subject, "account_id": account.id}
                connection.execute(insert(identities).values(**values, since=now()))
                record(connection, "claimed", account.name, account.name, issuer)
                return account
            account = Account(row.id, row.name, row.role, row.status)
            if account.status == "invited":  # a manager let the person in again
                set_values(connection, account, status="active")
                connection.execute(delete(invitations).where(_invitation_of(account)))
            elif account.status != "active":
                raise ConfigurationError(f"the account {account.name} is {account.status}")
            if role is not None and role != account.role:
                if role != "manager":
                    keep_a_manager(connection, account)
                set_values(connection, account, role=role)
                change = f"{account.role} → {role}"
                record(connection, "role_changed", issuer, account.name, change)
        return Account(account.id, account.name, role or account.role, "active")

    def _first(
        self, connection: Connection, name: str, role: Role | None, anybody: bool
    ) -> Account:
        name = usable_name(name)
        row = connection.execute(
            select(accounts).where(accounts.c.key == name_key(name))
        ).one_or_none()
        invited = row is not None and row.status == "invited"
        if not invited and (row is not None or not anybody):
            raise ConfigurationError(
                f"{name} isn't invited here; ask a manager for an invitation under that name"
            )
        kept: Role = row.role if row is not None else "annotator"
        account = enter_account(connection, name, role or kept, "active", None)
        connection.execute(delete(invitations).where(_invitation_of(account)))
        return account


def _invitation_of(account: Account) -> Any:
    return invitations.c.account_id == account.id
