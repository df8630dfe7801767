"""Accounts of people: names, roles and passwords.

Without any account that was added or invited nobody has to log in, and everybody may do all, as on
a machine of one person. Accounts that a migration made of the names beside old decisions don't
count until somebody is invited to claim them.
"""

from __future__ import annotations

import contextlib
import hashlib
import secrets
import threading
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError
from sqlalchemy import Connection, Row, delete, exc, insert, select, update

from model.core.errors import ConfigurationError, StoreError
from sessions.account_tables import accounts, invitations, record, tokens, web_sessions
from sessions.checks import clean_text
from sessions.commands import NAME_LIMIT
from sessions.database import Database, now
from sessions.review import ROLES, Role


def new_secret(prefix: str = "") -> str:
    """Return a secret of 256 random bits."""
    return prefix + secrets.token_urlsafe(32)


def digest(secret: str) -> str:
    """Return what is stored of a secret; SHA-256 suffices, as nobody can guess 256 bits."""
    return hashlib.sha256(secret.encode("utf-8", "replace")).hexdigest()


MIN_LENGTH = 10
"""Characters; the least that NIST SP 800-63B allows is 8."""
MAX_LENGTH = 1000
"""Characters, so that nobody has the server hash megabytes."""

hasher = PasswordHasher()
"""argon2id with the library's parameters: the second ones of RFC 9106, 64 MiB."""
_slots, _places = threading.BoundedSemaphore(2), threading.BoundedSemaphore(8)
"""Hashes at a time, as each takes 64 MiB, and with those that wait: visitors decide how many are
asked for, and each has a thread of the server's."""


class TooManyAttempts(ConfigurationError):
    """An address or a name had too many wrong passwords lately, or all are busy with others'."""


@contextlib.contextmanager
def _turn() -> Iterator[None]:
    if not _places.acquire(blocking=False):
        raise TooManyAttempts("Many people log in just now; try again in a few seconds.")
    try:
        with _slots:
            yield
    finally:
        _places.release()


def check_password(password: str, name: str) -> None:
    """Refuse a password that is too short, too long, or the name.

    Raises:
        ConfigurationError: with what would be right.
    """
    if not MIN_LENGTH <= len(password) <= MAX_LENGTH:
        raise ConfigurationError(
            f"the password has {len(password)} characters; give {MIN_LENGTH} to {MAX_LENGTH}"
        )
    if name.casefold() in password.casefold() and len(password) < len(name) + MIN_LENGTH:
        raise ConfigurationError("the password is little more than the name; choose another")


def hash_password(password: str) -> str:
    """Return the argon2id hash with its parameters."""
    with _turn():
        return hasher.hash(password)


def is_password(stored: str | None, password: str) -> bool:
    """True if ``password`` belongs to the stored hash; None takes the same work and is False."""
    with _turn():
        dummy = dummy_hash()  # here, so that the first question of either kind makes it
        try:
            right = hasher.verify(stored or dummy, password[:MAX_LENGTH])
        except (VerificationError, InvalidHashError):
            return False
    return right and stored is not None and len(password) <= MAX_LENGTH


@cache
def dummy_hash() -> str:
    """A hash of nothing anybody knows, for accounts that have no password."""
    return hasher.hash(secrets.token_bytes(32))


Status = Literal["unclaimed", "invited", "active", "disabled"]
INVITATION_SECONDS = 7 * 86400.0
COMMAND_LINE = "command line"
"""Author of events that the machine's own user caused."""
PROGRAMS: frozenset[str] = frozenset(
    {"segmenter", "source file", "masks of another system", "scene", "scripted annotator"}
)
"""Authors of what programs decide; no person may have these names."""
_RESERVED = PROGRAMS | {"anonymous", COMMAND_LINE}


@dataclass(frozen=True)
class Account:
    """A person who may log in.

    Attributes:
        id: in this workspace.
        name: stands beside decisions; never changes.
        role: what the person may do.
        status: "unclaimed" from old decisions, "invited" without a password yet, "active",
            "disabled".
    """

    id: int
    name: str
    role: Role
    status: Status


class Accounts:
    """All accounts of a workspace. Methods may be called from any thread.

    ``by`` is the author of a change, for the audit.
    """

    def __init__(self, database: Database) -> None:
        self._database = database

    def in_use(self) -> bool:
        """True if people have to log in."""
        with self._database.reading() as connection:
            return in_use(connection)

    def all(self) -> list[Account]:
        """Return all accounts by name."""
        with self._database.reading() as connection:
            rows = connection.execute(select(accounts).order_by(accounts.c.key)).all()
        return [_account(row) for row in rows]

    def find(self, name: str) -> Account:
        """Return the account of that name, whatever its case.

        Raises:
            ConfigurationError: where there is none.
        """
        with self._database.reading() as connection:
            return _account(_need(connection, name))

    def add(self, name: str, role: Role, password: str, by: str = COMMAND_LINE) -> Account:
        """Add an active account, or claim the one of that name for the person.

        Raises:
            ConfigurationError: where the name is taken, or name, role or password are unusable.
        """
        name = _usable(name, role)
        check_password(password, name)
        hashed = hash_password(password)
        with self._database.writing() as connection:
            account = enter_account(connection, name, role, "active", hashed)
            record(connection, "account_added", by, account.name, role)
        return account

    def invite(self, name: str, role: Role, by: str = COMMAND_LINE) -> str:
        """Invite a person, who then chooses a password; returns the secret of the link.

        An invitation that is open already ends: the newest link counts. It also lets a disabled
        person in again, such as one who lost the password.

        Raises:
            ConfigurationError: where the account is active, or name or role unusable.
        """
        name = _usable(name, role)
        secret = new_secret()
        with self._database.writing() as connection:
            account = enter_account(connection, name, role, "invited", None)
            mine = invitations.c.account_id == account.id
            connection.execute(delete(invitations).where(mine))
            values = {"hash": digest(secret), "expires": now(INVITATION_SECONDS)}
            connection.execute(insert(invitations).values(account_id=account.id, **values))
            record(connection, "invited", by, account.name, role)
        return secret

    def invited(self, secret: str) -> Account | None:
        """Return the account that an invitation is for; None where it expired or was used."""
        with self._database.reading() as connection:
            row = connection.execute(_invitation(secret)).one_or_none()
        return None if row is None else _account(row)

    def claim(self, secret: str, password: str, address: str = "") -> Account:
        """Use an invitation: the account becomes active with ``password``.

        Raises:
            ConfigurationError: where the link expired or was used, or the password is unusable.
        """
        account = self.invited(secret)
        if account is None:
            raise ConfigurationError("this invitation expired or was used; ask for a new one")
        check_password(password, account.name)
        hashed = hash_password(password)
        with self._database.writing() as connection:
            used = connection.execute(
                delete(invitations).where(invitations.c.hash == digest(secret))
            )
            if used.rowcount != 1:  # another request was first
                raise ConfigurationError("this invitation was used just now; log in")
            set_values(connection, account, status="active", password=hashed)
            record(connection, "claimed", account.name, account.name, address=address)
        return Account(account.id, account.name, account.role, "active")

    def check(self, name: str, password: str) -> Account | None:
        """Return the active account of name and password, else None, after the same work."""
        with self._database.reading() as connection:
            row = _row(connection, name)
        usable = row is not None and row.status == "active"
        right = is_password(row.password if row is not None and usable else None, password)
        return _account(row) if row is not None and right else None

    def change_password(self, name: str, password: str, by: str, keep: str | None = None) -> None:
        """Set a password and end the person's browser sessions and tokens.

        Args:
            keep: secret of the browser session that stays: the one in which it is changed.
        """
        account = self.find(name)
        if account.status != "active":
            raise ConfigurationError(f"the account {name} is {account.status}")
        check_password(password, account.name)
        hashed = hash_password(password)
        with self._database.writing() as connection:
            set_values(connection, account, password=hashed)
            end_credentials(connection, account.id, keep)
            record(connection, "password_changed", by, account.name)

    def set_role(self, name: str, role: Role, by: str = COMMAND_LINE) -> Account:
        """Change what a person may do, from the next command on.

        Raises:
            ConfigurationError: where it is the last manager, or there is no such account or role.
        """
        _usable("anybody", role)
        with self._database.writing() as connection:
            account = _account(_need(connection, name))
            if role != "manager":
                keep_a_manager(connection, account)
            set_values(connection, account, role=role)
            record(connection, "role_changed", by, account.name, f"{account.role} → {role}")
        return Account(account.id, account.name, role, account.status)

    def disable(self, name: str, by: str = COMMAND_LINE) -> None:
        """Keep a person out from now on: sessions and tokens end, decisions stay.

        Raises:
            ConfigurationError: where it is the last manager, or there is no such account.
        """
        with self._database.writing() as connection:
            account = _account(_need(connection, name))
            keep_a_manager(connection, account)
            set_values(connection, account, status="disabled")
            mine = invitations.c.account_id == account.id
            connection.execute(delete(invitations).where(mine))
            end_credentials(connection, account.id)
            record(connection, "disabled", by, account.name)


def name_key(name: str) -> str:
    """Return the form of a name in which two people can't have the same."""
    return unicodedata.normalize("NFKC", name).casefold()[:255]


def in_use(connection: Connection) -> bool:
    """True if an account was ever added or invited."""
    known = select(accounts.c.id).where(accounts.c.status != "unclaimed").limit(1)
    return connection.execute(known).first() is not None


def end_credentials(connection: Connection, account_id: int, keep: str | None = None) -> None:
    """End the browser sessions and tokens of an account, but for the session of ``keep``."""
    ended = delete(web_sessions).where(web_sessions.c.account_id == account_id)
    if keep is not None:
        ended = ended.where(web_sessions.c.hash != digest(keep))
    connection.execute(ended)
    connection.execute(delete(tokens).where(tokens.c.account_id == account_id))


def _usable(name: str, role: str) -> str:
    if role not in ROLES:
        raise ConfigurationError(f"there is no role {role[:40]!r}; choose {', '.join(ROLES)}")
    return usable_name(name)


def usable_name(name: str) -> str:
    """Return a person's name as accounts have it.

    Raises:
        ConfigurationError: where it is too short, has odd characters, or stands for a program.
    """
    clean = clean_text(name, NAME_LIMIT, "the name")
    _check_letters(name)
    if len(clean) < 2 or clean != " ".join(clean.split()):
        raise ConfigurationError(f"the name {name[:80]!r} needs two characters, and single blanks")
    if name_key(clean) in _RESERVED:
        raise ConfigurationError(f"the name {clean} stands for a program; choose another")
    return clean


_TOGETHER = frozenset({"LATIN", "CJK", "HIRAGANA", "KATAKANA", "HANGUL", "BOPOMOFO"})
"""Scripts that are written in one word."""
_UNSEEN = ("FILLER", "SELECTOR", "JOINER")


def _check_letters(name: str) -> None:
    """Refuse letters that can't be seen, and mixed scripts, as their letters look alike.

    Names wholly of one script are allowed whatever they look like: UTS 39, level 3.

    Raises:
        ConfigurationError: with what would be right.
    """
    letters = {c: unicodedata.name(c, "") for c in unicodedata.normalize("NFKC", name.strip())}
    odd = "".join(c for c in letters if unicodedata.category(c)[0] in "CZ").replace(" ", "")
    if odd or any(unseen in words for words in letters.values() for unseen in _UNSEEN):
        raise ConfigurationError(f"the name {name[:80]!r} has characters that can't be seen")
    scripts = {words.split(" ")[0] for c, words in letters.items() if c.isalpha()}
    if len(scripts) > 1 and scripts - _TOGETHER:
        mixed = ", ".join(sorted(scripts)).lower()
        raise ConfigurationError(f"the name {name[:80]!r} mixes {mixed} letters; use one script")


def enter_account(
    connection: Connection, name: str, role: Role, status: Status, password: str | None
) -> Account:
    """Add the account, or take one that nobody has claimed yet."""
    row = _row(connection, name)
    values = {"role": role, "status": status, "password": password}
    if row is None:
        values |= {"name": name, "key": name_key(name), "created": now()}
        try:
            connection.execute(insert(accounts).values(values))
        except exc.IntegrityError as error:
            raise StoreError(f"the account {name} was added just now by somebody else") from error
    elif row.status != "active":
        connection.execute(update(accounts).where(accounts.c.id == row.id).values(values))
    else:
        raise ConfigurationError(f"there is an account {row.name} already")
    return _account(_need(connection, name))


def _invitation(secret: str) -> Any:
    return (
        select(accounts)
        .join(invitations, invitations.c.account_id == accounts.c.id)
        .where(invitations.c.hash == digest(secret), invitations.c.expires > now())
        .where(accounts.c.status == "invited")
    )


def keep_a_manager(connection: Connection, account: Account) -> None:
    """Refuse to take the last manager's role.

    Raises:
        ConfigurationError: where there is no other one.
    """
    other = (
        (accounts.c.role == "manager")
        & (accounts.c.status == "active")
        & (accounts.c.id != account.id)
    )
    alone = connection.execute(select(accounts.c.id).where(other).limit(1)).first() is None
    if account.role == "manager" and account.status == "active" and alone:
        raise ConfigurationError(f"{account.name} is the last manager; make another one first")


def _row(connection: Connection, name: str) -> Row[Any] | None:
    wanted = select(accounts).where(accounts.c.key == name_key(name))
    return connection.execute(wanted).one_or_none()


def _need(connection: Connection, name: str) -> Row[Any]:
    row = _row(connection, name)
    if row is None:
        raise ConfigurationError(f"there is no account {name[:80]!r}; see artiworld user list")
    return row


def set_values(connection: Connection, account: Account, **values: str) -> None:
    """Change columns of an account."""
    connection.execute(update(accounts).where(accounts.c.id == account.id).values(**values))


def _account(row: Row[Any]) -> Account:
    return Account(row.id, row.name, row.role, row.status)
