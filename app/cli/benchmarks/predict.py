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

from app.cli.benchmarks.shapes import chest
from app.cli.output import Result, print_records
from app.cli.research_commands import BenchCommand
from model.core.articulated_object import SegmentedObject
from model.core.progress import Progress, no_progress
from model.prediction.arti4urdf.decoding import decode
from model.prediction.arti4urdf.predictor import Arti4UrdfPredictor, make_prompt
from model.prediction.arti4urdf.structure import read_structure
from model.prediction.registry import Predictor, load_predictor

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
