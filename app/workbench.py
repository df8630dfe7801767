"""The objects that are open, the jobs they ask for, and who looks at them.

One :class:`Workbench` a server; one :class:`OpenObject` an object, shared by all the tabs that show
it. Decisions live in the session's commands; this module runs the jobs that the state asks for and
feeds their answers back as commands.
"""

from __future__ import annotations

import hashlib
import logging
import re
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app import tasks
from app.config import ServeConfig
from app.jobs import Job, WorkerProcess
from model.errors import ArtiworldError, CommandError, InputFileError
from model.kinematics.tree import KinematicTree
from model.predictors import DEFAULT as DEFAULT_PREDICTOR
from model.progress import Cancelled
from model.remote.http_predictor import BackendError
from model.segmentation.prompts import Click
from sessions import commands as cmd
from sessions.live import LiveSession, SessionHub
from sessions.provenance import provenance
from sessions.state import Context, Document, SessionState, acceptance_problems, apply, needed_jobs
from sessions.store import ObjectRecord, Store

log = logging.getLogger(__name__)
Listener = Callable[[], None]
Notice = Callable[[str, str, str], None]
TOOL_SECONDS = 120.0


class Workbench:
    """Workers, store and open objects of one server."""

    def __init__(self, config: ServeConfig, store: Store, paths: list[Path]) -> None:
        self.config = config
        self.store = store
        self.hub = SessionHub(store)
        self.workspace = Path(config.workspace)
        self.geometry = WorkerProcess("geometry")
        self.segmentation = WorkerProcess("segmentation")
        self.prediction = WorkerProcess("prediction")
        self._lock = threading.RLock()
        self._open: dict[int, OpenObject] = {}
        self._queue_listeners: list[Listener] = []
        self._ids: list[int] = []
        self._records: dict[int, ObjectRecord] = {}
        self.add_paths(paths)

    def add_paths(self, paths: list[Path]) -> list[int]:
        """Put files or folders into the queue; returns their object ids."""
        records = self.store.open_objects((p, None, p.stem) for p in paths)
        ids = [r.id for r in records]
        with self._lock:
            self._ids = list(dict.fromkeys([*self._ids, *ids]))
            self._records.update({r.id: r for r in records})
        self._tell_queue()
        return ids

    def add_upload(self, name: str, content: bytes) -> int:
        """Keep a file that a browser sent, under its content's digest; its object id.

        Raises:
            InputFileError: where no reader knows the suffix, or nothing is in it.
        """
        from app.upload_guard import plain_name
        from model.geometry.readers import SUFFIXES

        safe = plain_name(name)
        if Path(safe).suffix.lower() not in SUFFIXES:
            known = ", ".join(sorted(SUFFIXES))
            raise InputFileError(safe, "this kind of file can't be opened", f"give one of {known}")
        if not content:
            raise InputFileError(safe, "the file is empty", "choose one with a mesh or points")
        folder = self.workspace / "uploads" / hashlib.sha256(content).hexdigest()[:16]
        folder.mkdir(parents=True, exist_ok=True)
        path, part = folder / safe, folder / f".{safe}.part"
        if not path.exists():
            part.write_bytes(content)
            part.rename(path)
        return self.add_paths([path])[0]

    def records(self) -> list[ObjectRecord]:
        """The queue: objects of this run, in the order they were given."""
        with self._lock:
            return [self._records[i] for i in self._ids]

    def object(self, object_id: int) -> OpenObject:
        """The shared view of an object; opens it on first use."""
        with self._lock:
            if object_id not in self._open:
                self._open[object_id] = OpenObject(self, self.store.object(object_id))
            opened = self._open[object_id]
        opened.ensure_open()
        return opened

    def on_queue(self, listener: Listener) -> Callable[[], None]:
        """Call ``listener`` when a state in the queue changes. Returns its removal."""
        self._queue_listeners.append(listener)

        def stop() -> None:
            if listener in self._queue_listeners:
                self._queue_listeners.remove(listener)

        return stop

    def queue_changed(self, object_id: int) -> None:
        """Tell all tabs that an object stands elsewhere now."""
        record = self.store.object(object_id)
        with self._lock:
            before, self._records[object_id] = self._records.get(object_id), record
        if before is None or before.state != record.state:
            self._tell_queue()

    def _tell_queue(self) -> None:
        for listener in list(self._queue_listeners):
            listener()

    def close(self) -> None:
        """End the workers."""
        for worker in (self.geometry, self.segmentation, self.prediction):
            worker.close()


class OpenObject:
    """One object as all its tabs see it: asset, session, labels, running jobs."""

    def __init__(self, bench: Workbench, record: ObjectRecord) -> None:
        self.bench = bench
        self.record = record
        self.live: LiveSession = bench.hub.session(record.id)
        self.asset: tasks.OpenedAsset | None = None
        self.problem: str | None = None
        self.backend_away = False
        self.busy: dict[str, tuple[float, str]] = {}
        self.labels: npt.NDArray[np.int16] | None = None
        self.payloads: dict[str, list[tasks.PartPayload]] = {}
        self.checks: list[tasks.JointCheck] = []
        self._labels_ref: str | None = None
        self._checked: tuple[KinematicTree, str] | None = None
        self._frame: tuple[Any, float] | None = None
        self._jobs: dict[str, Job[Any]] = {}
        self._lock = threading.RLock()
        self._listeners: list[Listener] = []
        self._notices: list[Notice] = []
        self.live.subscribe(lambda state, command: self._state_changed())

    # --- who looks

    def watch(self, listener: Listener, notice: Notice) -> Callable[[], None]:
        """Call ``listener`` on every change, ``notice(title, body, colour)`` with news."""
        self._listeners.append(listener)
        self._notices.append(notice)

        def stop() -> None:
            if listener in self._listeners:
                self._listeners.remove(listener)
                self._notices.remove(notice)

        return stop

    def changed(self) -> None:
        """Redraw in all the tabs."""
        for listener in list(self._listeners):
            listener()

    def tell(self, title: str, body: str, color: str = "blue") -> None:
        """Show a note in all the tabs."""
        for notice in list(self._notices):
            notice(title, body, color)

    # --- state

    @property
    def state(self) -> SessionState:
        """The session's state."""
        return self.live.state

    @property
    def document(self) -> Document:
        """What is decided now."""
        return self.live.state.present

    def do(self, command: cmd.Command, who: str) -> SessionState:
        """Carry out one user decision; it is on disk when this returns."""
        return self.live.do(command, who)

    @property
    def segmenting(self) -> bool:
        """Whether the shown labels lag behind the prompts."""
        return "segment" in self._jobs

    @property
    def predicting(self) -> bool:
        """Whether a prediction is under way."""
        return "predict" in self._jobs

    def source(self, document: Document | None = None) -> tasks.PartSource:
        """The parts of the document as the workers cut them.

        Raises:
            CommandError: where nothing is segmented yet.
        """
        doc = document or self.document
        if self.asset is None or doc.segmentation is None:
            raise CommandError("no part is there yet: click on a part that moves")
        names = {p.id: p.name for p in doc.parts if p.name}
        return tasks.PartSource(
            self.asset.folder,
            self.bench.workspace,
            doc.segmentation.labels,
            names,
            doc.category,
            self.asset.name,
        )

    # --- opening

    def ensure_open(self) -> None:
        """Read the asset in the background unless it is read or being read."""
        with self._lock:
            doc = self.document
            frame = (doc.up_axis, doc.unit_scale)
            if "open" in self._jobs or (self.asset is not None and self._frame == frame):
                return
            if self.problem is not None and self._frame == frame:
                return
            self._frame, self.problem = frame, None
            self.asset, self.labels, self._labels_ref = None, None, None
            self.payloads.clear()
            config = self.bench.config
            options = tasks.ReadOptions(
                doc.up_axis or config.up_axis, doc.unit_scale * config.unit_scale
            )
            job = self.bench.geometry.submit(
                tasks.open_asset,
                Path(self.record.path),
                self.bench.workspace / "cache",
                options,
                on_progress=self._progress("open"),
                priority=5,
            )
            self._start("open", job, self._opened)

    def _opened(self, asset: tasks.OpenedAsset) -> None:
        with self._lock:
            self.asset = asset
        if self.state.seq == 0:
            if asset.has_parts:
                self._take_source_parts(asset)
            if asset.category:
                self.do(cmd.SetCategory(asset.category), "source file")
        for warning in asset.warnings:
            self.tell("Opened with a remark", warning, "yellow")
        self.bench.geometry.submit(tasks.prepare_picking, asset.folder)
        self.prepare()
        self._state_changed()

    def prepare(self) -> None:
        """Encode the asset for the segmenter before the first click needs it."""
        if self.asset is None or "encode" in self._jobs:
            return
        job = self.bench.segmentation.submit(
            tasks.encode,
            self.asset.folder,
            self.bench.config.segmenter,
            on_progress=self._progress("encode"),
        )
        self._start("encode", job, lambda _: None)

    def _take_source_parts(self, asset: tasks.OpenedAsset) -> None:
        """Parts that the source file was cut into become regions, which the person can edit."""
        regions = self.bench.geometry.submit(
            tasks.source_regions, asset.folder, self.bench.workspace
        ).result(120)
        for part, (ref, count) in regions.items():
            name = asset.part_names[part] if part < len(asset.part_names) else None
            if part:
                self.do(cmd.AddPart(part, name), "source file")
                self.do(cmd.AddRegion(part, ref, True, count, "source"), "source file")
            elif name:
                self.do(cmd.NamePart(0, name), "source file")

    # --- jobs that the state asks for

    def _state_changed(self) -> None:
        self.ensure_open()
        if self.asset is not None:
            self._ask_labels()
            self._ask_checks()
        self.bench.queue_changed(self.record.id)
        self.changed()

    def use_tool(self, tool: str, part: int, who: str, turn: int = 0) -> int:
        """Let a segmentation tool work on ``part``; the number of regions that came of it."""
        if self.asset is None:
            raise CommandError("the object is still being read")
        if tool == "next mask":
            self._take_back(tool, part, who)
        doc = self.document
        offers = self.bench.segmentation.submit(
            tasks.use_tool,
            self.asset.folder,
            self.bench.workspace,
            self.bench.config.segmenter,
            _stored(doc),
            part,
            tool,
            turn,
            priority=12,
        ).result(TOOL_SECONDS)
        name = doc.part_names.get(part) if tool == "same shape" else None
        for offer in offers:
            target = offer.part
            if target < 0:
                target = max((p.id for p in self.document.parts), default=0) + 1
                self.do(cmd.AddPart(target, name), who)
            region = cmd.AddRegion(target, offer.elements, offer.positive, offer.count, tool)
            self.do(region, who)
        return len(offers)

    def _take_back(self, tool: str, part: int, who: str) -> None:
        """Remove what ``tool`` said last of ``part``, so that it can say something else."""
        while self.document.prompts:
            last = self.document.prompts[-1]
            if isinstance(last, Click) or (last.tool, last.part) != (tool, part):
                return
            self.do(cmd.RemovePrompt(len(self.document.prompts) - 1), who)

    def _ask_labels(self) -> None:
        doc, asset = self.document, self.asset
        assert asset is not None
        key = doc.key
        record = doc.segmentation
        if needed_jobs(self.state):
            job = self.bench.segmentation.submit(
                tasks.segment,
                asset.folder,
                self.bench.workspace,
                self.bench.config.segmenter,
                _stored(doc),
                key,
                asset.element,
                on_progress=self._progress("segment"),
                priority=10,
                key=("segment", self.record.id),
            )
            self._start("segment", job, self._segmented)
            return
        ref = record.labels if record is not None and doc.prompts else None
        with self._lock:
            if ref == self._labels_ref and (ref is None) == (self.labels is None):
                return
            if ref is None:
                self.labels, self._labels_ref = None, None
                return
        job = self.bench.segmentation.submit(
            tasks.display_labels, self.bench.workspace, ref, asset.element, priority=9
        )
        self._start("labels", job, lambda labels: self._show_labels(ref, labels))

    def _segmented(self, answer: tasks.SegmentationAnswer) -> None:
        self._show_labels(answer.labels, answer.display_labels)
        self.do(
            cmd.RecordSegmentation(
                answer.prompts_key, answer.labels, answer.segmenter, answer.seconds, answer.counts
            ),
            "segmenter",
        )

    def _show_labels(self, ref: str, labels: npt.NDArray[np.int16]) -> None:
        with self._lock:
            self._labels_ref, self.labels = ref, labels

    def _ask_checks(self) -> None:
        doc = self.document
        if doc.tree is None or doc.segmentation is None:
            self.checks, self._checked = [], None
            return
        wanted = (doc.tree, doc.segmentation.labels)
        if self._checked == wanted or "predict" in self._jobs:
            return
        self._checked = wanted
        running = self._jobs.get("check")
        if running is not None:
            running.cancel()
        job = self.bench.prediction.submit(
            tasks.check_joints,
            self.source(doc),
            doc.tree,
            on_progress=self._progress("check"),
            key=("check", self.record.id),
        )

        def keep(checks: list[tasks.JointCheck]) -> None:
            if self._checked == wanted:
                self.checks = checks

        self._start("check", job, keep)

    def part_payloads(self) -> list[tasks.PartPayload] | None:
        """The parts as drawn while joints move; None until they are cut (asks for it)."""
        doc = self.document
        if self.asset is None or doc.segmentation is None:
            return None
        ref = doc.segmentation.labels
        if ref not in self.payloads and "parts" not in self._jobs:
            job = self.bench.geometry.submit(
                tasks.part_payloads, self.source(doc), self.asset.element, priority=3
            )

            def keep(payloads: list[tasks.PartPayload]) -> None:
                self.payloads = {ref: payloads}

            self._start("parts", job, keep)
        return self.payloads.get(ref)

    # --- jobs that a person asks for

    def predict(self, who: str, *, here: bool = False) -> None:
        """Predict joints from the parts; the answer becomes a command.

        Args:
            who: decides it.
            here: with the predictor of this machine, whatever backend is set.
        """
        if self.predicting:
            return
        source, doc = self.source(), self.document
        if not doc.segmentation_current:
            raise CommandError("the parts are still being computed; predict in a moment")
        check = self._jobs.get("check")
        if check is not None:
            check.cancel()
        job = self.bench.prediction.submit(
            tasks.predict,
            source,
            DEFAULT_PREDICTOR if here else self.bench.config.predictor,
            doc.locked_joints,
            0,
            on_progress=self._progress("predict"),
            priority=10,
        )

        def keep(prediction: Any) -> None:
            self.backend_away = self.backend_away and here
            if prediction.tree is None:
                problems = "; ".join(prediction.problems) or "the predictor gave no reason"
                self.tell("No prediction", problems, "red")
                return
            self.do(cmd.RecordPrediction(prediction, source.labels), who)
            count = sum(j.moves for j in prediction.tree.joints)
            self.tell(
                "Predicted", f"{count} joint{'s'[: count != 1]} in {prediction.seconds:.1f} s"
            )

        self._start("predict", job, keep)
        self.changed()

    def cancel(self, what: str) -> None:
        """Stop a running job ("predict", "save", "segment")."""
        job = self._jobs.get(what)
        if job is not None:
            job.cancel()

    def accept(self, comment: str, who: str, at: str) -> None:
        """Write the asset, read it back, and only then record the decision."""
        if "save" in self._jobs:
            return
        state = self.state
        doc = state.present
        problems = acceptance_problems(doc)
        if problems:
            raise CommandError("; ".join(problems))
        assert doc.tree is not None
        command = cmd.Accept(comment)
        after = apply(state, command, Context(who, at))
        history = self.bench.store.history(self.record.id)
        record = provenance(after, history, self._source_record())
        folder = self.bench.workspace / "assets" / self._folder_name()
        job = self.bench.prediction.submit(
            tasks.save_asset_folder,
            self.source(doc),
            doc.tree,
            folder,
            record,
            on_progress=self._progress("save"),
            priority=8,
        )

        def keep(written: str) -> None:
            now = self.document
            if now.tree != doc.tree or now.segmentation != doc.segmentation:
                self.tell("Not accepted", "It was edited meanwhile: accept it again", "yellow")
                return
            self.do(command, who)
            self.do(cmd.Saved(written), who)
            self.tell("Accepted", f"Saved in {written}", "green")

        self._start("save", job, keep)
        self.changed()

    def _source_record(self) -> Any:
        from model.geometry.asset import Source

        asset = self.asset
        assert asset is not None
        return Source(asset.path, asset.sha256, asset.up_axis, asset.unit_scale)

    def _folder_name(self) -> str:
        plain = re.sub(r"[^A-Za-z0-9._-]+", "_", self.record.name).strip("._") or "object"
        return f"{plain[:60]}-{self.record.id}"

    # --- the life of a job

    def _progress(self, what: str) -> Callable[[float, str], None]:
        def tell(fraction: float, message: str) -> None:
            if what in self._jobs:
                self.busy[what] = (fraction, message)
                self.changed()

        return tell

    def _start(self, what: str, job: Job[Any], keep: Callable[[Any], None]) -> None:
        self._jobs[what] = job
        self.busy[what] = (0.0, "")
        job.add_done_callback(lambda ended: self._ended(what, ended, keep))

    def _ended(self, what: str, job: Job[Any], keep: Callable[[Any], None]) -> None:
        newest = self._jobs.get(what) is job
        if newest:
            del self._jobs[what]
            self.busy.pop(what, None)
        try:
            keep(job.result(0))
        except Cancelled:
            if what in ("predict", "save"):
                self.tell("Cancelled", "Nothing was changed", "gray")
        except BackendError as error:
            self.backend_away = True
            self._failed(what, f"{error}. Press “Predict on this machine”, or predict again later")
        except ArtiworldError as error:
            self._failed(what, str(error))
        except Exception as error:  # a job's boundary: say it and go on
            log.exception("job %s of object %s failed", what, self.record.id)
            self._failed(what, f"{error} (our fault; the details are in the server's log)")
        if newest and what in ("labels", "predict"):
            self._state_changed()
        else:
            self.changed()

    def _failed(self, what: str, message: str) -> None:
        if what == "open":
            self.problem = message
        self.tell({"open": "Can't open this file"}.get(what, "That didn't work"), message, "red")


def _stored(doc: Document) -> tuple[Click | tasks.StoredRegion, ...]:
    """The prompts as workers take them."""
    return tuple(
        p if isinstance(p, Click) else tasks.StoredRegion(p.part, p.elements, p.positive)
        for p in doc.prompts
    )
