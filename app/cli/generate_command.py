"""``artiworld generate``: articulated objects with ground truth."""

from __future__ import annotations

import argparse
from pathlib import Path

from app.cli.options import add_json, count


def add_options(parser: argparse.ArgumentParser) -> None:
    """What the command takes."""
    add = parser.add_argument
    add("--family", nargs="+", default=["all"], metavar="NAME",
        help="categories of PartNet-Mobility, Composite, or all")  # fmt: skip
    add("--n", type=count, default=1, metavar="N", help="objects of each family (default: 1)")
    add("--seed", type=int, default=0, help="the same seed gives the same objects")
    add("--out", type=Path, required=True, metavar="DIR", help="gets one folder an object")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Make the objects, and say where they are."""
    from app.cli import printing
    from app.cli.headless import check_output
    from model.data.procedural.generate import GenerateSettings, generate

    check_output(args.out)
    settings = GenerateSettings(args.out, tuple(args.family), args.n, args.seed)
    with printing.session(args.json) as show:
        folders = generate(settings, show.progress)
    show.result(
        {"folders": [str(f) for f in folders]},
        lambda: print(f"{len(folders)} objects in {args.out}"),
    )
    return 0
