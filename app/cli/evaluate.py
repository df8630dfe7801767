"""``artiworld evaluate``: score predictors and predictions from files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from app.cli import printing
from app.cli.annotator_report import COLUMNS, annotate_all
from app.cli.benchmarks.segment import bench_segment
from app.cli.output import check_output
from app.cli.printing import Result
from app.cli.research_commands import EvaluateCommand
from app.cli.simulated_annotator import AnnotatorConfig
from model.core.errors import ConfigurationError
from model.core.files import write_json
from model.core.progress import Progress, scaled_progress
from model.data.folders import export_parts
from model.data.registry import DatasetOptions, open_dataset
from model.evaluation.compare import compare, print_comparison, print_reports, print_table
from model.evaluation.html_report import write_html
from model.evaluation.predictions import Frame
from model.evaluation.report import Report, read_report, write_markdown
from model.evaluation.run import TRUTH, Corruption, EvaluationConfig, chosen_ids, require_predictor
from model.evaluation.run import evaluate as evaluate_method
from model.io.model_files import safe_link
from model.prediction.registry import DEFAULT
from model.segmentation.registry import load_segmenter
from model.validation.engines import MUJOCO, require_engines

LEAST_CLOUD = 1000
"""Points of the smallest cloud that the simulated annotator works on."""
SEGMENTATION_SETS = ("procedural", "procedural-noisy", "procedural-one-sided")


def evaluate(options: EvaluateCommand) -> int:
    """Score, or do what is asked for instead, and print the table.

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
    with printing.session(options.json) as show:
        work = instead[asked[0]] if asked else _score
        report, table = work(options, show.progress)
    show.result(report, table)
    return 0


def _score(options: EvaluateCommand, progress: Progress) -> Result:
    configs = configurations(options)
    reports: list[Report] = []
    for i, config in enumerate(configs):
        span = scaled_progress(progress, i / len(configs), (i + 1) / len(configs))
        reports.append(evaluate_method(config, progress=span))
    if options.out is not None:
        for config, report in zip(configs, reports, strict=True):
            assert config.out is not None
            report.write(config.out)
        write_markdown(reports, options.out / "report.md")
        progress(1.0, "drawing the worst objects")
        pairs = list(zip(configs, reports, strict=True))
        write_html(pairs, options.out / "report.html", options.pictures)
    several = [r.to_json() for r in reports]
    return several[0] if len(several) == 1 else {"runs": several}, lambda: print_reports(reports)


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

    return {"folders": written, "problems": problems}, table


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
        configs[0].data, names, segmenter=options.segmenter, names=options.names,
        seed=options.seed, timeout=max(options.timeout, 300.0),
        points=options.points or AnnotatorConfig.points,
    )  # fmt: skip
    report = annotate_all(config, chosen_ids(configs[0]), options.jobs, progress)
    if options.out is not None:
        write_json(options.out / "person.json", report.to_json())
        (options.out / "person.md").write_text(report.to_markdown(), encoding="utf-8")
    return report.to_json(), lambda: print_table("The simulated annotator", COLUMNS, report.rows())


def _bench_segmentation(options: EvaluateCommand, progress: Progress) -> Result:
    """Measure the segmenter by simulated clicks."""
    sets = list(SEGMENTATION_SETS)
    if options.root is not None:
        rooms = any(options.root.glob("*_labels.npz"))
        sets += ["room"] if rooms else ["partnet", "partnet-one-sided"]
    report, table = bench_segment(
        options.root, sets, [options.segmenter], progress, limit=options.limit,
        points=options.points,
    )  # fmt: skip
    if options.out is not None:
        write_json(options.out / "segmentation.json", report)
    return report, table


def _compare(options: EvaluateCommand, _: Progress) -> Result:
    """Compare the reports of two runs."""
    assert options.compare is not None
    a, b = map(read_report, options.compare)
    comparison = compare(a, b, seed=options.seed)
    if options.out is not None:
        write_json(options.out / "comparison.json", comparison.to_json())
        (options.out / "comparison.md").write_text(comparison.to_markdown(), encoding="utf-8")
    return comparison.to_json(), lambda: print_comparison(comparison)
