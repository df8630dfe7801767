"""Work on many objects in parallel processes, where no object may end the run."""

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
    """An object took too long."""


def robust_map(
    function: Callable[[A], T], ids: Sequence[A], jobs: int, method: str = "fork"
) -> Iterator[tuple[A, T | None]]:
    """``function`` of each id as they are done; None for one whose process died.

    Args:
        function: can be pickled; must not raise.
        ids: hashable, each one once.
        jobs: processes; with one, everything runs in this process and a death is ours too.
        method: how processes start, as of :func:`in_processes`.
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
            # A process died. Those not done are tried one by one; who dies alone is at fault.
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
    """``function`` of each task in processes that end with the block, whatever ends it.

    Ctrl+C goes to the whole process group. The workers don't hear it: the block does, and kills
    them, so that nobody waits for tasks under way and none stays behind.

    Args:
        function: can be pickled.
        tasks: the argument of each call.
        jobs: processes at most.
        method: how they start. "fork" is 3 to 6 s quicker, as nothing is imported anew; it must not
            be used where this process has threads that compute.
    """
    context: Any = multiprocessing.get_context(method)
    pool = ProcessPoolExecutor(min(jobs, len(tasks)), mp_context=context)
    try:
        with _interrupts_held():
            futures = [pool.submit(function, task) for task in tasks]
        yield futures
    except BaseException:
        kill_pool(pool)
        raise
    pool.shutdown()


def kill_pool(pool: ProcessPoolExecutor) -> None:
    """End a pool and its processes at once, without waiting for the tasks under way.

    The pool's own thread is waited for, 5 s at most: where Python ends while the thread closes
    its pipes, Python wakes it through one that is closed already (a traceback at exit).
    """
    manager = cast("threading.Thread | None", pool._executor_manager_thread)
    for process in list((pool._processes or {}).values()):
        process.kill()
    pool.shutdown(wait=False, cancel_futures=True)
    if manager is not None:
        manager.join(5)


def in_order(function: Callable[[A], T], tasks: Sequence[A], jobs: int) -> list[T]:
    """``function`` of each task, in their order, in ``jobs`` new processes; with one, in this one.

    Args:
        function: can be pickled; what it raises is raised here.
    """
    if jobs <= 1 or len(tasks) <= 1:
        return [function(task) for task in tasks]
    with in_processes(function, tasks, jobs, "spawn") as futures:
        return [future.result() for future in futures]


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Ctrl+C is heard after the block, and never by processes that are started in it.

    Where Python forks, an interrupt can be raised in a place that swallows it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # interrupts are none of its business
        return
    resource_tracker.ensure_running()  # on its start it lets interrupts through again
    heard: list[Any] = []
    before = signal.getsignal(signal.SIGINT)
    if callable(before):
        # What this thread blocks may come by another one.
        signal.signal(signal.SIGINT, lambda *how: heard.append(how))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if callable(before):
            signal.signal(signal.SIGINT, before)
    if heard and callable(before):
        before(*heard[0])


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise :class:`OutOfTimeError` in this thread after ``seconds``.

    Where the system or the thread has no alarm, nothing is limited.
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
