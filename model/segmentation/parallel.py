"""Two threads for numpy and scipy, which release Python's lock; results don't depend on them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

WORKERS = 2

A = TypeVar("A")
B = TypeVar("B")


def mapped(function: Callable[[A], B], items: Iterable[A]) -> list[B]:
    """``function`` of each item in order, on two threads."""
    waiting = list(items)
    if len(waiting) < 2:
        return [function(item) for item in waiting]
    with ThreadPoolExecutor(WORKERS) as pool:
        return list(pool.map(function, waiting))


def together(first: Callable[[], A], second: Callable[[], B]) -> tuple[A, B]:
    """The results of two functions that run side by side."""
    with ThreadPoolExecutor(1) as pool:
        other = pool.submit(second)
        return first(), other.result()
