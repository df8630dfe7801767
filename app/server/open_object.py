"""One open object: what is decided about it, what was read, and the jobs that this asks for.

Decisions live in the session's commands; this module runs the jobs that the state asks for and
feeds their answers back as commands.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from app.server import display_tasks, part_tasks, picking_tasks
from app.server import validation_tasks as judging_tasks
from app.server.display_tasks import OpenedAsset, PartPayload
from app.server.jobs import CLICKS, EDITS, Job, JobFailed
from app.server.observable import Watched
from app.server.part_tasks import PartSource
from app.server.running_jobs import RunningJobs
from app.server.segmenting import SOURCE, Segmenting
from app.server.tasks import ReadOptions, Stamp, stamp_if_there
from app.server.validating import JointCheck, Judging
from model.core.errors import ArtiworldError, CommandError
from model.core.tree import KinematicTree
from model.prediction.registry import DEFAULT as DEFAULT_PREDICTOR
from model.prediction.remote.http_predictor import BackendError
from model.segmentation.prompts import BASE
from model.validation.report import GateReport
from sessions import commands as cmd
from sessions.live import LiveSession
from sessions.state import Document, SessionState
from sessions.store import Begun, ObjectRecord

if TYPE_CHECKING:
    from app.server.app_state import Workbench

INTERRUPTED = "Its server ended on the way, or another one is still at it: Y accepts it"


class OpenObject(Watched):
    """One object as all its tabs see it: asset, session, labels, running jobs."""

    def __init__(self, bench: Workbench, record: ObjectRecord) -> None:
        self.bench = bench
        self.record = record
        self.live: LiveSession = bench.hub.session(record.id)
        self.asset: OpenedAsset | None = None
        self.problem: str | None = None
        self._worker_died = False
        self.backend_away = False
        self.payloads: dict[str, list[PartPayload]] = {}
        self._stored: tuple[str, npt.NDArray[np.integer]] | None = None
        self._frame: tuple[Any, ...] | None = None
        self._anew = False
        self._failed_on: Stamp | None = None
        self.jobs = RunningJobs(f"object {record.id}", self.changed)
        self._lock = threading.RLock()
        super().__init__()
        self.segmenting = Segmenting(self)
        self.judging = Judging(self)
        self._unsubscribe = self.live.subscribe(lambda state, command: self._decided(state))

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
    def busy(self) -> dict[str, tuple[float, str]]:
        """The jobs under way: how far each one is, 0..1, and what it says."""
        return self.jobs.busy

    @property
    def labels(self) -> npt.NDArray[np.int16] | None:
        """(D,) part of each displayed element; None where nothing is segmented."""
        return self.segmenting.labels

    def part_of(self, element: int) -> int | None:
        """The part that holds an element of the source, be it displayed or not; None where nothing
        is segmented.
        """
        record = self.document.segmentation
        if record is None:
            return None
        stored = self._stored
        if stored is None or stored[0] != record.labels:
            # Reading those of millions of points takes a tenth of a second.
            stored = self._stored = record.labels, self.bench.store.get_array(record.labels)
        return max(int(stored[1][element]), BASE)

    @property
    def checks(self) -> list[JointCheck]:
        """The collisions that the gate found on the present joints."""
        return self.judging.checks

    @property
    def predicting(self) -> bool:
        """Whether a prediction is under way."""
        return "predict" in self.jobs

    @property
    def interrupted(self) -> bool:
        """Whether it was being accepted when this server started, and isn't decided since."""
        begun = self.begun
        return begun is not None and not begun.held

    @property
    def held(self) -> str:
        """Why the gate held it back after whoever wanted it accepted had gone on, or ""."""
        return self.bench.held(replace(self.record, seq=self.state.seq))

    @property
    def begun(self) -> Begun | None:
        """An acceptance that was cut off or held back, with what was said for it."""
        return self.bench.begun(replace(self.record, seq=self.state.seq))

    def source(self, document: Document | None = None) -> PartSource:
        """The parts of the document as the workers cut them.

        Raises:
            CommandError: where nothing is segmented yet.
        """
        doc = document or self.document
        if self.asset is None or doc.segmentation is None:
            raise CommandError("no part is there yet: click on a part that moves")
        names = {p.id: p.name for p in doc.parts if p.name}
        return PartSource(
            self.asset.folder,
            self.bench.workspace,
            doc.segmentation.labels,
            names,
            doc.category,
            self.record.name,  # a working copy's folder is called after its content, too
        )

    @property
    def in_use(self) -> bool:
        """Whether a tab shows it, a job works on it, or it waits to be accepted."""
        return self.watched or bool(self.jobs) or self.judging.waiting

    def let_go(self) -> None:
        """Hear of nothing any more: what is decided is on disk, all else can be made again."""
        self._unsubscribe()
        self.asset = None  # at once: objects like this one wait long for the garbage collector
        self.payloads.clear()
        self.segmenting.forget()

    # --- opening

    def ensure_open(self, *, again: bool = False) -> None:
        """Read the asset in the background unless it is read or being read.

        What failed is tried again once the file changed.

        Args:
            again: also where it failed and nothing changed.
        """
        with self._lock:
            doc = self.document
            frame = (doc.up_axis, doc.unit_scale, doc.left_out, doc.face_cuts)
            if "open" in self.jobs or (self.asset is not None and self._frame == frame):
                return
            now = (frame, None if self.problem is None else stamp_if_there(self.record.path))
            if self.problem is not None and not again and now == (self._frame, self._failed_on):
                return
            # Whoever has it read in another frame begins afresh, with what the source says.
            self._anew = self._frame is not None and self._frame[:2] != frame[:2]
            self._frame, self.problem = frame, None
            self._failed_on = stamp_if_there(self.record.path)
            self.asset = None
            self.segmenting.forget()
            self.payloads.clear()
            config = self.bench.config
            options = ReadOptions(
                doc.up_axis or config.up_axis,
                doc.unit_scale * config.unit_scale,
                None if doc.left_out is None else doc.left_out.elements,
                doc.face_cuts,
            )
            job = self.bench.geometry.submit(
                display_tasks.open_asset,
                Path(self.record.path),
                self.bench.workspace,
                options,
                on_progress=self.jobs.progress("open"),
                priority=5,
                gives_way=CLICKS,
            )
            self.start("open", job, self._opened)

    def come_back(self) -> None:
        """Somebody wants to see it: read it, also where its worker died when it was read last."""
        self.ensure_open(again=self._worker_died)

    def try_again(self) -> None:
        """Read what could not be read."""
        if self.problem is not None:
            self.ensure_open(again=True)
            self.changed()

    def _opened(self, asset: OpenedAsset) -> None:
        with self._lock:
            self.asset = asset
        self.bench.note_broken(self.record.id, False)
        first, doc = self.state.seq == 0, self.document
        if first and asset.category:
            self.do(cmd.SetCategory(asset.category), SOURCE)
        if first or (self._anew and not doc.prompts and doc.tree is None):
            self.segmenting.take_source_parts(asset)
        if self.interrupted:
            self.tell("Not accepted yet", INTERRUPTED, "yellow")
        for warning in asset.warnings:
            self.tell("Opened with a remark", warning, "yellow")
        self.bench.geometry.submit(picking_tasks.prepare_picking, asset.folder)
        self.segmenting.prepare()
        self._state_changed()

    def need_asset(self) -> OpenedAsset:
        """What was read.

        Raises:
            CommandError: where it is still being read.
        """
        if self.asset is None:
            raise CommandError("the object is still being read")
        return self.asset

    # --- jobs that the state asks for

    def _decided(self, state: SessionState) -> None:
        if not self.live.given_here(state.seq):
            self.tell_of_others()
        self._state_changed()

    def _state_changed(self) -> None:
        self.ensure_open()
        if self.asset is not None:
            self.segmenting.ask()
            self.judging.ask()
        self.bench.queue_changed(self.record.id)
        self.changed()

    def start_gate(self, tree: KinematicTree, keep: Callable[[GateReport], None]) -> None:
        """Judge the joints of ``tree`` in the background."""
        job = self.bench.prediction.submit(
            judging_tasks.judge_joints,
            self.source(),
            tree,
            on_progress=self.jobs.progress("check"),
            key=("check", self.record.id),
            gives_way=CLICKS,
        )
        self.start("check", job, keep)

    def part_payloads(self) -> list[PartPayload] | None:
        """The parts as drawn while joints move; None until they are cut (asks for it)."""
        doc = self.document
        if self.asset is None or doc.segmentation is None:
            return None
        ref = doc.segmentation.labels
        if ref not in self.payloads and "parts" not in self.jobs:
            job = self.bench.geometry.submit(
                display_tasks.part_payloads,
                self.source(doc),
                self.asset.element,
                priority=3,
                gives_way=CLICKS,
            )

            def keep(payloads: list[PartPayload]) -> None:
                self.payloads = {ref: payloads}

            self.start("parts", job, keep)
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
        self.jobs.cancel("check")
        self.judging.forget_request()
        job = self.bench.prediction.submit(
            part_tasks.predict,
            source,
            DEFAULT_PREDICTOR if here else self.bench.config.predictor,
            doc.locked_joints,
            0,
            on_progress=self.jobs.progress("predict"),
            priority=10,
            gives_way=EDITS,
        )

        self.bench.prepare_bodies(source)

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

        self.start("predict", job, keep)
        self.changed()

    # --- the life of a job

    def start(self, what: str, job: Job[Any], keep: Callable[[Any], None]) -> None:
        """Follow a job; ``keep`` gets its answer. What fails is told."""
        self.jobs.follow(what, job, lambda ended: self._ended(what, ended, keep))

    def _ended(self, what: str, job: Job[Any], keep: Callable[[Any], None]) -> None:
        newest = self.jobs.drop(what, job)
        if what == "open":
            self._worker_died = isinstance(job.error, JobFailed)
        error = self.jobs.hand_over(what, job, keep)
        if what == "save" and not self.bench.closing:
            self.bench.store.accepting_ends(self.record.id)
        if isinstance(error, BackendError):
            self.backend_away = True
            self._failed(what, f"{error}: press “Predict on this machine”")
        elif isinstance(error, ArtiworldError):
            self._failed(what, str(error))
        elif error is not None and what in ("predict", "save"):
            self.tell("Cancelled", "Nothing was changed", "gray")
        asked = what in ("segment", "labels") and error is None  # what failed would fail again
        if newest and (asked or what == "predict"):
            self._state_changed()
        else:
            self.changed()

    def _failed(self, what: str, message: str) -> None:
        if what == "check":
            self.judging.failed(message)
        if what == "open":
            # Where uploads are kept says nothing to the one who sent the file.
            message = message.replace(f"{Path(self.record.path).parent}/", "")
            self.problem = message
            self.bench.note_broken(self.record.id, True)
        self.tell({"open": "Can't open this file"}.get(what, "That didn't work"), message, "red")
