"""A scene in, an articulated scene out; every step can be killed and taken up again.

::

    OUT/scene.json          the scene with what became of each object, metres, +z up
    OUT/scene.xml           the whole scene for MuJoCo
    OUT/<name of the source>  JSON and LISDF sources, as they came, with the URDFs' paths
    OUT/summary.json        counts, Sim-Id, times, problems
    OUT/assets/<key>/       a saved asset for each asset and size, with mjcf/ beside it; where an
                            object's limits were shortened or it is tilted, scene_<n>.urdf
    work/ in OUT            what is done already
"""

from __future__ import annotations

import difflib
import fcntl
import hashlib
import json
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.errors import ArtiworldError, ConfigurationError
from model.core.files import write_json
from model.core.pool import robust_map
from model.core.progress import Progress, no_progress
from model.io.urdf.files import MOBILITY, URDF_SUFFIX, gazebo_model
from model.io.urdf.reader import read_urdf_model
from model.io.urdf.sdf import is_sdf
from model.prediction.registry import DEFAULT
from model.scenes import jobs as job_module
from model.scenes.asset_parts import AssetIndex, ClickedObject, ObjectClicks, asset_digest
from model.scenes.jobs import (
    ASSETS,
    DONE,
    FAILED,
    MOVING,
    PLAIN,
    AssetJob,
    ConvertAsset,
    ray_map,
    read_done,
)
from model.scenes.language_finder import LanguageFinder
from model.scenes.neighbours import Standing, shortened
from model.scenes.results import Outcome, write_results
from model.scenes.scene import (
    ArticulableFinder,
    FloatArray,
    ObjectDescription,
    Scene,
    SceneObject,
    SceneObjectError,
)
from model.scenes.unpacking import Unpacked, unpack

WRITTEN = 4
"""Version of what a job writes: what an older one wrote is made anew."""
LIMITS, LOCK, UNPACKED = "work/limits", "work/lock", "work/unpacked"


@dataclass(frozen=True)
class ConvertSettings:
    """Settings for converting a scene.

    Attributes:
        jobs: processes.
        predictor, seed: predictor of the joints, and its random seed.
        keep_limits: leave joint limits as predicted, whatever stands in the way.
        collision: make collision shapes; bases that are free are free in MJCF only with them, as
            they would fall through the floor without.
        seconds: time limit an asset.
        formats: what the scene is written as besides MJCF.
        clicks: object's id → clicks that cut it into parts; such an object is articulated.
        asset_clicks: the clicks that are kept beside an asset's file, or None; they cut it where it
            is articulated and ``clicks`` has none.
        ray: address of a Ray cluster that does the work, whose machines all see ``out`` and the
            assets under the same paths; None for processes of this machine.
    """

    jobs: int = 1
    predictor: str = DEFAULT
    seed: int = 0
    keep_limits: bool = False
    collision: bool = False
    seconds: float = 1800.0
    formats: tuple[str, ...] = ()
    clicks: Mapping[str, ObjectClicks] = field(default_factory=dict)
    asset_clicks: Callable[[Path], ObjectClicks | None] = lambda _: None
    ray: str | None = None


def convert_scene(
    scene: Scene,
    assets: AssetIndex,
    out: Path,
    finder: ArticulableFinder,
    settings: ConvertSettings | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Convert every articulable object and write the scene into ``out``.

    Run again with the same arguments after a kill, it goes on where it was.

    Returns:
        What ``summary.json`` holds.

    Raises:
        ConfigurationError: where another run is writing into ``out``.
        InputFileError: where ``out`` can't be written.
    """
    settings = settings or ConvertSettings()
    _check_clicks(scene, settings)
    start = time.perf_counter()
    with alone(out):
        _sweep_up(out)
        outcomes = decide(scene, assets, finder, unpack(scene, out / UNPACKED))
        made = _make_jobs(outcomes, settings)
        reused = _run_jobs(made, outcomes, out, settings, progress)
        if not settings.keep_limits:
            shorten_limits(outcomes, out, progress)
        summary = write_results(
            scene,
            outcomes,
            out,
            free_bases=settings.collision,
            ambiguous=assets.ambiguous,
            formats=settings.formats,
        )
        summary |= {
            "finder": finder.name,
            "finder_usage": asdict(finder.usage) if isinstance(finder, LanguageFinder) else None,
            "predictor": settings.predictor,
            "assets_converted": len(made) - reused,
            "assets_done_before": reused,
            "seconds": round(time.perf_counter() - start, 3),
        }
        write_json(out / "summary.json", summary, indent=1)
    progress(1.0, "done")
    return summary


def _check_clicks(scene: Scene, settings: ConvertSettings) -> None:
    ids = [o.id for o in scene.objects]
    for id in settings.clicks:
        if id not in ids:
            near = difflib.get_close_matches(id, ids, 5, 0.3) or ids[:5]
            raise ConfigurationError(
                f"there are clicks for {id!r}, which {scene.path.name} doesn't hold; it holds "
                f"{', '.join(near)}, …"
            )


@contextmanager
def alone(out: Path) -> Iterator[None]:
    """A time in which no other process writes results into ``out``.

    Raises:
        ConfigurationError: where one does, or nobody can.
    """
    path = out / LOCK
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("w")
    except OSError as error:
        raise ConfigurationError(f"{out} can't be written: {error.strerror}") from error
    with file:
        try:
            # A POSIX lock belongs to this process alone: workers that outlive a kill don't hold it.
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise ConfigurationError(f"another conversion is writing into {out}") from None
        yield


def _sweep_up(out: Path) -> None:
    """Drafts that a killed run left."""
    for draft in (*(out / ASSETS).glob(".*"), *(out / UNPACKED).parent.glob(".*")):
        shutil.rmtree(draft, ignore_errors=True)
    for folder in (out / DONE, out / LIMITS):
        for draft in folder.glob(".*"):
            draft.unlink(missing_ok=True)


def descriptions(scene: Scene) -> list[ObjectDescription]:
    """The finder's input for each object."""
    return [ObjectDescription(o.description, o.category, o.fit or o.box) for o in scene.objects]


def decide(
    scene: Scene,
    assets: AssetIndex,
    finder: ArticulableFinder,
    inside: Unpacked | None = None,
) -> list[Outcome]:
    """Each object with the finder's decision, its asset, and whether that is known to move.

    Args:
        inside: what the scene's own file held; where it wasn't unpacked, its objects are missing.
    """
    inside = inside or Unpacked()
    truths: dict[Path, bool | None] = {}
    out: list[Outcome] = []
    objects = [_filled(obj, assets) for obj in scene.objects]
    for obj, decision in zip(objects, finder.find(descriptions(scene)), strict=True):
        outcome = Outcome(obj, decision)
        if obj.box is not None:
            outcome.state, outcome.reason = PLAIN, "a plain box without an asset"
        elif obj.asset is None:
            outcome.reason = "names no asset"
        elif obj.asset in inside.problems:
            outcome.state, outcome.reason = FAILED, inside.problems[obj.asset]
        else:
            outcome.path = inside.files.get(obj.asset) or assets.find(obj.asset)
            if outcome.path is None:
                outcome.reason = f"asset {obj.asset!r} is in none of the folders given"
            else:
                if outcome.path not in truths:
                    truths[outcome.path] = _moves(outcome.path)
                outcome.truth = truths[outcome.path]
                if obj.asset in inside.files and outcome.truth and not decision.articulable:
                    why = "the scene's file declares joints of it"
                    outcome.decision = replace(decision, articulable=True, reason=why)
        out.append(outcome)
    return out


def _filled(obj: SceneObject, assets: AssetIndex) -> SceneObject:
    """A box whose asset is there is that asset, stretched to it."""
    if obj.box is None or obj.asset is None or assets.find(obj.asset) is None:
        return obj
    return replace(obj, box=None)


def _moves(path: Path) -> bool | None:
    """True if the asset's own URDF or SDF has a moving joint; None without a readable one."""
    files = [path / MOBILITY, path / "object.urdf", gazebo_model(path) or path]
    for file in files:
        if file.is_file() and (file.suffix == URDF_SUFFIX or is_sdf(file)):
            try:
                return any(j.moves for j in read_urdf_model(file).tree.joints)
            except ArtiworldError:
                return None
    return None


def _make_jobs(outcomes: Sequence[Outcome], settings: ConvertSettings) -> dict[str, AssetJob]:
    digests: dict[Path, str] = {}
    made: dict[str, AssetJob] = {}
    for o in outcomes:
        if o.path is None:
            continue
        try:
            if o.path not in digests:
                digests[o.path] = asset_digest(o.path)
            job = asset_job(o, digests[o.path], settings)
        except ArtiworldError as error:
            o.state, o.reason, o.path = FAILED, str(error), None
            continue
        o.key = job.key
        made.setdefault(job.key, job)
    return made


def asset_job(o: Outcome, digest: str, settings: ConvertSettings) -> AssetJob:
    """The job for an object with an asset whose files have that digest.

    Raises:
        InputFileError: where the clicks beside its asset can't be read.
    """
    assert o.path is not None
    x, y, z = (round(float(v), 9) for v in o.obj.scale)
    fit = None if o.obj.fit is None else tuple(round(float(v), 9) for v in o.obj.fit)
    clicks = settings.clicks.get(o.obj.id)
    articulate = o.decision.articulable or clicks is not None
    if clicks is None and articulate:
        clicks = settings.asset_clicks(o.path)
    category = (o.decision.kind or o.obj.category) if articulate else None
    clicked = None
    if clicks is not None:
        category = clicks.category or category
        clicked = ClickedObject(clicks, o.obj.world_from_object, o.obj.anchor)
    collision = settings.collision and o.obj.solid
    content = [WRITTEN, digest, x, y, z, fit, articulate, category, collision, settings.formats]
    if clicks is not None:
        content.append(clicks.key())
    if clicks is not None and clicks.in_scene:
        content += [o.obj.world_from_object.tolist(), o.obj.anchor]
    content += [settings.predictor, settings.seed] if articulate else []
    short = hashlib.sha256(json.dumps(content).encode()).hexdigest()[:12]
    stem = "".join(c if c.isalnum() and c.isascii() else "_" for c in o.path.stem)[:40]
    made = (settings.predictor, settings.seed, collision, settings.seconds, settings.formats)
    name = f"{stem}-{short}"
    return AssetJob(name, o.path, (x, y, z), fit, articulate, category, *made, clicked)  # type: ignore[arg-type]


def _run_jobs(
    made: dict[str, AssetJob],
    outcomes: Sequence[Outcome],
    out: Path,
    settings: ConvertSettings,
    progress: Progress,
) -> int:
    """Convert the remaining jobs; returns the number that were done before."""
    reports = {k: r for k in made if (r := read_done(out, k)) is not None}
    reused = len(reports)
    waiting = [k for k in made if k not in reports]
    tell = _time_left(progress, 0.0, 0.8, len(waiting))
    tell(0, "converting")
    todo = {k: made[k] for k in waiting}
    if settings.ray is None:
        answers = robust_map(ConvertAsset(out, todo, os.getpid()), waiting, settings.jobs)
    else:
        answers = ray_map(ConvertAsset(out.absolute(), todo, None), waiting, settings.ray)
    for i, (key, report) in enumerate(answers, 1):
        reports[key] = report if report is not None else job_module.died(made[key])
        tell(i, key)
    for o in outcomes:
        if o.key is not None:
            o.report = reports[o.key]
            o.state, o.reason = o.report["state"], o.report["reason"]
    return reused


def shorten_limits(outcomes: Sequence[Outcome], out: Path, progress: Progress) -> None:
    """Shorten the limits of each articulated object, its neighbours at rest."""
    standing = {o.obj.id: s for o in outcomes if (s := _standing(o, out)) is not None}
    moving = [o for o in outcomes if o.state in MOVING and o.obj.id in standing]
    tell = _time_left(progress, 0.8, 0.97, len(moving))
    stands = list(standing.values())
    boxes = np.array([s.world_bounds() for s in stands]).reshape(-1, 2, 3)
    for i, o in enumerate(moving):
        tell(i, f"limits of {o.obj.id}")
        me = standing[o.obj.id]
        others = tuple(stands[k] for k in _close(me, boxes) if stands[k] is not me)
        o.changes = _kept(out, me, others)


def _kept(out: Path, me: Standing, others: tuple[Standing, ...]) -> list[dict[str, Any]]:
    """:func:`~model.scenes.neighbours.shortened`, worked out once."""
    content = [
        [
            s.id,
            None if s.folder is None else s.folder.name,
            s.world_from_asset.tolist(),
            s.bounds.tolist(),
        ]
        for s in (me, *others)
    ]
    key = hashlib.sha256(json.dumps(content).encode()).hexdigest()[:24]
    path = out / LIMITS / f"{key}.json"
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        pass
    changes = shortened(me, others)
    write_json(path, changes, indent=1)
    return changes


def _standing(o: Outcome, out: Path) -> Standing | None:
    if not o.obj.obstacle:
        return None
    if o.obj.box is not None:
        half = np.asarray(o.obj.box) / 2
        return Standing(o.obj.id, None, o.obj.world_from_object, np.stack([-half, half]))
    if o.key is None or o.report.get("bounds") is None:
        return None
    bounds = np.asarray(o.report["bounds"])
    try:
        placement = o.obj.placed(bounds)
    except SceneObjectError:
        return None
    return Standing(
        o.obj.id,
        out / ASSETS / o.key,
        placement.world_from_asset,
        np.sort(bounds * placement.scale, axis=0),
    )


def _close(a: Standing, boxes: FloatArray) -> npt.NDArray[np.intp]:
    """Which of the boxes (N, 2, 3) are within two diagonals of ``a``: no part of it moves
    further. All at once: one by one they would take most of the time for thousands of objects."""
    low, high = a.world_bounds()
    reach = 2 * float(np.linalg.norm(high - low))
    near = (boxes[:, 1] >= low - reach).all(axis=1) & (boxes[:, 0] <= high + reach).all(axis=1)
    return np.flatnonzero(near)


def _time_left(
    progress: Progress, start: float, end: float, count: int
) -> Callable[[int, str], None]:
    began = time.monotonic()

    def tell(done: int, what: str) -> None:
        left = ""
        if 0 < done < count:
            seconds = (time.monotonic() - began) / done * (count - done)
            left = f", {seconds / 60:.0f} min left" if seconds > 90 else f", {seconds:.0f} s left"
        fraction = start + (end - start) * (done / count if count else 1.0)
        progress(fraction, f"{done}/{count} {what}{left}")

    return tell
