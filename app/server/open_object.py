"""One open object: what is decided about it, what was read, and the jobs that this asks for.

Decisions live in the session's commands; this module runs the jobs that the state asks for and
feeds their answers back as commands.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.server import display_tasks, part_tasks, picking_tasks
from app.server.display_tasks import OpenedAsset, PartPayload
from app.server.jobs import CLICKS, EDITS, Job, JobFailed
from app.server.object_context import ObjectContext
from app.server.scene_member import SceneMember
from app.server.segmenting import SOURCE, Segmenting
from app.server.services import Services
from app.server.tasks import ReadOptions, Stamp, stamp_if_there
from app.server.validating import JointCheck, Judging
from model.core.errors import ArtiworldError, CommandError
from model.prediction.registry import DEFAULT as DEFAULT_PREDICTOR
from model.prediction.remote.http_predictor import BackendError
from sessions import commands as cmd
from sessions.state import SessionState
from sessions.store import ObjectRecord, PendingAcceptance

INTERRUPTED = "Its server ended on the way, or another one is still at it: Y accepts it"


class OpenObject(ObjectContext):
    """One object as all its tabs see it: asset, session, labels, running jobs.

    Args:
        in_scene: the object's place in the open scene, if it has one.
    """

    def __init__(
        self,
        record: ObjectRecord,
        services: Services,
        in_scene: Callable[[], SceneMember | None] = lambda: None,
    ) -> None:
        super().__init__(record, services)
        self._in_scene = in_scene
        self.problem: str | None = None
        self._worker_died = False
        self.backend_away = False
        self.payloads: dict[str, list[PartPayload]] = {}
        self._frame: tuple[Any, ...] | None = None
        self._anew = False
        self._failed_on: Stamp | None = None
        self.segmenting = Segmenting(self)
        self.judging = Judging(self)
        self._unsubscribe = self.live.subscribe(lambda state, command: self._decided(state))

    # --- state

    @property
    def in_scene(self) -> SceneMember | None:
        """The object's place in the open scene; None where it has none."""
        return self._in_scene()

    @property
    def display_name(self) -> str:
        """The object's name; in a scene the one it has there."""
        member = self.in_scene
        return self.record.name if member is None else member.name

    @property
    def being_accepted(self) -> bool:
        """Whether it is being accepted: nobody need do anything about it."""
        return self.judging.waiting or "save" in self.jobs

    @property
    def busy(self) -> dict[str, tuple[float, str]]:
        """The jobs under way: how far each one is, 0..1, and what it says."""
        return self.jobs.busy

    @property
    def labels(self) -> npt.NDArray[np.int16] | None:
        """(D,) part of each displayed element; None where nothing is segmented."""
        return self.segmenting.labels

    @property
    def checks(self) -> list[JointCheck]:
        """The collisions that the gate found on the present joints."""
        return self.judging.checks

    @property
    def interrupted(self) -> bool:
        """Whether it was being accepted when this server started, and isn't decided since."""
        begun = self.begun
        return begun is not None and not begun.held

    @property
    def held(self) -> str:
        """Why validation put its acceptance on hold after the person went on, or ""."""
        begun = self.begun
        return "" if begun is None or self.being_accepted else begun.held

    @property
    def begun(self) -> PendingAcceptance | None:
        """The acceptance that was cut off or put on hold, with its comment."""
        return self.services.acceptances.of(replace(self.record, seq=self.state.seq))

    @property
    def in_use(self) -> bool:
        """Whether a tab shows it, a job works on it, or it waits to be accepted."""
        return self.watched or bool(self.jobs) or self.judging.waiting

    def release(self) -> None:
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
            config = self.services.config
            options = ReadOptions(
                doc.up_axis or config.up_axis,
                doc.unit_scale * config.unit_scale,
                None if doc.left_out is None else doc.left_out.elements,
                doc.face_cuts,
            )
            job = self.services.workers.geometry.submit(
                display_tasks.open_asset,
                Path(self.record.path),
                self.services.workspace,
                options,
                on_progress=self.jobs.progress("open"),
                priority=5,
                gives_way=CLICKS,
            )
            self.start("open", job, self._opened)

    def reopen(self) -> None:
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
        self.services.queue.set_unreadable(self.record.id, False)
        first, doc = self.state.seq == 0, self.document
        if first and asset.category:
            self.do(cmd.SetCategory(asset.category), SOURCE)
        if first or (self._anew and not doc.prompts and doc.tree is None):
            self.segmenting.take_source_parts(asset)
        if self.interrupted:
            self.tell("Not accepted yet", INTERRUPTED, "yellow")
        for warning in asset.warnings:
            self.tell("Opened with a remark", warning, "yellow")
        self.services.workers.geometry.submit(picking_tasks.prepare_picking, asset.folder)
        self.segmenting.prepare()
        self._state_changed()

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
        self.services.queue.refresh(self.record.id)
        self.changed()

    def part_payloads(self) -> list[PartPayload] | None:
        """The parts as drawn while joints move; None until they are cut (asks for it)."""
        doc = self.document
        if self.asset is None or doc.segmentation is None:
            return None
        ref = doc.segmentation.labels
        if ref not in self.payloads and "parts" not in self.jobs:
            job = self.services.workers.geometry.submit(
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
        job = self.services.workers.prediction.submit(
            part_tasks.predict,
            source,
            DEFAULT_PREDICTOR if here else self.services.config.predictor,
            doc.locked_joints,
            0,
            on_progress=self.jobs.progress("predict"),
            priority=10,
            gives_way=EDITS,
        )

        self.services.drafts.prepare_bodies(source)

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

    def _ended(self, what: str, job: Job[Any], keep: Callable[[Any], None]) -> None:
        newest = self.jobs.drop(what, job)
        if what == "open":
            self._worker_died = isinstance(job.error, JobFailed)
        error = self.jobs.hand_over(what, job, keep)
        if what == "save" and not self.services.workers.closing:
            self.services.acceptances.end(self.record.id)
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
            self.services.queue.set_unreadable(self.record.id, True)
        self.tell({"open": "Can't open this file"}.get(what, "That didn't work"), message, "red")
