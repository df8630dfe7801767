"""``artiworld stats``: figures about work and its quality."""

from __future__ import annotations

import math
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from typing import Any

from app.cli import printing
from app.cli.team_commands import RepeatCommand, StatsCommand
from model.core.errors import ConfigurationError
from model.core.files import written_to
from model.evaluation.agreement import FIGURES
from sessions.command_log import open_database, read_work
from sessions.quality import Pair, Second, daily_sample, pairs_of, plant, seconds_in, summaries
from sessions.statistics import acts_of, csv_text, day_of, duration, grouped, rows_of
from sessions.store import Store

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
    with printing.session(options.json) as show:
        log = read_work(options.workspace, options.database)
        since = -math.inf if options.since is None else options.since
        figures = grouped(log, acts_of(log), options.by, since)
        rows = rows_of(figures, options.by, options.rate)
        if options.csv is not None:
            with written_to(options.csv, "choose a file that you may write to"):
                options.csv.write_text(csv_text(rows), encoding="utf-8", newline="")
    show.result(rows, lambda: _print(rows, options.by))
    return 0


def quality(options: StatsCommand) -> int:
    """Print agreement by person and category, and the disagreements; returns the exit code."""
    database = open_database(options.workspace, options.database)
    store = Store(options.workspace, options.database)
    try:
        with printing.session(options.json) as show:
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
    console = printing.console()
    for by, rows in means.items():
        if rows and by != "all":
            columns = [by, "pairs", *(f.replace("_", " ") for f in FIGURES)]
            cells = [[name, *map(_figure, row.values())] for name, row in rows.items()]
            console.print(printing.table_of(None, columns, cells, columns[1:]))
    rows = [
        (
            f"{p.name} ({p.object}, {p.second})", p.kind, p.first_by, p.second_by,
            "–" if p.agreement is None else f"{p.agreement.disagreement:.3f}",
            p.problem if p.agreement is None else "; ".join(p.agreement.what),
        )
        for p in pairs
    ]  # fmt: skip
    columns = ("object", "", "first by", "second by", "disagreement", "what")
    console.print(printing.table_of("Disagreements, largest first", columns, rows))
    console.print(f"{len(pairs)} pairs compared, {len(waiting)} wait to be accepted")


def _figure(value: Any) -> str:
    return "–" if value is None else f"{value:.3g}"


def sample(options: StatsCommand) -> int:
    """Print each person's objects for a reviewer to look at; returns the exit code."""
    day = options.day or (datetime.now(UTC).date() - timedelta(days=1)).isoformat()
    with printing.session(options.json) as show:
        log = read_work(options.workspace, options.database)
        chosen = daily_sample(acts_of(log), day, options.sample, options.seed)
    rows = [
        {"person": who, "object": i, "name": log.objects[i].name, "state": log.objects[i].state}
        for who, ids in chosen.items()
        for i in ids
    ]
    show.result(rows, lambda: printing.print_records(f"Sample of {day}", rows))
    return 0


def repeat(options: RepeatCommand) -> int:
    """Queue objects a second time and list them; returns the exit code."""
    if not options.double and not options.honeypots:
        raise ConfigurationError("give --double, --honeypots, or both")
    database = open_database(options.workspace, options.database)
    store = Store(options.workspace, options.database)
    try:
        with printing.session(options.json) as show:
            new = plant(
                store, database, share=options.double, honeypots=options.honeypots,
                seed=options.seed,
            )  # fmt: skip
        rows = [{"name": store.object(s.of).name, **asdict(s)} for s in new]
    finally:
        store.close()
        database.close()
    show.result(rows, lambda: printing.print_records(f"{len(rows)} objects queued again", rows))
    return 0


def _print(rows: list[dict[str, Any]], by: str) -> None:
    if not rows:
        printing.console().print("nobody has done anything here")
        return
    columns = [by, *(title for name, title in _COLUMNS.items() if name in rows[0])]
    cells = [
        [str(row[by]), *(_text(name, row[name]) for name in _COLUMNS if name in row)]
        for row in rows
    ]
    printing.console().print(printing.table_of(None, columns, cells, columns[1:]))


def _text(name: str, value: Any) -> str:
    if value is None:
        return "–"
    if name in _TIMES:
        return duration(value)
    return f"{value:.2f}" if isinstance(value, float) else str(value)
