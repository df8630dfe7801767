"""Tables and pages of reports: Markdown, the terminal, HTML, and values that JSON can hold.

Names come from files and people, so every writer here escapes them.
"""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from model.core.files import draft_of, written_to

WIDTH = 150
"""Columns of output to a file or a pipe."""


def finite(value: Any) -> Any:
    """Replace numbers that aren't finite by None, and tuples by lists."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {k: finite(v) for k, v in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [finite(v) for v in value]
    return value


def mean(values: Iterable[float | None]) -> float:
    """Mean of those that aren't None; NaN without any."""
    known = [float(v) for v in values if v is not None]
    return sum(known) / len(known) if known else math.nan


def escaped(text: str) -> str:
    """Escape Markdown and HTML, on one line."""
    plain = " ".join(text.split()).replace("&", "&amp;").replace("<", "&lt;")
    return re.sub(r"([\\`*\[\]|!#])", r"\\\1", plain)


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """A Markdown table of escaped cells."""
    return [
        "| " + " | ".join(header) + " |",
        "|" + "---|" * len(header),
        *("| " + " | ".join(escaped(cell) for cell in row) + " |" for row in rows),
    ]


def print_table(
    title: str,
    header: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    left: Collection[int] = (0,),
    styles: Sequence[str] = (),
    below: Iterable[str] = (),
) -> None:
    """Print a table; columns are numbers, flush right, but for those of ``left``.

    Args:
        styles: of the first rows, such as "bold"; the others are dim where there are any.
        below: lines after the table.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    made = Table(title=Text(title))
    for i, column in enumerate(header):
        made.add_column(column, justify="left" if i in left else "right")
    for i, row in enumerate(rows):
        style = styles[i] if i < len(styles) else "dim" if styles else None
        made.add_row(*map(Text, row), style=style)
    plain: dict[str, Any] = {"markup": False, "highlight": False, "emoji": False}
    console = Console(**plain)
    if not console.is_terminal:
        console = Console(width=WIDTH, **plain)
    console.print(made)
    for line in below:
        console.print(Text(line))


def write_page(path: Path, template: Path, **values: Any) -> Path:
    """Write ``template`` filled with ``values``; ``|png`` makes an address of a PNG file's bytes.

    Raises:
        InputFileError: where it can't be written.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
        loader=FileSystemLoader(template.parent),
    )
    environment.filters["png"] = lambda data: (
        f"data:image/png;base64,{base64.b64encode(data).decode('ascii')}"
    )
    page = environment.get_template(template.name).render(values)
    with written_to(path), draft_of(path) as draft:
        draft.write_text(page, encoding="utf-8")
    return path
