"""Output of the commands: folders, checked before a command writes; a table for people, or JSON
alone.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as ProgressBar
from rich.table import Table
from rich.text import Text

from model.core.errors import ConfigurationError
from model.core.progress import Progress, no_progress, scaled_progress

T = TypeVar("T")


def check_output(out: Path, *inputs: Path, option: str = "--out") -> None:
    """Check that ``out`` can be an output folder and would not overwrite an input.

    Args:
        option: the option that names the folder.

    Raises:
        ConfigurationError: with what to do.
    """
    try:
        taken = out.exists() and not out.is_dir()
    except (OSError, ValueError) as error:  # a name that is too long or has a NUL
        why = getattr(error, "strerror", None) or error
        raise ConfigurationError(
            f"{option} {str(out)[:80]}… can't be a folder ({why}); give another name"
        ) from error
    if taken:
        raise ConfigurationError(f"{option} {out} is a file; give a folder")
    for source in inputs:
        if os.path.realpath(out) == os.path.realpath(source):  # pathlib raises on circular links
            raise ConfigurationError(f"{option} {out} is where the input is; give another folder")
    above = next((p for p in (out, *out.absolute().parents) if p.exists()), Path("/"))
    if not above.is_dir() or not os.access(above, os.W_OK):
        raise ConfigurationError(f"{option} {out} can't be written; choose a folder of your own")


def check_replaceable(out: Path, is_earlier: Callable[[set[str]], bool]) -> None:
    """Check that ``out`` is new, empty, or holds an earlier result, known by its files' names.

    Raises:
        ConfigurationError: where it holds something else.
    """
    found = {path.name for path in out.iterdir()} if out.is_dir() else set[str]()
    if found and not is_earlier(found):
        raise ConfigurationError(f"--out {out} holds other files; give a new or an empty folder")


PIPE_WIDTH = 120
"""Columns in a pipe or a file, for which rich takes 80."""


@dataclass(frozen=True)
class Result:
    """Outcome of a command.

    Attributes:
        report: for a program, printed as JSON.
        table: prints it for a person.
        code: exit code.
    """

    report: Any
    table: Callable[[], object]
    code: int = 0


def run(work: Callable[[Any, Progress], Result], options: Any, as_json: bool) -> int:
    """Print the result of ``work(options, progress)`` and return its exit code.

    With JSON, anything that libraries print meanwhile goes to stderr.
    """
    if not as_json:
        with progress_bar() as progress:
            result = work(options, progress)
        result.table()
        return result.code
    sys.stdout.flush()
    saved = os.dup(1)
    os.dup2(2, 1)
    try:
        result = work(options, no_progress)
    finally:
        sys.stdout.flush()
        os.dup2(saved, 1)
        os.close(saved)
    print(json.dumps(result.report, indent=2, ensure_ascii=False))
    return result.code


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """A bar on stderr from the first progress on; none in a file."""
    console = Console(stderr=True)
    columns = TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn()
    bar = ProgressBar(*columns, console=console, transient=True, disable=not console.is_terminal)
    task = bar.add_task("starting", total=1.0)

    def show(fraction: float, message: str) -> None:
        bar.start()
        bar.update(task, completed=fraction, description=message)

    try:
        yield show
    finally:
        bar.stop()


def console(pipe_width: int = PIPE_WIDTH) -> Console:
    """Standard output, wide enough for a table in a pipe."""
    # Names of users' files are plain text, whatever brackets they contain.
    console = Console(markup=False, highlight=False, emoji=False)
    if not console.is_terminal:
        console.width = max(pipe_width, console.width)
    return console


def print_records(title: str | None, rows: Iterable[dict[str, Any]]) -> None:
    """Print a table of rows with the same keys; rows may end early. Numbers are flush right."""
    rows = list(rows)
    table = Table(title=None if title is None else Text(title))
    for column in rows[0] if rows else ():
        number = not any(isinstance(row.get(column), str | Text) for row in rows)
        table.add_column(column, justify="right" if number else "left", overflow="fold")
    for row in rows:
        table.add_row(*map(_cell, row.values()))
    console().print(table)


def _cell(value: Any) -> Text:
    if isinstance(value, Text):
        return value
    return Text("–" if value is None else f"{value:,}" if type(value) is int else str(value))


def wrong(lines: Iterable[str]) -> Text:
    """Errors in a cell of a table."""
    return Text("\n".join(lines), "bold red")


def print_figures(title: str, rows: Iterable[dict[str, Any]]) -> None:
    """Print rows of figures, rounded, under the names that they have in JSON."""
    rounded = [{k: round(v, 1) if isinstance(v, float) else v for k, v in r.items()} for r in rows]
    print_records(title, [{k.replace("_", " "): v for k, v in row.items()} for row in rounded])


def each_with_progress(items: Sequence[T], progress: Progress) -> Iterator[tuple[T, Progress]]:
    """Each item, with its equal share of ``progress``."""
    for i, item in enumerate(items):
        yield item, scaled_progress(progress, i / len(items), (i + 1) / len(items))


def print_notes(notes: Iterable[str], kind: str = "note", style: str = "yellow") -> None:
    """Print a coloured line for each note."""
    for note in notes:
        console().print(Text(f"{kind}: {note}", style))
