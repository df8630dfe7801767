"""Worker processes that outlive their server, because starting four of them takes seconds."""

from __future__ import annotations

import contextlib
import weakref
from collections.abc import Hashable, Iterator
from typing import Any
from unittest import mock

from app.server import workers
from app.server.job import Job
from app.server.jobs import WorkerProcess
from app.server.worker import WorkerTemplate
from model.core.progress import own_threads


class SharedWorker:
    """One server's use of a worker process: stands in for a :class:`WorkerProcess` of its own."""

    def __init__(self, worker: WorkerProcess, lazy: bool) -> None:
        self._worker, self._lazy = worker, lazy
        worker.rest(False)
        self._jobs: weakref.WeakSet[Job[Any]] = weakref.WeakSet()
        self._closed = False

    def submit(
        self,
        function: Any,
        *args: Any,
        key: Hashable = None,
        works_on: Hashable = None,
        **more: Any,
    ) -> Job[Any]:
        if self._closed:
            raise RuntimeError("the worker is closed")
        key, works_on = (None if k is None else (id(self), k) for k in (key, works_on))
        job = self._worker.submit(function, *args, key=key, works_on=works_on, **more)
        self._jobs.add(job)
        return job

    def adopt(self, job: Job[Any]) -> None:
        self._jobs.add(job)
        self._worker.adopt(job)

    def rest(self, rests: bool) -> None:
        """Nothing: other servers use it."""

    @property
    def name(self) -> str:
        return self._worker.name

    @property
    def pid(self) -> int | None:
        return self._worker.pid

    @property
    def busy(self) -> bool:
        return any(not job.done for job in list(self._jobs))

    def begin_to_close(self) -> None:
        """Cancel the jobs of this server."""
        self._closed = True
        for job in list(self._jobs):
            job.cancel()

    def close(self) -> None:
        """Cancel the jobs of this server and wait for their end."""
        self.begin_to_close()
        for job in list(self._jobs):
            with contextlib.suppress(Exception):
                job.result(timeout=20.0)
        self._worker.rest(self._lazy)  # fifty idle processes would leave no memory to the rest


@contextlib.contextmanager
def shared_workers() -> Iterator[None]:
    """Let all servers that start meanwhile share one worker process of each kind."""
    processes: dict[str, WorkerProcess] = {}
    template = WorkerTemplate(own_threads()) if WorkerTemplate.possible() else None

    def worker(name: str, **settings: Any) -> SharedWorker:
        if name not in processes:
            processes[name] = WorkerProcess(name, **settings | {"template": template})
        return SharedWorker(processes[name], settings.get("lazy", False))

    with (
        mock.patch.object(workers, "WorkerProcess", worker),
        mock.patch.object(workers.WorkerTemplate, "possible", return_value=False),
    ):
        yield
    for process in processes.values():
        process.close()
    if template is not None:
        template.close()
