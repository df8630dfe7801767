"""Score a predictor, or a folder of predictions, on a whole data set, in parallel, resumably.

Objects may be corrupted before: simulated scans, rotated, one-sided, noisy clouds.
"""

from __future__ import annotations

import json
import math
import time
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject, Part, Prediction
from model.core.errors import ArtiworldError, ConfigurationError, InputFileError
from model.core.geometry import PointCloud, about, affine
from model.core.pool import robust_map, time_limit
from model.core.progress import Progress, no_progress
from model.data.registry import Dataset, DatasetOptions, GroundTruth, open_dataset, select
from model.evaluation.joint_metrics import ObjectScore, UsableLimits, execute, score_object
from model.evaluation.predictions import (
    LONGEST_EDGE,
    Frame,
    FrameCosts,
    PredictionFolder,
    choose_frame,
    frame_costs,
    longest_edge,
    outlines,
    resolve,
)
from model.evaluation.report import Report, score_from_json, score_to_json
from model.geometry.sampling import sample_surface
from model.prediction.registry import DEFAULT, Predictor, load_predictor, predictor_names
from model.validation.engines import MUJOCO, require_engines

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Corruption:
    """Changes of an object before it is predicted.

    Attributes:
        yaw: rotation about +z (rad); None draws one for each object.
        scan: replace the meshes by a cloud scanned from one side.
        view: azimuth of the scanner (rad, from +x), before the rotation; PartNet-Mobility's objects
            face -x, which is pi.
        elevation: of the scanner (rad).
        noise: standard deviation over the object's diagonal.
        points: of the whole cloud.
    """

    yaw: float | None = 0.0
    scan: bool = False
    view: float = math.pi - 0.5
    elevation: float = 0.45
    noise: float = 0.003
    points: int = 20000


def corrupt(truth: GroundTruth, how: Corruption, rng: np.random.Generator) -> GroundTruth:
    """Corrupt an object; its joints are rotated, too."""
    out = _scanned(truth, how, rng) if how.scan else truth
    yaw = float(rng.uniform(-math.pi, math.pi)) if how.yaw is None else how.yaw
    return replace(out, object=out.object.moved(affine(about(2, yaw)))) if yaw else out


def _scanned(truth: GroundTruth, how: Corruption, rng: np.random.Generator) -> GroundTruth:
    """Clouds of the visible points; a hidden part keeps a few of its points."""
    parts = truth.object.parts
    low, high = truth.object.bounds
    diagonal = float(np.linalg.norm(high - low)) or 1.0
    dense: list[Array] = []
    for p in parts:
        assert p.mesh is not None
        extent = np.ptp(p.bounds, axis=0)
        share = float(np.linalg.norm(extent)) / diagonal
        count = int(np.clip(6 * how.points * share**1.5, 600, 6 * how.points))
        dense.append(sample_surface(p.mesh, count, rng)[0].points.astype(np.float64))
    in_view = visible(np.concatenate(dense), (low + high) / 2, diagonal, how.view, how.elevation)
    split = np.split(in_view, np.cumsum([len(d) for d in dense])[:-1])
    keep = min(1.0, how.points / max(1, int(in_view.sum())))
    out = []
    for p, points, mask in zip(parts, dense, split, strict=True):
        shown = points[mask]
        shown = shown[rng.random(len(shown)) < max(keep, min(1.0, 120 / max(1, len(shown))))]
        if len(shown) < 12:
            shown = points[rng.choice(len(points), 12)]
        shown = shown + rng.normal(0.0, how.noise * diagonal, shown.shape)
        out.append(Part(p.link, cloud=PointCloud(shown.astype(np.float32)), name=p.name))
    return replace(truth, object=replace(truth.object, parts=tuple(out)))


def visible(
    points: Array, center: Array, diagonal: float, azimuth: float, elevation: float
) -> npt.NDArray[np.bool_]:
    """(N,) points visible to a distant camera, by a coarse depth image."""
    ca, sa = math.cos(azimuth), math.sin(azimuth)
    ce, se = math.cos(elevation), math.sin(elevation)
    toward = np.array([ca * ce, sa * ce, se])
    right = np.array([-sa, ca, 0.0])
    up = np.cross(toward, right)
    local = (points - center) / diagonal
    cell = 1.0 / 160
    u = np.floor((local @ right + 0.6) / cell).astype(np.int64)
    v = np.floor((local @ up + 0.6) / cell).astype(np.int64)
    depth = local @ toward
    pixel = u * 4096 + v
    order = np.argsort(pixel, kind="stable")
    _, start = np.unique(pixel[order], return_index=True)
    nearest = np.maximum.reduceat(depth[order], start)
    of_point = np.empty(len(points), np.int64)
    of_point[order] = np.repeat(np.arange(len(start)), np.diff(np.append(start, len(points))))
    return depth >= nearest[of_point] - 1.5 * cell


FRAME_SAMPLE = 24
"""Objects that decide a method's frame."""
LOG = "objects.jsonl"
TRUTH = "truth"
"""Name of the predictor that returns the truth: the score of the data set itself."""


@dataclass(frozen=True)
class EvaluationConfig:
    """Configuration of an evaluation.

    Attributes:
        data: the data set. split: which of its objects, see :mod:`model.data.registry`.
        predictor: name of the predictor, :data:`TRUTH` for the truth; or the name of
            ``predictions`` in the report.
        predictions: folder of URDFs to score instead of running a predictor.
        frame: of these URDFs; None chooses one.
        names: whether the predictor gets part names and the category.
        corruption: of the objects before prediction; not for ``predictions``.
        jobs: processes.
        limit: most objects, spread over the whole set, or None.
        seed: random seed of the predictor, the corruption and the split.
        timeout: seconds after which one object counts as failed.
        execute: whether the joints of each prediction are driven, too. engines: in which.
        limits: tolerances of usable joints.
        out: folder for the reports and ``objects.jsonl``, from which a stopped run resumes; None
            writes nothing.
    """

    data: DatasetOptions
    split: str = "all"
    predictor: str = "hybrid"
    predictions: Path | None = None
    frame: Frame | None = None
    names: bool = True
    corruption: Corruption = field(default_factory=Corruption)
    jobs: int = 2
    limit: int | None = None
    seed: int = 0
    timeout: float = 120.0
    execute: bool = False
    engines: tuple[str, ...] = (MUJOCO,)
    limits: UsableLimits = field(default_factory=UsableLimits)
    out: Path | None = None

    def key(self) -> dict[str, Any]:
        """Settings that must agree for results of an earlier run to be reused."""
        out = asdict(self)
        for name in ("jobs", "limit", "out", "timeout", "split"):
            del out[name]
        if self.engines == (MUJOCO,):  # runs before there were several go on
            del out["engines"]
        if self.data.root is not None:
            out["data"]["root"] = str(Path(self.data.root).resolve())
        if self.predictions is not None:
            out["predictions"] = str(Path(self.predictions).resolve())
        return json.loads(json.dumps(out))


@dataclass(frozen=True)
class ObjectResult:
    """One object's score and time.

    Attributes:
        score: against the truth.
        seconds: of the prediction alone, or of reading and matching a written one.
    """

    score: ObjectScore
    seconds: float


@dataclass(frozen=True, eq=False)
class ScoredPrediction:
    """A prediction with its truth and its score.

    Attributes:
        predicted: in the truth's frame, with its names, or None.
    """

    truth: GroundTruth
    predicted: ArticulatedObject | None
    score: ObjectScore
    seconds: float


def evaluate(config: EvaluationConfig, *, progress: Progress = no_progress) -> Report:
    """Predict and score every object.

    An object that fails (its files, the predictor, the time limit, a crashed process) is recorded
    as failed and the run goes on.

    Raises:
        ArtiworldError: for a wrong configuration, before anything runs.
    """
    ids = chosen_ids(config)
    if config.execute:
        require_engines(",".join(config.engines), "--execute")
    if config.predictions is not None:
        files = PredictionFolder(config.predictions).files()
        _check_overlap(config, ids, set(files))
        if config.frame is None:
            progress(0.0, "comparing frames")
            config = replace(config, frame=find_frame(config, ids))
    else:
        require_predictor(config.predictor, config.jobs)
    started = time.perf_counter()
    results = _finished(config, ids)
    log = _open_log(config, results)
    try:
        todo = [i for i in ids if i not in results]
        for i, result in robust_map(partial(evaluate_object, config), todo, config.jobs):
            results[i] = result or ObjectResult(_failed(config, i, None, "the process died"), 0.0)
            if log is not None:
                log.write(json.dumps(_to_json(results[i])) + "\n")
                log.flush()
            progress(len(results) / len(ids), f"{len(results)} of {len(ids)} objects")
    finally:
        if log is not None:
            log.close()
    ordered = [results[i] for i in ids if i in results]
    return Report(
        dataset=config.data.name,
        predictor=config.predictor,
        names=config.names if config.predictions is None else None,
        settings={**config.key(), "split": config.split},
        scores=tuple(r.score for r in ordered),
        seconds=tuple(r.seconds for r in ordered),
        wall_seconds=time.perf_counter() - started,
        frame=None if config.frame is None else config.frame.describe(),
    )


def chosen_ids(config: EvaluationConfig) -> list[str]:
    """Return the objects of the split, at most ``limit`` of them, spread over all.

    Raises:
        ArtiworldError: for an invalid data set, split or limit.
    """
    ids = select(open_dataset(config.data), config.split, seed=config.seed)
    if config.limit is not None and config.limit < 1:
        raise ConfigurationError(f"limit must be at least 1, got {config.limit}")
    return spread(ids, config.limit or len(ids))


def spread(ids: Sequence[str], most: int) -> list[str]:
    """Return at most ``most`` ids, evenly spread."""
    if most >= len(ids):
        return list(ids)
    return [ids[int(i)] for i in np.linspace(0, len(ids) - 1, most).round()]


def require_predictor(name: str, jobs: int) -> None:
    """Check a predictor before the run: its name, weights and libraries.

    Raises:
        ConfigurationError: with the predictor's own message.
    """
    if name in (TRUTH, LONGEST_EDGE):
        return
    if name not in predictor_names():
        load_predictor(name)  # raises, naming the known ones
    if name != DEFAULT:
        # In its own process: a network's imports must not be loaded when we fork.
        for _, problem in robust_map(_cannot_load, [name], jobs):
            if problem != "":
                raise ConfigurationError(
                    problem or f"loading the predictor {name!r} kills its process"
                )


def _cannot_load(name: str) -> str:
    try:
        load_predictor(name)
    except (ArtiworldError, ImportError) as error:
        named = repr(name) in str(error)
        return str(error) if named else f"the predictor {name!r} can't be loaded: {error}"
    return ""


def find_frame(config: EvaluationConfig, ids: list[str]) -> Frame:
    """Find the frame of a method's files, from some of its objects."""
    assert config.predictions is not None
    there = set(PredictionFolder(config.predictions).files())
    some = spread([i for i in ids if i in there], FRAME_SAMPLE)
    found = robust_map(partial(_costs, config), some, config.jobs)
    return choose_frame([c for _, c in found if c is not None])


def _costs(config: EvaluationConfig, object_id: str) -> FrameCosts | None:
    """Costs of one object; None where it can't be read, which its score reports."""
    assert config.predictions is not None
    try:
        with time_limit(config.timeout):
            truth = _dataset(config.data).load(object_id).object
            written = PredictionFolder(config.predictions).read(object_id)
            return frame_costs(*outlines(truth, written))
    except Exception:  # the boundary of a job
        return None


def _check_overlap(config: EvaluationConfig, ids: list[str], files: set[str]) -> None:
    if not files & set(ids):
        there, wanted = ", ".join(sorted(files)[:5]), ", ".join(ids[:5])
        raise ConfigurationError(
            f"{config.predictions}: none of its objects ({there}, …) is in the data set "
            f"({wanted}, …); name files or folders after the data set's objects"
        )


def evaluate_object(config: EvaluationConfig, object_id: str) -> ObjectResult:
    """Predict and score one object; never raises but for a lack of memory."""
    category: list[str | None] = []
    try:
        with time_limit(config.timeout):
            truth = load_truth(config, object_id)
            category.append(truth.object.category)
            scored = score_prediction(config, truth)
        score = scored.score
        if config.execute:
            run = execute(
                scored.predicted, seed=config.seed, timeout=config.timeout, engines=config.engines
            )
            score = replace(score, execution=run)
        return ObjectResult(score, scored.seconds)
    # The boundary of a job: the run continues whatever one object does to the predictor.
    except Exception as error:
        problem = f"{type(error).__name__}: {error}"
        kind = category[0] if category else None
        return ObjectResult(_failed(config, object_id, kind, problem), 0.0)


def load_truth(config: EvaluationConfig, object_id: str) -> GroundTruth:
    """Read an object, and corrupt it by the configuration."""
    truth = _dataset(config.data).load(object_id)
    if config.predictions is not None:
        return truth
    rng = np.random.default_rng([config.seed, zlib.crc32(object_id.encode())])
    return corrupt(truth, config.corruption, rng)


def score_prediction(config: EvaluationConfig, truth: GroundTruth) -> ScoredPrediction:
    """Predict, or read a written prediction, and score it.

    Raises:
        ArtiworldError: where a written prediction is missing or can't be read.
    """
    start = time.perf_counter()
    if config.predictions is not None:
        written = PredictionFolder(config.predictions).read(truth.id)
        found = resolve(truth.object, written, config.frame or Frame())
        seconds = time.perf_counter() - start
        score = score_object(
            truth.object,
            found.tree,
            limits=config.limits,
            matches=found.matches,
            faulty=found.faulty,
            swapped=found.swapped,
            confidence=found.confidence,
            unmatched_parts=len(written.object.parts) - len(found.matches),
        )
        note = "; ".join(n for n in written.notes if not n.startswith("link_"))[:500]
        return ScoredPrediction(
            truth, found.object, replace(score, object_id=truth.id, note=note), seconds
        )
    if config.predictor == TRUTH:
        prediction = Prediction(truth.object.tree)
    elif config.predictor == LONGEST_EDGE:
        prediction = longest_edge(truth.segmented(names=config.names))
    else:
        prediction = _predictor(config.predictor).predict(
            truth.segmented(names=config.names), seed=config.seed
        )
    seconds = time.perf_counter() - start
    problem = "" if prediction.tree is not None else "; ".join(prediction.problems) or "no tree"
    score = score_object(
        truth.object,
        prediction.tree,
        limits=config.limits,
        problem=problem,
        confidence=prediction.confidence,
    )
    predicted = None
    if prediction.tree is not None:
        predicted = replace(truth.object, tree=prediction.tree)
    return ScoredPrediction(truth, predicted, replace(score, object_id=truth.id), seconds)


@lru_cache(maxsize=2)
def _predictor(name: str) -> Predictor:
    return load_predictor(name)


@lru_cache(maxsize=2)
def _dataset(options: DatasetOptions) -> Dataset:
    return open_dataset(options)


def _failed(
    config: EvaluationConfig, object_id: str, category: str | None, problem: str
) -> ObjectScore:
    """The score of an object without a prediction: all its joints are missing."""
    matches = None if config.predictions is None else ()
    try:
        truth = _dataset(config.data).load(object_id).object
    except ArtiworldError:
        return ObjectScore(object_id, category, (), problem=problem)
    score = score_object(truth, None, limits=config.limits, problem=problem, matches=matches)
    run = execute(None, engines=config.engines) if config.execute else None
    return replace(score, object_id=object_id, execution=run)


def _to_json(result: ObjectResult) -> dict[str, Any]:
    return {"score": score_to_json(result.score), "seconds": result.seconds}


def _finished(config: EvaluationConfig, ids: Iterable[str]) -> dict[str, ObjectResult]:
    """Results of an earlier run with the same settings; a torn last line is left out."""
    if config.out is None:
        return {}
    path = Path(config.out) / LOG
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
            score = score_from_json(entry["score"])
            seconds = float(entry["seconds"])
        except (ValueError, KeyError, TypeError):
            continue
        if score.object_id in wanted:
            found[score.object_id] = ObjectResult(score, seconds)
    return found


def _open_log(config: EvaluationConfig, results: dict[str, ObjectResult]) -> IO[str] | None:
    """Open the log; objects of an earlier run stay in it."""
    if config.out is None:
        return None
    out = Path(config.out)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputFileError(
            out, f"can't be written ({error.strerror or error})", "give a writable folder"
        ) from error
    kept = {**_finished(config, open_dataset(config.data).ids()), **results}
    lines = [json.dumps({"settings": config.key()})]
    lines += [json.dumps(_to_json(r)) for r in kept.values()]
    path = out / LOG
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path.open("a", encoding="utf-8")
