"""The jobs that an open object or a scene waits for: what they report, and how they end."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from app.server.jobs import Job
from model.core.errors import ArtiworldError
from model.core.progress import Cancelled

log = logging.getLogger(__name__)


class RunningJobs:
    """Jobs by what they are for; of two for the same the newest counts.

    Args:
        whose: the log calls them so.
        changed: called on every report of a job.

    Attributes:
        busy: how far each job is, 0..1, and what it says.
    """

    def __init__(self, whose: str, changed: Callable[[], None]) -> None:
        self.busy: dict[str, tuple[float, str]] = {}
        self._whose = whose
        self._changed = changed
        self._jobs: dict[str, Job[Any]] = {}

    def __bool__(self) -> bool:
        return bool(self._jobs)

    def __contains__(self, what: str) -> bool:
        return what in self._jobs

    def follow(
        self,
        what: str,
        job: Job[Any],
        ended: Callable[[Job[Any]], None],
        told: tuple[float, str] = (0.0, ""),
    ) -> None:
        """Count a job as running until it is dropped; ``ended`` gets it when it is over."""
        self._jobs[what] = job
        self.busy[what] = told
        job.add_done_callback(ended)

    def progress(self, what: str) -> Callable[[float, str], None]:
        """Takes in what the job for that reports."""

        def tell(fraction: float, message: str) -> None:
            if what in self._jobs:
                self.busy[what] = (fraction, message)
                self._changed()

        return tell

    def cancel(self, what: str) -> None:
        """Stop the job for that, where one is running."""
        job = self._jobs.get(what)
        if job is not None:
            job.cancel()

    def drop(self, what: str, job: Job[Any]) -> bool:
        """Count a job as over; False where a newer one for the same goes on."""
        newest = self._jobs.get(what) is job
        if newest:
            del self._jobs[what]
            self.busy.pop(what, None)
        return newest

    def hand_over(
        self, what: str, job: Job[Any], keep: Callable[[Any], None]
    ) -> ArtiworldError | Cancelled | None:
        """Give the answer of a job that ended to ``keep``.

        Returns:
            What went wrong, in words for people; None where nothing did.
        """
        try:
            keep(job.result(0))
        except (ArtiworldError, Cancelled) as error:
            return error
        except Exception as error:  # a job's boundary: say it and go on
            log.exception("job %s of %s failed", what, self._whose)
            return ArtiworldError(f"{error} (our fault; the details are in the server's log)")
        return None
