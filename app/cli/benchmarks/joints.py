"""``artiworld bench joints``: predicted joints on every source, with names and without."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from app.cli.output import Result, print_records
from app.cli.research_commands import BenchCommand
from model.core.errors import ConfigurationError
from model.core.files import read_json
from model.core.progress import Progress, scaled_progress
from model.data.registry import DatasetOptions
from model.evaluation.assets import beside
from model.evaluation.report import Report
from model.evaluation.run import EvaluationConfig, evaluate

FOLDERS = (
    ("PartNet-Mobility", "partnet-mobility", "partnet_mobility"),
    ("Infinigen", "urdf", "infinigen"),
    ("ReplicaCAD", "urdf", "articulated_free/habitat"),
    ("LIBERO", "mjcf", "articulated_free/libero"),
)
"""Title, kind and folder below ``--data`` of each source; those that are absent are left out."""
FAMILIES, SEED = 6, 4242
"""Procedural objects of each held-out family, and the seed that makes them."""
SPLITS = {"choose": "train:0.5", "table": "test:0.5", "all": "all"}


def bench(options: BenchCommand, progress: Progress) -> Result:
    """Measure with the options of the command."""
    before = {} if options.before is None else read_json(options.before)
    found = sources(options.data, SPLITS[options.half or "table"])
    runs = [(title, data, names) for title, data in found.items() for names in (True, False)]
    rows = []
    for k, (title, (data, split), names) in enumerate(runs):
        config = EvaluationConfig(
            data, split, names=names, jobs=options.jobs, limit=options.limit or None
        )
        span = scaled_progress(progress, k / len(runs), (k + 1) / len(runs))
        said = f"{title}, {'names' if names else 'no names'}"
        rows.append(row(said, evaluate(config, progress=span)))
    title = "Predicted joints (earlier figures in brackets)" if before else "Predicted joints"
    return {"table": rows}, lambda: print_records(title, beside(rows, before))


def sources(folder: Path | None, split: str) -> dict[str, tuple[DatasetOptions, str]]:
    """Title → data set and split: those in a folder, and procedural held-out families.

    Raises:
        ConfigurationError: where the folder holds none.
    """
    found = {
        title: (DatasetOptions(kind, folder / below), split)
        for title, kind, below in FOLDERS
        if folder is not None and (folder / below).is_dir()
    }
    if folder is not None and not found:
        named = ", ".join(below for *_, below in FOLDERS)
        raise ConfigurationError(f"--data {folder} holds none of {named}")
    made = DatasetOptions("procedural", seed=SEED, n=FAMILIES)
    return {**found, "procedural, held-out families": (made, "held-out")}


def row(title: str, report: Report) -> dict[str, Any]:
    """The figures of one source; shares in %."""
    values, count = report.summary.values, len(report.scores)
    shares = {"TC %": "tc", "tree %": "tree", "usable joints %": "usable_joints",
              "usable objects %": "usable"}  # fmt: skip
    return {
        "objects": title,
        "number": count,
        **{label: round(100 * values[key], 1) for label, key in shares.items()},
        "calibration error": round(report.calibration.ece, 3),
        "s an object": round(sum(report.seconds) / max(count, 1), 2),
    }
