"""People of a workspace: what each may do, who works on what, and who is there now.

A person who decides something about an object leases it, or asks for the next one; others who
annotate can't change it then. The lease ends some time after the last decision, or when the person
leaves. Presence only says who has the object open.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

from sqlalchemy import Connection, delete, func, insert, select, update

from model.core.errors import ConfigurationError
from sessions.account_tables import AuditLog, accounts, assignments, presence, record
from sessions.accounts import COMMAND_LINE, PROGRAMS, Account, Accounts, in_use, name_key
from sessions.commands import Command, JobResult
from sessions.credentials import Credentials, Identities
from sessions.database import Database, ObjectRecord, now, objects
from sessions.review import ROLES, NotPermittedError, ReviewState, Role
from sessions.webhooks import Webhooks, enqueue

LEASE_SECONDS = 15 * 60.0
"""After the last decision: long enough to look something up, and short of a lunch."""
PRESENCE_SECONDS = 60.0
"""After the last sign of life of a browser, which comes every :data:`HEARTBEAT_SECONDS`."""
HEARTBEAT_SECONDS = 20.0
_TO_ANNOTATE: tuple[ReviewState, ...] = ("rejected", "in_progress", "todo")
_TO_REVIEW: tuple[ReviewState, ...] = ("submitted", "predicted")


@dataclass(frozen=True)
class Presence:
    """A person who has an object open.

    Attributes:
        name: of the account.
        since: ISO 8601, UTC.
        leased: whether others who annotate can't change the object.
    """

    name: str
    since: str
    leased: bool


class Work:
    """Assignments and leases of a workspace. Methods may be called from any thread."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def assign(self, object_ids: Sequence[int], to: Sequence[Account], by: str) -> dict[int, str]:
        """Assign objects to people in turn; to nobody takes them from whom they were assigned to.

        Returns:
            object id → name.

        Raises:
            ConfigurationError: where an account is disabled, or there is no such object.
            NotPermittedError: where ``by`` is no manager now.
        """
        for account in to:
            if account.status == "disabled":
                raise ConfigurationError(f"the account {account.name} is disabled")
        given = dict(zip(object_ids, cycle(to), strict=False)) if to else {}
        with self._database.writing() as connection:
            _check_manager(connection, by)
            known = set(connection.execute(select(objects.c.id)).scalars())
            unknown = [i for i in object_ids if i not in known]
            if unknown:
                raise ConfigurationError(f"there is no object {unknown[0]}")
            mine = assignments.c.object_id.in_(list(object_ids))
            connection.execute(delete(assignments).where(mine))
            for object_id, account in given.items():
                values = {"object_id": object_id, "account_id": account.id, "at": now()}
                connection.execute(insert(assignments).values(values))
            for object_id in object_ids:
                name = given[object_id].name if to else ""
                record(connection, "assigned", by, f"object {object_id}", name)
        return {i: account.name for i, account in given.items()}

    def assigned(self) -> dict[int, str]:
        """Return object id → name of the person whom it is assigned to."""
        wanted = select(assignments.c.object_id, accounts.c.name).join(accounts)
        with self._database.reading() as connection:
            return {row.object_id: row.name for row in connection.execute(wanted)}

    def enter(self, object_id: int, account: Account) -> None:
        """Say that a person has the object open; again every :data:`HEARTBEAT_SECONDS`."""
        with self._database.writing() as connection:
            _put(connection, object_id, account.id, until=now(PRESENCE_SECONDS))

    def leave(self, object_id: int, account: Account) -> None:
        """Say that a person left an object; the lease ends."""
        mine = (presence.c.object_id == object_id) & (presence.c.account_id == account.id)
        with self._database.writing() as connection:
            connection.execute(delete(presence).where(mine))

    def present(self, object_id: int) -> list[Presence]:
        """Return who has an object open or leased, by name."""
        wanted = (
            select(accounts.c.name, presence.c.since, presence.c.lease)
            .join(accounts)
            .where(presence.c.object_id == object_id)
            .where((presence.c.until > now()) | (presence.c.lease > now()))
            .order_by(accounts.c.key)
        )
        with self._database.reading() as connection:
            rows = connection.execute(wanted).all()
        return [Presence(row.name, row.since, row.lease > now()) for row in rows]

    def next(self, account: Account, records: Iterable[ObjectRecord]) -> int | None:
        """Lease the next object to work on to a person; None where nothing waits.

        Objects that came back come first, then those assigned to the person, then those of nobody.
        Who reviews gets what was submitted or predicted.
        """
        ordered = queue_for(account, records, self.assigned())
        for object_id in ordered:
            with self._database.writing() as connection:
                # Locks the object's line where the database doesn't lock as a whole.
                line = select(objects.c.id).where(objects.c.id == object_id).with_for_update()
                connection.execute(line)
                if lease_holder(connection, object_id, account.id) is None:
                    renew_lease(connection, object_id, account.id)
                    return object_id
        return None


def queue_for(
    account: Account, records: Iterable[ObjectRecord], assigned: Mapping[int, str]
) -> list[int]:
    """Return the ids of the objects that wait for a person, the most urgent first."""
    states = _TO_ANNOTATE if account.role == "annotator" else (*_TO_REVIEW, *_TO_ANNOTATE)
    ranked: list[tuple[tuple[int, int], int]] = []
    for place, one in enumerate(records):
        # A returned object waits for its annotator, unless it was given to somebody else.
        waits_for = one.assigned_to if one.state == "rejected" else None
        owner = assigned.get(one.id, None if waits_for in PROGRAMS else waits_for)
        to_review = account.role != "annotator" and one.state in _TO_REVIEW
        if one.state not in states or not (to_review or owner in (None, account.name)):
            continue
        returned = one.state == "rejected" and owner == account.name
        rank = 0 if returned else 1 + states.index(one.state) * 2 + (owner != account.name)
        ranked.append(((rank, place), one.id))
    return [object_id for _, object_id in sorted(ranked)]


def lease_holder(connection: Connection, object_id: int, account_id: int) -> str | None:
    """Return who else than ``account_id`` has the lease of an object, or None."""
    wanted = (
        select(accounts.c.name)
        .join(presence, presence.c.account_id == accounts.c.id)
        .where(presence.c.object_id == object_id, presence.c.lease > now())
        .where(presence.c.account_id != account_id)
    )
    return connection.execute(wanted).scalars().first()


def renew_lease(connection: Connection, object_id: int, account_id: int) -> None:
    """Have a person's lease last from now on, unless somebody else has it."""
    if lease_holder(connection, object_id, account_id) is None:
        until = now(PRESENCE_SECONDS)
        _put(connection, object_id, account_id, until=until, lease=now(LEASE_SECONDS))


def end_lease(connection: Connection, object_id: int, account_id: int) -> None:
    """Let others take an object that a person may still have open."""
    mine = (presence.c.object_id == object_id) & (presence.c.account_id == account_id)
    connection.execute(update(presence).where(mine).values(lease=""))


def check_owner(connection: Connection, object_id: int, account: Account) -> None:
    """Refuse to let a person annotate what is another's.

    Raises:
        NotPermittedError: naming whose it is.
    """
    holder = lease_holder(connection, object_id, account.id)
    if holder is not None:
        raise NotPermittedError(f"{holder} works on this object now; take another one, or wait")
    wanted = (
        select(accounts.c.name, accounts.c.id)
        .join(assignments, assignments.c.account_id == accounts.c.id)
        .where(assignments.c.object_id == object_id)
    )
    owner = connection.execute(wanted).one_or_none()
    if owner is not None and owner.id != account.id:
        raise NotPermittedError(f"this object is assigned to {owner.name}")


def _check_manager(connection: Connection, by: str) -> None:
    role = select(accounts.c.role).where(accounts.c.name == by, accounts.c.status == "active")
    if by != COMMAND_LINE and connection.execute(role).scalar() != "manager":
        raise NotPermittedError("only a manager may assign objects")


def _put(connection: Connection, object_id: int, account_id: int, **values: Any) -> None:
    mine = (presence.c.object_id == object_id) & (presence.c.account_id == account_id)
    found = select(func.count()).select_from(presence).where(mine)
    if connection.execute(found).scalar():
        connection.execute(update(presence).where(mine).values(**values))
        return
    line = {"lease": "", "until": now(), **values, "since": now()}
    connection.execute(insert(presence).values(object_id=object_id, account_id=account_id, **line))


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
            if isinstance(command, JobResult) or who in PROGRAMS:
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
