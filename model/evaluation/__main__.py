"""``python -m model.evaluation --root FOLDER``: see :mod:`model.evaluation.run`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from model.errors import ArtiworldError
from model.evaluation.corruption import Corruption
from model.evaluation.run import DATASETS, EvaluationConfig, evaluate
from model.evaluation.table import print_report, progress_bar


def main(arguments: list[str] | None = None) -> int:
    """Run an evaluation from the command line; 0, or 2 for the user's mistake."""
    parser = argparse.ArgumentParser(prog="python -m model.evaluation", description=__doc__)
    parser.add_argument("--root", type=Path, required=True, help="folder of the data set")
    parser.add_argument("--data", default=DATASETS[0], choices=DATASETS)
    parser.add_argument("--predictor", default="geometric")
    parser.add_argument("--names", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--scan", action="store_true", help="one-sided noisy clouds, any yaw")
    parser.add_argument("--yaw", action="store_true", help="turn each object at random")
    parser.add_argument("--noise", type=float, default=0.003, help="of --scan, in diagonals")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--limit", type=int, default=None)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=None)
    a = parser.parse_args(arguments)
    corruption = Corruption(yaw=None if a.yaw or a.scan else 0.0, scan=a.scan, noise=a.noise)
    config = EvaluationConfig(
        a.root,
        a.data,
        a.predictor,
        a.names,
        corruption,
        a.jobs,
        a.limit,
        a.seed,
        out=a.out,
    )
    try:
        with progress_bar() as progress:
            report = evaluate(config, progress=progress)
    except ArtiworldError as error:
        print(error, file=sys.stderr)
        return 2
    print_report(report)
    return 0


if __name__ == "__main__":
    sys.exit(main())
