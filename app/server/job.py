"""One call in another process, as this one sees it, and the child process that carries it out:
start, end, results.
"""

from __future__ import annotations

import logging
import math
import multiprocessing
import os
import queue
import signal
import threading
import time
from collections.abc import Callable, Hashable
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

from app.server.worker import WorkerTemplate, pack, send, start_python, unpack
from model.core.errors import ArtiworldError
from model.core.memory import processor_seconds
from model.core.progress import Cancelled

T = TypeVar("T")
JobState = Literal["queued", "running", "done", "failed", "cancelled"]

_log = logging.getLogger(__name__)


class JobFailed(RuntimeError):
    """A job failed by a bug, or because its child process died.

    Attributes:
        details: the child's traceback, or "".
    """

    def __init__(self, message: str, details: str = "") -> None:
        self.details = details
        super().__init__(message)


class WorkerDied(JobFailed):
    """Its child process crashed, or was killed."""


class OutOfTimeError(ArtiworldError):
    """A job took longer than it may."""


@dataclass(eq=False, repr=False)
class Job(Generic[T]):
    """One call in the worker. Made by :meth:`WorkerProcess.submit`; all methods are thread-safe.

    Attributes:
        name: name of the function.
        fraction, message: progress in [0, 1], and the present step.
        error: why it failed: an :class:`~model.core.errors.ArtiworldError` or a :class:`JobFailed`.
        most_work: seconds of a processor that it may use.
        moves: of each worker in turn the seconds of a processor after which the job leaves it for
            those that wait, and what begins it anew elsewhere.
    """

    _ask_to_stop: Callable[[Job[T]], object]
    _number: int
    name: str
    _call: tuple[Any, ...] | None
    _on_progress: Callable[[float, str], object] | None
    _key: Hashable
    _preempted_by: int | None = None
    _works_on: Hashable = None
    _most_seconds: float | None = None
    _repeated: bool = False
    _on_found: Callable[[Any], object] | None = None
    state: JobState = "queued"
    fraction: float = 0.0
    message: str = ""
    error: Exception | None = None
    most_work: float = math.inf
    moves: list[tuple[float, Callable[[Job[Any]], object]]] = field(default_factory=list)
    _since: tuple[float, float] = (0.0, 0.0)  # clock and processor of its child as it began
    _worked: float = 0.0  # seconds of a processor
    _place: tuple[int, int] = (0, 0)  # in the queue
    _begun: bool = False
    _progress_waiting: bool = False
    _ran: float = 0.0  # seconds since it began
    _waited: float = 0.0  # of these, for others
    _deadline: float = math.inf
    _kill_at: float | None = None
    _deaths: int = 0  # of its child while it ran
    _value: Any = None
    _ended: threading.Event = field(default_factory=threading.Event)
    _callbacks: list[Callable[[Job[T]], object]] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def _ends_at(self) -> float:
        """When the child is killed: after a cancellation that it ignored, or out of time."""
        return min(self._deadline, math.inf if self._kill_at is None else self._kill_at)

    @property
    def may_move(self) -> bool:
        """True once it leaves its worker if somebody waits."""
        return bool(self.moves) and self._worked >= self.moves[0][0]

    @property
    def done(self) -> bool:
        """True once it is done, failed or cancelled."""
        return self._ended.is_set()

    def result(self, timeout: float | None = None) -> T:
        """Wait for the end and return the function's value.

        Raises:
            TimeoutError: after ``timeout`` seconds.
            Cancelled: where it was cancelled, or replaced by a newer job of its key.
            ArtiworldError: where the function raised it.
            JobFailed: where it failed otherwise.
        """
        if not self._ended.wait(timeout):
            raise TimeoutError(f"{self.name} is still {self.state} after {timeout} s")
        if self.state == "cancelled":
            raise Cancelled(self.name)
        if self.error is not None:
            raise self.error
        return self._value

    def cancel(self) -> None:
        """Ask it to stop: a queued job ends now, a running one at its next progress call.

        A child that doesn't react within :data:`app.server.jobs.CANCEL_SECONDS` is killed.
        """
        self._ask_to_stop(self)

    def listen(self, on_progress: Callable[[float, str], object]) -> None:
        """Report to ``on_progress`` from now on, beginning with the present progress."""
        self._on_progress = on_progress
        if self.state == "running":
            self._progressed(self.fraction, self.message)

    def add_done_callback(self, callback: Callable[[Job[T]], object]) -> None:
        """Call ``callback(job)`` after the end, on the callback thread."""
        with self._lock:
            if not self._ended.is_set():
                self._callbacks.append(callback)
                return
        _callbacks.call(callback, self)

    def end(self, state: JobState, value: Any = None, error: Exception | None = None) -> None:
        """End it and run its callbacks; only the first end counts."""
        with self._lock:
            if self._ended.is_set():
                return
            self.state, self._value, self.error = state, value, error
            self._call = None
            if state == "done":
                self.fraction = 1.0
            self._ended.set()
            callbacks, self._callbacks = self._callbacks, []
        for callback in callbacks:
            _callbacks.call(callback, self)

    def _found(self, value: Any) -> None:
        if self._on_found is not None:
            _callbacks.call(self._on_found, value)

    def _progressed(self, fraction: float, message: str) -> None:
        self.fraction, self.message = fraction, message
        if self._on_progress is None or self._progress_waiting:
            return
        self._progress_waiting = True  # a slow callback sees the newest value, not a backlog

        def report() -> None:
            self._progress_waiting = False
            if self._on_progress is not None:
                self._on_progress(self.fraction, self.message)

        _callbacks.call(report)


class _CallbackThread:
    """The one thread that runs the callbacks of all workers, in order."""

    def __init__(self) -> None:
        self._calls: queue.SimpleQueue[tuple[Callable[..., object], tuple[Any, ...]]]
        self._calls = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None

    def call(self, callback: Callable[..., object], *args: Any) -> None:
        with self._lock:
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="job callbacks", daemon=True)
                self._thread.start()
        self._calls.put((callback, args))

    def _run(self) -> None:
        while True:
            callback, args = self._calls.get()
            try:
                callback(*args)
            except Exception:  # the others must still run
                _log.exception("a job's callback failed")
            del callback, args


_callbacks = _CallbackThread()


class Child:
    """A started child process with our end of its pipe.

    Args:
        name: name of its worker.
        threads: numeric threads in it.
        setup: its first call.
        template: what it is forked from; None starts an interpreter.

    Attributes:
        ready: whether that call has returned.
        cancelled: numbers of the jobs that it was asked to stop.
    """

    def __init__(
        self,
        name: str,
        threads: int,
        setup: tuple[Any, ...],
        template: WorkerTemplate | None = None,
    ) -> None:
        self.ready = False
        self.cancelled: set[int] = set()
        self.connection: Connection
        self.connection, theirs = multiprocessing.Pipe(duplex=True)
        descriptor = theirs.fileno()
        forked = None if template is None else template.fork(name, descriptor)
        code = f"from app.server.worker import work; work({descriptor}, {os.getpid()}, {name!r})"
        self.process = forked or start_python(code, descriptor, threads)
        theirs.close()
        send(self.connection, "setup", 0, pack(setup))

    def work_of(self, job: Job[Any]) -> float:
        """Seconds of a processor since a job began; half of those by the clock where it waits."""
        clock, processor = job._since
        used = processor_seconds(self.process.pid or 0) - processor
        return max(used, (time.monotonic() - clock) / 2)

    def memory(self) -> int:
        """Bytes that it has in memory, where the system tells; else 0."""
        with suppress(OSError):
            pages = int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1])
            return pages * os.sysconf("SC_PAGE_SIZE")
        return 0

    def kill(self) -> None:
        """Kill the process and wait for its end."""
        self.connection.close()
        self.process.kill()
        self.process.wait()


def finish(job: Job[Any], chunks: list[Any]) -> None:
    """End a job with the result of its child."""
    try:
        kind, value = unpack(chunks)
    except Exception as error:  # an unreadable result fails its job, nothing else
        job.end("failed", error=JobFailed(f"{job.name}: unreadable result: {error}"))
        return
    if kind == "done":
        job.end("done", value)
    elif value["kind"] == "cancelled":
        job.end("cancelled")
    else:
        job.end("failed", error=error_of(job.name, value))


def error_of(name: str, described: dict[str, Any]) -> Exception:
    """Return the exception that :func:`app.server.worker.describe_error` described."""
    if described["kind"] != "user":
        return JobFailed(f"{name}: {described['message']}", described["text"])
    error: ArtiworldError = described["type"].__new__(described["type"], described["message"])
    error.__dict__.update(described["state"])
    return error


def death(code: int | None) -> str:
    """Return a human-readable description of how a process ended."""
    if code is None or code >= 0:
        return f"exited (code {code})"
    name = signal.Signals(-code).name
    if -code == signal.SIGKILL:
        return f"was killed ({name}; often because memory ran out)"
    return f"crashed ({name})"
