"""Score a predictor on a whole data set, in parallel, resumably."""

from __future__ import annotations

import json
import signal
import time
import zlib
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from model.datasets.protocol import Dataset
from model.errors import ArtiworldError, ConfigurationError, InputFileError
from model.evaluation.corruption import Corruption, corrupt
from model.evaluation.joint_metrics import ObjectScore, UsableLimits, score_object
from model.evaluation.report import Report, score_from_json, score_to_json
from model.predictor import Predictor
from model.predictors import load_predictor, predictor_names
from model.progress import Progress, no_progress

DATASETS = ("partnet-mobility",)


@dataclass(frozen=True)
class EvaluationConfig:
    """What is evaluated, and how.

    Attributes:
        root: folder of the data set.
        data: which data set it is, one of :data:`DATASETS`.
        predictor: name of the predictor.
        names: whether part names and the category are given to it.
        corruption: what is done to the objects first.
        jobs: processes.
        limit: at most this many objects, spread over the whole set; all where None.
        seed: of the predictor and the corruption.
        timeout: seconds after which one object counts as failed.
        limits: what counts as usable.
        out: folder for ``objects.jsonl`` (a line an object, so that a stopped run goes on),
            ``report.json`` and ``report.md``; nothing is written where None.
    """

    root: Path
    data: str = "partnet-mobility"
    predictor: str = "geometric"
    names: bool = True
    corruption: Corruption = field(default_factory=Corruption)
    jobs: int = 2
    limit: int | None = None
    seed: int = 0
    timeout: float = 120.0
    limits: UsableLimits = field(default_factory=UsableLimits)
    out: Path | None = None

    def key(self) -> dict[str, Any]:
        """What must agree for results of an earlier run to be used again."""
        out = asdict(self)
        for name in ("jobs", "limit", "out", "timeout"):
            del out[name]
        out["root"] = str(Path(self.root).resolve())
        return json.loads(json.dumps(out))


@dataclass(frozen=True)
class ObjectResult:
    """One object's score and what it took.

    Attributes:
        score: against the truth.
        seconds: of the prediction alone.
        parts: how many it had.
    """

    score: ObjectScore
    seconds: float
    parts: int


def open_dataset(data: str, root: Path) -> Dataset:
    """The data set called ``data`` in ``root``.

    Raises:
        ConfigurationError: for an unknown name. InputFileError: where the folder isn't there.
    """
    if data not in DATASETS:
        raise ConfigurationError(f"no data set {data!r}; there are {', '.join(DATASETS)}")
    if not Path(root).is_dir():
        raise InputFileError(root, "no such folder", f"give the folder of {data}")
    from model.datasets.partnet_mobility import PartNetMobility

    return PartNetMobility(Path(root))


def evaluate(config: EvaluationConfig, *, progress: Progress = no_progress) -> Report:
    """Predict and score every object.

    An object that fails (its files, the predictor, the time limit, a crashed process) is recorded
    as failed and the run goes on.

    Raises:
        ArtiworldError: for what is wrong with the configuration itself, before anything runs.
    """
    dataset = open_dataset(config.data, config.root)
    if config.predictor not in predictor_names():
        load_predictor(config.predictor)  # raises, naming those that are there
    ids = _spread(dataset.ids(), config.limit)
    started = time.perf_counter()
    results = _finished(config, ids)
    log = _open_log(config)
    try:
        todo = [i for i in ids if i not in results]
        for result in _run(config, todo):
            results[result.score.object_id] = result
            if log is not None:
                log.write(json.dumps(_to_json(result)) + "\n")
                log.flush()
            progress(len(results) / len(ids), f"{len(results)} of {len(ids)} objects")
    finally:
        if log is not None:
            log.close()
    ordered = [results[i] for i in ids if i in results]
    report = Report(
        dataset=config.data,
        predictor=config.predictor,
        names=config.names,
        settings=config.key(),
        scores=tuple(r.score for r in ordered),
        seconds=tuple(r.seconds for r in ordered),
        wall_seconds=time.perf_counter() - started,
    )
    if config.out is not None:
        report.write(Path(config.out))
    return report


def evaluate_object(config: EvaluationConfig, object_id: str) -> ObjectResult:
    """Predict and score one object; never raises but for a lack of memory."""
    signal_set = _start_alarm(config.timeout)
    parts, category, seconds = 0, None, 0.0
    try:
        truth = open_dataset(config.data, config.root).load(object_id)
        category, parts = truth.object.category, len(truth.object.parts)
        rng = np.random.default_rng([config.seed, zlib.crc32(object_id.encode())])
        truth = corrupt(truth, config.corruption, rng)
        start = time.perf_counter()
        prediction = _predictor(config.predictor).predict(
            truth.segmented(names=config.names), seed=config.seed
        )
        seconds = time.perf_counter() - start
        problem = "" if prediction.tree is not None else "; ".join(prediction.problems) or "no tree"
        score = score_object(truth.object, prediction.tree, limits=config.limits, problem=problem)
    # The boundary of a job: whatever one object does to the predictor, the run goes on.
    except Exception as error:
        score = _failed(config, object_id, category, f"{type(error).__name__}: {error}")
    finally:
        if signal_set:
            signal.setitimer(signal.ITIMER_REAL, 0)
    return ObjectResult(score, seconds, parts)


@lru_cache(maxsize=2)
def _predictor(name: str) -> Predictor:
    return load_predictor(name)


def _failed(
    config: EvaluationConfig, object_id: str, category: str | None, problem: str
) -> ObjectScore:
    """The score of an object without a prediction: all its joints are missing."""
    try:
        truth = open_dataset(config.data, config.root).load(object_id)
    except ArtiworldError:
        return ObjectScore(object_id, category, (), problem=problem)
    return score_object(truth.object, None, limits=config.limits, problem=problem)


class _OutOfTimeError(Exception):
    """An object took too long."""


def _start_alarm(seconds: float) -> bool:
    """Raise in this thread after ``seconds``, where the system and the thread allow it."""

    def ring(*_: object) -> None:
        raise _OutOfTimeError(f"not done after {seconds:g} s")

    try:
        signal.signal(signal.SIGALRM, ring)
        signal.setitimer(signal.ITIMER_REAL, seconds)
    except (AttributeError, ValueError):
        return False
    return True


def _run(config: EvaluationConfig, ids: list[str]) -> Iterable[ObjectResult]:
    if config.jobs <= 1 or len(ids) <= 1:
        for i in ids:
            yield evaluate_object(config, i)
        return
    waiting, suspects = list(ids), set[str]()
    while waiting:
        alone = [i for i in waiting if i in suspects]
        batch = alone[:1] or waiting
        done: set[str] = set()
        try:
            with ProcessPoolExecutor(max_workers=min(config.jobs, len(batch))) as pool:
                futures = {pool.submit(evaluate_object, config, i): i for i in batch}
                for future in as_completed(futures):
                    result = future.result()
                    done.add(futures[future])
                    yield result
        except BrokenProcessPool:
            # A process died. Those not done are tried one by one; who dies alone is at fault.
            left = [i for i in batch if i not in done]
            if len(left) == 1:
                done.add(left[0])
                yield ObjectResult(_failed(config, left[0], None, "the process died"), 0.0, 0)
            suspects.update(left)
        waiting = [i for i in waiting if i not in done]


def _spread(ids: tuple[str, ...], limit: int | None) -> list[str]:
    if limit is None or limit >= len(ids):
        return list(ids)
    if limit < 1:
        raise ConfigurationError(f"limit must be at least 1, got {limit}")
    return [ids[i] for i in np.linspace(0, len(ids) - 1, limit).round().astype(int)]


def _to_json(result: ObjectResult) -> dict[str, Any]:
    return {
        "score": score_to_json(result.score),
        "seconds": result.seconds,
        "parts": result.parts,
    }


def _finished(config: EvaluationConfig, ids: list[str]) -> dict[str, ObjectResult]:
    """Results of an earlier run with the same settings; a torn last line is left out."""
    if config.out is None:
        return {}
    path = Path(config.out) / "objects.jsonl"
    if not path.exists():
        return {}
    wanted, found = set(ids), {}
    lines = path.read_text(encoding="utf-8").splitlines()
    try:
        if not lines or json.loads(lines[0]).get("settings") != config.key():
            return {}
    except ValueError:
        return {}
    for line in lines[1:]:
        try:
            entry = json.loads(line)
        except ValueError:
            continue
        score = score_from_json(entry["score"])
        if score.object_id in wanted:
            found[score.object_id] = ObjectResult(score, entry["seconds"], entry["parts"])
    return found


def _open_log(config: EvaluationConfig) -> Any:
    if config.out is None:
        return None
    out = Path(config.out)
    out.mkdir(parents=True, exist_ok=True)
    path = out / "objects.jsonl"
    kept = _finished(config, list(open_dataset(config.data, config.root).ids()))
    lines = [json.dumps({"settings": config.key()})]
    lines += [json.dumps(_to_json(r)) for r in kept.values()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path.open("a", encoding="utf-8")
