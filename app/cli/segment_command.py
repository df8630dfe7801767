"""``artiworld segment``: a scan cut into parts by clicks from a file."""

from __future__ import annotations

import argparse
from pathlib import Path

from app.cli.options import add_json, add_point_sam, add_reading


def add_options(parser: argparse.ArgumentParser) -> None:
    """What the command takes."""
    add = parser.add_argument
    add("scan", type=Path, metavar="SCAN", help="a mesh, a point cloud or a folder of parts")
    add("--prompts", type=Path, required=True, metavar="FILE", help="JSON file of clicks")
    add("--out", type=Path, required=True, metavar="DIR", help="folder for the parts")
    add("--segmenter", default="default", metavar="NAME", help="who answers the clicks")
    add_point_sam(parser)
    add_reading(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Cut the scan into parts, and say what they are."""
    from app.cli import headless, printing

    with printing.session(args.json) as show:
        report = headless.segment(
            args.scan, args.prompts, args.out, segmenter=args.segmenter,
            reading=headless.ReadOptions(args.up_axis, args.unit_scale), progress=show.progress,
        )  # fmt: skip
    show.result(report, lambda: printing.parts_table(report, args.out))
    return 0
