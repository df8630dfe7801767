"""Rank the boxes between planes by how likely each is the part that a click means.

A drawer's tray touches the carcass and a door its frame, so the leak through a box's sides says
little about whether it is a part. A small network looks at every side, at where the click lies
between them, and at the content; some thousand boxes take milliseconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from operator import attrgetter

import numpy as np
from cachetools import LRUCache, cachedmethod

from model.core.files import static_assets
from model.segmentation.arrays import Bool, Float, Int, Int16, Int64, Uint8
from model.segmentation.models.mlp import Mlp, load_mlp
from model.segmentation.propose.plane_boxes import SIDE_FEATURES, STEPS, PlaneBoxes

WEIGHTS = "segmentation/boxes.npz"
_AXES, _ENDS = ("short", "long", "upright"), ("near", "far")
_ALONG = ("length", "near", "far", "centred", "click_faces")
BOX_SCORE_FEATURES = (
    *(f"{axis}_{name}" for axis in _AXES for name in _ALONG),
    *(f"{axis}_{end}_{name}" for axis in _AXES for end in _ENDS for name in SIDE_FEATURES),
    *(f"{axis}_{end}_outermost" for axis in _AXES for end in _ENDS),
    "share", "surface_filled", "inner_strength", "leak", "volume",
)  # fmt: skip

_CACHED = 16
"""Clicked superpoints whose scores are cached."""
_CONSIDERED, _ALIKE = 400, 0.65
"""Likeliest boxes that are thinned, and the volume overlap of those that are alike."""
_SIZE_BIN = 0.3
"""Logarithmic size of the bins from which one box each is taken."""


@lru_cache(maxsize=1)
def shipped_box_model() -> Mlp | None:
    """The project's trained network, or None if its file is absent."""
    path = static_assets() / WEIGHTS
    return load_mlp(path, BOX_SCORE_FEATURES) if path.is_file() else None


class BoxDescriber:
    """Describes boxes for a click.

    Horizontal directions are sorted by the box's length and their sides by the distance from the
    click, so what is learned holds for turned and mirrored objects. Up and down stay apart.
    """

    def __init__(self, boxes: PlaneBoxes, step: Float) -> None:
        """``step`` (3,) metres along each direction."""
        low, high = boxes.low.T.astype(np.float32), boxes.high.T.astype(np.float32)
        self._scale = (step / np.linalg.norm(STEPS * step)).astype(np.float32)
        length = (high - low + 1) * self._scale
        swap = length[:, 0] > length[:, 1]
        rows = np.arange(len(low))[:, None]
        self._order = np.where(swap[:, None], [1, 0, 2], [0, 1, 2]).astype(np.int8)
        self._low, self._high = low, high
        log_length = np.log(np.maximum(length, 1e-3), dtype=np.float64)
        self._length = log_length[rows, self._order]
        outermost = np.stack([low <= 0, high >= STEPS - 1], axis=2).astype(np.float32)
        self._sides = boxes.sides[rows, self._order]
        self._outermost = outermost[rows, self._order]
        share = np.maximum(boxes.share, 1e-9, dtype=np.float64)
        filled = share * boxes.surface.max(initial=1) / np.maximum(boxes.surface, 1e-9)
        self._held = np.stack(
            [np.log(share), np.log(filled), boxes.inner,
             np.log(boxes.leak + 1e-6, dtype=np.float64), log_length.sum(1)],
            axis=1,
        ).astype(np.float32)  # fmt: skip

    def __call__(self, found: Int64, spot: Int, faces: Bool) -> Float:
        """(K, F) features of the boxes ``found``, in the order of ``BOX_SCORE_FEATURES``.

        Args:
            spot: (3,) the click's steps.
            faces: (3,) whether the surface there faces along each direction.
        """
        order, rows = self._order[found], np.arange(len(found))[:, None]
        before = ((spot - self._low[found]) * self._scale)[rows, order]
        after = ((self._high[found] - spot) * self._scale)[rows, order]
        turned = before > after
        turned[:, 2] = False
        near, far = np.where(turned, after, before), np.where(turned, before, after)
        sides, outermost = self._sides[found], self._outermost[found]
        for axis in (0, 1):
            at = np.nonzero(turned[:, axis])[0]
            sides[at, axis] = sides[at, axis, ::-1]
            outermost[at, axis] = outermost[at, axis, ::-1]
        along = [self._length[found], near, far, near / np.maximum(near + far, 1e-6), faces[order]]
        blocks = (np.stack(along, axis=2), sides, outermost, self._held[found])
        flat = [b.reshape(len(found), int(np.prod(b.shape[1:]))) for b in blocks]
        return np.concatenate(flat, axis=1).astype(np.float32)


@dataclass(frozen=True, eq=False)
class RankedBoxes:
    """Boxes that hold all positive clicks and no negative one, the likeliest first.

    Attributes:
        low, high: (3, K) steps. score: (K,) log-odds. share: (K,) of the surface that they hold.
    """

    low: Int16
    high: Int16
    score: Float
    share: Float

    def apart(self, most: int) -> Int64:
        """The likeliest that aren't alike."""
        low, high = self.low[:, :_CONSIDERED].T, self.high[:, :_CONSIDERED].T
        free = np.ones(len(low), bool)
        out: list[int] = []
        while len(out) < most and free.any():
            best = int(free.argmax())
            out.append(best)
            free &= volume_overlap(low[best][None], high[best][None], low, high)[0] < _ALIKE
            free[best] = False
        return np.array(out, np.int64)

    def of_all_sizes(self, most: int) -> Int64:
        """The likeliest of each size, the likeliest first."""
        size = np.log(self.share, dtype=np.float64)
        _, first = np.unique(np.floor(size / _SIZE_BIN), return_index=True)
        return np.sort(first)[:most]

    def alike(self, low: Int16, high: Int16, least: float) -> Int64:
        """Those whose volume overlaps with a box (1, 3) by ``least``, the likeliest first."""
        overlap = volume_overlap(low, high, self.low.T, self.high.T)[0]
        return np.nonzero(overlap >= least)[0]


class BoxRanker:
    """Ranks the boxes between planes for the first click of a part."""

    def __init__(
        self, boxes: PlaneBoxes, place: Uint8, facing: Bool, step: Float, model: Mlp | None
    ) -> None:
        """``place``, ``facing`` (3, C) and ``step`` (3,): see :class:`.BoxGrid`."""
        self._boxes, self._place, self._facing = boxes, place, facing
        self._describe = None if model is None else BoxDescriber(boxes, step)
        self._model = model
        self._cache: LRUCache = LRUCache(_CACHED)

    @cachedmethod(attrgetter("_cache"))
    def _scored(self, superpoint: int) -> tuple[Int64, Float]:
        """Boxes that hold a superpoint, the likeliest first, and their scores."""
        found = self._boxes.holding(self._place[:, superpoint])
        if self._model is None or self._describe is None:
            score = -np.log(self._boxes.leak[found] + 1e-6, dtype=np.float64)
        else:
            faces = self._facing[:, superpoint]
            score = self._model(self._describe(found, self._place[:, superpoint], faces))
        order = np.argsort(-score, kind="stable")
        return found[order], score[order]

    def __call__(self, positive: tuple[int, ...], negative: tuple[int, ...]) -> RankedBoxes:
        """The boxes that agree with clicks, scored for the first positive one."""
        found, score = self._scored(positive[0])
        left = self._left(found, positive[1:], negative)
        return self._ranked(found[left], score[left])

    def tight(self, superpoint: int, negative: tuple[int, ...]) -> RankedBoxes:
        """The boxes that hold a superpoint and no negative ones, the least leak first.

        For later clicks: scoring their boxes with the network would slow each one down.
        """
        found = self._boxes.holding(self._place[:, superpoint])
        found = found[self._left(found, (), negative)]
        return self._ranked(found, -self._boxes.leak[found])

    def _left(self, found: Int64, positive: tuple[int, ...], negative: tuple[int, ...]) -> Int64:
        low, high = self._boxes.low[:, found], self._boxes.high[:, found]
        ok = np.ones(len(found), bool)
        for superpoints, wanted in ((positive, True), (negative, False)):
            for superpoint in superpoints:
                spot = self._place[:, superpoint].astype(np.int16)[:, None]
                ok &= ((low <= spot) & (high >= spot)).all(0) == wanted
        return np.nonzero(ok)[0]

    def _ranked(self, found: Int64, score: Float) -> RankedBoxes:
        boxes = self._boxes
        return RankedBoxes(boxes.low[:, found], boxes.high[:, found], score, boxes.share[found])


def volume_overlap(low: Int16, high: Int16, other_low: Int16, other_high: Int16) -> Float:
    """(H, K) IoU of the volumes of boxes (H, 3) with others (K, 3), in steps."""
    common, one, two = np.ones((len(low), len(other_low)), np.float32), 1.0, 1.0
    for k in range(3):
        first = np.maximum(low[:, k, None], other_low[None, :, k])
        last = np.minimum(high[:, k, None], other_high[None, :, k])
        common *= np.maximum(last - first + 1, 0)
        one = one * (high[:, k] - low[:, k] + np.float32(1))
        two = two * (other_high[:, k] - other_low[:, k] + np.float32(1))
    return common / (np.asarray(one)[:, None] + two - common)
