"""Reports on the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from model.evaluation.compare import KIND_NAMES, Comparison
from model.evaluation.report import COLUMNS, Report, paper_rows

if TYPE_CHECKING:
    from rich.console import Console

WIDTH = 150
"""Columns of output to a file or a pipe."""


def print_reports(reports: Sequence[Report]) -> None:
    """The paper's table: a row each run, then the paper's own rows for reference."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(f"{reports[0].dataset}, {len(reports[0].scores)} objects"))
    table.add_column("method")
    for column in COLUMNS:
        table.add_column(column, justify="right")
    for report in reports:
        table.add_row(*(Text(c) for c in report.row()), style="bold")
    for row in paper_rows():
        table.add_row(*(Text(c) for c in row), style="dim")
    console = _console()
    console.print(table)
    for report in reports:
        console.print(Text(_words(report)))


def print_comparison(comparison: Comparison) -> None:
    """Figures side by side, and the objects that changed."""
    from rich.table import Table
    from rich.text import Text

    a, b = comparison.labels
    table = Table(title=Text(f"{a} → {b}, {comparison.objects} objects"))
    for column in ("figure", "before", "after", "difference (95 % interval)", ""):
        table.add_column(column, justify="left" if column in ("figure", "") else "right")
    for row in comparison.rows():
        table.add_row(*(Text(c) for c in row))
    console = _console()
    console.print(table)
    for c in comparison.changes:
        parts = [f"{KIND_NAMES[c.kind]} {c.object_id}:"]
        parts += [f"gone: {'; '.join(c.gone)}."] if c.gone else []
        parts += [f"new: {'; '.join(c.new)}."] if c.new else []
        console.print(Text(" ".join(parts)))


def print_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Any table: the first column is text, the others are numbers."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title))
    for i, column in enumerate(header):
        table.add_column(column, justify="right" if i else "left")
    for row in rows:
        table.add_row(*(Text(c) for c in row))
    _console().print(table)


def _console() -> Console:
    from rich.console import Console

    console = Console(markup=False, highlight=False, emoji=False)
    return console if console.is_terminal else Console(
        width=WIDTH, markup=False, highlight=False, emoji=False
    )  # fmt: skip


def _words(report: Report) -> str:
    s = report.summary
    low, high = report.intervals["usable"]
    said = (
        f"{report.predictor}: {s.joints} joints: {s.missing} missing, {s.unparseable} unparseable, "
        f"{s.extra} extra; {s.failed} objects failed; usable {100 * s['usable']:.1f} % "
        f"({100 * low:.1f} … {100 * high:.1f}), usable joints {100 * s['usable_joints']:.1f} %, "
        f"parent right {100 * s['parent']:.1f} %, S2O F1 M/MA/MAO {100 * s['m_f1']:.1f}/"
        f"{100 * s['ma_f1']:.1f}/{100 * s['mao_f1']:.1f} %. {report.wall_seconds:.0f} s, "
        f"{sum(report.seconds) / max(1, len(report.seconds)):.2f} s an object."
    )
    return said if report.frame is None else f"{said} Frame of the files: {report.frame}."
