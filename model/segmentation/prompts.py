"""What a person says about the parts: clicks and regions, and the labels that follow."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from model.errors import PromptError

BASE = 0
"""Part 0 is the base: what no prompt claims belongs to it."""

UNASSIGNED = -1
MAX_PARTS = 1000


@dataclass(frozen=True)
class Click:
    """One prompt point.

    Attributes:
        position: (x, y, z) metres, object frame.
        part: part id, 0 is the base.
        positive: True where the point belongs to the part, False where it does not.
        element: the clicked face or point, where the picker knew it; exact beats nearest.
    """

    position: tuple[float, float, float]
    part: int
    positive: bool = True
    element: int | None = None

    def __post_init__(self) -> None:
        if len(self.position) != 3 or not all(math.isfinite(v) for v in self.position):
            raise PromptError(f"a click needs three finite coordinates, got {self.position}")
        if not 0 <= self.part < MAX_PARTS:
            raise PromptError(f"a click's part must be 0..{MAX_PARTS - 1}, got {self.part}")


@dataclass(frozen=True, eq=False)
class Region:
    """Elements chosen by box, lasso, brush or a merge of parts; they count exactly.

    Attributes:
        part: the part they belong to (positive) or don't (negative: back to the other parts).
        elements: (K,) int64 sorted unique element indices.
    """

    part: int
    elements: npt.NDArray[np.int64]
    positive: bool = True

    def __post_init__(self) -> None:
        if not 0 <= self.part < MAX_PARTS:
            raise PromptError(f"a region's part must be 0..{MAX_PARTS - 1}, got {self.part}")
        elements = np.unique(np.asarray(self.elements, dtype=np.int64))
        if len(elements) and elements[0] < 0:
            raise PromptError("a region's elements must be 0 or more")
        elements.flags.writeable = False
        object.__setattr__(self, "elements", elements)


@dataclass(frozen=True, eq=False)
class Prompts:
    """Everything said so far, in the order it was said (later beats earlier where they clash)."""

    items: tuple[Click | Region, ...] = ()

    @property
    def clicks(self) -> tuple[Click, ...]:
        """The clicks in order."""
        return tuple(p for p in self.items if isinstance(p, Click))

    @property
    def parts(self) -> tuple[int, ...]:
        """Ids of all the parts named by a prompt, and the base, ascending."""
        return tuple(sorted({BASE, *(p.part for p in self.items)}))

    def key(self) -> str:
        """Digest of the prompts: equal prompts have equal keys."""
        digest = hashlib.sha256()
        for p in self.items:
            if isinstance(p, Click):
                digest.update(repr(("c", p.position, p.part, p.positive, p.element)).encode())
            else:
                digest.update(repr(("r", p.part, p.positive)).encode())
                digest.update(p.elements.tobytes())
        return digest.hexdigest()[:24]


@dataclass(frozen=True, eq=False)
class PartSegmentation:
    """One label for each element of an asset. -1 is unassigned; label i is ``link_i``.

    Attributes:
        labels: (E,) int16, read-only.
        segmenter: who answered.
        seconds: how long it took.
    """

    labels: npt.NDArray[np.int16]
    segmenter: str = ""
    seconds: float = field(default=0.0, compare=False)

    def __post_init__(self) -> None:
        labels = np.array(self.labels, dtype=np.int16)
        if labels.ndim != 1:
            raise PromptError(f"labels must have shape (E,), got {labels.shape}")
        labels.flags.writeable = False
        object.__setattr__(self, "labels", labels)

    @property
    def parts(self) -> tuple[int, ...]:
        """Ids of the parts that own at least one element, ascending, without -1."""
        return tuple(int(i) for i in np.unique(self.labels) if i >= 0)
