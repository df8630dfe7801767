"""The command line: ``artiworld serve | segment | predict | export | …``.

Exit codes: 0; 2 for the user's mistake, with one line on stderr that says what to do; 1 for our own
fault, with its details in a log file. Nothing heavy is imported before a command needs it.
"""

from __future__ import annotations

import argparse
import difflib
import logging
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Sequence
from typing import NoReturn

from app.cli import (
    backend_command,
    bench_command,
    check_command,
    doctor_command,
    evaluate_command,
    export_command,
    generate_command,
    predict_command,
    scene_command,
    segment_command,
    serve_command,
    train_command,
)
from app.cli.options import joined_axes
from model.core.errors import ArtiworldError

_DESCRIPTION = "Turn rigid scans and meshes into articulated, simulator-ready assets."


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return the exit code."""
    words = joined_axes(list(sys.argv[1:] if arguments is None else arguments))
    try:
        args = make_parser().parse_args(words)
    except SystemExit as done:  # --help, --version, or a mistake that was told already
        return int(done.code or 0)
    debug = args.debug
    _set_up_logging(args.log_level, debug)
    try:
        return args.run(args) or 0
    except ArtiworldError as error:
        if debug:
            traceback.print_exc()
        _tell(error)
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:  # the reader of our output has gone, as in "| head"
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return 128 + signal.SIGPIPE
    except Exception as error:  # the boundary of the program
        return _our_fault(error, debug)


def _set_up_logging(level: int, debug: bool) -> None:
    """Our own messages from ``level`` on; libraries' only where they are grave."""
    logging.basicConfig(
        level=logging.DEBUG if debug else max(level, logging.WARNING),
        format="%(levelname)s %(name)s: %(message)s",
    )
    if debug:
        return
    warnings.simplefilter("ignore")
    for package in ("app", "model", "sessions"):
        logging.getLogger(package).setLevel(level)


def make_parser() -> argparse.ArgumentParser:
    """All commands and options."""
    parser = _Parser(prog="artiworld", description=_DESCRIPTION)
    parser.add_argument("--version", action=_Version)
    parser.add_argument("--debug", action="store_true", help="show tracebacks and debug messages")
    commands = parser.add_subparsers(
        title="commands", metavar="COMMAND", required=True, parser_class=_Parser
    )
    for name, module, text in (
        ("serve", serve_command, "open scans in the browser and articulate them"),
        ("segment", segment_command, "cut a scan into parts by clicks from a file"),
        ("predict", predict_command, "predict the joints of a folder of parts"),
        ("scene", scene_command, "articulate a whole scene, its objects in place"),
        ("backend", backend_command, "predict for other machines over HTTP"),
        ("export", export_command, "write articulated objects for simulators"),
        ("check", check_command, "say whether articulated objects work in simulators"),
        ("evaluate", evaluate_command, "score a predictor on a data set"),
        ("generate", generate_command, "make articulated objects with ground truth"),
        ("train", train_command, "train Arti4URDF on objects made here or your own"),
        ("bench", bench_command, "measure speed and accuracy"),
        ("doctor", doctor_command, "say what is installed, usable and wrong"),
    ):
        command = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        module.add_options(command)
        # Also after the command; SUPPRESS keeps its default from undoing the one before it.
        command.add_argument(
            "--debug", action="store_true", default=argparse.SUPPRESS, help=argparse.SUPPRESS
        )
        level = logging.INFO if name == "serve" else logging.ERROR
        command.set_defaults(run=module.run, log_level=level)
    return parser


class _Parser(argparse.ArgumentParser):
    """argparse with one line for a mistake; paths may stand before, between and after options."""

    def __init__(self, **settings: object) -> None:
        super().__init__(allow_abbrev=False, **settings)  # type: ignore[arg-type]
        self._within = False

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Plain argparse refuses the B of ``A --option B``: it takes all paths at the first one."""
        found: argparse.Namespace
        found, left = super().parse_known_args(args, namespace)  # type: ignore[assignment]
        if not left or self._within or self._subparsers is not None:
            return found, left
        self._within = True  # it comes back here, for the options and then for the paths
        try:
            found, left = self.parse_known_intermixed_args(args, namespace)  # type: ignore[assignment]
        finally:
            self._within = False
        if left:  # told here, where the command and its options are known
            self.error(f"unrecognized arguments: {' '.join(left)}{self._meant(left)}")
        return found, left

    def _meant(self, words: Sequence[str]) -> str:
        """The option that is like the first of ``words`` that looks like one, for people."""
        asked = next((w.partition("=")[0] for w in words if w.startswith("--")), "")
        near = difflib.get_close_matches(asked, self._option_string_actions, n=1)
        return f" (did you mean {near[0]}?)" if near else ""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}; see {self.prog} --help\n")


class _Version(argparse.Action):
    def __init__(self, option_strings: list[str], dest: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help="print the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f"artiworld {version('artiworld')}")
        parser.exit()


def _tell(error: BaseException) -> None:
    print(f"artiworld: {' '.join(str(error).split())}", file=sys.stderr)


def _our_fault(error: Exception, debug: bool) -> int:
    if debug:
        traceback.print_exception(error)
        return 1
    from app.server.crash_log import write_crash

    where = write_crash(error)
    kind = "" if type(error) is RuntimeError else f"{type(error).__name__}: "
    message = " ".join(str(error).split())[:300]
    print(f"artiworld: {kind}{message} (details: {where})", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
