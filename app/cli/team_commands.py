"""The subcommands for work in a team: figures, quality, releases, people's accounts."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import ClassVar, Literal

from app.cli.options import (
    Command,
    argument,
    count,
    flag,
    json_flag,
    option,
    positive_count,
    positive_number,
    repeated,
    required,
    seed_option,
)
from model.core.packages import at_place


def moment(text: str) -> float:
    """Read a day or a moment, ISO 8601, UTC where it says no zone; seconds since 1970."""
    found = datetime.fromisoformat(text)
    return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()


def day(text: str) -> str:
    """Read a day, ISO 8601."""
    return date.fromisoformat(text).isoformat()


def share(text: str) -> float:
    """Read a share from 0 to 1."""
    value = float(text)
    if not 0 <= value <= 1:
        raise ValueError
    return value


day.__name__ = "day (2026-01-31)"
share.__name__ = "share from 0 to 1"
moment.__name__ = "day (2026-01-31) or time (2026-01-31T12:00)"


@dataclass(frozen=True, kw_only=True)
class StatsCommand(Command):
    """Say how long people worked, what they did and what it cost."""

    workspace: Path = argument("folder of sessions and accepted assets", "WORKSPACE")
    by: Literal["person", "category", "predictor", "step", "object", "day"] = option(
        "a row for each of these", default="person"
    )
    since: float | None = option("leave out what was done before", "TIME", parse=moment)
    rate: float | None = option(
        "price of an hour of active time, for the cost", "PRICE", parse=positive_number
    )
    csv: Path | None = option("write the rows into this file, too", "FILE")
    quality: bool = flag("say instead how well second annotations agree with the first")
    sample: int = option(
        "list instead this many objects of each person's day, for a reviewer",
        "N",
        0,
        parse=count,
    )
    day: str | None = option("with --sample: the day (default: yesterday)", "DAY", parse=day)
    seed: int = seed_option("of the choice of a sample")
    database: str | None = option(
        "URL of a SQLite or PostgreSQL database (default: one in the workspace)", "URL"
    )
    json: bool = json_flag()

    def run(self) -> int:
        """Print the figures."""
        kind = "quality" if self.quality else "sample" if self.sample else "stats"
        return at_place(f"app.cli.team:{kind}")(self)


@dataclass(frozen=True, kw_only=True)
class RepeatCommand(Command):
    """Queue objects for a second annotation, unmarked, to measure quality."""

    workspace: Path = argument("folder of sessions and accepted assets", "WORKSPACE")
    double: float = option(
        "share of all objects to annotate twice, 0..1", "SHARE", 0.0, parse=share
    )
    honeypots: int = option(
        "number of accepted objects to annotate again, their asset being the ground truth",
        "N",
        0,
        parse=count,
    )
    seed: int = seed_option("of the choice")
    database: str | None = option(
        "URL of a SQLite or PostgreSQL database (default: one in the workspace)", "URL"
    )
    json: bool = json_flag()

    def run(self) -> int:
        """Queue them and list which."""
        return at_place("app.cli.team:repeat")(self)


@dataclass(frozen=True, kw_only=True)
class ReleaseCreateCommand(Command):
    """Freeze the accepted assets of a workspace as a numbered data set."""

    workspace: Path = argument("folder of sessions and accepted assets", "WORKSPACE")
    name: str = required("name of the data set", "NAME")
    version: str | None = option(
        "its version, such as 1.0 (default: the number after the last one)", "VERSION"
    )
    form: Literal["folder", "webdataset", "huggingface"] | None = option(
        "plain folder, tar shards for WebDataset, or the layout of Hugging Face's hub "
        "(default: the project's)"
    )
    out: Path | None = option("folder of the releases (default: releases in the workspace)", "DIR")
    license: str = option(
        "licence of the assets, such as CC-BY-4.0 (default: the project's, or that of the last "
        "SimReady package)",
        "NAME",
        "",
    )
    author: str = option(
        "author or organisation (default: the project's, or that of the last SimReady package)",
        "NAME",
        "",
    )
    category: tuple[str, ...] = repeated("release objects of this category only", "NAME")
    shard_mb: int = option("with webdataset: largest shard", "MB", 500, parse=positive_count)
    database: str | None = option(
        "URL of a SQLite or PostgreSQL database (default: one in the workspace)", "URL"
    )
    json: bool = json_flag()

    def run(self) -> int:
        """Write the release and print what is in it."""
        return at_place("app.cli.team:create")(self)


@dataclass(frozen=True, kw_only=True)
class ReleaseDiffCommand(Command):
    """List what changed between two releases."""

    before: Path = argument("folder of a release", "A")
    after: Path = argument("folder of another one", "B")
    json: bool = json_flag()

    def run(self) -> int:
        """Print the assets that were added, removed or changed."""
        return at_place("app.cli.team:diff")(self)


@dataclass(frozen=True, kw_only=True)
class ReleaseImportCommand(Command):
    """Check somebody's release and add its objects to a workspace."""

    release: Path = argument("folder of the release", "DIR")
    into: Path = required("folder of sessions and accepted assets; made where needed", "WORKSPACE")
    database: str | None = option(
        "URL of a SQLite or PostgreSQL database (default: one in the workspace)", "URL"
    )
    json: bool = json_flag()

    def run(self) -> int:
        """Add the objects and list them."""
        return at_place("app.cli.team:import_into")(self)


@dataclass(frozen=True, kw_only=True)
class ProjectShowCommand(Command):
    """Print the settings of a project."""

    workspace: Path = argument("folder of sessions and accepted assets", "WORKSPACE")
    database: str | None = option(
        "URL of a SQLite or PostgreSQL database (default: one in the workspace)", "URL"
    )
    json: bool = json_flag()

    def run(self) -> int:
        """Print them."""
        return at_place("app.cli.team:show")(self)


@dataclass(frozen=True, kw_only=True)
class ProjectSetCommand(ProjectShowCommand):
    """Change settings of a project; what isn't given stays."""

    name: str | None = option("name of the project", "NAME")
    instructions: Path | None = option("Markdown that is shown beside the picture", "FILE")
    labels: Path | None = option(
        "text file with a line for each category: “Oven: door, knob”", "FILE"
    )
    strict: bool | None = flag("names outside of the labels are errors", None, negatable=True)
    require: str | None = option(
        "findings that prevent acceptance without override: collision,floating,…, or none",
        "KIND,KIND",
    )
    format: str | None = option("formats that an export begins with", "NAME,NAME")
    collision: str | None = option("collision shapes of an export: hollow, coacd, …", "NAME")
    form: Literal["folder", "webdataset", "huggingface"] | None = option("form of releases")
    license: str | None = option("licence of releases, such as CC-BY-4.0", "NAME")
    author: str | None = option("author of releases", "NAME")

    def run(self) -> int:
        """Change them and print all."""
        return at_place("app.cli.team:change")(self)


class ProjectCommand(Command):
    """Show or change what all who work on a project share: instructions, labels, checks."""

    subcommands: ClassVar[dict[str, type[Command]]] = {
        "show": ProjectShowCommand,
        "set": ProjectSetCommand,
    }
    default_subcommand: ClassVar[str] = "show"


class ReleaseCommand(Command):
    """Freeze accepted assets as a data set; compare and import such sets."""

    subcommands: ClassVar[dict[str, type[Command]]] = {
        "create": ReleaseCreateCommand,
        "diff": ReleaseDiffCommand,
        "import": ReleaseImportCommand,
    }
    default_subcommand: ClassVar[str] = "create"


Role = Literal["annotator", "reviewer", "manager"]
Scope = Literal["read", "annotate", "review", "manage"]
_PLACE = "app.cli.team:"


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
