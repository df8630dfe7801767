"""Output of the commands: folders, checked before a command writes; a table for people, or JSON
alone.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as ProgressBar
from rich.table import Table
from rich.text import Text

from model.core.errors import ConfigurationError
from model.core.joint import JOINT_KINDS
from model.core.progress import Progress, no_progress

if TYPE_CHECKING:
    from app.cli.doctor import Check


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


def other_files_error(out: Path) -> ConfigurationError:
    """The error for an output folder that holds something else than an earlier result."""
    return ConfigurationError(f"--out {out} holds other files; give a new or an empty folder")


MOST_FILES = 10
"""Files of one folder that get a row each; a folder with more gets one row."""
PIPE_WIDTH = 120
"""Columns in a pipe or a file, for which rich takes 80."""


Result = tuple[Any, Callable[[], object]]
"""A report for a program, and the function that prints it for a person."""


@dataclass(frozen=True)
class Show:
    """Output of a command's progress and result."""

    as_json: bool
    progress: Progress = no_progress

    def result(self, report: Any, table: Callable[[], object]) -> None:
        """Print ``report`` as JSON, or call ``table``."""
        if self.as_json:
            print(json.dumps(report, indent=2, ensure_ascii=False))
        else:
            table()


@contextmanager
def session(as_json: bool) -> Iterator[Show]:
    """A :class:`Show`; with JSON, anything that libraries print meanwhile goes to stderr."""
    if not as_json:
        with progress_bar() as progress:
            yield Show(False, progress)
        return
    sys.stdout.flush()
    saved = os.dup(1)
    os.dup2(2, 1)
    try:
        yield Show(True)
    finally:
        sys.stdout.flush()
        os.dup2(saved, 1)
        os.close(saved)


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """A bar on stderr, driven as a :class:`~model.core.progress.Progress`; none in a file."""
    console = Console(stderr=True)
    columns = TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn()
    with ProgressBar(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda fraction, message: bar.update(task, completed=fraction, description=message)


def console(pipe_width: int = PIPE_WIDTH) -> Console:
    """Standard output, wide enough for a table in a pipe."""
    # Names of users' files are plain text, whatever brackets they contain.
    console = Console(markup=False, highlight=False, emoji=False)
    if not console.is_terminal:
        console.width = max(pipe_width, console.width)
    return console


def table_of(
    title: str | None,
    columns: Iterable[str],
    rows: Iterable[Iterable[str | Text]],
    numbers: Iterable[str] = (),
) -> Table:
    """A table; columns among ``numbers`` are flush right."""
    right = set(numbers)
    table = Table(title=None if title is None else Text(title))
    for column in columns:
        table.add_column(column, justify="right" if column in right else "left", overflow="fold")
    for row in rows:
        table.add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in row))
    return table


def print_records(title: str, rows: list[dict[str, Any]]) -> None:
    """Print a table of rows that have the same keys; rows may end early."""
    columns = list(rows[0]) if rows else []
    cells = [["–" if v is None else str(v) for v in row.values()] for row in rows]
    console().print(table_of(title, columns, cells, columns))


def print_notes(notes: Iterable[str]) -> None:
    """Print a yellow line for each note."""
    for note in notes:
        console().print(Text(f"note: {note}", "yellow"))


def print_parts(report: dict[str, Any], out: Path) -> None:
    """Print the parts that ``segment`` wrote."""
    elements = f"{report['source']['elements']}s"
    rows = [(p["file"], p.get("name") or "", f"{p['count']:,}") for p in report["parts"]]
    title = f"{report['name']} in {len(rows)} parts"
    console().print(table_of(title, ("file", "name", elements), rows, [elements]))
    print_notes(report["problems"])
    console().print(f"written to {out}")


def print_joints(report: dict[str, Any], out: Path) -> None:
    """Print the joints that ``predict`` found."""
    names = {part["link"]: part["name"] for part in report["parts"]}
    numbers = ("axis", "origin (m)", "limits", "confidence")
    rows = []
    for joint in report["joints"]:
        moves, confidence = joint["type"] != "fixed", joint["confidence"]
        rows.append(
            (
                joint["name"],
                joint["type"],
                joint["parent"],
                joint["child"],
                names.get(joint["child"]) or "",
                _vector(joint["axis"]) if moves else "",
                _vector(joint["origin"]) if moves else "",
                limits_text(joint["type"], joint["limits"]),
                "" if confidence is None else f"{100 * confidence:.0f} %",
            )
        )
    title = (
        f"{report['name']}: base {report['base']}, {report['backend']}, {report['seconds']:.2f} s"
    )
    columns = ("joint", "type", "parent", "child", "part", *numbers)
    console().print(table_of(title, columns, rows, numbers))
    print_notes(report["problems"])
    shapes = report["collision_shapes"] or "no"
    hint = "" if report["collision_shapes"] else " (--collision makes them)"
    console().print(f"{report['kilograms']:.3g} kg, {shapes} collision shapes{hint}")
    console().print(f"written to {out}")


def print_prepared(report: dict[str, Any], out: Path) -> None:
    """Print how ``prepare`` turned a scan and what it took away."""
    x, y, z = report["size"]
    console().print(
        f"up {_vector(report['up_in_source'])} in the file, "
        f"tilted by {report['tilt_degrees']:.0f}°, confidence {100 * report['confidence']:.0f} %"
    )
    console().print(f"{x:.3g} × {y:.3g} × {z:.3g} m, {report['elements']['kept']:,} elements kept")
    if report["removed"]:
        taken = ", ".join(f"{n:,} of {kind}" for kind, n in report["removed"].items())
        console().print(f"taken away: {taken} (--keep-support keeps all but outliers)")
    print_notes(report["problems"])
    console().print(f"written to {out}")


def print_files(report: dict[str, Any], out: Path) -> None:
    """Print the files that ``export`` wrote; a folder of many, as of shapes, gets one row."""
    folders: dict[str, list[dict[str, Any]]] = {}
    for file in report["files"]:
        folders.setdefault(os.path.dirname(file["file"]), []).append(file)
    rows = []
    for folder, files in folders.items():
        if folder and len(files) > MOST_FILES:
            total = sum(file["bytes"] for file in files)
            rows.append((f"{folder}/ · {len(files)} files", f"{total:,}"))
        else:
            rows += [(file["file"], f"{file['bytes']:,}") for file in files]
    title = f"{report['asset']} as {report['format']}"
    console().print(table_of(title, ("file", "bytes"), rows, ["bytes"]))
    console().print(f"written to {out}")


def print_checks(checks: list[Check]) -> None:
    """Print what ``doctor`` found, and the remedies."""
    styles = {"fine": "green", "note": "yellow", "wrong": "bold red"}
    rows = [(Text(c.status, styles[c.status]), c.name, c.found) for c in checks]
    console().print(table_of(None, ("", "what", "found"), rows))
    for check in checks:
        if check.remedy:
            line = f"{check.status}: {check.name}: {check.remedy}"
            console().print(Text(line, styles[check.status]))


def limits_text(kind: str, limits: list[float] | None) -> str:
    """Limits with their unit: degrees or millimetres."""
    if limits is None:
        return ""
    scale, unit = (1000.0, " mm") if JOINT_KINDS[kind].slides else (180.0 / math.pi, "°")
    low, high = (round(v * scale) + 0 for v in limits)
    return f"{low}…{high}{unit}"


def _vector(values: list[float]) -> str:
    return " ".join(f"{v + 0.0:.3f}" for v in values)
