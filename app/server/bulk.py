"""Work on many objects of the queue, one after the other: it is shown, and can be cancelled."""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from app.server.accepting import accept, acceptance_over
from app.server.export_tasks import ExportTask, export_one
from app.server.job import Job, WorkerDied
from app.server.object_context import Services
from app.server.open_object import OpenObject
from model.core.errors import ArtiworldError, CommandError
from model.core.progress import Cancelled, each
from model.validation.report import ValidationReport
from sessions import commands as cmd
from sessions.command_log import BULK, TimedJob, record_job
from sessions.state import SessionState

log = logging.getLogger(__name__)
POLL_SECONDS = 0.05
Notify = Callable[[str, str, str], None]
"""Gets title, text and color of a note."""


class BulkWork:
    """One action on many objects at a time, for all tabs.

    Args:
        open_object: opens an object by its id.

    Attributes:
        progress: (share 0..1, text) of what runs; None where nothing does.
    """

    def __init__(self, services: Services, open_object: Callable[[int], OpenObject]) -> None:
        self._services, self._open = services, open_object
        self._cancelled = threading.Event()
        self._lock = threading.Lock()
        self._job: Job[Any] | None = None
        self._place = 0, 1
        self.progress: tuple[float, str] | None = None

    def cancel(self) -> None:
        """Stop after what runs now, and that, too, where it can be."""
        self._cancelled.set()
        job = self._job
        if job is not None:
            job.cancel()

    def set_category(self, ids: Sequence[int], category: str, who: str, notify: Notify) -> None:
        """Set the category of objects."""

        def one(id: int) -> None:
            session = self._services.hub.session(id)
            if session.document.review.state == "accepted":
                raise CommandError("accepted: reopen it first")
            if session.document.category != category:
                session.do(cmd.SetCategory(category), who)
                self._services.queue.refresh(id)

        self._start(f"Category {category}", ids, one, notify)

    def predict(self, ids: Sequence[int], who: str, notify: Notify) -> None:
        """Predict the joints of objects that have parts."""

        def one(id: int) -> None:
            state = self._services.hub.session(id).state
            if state.seq and state.present.segmentation is None:
                raise CommandError("no parts yet")
            obj = self._opened(id)  # which takes the parts of a file that has them
            if obj.document.segmentation is None:
                raise CommandError("no parts yet")
            self._wait(lambda: obj.document.segmentation_current)
            obj.predict(who)
            self._wait(lambda: "predict" not in obj.jobs)
            if obj.document.tree is None:
                raise CommandError("no prediction")
            self._checked(obj)

        self._start("Predict", ids, one, notify)

    def check(self, ids: Sequence[int], notify: Notify) -> None:
        """Run the checks of predicted objects."""

        def one(id: int) -> None:
            if self._checked(self._opened(id)) is None:
                raise CommandError("can't be checked")

        self._start("Check", ids, one, notify)

    def _checked(self, obj: OpenObject) -> ValidationReport | None:
        obj.validation.update()
        self._wait(lambda: not obj.validation.awaited)
        return obj.validation.report

    def accept(self, ids: Sequence[int], who: str, notify: Notify) -> None:
        """Accept objects as they are now, however long it takes; those with warnings that nobody
        was shown are put on hold."""
        asked: dict[int, SessionState] = {}

        def one(id: int) -> None:
            for i in () if asked else ids:
                asked[i] = replace(self._services.hub.session(i).state, past=(), future=())
            obj = self._opened(id)
            if obj.document.review.state == "accepted":
                return
            refused: list[ArtiworldError] = []
            accept(obj, "", who, refused=refused.append, state=asked[id])
            self._wait(lambda: bool(refused) or acceptance_over(obj))
            if obj.document.review.state != "accepted":
                if refused and not obj.hold_reason:
                    raise refused[0]
                raise CommandError("on hold: see its warnings" if refused else "not accepted")

        self._start("Accept", ids, one, notify)

    def export(
        self,
        ids: Sequence[int],
        task_of: Callable[[Path], ExportTask],
        notify: Notify,
        done: Callable[[], None],
    ) -> None:
        """Export the saved assets of accepted objects; ``done`` once all files are there."""

        def one(id: int) -> None:
            saved = self._services.hub.session(id).document.saved
            folder = self._services.store.assets.folder(saved)
            if folder is None:
                raise CommandError("not accepted: it has no asset yet")
            job = self._services.workers.saving.submit(
                export_one,
                task_of(folder),
                on_progress=self._within,
                priority=-1,  # what somebody accepts meanwhile is saved first
            )
            report = self._result(job)
            wrong = [p for f in report["formats"] for p in f.get("problems", ())]
            if wrong:
                raise CommandError(wrong[0])

        self._start("Export", ids, one, notify, done)

    # --- running

    def _start(
        self,
        what: str,
        ids: Sequence[int],
        one: Callable[[int], None],
        notify: Notify,
        done: Callable[[], None] | None = None,
    ) -> None:
        with self._lock:
            if self.progress is not None:
                raise CommandError(f"“{self.progress[1]}” still runs: wait for it or cancel it")
            if not ids:
                raise CommandError("no objects are selected")
            self.progress = 0.0, what
        self._cancelled.clear()
        args = (what, tuple(ids), one, notify, done)
        threading.Thread(target=self._run, args=args, name="bulk work", daemon=True).start()

    def _run(
        self,
        what: str,
        ids: tuple[int, ...],
        one: Callable[[int], None],
        notify: Notify,
        done: Callable[[], None] | None,
    ) -> None:
        refused: Counter[str] = Counter()
        count = 0

        def timed(place: tuple[int, int]) -> None:
            nonlocal count
            k, id = place
            self._place = k, len(ids)
            self.progress = k / len(ids), f"{what}: {k + 1} of {len(ids)}"
            self._services.queue.changed()
            begun = time.time()
            try:
                one(id)
                count += 1
            finally:
                job = TimedJob(id, BULK, begun, time.time() - begun)
                record_job(self._services.workspace, job)

        def failed(_: object, error: Exception) -> None:
            known = isinstance(error, ArtiworldError | WorkerDied)
            refused[str(error)[:120] if known else "failed; see the server's log"] += 1

        try:
            each(enumerate(ids), timed, failed)
            if done is not None and count:
                done()
        except Cancelled:
            refused["cancelled"] = len(ids) - count - refused.total()
        except Exception:  # a thread's boundary
            log.exception("%s failed", what)
            refused["failed; see the server's log"] += 1
        finally:
            self.progress = None
        why = "".join(f". {n}: {text}" for text, n in refused.most_common(3))
        notify(what, f"{count} of {len(ids)} done{why}", "orange" if refused else "green")
        self._services.queue.changed()

    def _within(self, share: float, _: str) -> None:
        """Update the progress by ``share`` of the present object, 0..1."""
        if self.progress is not None:
            count, total = self._place
            self.progress = (count + share) / total, self.progress[1]
            self._services.queue.changed()

    def _opened(self, id: int) -> OpenObject:
        obj = self._open(id)
        self._wait(lambda: obj.asset is not None or obj.problem is not None)
        if obj.problem is not None:
            raise CommandError("it can't be read")
        return obj

    def _wait(self, ready: Callable[[], bool]) -> None:
        while not ready():
            if self._cancelled.is_set():
                raise Cancelled
            time.sleep(POLL_SECONDS)

    def _result(self, job: Job[Any]) -> Any:
        self._job = job
        try:
            self._wait(lambda: job.done)
            return job.result()
        finally:
            self._job = None
