"""``artiworld bench segment``: the segmenter by simulated clicks."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

from app.cli.output import Result
from app.cli.research_commands import BenchCommand
from model.core.errors import ConfigurationError
from model.core.progress import Progress
from model.evaluation.segmentation import BenchConfig, DataSet, run


def bench(options: BenchCommand, progress: Progress) -> Result:
    """Measure with the options of the command."""
    return bench_segment(
        options.data, options.sets, options.segmenter, progress, limit=options.limit,
        offset=options.offset, parts=options.parts, first=options.first,
    )  # fmt: skip


def bench_segment(
    data: Path | None,
    sets: Sequence[str] | None,
    segmenters: Sequence[str] | None,
    progress: Progress,
    **settings: Any,
) -> Result:
    """Measure segmenters on data sets.

    Args:
        data: folder of real data; None for procedural objects.
        settings: fields of :class:`BenchConfig`; None leaves a default.

    Raises:
        ConfigurationError: for an unknown data set, or one without its folder.
    """
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
    report = run(BenchConfig(**{k: v for k, v in settings.items() if v is not None}), progress)
    return json.loads(report.to_json()), report.print_table
