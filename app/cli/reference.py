"""The reference of the command line, made of the options themselves.

``python -m app.cli.reference`` writes ``docs/command-line.md``.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from app.cli.main import make_parser

DOCUMENT = Path(__file__).parents[2] / "docs" / "command-line.md"

_HEAD = """# Command line

<!-- Written by `python -m app.cli.reference`; change the options in app/cli, not this page. -->

`artiworld COMMAND --help` prints the same in a terminal. Paths may stand before, between and after
options. Exit codes: 0; 2 for a mistake in the input, with one line that says what to do; 1 for a
fault of the program, whose details are in a log file, and for `check`, `doctor` and
`export --check` where they find an error.

`artiworld --version` prints the version; `--debug`, before or after the command, shows tracebacks \
and debug messages.
"""


def reference() -> str:
    """All commands and options in Markdown."""
    commands = [p for p in parsers(make_parser()) if arguments(p) == p._actions]
    lines = [_HEAD, "| command | |", "|---|---|"]
    for parser in commands:
        anchor = parser.prog.replace(" ", "-")
        lines.append(f"| [`{parser.prog}`](#{anchor}) | {parser.description} |")
    for parser in commands:
        lines += ["", *_section(parser)]
    return "\n".join(lines) + "\n"


def parsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """A parser and those of all its subcommands, in the order of the help page."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from parsers(below)


def arguments(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    """A parser's own arguments and options; subcommands are neither."""
    return [a for a in parser._actions if not isinstance(a, argparse._SubParsersAction)]


def _section(parser: argparse.ArgumentParser) -> list[str]:
    """Heading, usage and a table of the arguments and options."""
    formatter = parser._get_formatter()
    usage, rows = [parser.prog], []
    for group in parser._action_groups:
        for action in group._group_actions:
            if action.help in (argparse.SUPPRESS, None) or "--help" in action.option_strings:
                continue
            shown = formatter._format_action_invocation(action)
            if not action.option_strings:
                usage.append(formatter._format_args(action, shown))
            elif action.required:
                usage.append(shown)
            only = "" if group in parser._action_groups[:2] else f"{group.title}: "
            rows.append(f"| `{shown}` | {only}{_text(action.help)} |")
    code = ["```sh", f"{' '.join(usage)} [OPTION…]", "```"]
    table = ["| argument | |", "|---|---|", *rows]
    return [f"## {parser.prog}", "", parser.description or "", "", *code, "", *table]


def _text(help: str) -> str:
    return help.replace("|", "\\|").replace("<", "\\<")


if __name__ == "__main__":
    DOCUMENT.write_text(reference(), encoding="utf-8")
