"""Writing a scene in the worker process: its assets, and the files of ``artiworld scene convert``.

Accepted objects move, the others are rigid.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from app.server.part_tasks import PartSource, articulated_object
from app.server.scene_tasks import SceneItem
from model.core.errors import ArtiworldError, CommandError
from model.core.files import write_json
from model.core.progress import Progress, no_progress
from model.core.tree import KinematicTree
from model.io.assets.asset_folder import write_asset
from model.io.assets.reader import read_provenance
from model.io.file_names import FileNames
from model.physics.simulation_values import physics_of
from model.scenes.asset_parts import asset_digest
from model.scenes.convert import ConvertSettings, alone, asset_job, shorten_limits
from model.scenes.jobs import (
    ACCEPTED,
    ASSETS,
    FAILED,
    MISSING,
    PLAIN,
    PREDICTED,
    REJECTED,
    STATIC,
    TODO,
    ConvertAsset,
    read_done,
    write_formats,
)
from model.scenes.registry import read_scene
from model.scenes.results import Outcome, write_results
from model.scenes.scene import Decision

ASSET_SECONDS = 1800.0
"""Longest time for one rigid asset, collision shapes included."""


@dataclass(frozen=True, eq=False)
class MovingCopy:
    """A working copy that moves in the saved scene.

    Attributes:
        accepted: folder of the accepted asset; None where it is only predicted.
        bounds: (2, 3) of its asset, at the asset's own size.
        confidence: child link → confidence.
        reason: human-readable reason why it moves.
    """

    source: PartSource
    tree: KinematicTree
    bounds: list[list[float]]
    accepted: str | None
    confidence: Mapping[str, float]
    reason: str


@dataclass(frozen=True)
class Decided:
    """The decision about an articulable object.

    Attributes:
        state: ``accepted``, ``predicted``, ``rejected`` or ``todo``; the last two are rigid.
        reason: human-readable.
        by, at: author and time; "" without a decision.
    """

    state: str
    reason: str = ""
    by: str = ""
    at: str = ""


def save_scene(
    path: Path,
    format: str,
    ids: Sequence[str],
    items: Sequence[SceneItem],
    copies: Mapping[Path, MovingCopy],
    decided: Mapping[str, Decided],
    out: Path,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Write the scene and its assets into ``out``; assets that are there already stay.

    Args:
        format, ids: the reader and the objects of the scene's file when it was opened.
        items: the present objects, those that were picked out of others among them.
        copies: working copy → the copy that moves.
        decided: articulable object → the decision about it.

    Returns:
        The summary, as ``artiworld scene convert`` gives it.

    Raises:
        ConfigurationError: where another server saves the scene at the moment.
    """
    progress(0.0, "reading")
    scene = read_scene(path, format)
    if [o.id for o in scene.objects] != list(ids):
        raise CommandError(f"{path} was changed since it was opened: restart the server")
    scene = replace(scene, objects=tuple(i.obj for i in items))
    with alone(out):
        (out / ASSETS).mkdir(parents=True, exist_ok=True)
        made: dict[str, dict[str, Any]] = {}
        outcomes: list[Outcome] = []
        for k, item in enumerate(items):
            progress(0.8 * k / len(items), item.obj.id)
            outcome = Outcome(item.obj, item.decision, item.path, item.truth)
            outcomes.append(outcome)
            if item.obj.box is not None:
                outcome.state, outcome.reason = PLAIN, "a plain box without an asset"
            elif item.problem:
                outcome.state, outcome.reason = FAILED, item.problem
            elif item.path is None:
                outcome.state, outcome.reason = MISSING, "its asset is in none of the folders"
            else:
                try:
                    _write_object(outcome, item, copies, out, made)
                    _apply_decision(outcome, decided.get(item.obj.id))
                except ArtiworldError as error:
                    outcome.state, outcome.reason, outcome.key = FAILED, str(error), None
        shorten_limits(outcomes, out, progress)
        progress(0.97, "writing")
        summary = write_results(scene, outcomes, out, free_bases=True, formats=_formats())
        write_json(out / "summary.json", summary, indent=1)
        for folder in (out / ASSETS).iterdir():
            if folder.name not in made:  # left from a former save
                shutil.rmtree(folder, ignore_errors=True)
    return summary


def _formats() -> tuple[str, ...]:
    """Return the formats of the scene besides MJCF."""
    return ("sdf", "usd") if find_spec("pxr") is not None else ("sdf",)


def _write_object(
    outcome: Any,
    item: SceneItem,
    copies: Mapping[Path, MovingCopy],
    out: Path,
    made: dict[str, dict[str, Any]],
) -> None:
    moving = None if item.copy is None else copies.get(item.copy)
    if moving is None:
        report = _rigid(item, out, made)
    else:
        assert item.copy is not None
        report = made.get(item.copy.name) or _moving_asset(item, moving, out)
    outcome.key, outcome.report = report["key"], report
    made[report["key"]] = report
    outcome.state, outcome.reason = report["state"], report["reason"]


def _apply_decision(outcome: Outcome, decided: Decided | None) -> None:
    """Record the decision about a written object; a rigid one may only be waiting for one."""
    if decided is None:
        return
    outcome.by, outcome.at = decided.by, decided.at
    if decided.state in (REJECTED, TODO) and outcome.state == STATIC:
        outcome.state, outcome.reason = decided.state, decided.reason


def _rigid(item: SceneItem, out: Path, made: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    assert item.path is not None
    settings = ConvertSettings(seconds=ASSET_SECONDS, collision=True, formats=_formats())
    rigid = Outcome(item.obj, Decision(False), item.path)
    job = asset_job(rigid, asset_digest(item.path), settings)
    report = made.get(job.key) or read_done(out, job.key)
    return report or ConvertAsset(out, {job.key: job}, os.getpid())(job.key)


def _moving_asset(item: SceneItem, moving: MovingCopy, out: Path) -> dict[str, Any]:
    """Write a working copy as an asset below ``out``."""
    assert item.copy is not None and item.path is not None
    key = item.copy.name
    folder = out / ASSETS / key
    store = moving.source.workspace / "collision"
    shutil.rmtree(folder, ignore_errors=True)
    # Not read from the accepted files: the collision shapes of these very parts are cached.
    obj = articulated_object(moving.source, moving.tree)
    physics = physics_of(obj, store=store)
    names = FileNames.of(obj)
    if moving.accepted is not None and Path(moving.accepted).is_dir():
        shutil.copytree(moving.accepted, folder)
        names = FileNames.stored(read_provenance(folder)["asset"])
    else:
        source = {"path": item.path.name, "sha256": asset_digest(item.path)}
        write_asset(obj, folder, physics=physics,
                    provenance={"source": source, "review": "predicted, not accepted"})  # fmt: skip
    obj, confidence = names.object(obj), names.by_link(moving.confidence)
    write_formats(obj, folder, _formats(), names.physics(physics))
    joints = [{**asdict(j), "confidence": confidence.get(j.child)}
              for j in obj.tree.joints if j.moves]  # fmt: skip
    state = PREDICTED if moving.accepted is None else ACCEPTED
    return {"key": key, "state": state if joints else STATIC, "reason": moving.reason,
            "bounds": moving.bounds, "joints": joints}  # fmt: skip
