"""``artiworld bench``: figures that are measured now, on this machine."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from model.errors import ConfigurationError
from model.progress import Progress, no_progress


@dataclass(frozen=True)
class Bench:
    """What was measured: for a program, and shown to a person."""

    report: Any
    show: Callable[[], object]


def bench_ui(
    points: list[int] | None, faces: int | None, clicks: int | None, segmenter: str | None
) -> Bench:
    """The screen: open to first picture, click to labels, bytes a click, animation ticks."""
    from app.bench_ui import BenchUiConfig, run

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
    from app.bench_scene import run, show

    figures = run(200 if objects is None else objects)
    return Bench([asdict(f) for f in figures], lambda: show(figures))


def bench_segment(
    data: Path | None,
    sets: list[str] | None,
    segmenters: list[str] | None,
    progress: Progress = no_progress,
    **settings: Any,
) -> Bench:
    """Segmentation by simulated clicks, see :mod:`model.segmentation.bench`.

    ``settings`` are those of its ``BenchConfig``; None leaves the default.
    """
    from typing import get_args

    from model.segmentation.bench import BenchConfig, DataSet, run

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
    """Prediction by number of parts, see :mod:`app.bench_predict`."""
    from app.bench_predict import measure, upright

    report = measure(progress)
    title = "Prediction, a chest of drawers (milliseconds, medians; forward passes)"
    return Bench(report, lambda: _show(title, upright(report["rows"])))


def _nothing() -> None:
    """What is left to show where a bench printed its table already."""


def _show(title: str, rows: list[dict[str, Any]]) -> None:
    from rich.table import Table

    from app.printing import console

    table = Table(title=title)
    for column in rows[0] if rows else ():
        table.add_column(column, justify="right")
    for row in rows:
        table.add_row(*(str(value) for value in row.values()))
    console().print(table)
