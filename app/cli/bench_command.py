"""``artiworld bench``: figures that are measured now, on this machine."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from app.cli.options import add_json, count
from model.core.errors import ConfigurationError
from model.core.progress import Progress, no_progress


@dataclass(frozen=True)
class Bench:
    """What was measured: for a program, and shown to a person."""

    report: Any
    show: Callable[[], object]


def add_options(parser: argparse.ArgumentParser) -> None:
    """What the command takes."""
    add = parser.add_argument
    add("what", choices=("ui", "scene", "segment", "predict", "networks"),
        help="the screen of one object, of a scene; the segmenter; the predictor; "
        "the paper-size networks with random weights")  # fmt: skip
    add("--data", type=Path, metavar="DIR", help="segment: folder of real data, by default made up")
    add("--sets", nargs="+", metavar="NAME",
        help="segment: data sets, e.g. partnet-mesh, or urdf-scan for your own URDFs")  # fmt: skip
    add("--segmenter", action="append", metavar="NAME",
        help="segment: may be repeated; ui: who answers the clicks")  # fmt: skip
    add("--points", type=count, nargs="+", metavar="N", help="ui: sizes of the clouds")
    add("--faces", type=count, metavar="N", help="ui: size of the mesh; 0 leaves it out")
    add("--clicks", type=count, metavar="N", help="ui: clicks on each object")
    add("--objects", type=count, metavar="N", help="scene: how many (default: 200)")
    add("--limit", type=int, help="segment: objects of each set")
    add("--offset", type=int, metavar="N", help="segment: with which object the subset begins")
    add("--parts", type=count, metavar="N", help="segment: parts asked for in an object at most")
    add("--first", choices=("deepest", "random"), help="segment: where the first click goes")
    add("--sizes", nargs="+", metavar="NAME",
        help="networks: language models (0.6b 1.7b 4b 8b)")  # fmt: skip
    add("--train", action="store_true", default=None,
        help="networks: train without a GPU, too (minutes a step)")  # fmt: skip
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, and show what came of it."""
    from app.cli import printing

    runs: dict[str, Callable[[], Bench]] = {
        "ui": lambda: bench_ui(args.points, args.faces, args.clicks, (args.segmenter or [None])[0]),
        "scene": lambda: bench_scene(args.objects),
        "segment": lambda: bench_segment(
            args.data,
            args.sets,
            args.segmenter,
            show.progress,
            limit=args.limit,
            offset=args.offset,
            parts=args.parts,
            first=args.first,
        ),
        "predict": lambda: bench_predict(show.progress),
        "networks": lambda: bench_networks(args.sizes, args.train, show.progress),
    }
    with printing.session(args.json) as show:
        answer = runs[args.what]()
    show.result(answer.report, answer.show)
    return 0


def bench_ui(
    points: list[int] | None, faces: int | None, clicks: int | None, segmenter: str | None
) -> Bench:
    """The screen: open to first picture, click to labels, bytes a click, animation ticks."""
    from app.cli.benchmarks.ui import BenchUiConfig, run

    asked = {
        "points": tuple(points) if points else None,
        "faces": faces,
        "clicks": clicks,
        "segmenter": segmenter,
    }
    figures = run(BenchUiConfig(**{k: v for k, v in asked.items() if v is not None}))
    return Bench([asdict(f) for f in figures], _nothing)  # it prints its own table


def bench_scene(objects: int | None) -> Bench:
    """A large scene: until its first picture, and until the whole of it is sent."""
    from app.cli.benchmarks.scene import run, show

    figures = run(200 if objects is None else objects)
    return Bench([asdict(f) for f in figures], lambda: show(figures))


def bench_segment(
    data: Path | None,
    sets: list[str] | None,
    segmenters: list[str] | None,
    progress: Progress = no_progress,
    **settings: Any,
) -> Bench:
    """Segmentation by simulated clicks, see :mod:`model.evaluation.segmentation.bench`.

    ``settings`` are those of its ``BenchConfig``; None leaves the default.
    """
    import json
    from typing import get_args

    from model.evaluation.segmentation.bench import BenchConfig, DataSet, run

    chosen = sets or (["partnet"] if data is not None else ["procedural"])
    known = get_args(DataSet)
    for name in chosen:
        if name not in known:
            raise ConfigurationError(f"no data set {name!r}; there are {', '.join(known)}")
        if data is None and not name.startswith("procedural"):
            raise ConfigurationError(f"the data set {name!r} needs --data DIR")
    if data is not None and not data.is_dir():
        raise ConfigurationError(f"--data {data} is no folder")
    settings |= {"sets": tuple(chosen), "data": data}
    settings["segmenters"] = tuple(segmenters) if segmenters else None
    given = {k: v for k, v in settings.items() if v is not None}
    report = run(BenchConfig(**given), progress)
    return Bench(json.loads(report.to_json()), report.print_table)


def bench_predict(progress: Progress = no_progress) -> Bench:
    """Prediction by number of parts, see :mod:`app.cli.benchmarks.predict`."""
    from app.cli.benchmarks.predict import measure, upright

    report = measure(progress)
    title = "Prediction, a chest of drawers (milliseconds, medians; forward passes)"
    return Bench(report, lambda: _show(title, upright(report["rows"])))


def bench_networks(
    sizes: list[str] | None, train: bool | None, progress: Progress = no_progress
) -> Bench:
    """The paper-size networks, see :mod:`app.cli.benchmarks.networks`."""
    from model.training.arti4urdf.full_config import LORA_RANK, FullConfig, require_extras

    require_extras(FullConfig(lora_rank=LORA_RANK))
    from app.cli.benchmarks.networks import NetworksConfig, measure, tables
    from model.prediction.arti4urdf.language_model import QWEN3

    for name in sizes or ():
        if name not in QWEN3:
            raise ConfigurationError(f"no size {name!r}; there are {', '.join(QWEN3)}")
    asked = {name: QWEN3[name] for name in sizes} if sizes else None
    report = measure(NetworksConfig(sizes=asked, train=train), progress)

    def show() -> None:
        for title, rows in tables(report):
            _show(title, rows)

    return Bench(report, show)


def _nothing() -> None:
    """What is left to show where a bench printed its table already."""


def _show(title: str, rows: list[dict[str, Any]]) -> None:
    from rich.table import Table

    from app.cli.printing import console

    table = Table(title=title)
    for column in rows[0] if rows else ():
        table.add_column(column, justify="right")
    for row in rows:
        table.add_row(*(str(value) for value in row.values()))
    console().print(table)
