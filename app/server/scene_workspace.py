"""An open scene: the state of its objects and the jobs they need.

One :class:`SceneWorkspace` a server. Decisions live in sessions: the scene's own (what is
articulated, decisions for several objects) and one for each working copy
(:mod:`app.server.scene_tasks`), which is an object like any other and may be opened, annotated and
accepted as such.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from app.server import scene_tasks
from app.server.gallery import Gallery, confidence
from app.server.job import Job, OutOfTimeError, WorkerDied
from app.server.jobs import CLICKS
from app.server.object_context import Services
from app.server.observable import Notice
from app.server.scene_accepting import Accepting
from app.server.scene_picking import Picking
from app.server.scene_state import (
    SHOWN,
    Row,
    Saving,
    SceneState,
    Status,
    Work,
    drawn_labels,
    names_for,
)
from app.server.scene_tasks import DrawnParts, OpenedScene, Prepared, SceneItem, Shape
from app.server.tasks import ReadOptions
from app.server.workers import READ_CANCELLED, READ_SECONDS, too_slow
from model.core.errors import CommandError
from model.core.progress import Cancelled
from sessions import commands as cmd
from sessions.document import Document
from sessions.review import ReviewRecord
from sessions.scene_commands import DecideObjects, PickOut, SetArticulable
from sessions.state import SessionState
from sessions.store import ObjectRecord

AUTHOR = "scene"
"""Recorded as the author of automatic results."""
MAX_SCENE_FACES = 900_000
"""Triangles of a whole scene that a browser draws smoothly."""
MAX_ASSET_FACES = 60_000
"""Triangles of one asset in it."""
MIN_ASSET_FACES = 1500
"""Triangles of one asset in a scene of very many."""


class SceneWorkspace(SceneState):
    """The scene of a server, shared by all its tabs."""

    def __init__(
        self,
        services: Services,
        path: Path,
        folders: tuple[Path, ...],
        format: str | None,
    ) -> None:
        super().__init__(services, path)
        self.problem: str | None = None
        self.paused = False
        self._stopped: set[Path] = set()  # assets that weren't read to their end
        self._preferred: int | None = None
        self._closed = False
        self._max_faces = MAX_SCENE_FACES
        self.accepting = Accepting(self)
        self.saving = Saving(self, self.row, self.accepting.why_refused)
        self.picking = Picking(self)
        self.live.subscribe(self._decided)
        self._folders, self._format = folders, format
        self._read()

    def _read(self) -> None:
        config = self.services.config
        job = self.services.workers.reading.submit(
            scene_tasks.read, self.path, self._folders, self._format, config.finder,
            config.finder_url, self.services.workspace, on_progress=self.jobs.progress("read"),
            priority=8, preempted_by=CLICKS, most_seconds=READ_SECONDS,
        )  # fmt: skip
        self.start("read", job, self._opened, files=(self.path,))

    def cancel(self) -> None:
        """Stop reading: the scene, the asset at hand, or a working copy."""
        for kind in ("read", "shapes", "copy"):
            self.jobs.cancel(kind)

    @property
    def can_try_again(self) -> bool:
        """True if reading the scene or one of its assets failed or was stopped."""
        return self.problem is not None or bool(self._stopped)

    def try_again(self) -> None:
        """Read again what failed or was stopped."""
        if self.problem is not None:
            self.problem = None
            self._read()
        self.shapes = {p: s for p, s in self.shapes.items() if p not in self._stopped}
        self._stopped.clear()
        for work in self.works.values():
            work.prepared = work.prepared and work.item.path in self.shapes
        self.go_on()

    # --- the state of each object

    @property
    def busy(self) -> dict[str, tuple[float, str]]:
        """Progress (0..1) and message of each running job."""
        return {**self.accepting.busy, **self.jobs.busy}

    def status(self, item: SceneItem) -> Status:
        """Return the state of an object."""
        if item.obj.box is None and self.missing_reason(item):
            return "missing" if item.path is None and not item.problem else "failed"
        work = self.work(item.obj.id)
        if work is None:
            return "static"
        state = work.document.review.state
        if state in ("todo", "in_progress"):
            return "todo"
        return "predicted" if state == "submitted" else state

    def row(self, item: SceneItem) -> Row:
        """Return one object as lists show it."""
        status, work = self.status(item), self.work(item.obj.id)
        known = work is not None and work.document.tree is not None
        certainty = confidence(work.document) if work and known else item.decision.confidence
        mark = "" if work is None else self.accepting.mark(work)
        return Row(item.obj.id, status, certainty, None if work is None else work.id, mark)

    def rows(self) -> list[Row]:
        """Return all objects: those to decide first, the least confident of them before others."""
        rows = [self.row(item) for item in self.items.values()]
        return sorted(rows, key=lambda r: (SHOWN.index(r.shown), r.confidence))

    # --- decisions

    def do(self, command: cmd.Command, who: str, notice: Notice | None = None) -> None:
        """Carry out one decision about the scene; it is on disk when this returns.

        Args:
            notice: gets the outcome of a decision about objects; all tabs where it is None.
        """
        if isinstance(command, DecideObjects) and notice is not None:
            self.accepting.expect(command, who, notice)
        self.live.do(command, who)

    def undo(self, who: str) -> str:
        """Undo the last decision about the scene that had an effect.

        A refused acceptance had none. Returns what was undone, in a few words, or "".
        """
        while self.live.state.can_undo:
            now, before = self.document, self.live.state.past[-1]
            gone = now.decided[len(before.decided) :]
            self.do(cmd.Undo(), who)
            if not gone:
                return now.label
            if not self.accepting.had_no_effect(gone[-1]):
                return self.accepting.describe(gone[-1])
        return ""

    def set_articulable(self, id: str, articulable: bool, who: str) -> None:
        """Decide whether an object is articulable, whatever the finder decided."""
        item = self.items[id]
        if item.path is None:
            raise CommandError(self.missing_reason(item) or "a plain box has no asset")
        same = articulable == item.decision.articulable
        self.do(SetArticulable(id, None if same else articulable), who)

    def prefer(self, id: str | None) -> None:
        """Predict this object next, or check one on hold again: somebody selected it."""
        work = None if id is None else self.work(id)
        if work is not None and work.hold_reason and work.read_source(work.document):
            work.validation.update()
        self._preferred = None if work is None else work.id

    def open_work(self, id: str, done: Callable[[Work], None]) -> None:
        """Call ``done`` as soon as the working copy of an object can be opened."""
        work = self.work(id)
        if work is None:
            raise CommandError("it is static: mark it as articulable first")
        if work.item.copy is not None and (work.item.copy / "object.json").is_file():
            done(work)
            return
        job = self.services.workers.read(
            scene_tasks.make_working_copy, work.item, priority=8, most_seconds=READ_SECONDS
        )
        files = (work.item.path or work.item.copy or self.path,)
        self.start("copy", job, lambda _: done(work), files=files)
        self.changed()

    # --- opening

    def _opened(self, scene: OpenedScene) -> None:
        self.read = scene.items
        paths = {item.path for item in scene.items if item.path is not None}
        self._max_faces = int(
            np.clip(MAX_SCENE_FACES / max(1, len(paths)), MIN_ASSET_FACES, MAX_ASSET_FACES)
        )
        self._arrange()
        self.scene = scene  # last: tabs show its objects from here on
        with self.lock:
            self.accepting.resume()
        self.go_on()

    def close(self) -> None:
        """Start no more jobs: the workers end."""
        self._closed = True

    def _arrange(self) -> None:
        """Bring the objects up to date with the scene's session."""
        with self.lock:
            self.items = self.picking.arranged(self.read)
            for work in self.works.values():
                work.ids = [i for i, item in self.items.items() if item.copy == work.item.copy]
        self._find_works()

    def _find_works(self) -> None:
        """Open a session for each required working copy that has none yet."""
        with self.lock:
            wanted: dict[Path, SceneItem] = {}
            for item in self.items.values():
                if item.copy is not None and self.articulable(item):
                    wanted.setdefault(item.copy, item)
            fresh = [item for copy, item in wanted.items() if copy not in self._work_of]
            names = names_for(fresh, self.works.values())
            records = self.services.store.open_objects(
                (item.copy, None, name)
                for item, name in zip(fresh, names, strict=True)
                if item.copy
            )
            for item, record in zip(fresh, records, strict=True):
                assert item.copy is not None
                work = Work(record, self.services, item, self.path, self._work_ended)
                work.ids = [i.obj.id for i in self.items.values() if i.copy == item.copy]
                self.works[work.id] = self._work_of[item.copy] = work
                work.live.subscribe(lambda state, command: self.go_on())

    def _decided(self, state: SessionState, command: cmd.Command) -> None:
        here = self.live.issued_here(state.seq)
        if not here:
            self.notify_remote_change()
        if self.scene is None:
            return
        if isinstance(command, (SetArticulable, PickOut, cmd.Undo, cmd.Redo)):
            self._arrange()
        with self.lock:
            self.accepting.update(state.present.decided, here=here)
        self.go_on()

    # --- jobs

    def go_on(self) -> None:
        """Start the next jobs, one of a kind at a time, and redraw."""
        if self.scene is not None and not self._closed:
            with self.lock:
                self._draw_shapes()
                self._draw_parts()
                self._prepare()
                self.accepting.go_on()
        self.changed()

    def _draw_shapes(self) -> None:
        if "shapes" in self.jobs:
            return
        paths = [i.path for i in self.items.values() if i.path and i.path not in self.shapes]
        chosen = self.works.get(self._preferred or -1)
        paths = sorted(dict.fromkeys(paths), key=lambda p: chosen is None or p != chosen.item.path)
        if not paths:
            return
        done = 1 - len(paths) / len({i.path for i in self.items.values() if i.path})
        report = self.jobs.progress("shapes")
        job = self.services.workers.reading.submit(
            scene_tasks.shapes,
            paths,
            self.services.workspace,
            self._max_faces,
            on_progress=lambda fraction, message: report(done + (1 - done) * fraction, message),
            priority=7,
            preempted_by=CLICKS,
            most_seconds=READ_SECONDS,
        )

        def keep(made: Mapping[Path, Shape | str]) -> None:
            self.shapes = {**self.shapes, **made}

        self.start("shapes", job, keep, (done, ""), files=paths)

    def _draw_parts(self) -> None:
        if "parts" in self.jobs:
            return
        for work in self.wanted():
            doc = work.document
            ref = None if doc.segmentation is None else doc.segmentation.labels
            if doc.tree is None or ref in (None, work.undrawable, drawn_labels(work)):
                continue
            assert work.item.copy is not None
            job = self.services.workers.geometry.submit(
                scene_tasks.drawn_parts,
                work.item.copy,
                self.services.workspace,
                ref,
                self._max_faces,
                _options(doc),
                priority=4,
            )

            def keep(drawn: DrawnParts, work: Work = work) -> None:
                work.drawn = drawn

            self.start("parts", job, keep, work=work)
            return

    def _prepare(self) -> None:
        if "prepare" in self.jobs or self.paused:
            return
        works = list(self.wanted())
        waiting = [w for w in works if not w.prepared and w.document.tree is None]
        # What can't be read is found out where no click waits for it.
        for work in waiting:
            shape = self.shapes.get(work.item.path) if work.item.path else None
            if isinstance(shape, str):
                work.prepared, work.reason = True, shape
        waiting = [w for w in waiting if not w.prepared and w.item.path in self.shapes]
        if not waiting:
            return
        work = next((w for w in waiting if w.id == self._preferred), waiting[0])
        job = self.services.workers.prediction.submit(
            scene_tasks.prepare,
            work.item,
            self.services.workspace,
            self.services.config.segmenter,
            self.services.predictor,
            priority=-5,
            preempted_by=0,
            most_seconds=READ_SECONDS,
        )

        def keep(prepared: Prepared) -> None:
            work.prepared, work.reason = True, prepared.reason
            self._record(work, prepared)

        done = 1 - len(waiting) / len(works)
        files = (work.item.path or self.path,)
        self.start("prepare", job, keep, (done, work.item.obj.id), work, files)

    def _record(self, work: Work, prepared: Prepared) -> None:
        """Record what was found as commands, unless a person was first."""
        if prepared.labels is None or work.live.refresh().seq:
            return
        do = work.live.do
        for part, name in prepared.names:
            do(cmd.AddPart(part, name) if part else cmd.NamePart(0, name), AUTHOR)
        for click in prepared.clicks:
            do(cmd.AddClick(click), AUTHOR)
        for part, ref, count in prepared.regions:
            do(cmd.AddRegion(part, ref, True, count, "source"), AUTHOR)
        if work.item.category:
            do(cmd.SetCategory(work.item.category[:80]), AUTHOR)
        do(
            cmd.RecordSegmentation(
                work.document.key,
                prepared.labels,
                prepared.segmenter,
                prepared.seconds,
                dict(prepared.counts),
            ),
            AUTHOR,
        )
        if prepared.prediction is not None:
            do(cmd.RecordPrediction(prepared.prediction, prepared.labels), AUTHOR)

    def _work_ended(self, kind: str) -> None:
        if kind == "save":
            self.live.refresh()  # another server may have undone the decision just now
        if kind in ("check", "save"):
            self.go_on()

    def pause(self, paused: bool) -> None:
        """Stop predicting more objects, or go on."""
        self.paused = paused
        if paused:
            self.jobs.cancel("prepare")
        self.go_on()

    def _ended(
        self,
        kind: str,
        job: Job[Any],
        keep: Callable[[Any], None],
        work: Work | None,
        files: Sequence[Path],
    ) -> None:
        with self.lock:  # no undo while a result is recorded
            error = self.jobs.deliver(kind, job, keep)
        at = _stopped_at(job, files)
        if isinstance(error, Cancelled):
            if at is not None and kind in ("read", "shapes"):
                self._failed(kind, READ_CANCELLED, work, at)
        elif isinstance(error, OutOfTimeError) and at is not None and kind != "prepare":
            self._failed(kind, too_slow(at.name), work, at)
        elif error is not None:
            self._failed(kind, str(error) if at is None else f"{at.name}: {error}", work, at)
        # Only now: recording the result must not start the same job again.
        self.jobs.drop(kind, job)
        self.go_on()

    def _failed(self, kind: str, message: str, work: Work | None, at: Path | None) -> None:
        if kind == "read":
            self.problem = message
        elif kind == "prepare" and work is not None:
            work.prepared, work.reason = True, message
        else:
            if kind == "parts" and work is not None and work.document.segmentation is not None:
                work.undrawable = work.document.segmentation.labels
            if kind == "shapes":
                left = {i.path for i in self.items.values() if i.path} - set(self.shapes)
                if at is not None:
                    left = {at}
                    self._stopped.add(at)
                self.shapes = {**self.shapes, **dict.fromkeys(left, message)}
            self.notify("Failed", message, "red")


_BLANK = ObjectRecord(0, Path(), "", None, "todo", 0, 0, None, "", "", "", None, 0)


class SceneGallery(Gallery):
    """The objects of a scene as a queue, those to decide first; ids are places in the scene."""

    def __init__(self, scene: SceneWorkspace) -> None:
        super().__init__(
            scene.services, lambda r: self._rows[r.id].confidence, self._state, self._marked
        )
        self._scene = scene
        self._rows: dict[int, Row] = {}
        self._known: tuple[Any, list[ObjectRecord]] = None, []

    def records(self) -> list[ObjectRecord]:
        """See the base class; made anew where something changed."""
        rows = self._scene.rows()
        now = rows, [work.state.seq for work in self._scene.works.values()]
        if now != self._known[0]:
            places = {id: k for k, id in enumerate(self._scene.items)}
            self._rows = {places[r.id]: r for r in rows if r.id in places}
            self._known = now, [self._record(place, row) for place, row in self._rows.items()]
        return self._known[1]

    def _record(self, place: int, row: Row) -> ObjectRecord:
        item, work = self._scene.items[row.id], self._scene.work(row.id)
        review = ReviewRecord() if work is None else work.document.review
        path = item.path if work is None or work.drawn is None else item.copy
        return replace(
            _BLANK,
            id=place,
            path=path or Path(),
            name=row.id,
            state=cast(Any, row.shown),
            category=item.category,
            who=review.by.replace(AUTHOR, ""),
            updated=review.at,
            seq=0 if work is None else work.state.seq,
        )

    def sessions(self, ids: Sequence[int]) -> list[int]:
        """See the base class: instances share one, static objects have none."""
        found = [self._rows[i].work for i in ids if i in self._rows]
        return list(dict.fromkeys(i for i in found if i is not None))

    def names(self, records: Sequence[ObjectRecord]) -> dict[int, str]:
        """See the base class."""
        return {r.id: r.name for r in records}

    def text(self, record: ObjectRecord, name: str) -> str:
        """See the base class."""
        return f"{super().text(record, name)} {self._scene.items[record.name].obj.description}"

    def passed(self, record: ObjectRecord) -> bool | None:
        """True: a scene's objects are checked once they are accepted."""
        return True

    def _key(self, sort: str, names: dict[int, str]) -> Callable[[ObjectRecord], Any] | None:
        return None if sort in ("", "order") else super()._key(sort, names)

    def _state(self, record: ObjectRecord) -> tuple[str, str]:
        work = self._scene.work(record.name)
        why = "" if work is None else self._scene.accepting.why_refused(work)
        return self._rows[record.id].shown, why

    def _marked(self) -> dict[int, tuple[str, str]]:
        return {
            r.id: self._state(r) for r in self.records() if r.state in ("validating", "on_hold")
        }


def _stopped_at(job: Job[Any], files: Sequence[Path]) -> Path | None:
    """The file that a job was reading when its time was up, it was stopped, or its process died;
    None where it ended by itself."""
    stopped = isinstance(job.error, (OutOfTimeError, WorkerDied)) or job.state == "cancelled"
    if not stopped or not files:
        return None
    return files[min(round(job.fraction * len(files)), len(files) - 1)]


def _options(doc: Document) -> ReadOptions:
    """Return what a person left out and cut; the frame is the scene's own."""
    left_out = None if doc.left_out is None else doc.left_out.elements
    return ReadOptions(left_out=left_out, face_cuts=doc.face_cuts)
