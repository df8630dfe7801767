"""Process objects in parallel, where no object may end the run."""

from __future__ import annotations

import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any, TypeVar, cast

T = TypeVar("T")
A = TypeVar("A")


class OutOfTimeError(Exception):
    """An object exceeded its time limit."""


def robust_map(
    function: Callable[[A], T], ids: Sequence[A], jobs: int, method: str = "fork"
) -> Iterator[tuple[A, T | None]]:
    """Yield each id with ``function`` of it as it completes; None where its process died.

    Args:
        function: can be pickled; must not raise.
        ids: hashable and distinct.
        jobs: processes; 1 runs everything in this process, without protection.
        method: how processes start, see :func:`in_processes`.
    """
    if jobs <= 1:
        for i in ids:
            yield i, function(i)
        return
    waiting, suspects = list(ids), set[A]()
    while waiting:
        alone = [i for i in waiting if i in suspects]
        batch = alone[:1] or waiting
        done: set[A] = set()
        try:
            with in_processes(function, batch, jobs, method) as futures:
                of_id = dict(zip(futures, batch, strict=True))
                for future in as_completed(futures):
                    result = future.result()
                    done.add(of_id[future])
                    yield of_id[future], result
        except BrokenProcessPool:
            # A process died: retry the remaining ids one by one to find the culprit.
            left = [i for i in batch if i not in done]
            if len(left) == 1:
                done.add(left[0])
                yield left[0], None
            suspects.update(left)
        waiting = [i for i in waiting if i not in done]


@contextmanager
def in_processes(
    function: Callable[[A], T], tasks: Sequence[A], jobs: int, method: str = "fork"
) -> Iterator[list[Future[T]]]:
    """Run ``function`` of each task in processes that end with the block.

    Ctrl+C reaches the whole process group. The workers ignore it; the block kills them, so that no
    running task is waited for and no process stays behind.

    Args:
        function: can be pickled.
        tasks: the argument of each call.
        jobs: processes at most.
        method: how they start. "fork" is 3 to 6 s faster, as nothing is imported again; it is not
            safe while threads of this process compute.
    """
    context: Any = multiprocessing.get_context(method)
    pool = ProcessPoolExecutor(min(jobs, len(tasks)), mp_context=context)
    try:
        with _delayed_interrupts():
            futures = [pool.submit(function, task) for task in tasks]
        yield futures
    except BaseException:
        kill_pool(pool)
        raise
    pool.shutdown()


def kill_pool(pool: ProcessPoolExecutor) -> None:
    """End a pool and its processes at once, without waiting for running tasks.

    The pool's manager thread is joined for at most 5 s: if Python exits while that closes its
    pipes, Python writes to a closed one (a traceback at exit).
    """
    manager = cast("threading.Thread | None", pool._executor_manager_thread)
    for process in list((pool._processes or {}).values()):
        process.kill()
    pool.shutdown(wait=False, cancel_futures=True)
    if manager is not None:
        manager.join(5)


def in_order(function: Callable[[A], T], tasks: Sequence[A], jobs: int) -> list[T]:
    """Return ``function`` of each task in order, in ``jobs`` new processes, or in this one for 1.

    Args:
        function: can be pickled; its exceptions are raised here.
    """
    if jobs <= 1 or len(tasks) <= 1:
        return [function(task) for task in tasks]
    with in_processes(function, tasks, jobs, "spawn") as futures:
        return [future.result() for future in futures]


@contextmanager
def _delayed_interrupts() -> Iterator[None]:
    """Delay Ctrl+C until after the block, and ignore it in processes started there.

    While Python forks, an interrupt can be raised where it is swallowed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread handles interrupts
        return
    resource_tracker.ensure_running()  # its start unblocks interrupts
    received: list[Any] = []
    before = signal.getsignal(signal.SIGINT)
    if callable(before):
        # A signal blocked in this thread may arrive in another one.
        signal.signal(signal.SIGINT, lambda *how: received.append(how))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if callable(before):
            signal.signal(signal.SIGINT, before)
    if received and callable(before):
        before(*received[0])


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise :class:`OutOfTimeError` in this thread after ``seconds``.

    Nothing is limited where the system or the thread has no alarm.
    """

    def ring(*_: object) -> None:
        raise OutOfTimeError(f"not done after {seconds:g} s")

    try:
        before = signal.signal(signal.SIGALRM, ring)
        signal.setitimer(signal.ITIMER_REAL, seconds)
    except (AttributeError, ValueError):
        yield
        return
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
