"""``artiworld evaluate``: score predictors and other people's predictions."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.cli.options import add_json, count
from model.core.errors import ConfigurationError
from model.prediction.registry import DEFAULT

if TYPE_CHECKING:
    from app.cli.printing import Show
    from model.core.progress import Progress
    from model.data.registry import DatasetOptions
    from model.evaluation.report import Report
    from model.evaluation.run import EvaluationConfig


def add_options(parser: argparse.ArgumentParser) -> None:
    """What the command takes."""
    add = parser.add_argument
    add("--data", default="partnet-mobility", metavar="NAME",
        help="partnet-mobility, physxnet, urdf, mjcf or procedural")  # fmt: skip
    add("--root", type=Path, metavar="DIR", help="folder of the data set")
    add("--split", default="all", metavar="WHICH",
        help="all, held-out (the paper's five categories), known, train[:SHARE], test[:SHARE] or "
             "category:NAME,NAME (default: all)")  # fmt: skip
    add("--n", type=int, default=1, help="procedural without --root: objects a family")
    add("--family", nargs="+", default=[], metavar="NAME", help="procedural without --root")
    add("--fault", default="", metavar="NAME",
        help="procedural without --root: what is wrong with the input: clouds, noise, "
        "heavy-noise, outliers, one-sided, split, merge, bleed, turned or mixed "
        "(default: clean meshes)")  # fmt: skip
    add(
        "--predictor",
        metavar="NAME,NAME",
        help=f"who predicts (default: {DEFAULT}); truth answers with the truth",
    )
    add("--predictions", action="append", default=[], metavar="[NAME=]DIR",
        help="score the URDFs in this folder instead; may be repeated")  # fmt: skip
    add("--frame", choices=("auto", "as-is"), default="auto",
        help="of --predictions: find turn and scale, or take the files as they are")  # fmt: skip
    add("--names", action=argparse.BooleanOptionalAction, default=True,
        help="tell the predictor part names and category")  # fmt: skip
    add("--scan", action="store_true", help="one-sided noisy clouds, turned at random")
    add("--yaw", action="store_true", help="turn each object at random")
    add("--noise", type=float, default=0.003, help="of --scan, in diagonals (default: 0.003)")
    add("--execute", action="store_true",
        help="also drive every joint of the predictions, in MuJoCo too")  # fmt: skip
    add("--jobs", type=int, default=2, help="processes (default: 2)")
    add("--timeout", type=float, default=120.0, metavar="SECONDS",
        help="an object that takes longer counts as failed (default: 120)")  # fmt: skip
    add("--limit", type=int, help="at most this many objects")
    add("--seed", type=count, default=0, help="of predictors, splits and made objects (default: 0)")
    add("--out", type=Path, metavar="DIR", help="folder for the reports; a stopped run goes on")
    add("--pictures", type=int, default=10, metavar="N",
        help="worst objects to draw in the page of --out (default: 10)")  # fmt: skip
    add("--person", action="store_true",
        help="instead, let a scripted annotator click, predict and correct")  # fmt: skip
    add("--segmentation", action="store_true",
        help="instead, simulated clicks: IoU@k and NoC on made-up scans, and on --root's: objects "
             "of partnet-mobility, or rooms as <name>.ply with <name>_labels.npz")  # fmt: skip
    add("--segmenter", default="default", metavar="NAME",
        help="of --person and --segmentation: who answers the clicks")  # fmt: skip
    add("--points", type=int, metavar="N",
        help="of --person and --segmentation: a cloud (default: 30000 and 100000)")  # fmt: skip
    add("--export", type=Path, metavar="DIR",
        help="write the objects as folders for artiworld predict, and stop")  # fmt: skip
    add("--compare", nargs=2, type=Path, metavar=("A", "B"),
        help="what changed from one run's --out to another's, and stop")  # fmt: skip
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Carry it out."""
    from app.cli import printing
    from app.cli.headless import check_output

    if args.out is not None:
        check_output(args.out)
    with printing.session(args.json) as show, _progress(args.json) as progress:
        answer, table = _chosen(args)(args, progress)
    return _show(show, answer, table)


Answer = tuple[Any, Callable[[], object]]


def _show(show: Show, answer: Any, table: Callable[[], object]) -> int:
    show.result(answer, table)
    return 0


def _chosen(args: argparse.Namespace) -> Callable[[argparse.Namespace, Progress], Answer]:
    ways = ("compare", "export", "person", "segmentation")
    asked = [way for way in ways if getattr(args, way)]
    if len(asked) > 1:
        raise ConfigurationError(f"--{asked[0]} and --{asked[1]} don't go together; run one")
    table = {"compare": _compare, "export": _export, "person": _person}
    table["segmentation"] = _segmentation
    return table[asked[0]] if asked else _score


@contextmanager
def _progress(as_json: bool) -> Iterator[Progress]:
    """A bar on the terminal; nothing with JSON."""
    from model.core.progress import no_progress

    if as_json:
        yield no_progress
        return
    from model.evaluation.table import progress_bar

    with progress_bar() as progress:
        yield progress


def _score(args: argparse.Namespace, progress: Progress) -> Answer:
    from model.core.progress import scaled_progress
    from model.evaluation.run import evaluate
    from model.evaluation.table import print_reports

    configs = configurations(args)
    reports: list[Report] = []
    for i, config in enumerate(configs):
        own = scaled_progress(progress, i / len(configs), (i + 1) / len(configs))
        reports.append(evaluate(config, progress=own))
    if args.out is not None:
        _write(args, configs, reports, progress)
    several = [r.to_json() for r in reports]
    answer = several[0] if len(several) == 1 else {"runs": several}
    return answer, lambda: print_reports(reports)


def _write(
    args: argparse.Namespace,
    configs: list[EvaluationConfig],
    reports: list[Report],
    progress: Progress,
) -> None:
    from model.evaluation.html_report import write_html
    from model.evaluation.markdown import write_markdown

    for config, report in zip(configs, reports, strict=True):
        assert config.out is not None
        report.write(config.out)
    write_markdown(reports, args.out / "report.md")
    progress(1.0, "drawing the worst objects")
    write_html(list(zip(configs, reports, strict=True)), args.out / "report.html", args.pictures)


def configurations(args: argparse.Namespace) -> list[EvaluationConfig]:
    """One for each predictor and each folder of predictions.

    Raises:
        ConfigurationError: for names that are there twice, or that can't be a folder.
    """
    from model.evaluation.alignment import Frame
    from model.evaluation.corruption import Corruption
    from model.evaluation.run import EvaluationConfig

    turned = args.yaw or args.scan
    if args.predictions and turned:
        raise ConfigurationError("--predictions are of whole objects; leave --scan and --yaw")
    base = EvaluationConfig(
        data=_data(args), split=args.split, names=args.names,
        corruption=Corruption(yaw=None if turned else 0.0, scan=args.scan, noise=args.noise),
        jobs=args.jobs, limit=args.limit, seed=args.seed, timeout=args.timeout,
        execute=args.execute, out=args.out,
    )  # fmt: skip
    listed = args.predictor or ("" if args.predictions else DEFAULT)
    out = [replace(base, predictor=name.strip()) for name in listed.split(",") if name.strip()]
    for given in args.predictions:
        name, separator, folder = given.partition("=")
        path = Path(folder if separator else given)
        frame = Frame() if args.frame == "as-is" else None
        label = name if separator else path.resolve().name
        out.append(replace(base, predictor=label, predictions=path, frame=frame))
    names = [c.predictor for c in out]
    twice = next((n for n in names if names.count(n) > 1), None)
    if twice is not None:
        raise ConfigurationError(f"two methods are called {twice!r}; write NAME=DIR")
    if args.out is not None and len(out) > 1:
        out = [replace(c, out=args.out / folder_name(c.predictor)) for c in out]
    return out


def folder_name(method: str) -> str:
    """A method's name as a folder's."""
    from model.io.part_folder import safe_link

    return safe_link(method)


def _data(args: argparse.Namespace) -> DatasetOptions:
    from model.data.registry import DatasetOptions

    return DatasetOptions(args.data, args.root, args.seed, args.n, tuple(args.family), args.fault)


def _export(args: argparse.Namespace, progress: Progress) -> Answer:
    import numpy as np

    from app.cli.headless import check_output
    from model.data.part_export import export_parts
    from model.data.registry import open_dataset
    from model.evaluation.run import chosen_ids

    config = configurations(args)[0]
    check_output(args.export, *([args.root] if args.root else []), option="--export")
    dataset, ids = open_dataset(config.data), chosen_ids(config)
    written, problems = [], []
    for i, object_id in enumerate(ids):
        progress(i / len(ids), f"{i} of {len(ids)} objects")
        try:
            truth = dataset.load(object_id)
            rng = np.random.default_rng([args.seed, i])
            folder = args.export / object_id
            written.append(str(export_parts(truth, folder, with_names=args.names, rng=rng).parent))
        except Exception as error:  # one bad object never ends the run
            problems.append(f"{object_id}: {error}")

    def table() -> None:
        print(f"{len(written)} objects in {args.export}")
        for problem in problems:
            print(f"left out: {problem}")

    return {"folders": written, "problems": problems}, table


def _person(args: argparse.Namespace, progress: Progress) -> Answer:
    from app.cli.annotator import AnnotatorConfig
    from app.cli.headless import write_json
    from app.cli.person_report import COLUMNS, run_person
    from model.evaluation.run import TRUTH, chosen_ids, require_predictor
    from model.evaluation.table import print_table
    from model.segmentation.registry import load_segmenter

    configs = configurations(args)
    names = tuple(c.predictor for c in configs)
    if TRUTH in names or any(c.predictions is not None for c in configs):
        raise ConfigurationError("--person needs predictors, not --predictions or truth")
    if args.points is not None and args.points < LEAST_CLOUD:
        raise ConfigurationError(f"--points must be {LEAST_CLOUD} or more, got {args.points}")
    for name in names:
        require_predictor(name, args.jobs)
    load_segmenter(args.segmenter)
    config = AnnotatorConfig(
        configs[0].data, names, segmenter=args.segmenter, names=args.names, seed=args.seed,
        timeout=max(args.timeout, 300.0), points=args.points or AnnotatorConfig.points,
    )  # fmt: skip
    report = run_person(config, chosen_ids(configs[0]), args.jobs, progress)
    if args.out is not None:
        write_json(args.out / "person.json", report.to_json())
        (args.out / "person.md").write_text(report.to_markdown(), encoding="utf-8")
    return report.to_json(), lambda: print_table("The person in the loop", COLUMNS, report.rows())


LEAST_CLOUD = 1000
SEGMENTATION_SETS = ("procedural", "procedural-noisy", "procedural-one-sided")


def _segmentation(args: argparse.Namespace, progress: Progress) -> Answer:
    from app.cli.bench_command import bench_segment
    from app.cli.headless import write_json

    sets: list[str] = list(SEGMENTATION_SETS)
    if args.root is not None:
        rooms = any(Path(args.root).glob("*_labels.npz"))
        sets += ["room"] if rooms else ["partnet", "partnet-one-sided"]
    bench = bench_segment(
        args.root, sets, [args.segmenter], progress, limit=args.limit, points=args.points
    )
    if args.out is not None:
        write_json(args.out / "segmentation.json", bench.report)
    return bench.report, bench.show


def _compare(args: argparse.Namespace, _: Progress) -> Answer:
    from app.cli.headless import write_json
    from model.evaluation.compare import compare
    from model.evaluation.report import read_report
    from model.evaluation.table import print_comparison

    made = compare(read_report(args.compare[0]), read_report(args.compare[1]), seed=args.seed)
    if args.out is not None:
        write_json(args.out / "comparison.json", made.to_json())
        (args.out / "comparison.md").write_text(made.to_markdown(), encoding="utf-8")
    return made.to_json(), lambda: print_comparison(made)
