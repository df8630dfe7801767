"""The reference of the command line, made of the help pages.

``python -m app.cli.reference`` writes ``docs/command-line.md``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from app.cli.commands import COMMANDS
from app.cli.options import Command, Group, description, shown

DOCUMENT = Path(__file__).parents[2] / "docs" / "command-line.md"

_HEAD = """# Command line

<!-- Written by `python -m app.cli.reference`; change the options in app/cli, not this page. -->

`artiworld COMMAND --help` prints the same in a terminal. Paths may stand before, between and after
options. Exit codes: 0; 2 for a mistake in the input, with one line that says what to do; 1 for a
fault of the program, whose details are in a log file, and for `check`, `doctor` and
`export --check` where they find an error.

`artiworld --version` prints the version; `--debug`, before or after the command, shows tracebacks
and debug messages.
"""


def commands(
    found: Mapping[str, type[Command] | Group] = COMMANDS,
) -> Iterator[tuple[str, type[Command]]]:
    """The words that call each command, and its options, in the order of the help page."""
    for name, each in found.items():
        if isinstance(each, Group):
            yield from ((f"{name} {below}", command) for below, command in commands(each.commands))
        else:
            yield name, each


def reference() -> str:
    """All commands and options in Markdown."""
    lines = [_HEAD, "| command | |", "|---|---|"]
    for name, command in commands():
        anchor = f"artiworld-{name.replace(' ', '-')}"
        lines.append(f"| [`artiworld {name}`](#{anchor}) | {description(command)} |")
    for name, command in commands():
        lines += ["", f"## artiworld {name}", "", description(command), "", "| argument | |"]
        lines += ["|---|---|", *(_row(*each) for each in shown(command).items())]
    return "\n".join(lines) + "\n"


def _row(option: str, help: str) -> str:
    text = help.replace("|", "\\|").replace("<", "\\<")
    return f"| `{option}` | {text} |"


if __name__ == "__main__":
    DOCUMENT.write_text(reference(), encoding="utf-8")
