"""One asset of a scene, converted once however often it stands there, here or on a Ray cluster.

There neither an object nor a worker may end the run.
"""

from __future__ import annotations

import json
import os
import socket
import threading
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from model.core.articulated_object import ArticulatedObject, SegmentedObject, remarks_of
from model.core.errors import ArtiworldError, ConfigurationError
from model.core.files import write_json
from model.core.geometry import affine
from model.core.packages import require
from model.core.pool import OutOfTimeError, time_limit
from model.core.tree import KinematicTree
from model.evaluation.joint_metrics import score_object
from model.io.assets.asset_folder import write_asset
from model.io.export.mjcf import MjcfExporter
from model.io.export.sdf import SdfExporter
from model.io.export.usd import UsdExporter
from model.io.file_names import FileNames
from model.physics.simulation_values import Physics, PhysicsSettings, physics_of, plain_physics
from model.prediction.registry import load_predictor
from model.scenes.asset_parts import (
    AssetParts,
    ClickedObject,
    LeftForAnnotator,
    asset_digest,
    bounds_of,
    clicked_parts,
    known_parts,
    masses_at,
    scaled,
    scaled_shapes,
    whole,
)
from model.scenes.scene import FloatArray, SceneObject

ASSETS, DONE, MJCF = "assets", "work/assets", "mjcf"
PREDICTED, STATIC, ANNOTATE, FAILED = "predicted", "static", "annotate", "failed"
"""Results for an asset; ``annotate`` stands there rigid until a person cuts it."""
ACCEPTED = "accepted"
"""As predicted, and a person said that it is right."""
MOVING = (PREDICTED, ACCEPTED)
REJECTED, TODO = "rejected", "todo"
"""Results of review: rejected, and undecided; both stand there rigid."""
MISSING, PLAIN = "missing", "plain"
"""States of objects whose asset isn't there, and of plain boxes without one."""


@dataclass(frozen=True)
class AssetJob:
    """An asset at one size.

    Attributes:
        key: names its folder; the same for the same files, size and settings.
        path: of the asset.
        scale, fit: as in :class:`~model.scenes.scene.SceneObject`.
        articulate: whether joints are requested.
        category: hint for the predictor.
        predictor, seed: as :func:`model.prediction.registry.load_predictor` and ``predict`` take
        them.
        collision: whether collision shapes are made, which takes most of the time.
        seconds: time limit.
        formats: further ones that the asset is written in: "sdf", "usd".
        clicked: clicks that cut it into parts, or None.
    """

    key: str
    path: Path
    scale: tuple[float, float, float]
    fit: tuple[float, float, float] | None
    articulate: bool
    category: str | None
    predictor: str
    seed: int
    collision: bool
    seconds: float
    formats: tuple[str, ...] = ()
    clicked: ClickedObject | None = None


@dataclass(frozen=True)
class ConvertAsset:
    """Runs jobs into ``out``; picklable. Never raises: what went wrong is in the answer.

    Attributes:
        parent: process without which it ends; None where another program ends it.
    """

    out: Path
    jobs: dict[str, AssetJob]
    parent: int | None

    def __call__(self, key: str) -> dict[str, Any]:
        """Convert one asset and record it; the record is written last, so a kill loses only it."""
        _end_with(self.parent)
        done = read_done(self.out, key)
        if done is not None:  # by a process that died before its answer was heard
            return done
        job = self.jobs[key]
        start = time.perf_counter()
        try:
            with time_limit(job.seconds):
                report = _convert(job, self.out)
        except (ArtiworldError, OutOfTimeError) as error:
            report = _record(job, FAILED, str(error))
        except Exception as error:  # one bad object never ends the run
            report = _record(job, FAILED, f"{type(error).__name__}: {error}")
        report["seconds"] = round(time.perf_counter() - start, 3)
        write_json(self.out / DONE / f"{key}.json", report, indent=1)
        return report


def died(job: AssetJob) -> dict[str, Any]:
    """The answer of a job whose process died."""
    return {**_record(job, FAILED, "its process died (out of memory?)"), "seconds": 0.0}


def _record(job: AssetJob, state: str, reason: str) -> dict[str, Any]:
    return {"key": job.key, "state": state, "reason": reason, "bounds": None, "joints": []}


def _convert(job: AssetJob, out: Path) -> dict[str, Any]:
    state, reason, found = STATIC, "", None
    holder = _holder(job)
    if job.articulate:
        try:
            found = (
                known_parts(job.path)
                if job.clicked is None
                else clicked_parts(job.path, holder, job.clicked.clicks)
            )
        except LeftForAnnotator as left:
            state, reason = ANNOTATE, str(left)
    parts = (whole(job.path),) if found is None else found.parts
    how = None if found is None else found.how
    asset_bounds = bounds_of(parts)
    placement = holder.placed(asset_bounds)
    parts = scaled(parts, placement.scale)
    name = job.path.stem if job.path.is_file() else job.path.name
    tree, confidence, problems, backend = KinematicTree((parts[0].link,)), {}, (), None
    if job.articulate and state == STATIC:
        answer = load_predictor(job.predictor).predict(
            SegmentedObject(name, parts, job.category), seed=job.seed
        )
        problems, backend = answer.problems, answer.backend
        if answer.tree is not None and any(j.moves for j in answer.tree.joints):
            state, tree, confidence = PREDICTED, answer.tree, dict(answer.confidence)
        else:
            state = ANNOTATE
            reason = "no joint was predicted: " + ("; ".join(problems) or "no reason was given")
            parts = scaled((whole(job.path),), placement.scale)
            tree = KinematicTree((parts[0].link,))
    masses, shapes = {}, {}
    if found is not None and state == PREDICTED:
        masses = masses_at(found, placement.scale)
        shapes = scaled_shapes(found.shapes, placement.scale)
    obj = ArticulatedObject(name, parts, tree, job.category, masses, shapes)
    usable = usability(obj, found, placement.scale, state)
    names = FileNames.of(obj)
    obj, confidence = names.object(obj), names.by_link(confidence)
    physics: Physics = physics_of(obj, PhysicsSettings()) if job.collision else plain_physics(obj)
    folder = out / ASSETS / job.key
    # Of the source's path the name alone: the asset may be moved.
    source = {"path": job.path.name, "sha256": asset_digest(job.path)}
    write_asset(
        obj,
        folder,
        provenance={"source": source, "predictor": backend, "parts": how},
        physics=physics if job.collision else None,
    )
    write_formats(obj, folder, job.formats, physics)
    joints = [{**asdict(j), "confidence": confidence.get(j.child)} for j in tree.joints if j.moves]
    return {
        **_record(job, state, reason),
        "bounds": asset_bounds.tolist(),
        "joints": joints,
        "parts": len(parts),
        "how": how,
        "notes": [*(() if found is None else found.notes), *remarks_of(parts)],
        "problems": list(problems),
        "usable": usable,
    }


def write_formats(
    obj: ArticulatedObject, folder: Path, formats: Collection[str], physics: Physics
) -> None:
    """Beside a saved asset what the scene's files refer to: ``mjcf/`` and each of ``formats``."""
    for name, exporter in (("usd", UsdExporter()), ("sdf", SdfExporter()), (MJCF, MjcfExporter())):
        if name == MJCF or name in formats:
            (folder / name).mkdir(exist_ok=True)
            exporter.export(obj, folder / name, physics=physics)


def usability(
    obj: ArticulatedObject, found: AssetParts | None, factors: FloatArray, state: str
) -> bool | None:
    """True if every joint is right (ArtiWorld, usability); None without a true URDF."""
    if found is None or found.truth is None:
        return None
    if state != PREDICTED:
        return False
    truth = ArticulatedObject(obj.name, obj.parts, found.truth.moved(affine(np.diag(factors))))
    return score_object(truth, obj.tree).usable


def _holder(job: AssetJob) -> SceneObject:
    if job.clicked is None:
        return SceneObject(job.key, job.key, np.eye(4), np.asarray(job.scale), fit=job.fit)
    return SceneObject(
        job.key,
        job.key,
        job.clicked.world_from_object,
        np.asarray(job.scale),
        fit=job.fit,
        anchor=job.clicked.anchor,
    )


def read_done(out: Path, key: str) -> dict[str, Any] | None:
    """The record of a job that an earlier run finished, or None."""
    path = out / DONE / f"{key}.json"
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(report, dict) or report.get("key") != key:
        return None
    if report["state"] == FAILED:
        return None  # whatever failed may go well now
    return report if (out / ASSETS / key / MJCF / "object.xml").is_file() else None


def _end_with(parent: int | None) -> None:
    """End a worker whose run was killed, so that it doesn't write beside the next run."""
    monitored = any(t.name == "end-with-parent" for t in threading.enumerate())
    if parent is None or os.getpid() == parent or monitored:
        return

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, name="end-with-parent", daemon=True).start()


T = TypeVar("T")

TRIES = 3
"""Deaths of its worker after which an object is given up."""

CONNECT_SECONDS = 5.0


def ray_map(
    function: Callable[[str], T], ids: Sequence[str], address: str
) -> Iterator[tuple[str, T | None]]:
    """``function`` of each id as they are done; None for one that kills its workers.

    Args:
        function: can be pickled; must not raise. ArtiWorld is installed on every machine.
        ids: each one once.
        address: of a cluster, as ``ray://host:10001``, ``host:6379`` or ``auto``; ``local`` starts
            one on this machine, which ends with the run.

    Raises:
        ConfigurationError: where Ray isn't installed or the cluster isn't there.
    """
    if not ids:
        return
    ray, errors = _connect(address)
    try:
        task = ray.remote(max_retries=0)(function.__class__.__call__)
        held = ray.put(function)
        running = {task.remote(held, i): (i, 1) for i in ids}
        while running:
            done, _ = ray.wait(list(running), num_returns=1)
            for reference in done:
                id, tries = running.pop(reference)
                try:
                    yield id, ray.get(reference)
                # A worker died, or its machine: Ray moves the object elsewhere.
                except errors as error:
                    if tries < TRIES and not isinstance(error, ray.exceptions.RayTaskError):
                        running[task.remote(held, id)] = (id, tries + 1)
                    else:
                        yield id, None
    finally:
        ray.shutdown()


def _connect(address: str) -> tuple[Any, type[Exception]]:
    ray = require("ray", "artiworld[cluster]", "--ray")
    require("ray.exceptions", "artiworld[cluster]", "--ray")
    _check_there(address)
    try:
        ray.init(
            address=address,
            log_to_driver=False,
            configure_logging=False,
            **({"include_dashboard": False} if address == "local" else {}),  # type: ignore[arg-type]
        )
    except (ConnectionError, ValueError, RuntimeError, OSError, TimeoutError) as error:
        first = (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
        raise ConfigurationError(f"no Ray cluster at {address!r}: {first}") from error
    return ray, ray.exceptions.RayError


def _check_there(address: str) -> None:
    """Ray itself retries for minutes without an answer."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not colon:
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), CONNECT_SECONDS).close()
    except (OSError, ValueError, OverflowError) as error:
        raise ConfigurationError(
            f"no Ray cluster at {address!r} ({error}); start one with: ray start --head"
        ) from error
