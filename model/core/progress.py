"""Progress of long work, and its cancellation."""

from __future__ import annotations

from typing import Protocol


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
