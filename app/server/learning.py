"""Learns from accepted objects in a process of its own, one run at a time."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from app.server.job import Job
from app.server.jobs import WorkerProcess
from app.server.worker import WorkerTemplate
from app.server.workers import READING, in_background
from model.core.errors import CommandError, ConfigurationError
from model.core.progress import Progress, no_progress
from sessions.command_log import open_database
from sessions.quality import seconds_in
from sessions.releases import accepted_assets
from sessions.store import Store


def learn_from(
    workspace: Path,
    database: str | None,
    without: Sequence[str] = (),
    jobs: int = 1,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Learn from the accepted objects of a workspace, but for second annotations and those
    whose asset is gone, which are recorded as left out.

    Returns:
        The record of the version, see :class:`model.training.experience.Learned`.

    Args:
        without: names of objects that are left out.

    Raises:
        ConfigurationError: for an unknown object, or too few accepted ones.
    """
    from model.training.experience import learn  # needs torch, which the server does without

    opened, store = open_database(workspace, database), Store(workspace, database)
    try:
        broken: list[str] = []
        found = accepted_assets(store, {second.object for second in seconds_in(opened)}, broken)
    finally:
        store.close()
        opened.close()
    unknown = [name for name in without if name not in {a.name for a in found}]
    if unknown:
        raise ConfigurationError(f"no accepted object is called {', '.join(unknown)}")
    folders = [a.folder for a in found if a.name not in without]
    left_out = (*without, *broken)
    return asdict(learn(workspace, folders, left_out, jobs=jobs, progress=progress))


class Learning:
    """One run at a time for a server.

    Args:
        template: its process is forked from it.
    """

    def __init__(
        self, workspace: Path, database: str | None, template: WorkerTemplate | None
    ) -> None:
        self._workspace, self._database, self._template = workspace, database, template
        self._worker: WorkerProcess | None = None
        self._lock = threading.Lock()

    def start(self, done: Callable[[Job[dict[str, Any]]], None]) -> None:
        """Begin; ``done`` gets the ended job on another thread.

        Raises:
            CommandError: where it runs already.
        """
        with self._lock:
            if self._worker is not None:
                raise CommandError("it is learning already")
            worker = self._worker = WorkerProcess(
                "learning",
                initializer=in_background,
                arguments=(READING,),
                template=self._template,
            )
        job = worker.submit(learn_from, self._workspace, self._database)

        def ended(job: Job[dict[str, Any]]) -> None:
            done(job)
            threading.Thread(target=self.close, name="learning ends").start()

        job.add_done_callback(ended)

    def close(self) -> None:
        """End it, whether it is done or not."""
        with self._lock:
            worker, self._worker = self._worker, None
        if worker is not None:
            worker.close()
