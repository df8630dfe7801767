"""``artiworld bench scans``: reconstructed scans, from file to joints."""

from __future__ import annotations

import json
from pathlib import Path

from app.cli.output import Result, print_records
from app.cli.research_commands import BenchCommand
from model.core.progress import Progress
from model.data.registry import DatasetOptions, recognised
from model.evaluation.scans import ScansConfig, run, table, to_json


def data_in(folder: Path) -> DatasetOptions:
    """The data set that a folder holds, by what lies in it."""
    if any(folder.glob("*/object.urdf")):
        return DatasetOptions("urdf", folder)
    return DatasetOptions(recognised(folder).name, folder)


def bench(options: BenchCommand, progress: Progress) -> Result:
    """Measure with the options of the command."""
    data = DatasetOptions("procedural", seed=1, n=2)
    if options.data is not None:
        data = data_in(options.data)
    config = ScansConfig(
        data, options.half or "table", 15 if options.limit is None else options.limit
    )
    scores = run(config, progress)
    rows = [
        {k: v if isinstance(v, str) else round(v, 3) for k, v in row.items()}
        for row in table(scores)
    ]
    title = f"Reconstructed scans of {data.name}, half {config.half!r}"
    return json.loads(to_json(scores)), lambda: print_records(title, rows)
