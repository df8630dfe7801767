"""Subcommands of ``artiworld bench``, each with its own options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

from app.cli.options import (
    ENGINE_HELP,
    SEGMENTER_HELP,
    Command,
    ReportCommand,
    count,
    flag,
    option,
    positive_count,
    repeated,
)

Half = Literal["choose", "table", "all"]


@dataclass(frozen=True, kw_only=True)
class LimitedBench(ReportCommand):
    """A benchmark on some objects of each set."""

    limit: int | None = option("objects of each set; 0 for all", "LIMIT")


@dataclass(frozen=True, kw_only=True)
class DataBench(LimitedBench):
    """A benchmark on real data."""

    data: Path | None = option("folder of real data (default: procedural objects)", "DIR")
    half: Half = option("half of the objects, to choose with or for the table", default="table")


@dataclass(frozen=True, kw_only=True)
class ProcessesBench(DataBench):
    """A benchmark in several processes."""

    jobs: int = option("processes", "N", 2, parse=positive_count)


@dataclass(frozen=True, kw_only=True)
class UiBench(ReportCommand):
    """The screen of one object: a person's waiting times on the server."""

    place: ClassVar[str] = "app.cli.benchmarks.ui:ui_bench"
    points: tuple[int, ...] = option(
        "sizes of the clouds", "N...", (100_000, 1_000_000), parse=count
    )
    faces: int = option("size of the mesh; 0 leaves it out", "N", 1_000_000, parse=count)
    clicks: int = option("clicks on each object", "N", 40, parse=count)
    segmenter: str = option(SEGMENTER_HELP, "NAME", "default")


@dataclass(frozen=True, kw_only=True)
class SceneBench(ReportCommand):
    """The screen of a scene: the time until it appears."""

    place: ClassVar[str] = "app.cli.benchmarks.load:scene_bench"
    objects: int = option("number of objects", "N", 200, parse=count)


@dataclass(frozen=True, kw_only=True)
class SegmentBench(LimitedBench):
    """The segmenter, by simulated clicks."""

    place: ClassVar[str] = "app.cli.benchmarks.predictions:segment_bench"
    data: Path | None = option("folder of real data (default: procedural objects)", "DIR")
    sets: tuple[str, ...] = option(
        "data sets, e.g. partnet-mesh, or urdf-scan for your own URDFs", "NAME...", ()
    )
    segmenter: tuple[str, ...] = repeated("segmenter that turns clicks into parts", "NAME")
    offset: int | None = option("object at which the subset begins", "N")
    parts: int | None = option("most parts of an object", "N", parse=count)
    first: Literal["deepest", "random"] | None = option("place of the first click")
    without: tuple[str, ...] = option(
        "leave out each of these mechanisms by itself, or all in turn", "NAME...", ()
    )


@dataclass(frozen=True, kw_only=True)
class ScansBench(DataBench):
    """Reconstructed scans from file to joints."""

    place: ClassVar[str] = "app.cli.benchmarks.predictions:scans_bench"
    source: tuple[str, ...] = option(
        "folders of --data to measure one by one, e.g. partnet_mobility infinigen", "NAME...", ()
    )


@dataclass(frozen=True, kw_only=True)
class AnnotateBench(DataBench):
    """Raw scans from file to accepted asset: what a person waits for."""

    place: ClassVar[str] = "app.cli.benchmarks.annotate:annotate_bench"
    points: int = option("points of a scan", "N", 220_000, parse=positive_count)
    before: Path | None = option("also with the code of this earlier checkout", "DIR")


@dataclass(frozen=True, kw_only=True)
class JointsBench(ProcessesBench):
    """Predicted joints on every source, with names and without."""

    place: ClassVar[str] = "app.cli.benchmarks.predictions:joints_bench"
    before: Path | None = option("--json of an earlier run, shown beside", "FILE")
    without: tuple[str, ...] = option(
        "also without these mechanisms of the prediction, or without each (all)", "NAME...", ()
    )


@dataclass(frozen=True, kw_only=True)
class TeachBench(ProcessesBench):
    """Joints after a few objects of each kind were accepted."""

    place: ClassVar[str] = "app.cli.benchmarks.predictions:teach_bench"
    examples: int = option("accepted objects of each kind", "K", 3, parse=positive_count)
    parts: Literal["truth", "clicks", "all"] = option(
        "parts of the others: true, by clicks, or by All parts", default="truth"
    )


@dataclass(frozen=True, kw_only=True)
class PredictBench(ReportCommand):
    """The time that the predictor takes."""

    place: ClassVar[str] = "app.cli.benchmarks.predictions:predict_bench"


@dataclass(frozen=True, kw_only=True)
class NetworksBench(ReportCommand):
    """The paper-size networks with random weights."""

    place: ClassVar[str] = "app.cli.benchmarks.networks:networks_bench"
    sizes: tuple[str, ...] = option("language models (0.6b 1.7b 4b 8b)", "NAME...", ())
    train: bool = flag("train without a GPU, too (minutes a step)")

    def run(self) -> int:
        """Check the extras before the benchmark imports them."""
        from model.training.arti4urdf.config import LORA_RANK, FullConfig, require_extras

        require_extras(FullConfig(lora_rank=LORA_RANK))
        return super().run()


@dataclass(frozen=True, kw_only=True)
class RivalsBench(LimitedBench):
    """Other methods' URDFs beside ours."""

    place: ClassVar[str] = "app.cli.benchmarks.predictions:rivals_bench"
    root: Path | None = option(
        "folder with a folder of URDFs a method; the page is written there (required)", "DIR"
    )
    data: Path | None = option("folder of real data (default: procedural objects)", "DIR")
    jobs: int = option("processes", "N", 2, parse=positive_count)


@dataclass(frozen=True, kw_only=True)
class FaultsBench(ReportCommand):
    """Damaged files of every format, and servers that are killed."""

    place: ClassVar[str] = "app.cli.benchmarks.faults:faults_bench"
    limit: int = option("files in all", "LIMIT", 2000)
    seed: int = option("seed of the first file; each has the next one", "SEED", 0)
    kills: int = option("also kill a server at so many moments", "N", 0)
    clients: int = option(
        "also let six people click for so long while one opens the worst files", "SECONDS", 0
    )


@dataclass(frozen=True, kw_only=True)
class AssetsBench(ProcessesBench):
    """Exports in engines and validators."""

    place: ClassVar[str] = "app.cli.benchmarks.predictions:assets_bench"
    engine: str = option(ENGINE_HELP, "NAME,NAME", "mujoco,sapien")
    before: Path | None = option("--json of an earlier run, shown beside", "FILE")


@dataclass(frozen=True, kw_only=True)
class RobotBench(ProcessesBench):
    """A gripper that opens exports, of the bundled objects too."""

    place: ClassVar[str] = "app.cli.benchmarks.predictions:robot_bench"
    scene: Path | None = option(
        "open joints of this scene in MJCF instead, as scene convert writes it; --limit counts "
        "joints (default: 3)",
        "FILE",
    )
    video: Path | None = option("write a GIF of each object here", "DIR")


@dataclass(frozen=True, kw_only=True)
class TeamBench(ReportCommand):
    """People who work at once through the REST API."""

    place: ClassVar[str] = "app.cli.benchmarks.load:team_bench"
    people: int = option("people, each with a scan", "N", 20, parse=positive_count)
    seconds: int = option("how long they work", "N", 120, parse=positive_count)
    seed: int = option("seed of their clicks", "SEED", 0)
    database: str | None = option("URL of an empty database (default: SQLite)", "URL")


BENCHES: dict[str, type[Command]] = {
    "ui": UiBench,
    "scene": SceneBench,
    "segment": SegmentBench,
    "scans": ScansBench,
    "annotate": AnnotateBench,
    "joints": JointsBench,
    "teach": TeachBench,
    "predict": PredictBench,
    "networks": NetworksBench,
    "rivals": RivalsBench,
    "faults": FaultsBench,
    "assets": AssetsBench,
    "robot": RobotBench,
    "team": TeamBench,
}
"""Benchmark → its options, in the order of the help page."""
