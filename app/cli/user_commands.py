"""``artiworld user`` and ``artiworld audit``: people's accounts, for who runs the server."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

from app.cli.command import Command, argument, flag, option, repeated
from app.cli.options import json_flag
from model.core.packages import at_place

Role = Literal["annotator", "reviewer", "manager"]
Scope = Literal["read", "annotate", "review", "manage"]
_PLACE = "app.cli.users:"


@dataclass(frozen=True, kw_only=True)
class WorkspaceCommand(Command):
    """A command about the people of a workspace."""

    workspace: Path = option("folder of sessions and accepted assets", "DIR", Path("workspace"))
    database: str | None = option(
        "URL of a SQLite or PostgreSQL database (default: one in the workspace)", "URL"
    )
    json: bool = json_flag()


@dataclass(frozen=True, kw_only=True)
class UserAddCommand(WorkspaceCommand):
    """Add an account; its password is asked for, or read from standard input."""

    name: str = argument("name beside the person's decisions", "NAME")
    role: Role = option("what the person may do", "ROLE", "annotator")

    def run(self) -> int:
        """Ask for the password and add the account."""
        return at_place(f"{_PLACE}add")(self)


@dataclass(frozen=True, kw_only=True)
class UserInviteCommand(WorkspaceCommand):
    """Print a link with which a person chooses a password; it works once, for a week."""

    name: str = argument("name beside the person's decisions, also of earlier ones", "NAME")
    role: Role = option("what the person may do", "ROLE", "annotator")
    url: str = option("address of the server", "URL", "http://localhost:8080")

    def run(self) -> int:
        """Print the link."""
        return at_place(f"{_PLACE}invite")(self)


@dataclass(frozen=True, kw_only=True)
class UserListCommand(WorkspaceCommand):
    """List all accounts."""

    def run(self) -> int:
        """Print them."""
        return at_place(f"{_PLACE}list_accounts")(self)


@dataclass(frozen=True, kw_only=True)
class UserRoleCommand(WorkspaceCommand):
    """Change what a person may do, from the next decision on."""

    name: str = argument("name of the account", "NAME")
    role: Role = argument("annotator, reviewer or manager", "ROLE")

    def run(self) -> int:
        """Change it."""
        return at_place(f"{_PLACE}set_role")(self)


@dataclass(frozen=True, kw_only=True)
class UserDisableCommand(WorkspaceCommand):
    """Keep a person out; the decisions stay. A new invitation lets the person in again."""

    name: str = argument("name of the account", "NAME")

    def run(self) -> int:
        """Disable the account."""
        return at_place(f"{_PLACE}disable")(self)


@dataclass(frozen=True, kw_only=True)
class UserRevokeCommand(WorkspaceCommand):
    """End all browser sessions and tokens of a person, who may log in again."""

    name: str = argument("name of the account", "NAME")

    def run(self) -> int:
        """End them."""
        return at_place(f"{_PLACE}revoke")(self)


@dataclass(frozen=True, kw_only=True)
class UserTokenCommand(WorkspaceCommand):
    """Print a new token for scripts; nothing shows it again."""

    name: str = argument("name of the account", "NAME")
    label: str = option("what the token is for", "TEXT", "script")
    scope: tuple[Scope, ...] = repeated("read, annotate, review or manage (default: read)", "SCOPE")
    days: int = option("how long it lasts", "DAYS", 90)

    def run(self) -> int:
        """Make the token."""
        return at_place(f"{_PLACE}make_token")(self)


@dataclass(frozen=True, kw_only=True)
class UserCommand(Command):
    """Manage the accounts of the people who annotate and review."""

    subcommands: ClassVar[dict[str, type[Command]]] = {
        "add": UserAddCommand,
        "invite": UserInviteCommand,
        "list": UserListCommand,
        "role": UserRoleCommand,
        "disable": UserDisableCommand,
        "revoke": UserRevokeCommand,
        "token": UserTokenCommand,
    }


@dataclass(frozen=True, kw_only=True)
class AuditCommand(WorkspaceCommand):
    """Say what happened to accounts, or what was decided about objects, the newest first."""

    name: str | None = option("only what this account did, or what was done to it", "NAME")
    kind: str | None = option("only this kind, such as login_failed or accept", "KIND")
    since: str | None = option("only from this day on, such as 2026-01-31", "DAY")
    count: int = option("at most so many", "N", 50)
    decisions: bool = flag("decisions about objects instead of what happened to accounts")
    object: int | None = option("with --decisions: only those about this object", "ID")

    def run(self) -> int:
        """Print the events."""
        return at_place(f"{_PLACE}show_audit")(self)
