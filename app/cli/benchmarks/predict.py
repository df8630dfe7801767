"""``artiworld bench predict``: the time of a prediction, and its shares.

The network is timed twice in the same run with the same weights: with forced spans appended in one
pass, and token by token as in plain generation. Its passes are compared with plain generation of
the same compact tokens ("fewer than compact") and with the tokens of the answer's text, which a
language model without the compact vocabulary has to write ("fewer than text"). The yardstick is a
KD-tree over 100k points: ratios to it can be compared between machines.
"""

from __future__ import annotations

import re
import resource
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from app.cli.commands import BenchCommand
from app.cli.printing import Result, print_records
from model.core.articulated_object import Part, SegmentedObject
from model.core.mesh import Mesh
from model.core.progress import Progress, no_progress
from model.prediction.arti4urdf.decoding import decode
from model.prediction.arti4urdf.predictor import Arti4UrdfPredictor, make_prompt
from model.prediction.arti4urdf.structure import read_structure
from model.prediction.protocol import Predictor
from model.prediction.registry import load_predictor

PART_COUNTS = (2, 4, 9, 16, 32)
REPEATS = 3


def bench(options: BenchCommand, progress: Progress) -> Result:
    """Measure with the options of the command."""
    report = measure(progress)
    title = "Prediction, a chest of drawers (milliseconds, medians; forward passes)"
    return report, lambda: print_records(title, transposed(report["rows"]))


def measure(progress: Progress = no_progress) -> dict[str, Any]:
    """Milliseconds and forward passes by number of parts, and the process's peak memory."""
    geometric = load_predictor("geometric")
    network = load_predictor("arti4urdf")
    for predictor in (geometric, network):
        predictor.predict(chest(2))  # imports and caches
    rows: list[dict[str, Any]] = []
    for i, count in enumerate(PART_COUNTS):
        progress(i / len(PART_COUNTS), f"{count} parts")
        segmented = chest(count - 1)
        rows.append({"parts": count, **_row(segmented, geometric, network)})
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    scale = 1 if sys.platform == "darwin" else 1024
    return {"rows": rows, "peak memory MiB": round(peak * scale / 2**20)}


def transposed(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row per figure and a column per size, as there are more figures than sizes."""
    names = [name for name in rows[0] if name != "parts"]
    return [{"": name, **{f"{row['parts']} parts": row[name] for row in rows}} for name in names]


def _row(segmented: SegmentedObject, geometric: Predictor, network: Predictor) -> dict[str, Any]:
    whole = _median_ms(lambda: network.predict(segmented))
    yardstick = _median_ms(_yardstick)
    return {
        "geometry": round(_median_ms(lambda: geometric.predict(segmented)), 1),
        "Arti4URDF": round(whole, 1),
        **_decoding(segmented, network),
        "yardstick": round(yardstick, 1),
        "ratio": round(whole / yardstick, 2),
    }


def _decoding(segmented: SegmentedObject, network: Predictor) -> dict[str, Any]:
    """The network's own share, with forced spans and without."""
    predictor: Arti4UrdfPredictor = network  # type: ignore[assignment]
    prompt = make_prompt(read_structure(segmented), segmented, 0)
    spans = decode(predictor.model, prompt)
    single = decode(predictor.model, prompt, span=False)
    text = predictor.predict(segmented).raw_text
    return {
        "decode": round(_median_ms(lambda: decode(predictor.model, prompt)), 1),
        "token by token": round(_median_ms(lambda: decode(predictor.model, prompt, span=False)), 1),
        "passes": spans.passes,
        "token by token passes": single.passes,
        "text tokens": text_tokens(text),
        "fewer than compact": round(single.passes / max(1, spans.passes), 1),
        "fewer than text": round(text_tokens(text) / max(1, spans.passes), 1),
    }


def text_tokens(text: str) -> int:
    """Tokens of the answer's text in Qwen's pre-tokeniser: words, single digits, runs of signs.

    Its byte pairs may cut words further, never join them, so plain decoding takes at least these.
    """
    return len(re.findall(r" ?[A-Za-z_]+|\d| ?[^\sA-Za-z_\d]+|\s*[\r\n]+|\s+", text))


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
    parts = [Part("link_0", mesh=joined(walls))]
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
        parts.append(Part(f"link_{i + 1}", mesh=joined(boxes), name="drawer"))
    return SegmentedObject("chest", tuple(parts), "cabinet")


def _box(at: np.ndarray, low: tuple[float, ...], high: tuple[float, ...]) -> Mesh:
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    vertices = at + np.asarray(low) + corner * np.subtract(high, low)
    return Mesh(vertices, np.array(faces, np.int32))


def joined(meshes: list[Mesh]) -> Mesh:
    """One mesh of several."""
    counts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    faces = [m.faces + start for m, start in zip(meshes, counts, strict=False)]
    return Mesh(np.concatenate([m.vertices for m in meshes]), np.concatenate(faces))


def _yardstick() -> None:
    points = np.random.default_rng(0).random((100_000, 3))
    KDTree(points).query(points[:10_000], k=8)


def _median_ms(function: Callable[[], object]) -> float:
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        function()
        times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times)
