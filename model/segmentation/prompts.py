"""Prompts (clicks and regions), the labels that answer them, and simulated clicks.

The first simulated click is the part's deepest point (or a random one); each next one is the
deepest point of the larger error, missing or extra (Zhou et al., *Point-SAM*, 2024), or, with many
parts, of the largest error cluster by pair of true and given part (Yue et al., *AGILE3D*, 2024).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from numbers import Integral, Real
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from model.core.asset import MAX_PARTS
from model.core.errors import PromptError
from model.segmentation.arrays import Bool, Float, Int, Int16, Int64

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


_QUERIES = 4000


def iou(answer: Bool, truth: Bool) -> float:
    """Intersection over union of two masks; 1 where both are empty."""
    union = int((answer | truth).sum())
    return float((answer & truth).sum() / union) if union else 1.0


def deepest(points: Float, region: Bool) -> int:
    """The point of ``region`` that is farthest from any point outside it.

    Large regions are searched at 4000 evenly chosen points.
    """
    inside = np.nonzero(region)[0]
    if not len(inside):
        raise ValueError("an empty region has no deepest point")
    outside = np.nonzero(~region)[0]
    if not len(outside):
        middle = points[inside].mean(0)
        return int(inside[np.linalg.norm(points[inside] - middle, axis=1).argmin()])
    step = max(len(inside) // _QUERIES, 1)
    asked = inside[::step]
    low, high = points[inside].min(0), points[inside].max(0)
    margin = 0.5 * float((high - low).max()) + 1e-9
    near = ((points[outside] > low - margin) & (points[outside] < high + margin)).all(1)
    if near.any():
        outside = outside[near]
    tree = KDTree(points[outside], balanced_tree=False, compact_nodes=False)
    distance, _ = tree.query(points[asked], workers=2)
    return int(asked[distance.argmax()])


def central(points: Float, region: Bool, rng: np.random.Generator, tries: int = 4) -> int:
    """The deepest of ``tries`` random points of ``region``, as of a hasty person."""
    inside, outside = np.nonzero(region)[0], np.nonzero(~region)[0]
    tried = rng.choice(inside, tries)
    if not len(outside):
        return int(tried[0])
    apart = points[tried][:, None] - points[outside[:: max(len(outside) // _QUERIES, 1)]][None]
    return int(tried[(apart**2).sum(2).min(1).argmax()])


def next_click(points: Float, truth: Bool, answer: Bool) -> tuple[int, bool] | None:
    """The next point to click and whether positively; None if the answer is perfect."""
    missing, extra = truth & ~answer, answer & ~truth
    if not missing.any() and not extra.any():
        return None
    positive = bool(missing.sum() >= extra.sum())
    return deepest(points, missing if positive else extra), positive


def next_part_click(points: Float, truth: Int, answer: Int) -> tuple[int, int] | None:
    """Point and true part of the largest error cluster; None if there is no error."""
    wrong = np.nonzero(truth != answer)[0]
    if not len(wrong):
        return None
    width = int(max(truth.max(), answer.max())) + 2
    pair = truth[wrong].astype(np.int64) * width + answer[wrong] + 1
    worst = np.bincount(pair).argmax()
    region = np.zeros(len(truth), bool)
    region[wrong[pair == worst]] = True
    return deepest(points, region), int(worst // width)
