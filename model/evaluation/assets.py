"""``artiworld bench assets``: whether simulators and validators accept what is exported.

Objects come with their true joints, with the predicted ones (names given), or are the bundled
examples. Each gets its collision shapes, is driven in the engines with them, written in every
format, and read back by all software that is installed.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from model.core.articulated_object import ArticulatedObject
from model.core.progress import Progress, no_progress
from model.data.registry import DatasetOptions, open_dataset
from model.evaluation.joint_metrics import execute
from model.evaluation.pool import OutOfTimeError, robust_map, time_limit
from model.evaluation.report import finite
from model.evaluation.scans import Half, half_of
from model.io.export.registry import EXPORTERS
from model.io.export.simready import VALIDATOR
from model.io.readback import write_and_read
from model.physics.simulation_values import physics_of
from model.prediction.registry import DEFAULT, load_predictor
from model.validation.engines import ENGINES

Joints = Literal["true", "predicted"]
SECONDS = 600.0
"""Time limit of an object's drives, and of its formats."""


@dataclass(frozen=True)
class AssetsConfig:
    """Objects, engines and formats to measure.

    Attributes:
        data: the objects. half: see :func:`~model.evaluation.scans.half_of`. limit: of them; 0 for
            all.
        joints: the true ones, or predicted ones with names given.
        engines: see :data:`~model.validation.engines.ENGINES`. formats: that are written.
        seed: random seed of the shuffle. jobs: processes.
    """

    data: DatasetOptions
    half: Half = "table"
    limit: int = 0
    joints: Joints = "true"
    engines: tuple[str, ...] = tuple(ENGINES)
    formats: tuple[str, ...] = tuple(EXPORTERS.built_in)
    seed: int = 0
    jobs: int = 2

    @property
    def label(self) -> str:
        """Label of its row."""
        return f"{self.data.name}, {self.joints} joints"


@dataclass(frozen=True)
class AssetScore:
    """Result for one object.

    Attributes:
        id: of the object.
        engines: engine → whether every joint moves there, with the exported shapes.
        readers: reader or validator → whether it found no problem, in all formats.
        links, shapes: number of links and of collision shapes.
        seconds: of shapes and masses, drives, and all formats, each by the clock.
        problems: human-readable messages.
    """

    id: str
    engines: Mapping[str, bool] = field(default_factory=dict)
    readers: Mapping[str, bool] = field(default_factory=dict)
    links: int = 0
    shapes: int = 0
    seconds: tuple[float, ...] = ()
    problems: tuple[str, ...] = ()


def run(config: AssetsConfig, progress: Progress = no_progress) -> list[AssetScore]:
    """Measure; an object whose process dies counts as refused everywhere."""
    ids = half_of(open_dataset(config.data).ids(), config.half, config.seed, config.limit)
    found: dict[str, AssetScore] = {}
    for name, score in robust_map(partial(score_object, config), ids, config.jobs):
        found[name] = score or _lost(config, name, "its process died")
        progress(len(found) / len(ids), f"{config.label}: {name}")
    return [found[i] for i in ids]


def score_object(config: AssetsConfig, name: str) -> AssetScore:
    """Judge one object; never raises but for a lack of memory."""
    try:
        with time_limit(SECONDS):
            obj = _object(config, name)
            start = time.perf_counter()
            physics = physics_of(obj)  # the drives find its shapes in the cache
            shaped = time.perf_counter()
    except (Exception, OutOfTimeError) as error:  # the boundary: any geometry may come here
        return _lost(config, name, f"{type(error).__name__}: {error}"[:300])
    driven = execute(obj, timeout=SECONDS, engines=config.engines, shapes=True)
    done = time.perf_counter()
    problems = [] if driven.executable else [driven.why]
    readers: dict[str, bool] = {}
    for format in config.formats:
        back = write_and_read(obj, physics, format)
        problems += [f"{format}: {p}" for p in back.problems]
        for reader, said in (back.found or {"export": back.problems}).items():
            readers[reader if reader == VALIDATOR else f"{reader} ({format})"] = not said
    seconds = (shaped - start, done - shaped, time.perf_counter() - done)
    return AssetScore(
        name,
        driven.engines,
        readers,
        len(obj.parts),
        sum(map(len, physics.collision.values())),
        tuple(round(s, 2) for s in seconds),
        tuple(problems),
    )


def _object(config: AssetsConfig, name: str) -> ArticulatedObject:
    truth = open_dataset(config.data).load(name)
    if config.joints == "true":
        return truth.object
    found = load_predictor(DEFAULT).predict(truth.segmented(names=True), seed=0)
    if found.tree is None:
        raise ValueError("; ".join(found.problems) or "there is no tree")
    return replace(truth.object, tree=found.tree, affordances=())


def _lost(config: AssetsConfig, name: str, why: str) -> AssetScore:
    return AssetScore(name, dict.fromkeys(config.engines, False), problems=(why,))


def row(config: AssetsConfig, scores: Sequence[AssetScore]) -> dict[str, float | str]:
    """Shares in 0..1, of all objects, or of those that a reader got."""
    out: dict[str, float | str] = {"objects": config.label, "n": len(scores)}
    for engine in config.engines:
        out[ENGINES[engine].title] = _mean([s.engines.get(engine, False) for s in scores])
    out |= {name: share for name, share in _readers(scores)}
    shaped = [s for s in scores if s.links]
    links = sum(s.links for s in shaped)
    out["shapes a link"] = sum(s.shapes for s in shaped) / links if links else float("nan")
    for k, what in enumerate(("shapes s", "drives s", "formats s")):
        out[what] = float(np.median([s.seconds[k] for s in shaped] or [float("nan")]))
    return out


def _readers(scores: Sequence[AssetScore]) -> Iterator[tuple[str, float]]:
    """NVIDIA's validator, and the share of objects that all other readers take."""
    if any(VALIDATOR in s.readers for s in scores):
        yield "Robotics-Prop", _mean([s.readers.get(VALIDATOR, False) for s in scores])
    rest = [[fine for name, fine in s.readers.items() if name != VALIDATOR] for s in scores]
    yield "other readers", _mean([bool(each) and all(each) for each in rest])


def _mean(values: Sequence[bool]) -> float:
    return float(np.mean(values)) if values else float("nan")


def to_json(runs: Sequence[tuple[AssetsConfig, Sequence[AssetScore]]]) -> dict[str, Any]:
    """The table and all scores; ``NaN`` is null."""
    scores = {c.label: [asdict(s) for s in each] for c, each in runs}
    readers = sorted({name for _, each in runs for s in each for name in s.readers})
    return {"table": finite([row(c, s) for c, s in runs]), "readers": readers, "objects": scores}


def beside(rows: Sequence[Mapping[str, Any]], before: Mapping[str, Any]) -> list[dict[str, str]]:
    """The rows as text, each figure followed by that of an earlier report in brackets."""
    old = {r["objects"]: r for r in before.get("table", ())}
    out: list[dict[str, str]] = []
    for new in rows:
        was = old.get(new["objects"], {})
        out.append(
            {
                k: _text(v) + (f" ({_text(was[k])})" if k in was and k != "objects" else "")
                for k, v in new.items()
            }
        )
    return out


def _text(value: Any) -> str:
    return "–" if value is None else value if isinstance(value, str) else f"{value:.3g}"


def folder_runs(folder: Path | None, **settings: Any) -> list[AssetsConfig]:
    """Truth and predictions of a folder of PartNet-Mobility, then of the bundled objects."""
    bundled = AssetsConfig(DatasetOptions("bundled"), **{**settings, "half": "all"})
    sets = [] if folder is None else [DatasetOptions("partnet-mobility", folder)]
    runs = [AssetsConfig(s, joints=j, **settings) for s in sets for j in ("true", "predicted")]
    return [*runs, bundled, replace(bundled, joints="predicted")]
