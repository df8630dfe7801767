"""The command line: ``artiworld serve | segment | predict | export | …``.

Exit codes: 0; 2 for the user's mistake, with one line on stderr that says what to do; 1 for an
internal error, with its details in a log file. Nothing heavy is imported before a command needs it.
"""

from __future__ import annotations

import argparse
import difflib
import logging
import os
import re
import signal
import sys
import traceback
import warnings
from collections.abc import Sequence
from typing import Any, NoReturn

from app.cli.commands import COMMANDS
from app.cli.options import SIGNED_OPTIONS, Command, add_commands, from_namespace
from app.server.ending import write_crash
from model.core.errors import ArtiworldError

_SIGNED = re.compile(r"-([xyz]$|[\d.])")
_DESCRIPTION = "Turn rigid scans and meshes into articulated, simulator-ready assets."


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return the exit code."""
    try:
        command, debug = parse(sys.argv[1:] if arguments is None else arguments)
    except SystemExit as done:  # --help, --version, or a mistake that was reported already
        return int(done.code or 0)
    _set_up_logging(command.log_level, debug)
    try:
        return command.run()
    except ArtiworldError as error:
        if debug:
            traceback.print_exc()
        print(f"artiworld: {_printable(str(error))}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:  # the reader of our output has gone, as in "| head"
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return 128 + signal.SIGPIPE
    except Exception as error:  # the boundary of the program
        return _our_fault(error, debug)


def parse(arguments: Sequence[str]) -> tuple[Command, bool]:
    """The command with its options, and whether ``--debug`` is on.

    Raises:
        SystemExit: after --help, --version or a mistake.
    """
    values = make_parser().parse_args(_with_subcommand(_joined_signs(arguments)))
    return from_namespace(values.command, values), values.debug


def make_parser() -> argparse.ArgumentParser:
    """All commands and options."""
    parser = _Parser(prog="artiworld", description=_DESCRIPTION)
    parser.add_argument("--version", action=_Version)
    parser.add_argument("--debug", action="store_true", help="show tracebacks and debug messages")
    add_commands(parser, COMMANDS, title="commands", metavar="COMMAND")
    return parser


def _with_subcommand(words: list[str]) -> list[str]:
    """``release WORKSPACE`` as ``release create WORKSPACE``; help is that of all subcommands."""
    at = next((i for i, word in enumerate(words) if not word.startswith("-")), len(words))
    command = COMMANDS.get(words[at]) if at < len(words) else None
    if command is None or not command.default_subcommand or len(words) == at + 1:
        return words
    if words[at + 1] in (*command.subcommands, "-h", "--help"):
        return words
    return [*words[: at + 1], command.default_subcommand, *words[at + 1 :]]


def _joined_signs(words: Sequence[str]) -> list[str]:
    """Join ``--up-axis -z`` with "=", as argparse would take the -z for an option."""
    out: list[str] = []
    for word in words:
        if out and out[-1] in SIGNED_OPTIONS and _SIGNED.match(word):
            out[-1] += f"={word}"
        else:
            out.append(word)
    return out


def _set_up_logging(level: int, debug: bool) -> None:
    """Log ArtiWorld's messages from ``level`` on, those of libraries from warnings on."""
    logging.basicConfig(
        level=logging.DEBUG if debug else max(level, logging.WARNING),
        format="%(levelname)s %(name)s: %(message)s",
    )
    if debug:
        return
    warnings.simplefilter("ignore")
    for package in ("app", "model", "sessions"):
        logging.getLogger(package).setLevel(level)


class _Parser(argparse.ArgumentParser):
    """argparse with one line for a mistake; paths may stand before, between and after options."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)
        self._intermixed = False

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Plain argparse refuses the B of ``A --option B``: it takes all paths at the first one."""
        found: argparse.Namespace
        found, left = super().parse_known_args(args, namespace)  # type: ignore[assignment]
        if not left or self._intermixed or self._subparsers is not None:
            return found, left
        self._intermixed = True  # it calls this method, for the options and then for the paths
        try:
            found, left = self.parse_known_intermixed_args(args, namespace)  # type: ignore[assignment]
        finally:
            self._intermixed = False
        if left:  # reported here, where the command and its options are known
            self.error(f"unrecognized arguments: {' '.join(left)}{self._hint(left)}")
        return found, left

    def _hint(self, words: Sequence[str]) -> str:
        """The option that is most similar to the first of ``words`` that looks like one."""
        asked = next((w.partition("=")[0] for w in words if w.startswith("--")), "")
        near = difflib.get_close_matches(asked, self._option_string_actions, n=1)
        return f" (did you mean {near[0]}?)" if near else ""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}; see {self.prog} --help\n")


class _Version(argparse.Action):
    def __init__(self, option_strings: list[str], dest: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help="print the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version  # takes a third of the time of --help

        print(f"artiworld {version('artiworld')}")
        parser.exit()


def _printable(text: str) -> str:
    """The text in one line; escape characters of file names must not steer the terminal."""
    return "".join(c if c.isprintable() else "\ufffd" for c in " ".join(text.split()))


def _our_fault(error: Exception, debug: bool) -> int:
    if debug:
        traceback.print_exception(error)
        return 1
    where = write_crash(error)
    kind = "" if type(error) is RuntimeError else f"{type(error).__name__}: "
    message = _printable(str(error))[:300]
    print(f"artiworld: {kind}{message} (details: {where})", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
