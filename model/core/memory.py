"""Memory of the machine, and a limit for a process that reads untrusted files."""

from __future__ import annotations

import os
import resource
from pathlib import Path

_CGROUP = Path("/sys/fs/cgroup/memory.max")
LEAST = 2 << 30
"""Bytes that a limit leaves at least: the libraries alone take half of it."""


def machine_memory() -> int:
    """Bytes of memory of this machine, or of the container that it is."""
    total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if _CGROUP.exists() and (text := _CGROUP.read_text().strip()).isdigit():
        total = min(total, int(text))
    return total


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
