"""Prompts (clicks and regions), and the labels that answer them."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from numbers import Integral, Real
from typing import Any

import numpy as np

from model.core.asset import MAX_PARTS
from model.core.errors import PromptError
from model.segmentation.arrays import Int16, Int64

BASE = 0
"""Part 0 is the base: elements that no prompt claims."""

UNASSIGNED = -1


@dataclass(frozen=True)
class Click:
    """One prompt point.

    Attributes:
        position: (x, y, z) metres, object frame.
        part: part id, 0 is the base.
        positive: True where the point belongs to the part, False where it does not.
        element: the clicked face or point, if known; otherwise the nearest one counts.
    """

    position: tuple[float, float, float]
    part: int
    positive: bool = True
    element: int | None = None

    def __post_init__(self) -> None:
        given = tuple(self.position) if isinstance(self.position, Iterable) else ()
        if len(given) != 3 or not all(_is_number(v) and math.isfinite(v) for v in given):
            raise PromptError(f"a click needs three finite coordinates, got {self.position!r:.80}")
        if not isinstance(self.positive, bool | np.bool_):
            raise PromptError(f"positive must be True or False, got {self.positive!r:.80}")
        if self.element is not None:
            object.__setattr__(self, "element", _whole(self.element, "a click's element"))
        # Plain numbers, as keys are made from their text.
        object.__setattr__(self, "position", tuple(float(v) for v in given))
        object.__setattr__(self, "part", _part(self.part, "a click's part"))
        object.__setattr__(self, "positive", bool(self.positive))


@dataclass(frozen=True, eq=False)
class Region:
    """Elements chosen by box, lasso, brush or a merge of parts; labels follow them exactly.

    Attributes:
        part: the part that they belong to, or don't (they return to the other parts then).
        elements: (K,) int64 sorted unique element indices.
    """

    part: int
    elements: Int64
    positive: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "part", _part(self.part, "a region's part"))
        given = np.asarray(self.elements)
        if given.size and given.dtype.kind not in "iu":
            raise PromptError(f"a region's elements must be whole numbers, got {given.dtype}")
        elements = np.unique(given.astype(np.int64))
        if len(elements) and elements[0] < 0:
            raise PromptError("a region's elements must be 0 or more")
        elements.flags.writeable = False
        object.__setattr__(self, "elements", elements)


@dataclass(frozen=True, eq=False)
class Prompts:
    """All prompts in order; where two contradict each other, the later one counts."""

    items: tuple[Click | Region, ...] = ()

    @property
    def clicks(self) -> tuple[Click, ...]:
        """The clicks in order."""
        return tuple(p for p in self.items if isinstance(p, Click))

    @property
    def parts(self) -> tuple[int, ...]:
        """Ids of all parts with prompts, and the base, ascending."""
        return tuple(sorted({BASE, *(p.part for p in self.items)}))

    def key(self) -> str:
        """Digest of the prompts: equal prompts have equal keys (but 0.0 and -0.0 differ)."""
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
        labels: (E,) int16, read-only, from -1 to ``MAX_PARTS`` - 1; any integer type is accepted.
        segmenter: its name.
        seconds: computing time.
    """

    labels: Int16
    segmenter: str = ""
    seconds: float = field(default=0.0, compare=False)

    def __post_init__(self) -> None:
        given = np.asarray(self.labels)
        if given.ndim != 1:
            raise PromptError(f"labels must have shape (E,), got {given.shape}")
        if given.size:
            if given.dtype.kind not in "iu":
                raise PromptError(f"labels must be integers, got {given.dtype}")
            low, high = int(given.min()), int(given.max())
            if low < UNASSIGNED or high >= MAX_PARTS:
                raise PromptError(
                    f"labels must be {UNASSIGNED}..{MAX_PARTS - 1}, got {low}..{high}"
                )
        labels = np.array(given, dtype=np.int16)
        labels.flags.writeable = False
        object.__setattr__(self, "labels", labels)

    @property
    def parts(self) -> tuple[int, ...]:
        """Ids of the parts with at least one element, ascending, without -1."""
        return tuple(int(i) for i in np.unique(self.labels) if i >= 0)


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _whole(value: Any, what: str) -> int:
    if not isinstance(value, Integral) or isinstance(value, bool):
        raise PromptError(f"{what} must be a whole number, got {value!r:.80}")
    return int(value)


def _part(value: Any, what: str) -> int:
    part = _whole(value, what)
    if not 0 <= part < MAX_PARTS:
        raise PromptError(f"{what} must be 0..{MAX_PARTS - 1}, got {part}")
    return part
