"""Protocols of scenes: readers, and finders of articulable objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from model.scenes.scene import Scene


@runtime_checkable
class SceneReader(Protocol):
    """One kind of scene file."""

    name: str
    description: str

    def recognises(self, path: Path, head: bytes) -> bool:
        """True if the file is of this kind, by its name and its first 64 KiB."""
        ...

    def read(self, path: Path) -> Scene:
        """Read it; a broken object is reported in ``problems`` and left out, the rest goes on.

        Raises:
            InputFileError: where the file as a whole is no scene of this kind.
        """
        ...


@dataclass(frozen=True)
class ObjectDescription:
    """A finder's input for one object.

    Attributes:
        description: human-readable.
        category: or None.
        size: (x, y, z) metres, or None where nobody knows.
    """

    description: str
    category: str | None = None
    size: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Decision:
    """Decision whether an object can be articulated.

    Attributes:
        articulable: yes or no.
        parts: kinds of moving parts to expect.
        reason: human-readable.
        kind: recognised kind of object, or None.
        base: whether its base belongs to the world (``fixed``) or is free to move; None where
            nobody knows.
        confidence: 0..1.
    """

    articulable: bool
    parts: tuple[str, ...] = ()
    reason: str = ""
    kind: str | None = None
    base: str | None = None
    confidence: float = 1.0


@runtime_checkable
class ArticulableFinder(Protocol):
    """Says which objects can be articulated, into which parts, and why ("a language model decides
    which objects can be articulated", ArtiWorld, pipeline step 1)."""

    name: str

    def find(self, objects: Sequence[ObjectDescription]) -> list[Decision]:
        """One decision an object, in their order."""
        ...
