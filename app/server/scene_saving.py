"""Saving an open scene, and a report on it, in worker processes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from app.server.jobs import CLICKS
from app.server.scene_report import ReportRow, write_report
from app.server.scene_rows import Row, Work
from app.server.scene_saving_tasks import Decided, MovingCopy, save_scene
from app.server.scene_state import SceneState
from app.server.scene_tasks import OpenedScene, SceneItem
from model.core.errors import CommandError
from model.core.names import link_display_name
from model.scenes.jobs import ACCEPTED, PREDICTED, REJECTED, TODO
from sessions import commands as cmd


class Saving:
    """Writes the scene, and the report on it.

    Args:
        row: returns an object as lists show it.
        why_refused: returns why an object wasn't accepted, or "".
    """

    def __init__(
        self,
        scene: SceneState,
        row: Callable[[SceneItem], Row],
        why_refused: Callable[[Work], str],
    ) -> None:
        self._scene, self._list_row, self._why_refused = scene, row, why_refused

    def save(self, loose: bool, who: str) -> None:
        """Write the scene.

        Args:
            loose: whether unreviewed predictions move, too.

        Raises:
            CommandError: where the scene is still being read, or its parts aren't ready.
        """
        scene = self._scene
        if "save" in scene.jobs:
            return
        opened, items, copies, decided = self._plan(loose)
        before, states = scene.document, {w: w.live.state for w in scene.wanted()}
        record = scene.record
        out = scene.services.workspace / "scenes" / f"saved-{record.id}"
        job = scene.services.workers.reading.submit(
            save_scene, record.path, opened.reader, tuple(i.obj.id for i in scene.read), items,
            copies, decided, out, on_progress=scene.jobs.progress("save"), priority=6,
            preempted_by=CLICKS,
        )  # fmt: skip

        def keep(summary: dict[str, Any]) -> None:
            now = scene.live.refresh().present
            if (now.articulable, now.picked) != (before.articulable, before.picked):
                raise CommandError("the scene was edited meanwhile: save it again")
            for work, state in states.items():
                moved = work.live.moved_since(state)
                reviews = state.present.review.state, work.document.review.state
                counts = work.item.copy in copies or {*reviews} & {ACCEPTED, REJECTED}
                if moved and counts:
                    raise CommandError(f"{work.item.obj.id}: {moved}. Save the scene again")
            scene.live.do(cmd.Saved(str(out)), who)
            moving = sum(summary["states"].get(s, 0) for s in (ACCEPTED, PREDICTED))
            scene.notify("Saved", f"{moving} objects move; {out}", "green")

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
            why = "it has no joints yet" if doc.tree is None else "nobody has reviewed it"
        return Decided(TODO, why)

    def _moving(self, work: Work, loose: bool) -> MovingCopy | None:
        doc, scene = work.document, self._scene
        state = doc.review.state
        if doc.tree is None or state not in (("accepted", "predicted") if loose else ("accepted",)):
            return None
        shape = None if work.item.path is None else scene.shapes.get(work.item.path)
        source = work.part_source(scene.services.workspace)
        if source is None or shape is None or isinstance(shape, str):
            raise CommandError(f"{work.item.obj.id} is still being prepared; save in a moment")
        folder = doc.saved.folder if state == "accepted" and doc.saved is not None else None
        reason = f"accepted by {doc.review.by}" if state == "accepted" else ""
        confidence = {} if doc.prediction is None else dict(doc.prediction.confidence)
        return MovingCopy(source, doc.tree, shape.bounds.tolist(), folder, confidence, reason)

    def report(self, done: Callable[[Path], None]) -> None:
        """Write the report; ``done`` gets the path of the page."""
        scene = self._scene
        if "report" in scene.jobs or scene.scene is None:
            return
        rows = [self._row(item) for item in scene.items.values()]
        record = scene.record
        path = scene.services.workspace / "scenes" / f"report-{record.id}" / f"{record.name}.html"
        job = scene.services.workers.reading.submit(
            write_report, path, scene.scene.name, tuple(rows), scene.scene.problems,
            dict(scene.shapes), scene.services.workspace,
            saved=None if scene.document.saved is None else Path(scene.document.saved.folder),
            on_progress=scene.jobs.progress("report"), priority=6, preempted_by=CLICKS,
        )  # fmt: skip
        scene.start("report", job, lambda _: done(path))
        scene.changed()

    def _row(self, item: SceneItem) -> ReportRow:
        scene, work = self._scene, self._scene.work(item.obj.id)
        row = self._list_row(item)
        doc = None if work is None else work.document
        source = None
        if work is not None and work.document.tree is not None:
            source = work.part_source(scene.services.workspace)
        notes = [] if work is None else [work.reason, self._why_refused(work)]
        notes.append(scene.missing_reason(item))
        return ReportRow(
            item, "on_hold" if row.shown == "on_hold" else row.status, row.confidence,
            scene.document.articulable.get(item.obj.id),
            None if doc is None else doc.tree,
            {} if doc is None or doc.prediction is None else dict(doc.prediction.confidence),
            {} if doc is None else {
                p.link: link_display_name(p.link, p.name, root=False) for p in doc.parts
            },
            "" if doc is None else doc.review.by, "" if doc is None else doc.review.at,
            "" if doc is None else (doc.review.reason or "").replace("_", " "),
            tuple(n for n in notes if n), source, None if work is None else work.id,
        )  # fmt: skip
