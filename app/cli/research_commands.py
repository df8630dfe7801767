"""Subcommands of ``artiworld`` that evaluate, generate and train, with their options."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

from app.cli.options import (
    ENGINE_HELP,
    Options,
    ReportCommand,
    count,
    flag,
    group,
    option,
    positive_count,
    positive_number,
    repeated,
    required,
    seed_option,
)
from model.prediction import DEFAULT as DEFAULT_PREDICTOR


@dataclass(frozen=True, kw_only=True)
class EvaluateCommand(ReportCommand):
    """Score a predictor on a data set."""

    place: ClassVar[str] = "app.cli.evaluate:evaluate"
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
    family: tuple[str, ...] = option("procedural without --root: families", "NAME...", ())
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
        "differences between the --out of two runs, and stop", "A B"
    )


@dataclass(frozen=True, kw_only=True)
class GenerateCommand(ReportCommand):
    """Make articulated objects with ground truth."""

    place: ClassVar[str] = "app.cli.train:generate_objects"
    family: tuple[str, ...] = option(
        "categories of PartNet-Mobility, Composite, or all", "NAME...", ("all",)
    )
    n: int = option("objects per family", "N", 1, parse=count)
    seed: int = option("the same seed gives the same objects", "SEED", 0)
    out: Path = required("folder that gets one folder per object", "DIR")


@dataclass(frozen=True, kw_only=True)
class FullModelOptions(Options):
    """Options of the paper-size model."""

    language_model: Path | None = option("folder of Qwen3 as published", "DIR")
    point_encoder: Path | None = option("ULIP-2 checkpoint with Point-BERT", "FILE")
    lora: bool = flag("train updates of rank 16 at a rate of 1e-4 instead of all weights")
    cache: Path | None = option(
        "cache generated and read objects here (default: generate and read them each time)", "DIR"
    )
    settings: tuple[str, ...] = repeated(
        "change a setting, as in --set epochs=5", "NAME=VALUE", flag="set"
    )


@dataclass(frozen=True, kw_only=True)
class TrainCommand(ReportCommand):
    """Train Arti4URDF on procedural objects or your own, or learn from accepted objects."""

    place: ClassVar[str] = "app.cli.train:train"
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
    samples: int = option(
        "procedural objects to train on, made where missing", "N", 8000, parse=positive_count
    )
    data: tuple[Path, ...] = repeated(
        "folder of PartNet-Mobility or PhysXNet to train on as well", "DIR"
    )
    all_categories: bool = flag("train on the paper's five held-out categories too")
    test_share: float = option(
        "leave out what evaluate --split test:S scores of each --data", "S", 0.0
    )
    steps: int | None = option("length of the schedule", "N", parse=positive_count)
    seed: int = option("seed of weights, samples and their order", "SEED", 0)
    minutes: float = option(
        "stop after this long and keep the state (default: no limit)",
        "M",
        math.inf,
        parse=positive_number,
    )
    jobs: int = option("processes that make samples (default: all cores)", "N", 0, parse=count)
    weights: Path | None = option("write the weights here at the end, ready for use", "DIR")
    version_name: str = option("recorded with the small model's weights", "TEXT", "")
    full_model: FullModelOptions = group(FullModelOptions)
