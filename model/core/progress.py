"""Progress of long work, its cancellation, and steps that may fail without ending it."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Protocol, TypeVar

T = TypeVar("T")

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
