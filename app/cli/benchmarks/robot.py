"""``artiworld bench robot``: whether a gripper can open what is exported."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from app.cli.benchmarks.scans import data_in
from app.cli.output import Result, check_output, print_records
from app.cli.research_commands import BenchCommand
from model.core.errors import ConfigurationError
from model.core.packages import require
from model.core.progress import Progress, scaled_progress
from model.evaluation.robot import folder_runs, open_scene, run, to_json


def bench(options: BenchCommand, progress: Progress) -> Result:
    """Measure with the options of the command."""
    require("mujoco", "artiworld[physics]", "bench robot")
    if options.scene is not None:
        if options.video is not None or options.data is not None:
            raise ConfigurationError("--scene takes neither --data nor --video")
        score = open_scene(options.scene, 3 if options.limit is None else options.limit, progress)
        report = to_json([(options.scene.name, [score])])
        return report, lambda: _print(report)
    if options.video is not None:
        check_output(options.video, option="--video")
    configs = folder_runs(
        None if options.data is None else data_in(options.data), half=options.half or "table",
        limit=options.limit or 0, jobs=options.jobs, pictures=options.video,
    )  # fmt: skip
    runs = []
    for k, config in enumerate(configs):
        span = scaled_progress(progress, k / len(configs), (k + 1) / len(configs))
        runs.append((config.label, run(config, span)))
    report = to_json(runs)
    return report, lambda: _print(report)


def _print(report: Mapping[str, Any]) -> None:
    rows = [{k: _text(v) for k, v in row.items()} for row in report["table"]]
    for row in rows:  # the columns of kinds name their own number of joints
        print_records(f"Joints that the gripper opened: {row.pop('objects')}", [row])
    for label, why in report["reasons"].items():
        said = ", ".join(f"{count} × {reason}" for reason, count in why.items())
        print(f"{label}: not opened: {said or 'none'}")


def _text(value: Any) -> str:
    return "–" if value is None else value if isinstance(value, str) else f"{value:.3g}"
