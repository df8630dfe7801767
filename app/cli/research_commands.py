"""Subcommands of ``artiworld`` that generate, train and measure, with their options.

Each ``run`` imports the module that does the work, which may be heavy; nothing else here does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from app.cli.options import (
    ENGINE_HELP,
    Command,
    argument,
    count,
    flag,
    group,
    json_flag,
    option,
    positive_count,
    repeated,
    required,
    seed_option,
)
from model.core.packages import at_place
from model.prediction import DEFAULT as DEFAULT_PREDICTOR


@dataclass(frozen=True, kw_only=True)
class EvaluateCommand(Command):
    """Score a predictor on a data set."""

    data: str = option(
        "partnet-mobility, physxnet, urdf, mjcf, procedural or bundled", "NAME", "partnet-mobility"
    )
    root: Path | None = option("folder of the data set", "DIR")
    split: str = option(
        "all, held-out (the paper's five categories), known, train[:SHARE], test[:SHARE] or "
        "category:NAME,NAME",
        "WHICH",
        "all",
    )
    n: int = option("procedural without --root: objects per family", "N", 1)
    family: tuple[str, ...] = option("procedural without --root: families", "NAME", (), nargs="+")
    fault: str = option(
        "procedural without --root: fault of the input: clouds, noise, heavy-noise, outliers, "
        "one-sided, split, merge, bleed, turned or mixed (default: clean meshes)",
        "NAME",
        "",
    )
    predictor: str | None = option(
        f"predictors of the joints (default: {DEFAULT_PREDICTOR}); truth gives the ground truth",
        "NAME,NAME",
    )
    predictions: tuple[str, ...] = repeated("score the URDFs in this folder instead", "[NAME=]DIR")
    frame: Literal["auto", "as-is"] = option(
        "of --predictions: find turn and scale, or take the files as they are", None, "auto"
    )
    names: bool = flag("give part names and category to the predictor", default=True)
    scan: bool = flag("one-sided noisy clouds, turned at random")
    yaw: bool = flag("turn each object at random")
    noise: float = option("noise of --scan, in diagonals", "NOISE", 0.003)
    execute: bool = flag("also drive every joint of the predictions, in --engine too")
    engine: str = option(ENGINE_HELP, "NAME,NAME", "mujoco")
    jobs: int = option("processes", "JOBS", 2)
    timeout: float = option("an object that takes longer counts as failed", "SECONDS", 120.0)
    limit: int | None = option("at most this many objects", "LIMIT")
    seed: int = seed_option("seed of predictors, splits and procedural objects")
    out: Path | None = option("folder for the reports; a stopped run is resumed there", "DIR")
    pictures: int = option("worst objects to draw in the page of --out", "N", 10)
    person: bool = flag("instead, let a simulated annotator click, predict and correct")
    segmentation: bool = flag(
        "instead, simulated clicks: IoU@k and NoC on simulated scans, and on --root's: objects "
        "of partnet-mobility, or rooms as <name>.ply with <name>_labels.npz"
    )
    segmenter: str = option(
        "of --person and --segmentation: segmenter (default: ArtiWorld's own)", "NAME", "default"
    )
    points: int | None = option(
        "of --person and --segmentation: points per cloud (default: 30000 and 100000)", "N"
    )
    export: Path | None = option(
        "write the objects as folders for artiworld predict, and stop", "DIR"
    )
    compare: tuple[Path, Path] | None = option(
        "differences between the --out of two runs, and stop", ("A", "B")
    )
    json: bool = json_flag()

    def run(self) -> int:
        """Score, or what is asked for instead, and print the table."""
        return at_place("app.cli.evaluate:evaluate")(self)


@dataclass(frozen=True, kw_only=True)
class GenerateCommand(Command):
    """Make articulated objects with ground truth."""

    family: tuple[str, ...] = option(
        "categories of PartNet-Mobility, Composite, or all", "NAME", ("all",), nargs="+"
    )
    n: int = option("objects per family", "N", 1, parse=count)
    seed: int = option("the same seed gives the same objects", "SEED", 0)
    out: Path = required("folder that gets one folder per object", "DIR")
    json: bool = json_flag()

    def run(self) -> int:
        """Write the objects."""
        from app.cli import output
        from app.cli.output import check_output
        from model.data.procedural.generate import GenerateSettings, generate

        check_output(self.out)
        with output.session(self.json) as show:
            settings = GenerateSettings(self.out, self.family, self.n, self.seed)
            folders = generate(settings, show.progress)
        show.result(
            {"folders": [str(f) for f in folders]},
            lambda: print(f"{len(folders)} objects in {self.out}"),
        )
        return 0


@dataclass(frozen=True, kw_only=True)
class FullModelOptions:
    """Options of the paper-size model."""

    language_model: Path | None = option("folder of Qwen3 as published", "DIR")
    point_encoder: Path | None = option("ULIP-2 checkpoint with Point-BERT", "FILE")
    lora: bool = flag("train updates of rank 16 at a rate of 1e-4 instead of all weights")
    cache: Path | None = option(
        "cache generated and read objects here (default: generate and read them each time)", "DIR"
    )
    settings: tuple[str, ...] = repeated(
        "change a setting, as in --set epochs=5", "NAME=VALUE", flag="--set"
    )


@dataclass(frozen=True, kw_only=True)
class TrainCommand(Command):
    """Train Arti4URDF on procedural objects or your own, or learn from accepted objects."""

    preset: str = option(
        "configuration: nano, or of the paper-size model qwen3-0.6b, qwen3-1.7b, qwen3-4b, paper "
        "(Qwen3-8B), qwen3 (any size); confidence fits the predictors' confidence",
        "NAME",
        "nano",
    )
    out: Path = option("folder of the run; run again to resume", "DIR", Path("training"))
    workspace: Path | None = option(
        "learn from this workspace's accepted objects instead; its predictions use what they "
        "say where that helps",
        "DIR",
    )
    without: tuple[str, ...] = repeated("--workspace: object to learn nothing from", "NAME")
    use: int | None = option(
        "--workspace: go back to a version that was learned earlier; 0 for none",
        "VERSION",
        parse=count,
    )
    database: str | None = option(
        "--workspace: its SQLite or PostgreSQL database (default: one in the workspace)", "URL"
    )
    json: bool = json_flag()
    samples: int = option("procedural objects to train on, made where missing", "N", 8000)
    data: tuple[Path, ...] = repeated(
        "folder of PartNet-Mobility or PhysXNet to train on as well", "DIR"
    )
    all_categories: bool = flag("train on the paper's five held-out categories too")
    test_share: float = option(
        "leave out what evaluate --split test:S scores of each --data", "S", 0.0
    )
    steps: int | None = option("length of the schedule", "N")
    seed: int = option("seed of weights, samples and their order", "SEED", 0)
    minutes: float = option(
        "stop after this long and keep the state (default: no limit)", "M", math.inf
    )
    jobs: int = option("processes that make samples (default: all cores)", "N", 0)
    weights: Path | None = option("write the weights here at the end, ready for use", "DIR")
    version_name: str = option("recorded with the small model's weights", "TEXT", "")
    full_model: FullModelOptions = group(FullModelOptions, "paper-size model")

    def run(self) -> int:
        """Make missing samples, train, and write weights."""
        return at_place("app.cli.train:train")(self)


_BENCHES = {
    "segment": "predictions",
    "scans": "predictions",
    "joints": "predictions",
    "predict": "predictions",
    "weights": "predictions",
    "rivals": "predictions",
    "assets": "predictions",
    "robot": "predictions",
    "scene": "load",
    "team": "load",
    "ui": "ui",
    "networks": "networks",
    "faults": "faults",
}
"""Benchmark → file of :mod:`app.cli.benchmarks`."""


@dataclass(frozen=True, kw_only=True)
class BenchCommand(Command):
    """Measure speed and accuracy."""

    what: Literal[
        "ui", "scene", "segment", "scans", "joints", "predict", "weights", "networks", "rivals",
        "faults", "assets", "robot", "team",
    ] = argument(
        "the screen of one object, of a scene; the segmenter; reconstructed scans from file to "
        "joints; joints on every source; the predictor's time; what its weights read; the "
        "paper-size networks with random weights; other methods' URDFs beside ours; damaged files "
        "of every format; exports in engines and validators; a gripper that opens exports; people "
        "who work at once through the REST API", None,
    )  # fmt: skip
    data: Path | None = option(
        "segment, scans, joints, rivals: folder of real data, by default procedural; assets: of "
        "PartNet-Mobility; robot: of PartNet-Mobility or URDFs, beside the bundled objects",
        "DIR",
    )
    root: Path | None = option(
        "rivals: folder with a folder of URDFs a method; the page is written there", "DIR"
    )
    jobs: int = option("joints, rivals, assets, robot: processes", "N", 2, parse=positive_count)
    sets: tuple[str, ...] | None = option(
        "segment: data sets, e.g. partnet-mesh, or urdf-scan for your own URDFs", "NAME", nargs="+"
    )
    segmenter: tuple[str, ...] | None = repeated(
        "segment, ui: segmenter that turns clicks into parts", "NAME", None
    )
    points: tuple[int, ...] = option(
        "ui: sizes of the clouds", "N", (100_000, 1_000_000), nargs="+", parse=count
    )
    faces: int = option("ui: size of the mesh; 0 leaves it out", "N", 1_000_000, parse=count)
    clicks: int = option("ui: clicks on each object", "N", 40, parse=count)
    objects: int = option("scene: number of objects", "N", 200, parse=count)
    limit: int | None = option(
        "segment, scans, joints, weights, rivals, assets, robot: objects of each set; 0 for all; "
        "faults: files in all; robot with --scene: joints (3)",
        "LIMIT",
    )
    seed: int = option("faults: seed of the first file; each has the next one", "SEED", 0)
    kills: int = option("faults: also kill a server at so many moments", "N", 0)
    clients: int = option(
        "faults: also let six people click for so long while one opens the worst files",
        "SECONDS",
        0,
    )
    people: int = option("team: people, each with a scan", "N", 20, parse=positive_count)
    seconds: int = option("team: how long they work", "N", 120, parse=positive_count)
    database: str | None = option("team: URL of an empty database (default: SQLite)", "URL")
    offset: int | None = option("segment: object at which the subset begins", "N")
    parts: int | None = option("segment: most parts of an object", "N", parse=count)
    first: Literal["deepest", "random"] | None = option("segment: place of the first click")
    without: tuple[str, ...] | None = option(
        "segment: leave out each of these mechanisms by itself, or all in turn", "NAME", nargs="+"
    )
    half: Literal["choose", "table", "all"] | None = option(
        "scans, joints, assets, robot: half of the objects, to choose with or for the table "
        "(default: table)"
    )
    engine: str = option(f"assets: {ENGINE_HELP}", "NAME,NAME", "mujoco,sapien")
    before: Path | None = option("assets, joints: --json of an earlier run, shown beside", "FILE")
    scene: Path | None = option(
        "robot: open joints of this scene in MJCF instead, as scene convert writes it", "FILE"
    )
    video: Path | None = option("robot: write a GIF of each object here", "DIR")
    sizes: tuple[str, ...] | None = option(
        "networks: language models (0.6b 1.7b 4b 8b)", "NAME", nargs="+"
    )
    train: bool | None = flag("networks: train without a GPU, too (minutes a step)", default=None)
    json: bool = json_flag()

    def run(self) -> int:
        """Measure, and print the figures. Each benchmark has heavy packages of its own."""
        from app.cli import output

        if self.what == "networks":
            from model.training.arti4urdf.config import LORA_RANK, FullConfig, require_extras

            require_extras(FullConfig(lora_rank=LORA_RANK))
        bench = at_place(f"app.cli.benchmarks.{_BENCHES[self.what]}:{self.what}_bench")
        with output.session(self.json) as show:
            report, table = bench(self, show.progress)
        show.result(report, table)
        return int(isinstance(report, dict) and bool(report.get("failed")))
