"""Something that several tabs show, such as an open object or a scene: it tells them when to
redraw and what to announce; and its running jobs.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

from app.server.job import WorkerDied
from app.server.jobs import Job
from model.core.errors import ArtiworldError
from model.core.progress import Cancelled

Listener = Callable[[], None]
Notice = Callable[[str, str, str], None]


class Observable:
    """Keeps the tabs that show it.

    Attributes:
        kept_until: until then (monotonic clock) a script is taken to work on it.
    """

    def __init__(self) -> None:
        self.kept_until = 0.0
        self._listeners: list[Listener] = []
        self._notices: list[Notice] = []
        self._showing: list[Listener] = []
        self._announced_remote = False

    @property
    def is_shown(self) -> bool:
        """True while any tab shows it."""
        return bool(self._showing)

    @property
    def clicked(self) -> bool:
        """True while a tab shows it, or a script works on it."""
        return self.is_shown or time.monotonic() < self.kept_until

    def watch(
        self, listener: Listener, notice: Notice, *, shows: bool = True
    ) -> Callable[[], None]:
        """Call ``listener`` on every change and ``notice(title, body, color)`` with news.

        Args:
            shows: whether a tab shows it, and doesn't only follow what becomes of it.

        Returns:
            The function that ends it.
        """
        self._listeners.append(listener)
        self._notices.append(notice)
        if shows:
            self._showing.append(listener)

        def stop() -> None:
            if listener not in self._listeners:
                return
            self._listeners.remove(listener)
            self._notices.remove(notice)
            if listener in self._showing:
                self._showing.remove(listener)
                if not self._showing:
                    self.left()

        return stop

    def left(self) -> None:
        """The last tab shows something else."""

    def changed(self) -> None:
        """Have all tabs redraw."""
        for listener in list(self._listeners):
            listener()

    def notify(self, title: str, body: str, color: str = "blue") -> None:
        """Show a note in all tabs."""
        for notice in list(self._notices):
            notice(title, body, color)

    def notify_remote_change(self) -> None:
        """Say once that another server changes this, too."""
        if self._listeners and not self._announced_remote:
            self._announced_remote = True
            self.notify("Changed elsewhere", "Another server works on this, too", "yellow")


log = logging.getLogger(__name__)


class RunningJobs:
    """Running jobs by kind; of two of a kind the newest counts.

    Args:
        owner: name in the log.
        changed: called whenever a job reports progress.
        record: gets kind, start (seconds since 1970) and seconds of each job that ended.

    Attributes:
        busy: progress (0..1) and message of each job.
        record: as given.
    """

    def __init__(
        self,
        owner: str,
        changed: Callable[[], None],
        record: Callable[[str, float, float], None] = lambda *_: None,
    ) -> None:
        self.busy: dict[str, tuple[float, str]] = {}
        self._owner = owner
        self._changed, self.record = changed, record
        self._jobs: dict[str, Job[Any]] = {}

    def __bool__(self) -> bool:
        return bool(self._jobs)

    def __contains__(self, kind: str) -> bool:
        return kind in self._jobs

    def add(
        self,
        kind: str,
        job: Job[Any],
        ended: Callable[[Job[Any]], None],
        progress: tuple[float, str] = (0.0, ""),
    ) -> None:
        """Count a job as running until it is dropped; ``ended`` gets it when it is over."""
        self._jobs[kind] = job
        self.busy[kind] = progress
        begun = time.time()  # before the callback that stores a result, so that this comes first
        job.add_done_callback(lambda _: self.record(kind, begun, time.time() - begun))
        job.add_done_callback(ended)

    def progress(self, kind: str) -> Callable[[float, str], None]:
        """Return the progress callback of the job of this kind."""

        def report(fraction: float, message: str) -> None:
            if kind in self._jobs:
                self.busy[kind] = (fraction, message)
                self._changed()

        return report

    def cancel(self, kind: str) -> None:
        """Stop the job of this kind, if one is running."""
        job = self._jobs.get(kind)
        if job is not None:
            job.cancel()

    def drop(self, kind: str, job: Job[Any]) -> bool:
        """Count a job as over; False where a newer one of its kind goes on."""
        newest = self._jobs.get(kind) is job
        if newest:
            del self._jobs[kind]
            self.busy.pop(kind, None)
        return newest

    def deliver(
        self, kind: str, job: Job[Any], keep: Callable[[Any], None]
    ) -> ArtiworldError | Cancelled | None:
        """Give the result of a job that ended to ``keep``; return the error, if there was one."""
        try:
            keep(job.result(0))
        except (ArtiworldError, Cancelled) as error:
            return error
        except Exception as error:  # a job's boundary
            log.exception("job %s of %s failed", kind, self._owner)
            if isinstance(error, WorkerDied):  # of a file, or for want of memory
                return ArtiworldError(str(error))
            return ArtiworldError(f"{error} (a bug; the server's log has the details)")
        return None
