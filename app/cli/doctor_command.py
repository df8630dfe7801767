"""``artiworld doctor``: what is installed, usable and wrong, told."""

from __future__ import annotations

import argparse
from pathlib import Path

from app.cli.options import add_json


def add_options(parser: argparse.ArgumentParser) -> None:
    """What the command takes."""
    parser.add_argument("--workspace", type=Path, default=Path("workspace"), metavar="DIR")
    parser.add_argument("--database", metavar="URL")
    parser.add_argument("--port", type=int, default=8080)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Look at everything, and tell it; 1 where something is wrong."""
    from app.cli import doctor, printing

    with printing.session(args.json) as show:
        checks = doctor.examine(args.workspace, args.database, args.port)
    show.result(doctor.to_json(checks), lambda: printing.checks_table(checks))
    return 1 if any(check.status == "wrong" for check in checks) else 0
