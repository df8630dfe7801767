"""``artiworld bench scans``: reconstructed scans, from file to joints."""

from __future__ import annotations

import json

from app.cli.printing import Result, print_records
from app.cli.research_commands import BenchCommand
from model.core.progress import Progress
from model.data.registry import DatasetOptions, recognised
from model.evaluation.scans import ScansConfig, run, table, to_json


def bench(options: BenchCommand, progress: Progress) -> Result:
    """Measure with the options of the command."""
    if options.data is None:
        data = DatasetOptions("procedural", seed=1, n=2)
    elif any(options.data.glob("*/object.urdf")):
        data = DatasetOptions("urdf", options.data)
    else:
        data = DatasetOptions(recognised(options.data).name, options.data)
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
