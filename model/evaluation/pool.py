"""Work on many objects in parallel processes, where no object may end the run."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

T = TypeVar("T")


class OutOfTimeError(Exception):
    """An object took too long."""


def robust_map(
    function: Callable[[str], T], ids: Sequence[str], jobs: int
) -> Iterator[tuple[str, T | None]]:
    """``function`` of each id as they are done; None for one whose process died.

    Args:
        function: can be pickled; must not raise.
        ids: each one once.
        jobs: processes; with one, everything runs in this process and a death is ours too.
    """
    if jobs <= 1:
        for i in ids:
            yield i, function(i)
        return
    waiting, suspects = list(ids), set[str]()
    while waiting:
        alone = [i for i in waiting if i in suspects]
        batch = alone[:1] or waiting
        done: set[str] = set()
        try:
            with ProcessPoolExecutor(max_workers=min(jobs, len(batch))) as pool:
                futures = {pool.submit(function, i): i for i in batch}
                for future in as_completed(futures):
                    result = future.result()
                    done.add(futures[future])
                    yield futures[future], result
        except BrokenProcessPool:
            # A process died. Those not done are tried one by one; who dies alone is at fault.
            left = [i for i in batch if i not in done]
            if len(left) == 1:
                done.add(left[0])
                yield left[0], None
            suspects.update(left)
        waiting = [i for i in waiting if i not in done]


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
