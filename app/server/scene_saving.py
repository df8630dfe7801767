"""Saving an open scene, and a page that says what became of it; both in worker processes.

The files are those of ``artiworld scene convert`` (:mod:`model.scenes.convert`), from what people
decided: accepted objects move, the others stand rigid.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from app.server.jobs import CLICKS
from app.server.part_tasks import PartSource, articulated_object
from app.server.scene_report import ReportRow, write_report
from app.server.scene_rows import Row, Work
from app.server.scene_state import SceneState
from app.server.scene_tasks import OpenedScene, SceneItem
from model.core.display_names import link_display_name
from model.core.errors import ArtiworldError, CommandError
from model.core.progress import Progress, no_progress
from model.core.tree import KinematicTree
from model.io.assets.asset_folder import write_asset
from model.physics.simulation_values import physics_of
from model.scenes.assets import asset_digest
from model.scenes.convert import ConvertSettings, asset_job, shorten_limits
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
    write_json,
)
from model.scenes.outcome import Outcome
from model.scenes.protocol import Decision
from model.scenes.registry import read_scene
from model.scenes.results import write_results
from sessions import commands as cmd

SECONDS = 1800.0


@dataclass(frozen=True, eq=False)
class MovingCopy:
    """A working copy that moves in the saved scene.

    Attributes:
        accepted: folder of the accepted asset; None where it is only predicted.
        bounds: (2, 3) of its asset, at the asset's own size.
        confidence: child link → confidence.
        said: what became of it, for people.
    """

    source: PartSource
    tree: KinematicTree
    bounds: list[list[float]]
    accepted: str | None
    confidence: Mapping[str, float]
    said: str


@dataclass(frozen=True)
class Decided:
    """What people made of an object that can be articulated.

    Attributes:
        state: ``accepted``, ``predicted``, ``rejected`` or ``todo``; the last two stand rigid.
        reason: why, for people.
        by, at: who decided, and when; "" where nobody did.
    """

    state: str
    reason: str = ""
    by: str = ""
    at: str = ""


class Saving:
    """Writes the scene, and the report on it.

    Args:
        row: an object as lists show it.
        why_refused: why an object wasn't accepted, or "".
    """

    def __init__(
        self,
        scene: SceneState,
        row: Callable[[SceneItem], Row],
        why_refused: Callable[[Work], str],
    ) -> None:
        self._scene, self._list_row, self._why_refused = scene, row, why_refused

    def save(self, loose: bool, who: str) -> None:
        """Write the scene; ``loose``: what is only predicted moves too.

        Raises:
            CommandError: where it is being written, or its parts aren't ready.
        """
        scene = self._scene
        if "save" in scene.jobs:
            return
        opened, items, copies, decided = self._plan(loose)
        record = scene.record
        out = scene.services.workspace / "scenes" / f"saved-{record.id}"
        job = scene.services.workers.geometry.submit(
            save_scene, record.path, opened.reader, tuple(i.obj.id for i in scene.read), items,
            copies, decided, out, on_progress=scene.jobs.progress("save"), priority=6,
            gives_way=CLICKS,
        )  # fmt: skip

        def keep(summary: dict[str, Any]) -> None:
            scene.live.do(cmd.Saved(str(out)), who)
            moving = sum(summary["states"].get(s, 0) for s in (ACCEPTED, PREDICTED))
            scene.tell("Saved", f"{moving} objects move; {out}", "green")

        scene.start("save", job, keep)
        scene.changed()

    def _plan(
        self, loose: bool
    ) -> tuple[
        OpenedScene, tuple[SceneItem, ...], dict[Path, MovingCopy], dict[str, Decided]
    ]:  # fmt: skip
        scene = self._scene
        if scene.scene is None:
            raise CommandError("the scene is still being read")
        copies: dict[Path, MovingCopy] = {}
        for work in scene.wanted():
            found = self._moving(work, loose)
            if found is not None and work.item.copy is not None:
                copies[work.item.copy] = found
        items = [replace(i, copy=i.copy if scene.articulable(i) else None,
                         decision=replace(i.decision, articulable=scene.articulable(i)))
                 for i in scene.items.values()]  # fmt: skip
        decided = {
            i: self._decided(w, w.item.copy in copies) for w in scene.wanted() for i in w.ids
        }
        return scene.scene, tuple(items), copies, decided

    def _decided(self, work: Work, moves: bool) -> Decided:
        doc, review = work.document, work.document.review
        if review.state == "rejected":
            why = (review.reason or "").replace("_", " ")
            why = "; ".join(w for w in (why, review.comment) if w)
            return Decided(REJECTED, f"rejected: {why}" if why else "", review.by, review.at)
        if review.state == "accepted":
            return Decided(ACCEPTED, f"accepted by {review.by}", review.by, review.at)
        if moves:
            return Decided(PREDICTED)
        why = self._why_refused(work) or work.reason
        if not why:
            why = "it has no joints yet" if doc.tree is None else "nobody has decided on it"
        return Decided(TODO, why)

    def _moving(self, work: Work, loose: bool) -> MovingCopy | None:
        doc, scene = work.document, self._scene
        state = doc.review.state
        if doc.tree is None or state not in (("accepted", "predicted") if loose else ("accepted",)):
            return None
        shape = None if work.item.path is None else scene.shapes.get(work.item.path)
        if work.drawn is None or shape is None or isinstance(shape, str):
            raise CommandError(f"{work.item.obj.id} is still being prepared; save in a moment")
        source = PartSource(
            work.drawn.folder, scene.services.workspace, work.drawn.labels, doc.part_names,
            doc.category, work.name,
        )  # fmt: skip
        folder = doc.saved.folder if state == "accepted" and doc.saved is not None else None
        said = f"accepted by {doc.review.by}" if state == "accepted" else ""
        confidence = {} if doc.prediction is None else dict(doc.prediction.confidence)
        return MovingCopy(source, doc.tree, shape.bounds.tolist(), folder, confidence, said)

    def report(self, done: Callable[[Path], None]) -> None:
        """Write the page; ``done`` gets its path."""
        scene = self._scene
        if "report" in scene.jobs or scene.scene is None:
            return
        rows = [self._row(item) for item in scene.items.values()]
        record = scene.record
        path = scene.services.workspace / "scenes" / f"report-{record.id}" / f"{record.name}.html"
        job = scene.services.workers.geometry.submit(
            write_report, path, scene.scene.name, tuple(rows), scene.scene.problems,
            dict(scene.shapes), scene.services.workspace,
            saved=None if scene.document.saved is None else Path(scene.document.saved.folder),
            on_progress=scene.jobs.progress("report"), priority=6, gives_way=CLICKS,
        )  # fmt: skip
        scene.start("report", job, lambda _: done(path))
        scene.changed()

    def _row(self, item: SceneItem) -> ReportRow:
        scene, work = self._scene, self._scene.work(item.obj.id)
        row = self._list_row(item)
        doc = None if work is None else work.document
        source = None
        if work is not None and doc is not None and doc.tree is not None and work.drawn is not None:
            source = PartSource(
                work.drawn.folder, scene.services.workspace, work.drawn.labels, doc.part_names
            )
        notes = []
        if work is not None:
            notes = [work.reason, self._why_refused(work)]
        notes.append(scene.missing_reason(item))
        return ReportRow(
            item, row.status, row.confidence, scene.document.articulable.get(item.obj.id),
            None if doc is None else doc.tree,
            {} if doc is None or doc.prediction is None else dict(doc.prediction.confidence),
            {} if doc is None else {
                p.link: link_display_name(p.link, p.name, root=False) for p in doc.parts
            },
            "" if doc is None else doc.review.by, "" if doc is None else doc.review.at,
            "" if doc is None else (doc.review.reason or "").replace("_", " "),
            tuple(n for n in notes if n), source, None if work is None else work.id,
        )  # fmt: skip


# --- in the worker ----------------------------------------------------------------------------


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
    """Write the scene and its assets into ``out``; what stands there already isn't made again.

    Args:
        format, ids: how the scene's file was read, and the objects that it held then.
        items: its objects now, those that were picked out of others among them.
        copies: working copy → what moves.
        decided: object that can be articulated → what people made of it.

    Returns:
        The summary, as ``artiworld scene convert`` gives it.
    """
    progress(0.0, "reading")
    scene = read_scene(path, format)
    if [o.id for o in scene.objects] != list(ids):
        raise CommandError(f"{path} was changed since it was opened: start the server anew")
    scene = replace(scene, objects=tuple(i.obj for i in items))
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
                _stand(outcome, item, copies, out, made)
                _tell(outcome, decided.get(item.obj.id))
            except ArtiworldError as error:
                outcome.state, outcome.reason, outcome.key = FAILED, str(error), None
    shorten_limits(outcomes, out, progress)
    progress(0.97, "writing")
    summary = write_results(scene, outcomes, out, free_bases=True, formats=_formats())
    write_json(out / "summary.json", summary)
    for folder in (out / ASSETS).iterdir():
        if folder.name not in made:  # of a scene that was saved before
            shutil.rmtree(folder, ignore_errors=True)
    return summary


def _formats() -> tuple[str, ...]:
    """What the scene is written as besides MJCF."""
    return ("sdf", "usd") if find_spec("pxr") is not None else ("sdf",)


def _stand(
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


def _tell(outcome: Outcome, decided: Decided | None) -> None:
    """What people made of an object that stands there; a rigid one isn't static for that."""
    if decided is None:
        return
    outcome.by, outcome.at = decided.by, decided.at
    if decided.state in (REJECTED, TODO) and outcome.state == STATIC:
        outcome.state, outcome.reason = decided.state, decided.reason


def _rigid(item: SceneItem, out: Path, made: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    assert item.path is not None
    settings = ConvertSettings(seconds=SECONDS, collision=True, formats=_formats())
    rigid = Outcome(item.obj, Decision(False), item.path)
    job = asset_job(rigid, asset_digest(item.path), settings)
    report = made.get(job.key) or read_done(out, job.key)
    return report or ConvertAsset(out, {job.key: job}, os.getpid())(job.key)


def _moving_asset(item: SceneItem, moving: MovingCopy, out: Path) -> dict[str, Any]:
    """The working copy as an asset below ``out``, as people left it."""
    assert item.copy is not None and item.path is not None
    key = item.copy.name
    folder = out / ASSETS / key
    store = moving.source.workspace / "collision"
    shutil.rmtree(folder, ignore_errors=True)
    # Not the accepted files read back: the collision shapes of these very parts are kept.
    obj = articulated_object(moving.source, moving.tree)
    physics = physics_of(obj, store=store)
    if moving.accepted is not None and Path(moving.accepted).is_dir():
        shutil.copytree(moving.accepted, folder)
    else:
        source = {"path": item.path.name, "sha256": asset_digest(item.path)}
        write_asset(obj, folder, physics=physics,
                    provenance={"source": source, "review": "predicted, not accepted"})  # fmt: skip
    write_formats(obj, folder, _formats(), physics)
    joints = [{**asdict(j), "confidence": moving.confidence.get(j.child)}
              for j in obj.tree.joints if j.moves]  # fmt: skip
    state = PREDICTED if moving.accepted is None else ACCEPTED
    return {"key": key, "state": state if joints else STATIC, "reason": moving.said,
            "bounds": moving.bounds, "joints": joints}  # fmt: skip
