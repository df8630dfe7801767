"""An open scene's objects: their working copies, their assets as drawn, their rows in lists; and
saving them in worker processes.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from app.server.job import Job
from app.server.jobs import CLICKS
from app.server.object_context import Services
from app.server.observable import Observable, RunningJobs
from app.server.open_object import OpenObject
from app.server.scene_saving_tasks import Decided, MovingCopy, ReportRow, save_scene, write_report
from app.server.scene_tasks import DrawnParts, OpenedScene, SceneItem, Shape, placed
from model.core.asset import Source
from model.core.errors import CommandError, InputFileError
from model.core.files import free_name
from model.scenes.asset_parts import asset_digest
from model.scenes.jobs import ACCEPTED, PREDICTED, REJECTED, TODO
from sessions import commands as cmd
from sessions.document import Document
from sessions.store import ObjectRecord

Status = Literal["static", "todo", "predicted", "accepted", "rejected", "failed", "missing"]
HELD = "on hold"
"""Label of an object whose acceptance was refused."""
Shown = Status | Literal["validating", "on_hold"]
"""A status, or of an object to be accepted: being validated, or on hold."""
SHOWN: tuple[Shown, ...] = (
    "predicted",
    "on_hold",
    "todo",
    "validating",
    "rejected",
    "accepted",
    "static",
    "failed",
    "missing",
)
"""In the order of a reviewer's interest."""


class Work(OpenObject):
    """A working copy, which objects of the scene share; it is read once somebody opens it.

    Args:
        item: the first object with it.
        scene: the scene's file.
        ended: gets the kind of each of its jobs that ended.

    Attributes:
        ids: the objects in the scene.
        reason: why it is left for the annotator, or what failed, else "".
        prepared: whether its prediction was tried.
        drawn: its parts as the scene shows them, or None.
        undrawable: reference of labels whose parts couldn't be drawn, else "".
        failure: why its last acceptance failed, else "".
    """

    in_scene = True

    def __init__(
        self,
        record: ObjectRecord,
        services: Services,
        item: SceneItem,
        scene: Path,
        ended: Callable[[str], None],
    ) -> None:
        super().__init__(record, services)
        self.item, self._scene, self._job_ended = item, scene, ended
        self.ids: list[str] = []
        self.reason = self.undrawable = self.failure = ""
        self.prepared = False
        self.drawn: DrawnParts | None = None

    @property
    def id(self) -> int:
        """Id of its session."""
        return self.record.id

    @property
    def display_name(self) -> str:
        """See the base class."""
        return self.item.obj.id

    def read_source(self, document: Document) -> tuple[Path, Source] | None:
        """See the base class; the parts that the scene shows do as well as an open asset."""
        labels = None if document.segmentation is None else document.segmentation.labels
        if self.drawn is None or self.drawn.labels != labels:
            return super().read_source(document)
        return self.drawn.folder, self.drawn.source

    @property
    def scene_source(self) -> dict[str, Any]:
        """The asset, not its copy in the workspace."""
        obj, path = self.item.obj, self.item.path
        assert path is not None
        if path.is_relative_to(self.services.workspace / "scenes"):  # inside the scene's file
            path = self._scene
        sha256 = None
        with suppress(InputFileError):  # the file is gone
            sha256 = asset_digest(path)
        return {
            "path": str(path),
            "sha256": sha256,
            "scene": str(self._scene),
            "objects": list(self.ids),
            "asset": obj.asset or self.record.name,
            "scale": obj.scale.tolist(),
        }

    def release(self) -> None:
        """See the base class; it stays an object of the scene."""
        self.unload()

    def _ended(self, what: str, job: Job[Any], keep: Callable[[Any], None]) -> None:
        if what == "save":
            self.failure = "" if job.error is None else str(job.error)
        super()._ended(what, job, keep)
        self._job_ended(what)


def names_for(items: Iterable[SceneItem], works: Iterable[Work]) -> list[str]:
    """Return a name for each new working copy, after its asset; another size is ``kettle_2``."""
    taken, out = {work.record.name for work in works}, []
    for item in items:
        stem = "object" if item.copy is None else item.copy.name.rpartition("-")[0]
        out.append(free_name(stem, taken))
        taken.add(out[-1])
    return out


@dataclass(frozen=True)
class Row:
    """One object as lists show it.

    Attributes:
        status: its state by the decisions.
        confidence: of the prediction's least confident joint; of the finder where there is none.
        mark: "validating" while an acceptance is under way, "on_hold" after a refusal; else "".
    """

    id: str
    status: Status
    confidence: float
    work: int | None
    mark: Literal["", "validating", "on_hold"] = ""

    @property
    def shown(self) -> Shown:
        """The state as lists show it."""
        return self.mark or self.status

    @property
    def undecided(self) -> bool:
        """True while it waits for a person's decision."""
        return self.mark != "validating" and self.status in ("predicted", "todo")


def drawn_labels(work: Work) -> str | None:
    """Return the labels of the drawn parts, or None."""
    return None if work.drawn is None else work.drawn.labels


def order(rows: Sequence[Row]) -> list[str]:
    """Return the ids in the order of a review: undecided ones, lowest confidence first."""
    return [r.id for r in rows if r.undecided]


class SceneState(Observable):
    """The scene as its saving, accepting and picking see it.

    Attributes:
        scene: None until it is read.
        read: the objects of the scene's file.
        items: id → object, those that were picked out of others among them.
        shapes: asset → its geometry as drawn, or why there is none.
        works: session id → working copy.
        lock: held while decisions are recorded, and jobs begin and end.
    """

    def __init__(self, services: Services, path: Path) -> None:
        super().__init__()
        self.services = services
        self.path = path
        self.record = services.store.open_object(path, None, path.stem)
        self.live = services.hub.session(self.record.id)
        self.scene: OpenedScene | None = None
        self.read: tuple[SceneItem, ...] = ()
        self.items: dict[str, SceneItem] = {}
        self.shapes: dict[Path, Shape | str] = {}
        self.works: dict[int, Work] = {}
        self.jobs = RunningJobs("the scene", self.changed)
        self.lock = threading.RLock()
        self._work_of: dict[Path, Work] = {}

    @property
    def document(self) -> Document:
        """The present decisions about the scene."""
        return self.live.state.present

    def articulable(self, item: SceneItem) -> bool:
        """True if the object is to be articulated, by a person's decision, else by the finder's."""
        decided = self.document.articulable.get(item.obj.id)
        return item.decision.articulable if decided is None else decided

    def work(self, id: str) -> Work | None:
        """Return the working copy of an object; None where it isn't articulated."""
        item = self.items.get(id)
        if item is None or item.copy is None or not self.articulable(item):
            return None
        return self._work_of.get(item.copy)

    def wanted(self) -> Iterable[Work]:
        """Return the working copies of the articulable objects, in the scene's order."""
        return [w for w in self.works.values() if any(self.work(i) is w for i in w.ids)]

    def twins(self, id: str) -> list[str]:
        """Return the objects that share a decision with ``id``: same asset and size; itself too."""
        work = self.work(id)
        if work is None:
            return [id]
        return [i for i in work.ids if self.articulable(self.items[i])]

    def missing_reason(self, item: SceneItem) -> str:
        """Return why an object isn't shown, or ""."""
        if item.obj.box is not None:
            return ""
        if item.problem:
            return item.problem
        if item.path is None:
            named = item.obj.asset
            return f"asset {named!r} is in none of the folders" if named else "it names no asset"
        shape = self.shapes.get(item.path)
        return shape if isinstance(shape, str) else ""

    def world_from_copy(self, item: SceneItem) -> npt.NDArray[np.float64] | None:
        """Return the (4, 4) pose of the working copy at its size; None before it is drawn."""
        found = placed(item, self.shapes) if item.path is not None else None
        return None if found is None else found[1]

    def start(
        self,
        kind: str,
        job: Any,
        keep: Callable[[Any], None],
        progress: tuple[float, str] = (0.0, ""),
        work: Work | None = None,
        files: Sequence[Path] = (),
    ) -> None:
        """Follow a job; ``keep`` gets its result. Failures are shown, and written into ``work``.

        Args:
            files: what it reads, one after the other: the one that it doesn't come to the end of
                is named.
        """
        self.jobs.add(
            kind, job, lambda ended: self._ended(kind, ended, keep, work, files), progress
        )

    _ended: Callable[[str, Job[Any], Callable[[Any], None], Work | None, Sequence[Path]], None]


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
    ) -> tuple[OpenedScene, tuple[SceneItem, ...], dict[Path, MovingCopy], dict[str, Decided]]:
        scene = self._scene
        if scene.scene is None:
            raise CommandError("the scene is still being read")
        copies: dict[Path, MovingCopy] = {}
        for work in scene.wanted():
            found = self._moving(work, loose)
            if found is not None and work.item.copy is not None:
                copies[work.item.copy] = found
        items = [
            replace(
                i,
                copy=i.copy if scene.articulable(i) else None,
                decision=replace(i.decision, articulable=scene.articulable(i)),
            )
            for i in scene.items.values()
        ]
        decided = {
            i: self._decided(w, w.item.copy in copies)
            for w in scene.wanted()
            for i in w.ids
            if scene.work(i) is w  # a twin may be static
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
        if work.read_source(doc) is None or shape is None or isinstance(shape, str):
            raise CommandError(f"{work.item.obj.id} is still being prepared; save in a moment")
        return MovingCopy(work.source(doc), doc, shape.bounds.tolist())

    def report(self, done: Callable[[Path], None]) -> None:
        """Write the report; ``done`` gets the path of the page."""
        scene = self._scene
        if "report" in scene.jobs or scene.scene is None:
            return
        rows = [self._row(item) for item in scene.items.values()]
        record = scene.record
        path = scene.services.workspace / "scenes" / f"report-{record.id}" / f"{record.name}.html"
        job = scene.services.workers.reading.submit(
            write_report,
            path,
            scene.scene.name,
            tuple(rows),
            scene.scene.problems,
            dict(scene.shapes),
            scene.services.workspace,
            saved=None if scene.document.saved is None else Path(scene.document.saved.folder),
            on_progress=scene.jobs.progress("report"),
            priority=6,
            preempted_by=CLICKS,
        )
        scene.start("report", job, lambda _: done(path))
        scene.changed()

    def _row(self, item: SceneItem) -> ReportRow:
        scene, work = self._scene, self._scene.work(item.obj.id)
        row, doc = self._list_row(item), None if work is None else work.document
        source = None
        if work is not None and doc is not None and doc.tree and work.read_source(doc):
            source = work.source(doc)
        notes = [] if work is None else [work.reason, self._why_refused(work)]
        notes.append(scene.missing_reason(item))
        return ReportRow(
            item,
            "on_hold" if row.shown == "on_hold" else row.status,
            row.confidence,
            scene.document.articulable.get(item.obj.id),
            doc,
            tuple(n for n in notes if n),
            source,
            row.work,
        )
