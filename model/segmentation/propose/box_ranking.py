"""How likely each box between planes is the part that a click means.

A drawer's tray lies against the carcass and a door against its frame, so what leaks through the
sides of a box says little of whether it is a part. A small network looks at every side, where the
click lies between them, and what the box holds; some thousand boxes take milliseconds.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from model.core.resources import static_assets
from model.segmentation.propose.plane_boxes import SIDE_FEATURES, STEPS, PlaneBoxes
from model.segmentation.score.mlp import Mlp, load_mlp

WEIGHTS = "segmentation/boxes.npz"
_AXES, _ENDS = ("short", "long", "upright"), ("near", "far")
_ALONG = ("length", "near", "far", "centred", "click_faces")
BOX_SCORE_FEATURES = (
    *(f"{axis}_{name}" for axis in _AXES for name in _ALONG),
    *(f"{axis}_{end}_{name}" for axis in _AXES for end in _ENDS for name in SIDE_FEATURES),
    *(f"{axis}_{end}_outermost" for axis in _AXES for end in _ENDS),
    "share", "surface_filled", "inner_strength", "leak", "volume",
)  # fmt: skip

_KEPT = 16
"""Clicked superpoints whose boxes are kept."""
_LOOKED_AT, _ALIKE = 400, 0.65
"""Likeliest boxes among which others are looked for, and the overlap of those that are alike."""
_SIZES = 0.3
"""Boxes of nearly the same size (logarithm) compete where one of each size is wanted."""

Float = npt.NDArray[np.floating]
Int = npt.NDArray[np.int16]


@lru_cache(maxsize=1)
def shipped_box_model() -> Mlp | None:
    """The network that ships, or None where it is not there."""
    path = static_assets() / WEIGHTS
    return load_mlp(path, BOX_SCORE_FEATURES) if path.is_file() else None


class BoxDescriber:
    """Describes boxes for a click.

    Level directions are told apart by the box's length along them, their sides by which is nearer
    to the click: what is learned holds for objects that are turned or mirrored. Up and down are
    not the same.
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
        log_length = np.log(np.maximum(length, 1e-3))
        self._length = log_length[rows, self._order]
        outermost = np.stack([low <= 0, high >= STEPS - 1], axis=2).astype(np.float32)
        self._sides = boxes.sides[rows, self._order]
        self._outermost = outermost[rows, self._order]
        share = np.maximum(boxes.share, 1e-9)
        filled = share * boxes.surface.max(initial=1) / np.maximum(boxes.surface, 1e-9)
        self._held = np.stack(
            [np.log(share), np.log(filled), boxes.inner, np.log(boxes.leak + 1e-6),
             log_length.sum(1)],
            axis=1,
        ).astype(np.float32)  # fmt: skip

    def __call__(
        self,
        found: npt.NDArray[np.int64],
        spot: npt.NDArray[np.integer],
        faces: npt.NDArray[np.bool_],
    ) -> Float:
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
class Believed:
    """Boxes that hold all clicks of a part and none against it, the likeliest first.

    Attributes:
        low, high: (3, K) steps. score: (K,) log-odds. share: (K,) of the surface that they hold.
    """

    low: Int
    high: Int
    score: Float
    share: Float

    def apart(self, most: int) -> npt.NDArray[np.int64]:
        """The likeliest that are not much like a likelier one."""
        low, high = self.low[:, :_LOOKED_AT].T, self.high[:, :_LOOKED_AT].T
        free = np.ones(len(low), bool)
        out: list[int] = []
        while len(out) < most and free.any():
            best = int(free.argmax())
            out.append(best)
            free &= volume_overlap(low[best][None], high[best][None], low, high)[0] < _ALIKE
            free[best] = False
        return np.array(out, np.int64)

    def of_all_sizes(self, most: int) -> npt.NDArray[np.int64]:
        """The likeliest of each size, the likeliest first."""
        _, first = np.unique(np.floor(np.log(self.share) / _SIZES), return_index=True)
        return np.sort(first)[:most]

    def like(self, low: Int, high: Int, least: float) -> npt.NDArray[np.int64]:
        """Those whose volume overlaps with a box (1, 3) by ``least``, the likeliest first."""
        overlap = volume_overlap(low, high, self.low.T, self.high.T)[0]
        return np.nonzero(overlap >= least)[0]


class BoxBeliefs:
    """Ranks the boxes between planes for the first click of a part, and keeps the scores."""

    def __init__(
        self,
        boxes: PlaneBoxes,
        place: npt.NDArray[np.uint8],
        facing: npt.NDArray[np.bool_],
        step: Float,
        model: Mlp | None,
    ) -> None:
        """``place``, ``facing`` (3, C) and ``step`` (3,): see ``Boxes``."""
        self._boxes, self._place, self._facing = boxes, place, facing
        # Without a network nothing needs to be described.
        self._describe = None if model is None else BoxDescriber(boxes, step)
        self._model = model
        self._of: OrderedDict[int, tuple[npt.NDArray[np.int64], Float]] = OrderedDict()

    def _scored(self, superpoint: int) -> tuple[npt.NDArray[np.int64], Float]:
        """Boxes that hold a superpoint, the likeliest first, and their scores."""
        if superpoint not in self._of:
            found = self._boxes.holding(self._place[:, superpoint])
            if self._model is None or self._describe is None:
                score = -np.log(self._boxes.leak[found] + 1e-6)
            else:
                faces = self._facing[:, superpoint]
                score = self._model(self._describe(found, self._place[:, superpoint], faces))
            order = np.argsort(-score, kind="stable")
            self._of[superpoint] = found[order], score[order]
            if len(self._of) > _KEPT:
                self._of.popitem(last=False)
        return self._of[superpoint]

    def __call__(self, positive: tuple[int, ...], negative: tuple[int, ...]) -> Believed:
        """The boxes that clicks on these superpoints leave, as the first positive one sees them."""
        found, score = self._scored(positive[0])
        left = self._left(found, positive[1:], negative)
        return self._believed(found[left], score[left])

    def tight(self, superpoint: int, negative: tuple[int, ...]) -> Believed:
        """The boxes that hold a superpoint and no negative ones, the least leak first.

        For what a later click is about; to score these boxes as well would cost every click.
        """
        found = self._boxes.holding(self._place[:, superpoint])
        found = found[self._left(found, (), negative)]
        return self._believed(found, -self._boxes.leak[found])

    def _left(
        self, found: npt.NDArray[np.int64], positive: tuple[int, ...], negative: tuple[int, ...]
    ) -> npt.NDArray[np.int64]:
        low, high = self._boxes.low[:, found], self._boxes.high[:, found]
        ok = np.ones(len(found), bool)
        for superpoints, wanted in ((positive, True), (negative, False)):
            for superpoint in superpoints:
                spot = self._place[:, superpoint].astype(np.int16)[:, None]
                ok &= ((low <= spot) & (high >= spot)).all(0) == wanted
        return np.nonzero(ok)[0]

    def _believed(self, found: npt.NDArray[np.int64], score: Float) -> Believed:
        boxes = self._boxes
        return Believed(boxes.low[:, found], boxes.high[:, found], score, boxes.share[found])


def volume_overlap(low: Int, high: Int, other_low: Int, other_high: Int) -> Float:
    """(H, K) IoU of the volumes of boxes (H, 3) with others (K, 3), in steps."""
    common, one, two = np.ones((len(low), len(other_low)), np.float32), 1.0, 1.0
    for k in range(3):
        first = np.maximum(low[:, k, None], other_low[None, :, k])
        last = np.minimum(high[:, k, None], other_high[None, :, k])
        common *= np.maximum(last - first + 1, 0)
        one = one * (high[:, k] - low[:, k] + np.float32(1))
        two = two * (other_high[:, k] - other_low[:, k] + np.float32(1))
    return common / (np.asarray(one)[:, None] + two - common)
