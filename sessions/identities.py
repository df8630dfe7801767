"""People whom an organisation's OpenID Connect provider knows, and logins that are under way."""

from __future__ import annotations

from typing import Any

from sqlalchemy import Connection, delete, insert, select, update

from model.core.errors import ConfigurationError
from sessions.account_tables import accounts, identities, invitations, logins
from sessions.accounts import Account, enter_account, keep_a_manager, name_key, usable_name
from sessions.audit import record
from sessions.database import Database
from sessions.records import now
from sessions.review import Role
from sessions.secrets import digest

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
                _set(connection, account, status="active")
                connection.execute(delete(invitations).where(_invitation_of(account)))
            elif account.status != "active":
                raise ConfigurationError(f"the account {account.name} is {account.status}")
            if role is not None and role != account.role:
                if role != "manager":
                    keep_a_manager(connection, account)
                _set(connection, account, role=role)
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


def _set(connection: Connection, account: Account, **values: str) -> None:
    connection.execute(update(accounts).where(accounts.c.id == account.id).values(**values))
