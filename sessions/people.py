"""Accounts, credentials, work, webhooks and audit of a workspace, and what a person may do."""

from __future__ import annotations

from typing import Any

from sqlalchemy import Connection, select

from sessions.account_tables import accounts
from sessions.accounts import PROGRAMS, Account, Accounts, in_use, name_key
from sessions.audit import AuditLog
from sessions.commands import Command, Placed, RecordSegmentation, Saved
from sessions.credentials import Credentials
from sessions.database import Database
from sessions.identities import Identities
from sessions.review import ROLES, NotPermittedError, Role
from sessions.webhooks import Webhooks, enqueue
from sessions.work import Work, check_owner, end_lease, renew_lease

JOB_RESULTS = (RecordSegmentation, Saved, Placed)
"""Commands that only a job gives; the server lets nobody send them."""

HANDING_OVER = ("submit", "accept", "reject")
"""Stored names of the commands after which it is somebody else's turn."""


class People:
    """Everything about the people of one workspace.

    Attributes:
        accounts: names, roles and passwords.
        credentials: browser sessions and tokens.
        identities: whom an OpenID Connect provider knows.
        work: assignments, leases and presence.
        audit: what happened to accounts.
        webhooks: addresses that hear of decisions.
    """

    def __init__(self, database: Database) -> None:
        self._database = database
        self.accounts = Accounts(database)
        self.credentials = Credentials(database)
        self.identities = Identities(database)
        self.work = Work(database)
        self.audit = AuditLog(database)
        self.webhooks = Webhooks(database)

    def role_for(
        self, object_id: int, command: Command, who: str, most: Role | None = None
    ) -> Role:
        """Return the role in which ``who`` may give ``command`` now.

        It is looked up at each command, so that a changed role counts from the next one on.

        Args:
            most: no higher role is returned, where it is given.

        Raises:
            NotPermittedError: where people have to log in and ``who`` has no active account, or
                where the object is another person's.
        """
        with self._database.reading() as connection:
            if not in_use(connection):
                return most or "reviewer"
            if isinstance(command, JOB_RESULTS) or who in PROGRAMS:
                return "annotator"
            account = _active(connection, who)
            role = account.role
            if most is not None and ROLES.index(most) < ROLES.index(role):
                role = most
            if role == "annotator":
                check_owner(connection, object_id, account)
        return role

    def decided(self, connection: Connection, line: dict[str, Any]) -> None:
        """Renew or end the author's lease and tell webhooks, in the command's transaction."""
        enqueue(connection, line)
        if line["who"] in PROGRAMS:
            return
        mine = select(accounts.c.id).where(accounts.c.key == name_key(line["who"]))
        account_id = connection.execute(mine.where(accounts.c.status == "active")).scalar()
        if account_id is None:
            return
        if line["kind"] in HANDING_OVER:
            end_lease(connection, line["object_id"], account_id)
        else:
            renew_lease(connection, line["object_id"], account_id)


def _active(connection: Connection, who: str) -> Account:
    row = connection.execute(select(accounts).where(accounts.c.key == name_key(who))).one_or_none()
    if row is None or row.status != "active":
        raise NotPermittedError(f"{who} has no active account here; log in with one")
    return Account(row.id, row.name, row.role, row.status)
