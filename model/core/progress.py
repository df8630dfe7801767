"""Long work: its progress and cancellation, and the processes that compute it.

Steps may fail without ending the work. Processes have their numeric threads, and end with their
parent.
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import os
import signal
import sys
from collections.abc import Callable, Hashable, Iterable, Mapping
from pathlib import Path
from typing import Protocol, TypeVar

from cachetools import TTLCache

from model.core.errors import ArtiworldError

T = TypeVar("T")
H = TypeVar("H", bound=Hashable)

log = logging.getLogger(__name__)


class Cancelled(Exception):
    """The person asked to stop. Raised from inside a :class:`Progress` call."""


class Progress(Protocol):
    """Called by long work at every step; may raise :class:`Cancelled`."""

    def __call__(self, fraction: float, message: str) -> None:
        """Report ``fraction`` in [0, 1] and what is being done now, in a few words."""
        ...


def no_progress(fraction: float, message: str) -> None:
    """A :class:`Progress` that reports nothing."""


def scaled_progress(progress: Progress, start: float, end: float) -> Progress:
    """Return a progress whose 0..1 is ``start``..``end`` of ``progress``."""

    def scaled(fraction: float, message: str) -> None:
        progress(start + (end - start) * fraction, message)

    return scaled


def attempt(remarks: list[str], name: str, step: Callable[[], T], default: T) -> T:
    """Return ``step()``; where it fails, log it, add a remark, and return ``default``.

    For one rule among many, and for extras that must not cost the result.
    """
    try:
        return step()
    except Cancelled:
        raise
    except Exception as error:
        log.exception("an optional step failed: %s", name)
        remarks.append(f"{name} failed ({type(error).__name__}: {error}): left out")
        return default


def each(
    items: Iterable[T], step: Callable[[T], object], failed: Callable[[T, Exception], object]
) -> None:
    """Call ``step`` for each stored item; one that raises goes to ``failed``, and the rest go on.

    Raises:
        Cancelled: where a step was cancelled.
    """
    for item in items:
        try:
            step(item)
        except Cancelled:
            raise
        except Exception as error:
            if not isinstance(error, ArtiworldError | OSError):
                log.exception("work on %s failed", item)
            failed(item, error)


MOST_TRIES, ASIDE_SECONDS = 3, 600.0


class StoredWork:
    """Work that is repeated for stored items; one that fails too often is set aside for a while.

    Attributes:
        aside: (work, item) → failures in a row, and the last error; forgotten after a while.
    """

    def __init__(self) -> None:
        self.aside = TTLCache[tuple[str, Hashable], tuple[int, str]](10_000, ASIDE_SECONDS)

    def each(self, work: str, items: Iterable[H], step: Callable[[H], object]) -> None:
        """Call ``step`` for each item that isn't set aside."""

        def one(item: H) -> None:
            step(item)
            self.aside.pop((work, item), None)

        def failures(item: H) -> int:
            return self.aside.get((work, item), (0, ""))[0]

        def failed(item: H, error: Exception) -> None:
            self.aside[work, item] = failures(item) + 1, f"{type(error).__name__}: {error}"

        each([i for i in items if failures(i) < MOST_TRIES], one, failed)


NAMES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
"""Variables that numpy's and torch's libraries read."""

BY_DEFAULT = "ARTIWORLD_THREADS_BY_DEFAULT"
"""Holds those of :data:`NAMES` that :func:`with_threads` set and not the person."""


def own_threads() -> int:
    """Numeric threads of a worker process: one processor is left to the server."""
    return max(1, (os.cpu_count() or 2) - 1)


def with_threads(environment: Mapping[str, str], threads: int) -> dict[str, str]:
    """The environment of a child process with so many threads; what is set in it stays."""
    ours = [name for name in NAMES if name not in environment]
    return {**{name: str(threads) for name in ours}, BY_DEFAULT: ",".join(ours), **environment}


def chosen_by_person(environment: Mapping[str, str]) -> bool:
    """True if the user set the number of torch's threads."""
    ours = environment.get(BY_DEFAULT, "").split(",")
    return any(n in environment and n not in ours for n in ("OMP_NUM_THREADS", "MKL_NUM_THREADS"))


_PR_SET_PDEATHSIG = 1


def die_with_parent(parent: int) -> None:
    """Have Linux kill this process with its parent; elsewhere the closed pipe ends it."""
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        # Out of memory, the kernel should kill the worker rather than the server.
        with contextlib.suppress(OSError):
            Path("/proc/self/oom_score_adj").write_text("500")
    if os.getppid() != parent:
        os._exit(0)
