"""Memory: how much there is, a limit for a process, and a least-recently-used cache.

The limit is for processes that handle what strangers made. The cache is limited in entries and in
weight.
"""

from __future__ import annotations

import hashlib
import os
import resource
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

_CGROUP = Path("/sys/fs/cgroup/memory.max")
LEAST = 2 << 30
"""Bytes that a limit leaves at least: the libraries alone take half of it."""


def machine_memory() -> int:
    """Bytes of memory of this machine, or of the container that it is."""
    total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if _CGROUP.exists() and (text := _CGROUP.read_text().strip()).isdigit():
        total = min(total, int(text))
    return total


def processor_seconds(pid: int) -> float:
    """Seconds of a processor that a process and its ended children used; 0 where nothing tells."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


def limit_memory(share: float) -> None:
    """Make this process get a MemoryError beyond a share of the machine's memory.

    Its data counts, not what it maps from files; macOS knows no such limit.
    """
    limit_process(max(int(share * machine_memory()), LEAST))


def limit_process(most: int) -> None:
    """As :func:`limit_memory`, with the limit in bytes."""
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    if hard != resource.RLIM_INFINITY:
        most = min(most, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (most, hard))


K = TypeVar("K")
V = TypeVar("V")


def array_digest(*arrays: npt.NDArray) -> bytes:
    """Hash the content, types and shapes of arrays."""
    digest = hashlib.blake2b(digest_size=16)
    for array in arrays:
        digest.update(f"{array.dtype}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.digest()


class LruCache(Generic[K, V]):
    """Values of an expensive function, for one process.

    Unlike ``cachetools.LRUCache`` it limits both number and weight, makes room before a heavy value
    is computed, and keeps the last value even if that alone is too heavy.

    Args:
        size: largest number of values.
        weight: largest weight of all values together, in any unit.
    """

    def __init__(self, size: int, weight: float = float("inf")) -> None:
        self._size, self._most = size, weight
        self._values: OrderedDict[K, tuple[V, float]] = OrderedDict()
        self._total = 0.0

    def get(
        self,
        key: K,
        make: Callable[[], V],
        weight: float = 0.0,
        weigh: Callable[[V], float] | None = None,
    ) -> V:
        """Return the value of ``key``; make it if needed, after making room for its ``weight``.

        Args:
            weigh: weight of the value, where only the value tells it.
        """
        found = self._values.get(key)
        if found is not None:
            self._values.move_to_end(key)
            return found[0]
        self._make_room(weight)
        value = make()
        weight = weight if weigh is None else weigh(value)
        self._drop(key)  # another job may have made it meanwhile
        self._make_room(weight)
        self._values[key] = value, weight
        self._total += weight
        return value

    def clear(self) -> None:
        """Drop all values."""
        self._values.clear()
        self._total = 0.0

    def _make_room(self, weight: float) -> None:
        while self._values and (
            len(self._values) >= self._size or weight + self._total > self._most
        ):
            self._drop(next(iter(self._values)))

    def _drop(self, key: K) -> None:
        found = self._values.pop(key, None)
        if found is not None:
            self._total -= found[1]
