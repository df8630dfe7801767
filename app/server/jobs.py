"""Long work in a process of its own, so that the browser never waits for it.

A :class:`WorkerProcess` keeps one child process that runs one job at a time. Caches that a job
leaves in its modules stay for the next one until the child is killed (a cancel that it ignores, out
of memory), so jobs must be able to fill them again. A long job may be preempted: between its steps,
which are its calls of ``progress``, the child runs urgent jobs, with the same caches.
"""

from __future__ import annotations

import heapq
import itertools
import logging
import math
import multiprocessing
import threading
import time
from collections.abc import Callable, Hashable
from multiprocessing.connection import wait
from typing import Any, TypeVar

from app.server.job import (
    Child,
    Job,
    JobFailed,
    OutOfTimeError,
    WorkerDied,
    death,
    error_of,
    finish,
)
from app.server.worker import WorkerTemplate, pack, receive, send, unpack
from model.core.memory import processor_seconds
from model.core.progress import own_threads

T = TypeVar("T")

CANCEL_SECONDS = 3.0
"""Seconds that a cancelled job may go on before its child is killed."""
CLICKS = 9
"""Least priority of the jobs that answer a click."""
EDITS = 15
"""Least priority of the jobs that an edit of a joint waits for."""
PREVIEWS = -5
"""Priority of previews of a click: everything else comes first."""
PATIENCE = 0.25
"""Seconds by which a job's preemptions may exceed the time it ran itself: long jobs keep half of
the processor, and nobody's click starves behind other people's. A choice; without any bound the
95th percentile of ``artiworld bench team`` is 275 instead of 206 ms."""

__all__ = ["CANCEL_SECONDS", "CLICKS", "EDITS", "PREVIEWS", "Job", "JobFailed", "WorkerProcess"]

_log = logging.getLogger(__name__)


class WorkerProcess:
    """One long-lived child process and the queue before it.

    Args:
        name: name in messages and logs.
        initializer: importable function that the child calls first, to load weights for example.
        arguments: of ``initializer``.
        threads: numeric threads in the child (OMP, BLAS); all processors but one by default.
        lazy: whether the child starts with the first job only.
        template: what the child is forked from, with its numeric threads; None starts an
            interpreter.
        most_kept: a child that has more bytes of memory between two jobs begins anew.
    """

    def __init__(
        self,
        name: str,
        *,
        initializer: Callable[..., object] | None = None,
        arguments: tuple[Any, ...] = (),
        threads: int | None = None,
        lazy: bool = False,
        template: WorkerTemplate | None = None,
        most_kept: float = math.inf,
    ) -> None:
        self.name, self._most_kept, self._rests = name, most_kept, False
        self._lazy = lazy
        self._setup = (initializer or _nothing, arguments, {})
        self._threads = threads or own_threads()
        self._template = template
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._queue: list[tuple[int, int, Job[Any]]] = []
        self._of_key: dict[Hashable, tuple[int, int, Job[Any]]] = {}
        self._running: list[Job[Any]] = []  # each one preempted the one before it
        self._tallied = 0.0
        self._closing = False
        self._wake_reader, self._wake_writer = multiprocessing.Pipe(duplex=False)
        self._child: Child | None = None
        self._supervisor = threading.Thread(target=self._supervise, name=f"{name} worker")
        self._supervisor.daemon = True
        self._supervisor.start()

    def submit(
        self,
        function: Callable[..., T],
        *args: Any,
        on_progress: Callable[[float, str], object] | None = None,
        on_found: Callable[[Any], object] | None = None,
        priority: int = 0,
        key: Hashable = None,
        preempted_by: int | None = None,
        works_on: Hashable = None,
        most_seconds: float | None = None,
        repeated: bool = False,
        **kwargs: Any,
    ) -> Job[T]:
        """Queue ``function(*args, **kwargs)``.

        Args:
            function: importable by name. Where it takes ``progress``, it gets a
                :class:`~model.core.progress.Progress` that reports here and stops a cancelled job.
            on_progress: called with (fraction, message) on the callback thread.
            on_found: called there with what the function gives to its parameter ``found`` before
                its end; again where its child died and it runs once more.
            priority: higher runs earlier; equal ones in the order of submission.
            key: replaces a queued (not running) job of the same key, so that only the newest
                click counts.
            preempted_by: queued jobs of at least this priority run between its steps; None for
                none. It starts again where the child dies of one of them.
            works_on: the data that it makes or needs: a job never runs between the steps of
                another one that works on the same data.
            most_seconds: the child is killed, and the job fails, where it takes longer.
            repeated: it runs once more where its child dies: it answers a click, which isn't lost.
        """
        name = getattr(function, "__name__", repr(function))
        number = next(self._numbers)
        call = (function, args, kwargs)
        job: Job[T] = Job(
            self._cancel, number, name, call, on_progress, key, preempted_by, works_on,
            most_seconds, repeated, on_found,
        )  # fmt: skip
        replaced: Job[Any] | None = None
        with self._lock:
            if self._closing:
                raise RuntimeError(f"the worker {self.name!r} is closed")
            job._place = (-priority, number)
            old = self._of_key.get(key) if key is not None else None
            if old is not None and not old[2].done:
                replaced = old[2]
                job._place = (min(-priority, old[0]), old[1])
                self._remove(replaced)
            self._enqueue(job)
        if replaced is not None:
            replaced.end("cancelled")
        self._wake()
        return job

    def adopt(self, job: Job[Any]) -> None:
        """Queue a job of another worker, to run from its beginning."""
        job._ask_to_stop, job._number = self._cancel, next(self._numbers)
        job._place = (job._place[0], job._number)
        self._requeue(job)
        self._wake()

    @property
    def pid(self) -> int | None:
        """Process id of the child; None while there is none."""
        child = self._child
        return None if child is None else child.process.pid

    @property
    def busy(self) -> bool:
        """True while a job is running or queued."""
        with self._lock:
            return bool(self._running or self._queue)

    def rest(self, rests: bool) -> None:
        """Have the child ended, or no longer so, while there is nothing to do."""
        self._rests = rests
        self._wake()

    def begin_to_close(self) -> None:
        """Have the child ended, without waiting for it."""
        with self._lock:
            self._closing = True
        self._wake()

    def close(self) -> None:
        """Cancel everything and end the child. May be called twice."""
        self.begin_to_close()
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
            job.end("cancelled")
        else:
            self._wake()

    def _enqueue(self, job: Job[Any]) -> None:
        entry = (*job._place, job)
        if job._key is not None:
            self._of_key[job._key] = entry
        heapq.heappush(self._queue, entry)

    def _remove(self, job: Job[Any]) -> None:
        self._queue = [entry for entry in self._queue if entry[2] is not job]
        heapq.heapify(self._queue)
        if job._key is not None and self._of_key.get(job._key, (0, 0, None))[2] is job:
            del self._of_key[job._key]

    # The supervisor: the only thread that talks to the child. It also starts the child, and lives
    # as long as the worker, because Linux ties "die with the parent" to the thread that forked.

    def _supervise(self) -> None:
        if not self._lazy:
            self._child = self._start()
        while not self._closing:
            self._send_next()
            child = self._child
            sources = [self._wake_reader] + ([child.connection] if child is not None else [])
            ready = wait(sources, timeout=self._patience())
            if self._wake_reader in ready:
                while self._wake_reader.poll():
                    self._wake_reader.recv_bytes()
            if child is not None and (child.connection in ready or self._running):
                self._listen(child, child.connection in ready)
            self._enforce_cancel()
        self._shut_down()

    def _start(self) -> Child:
        return Child(self.name, self._threads, self._setup, self._template)

    def _patience(self) -> float | None:
        active = self._active
        if active is None:
            return None
        # Not longer: a child may die while a grandchild keeps the pipe open.
        return max(0.0, min(1.0, active._ends_at - time.monotonic()))

    @property
    def _active(self) -> Job[Any] | None:
        """The job that the child works on; those that it preempted wait for it."""
        begun = [job for job in self._running if job._begun] or self._running[:1]
        return begun[-1] if begun else None

    def _next(self) -> Job[Any] | None:
        """Return the queued job that may run now."""
        if not self._running:
            return self._queue[0][2] if self._queue else None
        self._tally(time.monotonic())
        levels = [
            job._preempted_by
            for job in self._running
            if job._preempted_by is not None
            and job._begun
            and job._kill_at is None
            and job._waited <= job._ran + PATIENCE
        ]
        if len(levels) < len(self._running):
            return None
        in_use = {job._works_on for job in self._running} - {None}
        urgent = [e for e in self._queue if -e[0] >= max(levels) and e[2]._works_on not in in_use]
        return min(urgent)[2] if urgent else None

    def _tally(self, now: float) -> None:
        """Add the time since the last call to what the begun jobs ran and waited."""
        spent, self._tallied = now - self._tallied, now
        active = self._active
        for job in self._running:
            if job._begun and job is active:
                job._ran += spent
            elif job._begun:
                job._waited += spent

    def _send_next(self) -> None:
        child = self._child
        rests = self._rests and not self._queue
        if child is not None and not self._running and (rests or child.memory() > self._most_kept):
            _log.info("worker %s ends: it keeps %d MB", self.name, child.memory() >> 20)
            child.kill()
            self._child = None
        while True:
            with self._lock:
                if self._child is None:
                    if not self._queue:
                        return
                    break
                job = self._next() if self._child.ready else None
                if job is None:
                    return
                self._remove(job)
                job.state = "running"
                self._running.append(job)
            try:
                chunks = pack(job._call)
            except Exception as error:  # a call that can't be pickled is the caller's bug
                self._running.remove(job)
                job.end("failed", error=JobFailed(f"{job.name} can't be sent: {error}"))
                continue
            try:
                send(self._child.connection, "job", job._number, chunks)
            except OSError:
                self._died(self._child)
            return
        self._child = self._start()

    def _listen(self, child: Child, has_message: bool) -> None:
        try:
            while has_message:
                self._handle(child, *receive(child.connection))
                if self._child is not child:
                    return
                has_message = child.connection.poll()
            if child.process.poll() is not None and not child.connection.poll():
                raise EOFError
        except (EOFError, OSError):
            self._died(child)

    def _handle(self, child: Child, kind: str, number: int, chunks: list[Any], sent: float) -> None:
        if kind == "ready":
            child.ready = True
            return
        if kind not in ("progress", "found"):
            self._tally(sent)  # not when it is read, which may be late on a busy machine
        job = next((j for j in self._running if j._number == number), None)
        if number == 0:
            self._start_failed(child, unpack(chunks)[1])
        elif job is None:
            return
        elif kind == "begun":
            job._begun = True
            job._since = time.monotonic(), processor_seconds(child.process.pid or 0)
            if job._most_seconds is not None:
                job._deadline = time.monotonic() + job._most_seconds
        elif kind == "progress":
            job._progressed(*unpack(chunks))
        elif kind == "found":
            job._found(unpack(chunks))
        else:
            self._running.remove(job)
            finish(job, chunks)
            active = self._active
            if active is not None and active._kill_at is not None:
                # It couldn't notice while it was preempted.
                active._kill_at = time.monotonic() + CANCEL_SECONDS

    def _start_failed(self, child: Child, error: dict[str, Any]) -> None:
        child.kill()
        self._child = None
        self._fail_first(error_of(self.name, error))

    def _died(self, child: Child) -> None:
        child.kill()
        why = death(child.process.returncode)
        self._child = None
        job, running = self._active, self._running
        self._running = []
        for other in running:
            if other is not job:
                self._requeue(other)
        if job is not None and job._kill_at is not None:
            job.end("cancelled")
        elif job is not None and job._deadline <= time.monotonic():
            most = min(job._most_seconds or math.inf, job.most_work)
            text = f"{job.name} took more than {most:g} s and was ended"
            job.end("failed", error=OutOfTimeError(text))
        elif job is not None and job.may_move:
            job.moves.pop(0)[1](job)
        elif job is not None:
            _log.warning("worker %s: %s while running %s", self.name, why, job.name)
            self._repeat_or_fail(job, why)
        elif not child.ready:
            self._fail_first(JobFailed(f"the worker process {self.name!r} {why} while starting"))
            return  # the next job tries again, which avoids an endless loop
        self._child = self._start()

    def _repeat_or_fail(self, job: Job[Any], why: str) -> None:
        """Queue the job of which the child died once more, or end it."""
        job._deaths += 1
        if job._repeated and job._deaths == 1:
            self._requeue(job)
            return
        times = ", the second time as well: it isn't tried again" if job._deaths > 1 else ""
        text = f"{job.name}: the worker process {why}{times}; it has been started again"
        job.end("failed", error=WorkerDied(text))

    def _requeue(self, job: Job[Any]) -> None:
        """Queue a job again whose child process died, if it is still requested."""
        with self._lock:
            newer = job._key is not None and job._key in self._of_key
            wanted = job._kill_at is None and not newer and not self._closing
            if wanted:
                job.state, job._begun, job._deadline = "queued", False, math.inf
                job._ran = job._waited = job._worked = 0.0
                self._enqueue(job)
        if not wanted:
            job.end("cancelled")

    def _fail_first(self, error: Exception) -> None:
        with self._lock:
            job = self._queue[0][2] if self._queue else None
            if job is not None:
                self._remove(job)
        if job is not None:
            job.end("failed", error=error)
        else:
            _log.error("worker %s: %s", self.name, error)

    def _enforce_cancel(self) -> None:
        active, child = self._active, self._child
        if active is None or child is None:
            return
        if active._begun and active.most_work < math.inf:
            active._worked = child.work_of(active)
            if active._worked >= active.most_work:
                active._deadline = 0.0
        if time.monotonic() >= active._ends_at or (active.may_move and self._queue):
            self._died(child)
            return
        for job in self._running:
            if job._kill_at is None or job._number in child.cancelled:
                continue
            child.cancelled.add(job._number)
            try:
                send(child.connection, "cancel", job._number)
            except OSError:
                self._died(child)
                return

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
        for job in [*self._running, *waiting]:
            job.end("cancelled")
        self._running = []


def _nothing() -> None:
    """Do nothing: the default initializer."""
