"""What the commands print: a table for people, or JSON and nothing else."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

    from app.cli.doctor import Check

FILES_TOLD = 10
"""Files of one folder that get a row each; of more the folder gets one."""
NARROWEST = 120
"""Columns where nobody looks (a pipe, a log); rich would fold everything into 80."""


@dataclass
class Show:
    """How a command answers."""

    as_json: bool

    def progress(self, fraction: float, message: str) -> None:
        """One line on the terminal that is written over; nothing in a pipe."""
        if sys.stderr.isatty() and not self.as_json:
            print(f"\r\033[K{100 * fraction:3.0f} % {message}", end="", file=sys.stderr, flush=True)

    def result(self, report: Any, table: Callable[[], object]) -> None:
        """Print ``report`` as JSON, or call ``table``."""
        if self.as_json:
            print(json.dumps(report, indent=2, ensure_ascii=False))
        else:
            table()


@contextmanager
def session(as_json: bool) -> Iterator[Show]:
    """A :class:`Show`; with JSON, what libraries print meanwhile goes to stderr."""
    show = Show(as_json)
    saved = None
    if as_json:
        sys.stdout.flush()
        saved = os.dup(1)
        os.dup2(2, 1)
    try:
        yield show
    finally:
        if saved is not None:
            sys.stdout.flush()
            os.dup2(saved, 1)
            os.close(saved)
        elif sys.stderr.isatty():
            print("\r\033[K", end="", file=sys.stderr, flush=True)


def console() -> Console:
    """Standard output, wide enough for a table in a pipe."""
    made = _console(None)
    return made if made.is_terminal else _console(max(NARROWEST, made.width))


def _console(width: int | None) -> Console:
    from rich.console import Console

    # Names of users' files are text, whatever brackets they hold.
    return Console(width=width, markup=False, highlight=False, emoji=False)


def parts_table(report: dict[str, Any], out: Path) -> None:
    """What ``segment`` wrote."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(f"{report['name']} in {len(report['parts'])} parts"))
    table.add_column("file")
    table.add_column("name")
    table.add_column(f"{report['source']['elements']}s", justify="right")
    for part in report["parts"]:
        table.add_row(part["file"], part.get("name") or "", f"{part['count']:,}")
    _print(table, report["problems"], out)


def joints_table(report: dict[str, Any], out: Path) -> None:
    """What ``predict`` found."""
    from rich.table import Table
    from rich.text import Text

    title = (
        f"{report['name']}: base {report['base']}, {report['backend']}, {report['seconds']:.2f} s"
    )
    table = Table(title=Text(title))
    names = {part["link"]: part["name"] for part in report["parts"]}
    for column in ("joint", "type", "parent", "child", "part"):
        table.add_column(column)
    for column in ("axis", "origin (m)", "limits", "sure"):
        table.add_column(column, justify="right")
    for joint in report["joints"]:
        moves = joint["type"] != "fixed"
        sure = joint["confidence"]
        table.add_row(
            joint["name"],
            joint["type"],
            joint["parent"],
            joint["child"],
            names.get(joint["child"]) or "",
            _vector(joint["axis"]) if moves else "",
            _vector(joint["origin"]) if moves else "",
            limits_text(joint["type"], joint["limits"]),
            "" if sure is None else f"{100 * sure:.0f} %",
        )
    shapes = report["collision_shapes"]
    told = (
        f"{shapes} collision shapes" if shapes else "no collision shapes (--collision makes them)"
    )
    _print(table, report["problems"], out, f"{report['kilograms']:.3g} kg, {told}")


def files_table(report: dict[str, Any], out: Path) -> None:
    """What ``export`` wrote; a folder of many files, as of collision shapes, is one row."""
    from rich.table import Table
    from rich.text import Text

    of_folder: dict[str, list[dict[str, Any]]] = {}
    for file in report["files"]:
        of_folder.setdefault(os.path.dirname(file["file"]), []).append(file)
    table = Table(title=Text(f"{report['asset']} as {report['format']}"))
    table.add_column("file")
    table.add_column("bytes", justify="right")
    for folder, files in of_folder.items():
        if folder and len(files) > FILES_TOLD:
            total = sum(file["bytes"] for file in files)
            table.add_row(f"{folder}/ · {len(files)} files", f"{total:,}")
            continue
        for file in files:
            table.add_row(file["file"], f"{file['bytes']:,}")
    _print(table, [], out)


def checks_table(checks: list[Check]) -> None:
    """What ``doctor`` found, and how to mend it."""
    from rich.table import Table
    from rich.text import Text

    styles = {"fine": "green", "note": "yellow", "wrong": "bold red"}
    table = Table()
    for column in ("", "what", "found"):
        table.add_column(column)
    for check in checks:
        style = styles[check.status]
        table.add_row(Text(check.status, style), Text(check.name), Text(check.found))
    out = console()
    out.print(table)
    for check in checks:
        if check.remedy:
            out.print(Text(f"{check.status}: {check.name}: {check.remedy}", styles[check.status]))


def limits_text(kind: str, limits: list[float] | None) -> str:
    """Limits with their unit: degrees or millimetres."""
    if limits is None:
        return ""
    scale, unit = (1000.0, "mm") if kind == "prismatic" else (180.0 / math.pi, "°")
    low, high = (round(v * scale) + 0 for v in limits)
    return f"{low}…{high} {unit}" if unit == "mm" else f"{low}…{high}{unit}"


def _vector(values: list[float]) -> str:
    return " ".join(f"{v + 0.0:.3f}" for v in values)


def _print(table: object, problems: list[str], out: Path, more: str = "") -> None:
    from rich.text import Text

    target = console()
    target.print(table)
    for problem in problems:
        target.print(Text(f"note: {problem}", "yellow"))
    if more:
        target.print(Text(more))
    target.print(Text(f"written to {out}"))
