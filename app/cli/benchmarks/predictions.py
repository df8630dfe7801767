"""Benchmarks of the method: the segmenter by simulated clicks, predicted joints on every source and
on reconstructed scans, their time, what their weights read, other methods' outputs, a gripper that
opens what is exported, and what simulators and validators accept.
"""

from __future__ import annotations

import itertools
import json
import re
import resource
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, get_args

import numpy as np
from scipy.spatial import KDTree

from app.cli.bench_commands import (
    AssetsBench,
    JointsBench,
    PredictBench,
    RivalsBench,
    RobotBench,
    ScansBench,
    SegmentBench,
    TeachBench,
)
from app.cli.benchmarks.shapes import chest
from app.cli.output import Result, check_output, each_with_progress, print_records
from model.core.articulated_object import SegmentedObject
from model.core.errors import ConfigurationError
from model.core.files import read_json
from model.core.packages import require
from model.core.progress import Progress, no_progress
from model.data.folders import urdf_files
from model.data.registry import DatasetOptions, recognised
from model.evaluation.assets import AssetsConfig, beside
from model.evaluation.assets import run as run_assets
from model.evaluation.assets import to_json as assets_json
from model.evaluation.bench import folder_runs
from model.evaluation.report import Report
from model.evaluation.rivals import compare_rivals
from model.evaluation.rivals import to_json as rivals_json
from model.evaluation.robot import RobotConfig, open_scene
from model.evaluation.robot import run as run_robot
from model.evaluation.robot import to_json as robot_json
from model.evaluation.run import EvaluationConfig, evaluate
from model.evaluation.scans import ScansConfig, table
from model.evaluation.scans import run as run_scans
from model.evaluation.segmentation import BenchConfig, DataSet
from model.evaluation.segmentation import run as run_segment
from model.evaluation.segmentation_ablation import ablate
from model.evaluation.teaching import SPLITS, TeachConfig
from model.evaluation.teaching import run as run_teach
from model.evaluation.teaching import table as teach_table
from model.prediction.arti4urdf.decoding import decode
from model.prediction.arti4urdf.predictor import Arti4UrdfPredictor, make_prompt
from model.prediction.arti4urdf.structure import read_structure
from model.prediction.builder import SWITCHES
from model.prediction.registry import DEFAULT, Predictor, load_predictor
from model.validation.engines import MUJOCO, require_engines

FOLDERS = (
    ("PartNet-Mobility", "partnet-mobility", "partnet_mobility"),
    ("Infinigen", "urdf", "infinigen"),
    ("simulators", "urdf", "simulator_objects"),
    ("ReplicaCAD", "urdf", "articulated_free/habitat"),
    ("LIBERO", "mjcf", "articulated_free/libero"),
)
"""Title, kind and folder below ``--data`` of each source; those that are absent are left out."""
FAMILIES, SEED = 6, 4242
"""Procedural objects of each held-out family, and the seed that makes them."""


def joints_bench(options: JointsBench, progress: Progress) -> Result:
    """Score joints on every source, with names and without."""
    before = {} if options.before is None else read_json(options.before)
    found = sources(options.data, SPLITS[options.half])
    left_out = ["", *(SWITCHES if "all" in options.without else options.without)]
    runs = list(itertools.product(found.items(), (True, False), left_out))
    rows = []
    for ((title, (data, split)), names, mechanism), part in each_with_progress(runs, progress):
        config = EvaluationConfig(
            data,
            split,
            predictor=f"without:{mechanism}" if mechanism else DEFAULT,
            names=names,
            jobs=options.jobs,
            limit=options.limit or None,
        )
        said = f"{title}, {'names' if names else 'no names'}"
        said += f", without {mechanism}" if mechanism else ""
        rows.append(row(said, evaluate(config, progress=part)))
    title = "Predicted joints (earlier figures in brackets)" if before else "Predicted joints"
    return Result({"table": rows}, lambda: print_records(title, beside(rows, before)))


def teach_bench(options: TeachBench, progress: Progress) -> Result:
    """Predict alone and after examples of each kind."""
    if options.data is None:
        raise ConfigurationError("--data: give a folder of objects of several kinds")
    tables: dict[str, list[dict[str, Any]]] = {}
    sets = folders_in(options.data) or {options.data.name: data_in(options.data)}
    for (title, data), part in each_with_progress(list(sets.items()), progress):
        limit = options.limit or 0
        config = TeachConfig(
            data, options.half, options.examples, limit, options.jobs, options.parts
        )
        tables[title] = teach_table(run_teach(config, part))

    def shown() -> None:
        for title, rows in tables.items():
            print_records(f"{title}: alone → after {options.examples} of a kind", rows)

    return Result(tables, shown)


def folders_in(folder: Path) -> dict[str, DatasetOptions]:
    """Title → data set of the known sources in a folder."""
    there = ((title, kind, folder / below) for title, kind, below in FOLDERS)
    return {title: DatasetOptions(kind, path) for title, kind, path in there if path.is_dir()}


def sources(folder: Path | None, split: str) -> dict[str, tuple[DatasetOptions, str]]:
    """Title → data set and split: those in a folder, and procedural held-out families.

    Raises:
        ConfigurationError: where the folder holds none.
    """
    found = {} if folder is None else {k: (d, split) for k, d in folders_in(folder).items()}
    if folder is not None and not found:
        named = ", ".join(below for *_, below in FOLDERS)
        raise ConfigurationError(f"--data {folder} holds none of {named}")
    made = DatasetOptions("procedural", seed=SEED, n=FAMILIES)
    return {**found, "procedural, held-out families": (made, "held-out")}


def row(title: str, report: Report) -> dict[str, Any]:
    """The figures of one source; shares in %."""
    values, count = report.summary.values, len(report.scores)
    shares = {
        "TC %": "tc",
        "tree %": "tree",
        "usable joints %": "usable_joints",
        "usable objects %": "usable",
    }
    return {
        "objects": title,
        "number": count,
        **{label: round(100 * values[key], 1) for label, key in shares.items()},
        "calibration error": round(report.calibration.ece, 3),
        "s an object": round(sum(report.seconds) / max(count, 1), 2),
    }


PART_COUNTS = (2, 4, 9, 16, 32)
REPEATS = 3


def predict_bench(options: PredictBench, progress: Progress) -> Result:
    """Time the predictors by number of parts."""
    report = measure(progress)
    title = "Prediction, a chest of drawers (milliseconds, medians; forward passes)"
    return Result(report, lambda: print_records(title, transposed(report["rows"])))


def measure(progress: Progress = no_progress) -> dict[str, Any]:
    """Milliseconds and forward passes by number of parts, and the process's peak memory."""
    geometric = load_predictor("geometric")
    network = load_predictor("arti4urdf")
    for predictor in (geometric, network):
        predictor.predict(chest(2))  # imports and caches
    rows: list[dict[str, Any]] = []
    for i, count in enumerate(PART_COUNTS):
        progress(i / len(PART_COUNTS), f"{count} parts")
        segmented = chest(count - 1)
        rows.append({"parts": count, **_row(segmented, geometric, network)})
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    scale = 1 if sys.platform == "darwin" else 1024
    return {"rows": rows, "peak memory MiB": round(peak * scale / 2**20)}


def transposed(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row per figure and a column per size, as there are more figures than sizes."""
    names = [name for name in rows[0] if name != "parts"]
    return [{"": name, **{f"{row['parts']} parts": row[name] for row in rows}} for name in names]


def _row(segmented: SegmentedObject, geometric: Predictor, network: Predictor) -> dict[str, Any]:
    whole = _median_ms(lambda: network.predict(segmented))
    yardstick = _median_ms(_yardstick)
    return {
        "geometry": round(_median_ms(lambda: geometric.predict(segmented)), 1),
        "Arti4URDF": round(whole, 1),
        **_decoding(segmented, network),
        "yardstick": round(yardstick, 1),
        "ratio": round(whole / yardstick, 2),
    }


def _decoding(segmented: SegmentedObject, network: Predictor) -> dict[str, Any]:
    """The network's own share, with forced spans and without."""
    predictor: Arti4UrdfPredictor = network  # type: ignore[assignment]
    prompt = make_prompt(read_structure(segmented), segmented, 0)
    spans = decode(predictor.model, prompt)
    single = decode(predictor.model, prompt, span=False)
    text = predictor.predict(segmented).raw_text
    return {
        "decode": round(_median_ms(lambda: decode(predictor.model, prompt)), 1),
        "token by token": round(_median_ms(lambda: decode(predictor.model, prompt, span=False)), 1),
        "passes": spans.passes,
        "token by token passes": single.passes,
        "text tokens": text_tokens(text),
        "fewer than compact": round(single.passes / max(1, spans.passes), 1),
        "fewer than text": round(text_tokens(text) / max(1, spans.passes), 1),
    }


def text_tokens(text: str) -> int:
    """Tokens of the answer's text in Qwen's pre-tokeniser: words, single digits, runs of signs.

    Its byte pairs may cut words further, never join them, so plain decoding takes at least these.
    """
    return len(re.findall(r" ?[A-Za-z_]+|\d| ?[^\sA-Za-z_\d]+|\s*[\r\n]+|\s+", text))


def _yardstick() -> None:
    points = np.random.default_rng(0).random((100_000, 3))
    KDTree(points).query(points[:10_000], k=8)


def _median_ms(function: Callable[[], object]) -> float:
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        function()
        times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times)


def segment_bench(options: SegmentBench, progress: Progress) -> Result:
    """Measure the segmenters by simulated clicks."""
    return bench_segment(
        options.data,
        options.sets,
        options.segmenter,
        progress,
        limit=options.limit,
        offset=options.offset,
        parts=options.parts,
        first=options.first,
        without=options.without,
    )


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
    without = settings.pop("without", None)
    config = BenchConfig(**{k: v for k, v in settings.items() if v is not None})
    if without:
        rows = ablate(config, without, progress)
        return Result(rows, lambda: print_records("Mechanisms left out, and what changes", rows))
    report = run_segment(config, progress)
    return Result(json.loads(report.to_json()), report.print_table)


def data_in(folder: Path) -> DatasetOptions:
    """The data set that a folder holds, by what lies in it."""
    if not any(folder.glob("*/mobility.urdf")) and urdf_files(folder):
        return DatasetOptions("urdf", folder)
    return DatasetOptions(recognised(folder).name, folder)


def scans_bench(options: ScansBench, progress: Progress) -> Result:
    """Measure on reconstructed scans, of each source by itself."""
    found = {"": DatasetOptions("procedural", seed=1, n=2)}
    if options.source and options.data is None:
        raise ConfigurationError("--source: give --data the folder that holds these sources")
    if options.data is not None:
        folder = options.data
        found = {name: data_in(folder / name) for name in options.source} or {"": data_in(folder)}
    limit = 15 if options.limit is None else options.limit
    rows: list[dict[str, Any]] = []
    scans: list[dict[str, Any]] = []
    for (name, data), part in each_with_progress(list(found.items()), progress):
        scores = run_scans(ScansConfig(data, options.half, limit), part)
        first = {"source": name} if name else {}
        rows += [first | row for row in table(scores)]
        scans += [first | asdict(score) for score in scores]
    short = [{k: round(v, 3) if isinstance(v, float) else v for k, v in r.items()} for r in rows]
    title = f"Reconstructed scans, half {options.half!r}"
    return Result({"table": rows, "scans": scans}, lambda: print_records(title, short))


def rivals_bench(options: RivalsBench, progress: Progress) -> Result:
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
    return Result(rivals_json(rivals), lambda: print_records(title, rows))


def robot_bench(options: RobotBench, progress: Progress) -> Result:
    """Open exports with the gripper."""
    require("mujoco", "artiworld[physics]", "bench robot")
    if options.scene is not None:
        if options.video is not None or options.data is not None:
            raise ConfigurationError("--scene takes neither --data nor --video")
        score = open_scene(options.scene, 3 if options.limit is None else options.limit, progress)
        report = robot_json([(options.scene.name, [score])])
        return Result(report, lambda: _print(report))
    if options.video is not None:
        check_output(options.video, option="--video")
    configs = folder_runs(
        RobotConfig,
        None if options.data is None else data_in(options.data),
        half=options.half,
        limit=options.limit or 0,
        jobs=options.jobs,
        pictures=options.video,
    )
    runs = [(c.label, run_robot(c, part)) for c, part in each_with_progress(configs, progress)]
    report = robot_json(runs)
    return Result(report, lambda: _print(report))


def _print(report: Mapping[str, Any]) -> None:
    rows = [{k: _text(v) for k, v in row.items()} for row in report["table"]]
    for row in rows:  # the columns of kinds name their own number of joints
        print_records(f"Joints that the gripper opened: {row.pop('objects')}", [row])
    for label, why in report["reasons"].items():
        said = ", ".join(f"{count} × {reason}" for reason, count in why.items())
        print(f"{label}: not opened: {said or 'none'}")


def _text(value: Any) -> str:
    return "–" if value is None else value if isinstance(value, str) else f"{value:.3g}"


def assets_bench(options: AssetsBench, progress: Progress) -> Result:
    """Open exports in engines and validators."""
    engines = require_engines(options.engine)
    before = {} if options.before is None else read_json(options.before)
    configs = folder_runs(
        AssetsConfig,
        None if options.data is None else DatasetOptions("partnet-mobility", options.data),
        half=options.half,
        limit=options.limit or 0,
        jobs=options.jobs,
        engines=engines,
    )
    runs = [(c, run_assets(c, part)) for c, part in each_with_progress(configs, progress)]
    report = assets_json(runs)
    title = "Accepted exports (earlier figures in brackets)" if before else "Accepted exports"
    return Result(report, lambda: print_records(title, beside(report["table"], before)))
