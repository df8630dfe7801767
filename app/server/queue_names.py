"""Names of objects in the queue: distinct, and short enough for a button."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from sessions.database import ObjectRecord


def queue_names(records: Sequence[ObjectRecord]) -> dict[int, str]:
    """Id → name; the suffix or the folders distinguish equal names."""
    same: dict[str, list[ObjectRecord]] = defaultdict(list)
    for record in records:
        same[record.name].append(record)
    out: dict[int, str] = {}
    for name, group in same.items():
        names = [name] * len(group)
        if len(group) > 1:
            names = _distinct_names(name, group)
        out.update(zip((r.id for r in group), names, strict=True))
    return out


def _distinct_names(name: str, group: list[ObjectRecord]) -> list[str]:
    deepest = max(len(r.path.parts) for r in group)
    names = [f"{name}{r.path.suffix}" for r in group]
    for depth in range(1, deepest):
        if len(set(names)) == len(names):
            break
        folders = ["/".join(r.path.parts[-1 - depth : -1]) for r in group]
        names = [f"{folder}/{name}" for folder in folders]
        if len(set(names)) < len(names):
            names = [f"{n}{r.path.suffix}" for n, r in zip(names, group, strict=True)]
    return names


def clipped(text: str, limit: int) -> str:
    """``text`` in at most ``limit`` characters; the middle goes, as names often begin alike."""
    if len(text) <= limit:
        return text
    head = (limit - 1) // 3
    return f"{text[:head]}…{text[len(text) - (limit - 1 - head) :]}"
