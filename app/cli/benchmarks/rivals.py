"""``artiworld bench rivals``: every method's outputs on the same objects, in one page."""

from __future__ import annotations

from app.cli.benchmarks.scans import data_in
from app.cli.output import Result, print_records
from app.cli.research_commands import BenchCommand
from model.core.errors import ConfigurationError
from model.core.progress import Progress
from model.data.registry import DatasetOptions
from model.evaluation.rivals import compare_rivals, to_json
from model.validation.engines import MUJOCO, require_engines


def bench(options: BenchCommand, progress: Progress) -> Result:
    """Score with the options of the command, write the page, and print its table."""
    if options.root is None:
        raise ConfigurationError("--root: give the folder with a folder of URDFs a method in it")
    require_engines(MUJOCO, "--execute")
    data = DatasetOptions("procedural")
    if options.data is not None:
        data = data_in(options.data)
    rivals = compare_rivals(
        data, options.root, limit=options.limit or None, jobs=options.jobs, progress=progress
    )
    columns = ["method", *rivals[0].figures()]
    rows = [dict(zip(columns, r.cells(), strict=True)) for r in rivals]
    title = f"{len(rivals[0].report.scores)} objects of {data.name}; {options.root}/rivals.html"
    return to_json(rivals), lambda: print_records(title, rows)
