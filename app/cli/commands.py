"""All subcommands of ``artiworld``, with the options of those that work on people's objects."""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

from app.cli.bench_commands import BENCHES
from app.cli.options import (
    ENGINE_HELP,
    MASKS_HELP,
    SEGMENTER_HELP,
    UP_AXES,
    Command,
    Group,
    OidcOptions,
    PhysicsOptions,
    PredictorOptions,
    ReadingOptions,
    ReportCommand,
    SegmenterOptions,
    Vector,
    argument,
    database_option,
    direction,
    flag,
    group,
    measured,
    option,
    positive_count,
    positive_number,
    repeated,
    required,
    seed_option,
    workspace_option,
)
from app.cli.research_commands import EvaluateCommand, GenerateCommand, TrainCommand
from app.cli.team_commands import PROJECT, RELEASE, USERS, AuditCommand, RepeatCommand, StatsCommand
from app.server.config import TOKEN_VARIABLE
from app.server.ending import EndSignals
from model.core.packages import at_place
from model.prediction import DEFAULT as DEFAULT_PREDICTOR
from model.prediction import TOKEN_VARIABLE as BACKEND_TOKEN_VARIABLE


@dataclass(frozen=True, kw_only=True)
class ServeCommand(Command):
    """Open scans in the browser and articulate them."""

    log_level: ClassVar[int] = logging.INFO
    paths: tuple[Path, ...] = argument(
        "meshes, scans, URDFs, MJCFs, folders, or one scene (default: the bundled examples)",
        "[PATH ...]",
        (),
    )
    assets: tuple[Path, ...] = repeated(
        "open PATH as a scene with the assets in this folder (default: those beside it)", "DIR"
    )
    scene: bool = flag("open PATH as a scene though it is a mesh or a scan, such as a scanned room")
    finder: str = option(
        "finder of articulable objects in a scene, as for scene convert", "NAME", "lexicon"
    )
    finder_url: str | None = option(
        "openai finder: address of the server, such as http://localhost:11434/v1", "URL"
    )
    workspace: Path = workspace_option()
    database: str | None = database_option()
    host: str = option(
        "address to listen at; others than this machine need a token", "HOST", "127.0.0.1"
    )
    port: int | None = option(
        "port to listen at; 0 for any (default: 8080 or the next free one)", "PORT"
    )
    token: str | None = option(f"token that visitors need; or set {TOKEN_VARIABLE}", "TOKEN")
    allow_origin: tuple[str, ...] = repeated("address under which a proxy shows the server", "URL")
    trusted_proxy: tuple[str, ...] = repeated(
        "address or network of a proxy whose X-Forwarded-For names the visitor", "ADDRESS"
    )
    user: str | None = option("name written beside decisions (default: your login name)", "USER")
    reading: ReadingOptions = group(ReadingOptions)
    max_upload_mb: int = option("largest upload from a browser", "MB", 500)
    masks: Path | None = option(f"{MASKS_HELP}; of the one PATH", "FILE")
    segmentation: SegmenterOptions = group(SegmenterOptions)
    prediction: PredictorOptions = group(PredictorOptions)
    storage: str | None = option(
        "where accepted assets are kept, such as s3://bucket/prefix; or set ARTIWORLD_STORAGE "
        "(default: the workspace)",
        "URL",
    )
    oidc: OidcOptions = group(OidcOptions)
    open: bool = flag("open a browser", negatable=True)

    def run(self) -> int:
        """Serve until interrupted."""
        with EndSignals() as end:  # first: trimesh swallows the KeyboardInterrupt of its imports
            return at_place("app.cli.serve:serve")(self, end)


@dataclass(frozen=True, kw_only=True)
class PrepareCommand(ReportCommand):
    """Level, size and clean a scan."""

    place: ClassVar[str] = "app.cli.segment:prepare_scan"
    scan: Path = argument("a mesh or a point cloud, in any rotation and unit", "SCAN")
    out: Path = required("folder for the prepared object", "DIR")
    up: Vector | None = option(
        "up in the file: auto, an axis, or a direction X,Y,Z (default: auto)",
        "UP",
        parse=direction,
        tokens=UP_AXES,
    )
    height: float | None = option("metres of the object along z", "METRES", parse=positive_number)
    length: tuple[Vector, Vector, float] | None = option(
        "two places in the file and the metres between them",
        "X1,Y1,Z1,X2,Y2,Z2=METRES",
        parse=measured,
    )
    unit_scale: float = option(
        "metres per unit of the file, where neither is given", "METRES", 1.0, parse=positive_number
    )
    keep_support: bool = flag("keep what the object stands on and what stands beside it")


@dataclass(frozen=True, kw_only=True)
class SegmentCommand(ReportCommand):
    """Cut a scan into parts by clicks from a file, or by masks of another system."""

    place: ClassVar[str] = "app.cli.segment:segment"
    scan: Path = argument("a mesh, a point cloud or a folder of parts", "SCAN")
    prompts: Path | None = option("JSON file of clicks; not needed with --masks", "FILE")
    masks: Path | None = option(MASKS_HELP, "FILE")
    out: Path = required("folder for the parts", "DIR")
    segmentation: SegmenterOptions = group(SegmenterOptions)
    reading: ReadingOptions = group(ReadingOptions)


@dataclass(frozen=True, kw_only=True)
class PredictPredictorOptions(PredictorOptions):
    """As of ``serve``, which needs ``--token`` for its own visitors."""

    backend_token: str | None = option(
        f"token of the backend; or set {BACKEND_TOKEN_VARIABLE}", "TOKEN", flag="token"
    )


@dataclass(frozen=True, kw_only=True)
class PredictCommand(ReportCommand):
    """Predict the joints of a folder of parts."""

    place: ClassVar[str] = "app.cli.predict:predict"
    folder: Path = argument(
        "folder with link_0, link_1, … or an object.json; or a URDF or MJCF, or a GLB whose "
        "meshes are named after parts",
        "DIR",
    )
    out: Path = required("folder for the URDF and its meshes", "DIR")
    prediction: PredictPredictorOptions = group(PredictPredictorOptions)
    category: str | None = option("category of the object, such as cabinet", "NAME")
    collision: bool = flag("make collision shapes too, which takes seconds to a minute")
    complete: bool = flag(
        "make up what a scan doesn't show: closed surfaces, thick doors, trays of drawers, "
        "openings behind them"
    )
    seed: int = seed_option()
    reading: ReadingOptions = group(ReadingOptions)


def scene_formats(text: str) -> tuple[str, ...]:
    """Read the formats of a scene beside MJCF, which is always written."""
    names = tuple(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))
    if not set(names) <= {"mjcf", "sdf", "usd"}:
        raise ValueError
    return tuple(n for n in names if n != "mjcf")


def object_clicks(text: str) -> tuple[str, Path]:
    """Read the object and the file of ``ID=FILE``."""
    id, equals, file = text.rpartition("=")
    if not (equals and id and file):
        raise ValueError
    return id, Path(file)


def prices(text: str) -> tuple[float, float]:
    """Read the prices of a million tokens in and out."""
    into, out = (float(word) for word in text.split(","))
    if not (0 <= into < math.inf and 0 <= out < math.inf):
        raise ValueError
    return into, out


scene_formats.__name__ = "list of sdf and usd"
object_clicks.__name__ = "ID=FILE"
prices.__name__ = "pair of prices"


@dataclass(frozen=True, kw_only=True)
class SceneInspectCommand(ReportCommand):
    """List what is in a scene and what can be articulated."""

    place: ClassVar[str] = "app.cli.scene:inspect"
    scene: Path = argument("a scene: a description, or GLB, USD or PLY with its geometry", "SCENE")
    assets: tuple[Path, ...] = repeated(
        "folder of the scene's 3D assets (default: the scene's folder)", "DIR"
    )
    format: str | None = option("format of the scene (default: detected from the file)", "NAME")
    finder: str = option(
        "finder of articulable objects: lexicon, openai:MODEL (any server with OpenAI's "
        "protocol; key in OPENAI_API_KEY) or qwen3:FOLDER",
        "NAME",
        "lexicon",
    )
    finder_url: str | None = option(
        "openai: address of the server, such as http://localhost:11434/v1", "URL"
    )
    finder_batch: int = option("openai: objects per question", "N", 20, parse=positive_count)
    finder_timeout: float = option("openai: time for one answer", "SECONDS", 120.0)
    finder_cache: Path | None = option(
        "folder of cached answers (default: ~/.cache/artiworld/finder)", "DIR"
    )
    price: tuple[float, float] | None = option(
        "prices of a million tokens, for the cost", "IN,OUT", parse=prices
    )
    dry_run: bool = flag("estimate what asking would cost, and do nothing")


@dataclass(frozen=True, kw_only=True)
class SceneConvertCommand(SceneInspectCommand):
    """Articulate every object that can be, in place."""

    place: ClassVar[str] = "app.cli.scene:convert"
    out: Path = required(
        "folder for the articulated scene; a run that was killed is resumed there", "DIR"
    )
    jobs: int = option(
        "processes (default: as many as processors)",
        "N",
        os.cpu_count() or 1,
        parse=positive_count,
    )
    predictor: str = option("predictor of the joints", "NAME", DEFAULT_PREDICTOR)
    seed: int = seed_option()
    formats: Sequence[str] = option(
        "write the scene as sdf and usd too, besides MJCF", "NAME,NAME", (), parse=scene_formats
    )
    clicks: tuple[tuple[str, Path], ...] = repeated(
        "cut the object ID into parts by the clicks in FILE (as segment's --prompts, but in "
        "the scene's metres, +z up) and articulate it",
        "ID=FILE",
        parse=object_clicks,
    )
    segmenter: str = option(SEGMENTER_HELP, "NAME", "default")
    ray: str | None = option("let a Ray cluster do the work (host:port, auto, or local)", "ADDRESS")
    keep_limits: bool = flag("leave joint limits as predicted where the motion hits neighbours")
    collision: bool = flag("make collision shapes; without them every base is fixed in MJCF")
    time_limit: float = option("time for one asset", "SECONDS", 1800.0, parse=positive_number)


@dataclass(frozen=True, kw_only=True)
class BackendCommand(Command):
    """Predict for other machines over HTTP."""

    place: ClassVar[str] = "app.cli.serve:serve_backend"
    predictor: str = option("predictor of the joints", "NAME", DEFAULT_PREDICTOR)
    host: str = option(
        "address to listen at; others than this machine need a token", "HOST", "127.0.0.1"
    )
    port: int = option("port to listen at; 0 for any", "PORT", 8090)
    token: str | None = option(f"token that clients need; or set {BACKEND_TOKEN_VARIABLE}", "TOKEN")
    workers: int = option("objects predicted at the same time", "N", 1, parse=positive_count)
    waiting: int = option(
        "requests under way before more are refused", "N", 16, parse=positive_count
    )
    max_request_mb: int = option(
        "largest object that a client may send", "MB", 200, parse=positive_count
    )


@dataclass(frozen=True, kw_only=True)
class ExportCommand(ReportCommand):
    """Write articulated objects for simulators."""

    place: ClassVar[str] = "app.cli.export:export"
    assets: tuple[Path, ...] = argument(
        "asset folders, URDF and MJCF files, or folders of assets", "ASSET [ASSET ...]"
    )
    format: tuple[str, ...] = repeated(
        "urdf, ros, mjcf, usd, sdf, glb, or all (required)", "NAME,NAME"
    )
    out: Path = required(
        "folder for the files; several assets, and several formats of each, get folders in it",
        "DIR",
    )
    physics: PhysicsOptions = group(PhysicsOptions)
    check: bool = flag("read each file back and compare link poses")
    complete: bool | None = flag(
        "complete scanned parts as of predict, or take away what was made up "
        "(default: as they were saved)",
        None,
        negatable=True,
    )
    profile: Literal["robotics-prop"] | None = option(
        "with usd: a SimReady package of this profile, with thumbnail and metadata"
    )
    author: str = option(
        "author or organisation, for the package (default: the workspace's last one)", "NAME", ""
    )
    license: str = option(
        "licence of the asset, for the package, such as CC-BY-4.0 (default: the last one)",
        "NAME",
        "",
    )
    qcode: str | None = option("its Wikidata item, for the package (default: by category)", "QCODE")
    jobs: int | None = option("processes for several assets (default: as many as processors)", "N")


@dataclass(frozen=True, kw_only=True)
class CheckCommand(ReportCommand):
    """Check whether articulated objects work in simulators."""

    place: ClassVar[str] = "app.cli.check:check"
    assets: tuple[Path, ...] = argument(
        "asset folders, URDF and MJCF files, or folders of assets", "ASSET [ASSET ...]"
    )
    format: tuple[str, ...] = repeated("formats to write and read back (default: all)", "NAME,NAME")
    gate: bool = flag("sweep every joint, and drive it in --engine", default=True)
    engine: str = option(ENGINE_HELP, "NAME,NAME", "mujoco")
    allow_broken: bool = flag(
        "exit with 0 where everything can be read back, whatever validation finds"
    )
    compare_coacd: float = option(
        "also run coacd, at most this long per asset (default: not)", "SECONDS", 0.0
    )
    physics: PhysicsOptions = group(PhysicsOptions)
    jobs: int | None = option("processes (default: as many as processors)", "N")


@dataclass(frozen=True, kw_only=True)
class DoctorCommand(ReportCommand):
    """Say what is installed, usable and wrong."""

    place: ClassVar[str] = "app.cli.doctor:doctor"
    workspace: Path = workspace_option()
    database: str | None = database_option()
    port: int = option("port that serve would listen at", "PORT", 8080)


COMMANDS: dict[str, type[Command] | Group] = {
    "serve": ServeCommand,
    "prepare": PrepareCommand,
    "segment": SegmentCommand,
    "predict": PredictCommand,
    "scene": Group(
        "Articulate a whole scene, its objects in place.",
        {"convert": SceneConvertCommand, "inspect": SceneInspectCommand},
    ),
    "backend": BackendCommand,
    "export": ExportCommand,
    "check": CheckCommand,
    "evaluate": EvaluateCommand,
    "generate": GenerateCommand,
    "train": TrainCommand,
    "bench": Group("Measure speed and accuracy.", BENCHES),
    "project": PROJECT,
    "stats": StatsCommand,
    "repeat": RepeatCommand,
    "release": RELEASE,
    "user": USERS,
    "audit": AuditCommand,
    "doctor": DoctorCommand,
}
"""Name → subcommand or group of them, in the order of the help page."""
