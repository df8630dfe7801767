"""Implementation of the account commands."""

from __future__ import annotations

import getpass
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

from app.cli import printing
from app.cli import user_commands as options
from model.core.errors import ConfigurationError
from sessions.accounts import Account
from sessions.people import People
from sessions.store import Store


def add(asked: options.UserAddCommand) -> int:
    """Add an account with a password that is asked for."""
    with _people(asked) as people:
        account = people.accounts.add(asked.name, asked.role, _password())
    return _say(asked, asdict(account), f"Added {account.name}, {account.role}")


def invite(asked: options.UserInviteCommand) -> int:
    """Print an invitation's link."""
    with _people(asked) as people:
        code = people.accounts.invite(asked.name, asked.role)
    link = f"{asked.url.rstrip('/')}/login#invitation={code}"
    return _say(asked, {"name": asked.name, "link": link}, f"For {asked.name}, once: {link}")


def list_accounts(asked: options.UserListCommand) -> int:
    """Print all accounts."""
    with _people(asked) as people:
        found = people.accounts.all()
    lines = [f"{a.name}  {a.role}  {a.status}" for a in found] or ["No accounts: nobody logs in"]
    return _say(asked, [asdict(a) for a in found], *lines)


def set_role(asked: options.UserRoleCommand) -> int:
    """Change a role."""
    with _people(asked) as people:
        account = people.accounts.set_role(asked.name, asked.role)
    return _say(asked, asdict(account), f"{account.name} is {account.role} now")


def disable(asked: options.UserDisableCommand) -> int:
    """Disable an account."""
    with _people(asked) as people:
        people.accounts.disable(asked.name)
    return _say(asked, {"disabled": asked.name}, f"{asked.name} can't log in any more")


def revoke(asked: options.UserRevokeCommand) -> int:
    """End the sessions and tokens of an account."""
    with _people(asked) as people:
        people.credentials.revoke(_account(people, asked.name))
    return _say(asked, {"revoked": asked.name}, f"{asked.name} is logged out everywhere")


def make_token(asked: options.UserTokenCommand) -> int:
    """Print a new token."""
    with _people(asked) as people:
        account = _account(people, asked.name)
        scopes = asked.scope or ("read",)
        secret = people.credentials.make_token(account, asked.label, scopes, asked.days)
    return _say(asked, {"token": secret}, secret)


def show_audit(asked: options.AuditCommand) -> int:
    """Print events, or decisions about objects."""
    if asked.decisions:
        return _show_decisions(asked)
    with _people(asked) as people:
        events = people.audit.events(
            name=asked.name, kind=asked.kind, since=asked.since, count=asked.count
        )
    lines = [
        f"{e.at[:19]}  {e.who or '-'}  {e.kind}  {e.subject}  {e.detail}  {e.address}".rstrip()
        for e in events
    ]
    return _say(asked, [asdict(e) for e in events], *(lines or ["Nothing"]))


def _show_decisions(asked: options.AuditCommand) -> int:
    with _people(asked) as people:
        found = people.audit.decisions(
            who=asked.name, object_id=asked.object, kind=asked.kind, since=asked.since,
            count=asked.count,
        )  # fmt: skip
    lines = [f"{d.at[:19]}  {d.who}  {d.kind}  {d.name} ({d.object})" for d in found]
    return _say(asked, [asdict(d) for d in found], *(lines or ["Nothing"]))


@contextmanager
def _people(asked: options.WorkspaceCommand) -> Iterator[People]:
    store = Store(asked.workspace, asked.database)
    try:
        yield store.people
    finally:
        store.close()


def _account(people: People, name: str) -> Account:
    return people.accounts.find(name)


def _password() -> str:
    if not sys.stdin.isatty():
        return sys.stdin.readline().rstrip("\n")
    first = getpass.getpass("Password: ")
    if getpass.getpass("Again: ") != first:
        raise ConfigurationError("the two passwords differ; try again")
    return first


def _say(asked: options.WorkspaceCommand, result: Any, *lines: str) -> int:
    printing.Show(asked.json).result(result, lambda: print("\n".join(lines)))
    return 0
