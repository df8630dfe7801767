"""``artiworld project``, ``release``, ``stats``, ``repeat``, ``user`` and ``audit``: settings,
data sets, figures and accounts of a team.
"""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from app.cli import output
from app.cli import team_commands as options
from app.cli.output import Result, check_output
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
from model.core.progress import Progress
from model.evaluation.agreement import FIGURES
from model.io.assets.reader import read_provenance
from model.io.export.simready import remembered
from sessions.command_log import WorkLog, check_workspace, open_database, read_work
from sessions.project_settings import ProjectSettings, labels_from_text, labels_to_text
from sessions.quality import Pair, Second, daily_sample, pairs_of, plant, seconds_in, summaries
from sessions.release_files import import_release, next_version, read_release, write_release
from sessions.releases import AcceptedAsset, Release, accepted_assets, changes, check_name
from sessions.statistics import acts_of, csv_text, day_of, duration, grouped, rows_of
from sessions.store import Store


def show(options: ProjectShowCommand, _: Progress, fields: dict[str, Any] | None = None) -> Result:
    """The settings of a project, once ``fields`` are changed."""
    check_workspace(options.workspace, options.database)
    with closing(Store(options.workspace, options.database)) as store:
        settings = store.project.change(fields) if fields else store.project.settings
    return Result(codec.write(settings), lambda: _print_settings(settings))


def change(options: ProjectSetCommand, progress: Progress) -> Result:
    """Change what is given; all settings."""
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
    return show(options, progress, fields)


def _text_of(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputFileError(path, "can't be read as text", "give a file in UTF-8") from error


def _list(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


def _print_settings(settings: ProjectSettings) -> None:
    shown = {
        "name": settings.name,
        "instructions": f"{len(settings.instructions)} characters",
        "labels": labels_to_text(settings.labels),
        "names outside of the labels": "errors" if settings.strict else "allowed",
        "required checks": ", ".join(settings.required),
        "export": f"{', '.join(settings.formats)} {settings.collision}".strip(),
        "release": f"{settings.form} {settings.license} {settings.author}".strip(),
    }
    rows = [{"setting": name, "value": value} for name, value in shown.items()]
    output.print_records(settings.name or "Project", rows)


def create(options: ReleaseCreateCommand, progress: Progress) -> Result:
    """Write a release."""
    name = check_name(options.name, "--name")
    check_workspace(options.workspace, options.database)
    home = options.out or options.workspace / "releases"
    version = check_name(options.version or next_version(home, name), "--version")
    out = home / f"{name}-{version}"
    check_output(home)
    author, license = remembered(options.workspace)
    with (
        closing(open_database(options.workspace, options.database)) as database,
        closing(Store(options.workspace, options.database)) as store,
        closing(WorkspaceLease(options.workspace)),
    ):
        again = seconds_in(database)
        pairs, _ = pairs_of(store, again, progress)
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
        size = options.shard_mb * 1_000_000
        release = write_release(release, assets, out, shard_bytes=size, progress=progress)
        place = store.assets.keep_release(out)
    report = release.to_json() | {"folder": str(out)} | ({"storage": place} if place else {})
    return Result(report, lambda: _print_release(release, place or str(out)))


def _wanted(assets: list[AcceptedAsset], categories: tuple[str, ...]) -> list[AcceptedAsset]:
    """Assets of some categories; all where none is named."""
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
    counts = sorted(release.count("category").items())
    rows = [{"category": name, "assets": count} for name, count in counts]
    title = f"{release.name} {release.version}: {len(release.assets)} assets"
    output.print_records(title, rows)
    if not release.license:
        output.print_notes(["no licence was given; others may not use it: --license CC-BY-4.0"])
    output.console().print(f"written to {out}")


def diff(options: ReleaseDiffCommand, _: Progress) -> Result:
    """The assets that were added, removed or changed."""
    report = changes(read_release(options.before), read_release(options.after)).to_json()
    return Result(report, lambda: _print_changes(report))


def _print_changes(report: dict[str, Any]) -> None:
    title = f"{report['before']} → {report['after']}"
    rows = [
        {"": c["kind"], "asset": c["key"], "what": "; ".join(c["what"])} for c in report["changes"]
    ]
    output.print_records(title, rows)
    counts = ", ".join(f"{report[kind]} {kind}" for kind in ("added", "removed", "changed"))
    output.console().print(f"{counts}, {report['same']} the same")


def import_into(options: ReleaseImportCommand, progress: Progress) -> Result:
    """Import a release; its objects."""
    read_release(options.release)  # a folder that is none makes no workspace
    with (
        closing(Store(options.into, options.database)) as store,
        closing(WorkspaceLease(options.into)),
    ):
        records = import_release(options.release, store, progress)
    rows = [{"object": r.id, "name": r.name, "path": str(r.path)} for r in records]
    return Result(rows, lambda: output.print_records(f"{len(rows)} objects imported", rows))


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


def stats(options: StatsCommand, progress: Progress) -> Result:
    """Figures of work, written as CSV where asked; or of quality, or a sample."""
    if options.quality:
        return _quality(options, progress)
    log = read_work(options.workspace, options.database)
    if options.sample:
        return _sample(options, log)
    since = -math.inf if options.since is None else options.since
    figures = grouped(log, acts_of(log), options.by, since)
    rows = rows_of(figures, options.by, options.rate)
    if options.csv is not None:
        with written_to(options.csv, "choose a file that you may write to"):
            options.csv.write_text(csv_text(rows), encoding="utf-8", newline="")
    return Result(rows, lambda: _print_figures(rows, options.by))


def _quality(options: StatsCommand, progress: Progress) -> Result:
    """Agreement by person and category, and the disagreements."""
    with (
        closing(open_database(options.workspace, options.database)) as database,
        closing(Store(options.workspace, options.database)) as store,
    ):
        pairs, waiting = pairs_of(store, seconds_in(database), progress)
    if options.since is not None:
        first = day_of(options.since)
        pairs = [p for p in pairs if p.day >= first]
    means = summaries(pairs)
    report = {
        "means": means,
        "pairs": [p.to_json() for p in pairs],
        "waiting": [asdict(w) for w in waiting],
    }
    return Result(report, lambda: _print_quality(means, pairs, waiting))


def _print_quality(
    means: dict[str, dict[str, dict[str, Any]]], pairs: list[Pair], waiting: list[Second]
) -> None:
    for by, found in means.items():
        if found and by != "all":
            columns = ("pairs", *(f.replace("_", " ") for f in FIGURES))
            rows = [
                {by: name, **dict(zip(columns, map(_figure, row.values()), strict=True))}
                for name, row in found.items()
            ]
            output.print_records(None, rows)
    rows = [
        {
            "object": f"{p.name} ({p.object}, {p.second})",
            "": p.kind,
            "first by": p.first_by,
            "second by": p.second_by,
            "disagreement": None if p.agreement is None else f"{p.agreement.disagreement:.3f}",
            "what": p.problem if p.agreement is None else "; ".join(p.agreement.what),
        }
        for p in pairs
    ]
    output.print_records("Disagreements, largest first", rows)
    output.console().print(f"{len(pairs)} pairs compared, {len(waiting)} wait to be accepted")


def _figure(value: Any) -> str:
    return "–" if value is None else f"{value:.3g}"


def _sample(options: StatsCommand, log: WorkLog) -> Result:
    """Each person's objects for a reviewer to look at."""
    day = options.day or (datetime.now(UTC).date() - timedelta(days=1)).isoformat()
    chosen = daily_sample(acts_of(log), day, options.sample, options.seed)
    rows = [
        {"person": who, "object": i, "name": log.objects[i].name, "state": log.objects[i].state}
        for who, ids in chosen.items()
        for i in ids
    ]
    return Result(rows, lambda: output.print_records(f"Sample of {day}", rows))


def repeat(options: RepeatCommand, _: Progress) -> Result:
    """Queue objects a second time."""
    if not options.double and not options.honeypots:
        raise ConfigurationError("give --double, --honeypots, or both")
    with (
        closing(open_database(options.workspace, options.database)) as database,
        closing(Store(options.workspace, options.database)) as store,
    ):
        new = plant(
            store,
            database,
            share=options.double,
            honeypots=options.honeypots,
            seed=options.seed,
        )
        rows = [{"name": store.object(s.of).name, **asdict(s)} for s in new]
    return Result(rows, lambda: output.print_records(f"{len(rows)} objects queued again", rows))


def _print_figures(rows: list[dict[str, Any]], by: str) -> None:
    if not rows:
        output.console().print("nobody has done anything here")
        return
    shown = [
        {by: str(row[by])} | {_COLUMNS[k]: _cell(k, v) for k, v in row.items() if k in _COLUMNS}
        for row in rows
    ]
    output.print_records(None, shown)


def _cell(name: str, value: Any) -> str:
    if value is None:
        return "–"
    if name in _TIMES:
        return duration(value)
    return f"{value:.2f}" if isinstance(value, float) else str(value)


def with_people(asked: options.PeopleCommand, _: Progress) -> Result:
    """Do what a command about people is for."""
    with closing(Store(asked.workspace, asked.database)) as store:
        report, lines = asked.work(store.people)
    return Result(report, lambda: print("\n".join(lines)))
