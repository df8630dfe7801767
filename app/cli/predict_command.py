"""``artiworld predict``: the joints of a folder of parts."""

from __future__ import annotations

import argparse
from pathlib import Path

from app.cli.backend_command import add_client_options, chosen_predictor
from app.cli.options import add_json, add_reading, count
from model.prediction.registry import DEFAULT


def add_options(parser: argparse.ArgumentParser) -> None:
    """What the command takes."""
    add = parser.add_argument
    add("folder", type=Path, metavar="DIR",
        help="folder with link_0, link_1, … or an object.json; or a URDF or MJCF, or a GLB whose "
             "meshes are called after parts")  # fmt: skip
    add("--out", type=Path, required=True, metavar="DIR", help="folder for the URDF and its meshes")
    add("--predictor", default=DEFAULT, metavar="NAME", help="who predicts")
    add_client_options(parser, "--token")
    add("--category", metavar="NAME", help="what the object is, such as cabinet")
    add("--collision", action="store_true",
        help="make collision shapes too, which takes seconds to a minute")  # fmt: skip
    add("--seed", type=count, default=0, help="the only source of randomness (default: 0)")
    add_reading(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Predict the joints, and say what they are."""
    from app.cli import headless, printing

    with printing.session(args.json) as show:
        report = headless.predict(
            args.folder, args.out, predictor=chosen_predictor(args), category=args.category,
            seed=args.seed, reading=headless.ReadOptions(args.up_axis, args.unit_scale),
            collision=args.collision, progress=show.progress,
        )  # fmt: skip
    show.result(report, lambda: printing.joints_table(report, args.out))
    return 0
