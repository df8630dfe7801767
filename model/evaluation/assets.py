"""``artiworld bench assets``: whether simulators and validators accept what is exported.

Objects come with their true joints, with the predicted ones (names given), or are the bundled
examples. Each gets its collision shapes, is driven in the engines with them, written in every
format, and read back by all software that is installed.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any

import numpy as np

from model.core.pool import OutOfTimeError, time_limit
from model.core.progress import Progress, no_progress
from model.core.tables import finite, mean
from model.evaluation.bench import SECONDS, ObjectBench
from model.evaluation.joint_metrics import execute
from model.io.export.registry import EXPORTERS
from model.io.export.simready import VALIDATOR
from model.io.readback import write_and_read
from model.physics.simulation_values import physics_of
from model.validation.engines import ENGINES


@dataclass(frozen=True)
class AssetsConfig(ObjectBench):
    """Objects, engines and formats to measure.

    Attributes:
        engines: see :data:`~model.validation.engines.ENGINES`. formats: that are written.
    """

    engines: tuple[str, ...] = tuple(ENGINES)
    formats: tuple[str, ...] = tuple(EXPORTERS.built_in)


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
    return config.scores(partial(score_object, config), partial(_lost, config), progress)


def score_object(config: AssetsConfig, name: str) -> AssetScore:
    """Judge one object; never raises but for a lack of memory."""
    try:
        with time_limit(SECONDS):
            obj = config.object(name)
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


def _lost(config: AssetsConfig, name: str, why: str) -> AssetScore:
    return AssetScore(name, dict.fromkeys(config.engines, False), problems=(why,))


def row(config: AssetsConfig, scores: Sequence[AssetScore]) -> dict[str, float | str]:
    """Shares in 0..1, of all objects, or of those that a reader got."""
    out: dict[str, float | str] = {"objects": config.label, "n": len(scores)}
    for engine in config.engines:
        out[ENGINES[engine].title] = mean([s.engines.get(engine, False) for s in scores])
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
        yield "Robotics-Prop", mean([s.readers.get(VALIDATOR, False) for s in scores])
    rest = [[fine for name, fine in s.readers.items() if name != VALIDATOR] for s in scores]
    yield "other readers", mean([bool(each) and all(each) for each in rest])


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
