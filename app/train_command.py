"""``artiworld train``: samples, training in slices, weights for use."""

from __future__ import annotations

import argparse
import math
from pathlib import Path


def add_train(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add = parser.add_argument
    add("--preset", default="nano", metavar="NAME", help="configuration (default: nano)")
    add(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder of the run; run again to go on",
    )
    add("--samples", type=int, default=8000, metavar="N",
        help="procedural objects to train on, made where missing (default: 8000)")  # fmt: skip
    add("--data", type=Path, action="append", default=[], metavar="DIR",
        help="folder of PartNet-Mobility objects to train on as well (repeatable)")  # fmt: skip
    add("--steps", type=int, default=None, metavar="N", help="length of the schedule")
    add("--seed", type=int, default=0, help="of weights, samples and their order (default: 0)")
    add("--minutes", type=float, default=math.inf, metavar="M",
        help="stop after this long and keep the state (default: no limit)")  # fmt: skip
    add(
        "--jobs",
        type=int,
        default=0,
        metavar="N",
        help="processes that make samples (default: all cores)",
    )
    add("--weights", type=Path, default=None, metavar="DIR",
        help="write the averaged weights here at the end, ready for use")  # fmt: skip
    add("--version-name", default="", metavar="TEXT", help="recorded with the weights")


def run_train(args: argparse.Namespace) -> int:
    """Make what samples are missing, train, write weights.

    Raises:
        ConfigurationError: for a mistake in the options.
    """
    from dataclasses import replace

    from model.errors import ConfigurationError
    from model.evaluation.table import progress_bar
    from model.training.config import preset
    from model.training.loop import export_weights, train
    from model.training.samples import HELD_OUT, make_shards, write_dataset

    if args.samples < 1 or args.minutes <= 0 or args.jobs < 0:
        raise ConfigurationError("--samples, --minutes and --jobs must be positive")
    config = replace(preset(args.preset), seed=args.seed)
    if args.steps is not None:
        if args.steps < 1:
            raise ConfigurationError(f"--steps must be 1 or more, got {args.steps}")
        config = replace(config, steps=args.steps)
    data, held = args.out / "samples", args.out / "validation"
    with progress_bar() as report:
        make_shards(data, args.samples, seed=args.seed + 1, jobs=args.jobs, progress=report)
        make_shards(held, min(200, args.samples), seed=args.seed + 900, progress=report)
        held_out = args.out / "held_out"
        make_shards(
            held_out,
            min(200, args.samples),
            seed=args.seed + 901,
            families=HELD_OUT,
            progress=report,
        )
        for root in args.data:
            write_dataset(root, data, progress=report)
        train(config, data, args.out, validation=held, seconds=args.minutes * 60, progress=report)
    if args.weights is not None:
        export_weights(args.out, args.weights, version=args.version_name or args.preset)
        print(f"weights: {args.weights}")
    return 0
