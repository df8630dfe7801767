"""``artiworld project``, ``release``, ``stats``, ``repeat``, ``user`` and ``audit``: settings,
data sets, figures and accounts of a team.
"""

from __future__ import annotations

import getpass
import math
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from app.cli import output
from app.cli import team_commands as options
from app.cli.output import check_output
from app.cli.team_commands import (
    ProjectSetCommand,
    ProjectShowCommand,
    ReleaseCreateCommand,
    ReleaseDiffCommand,
    ReleaseImportCommand,
    RepeatCommand,
    StatsCommand,
)
from app.server.ending import WorkspaceLease
from model.core import codec
from model.core.errors import ConfigurationError, InputFileError
from model.core.files import written_to
from model.evaluation.agreement import FIGURES
from model.io.assets.reader import read_provenance
from model.io.export.simready import remembered
from sessions.accounts import Account
from sessions.command_log import check_workspace, open_database, read_work
from sessions.people import People
from sessions.project_settings import ProjectSettings, labels_from_text, labels_to_text
from sessions.quality import Pair, Second, daily_sample, pairs_of, plant, seconds_in, summaries
from sessions.release_files import import_release, next_version, read_release, write_release
from sessions.releases import AcceptedAsset, Release, accepted_assets, changes, check_name
from sessions.statistics import acts_of, csv_text, day_of, duration, grouped, rows_of
from sessions.store import Store


def show(options: ProjectShowCommand, fields: dict[str, Any] | None = None) -> int:
    """Print the settings, once ``fields`` are changed; returns the exit code."""
    check_workspace(options.workspace, options.database)
    store = Store(options.workspace, options.database)
    try:
        settings = store.project.change(fields) if fields else store.project.settings
    finally:
        store.close()
    with output.session(options.json) as shown:
        pass
    shown.result(codec.write(settings), lambda: _print_settings(settings))
    return 0


def change(options: ProjectSetCommand) -> int:
    """Change what is given, and print all; returns the exit code."""
    same = ("name", "strict", "collision", "form", "license", "author")
    fields: dict[str, Any] = {k: getattr(options, k) for k in same}
    if options.instructions is not None:
        fields["instructions"] = _text_of(options.instructions)
    if options.labels is not None:
        fields["labels"] = labels_from_text(_text_of(options.labels))
    if options.require is not None:
        fields["required"] = _list("" if options.require == "none" else options.require)
    if options.format is not None:
        fields["formats"] = _list(options.format)
    fields = {k: v for k, v in fields.items() if v is not None}
    if not fields:
        raise ConfigurationError("nothing to change; give --instructions, --labels, …")
    return show(options, fields)


def _text_of(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputFileError(path, "can't be read as text", "give a file in UTF-8") from error


def _list(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


def _print_settings(settings: ProjectSettings) -> None:
    rows = [
        ("name", settings.name),
        ("instructions", f"{len(settings.instructions)} characters"),
        ("labels", labels_to_text(settings.labels)),
        ("names outside of the labels", "errors" if settings.strict else "allowed"),
        ("required checks", ", ".join(settings.required)),
        ("export", f"{', '.join(settings.formats)} {settings.collision}".strip()),
        ("release", f"{settings.form} {settings.license} {settings.author}".strip()),
    ]
    title = settings.name or "Project"
    output.console().print(output.table_of(title, ("setting", "value"), rows))


def create(options: ReleaseCreateCommand) -> int:
    """Write a release and print its counts; returns the exit code."""
    name = check_name(options.name, "--name")
    check_workspace(options.workspace, options.database)
    home = options.out or options.workspace / "releases"
    version = check_name(options.version or next_version(home, name), "--version")
    out = home / f"{name}-{version}"
    check_output(home)
    author, license = remembered(options.workspace)
    database = open_database(options.workspace, options.database)
    store = Store(options.workspace, options.database)
    try:
        with closing(WorkspaceLease(options.workspace)), output.session(options.json) as show:
            again = seconds_in(database)
            pairs, _ = pairs_of(store, again, show.progress)
            wanted = store.project.settings
            release = Release(
                name,
                version,
                options.form or wanted.form,
                options.license or wanted.license or license,
                options.author or wanted.author or author,
                summaries(pairs)["all"]["all"],
            )
            store.assets.check_release(out.name)
            found = accepted_assets(store, {second.object for second in again})
            assets = _wanted(found, options.category)
            release = write_release(
                release,
                assets,
                out,
                shard_bytes=options.shard_mb * 1_000_000,
                progress=show.progress,
            )
            place = store.assets.keep_release(out)
    finally:
        store.close()
        database.close()
    report = release.to_json() | {"folder": str(out)} | ({"storage": place} if place else {})
    show.result(report, lambda: _print_release(release, place or str(out)))
    return 0


def _wanted(assets: list[AcceptedAsset], categories: tuple[str, ...]) -> list[AcceptedAsset]:
    """Those of some categories; all where none is named."""
    if not categories:
        return assets
    named = {c.casefold() for c in categories}
    of = {a: str(read_provenance(a.folder)["asset"].get("category") or "") for a in assets}
    found = [a for a in assets if of[a].casefold() in named]
    if not found:
        known = ", ".join(sorted({c for c in of.values() if c})) or "none"
        raise ConfigurationError(
            f"no accepted object has the category {', '.join(categories)}; there are: {known}"
        )
    return found


def _print_release(release: Release, out: str) -> None:
    rows = [(name, str(count)) for name, count in sorted(release.count("category").items())]
    title = f"{release.name} {release.version}: {len(release.assets)} assets"
    output.console().print(output.table_of(title, ("category", "assets"), rows, ("assets",)))
    if not release.license:
        output.print_notes(["no licence was given; others may not use it: --license CC-BY-4.0"])
    output.console().print(f"written to {out}")


def diff(options: ReleaseDiffCommand) -> int:
    """Print what differs; returns the exit code."""
    found = changes(read_release(options.before), read_release(options.after))
    report = found.to_json()
    with output.session(options.json) as show:
        pass
    show.result(report, lambda: _print_changes(report))
    return 0


def _print_changes(report: dict[str, Any]) -> None:
    title = f"{report['before']} → {report['after']}"
    rows = [(c["kind"], c["key"], "; ".join(c["what"])) for c in report["changes"]]
    output.console().print(output.table_of(title, ("", "asset", "what"), rows))
    counts = ", ".join(f"{report[kind]} {kind}" for kind in ("added", "removed", "changed"))
    output.console().print(f"{counts}, {report['same']} the same")


def import_into(options: ReleaseImportCommand) -> int:
    """Import a release and list its objects; returns the exit code."""
    read_release(options.release)  # a folder that is none makes no workspace
    store = Store(options.into, options.database)
    try:
        with closing(WorkspaceLease(options.into)), output.session(options.json) as show:
            records = import_release(options.release, store, show.progress)
    finally:
        store.close()
    rows = [{"object": r.id, "name": r.name, "path": str(r.path)} for r in records]
    show.result(rows, lambda: output.print_records(f"{len(rows)} objects imported", rows))
    return 0


_COLUMNS = {
    "objects": "objects",
    "accepted": "accepted",
    "active": "active",
    "waiting": "waiting",
    "clicks": "clicks",
    "commands": "commands",
    "corrections": "corrections",
    "accepted_per_hour": "accepted/h",
    "seconds_per_accepted": "each",
    "cost": "cost",
    "cost_per_accepted": "cost each",
}
_TIMES = ("active", "waiting", "seconds_per_accepted")


def stats(options: StatsCommand) -> int:
    """Print the rows, and write them as CSV where asked; returns the exit code."""
    with output.session(options.json) as show:
        log = read_work(options.workspace, options.database)
        since = -math.inf if options.since is None else options.since
        figures = grouped(log, acts_of(log), options.by, since)
        rows = rows_of(figures, options.by, options.rate)
        if options.csv is not None:
            with written_to(options.csv, "choose a file that you may write to"):
                options.csv.write_text(csv_text(rows), encoding="utf-8", newline="")
    show.result(rows, lambda: _print_figures(rows, options.by))
    return 0


def quality(options: StatsCommand) -> int:
    """Print agreement by person and category, and the disagreements; returns the exit code."""
    database = open_database(options.workspace, options.database)
    store = Store(options.workspace, options.database)
    try:
        with output.session(options.json) as show:
            pairs, waiting = pairs_of(store, seconds_in(database), show.progress)
        if options.since is not None:
            first = day_of(options.since)
            pairs = [p for p in pairs if p.day >= first]
    finally:
        store.close()
        database.close()
    means = summaries(pairs)
    report = {
        "means": means,
        "pairs": [p.to_json() for p in pairs],
        "waiting": [asdict(w) for w in waiting],
    }
    show.result(report, lambda: _print_quality(means, pairs, waiting))
    return 0


def _print_quality(
    means: dict[str, dict[str, dict[str, Any]]], pairs: list[Pair], waiting: list[Second]
) -> None:
    console = output.console()
    for by, rows in means.items():
        if rows and by != "all":
            columns = [by, "pairs", *(f.replace("_", " ") for f in FIGURES)]
            cells = [[name, *map(_figure, row.values())] for name, row in rows.items()]
            console.print(output.table_of(None, columns, cells, columns[1:]))
    rows = [
        (
            f"{p.name} ({p.object}, {p.second})",
            p.kind,
            p.first_by,
            p.second_by,
            "–" if p.agreement is None else f"{p.agreement.disagreement:.3f}",
            p.problem if p.agreement is None else "; ".join(p.agreement.what),
        )
        for p in pairs
    ]
    columns = ("object", "", "first by", "second by", "disagreement", "what")
    console.print(output.table_of("Disagreements, largest first", columns, rows))
    console.print(f"{len(pairs)} pairs compared, {len(waiting)} wait to be accepted")


def _figure(value: Any) -> str:
    return "–" if value is None else f"{value:.3g}"


def sample(options: StatsCommand) -> int:
    """Print each person's objects for a reviewer to look at; returns the exit code."""
    day = options.day or (datetime.now(UTC).date() - timedelta(days=1)).isoformat()
    with output.session(options.json) as show:
        log = read_work(options.workspace, options.database)
        chosen = daily_sample(acts_of(log), day, options.sample, options.seed)
    rows = [
        {"person": who, "object": i, "name": log.objects[i].name, "state": log.objects[i].state}
        for who, ids in chosen.items()
        for i in ids
    ]
    show.result(rows, lambda: output.print_records(f"Sample of {day}", rows))
    return 0


def repeat(options: RepeatCommand) -> int:
    """Queue objects a second time and list them; returns the exit code."""
    if not options.double and not options.honeypots:
        raise ConfigurationError("give --double, --honeypots, or both")
    database = open_database(options.workspace, options.database)
    store = Store(options.workspace, options.database)
    try:
        with output.session(options.json) as show:
            new = plant(
                store,
                database,
                share=options.double,
                honeypots=options.honeypots,
                seed=options.seed,
            )
        rows = [{"name": store.object(s.of).name, **asdict(s)} for s in new]
    finally:
        store.close()
        database.close()
    show.result(rows, lambda: output.print_records(f"{len(rows)} objects queued again", rows))
    return 0


def _print_figures(rows: list[dict[str, Any]], by: str) -> None:
    if not rows:
        output.console().print("nobody has done anything here")
        return
    columns = [by, *(title for name, title in _COLUMNS.items() if name in rows[0])]
    cells = [
        [str(row[by]), *(_cell(name, row[name]) for name in _COLUMNS if name in row)]
        for row in rows
    ]
    output.console().print(output.table_of(None, columns, cells, columns[1:]))


def _cell(name: str, value: Any) -> str:
    if value is None:
        return "–"
    if name in _TIMES:
        return duration(value)
    return f"{value:.2f}" if isinstance(value, float) else str(value)


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
            who=asked.name,
            object_id=asked.object,
            kind=asked.kind,
            since=asked.since,
            count=asked.count,
        )
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
    output.Show(asked.json).result(result, lambda: print("\n".join(lines)))
    return 0
