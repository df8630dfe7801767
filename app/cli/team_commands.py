"""The subcommands for work in a team: figures, quality, releases, people's accounts."""

from __future__ import annotations

import getpass
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from app.cli.options import (
    Group,
    ReportCommand,
    argument,
    count,
    database_option,
    flag,
    option,
    positive_count,
    positive_number,
    repeated,
    required,
    seed_option,
    workspace_option,
)
from model.core.errors import ConfigurationError

if TYPE_CHECKING:
    from sessions.people import People


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
class WorkspaceCommand(ReportCommand):
    """A command about a workspace."""

    workspace: Path = argument("folder of sessions and accepted assets", "WORKSPACE")
    database: str | None = database_option()


@dataclass(frozen=True, kw_only=True)
class StatsCommand(WorkspaceCommand):
    """Say how long people worked, what they did and what it cost."""

    place: ClassVar[str] = "app.cli.team:stats"
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


@dataclass(frozen=True, kw_only=True)
class RepeatCommand(WorkspaceCommand):
    """Queue objects for a second annotation, unmarked, to measure quality."""

    place: ClassVar[str] = "app.cli.team:repeat"
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


@dataclass(frozen=True, kw_only=True)
class ReleaseCreateCommand(WorkspaceCommand):
    """Freeze the accepted assets of a workspace as a numbered data set."""

    place: ClassVar[str] = "app.cli.team:create"
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


@dataclass(frozen=True, kw_only=True)
class ReleaseDiffCommand(ReportCommand):
    """List what changed between two releases."""

    place: ClassVar[str] = "app.cli.team:diff"
    before: Path = argument("folder of a release", "A")
    after: Path = argument("folder of another one", "B")


@dataclass(frozen=True, kw_only=True)
class ReleaseImportCommand(ReportCommand):
    """Check somebody's release and add its objects to a workspace."""

    place: ClassVar[str] = "app.cli.team:import_into"
    release: Path = argument("folder of the release", "DIR")
    into: Path = required("folder of sessions and accepted assets; made where needed", "WORKSPACE")
    database: str | None = database_option()


@dataclass(frozen=True, kw_only=True)
class ProjectShowCommand(WorkspaceCommand):
    """Print the settings of a project."""

    place: ClassVar[str] = "app.cli.team:show"


@dataclass(frozen=True, kw_only=True)
class ProjectSetCommand(ProjectShowCommand):
    """Change settings of a project; what isn't given stays."""

    place: ClassVar[str] = "app.cli.team:change"
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


Role = Literal["annotator", "reviewer", "manager"]
Scope = Literal["read", "annotate", "review", "manage"]


@dataclass(frozen=True, kw_only=True)
class PeopleCommand(ReportCommand):
    """A command about the people of a workspace."""

    place: ClassVar[str] = "app.cli.team:with_people"
    workspace: Path = workspace_option()
    database: str | None = database_option()

    def work(self, people: People) -> tuple[Any, Sequence[str]]:
        """Do it; return a report for a program, and lines for a person."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class UserAddCommand(PeopleCommand):
    """Add an account; its password is asked for, or read from standard input."""

    name: str = argument("name beside the person's decisions", "NAME")
    role: Role = option("what the person may do", "ROLE", "annotator")

    def work(self, people: People) -> tuple[Any, Sequence[str]]:
        """Add the account."""
        account = people.accounts.add(self.name, self.role, _password())
        return asdict(account), [f"Added {account.name}, {account.role}"]


@dataclass(frozen=True, kw_only=True)
class UserInviteCommand(PeopleCommand):
    """Print a link with which a person chooses a password; it works once, for a week."""

    name: str = argument("name beside the person's decisions, also of earlier ones", "NAME")
    role: Role = option("what the person may do", "ROLE", "annotator")
    url: str = option("address of the server", "URL", "http://localhost:8080")

    def work(self, people: People) -> tuple[Any, Sequence[str]]:
        """Make the link."""
        code = people.accounts.invite(self.name, self.role)
        link = f"{self.url.rstrip('/')}/login#invitation={code}"
        return {"name": self.name, "link": link}, [f"For {self.name}, once: {link}"]


@dataclass(frozen=True, kw_only=True)
class UserListCommand(PeopleCommand):
    """List all accounts."""

    def work(self, people: People) -> tuple[Any, Sequence[str]]:
        """Find them."""
        found = people.accounts.all()
        lines = [f"{a.name}  {a.role}  {a.status}" for a in found]
        return [asdict(a) for a in found], lines or ["No accounts: nobody logs in"]


@dataclass(frozen=True, kw_only=True)
class UserRoleCommand(PeopleCommand):
    """Change what a person may do, from the next decision on."""

    name: str = argument("name of the account", "NAME")
    role: Role = argument("annotator, reviewer or manager", "ROLE")

    def work(self, people: People) -> tuple[Any, Sequence[str]]:
        """Change it."""
        account = people.accounts.set_role(self.name, self.role)
        return asdict(account), [f"{account.name} is {account.role} now"]


@dataclass(frozen=True, kw_only=True)
class UserDisableCommand(PeopleCommand):
    """Keep a person out; the decisions stay. A new invitation lets the person in again."""

    name: str = argument("name of the account", "NAME")

    def work(self, people: People) -> tuple[Any, Sequence[str]]:
        """Disable the account."""
        people.accounts.disable(self.name)
        return {"disabled": self.name}, [f"{self.name} can't log in any more"]


@dataclass(frozen=True, kw_only=True)
class UserRevokeCommand(PeopleCommand):
    """End all browser sessions and tokens of a person, who may log in again."""

    name: str = argument("name of the account", "NAME")

    def work(self, people: People) -> tuple[Any, Sequence[str]]:
        """End them."""
        people.credentials.revoke(people.accounts.find(self.name))
        return {"revoked": self.name}, [f"{self.name} is logged out everywhere"]


@dataclass(frozen=True, kw_only=True)
class UserTokenCommand(PeopleCommand):
    """Print a new token for scripts; nothing shows it again."""

    name: str = argument("name of the account", "NAME")
    label: str = option("what the token is for", "TEXT", "script")
    scope: tuple[Scope, ...] = repeated("read, annotate, review or manage (default: read)", "SCOPE")
    days: int = option("how long it lasts", "DAYS", 90)

    def work(self, people: People) -> tuple[Any, Sequence[str]]:
        """Make the token."""
        account, scopes = people.accounts.find(self.name), self.scope or ("read",)
        secret = people.credentials.make_token(account, self.label, scopes, self.days)
        return {"token": secret}, [secret]


@dataclass(frozen=True, kw_only=True)
class AuditCommand(PeopleCommand):
    """Say what happened to accounts, or what was decided about objects, the newest first."""

    name: str | None = option("only what this account did, or what was done to it", "NAME")
    kind: str | None = option("only this kind, such as login_failed or accept", "KIND")
    since: str | None = option("only from this day on, such as 2026-01-31", "DAY")
    count: int = option("at most so many", "N", 50)
    decisions: bool = flag("decisions about objects instead of what happened to accounts")
    object: int | None = option("with --decisions: only those about this object", "ID")

    def work(self, people: People) -> tuple[Any, Sequence[str]]:
        """Find the events."""
        found: Sequence[Any]
        same: Any = {"kind": self.kind, "since": self.since, "count": self.count}
        if self.decisions:
            found = people.audit.decisions(who=self.name, object_id=self.object, **same)
            lines = [f"{d.at[:19]}  {d.who}  {d.kind}  {d.name} ({d.object})" for d in found]
        else:
            found = people.audit.events(name=self.name, **same)
            lines = [
                f"{e.at[:19]}  {e.who or '-'}  {e.kind}  {e.subject}  {e.detail}  {e.address}"
                for e in found
            ]
        return [asdict(each) for each in found], [line.rstrip() for line in lines] or ["Nothing"]


def _password() -> str:
    if not sys.stdin.isatty():
        return sys.stdin.readline().rstrip("\n")
    first = getpass.getpass("Password: ")
    if getpass.getpass("Again: ") != first:
        raise ConfigurationError("the two passwords differ; try again")
    return first


PROJECT = Group(
    "Show or change what all who work on a project share: instructions, labels, checks.",
    {"show": ProjectShowCommand, "set": ProjectSetCommand},
    default="show",
)
RELEASE = Group(
    "Freeze accepted assets as a data set; compare and import such sets.",
    {"create": ReleaseCreateCommand, "diff": ReleaseDiffCommand, "import": ReleaseImportCommand},
    default="create",
)
USERS = Group(
    "Manage the accounts of the people who annotate and review.",
    {
        "add": UserAddCommand,
        "invite": UserInviteCommand,
        "list": UserListCommand,
        "role": UserRoleCommand,
        "disable": UserDisableCommand,
        "revoke": UserRevokeCommand,
        "token": UserTokenCommand,
    },
)
