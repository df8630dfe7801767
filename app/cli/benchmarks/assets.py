"""``artiworld bench assets``: what simulators and validators accept."""

from __future__ import annotations

from app.cli.output import Result, print_records
from app.cli.research_commands import BenchCommand
from model.core.files import read_json
from model.core.progress import Progress, scaled_progress
from model.evaluation.assets import beside, folder_runs, run, to_json
from model.validation.engines import require_engines


def bench(options: BenchCommand, progress: Progress) -> Result:
    """Measure with the options of the command."""
    engines = require_engines(options.engine)
    before = {} if options.before is None else read_json(options.before)
    configs = folder_runs(
        options.data, half=options.half or "table", limit=options.limit or 0, jobs=options.jobs,
        engines=engines,
    )  # fmt: skip
    runs = []
    for k, config in enumerate(configs):
        span = scaled_progress(progress, k / len(configs), (k + 1) / len(configs))
        runs.append((config, run(config, span)))
    report = to_json(runs)
    title = "Accepted exports (earlier figures in brackets)" if before else "Accepted exports"
    return report, lambda: print_records(title, beside(report["table"], before))
