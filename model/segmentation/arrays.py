"""Short names of array types, and two threads for numpy and scipy.

Both libraries release Python's lock; results don't depend on the threads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np
import numpy.typing as npt

Bool = npt.NDArray[np.bool_]
Int = npt.NDArray[np.integer]
Int8 = npt.NDArray[np.int8]
Int16 = npt.NDArray[np.int16]
Int32 = npt.NDArray[np.int32]
Int64 = npt.NDArray[np.int64]
Uint8 = npt.NDArray[np.uint8]
Uint64 = npt.NDArray[np.uint64]
Float = npt.NDArray[np.floating]
Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]

Labels = Int16
"""(E,), (N,) or (C,): the part of each element, node or superpoint."""


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
