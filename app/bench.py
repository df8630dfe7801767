"""``artiworld bench``: figures that are measured now, on this machine."""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from model.errors import ConfigurationError
from model.geometry.mesh import Mesh
from model.kinematics.articulated_object import Part, SegmentedObject
from model.progress import Progress, no_progress

PART_COUNTS = (2, 4, 8, 16, 32)
REPEATS = 3


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


def bench_segment(
    data: Path | None,
    sets: list[str] | None,
    segmenters: list[str] | None,
    limit: int | None,
    progress: Progress = no_progress,
) -> Bench:
    """Segmentation by simulated clicks, see :mod:`model.segmentation.bench`."""
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
    settings: dict[str, Any] = {"sets": tuple(chosen)}
    if data is not None:
        settings["data"] = data
    if segmenters:
        settings["segmenters"] = tuple(segmenters)
    if limit is not None:
        settings["limit"] = limit
    report = run(BenchConfig(**settings), progress)
    return Bench(json.loads(report.to_json()), report.print_table)


def bench_predict(progress: Progress = no_progress) -> Bench:
    """Milliseconds of the geometric predictor by number of parts.

    Beside it stands a fixed piece of work of the same run, a KD-tree over 100k points: their ratio
    can be compared between machines.
    """
    from model.predictors import load_predictor

    predictor = load_predictor("geometric")
    predictor.predict(chest(2))  # imports and caches
    rows: list[dict[str, Any]] = []
    for i, count in enumerate(PART_COUNTS):
        progress(i / len(PART_COUNTS), f"{count} parts")
        segmented = chest(count - 1)
        took = _median_ms(lambda segmented=segmented: predictor.predict(segmented))
        yardstick = _median_ms(_yardstick)
        answer = predictor.predict(segmented)
        joints = answer.tree.joints if answer.tree is not None else ()
        rows.append(
            {
                "parts": count,
                "ms": round(took, 1),
                "ms a part": round(took / count, 2),
                "yardstick ms": round(yardstick, 1),
                "ratio": round(took / yardstick, 2),
                "sliding joints": sum(j.type == "prismatic" for j in joints),
            }
        )
    return Bench({"rows": rows}, lambda: _show("Geometric predictor, a chest of drawers", rows))


def chest(drawers: int) -> SegmentedObject:
    """A chest with ``drawers`` drawers in columns of four, each an open box with a handle."""
    columns = -(-drawers // 4)
    rows = -(-drawers // columns)
    wide, high, deep = 0.5, 0.2, 0.45
    size = np.array([deep, columns * wide, rows * high])
    wall = 0.015
    low = np.array([-deep / 2, -size[1] / 2, 0.0])
    wide_all, high_all = float(size[1]), float(size[2])
    walls = [
        _box(low, (-wall, -wall, -wall), (deep, wide_all + wall, 0.0)),
        _box(low, (-wall, -wall, high_all), (deep, wide_all + wall, high_all + wall)),
        _box(low, (-wall, -wall, 0.0), (deep, 0.0, high_all)),
        _box(low, (-wall, wide_all, 0.0), (deep, wide_all + wall, high_all)),
        _box(low, (-wall, 0.0, 0.0), (0.0, wide_all, high_all)),
    ]
    parts = [Part("link_0", mesh=_joined(walls))]
    gap, thin = 0.004, 0.01
    x, y, z = deep - gap, wide - 2 * gap, high - 2 * gap
    for i in range(drawers):
        at = np.add(low, (gap, (i // rows) * wide + gap, (i % rows) * high + gap))
        boxes = [
            _box(at, (0.0, 0.0, 0.0), (x, y, thin)),
            _box(at, (0.0, 0.0, 0.0), (x, thin, z)),
            _box(at, (0.0, y - thin, 0.0), (x, y, z)),
            _box(at, (0.0, 0.0, 0.0), (thin, y, z)),
            _box(at, (x - thin, 0.0, 0.0), (x, y, z)),
            _box(at, (x, y / 2 - 0.06, z / 2 - 0.008), (x + 0.03, y / 2 + 0.06, z / 2 + 0.008)),
        ]
        parts.append(Part(f"link_{i + 1}", mesh=_joined(boxes), name="drawer"))
    return SegmentedObject("chest", tuple(parts), "cabinet")


def _box(at: np.ndarray, low: tuple[float, ...], high: tuple[float, ...]) -> Mesh:
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    vertices = at + np.asarray(low) + corner * np.subtract(high, low)
    return Mesh(vertices, np.array(faces, np.int32))


def _joined(meshes: list[Mesh]) -> Mesh:
    counts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    faces = [m.faces + start for m, start in zip(meshes, counts, strict=False)]
    return Mesh(np.concatenate([m.vertices for m in meshes]), np.concatenate(faces))


def _nothing() -> None:
    """What is left to show where a bench printed its table already."""


def _yardstick() -> None:
    from scipy.spatial import KDTree

    points = np.random.default_rng(0).random((100_000, 3))
    KDTree(points).query(points[:10_000], k=8)


def _median_ms(function: Callable[[], object]) -> float:
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        function()
        times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times)


def _show(title: str, rows: list[dict[str, Any]]) -> None:
    from rich.table import Table

    from app.printing import console

    table = Table(title=title)
    for column in rows[0] if rows else ():
        table.add_column(column, justify="right")
    for row in rows:
        table.add_row(*(str(value) for value in row.values()))
    console().print(table)
