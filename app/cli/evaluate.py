"""``artiworld evaluate``: score predictors and predictions from files, and report on the simulated
annotator, by predictor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from app.cli.benchmarks.predictions import bench_segment
from app.cli.output import Result, check_output, each_with_progress, print_records
from app.cli.research_commands import EvaluateCommand
from app.cli.simulated_annotator import BY_HAND, AnnotatorConfig, AnnotatorScore, annotate
from model.core.errors import ConfigurationError
from model.core.files import write_json
from model.core.pool import robust_map
from model.core.progress import Progress, no_progress
from model.core.tables import escaped, table
from model.data.folders import export_parts
from model.data.registry import DatasetOptions, open_dataset
from model.evaluation.compare import compare, print_comparison, print_reports
from model.evaluation.html_report import write_html
from model.evaluation.predictions import Frame
from model.evaluation.report import read_report, write_markdown
from model.evaluation.run import TRUTH, Corruption, EvaluationConfig, chosen_ids, require_predictor
from model.evaluation.run import evaluate as evaluate_method
from model.io.model_files import safe_link
from model.prediction.registry import DEFAULT
from model.segmentation.registry import load_segmenter
from model.validation.engines import MUJOCO, require_engines


@dataclass(frozen=True)
class AnnotatorReport:
    """Scores of all objects with each predictor, and by hand."""

    config: AnnotatorConfig
    scores: tuple[AnnotatorScore, ...]

    def rows(self) -> list[dict[str, Any]]:
        """A row for each predictor: means over the objects that were correct in the end.

        ``saved`` is the share of the corrections by hand that the predictor saved, over objects
        that are correct in both.
        """
        return [self._row(name) for name in (*self.config.predictors, BY_HAND)]

    def _row(self, name: str) -> dict[str, Any]:
        scores = [s for s in self.scores if s.predictor == name]
        right = [s for s in scores if s.right]
        hand = {
            s.object_id: s.corrections for s in self.scores if s.predictor == BY_HAND and s.right
        }
        both = [(s.corrections, hand[s.object_id]) for s in right if s.object_id in hand]
        needed = sum(b for _, b in both)
        saved = 1 - sum(a for a, _ in both) / needed if needed else math.nan
        joints, wrong = sum(s.joints for s in right), sum(s.wrong for s in right)
        return {
            "predictor": name,
            "objects": str(len(scores)),
            "right %": _percent(len(right) / len(scores) if scores else math.nan),
            "clicks": _mean([s.clicks for s in right]),
            "part IoU": _mean([s.part_iou for s in right], 3),
            "wrong joints %": _percent(wrong / joints if joints else math.nan),
            "corrections": _mean([s.corrections for s in right]),
            "commands": _mean([s.commands for s in right]),
            "saved %": "" if name == BY_HAND else _percent(saved),
        }

    def to_json(self) -> dict[str, Any]:
        """Settings, rows and all scores."""
        settings = {
            k: getattr(self.config, k)
            for k in ("segmenter", "names", "points", "target", "clicks", "seed")
        }
        return {
            "settings": settings,
            "rows": self.rows(),
            "objects": [asdict(s) for s in self.scores],
        }

    def to_markdown(self) -> str:
        """The table, and the objects that were not correct in the end."""
        rows = self.rows()
        lines = [
            "# The simulated annotator",
            "",
            *table(list(rows[0]), [list(r.values()) for r in rows]),
        ]
        lines += [
            "",
            "Means over objects that were correct in the end. Clicks until every part's IoU is "
            f"{self.config.target} or {self.config.clicks} clicks per part are spent; corrections "
            "are commands on joints; commands are all of the annotator's; saved is the share of "
            "the corrections by hand that the predictor saved.",
            "",
            "## Not correct in the end",
            "",
        ]
        lines += [
            f"- {escaped(s.object_id)}, {escaped(s.predictor)}: {escaped(s.why)}"
            for s in self.scores
            if not s.right
        ]
        return "\n".join(lines) + "\n"


def annotate_all(
    config: AnnotatorConfig, ids: Sequence[str], jobs: int, progress: Progress = no_progress
) -> AnnotatorReport:
    """Annotate all objects, in parallel."""
    found: dict[str, list[AnnotatorScore]] = {}
    for object_id, scores in robust_map(partial(annotate, config), ids, jobs):
        died = [
            AnnotatorScore(object_id, None, name, why="the process died")
            for name in (*config.predictors, BY_HAND)
        ]
        found[object_id] = scores or died
        progress(len(found) / len(ids), f"{len(found)} of {len(ids)} objects annotated")
    return AnnotatorReport(config, tuple(s for i in ids for s in found[i]))


def _mean(values: Sequence[float], digits: int = 1) -> str:
    return f"{sum(values) / len(values):.{digits}f}" if values else "–"


def _percent(share: float) -> str:
    return "–" if math.isnan(share) else f"{100 * share:.1f}"


LEAST_CLOUD = 1000
"""Points of the smallest cloud that the simulated annotator works on."""
SEGMENTATION_SETS = ("procedural", "procedural-noisy", "procedural-one-sided")


def evaluate(options: EvaluateCommand, progress: Progress) -> Result:
    """Score, or do what is asked for instead.

    Raises:
        ConfigurationError: where options exclude each other or can't work.
    """
    if options.out is not None:
        check_output(options.out)
    instead = {
        "compare": _compare,
        "export": _export,
        "person": _annotate,
        "segmentation": _bench_segmentation,
    }
    asked = [name for name in instead if getattr(options, name)]
    if len(asked) > 1:
        raise ConfigurationError(f"--{asked[0]} and --{asked[1]} don't go together; run one")
    return (instead[asked[0]] if asked else _score)(options, progress)


def _score(options: EvaluateCommand, progress: Progress) -> Result:
    configs = configurations(options)
    reports = [evaluate_method(c, progress=p) for c, p in each_with_progress(configs, progress)]
    if options.out is not None:
        for config, report in zip(configs, reports, strict=True):
            assert config.out is not None
            report.write(config.out)
        write_markdown(reports, options.out / "report.md")
        progress(1.0, "drawing the worst objects")
        pairs = list(zip(configs, reports, strict=True))
        write_html(pairs, options.out / "report.html", options.pictures)
    several = [r.to_json() for r in reports]
    found = several[0] if len(several) == 1 else {"runs": several}
    return Result(found, lambda: print_reports(reports))


def configurations(options: EvaluateCommand) -> list[EvaluationConfig]:
    """One for each predictor and each folder of predictions.

    Raises:
        ConfigurationError: for names that come twice, or that can't be a folder.
    """
    turned = options.yaw or options.scan
    if options.predictions and turned:
        raise ConfigurationError("--predictions are of whole objects; leave --scan and --yaw")
    base = EvaluationConfig(
        data=DatasetOptions(
            options.data, options.root, options.seed, options.n, options.family, options.fault
        ),
        split=options.split,
        names=options.names,
        corruption=Corruption(yaw=None if turned else 0.0, scan=options.scan, noise=options.noise),
        jobs=options.jobs,
        limit=options.limit,
        seed=options.seed,
        timeout=options.timeout,
        execute=options.execute,
        engines=require_engines(options.engine) if options.execute else (MUJOCO,),
        out=options.out,
    )
    listed = options.predictor or ("" if options.predictions else DEFAULT)
    out = [replace(base, predictor=name.strip()) for name in listed.split(",") if name.strip()]
    for given in options.predictions:
        name, separator, folder = given.partition("=")
        path = Path(folder if separator else given)
        frame = Frame() if options.frame == "as-is" else None
        label = name if separator else path.resolve().name
        out.append(replace(base, predictor=label, predictions=path, frame=frame))
    names = [c.predictor for c in out]
    twice = next((n for n in names if names.count(n) > 1), None)
    if twice is not None:
        raise ConfigurationError(f"two methods are called {twice!r}; write NAME=DIR")
    if options.out is not None and len(out) > 1:
        out = [replace(c, out=options.out / safe_link(c.predictor)) for c in out]
    return out


def _export(options: EvaluateCommand, progress: Progress) -> Result:
    """Write the objects as folders of parts."""
    target, config = options.export, configurations(options)[0]
    assert target is not None
    check_output(target, *([options.root] if options.root else []), option="--export")
    dataset, ids = open_dataset(config.data), chosen_ids(config)
    written, problems = [], []
    for i, object_id in enumerate(ids):
        progress(i / len(ids), f"{i} of {len(ids)} objects")
        try:
            truth = dataset.load(object_id)
            rng = np.random.default_rng([options.seed, i])
            file = export_parts(truth, target / object_id, with_names=options.names, rng=rng)
            written.append(str(file.parent))
        except Exception as error:  # one bad object never ends the run
            problems.append(f"{object_id}: {error}")

    def table() -> None:
        print(f"{len(written)} objects in {target}")
        for problem in problems:
            print(f"left out: {problem}")

    return Result({"folders": written, "problems": problems}, table)


def _annotate(options: EvaluateCommand, progress: Progress) -> Result:
    """Let a simulated annotator work on the objects."""
    configs = configurations(options)
    names = tuple(c.predictor for c in configs)
    if TRUTH in names or any(c.predictions is not None for c in configs):
        raise ConfigurationError("--person needs predictors, not --predictions or truth")
    if options.points is not None and options.points < LEAST_CLOUD:
        raise ConfigurationError(f"--points must be {LEAST_CLOUD} or more, got {options.points}")
    for name in names:
        require_predictor(name, options.jobs)
    load_segmenter(options.segmenter)
    config = AnnotatorConfig(
        configs[0].data,
        names,
        segmenter=options.segmenter,
        names=options.names,
        seed=options.seed,
        timeout=max(options.timeout, 300.0),
        points=options.points or AnnotatorConfig.points,
    )
    report = annotate_all(config, chosen_ids(configs[0]), options.jobs, progress)
    if options.out is not None:
        write_json(options.out / "person.json", report.to_json())
        (options.out / "person.md").write_text(report.to_markdown(), encoding="utf-8")
    title = "The simulated annotator"
    return Result(report.to_json(), lambda: print_records(title, report.rows()))


def _bench_segmentation(options: EvaluateCommand, progress: Progress) -> Result:
    """Measure the segmenter by simulated clicks."""
    sets = list(SEGMENTATION_SETS)
    if options.root is not None:
        rooms = any(options.root.glob("*_labels.npz"))
        sets += ["room"] if rooms else ["partnet", "partnet-one-sided"]
    found = bench_segment(
        options.root,
        sets,
        [options.segmenter],
        progress,
        limit=options.limit,
        points=options.points,
    )
    if options.out is not None:
        write_json(options.out / "segmentation.json", found.report)
    return found


def _compare(options: EvaluateCommand, _: Progress) -> Result:
    """Compare the reports of two runs."""
    assert options.compare is not None
    a, b = map(read_report, options.compare)
    comparison = compare(a, b, seed=options.seed)
    if options.out is not None:
        write_json(options.out / "comparison.json", comparison.to_json())
        (options.out / "comparison.md").write_text(comparison.to_markdown(), encoding="utf-8")
    return Result(comparison.to_json(), lambda: print_comparison(comparison))
