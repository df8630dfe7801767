"""One open object: its session, its asset, and the jobs that its state asks for.

Decisions live in the session's commands; the results of jobs become commands, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.server import display_tasks, part_tasks, segmenting_tasks
from app.server.display_tasks import OpenedAsset, PartPayload
from app.server.job import OutOfTimeError
from app.server.jobs import CLICKS, EDITS, Job, JobFailed
from app.server.learning import Likeness
from app.server.object_context import ObjectContext, Services
from app.server.observable import Listener, Notice
from app.server.preparing import Preparing, untouched
from app.server.segmenting import Segmenting
from app.server.tasks import Stamp, stamp_if_there
from app.server.validating import JointCollision, Validation
from app.server.workers import READ_CANCELLED, too_slow
from model.core.errors import ArtiworldError, CommandError
from model.prediction.registry import DEFAULT as DEFAULT_PREDICTOR
from model.prediction.remote_backend import BackendError
from sessions import commands as cmd
from sessions.people import Presence
from sessions.review import transition
from sessions.state import SOURCE, SessionState
from sessions.store import ObjectRecord, PendingAcceptance

INTERRUPTED = "Its server ended, or another one still works on it. Press Y to accept it"


class OpenObject(ObjectContext):
    """One object as all its tabs see it: asset, session, labels, running jobs.

    Attributes:
        in_scene: whether it belongs to the open scene.
        present: the people with accounts who have it open, in any server.
    """

    in_scene = False

    def __init__(self, record: ObjectRecord, services: Services) -> None:
        super().__init__(record, services)
        self.present: tuple[Presence, ...] = ()
        self.asked_by = ""  # who waits for it to be read
        self.problem: str | None = None
        self._worker_died = self._reading_stopped = self._warm = False
        self.backend_away = False
        self.payloads: dict[str, list[PartPayload]] = {}
        self._cutting = self._uncut = ""  # labels by which parts are cut, and which failed to
        self._frame: tuple[Any, ...] | None = None
        self._anew = False
        self._failed_on: Stamp | None = None
        self.segmenting = Segmenting(self)
        self.likeness = Likeness(self)
        self.preparing = Preparing(self)
        self.validation = Validation(self, sized=not self.in_scene)
        self._unsubscribe = self.live.subscribe(lambda state, command: self._decided(state))

    # --- state

    @property
    def display_name(self) -> str:
        """The object's name; in a scene the one it has there."""
        return self.record.name

    @property
    def scene_source(self) -> dict[str, Any]:
        """Its source in ``provenance.json`` where it belongs to a scene; else empty."""
        return {}

    @property
    def being_accepted(self) -> bool:
        """True while an acceptance is under way."""
        return self.validation.acceptance_waits or "save" in self.jobs

    @property
    def shown_state(self) -> str:
        """Its review state, or the one of an acceptance that isn't recorded yet."""
        if "save" in self.jobs:
            return "saving"
        if self.validation.acceptance_waits:
            return "validating"
        if self.hold_reason:
            return "on_hold"
        return "interrupted" if self.interrupted else self.document.review.state

    @property
    def busy(self) -> dict[str, tuple[float, str]]:
        """Progress (0..1) and message of each running job."""
        return self.jobs.busy

    @property
    def labels(self) -> npt.NDArray[np.int16] | None:
        """(D,) part of each displayed element; None where nothing is segmented."""
        return self.segmenting.labels

    @property
    def checks(self) -> list[JointCollision]:
        """The collisions that validation found on the present joints."""
        return self.validation.collisions

    @property
    def interrupted(self) -> bool:
        """True if an acceptance was under way when this server started, and is still undecided."""
        pending = self.pending_acceptance
        return pending is not None and not pending.hold_reason

    @property
    def hold_reason(self) -> str:
        """Why validation put its acceptance on hold after the person went on, or ""."""
        pending = self.pending_acceptance
        return "" if pending is None or self.being_accepted else pending.hold_reason

    @property
    def pending_acceptance(self) -> PendingAcceptance | None:
        """The acceptance that was cut off or put on hold, with its comment."""
        return self.services.acceptances.of(replace(self.record, seq=self.state.seq))

    @property
    def in_use(self) -> bool:
        """True while a tab shows it, a script or a job works on it, or its acceptance waits."""
        return self.clicked or bool(self.jobs) or self.validation.acceptance_waits

    def watch(
        self, listener: Listener, notice: Notice, *, shows: bool = True
    ) -> Callable[[], None]:
        """See the base class; clicks in the tab are answered soon."""
        stop = super().watch(listener, notice, shows=shows)
        if shows and self.asset is not None:
            self._prepare_clicks(self.asset)
            self.likeness.update()
        elif shows:  # its reading may have stopped meanwhile
            self.reopen()
        return stop

    def left(self) -> None:
        """Stop reading and encoding: nobody waits for it."""
        self._reading_stopped = True
        self.jobs.cancel("open")
        self.jobs.cancel("encode")

    def release(self) -> None:
        """Drop what can be computed again; the decisions are on disk."""
        self._unsubscribe()
        self.unload()

    def unload(self) -> None:
        """Drop the asset, until it is opened again."""
        self.preparing.forget()
        self.services.workers.lanes.leave(self)
        self.asset = self._frame = None  # now: the garbage collector may take long
        self.payloads.clear()
        self.segmenting.forget()

    # --- opening

    def ensure_open(self, *, again: bool = False) -> None:
        """Read the asset in the background unless it is read or being read.

        After a failure it is read again once the file changed.

        Args:
            again: also where it failed and nothing changed.
        """
        with self._lock:
            doc = self.document
            frame = (doc.up_axis, doc.unit_scale, doc.frame, doc.left_out, doc.face_cuts)
            if "open" in self.jobs or (self.asset is not None and self._frame == frame):
                return
            now = (frame, None if self.problem is None else stamp_if_there(self.record.path))
            if self.problem is not None and not again and now == (self._frame, self._failed_on):
                return
            # In another frame the object starts afresh, with the parts and joints of the file.
            self._anew = self._frame is not None and self._frame[:3] != frame[:3]
            self._frame, self.problem = frame, None
            self._failed_on = stamp_if_there(self.record.path)
            self.asset = None
            self.segmenting.forget()
            self.payloads.clear()
            job = self.services.workers.read(
                display_tasks.open_asset,
                Path(self.record.path),
                self.services.workspace,
                self.read_options(doc),
                self._masks(),
                who=self.asked_by,
                on_progress=self.jobs.progress("open"),
            )
            self.start("open", job, self._opened)

    def _masks(self) -> Path | None:
        """The masks of another system, where they are of this object."""
        config = self.services.config
        own = [Path(p).resolve() for p in config.paths] == [Path(self.record.path).resolve()]
        return config.masks if own else None

    def reopen(self) -> None:
        """Read it for a tab that opens it, also where the worker died when it was read last."""
        self.ensure_open(again=self._worker_died or self._reading_stopped)

    def try_again(self) -> None:
        """Read it again after a failure."""
        if self.problem is not None:
            self.ensure_open(again=True)
            self.changed()

    def _opened(self, asset: OpenedAsset) -> None:
        with self._lock:
            self.lane = self.services.workers.lanes.take(self, heavy=asset.heavy)
            self.asset = asset  # a click may come from now on
        self.services.queue.set_unreadable(self.record.id, False)
        first, doc = self.state.seq == 0, self.document
        if first and asset.category:
            self.do(cmd.SetCategory(asset.category), SOURCE)
        if first or ((self._anew or asset.masks) and not doc.prompts and doc.tree is None):
            self.segmenting.take_source_parts(asset)
        elif asset.masks:
            self.notify("Masks not used", "It has parts already: remove them to start from masks")
        if self.interrupted:
            self.notify("Not accepted yet", INTERRUPTED, "yellow")
        for warning in asset.warnings:
            self.notify("Opened with a warning", warning, "orange")
        whole = asset.source_labels is None and self.document.left_out is None
        proposed = whole and not self.in_scene and untouched(self.document)
        if self.is_shown or not proposed:  # what is opened ahead may be levelled first
            self._prepare_clicks(asset)
        if proposed:
            self.preparing.propose(priority=-1)  # after what the first click needs
        self._state_changed()

    def _prepare_clicks(self, asset: OpenedAsset) -> None:
        """Have a lane of its own, which knows it; a tilted scan is levelled before."""
        self.lane = self.services.workers.lanes.take(self, heavy=asset.heavy)
        self.lane.geometry.submit(segmenting_tasks.prepare_picking, asset.folder)
        if not self.preparing.tilt:
            self.segmenting.prepare()

    # --- jobs that the state asks for

    def _decided(self, state: SessionState) -> None:
        if not self.live.issued_here(state.seq):
            self.notify_remote_change()
        self._state_changed()

    def _state_changed(self) -> None:
        if self._frame is not None:
            self.ensure_open()
        if self.asset is None:
            self.validation.drop_stale_request()
        else:
            self.segmenting.update()
            self.likeness.update()
            self.validation.update()
            if self.document.prompts:
                self._warm_up()
        self.services.queue.refresh(self.record.id, self.live.summary)
        self.changed()

    def _warm_up(self) -> None:
        """Load what predicting and checking need, which takes seconds, before it is needed."""
        if not self._warm:
            self._warm = True
            self.services.workers.prediction.submit(
                part_tasks.warm_up, self.services.predictor, key="warm up", priority=-1
            )

    def part_payloads(self) -> list[PartPayload] | None:
        """Return the parts as drawn while joints move; None until they are cut (starts it)."""
        doc = self.document
        if self.asset is None or doc.segmentation is None:
            return None
        ref = doc.segmentation.labels
        if ref not in (*self.payloads, self._uncut) and "parts" not in self.jobs:
            self._cutting = ref
            job = self.lane.geometry.submit(
                display_tasks.part_payloads,
                self.source(doc),
                self.asset.element,
                priority=3,
                preempted_by=CLICKS,
            )

            def keep(payloads: list[PartPayload]) -> None:
                self.payloads = {ref: payloads}

            self.start("parts", job, keep)
        return self.payloads.get(ref)

    # --- jobs that a person asks for

    def predict(self, who: str, *, here: bool = False) -> None:
        """Predict joints from the parts; the result becomes a command.

        Args:
            who: the current user.
            here: with this machine's own predictor, whatever backend is set.
        """
        if "predict" in self.jobs:
            return
        source, doc = self.source(), self.document
        transition(doc.review.state, "predict")  # refuses now, not after the wait
        if not doc.segmentation_current:
            raise CommandError("the parts are still being computed; try again in a moment")
        self.jobs.cancel("check")
        self.validation.forget_request()
        job = self.services.workers.prediction.submit(
            part_tasks.predict,
            source,
            DEFAULT_PREDICTOR if here else self.services.predictor,
            doc.locked_joints,
            0,
            self.likeness.source_of_joints(doc),
            on_progress=self.jobs.progress("predict"),
            priority=10,
            preempted_by=EDITS,
        )

        self.services.drafts.prepare_bodies(source)

        def keep(prediction: Any) -> None:
            self.backend_away = self.backend_away and here
            if prediction.tree is None:
                problems = "; ".join(prediction.problems) or "the predictor gave no reason"
                self.notify("No prediction", problems, "red")
                return
            self.do(cmd.RecordPrediction(prediction, source.labels), who)
            count = sum(j.moves for j in prediction.tree.joints)
            self.notify(
                "Predicted", f"{count} joint{'s'[: count != 1]} in {prediction.seconds:.1f} s"
            )

        self.start("predict", job, keep)
        self.changed()

    # --- the life of a job

    def _ended(self, what: str, job: Job[Any], keep: Callable[[Any], None]) -> None:
        newest = self.jobs.drop(what, job)
        if what == "open":
            self._worker_died = isinstance(job.error, JobFailed)
        error = self.jobs.deliver(what, job, keep)
        if self.services.workers.closing:
            return
        if what == "encode":
            self._warm_up()
        if what == "prepare" and error is None and not (self.is_shown or self.preparing.tilt):
            self.segmenting.prepare()
        if what == "encode" and error is None:
            self.likeness.encoded()
        if what == "save":
            self.services.acceptances.end(self.record.id)
        if isinstance(error, OutOfTimeError):
            self._failed(what, too_slow(self.record.name))
        elif isinstance(error, BackendError):
            self.backend_away = True
            self._failed(what, f"{error}. Press “Predict on this machine”")
        elif isinstance(error, ArtiworldError):
            self._failed(what, str(error))
        elif what == "open" and newest and error is not None:
            self.problem = READ_CANCELLED
            if self._reading_stopped and self.is_shown:  # a tab came back meanwhile
                self._reading_stopped = False
                self.ensure_open(again=True)
        elif what == "encode" and newest and error and self.is_shown and not self.preparing.tilt:
            self.segmenting.prepare()  # a tab came back meanwhile
        elif error is not None and what in ("predict", "save"):
            self.notify("Cancelled", "Nothing was changed", "gray")
        asked = what in ("segment", "labels") and error is None  # it would only fail again
        if newest and (asked or what == "predict"):
            self._state_changed()
        else:
            self.changed()

    def _failed(self, what: str, message: str) -> None:
        if what == "check":
            self.validation.failed(message)
        if what == "parts":
            self._uncut = self._cutting  # drawing asks again, and it would only fail again
        if what == "open":
            # The folder of uploads means nothing to the person who sent the file.
            message = message.replace(f"{Path(self.record.path).parent}/", "")
            self.problem = message
            self.services.queue.set_unreadable(self.record.id, True)
        self.notify({"open": "Can't open this file"}.get(what, "Failed"), message, "red")
