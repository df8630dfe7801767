"""``artiworld stats``: figures about work and its quality."""

from __future__ import annotations

import math
from typing import Any

from app.cli import printing
from app.cli.team_commands import StatsCommand
from model.core.files import written_to
from sessions.command_log import read_work
from sessions.statistics import acts_of, csv_text, grouped, rows_of

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
    if name not in _TIMES:
        return f"{value:.2f}" if isinstance(value, float) else str(value)
    minutes, seconds = divmod(round(value), 60)
    return f"{minutes}:{seconds:02} min" if minutes else f"{value:.1f} s"
