"""The command line: ``artiworld serve | segment | predict | export | …``.

Exit codes: 0; 2 for the user's mistake, with one line on stderr that says what to do; 1 for an
internal error, with its details in a log file. Nothing heavy is imported before a command needs it.
"""

from __future__ import annotations

import difflib
import logging
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import tyro
from tyro._errors import on_parse_error
from tyro.conf import DisallowNone, OmitArgPrefixes, Positional

from app.cli.commands import COMMANDS
from app.cli.options import REGISTRY, Command, Group, description, shown
from app.server.ending import write_crash
from model.core.errors import ArtiworldError

PROGRAM = Group(
    "Turn rigid scans and meshes into articulated, simulator-ready assets.\n\n"
    "COMMAND --help lists the options of a command. --version prints the version; --debug, before\n"
    "or after a command, shows tracebacks.",
    COMMANDS,
)


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
    words = [word for word in arguments if word != "--debug"]
    if words[:1] == ["--version"]:
        from importlib.metadata import version  # takes a third of the time of --help

        print(f"artiworld {version('artiworld')}")
        raise SystemExit(0)
    chosen, program, words = _named(words)
    if isinstance(chosen, Group):
        raise _listed(chosen, program, words)
    with on_parse_error(_report):
        command, left = tyro.cli(
            chosen,
            prog=program,
            description=description(chosen),
            args=words,
            config=(OmitArgPrefixes, DisallowNone),
            registry=REGISTRY,
            return_unknown_args=True,
        )
    return _with_paths(command, left, program) if left else command, "--debug" in arguments


def _named(words: list[str]) -> tuple[type[Command] | Group, str, list[str]]:
    """The command or group that ``words`` name, the words that call it, and those behind.

    ``release WORKSPACE`` is short for ``release create WORKSPACE``; ``bench --json ui`` is as
    ``bench ui --json``.
    """
    chosen: type[Command] | Group = PROGRAM
    program = ["artiworld"]
    while isinstance(chosen, Group) and words and words[0] not in ("-h", "--help"):
        names = chosen.commands
        first = words[0] if chosen.default or not words[0].startswith("-") else None
        name = first or next((word for word in words if word in names), "")
        if name in names:
            words = [*words[: words.index(name)], *words[words.index(name) + 1 :]]
        elif not (name := chosen.default):
            break
        program.append(name)
        chosen = names[name]
    return chosen, " ".join(program), words


def _listed(group: Group, program: str, words: Sequence[str]) -> SystemExit:
    """Print the commands of a group, or the mistake that ``words`` name none of them."""
    if words[:1] not in (["-h"], ["--help"]):
        known = f"one of {', '.join(group.commands)}"
        text = f"COMMAND {words[0]!r} isn't {known}" if words else f"COMMAND is missing: {known}"
        return _mistake(text, program)
    print(f"usage: {program} COMMAND [OPTION ...]\n\n{group.help}\n\ncommands:")
    width = max(map(len, group.commands))
    for name, each in group.commands.items():
        print(f"  {name:<{width}}  {description(each)}")
    return SystemExit(0)


def _with_paths(command: Command, words: Sequence[str], program: str) -> Command:
    """``command`` with the paths that stand behind an option: tyro reads those before it alone."""
    several = [
        f.name
        for f in fields(command)  # type: ignore[arg-type]
        if f.metadata.get("marker") is Positional and isinstance(getattr(command, f.name), tuple)
    ]
    wrong = next((w.partition("=")[0] for w in words if w.startswith("-")), "")
    if several and not wrong:
        paths = (*getattr(command, several[0]), *map(Path, words))
        return replace(command, **{several[0]: paths})  # type: ignore[type-var]
    known = [option.split()[0].strip(",") for option in shown(type(command))]
    near = difflib.get_close_matches(wrong, known, n=1)
    hint = f" (did you mean {near[0]}?)" if near else ""
    raise _mistake(f"unrecognized arguments: {' '.join(words)}{hint}", program)


def _report(event: Any) -> None:
    """Print what is wrong with the words in one line, in place of tyro's boxes, and exit."""
    named = argument.display_name() if (argument := getattr(event, "argument", None)) else ""
    match type(event).__name__:
        case "MissingArgs":
            needed = (str(each.arg.get_invocation_text()[1]) for each in event.missing_arguments)
            left = "".join(f"; {word!r} is unknown" for word in event.unrecognized_tokens)
            text = f"missing {', '.join(needed)}{left}"
        case "InvalidChoice":
            text = f"{named} {event.value} is none of {', '.join(event.choices)}"
        case "InstantiationFailure":
            text = f"{named} {event.message}"
        case _:
            text = f"{named} needs a value"
    raise _mistake(text, event.prog)


def _mistake(text: str, program: str) -> SystemExit:
    """Print the mistake; returns the end of the program."""
    print(f"{program}: {_printable(text)}; see {program} --help", file=sys.stderr)
    return SystemExit(2)


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
