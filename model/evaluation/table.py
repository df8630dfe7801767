"""Reports on the terminal."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from model.evaluation.report import COLUMNS, Report
from model.progress import Progress


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """A bar on stderr that is fed as a :class:`~model.progress.Progress`."""
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as RichProgress

    console = Console(stderr=True)
    with RichProgress(
        TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn(), console=console
    ) as bar:
        task = bar.add_task("starting", total=1.0)

        def report(fraction: float, message: str) -> None:
            bar.update(task, completed=fraction, description=message)

        yield report


def print_report(report: Report) -> None:
    """The paper's table with its own rows for reference."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"{report.dataset}, {len(report.scores)} objects")
    table.add_column("method")
    for column in COLUMNS:
        table.add_column(column, justify="right")
    for i, row in enumerate(report.rows()):
        table.add_row(*row, style="bold" if i == 0 else "dim")
    console = Console()
    if not console.is_terminal:
        console = Console(width=150)  # a file or a pipe has no width: don't break the rows
    console.print(table)
    s = report.summary
    console.print(
        f"{s.joints} joints: {s.missing} missing, {s.extra} extra; {s.failed} objects failed; "
        f"parent right {100 * s.parent:.1f} %; usable joints {100 * s.usable_joints:.1f} %. "
        f"{report.wall_seconds:.0f} s, {sum(report.seconds) / max(1, len(report.seconds)):.2f} s "
        "a prediction."
    )
