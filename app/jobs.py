"""Long work in a process of its own, so that the browser never waits for it.

A :class:`WorkerProcess` keeps one child process that runs one job at a time. Caches that a job
leaves in its modules stay for the next one until the child is killed (a cancel that it ignores, out
of memory): jobs must be able to build them again.
"""

from __future__ import annotations

import heapq
import itertools
import logging
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Hashable
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar

from app.job import Job, JobFailed
from app.worker import pack, receive, send, unpack
from model.errors import ArtiworldError
from model.threads import with_threads

T = TypeVar("T")

CANCEL_SECONDS = 3.0
"""How long a running job may take to notice that it was cancelled before the child is killed."""

__all__ = ["CANCEL_SECONDS", "Job", "JobFailed", "WorkerProcess"]

_log = logging.getLogger(__name__)


class WorkerProcess:
    """One long-lived child process and the queue before it.

    Args:
        name: for people and logs.
        initializer: importable function that the child calls first (for example to load weights).
        arguments: of ``initializer``.
        threads: numeric threads in the child (OMP, BLAS); all processors but one by default.
    """

    def __init__(
        self,
        name: str,
        *,
        initializer: Callable[..., object] | None = None,
        arguments: tuple[Any, ...] = (),
        threads: int | None = None,
    ) -> None:
        self.name = name
        self._setup = (initializer or _nothing, arguments, {})
        self._threads = threads or max(1, (os.cpu_count() or 2) - 1)
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._queue: list[tuple[int, int, Job[Any]]] = []
        self._of_key: dict[Hashable, tuple[int, int, Job[Any]]] = {}
        self._running: Job[Any] | None = None
        self._closing = False
        self._wake_reader, self._wake_writer = multiprocessing.Pipe(duplex=False)
        self._child: _Child | None = None
        self._supervisor = threading.Thread(target=self._supervise, name=f"{name} worker")
        self._supervisor.daemon = True
        self._supervisor.start()

    def submit(
        self,
        function: Callable[..., T],
        *args: Any,
        on_progress: Callable[[float, str], object] | None = None,
        priority: int = 0,
        key: Hashable = None,
        **kwargs: Any,
    ) -> Job[T]:
        """Queue ``function(*args, **kwargs)``.

        Args:
            function: importable by name. Where it takes ``progress``, it gets a
                :class:`~model.progress.Progress` that reports here and stops a cancelled job.
            on_progress: called with (fraction, message) on the callback thread.
            priority: higher runs earlier; equal ones in the order of submission.
            key: a queued (not running) job of the same key is cancelled and this one takes its
                place, so that where clicks come faster than answers only the newest counts.
        """
        name = getattr(function, "__name__", repr(function))
        number = next(self._numbers)
        job: Job[T] = Job(self._cancel, number, name, (function, args, kwargs), on_progress, key)
        replaced: Job[Any] | None = None
        with self._lock:
            if self._closing:
                raise RuntimeError(f"the worker {self.name!r} is closed")
            entry = (-priority, number, job)
            old = self._of_key.get(key) if key is not None else None
            if old is not None and not old[2].done:
                replaced = old[2]
                entry = (min(-priority, old[0]), old[1], job)
                self._queue.remove(old)
                heapq.heapify(self._queue)
            if key is not None:
                self._of_key[key] = entry
            heapq.heappush(self._queue, entry)
        if replaced is not None:
            replaced._end("cancelled")
        self._wake()
        return job

    @property
    def pid(self) -> int | None:
        """Process id of the child, None while there is none."""
        child = self._child
        return None if child is None else child.process.pid

    @property
    def busy(self) -> bool:
        """Whether a job is running or queued."""
        with self._lock:
            return self._running is not None or bool(self._queue)

    def close(self) -> None:
        """Cancel everything and end the child. May be called twice."""
        with self._lock:
            self._closing = True
        self._wake()
        if threading.current_thread() is not self._supervisor:
            self._supervisor.join(timeout=5.0)

    def __enter__(self) -> WorkerProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _wake(self) -> None:
        with self._lock:
            if not self._wake_writer.closed:
                self._wake_writer.send_bytes(b"!")

    def _cancel(self, job: Job[Any]) -> None:
        with self._lock:
            if job.done or job._kill_at is not None:
                return
            queued = job.state == "queued"
            if queued:
                self._remove(job)
            else:
                job._kill_at = time.monotonic() + CANCEL_SECONDS
        if queued:
            job._end("cancelled")
        else:
            self._wake()

    def _remove(self, job: Job[Any]) -> None:
        self._queue = [entry for entry in self._queue if entry[2] is not job]
        heapq.heapify(self._queue)
        if job._key is not None and self._of_key.get(job._key, (0, 0, None))[2] is job:
            del self._of_key[job._key]

    # The supervisor: the only thread that talks to the child. It also starts the child, and lives
    # as long as the worker, because Linux ties "die with the parent" to the thread that forked.

    def _supervise(self) -> None:
        self._child = _Child(self)
        while not self._closing:
            self._send_next()
            child = self._child
            sources = [self._wake_reader] + ([child.connection] if child is not None else [])
            ready = wait(sources, timeout=self._patience())
            if self._wake_reader in ready:
                while self._wake_reader.poll():
                    self._wake_reader.recv_bytes()
            if child is not None and (child.connection in ready or self._running is not None):
                self._listen(child, child.connection in ready)
            self._enforce_cancel()
        self._shut_down()

    def _patience(self) -> float | None:
        running = self._running
        if running is None:
            return None
        if running._kill_at is None:
            return 1.0  # look after a child that died while a grandchild keeps the pipe open
        return max(0.0, min(1.0, running._kill_at - time.monotonic()))

    def _send_next(self) -> None:
        while self._running is None:
            with self._lock:
                if not self._queue:
                    return
                if self._child is None:
                    break
                if not self._child.ready:
                    return
                _, _, job = heapq.heappop(self._queue)
                if job._key is not None and self._of_key.get(job._key, (0, 0, None))[2] is job:
                    del self._of_key[job._key]
                job.state = "running"
                self._running = job
            try:
                chunks = pack(job._call)
            except (
                Exception
            ) as error:  # what can't be pickled is the caller's bug, not ours to die of
                self._running = None
                job._end("failed", error=JobFailed(f"{job.name} can't be sent: {error}"))
                continue
            job._call = None
            try:
                send(self._child.connection, "job", job._number, chunks)
            except OSError:
                self._died(self._child)
            return
        if self._running is None:
            self._child = _Child(self)

    def _listen(self, child: _Child, has_message: bool) -> None:
        try:
            while has_message:
                kind, number, chunks = receive(child.connection)
                self._handle(child, kind, number, chunks)
                if self._child is not child:
                    return
                has_message = child.connection.poll()
            if child.process.poll() is not None and not child.connection.poll():
                raise EOFError
        except (EOFError, OSError):
            self._died(child)

    def _handle(self, child: _Child, kind: str, number: int, chunks: list[Any]) -> None:
        if kind == "ready":
            child.ready = True
            return
        job = self._running
        if number == 0:
            self._start_failed(child, unpack(chunks)[1])
        elif job is None or job._number != number:
            return
        elif kind == "progress":
            job._progressed(*unpack(chunks))
        else:
            self._running = None
            _finish(job, chunks)

    def _start_failed(self, child: _Child, error: dict[str, Any]) -> None:
        child.kill()
        self._child = None
        self._fail_first(_error_of(self.name, error))

    def _died(self, child: _Child) -> None:
        child.kill()
        why = _death(child.process.returncode)
        self._child = None
        job, self._running = self._running, None
        if job is not None and job._kill_at is not None:
            job._end("cancelled")
        elif job is not None:
            _log.warning("worker %s: %s while running %s", self.name, why, job.name)
            text = f"{job.name}: the worker process {why}; it has been started again"
            job._end("failed", error=JobFailed(text))
        elif not child.ready:
            self._fail_first(JobFailed(f"the worker process {self.name!r} {why} while starting"))
            return  # the next job tries again; no restart in a circle
        self._child = _Child(self)

    def _fail_first(self, error: Exception) -> None:
        with self._lock:
            job = self._queue[0][2] if self._queue else None
            if job is not None:
                self._remove(job)
        if job is not None:
            job._end("failed", error=error)
        else:
            _log.error("worker %s: %s", self.name, error)

    def _enforce_cancel(self) -> None:
        job, child = self._running, self._child
        if job is None or child is None or job._kill_at is None:
            return
        if time.monotonic() >= job._kill_at:
            self._died(child)
        elif child.cancelled != job._number:
            child.cancelled = job._number
            try:
                send(child.connection, "cancel", job._number)
            except OSError:
                self._died(child)

    def _shut_down(self) -> None:
        with self._lock:
            waiting = [job for _, _, job in self._queue]
            self._queue.clear()
            self._of_key.clear()
            self._wake_writer.close()
            self._wake_reader.close()
        child, self._child = self._child, None
        if child is not None:
            child.kill()
        for job in [*([self._running] if self._running else []), *waiting]:
            job._end("cancelled")
        self._running = None


class _Child:
    """A started child process with our end of its pipe."""

    def __init__(self, worker: WorkerProcess) -> None:
        self.ready = False
        self.cancelled = 0
        self.connection: Connection
        self.connection, theirs = multiprocessing.Pipe(duplex=True)
        descriptor = theirs.fileno()
        paths = [os.path.abspath(p) for p in sys.path]
        code = (
            f"import sys; sys.path[:] = {paths!r}; from app.worker import main; "
            f"main({descriptor}, {os.getpid()}, {worker.name!r})"
        )
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-c", code],
            pass_fds=[descriptor],
            stdin=subprocess.DEVNULL,
            env=with_threads(os.environ, worker._threads),
        )
        theirs.close()
        send(self.connection, "setup", 0, pack(worker._setup))

    def kill(self) -> None:
        """End the process now and collect it."""
        self.connection.close()
        self.process.kill()
        self.process.wait()


def _nothing() -> None:
    """The initializer where there is none."""


def _finish(job: Job[Any], chunks: list[Any]) -> None:
    try:
        kind, value = unpack(chunks)
    except Exception as error:  # an answer that can't be read back fails its job, nothing else
        job._end("failed", error=JobFailed(f"{job.name}: the answer can't be read: {error}"))
        return
    if kind == "done":
        job._end("done", value)
    elif value["kind"] == "cancelled":
        job._end("cancelled")
    else:
        job._end("failed", error=_error_of(job.name, value))


def _error_of(name: str, described: dict[str, Any]) -> Exception:
    if described["kind"] != "user":
        return JobFailed(f"{name}: {described['message']}", described["text"])
    error: ArtiworldError = described["type"].__new__(described["type"], described["message"])
    error.__dict__.update(described["state"])
    return error


def _death(code: int | None) -> str:
    if code is None or code >= 0:
        return f"ended by itself (exit code {code})"
    name = signal.Signals(-code).name
    if -code == signal.SIGKILL:
        return f"was killed ({name}; often because memory ran out)"
    return f"crashed ({name})"
