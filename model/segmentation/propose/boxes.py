"""Boxes round what was clicked: a drawer is more than its front, and fills the box behind it.

Links of furniture and appliances stand square to one another, so boxes along the object's main
directions are hypotheses of their own: round a clicked region, round the mask with it, behind a
flat front as deep as the next surface that faces it; and planes along the sides of such boxes cut
off what a negative click means.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix
from scipy.spatial import KDTree

from model.segmentation.describe.depths import Depths
from model.segmentation.describe.fronts import FRONT_FEATURES, front_features, trimmed
from model.segmentation.describe.masks import (
    FEATURE_NAMES,
    SOURCES,
    Candidates,
    Clicked,
    MaskDescriber,
    MendingClick,
    joined,
)
from model.segmentation.encode.hierarchy import Hierarchy
from model.segmentation.encode.random_walk import RandomWalk
from model.segmentation.encode.superpoints import Superpoints
from model.segmentation.parallel import together
from model.segmentation.propose.box_ranking import Believed, BoxBeliefs, shipped_box_model
from model.segmentation.propose.fronts import Front, Fronts
from model.segmentation.propose.plane_boxes import STEPS as _STEPS
from model.segmentation.propose.plane_boxes import PlaneBoxes, plane_boxes
from model.segmentation.score.trees import Scorer, Trees
from model.segmentation.solver import (
    ALONE_BEHIND,
    CLOSE_SPECK,
    DETAIL_PENALTY,
    LARGE_PENALTY,
    PartSolver,
    PartState,
)

BOX_FEATURES = (
    "from_box", "box_filled", "box_volume", "box_short", "box_middle", "box_long", "box_bottom",
    "box_top", "box_reaches", "box_growth", "click_outside_box", "squareness",
    "round_positives", "round_positives_worst", "round_negatives", "round_negatives_worst",
    "first_deepest", "near_negatives", "between_positives",
)  # fmt: skip
HISTORY_FEATURES = (
    "change_deepest", "change_other", "past_deepest", "past_deepest_worst",
    "past_other", "past_other_worst", "last_changed", "change_of_last",
    "past_depth", "past_depth_worst",
)  # fmt: skip
"""How well a mask explains this click and those before it, each a mending of what was seen then."""
OBJECT_FEATURE_NAMES = (*FEATURE_NAMES, *BOX_FEATURES, *HISTORY_FEATURES)
MOVING_FEATURE_NAMES = (*OBJECT_FEATURE_NAMES, *FRONT_FEATURES)
"""Of first clicks on parts that move."""
_FROM_BOX = len(SOURCES)
_LOG_SIZE, _FIRST_DEPTH = (
    [n for n in FEATURE_NAMES if n not in MaskDescriber.among].index(n)
    for n in ("log_size", "first_depth_relative")
)

Bool = npt.NDArray[np.bool_]
Float = npt.NDArray[np.floating]
Int = npt.NDArray[np.int16]

_AXES_TRIED = 400
_ALONG = np.cos(np.radians(6))
_SQUARE = 0.12
_LEAST_SUPPORT = 0.03
"""Share of the surface that has to face along a direction for it to be a main one."""
_FLAT = 0.3
"""Of its second longest side: what is thinner is a front that a box may lie behind."""
_COVER = 0.2
"""Share of a front's own surface that has to face it for a box to end there."""
_REGIONS = 10
"""Of the nested regions round a click, how many boxes are put round."""
_FRONTS, _PLANES, _BETWEEN, _OF_SIZES = 4, 16, 12, 10
"""Fronts that boxes are put behind, planes that cut, and boxes between planes (of a mesh), at
most."""
_OF_TREES = 3.0
"""The scores of trees for first clicks times this differ as much as a network's."""
_SAY = 0.8
"""Of the scorer of parts that move; that of anything, which learned from other objects, has the
rest."""
_MENDING_SAY = 0.5
"""The same of later clicks."""
_BAR_PENALTY = 12.0
"""For a first answer to a click on a handle, at least four times as long as wide, without what is
behind, at most; for shorter ones less, none where they are less than twice as long."""
_RECTANGLES = 12
"""Of a front, beside later clicks."""
_WHOLE = 0.8
"""Share of a shell that is all but whole."""
_LIKE = 0.5
"""Overlap of the volumes of boxes that are alike."""
_ROUND = 16
"""Superpoints next to a click that it speaks of."""
_SHALLOW = 1e-3
"""Depth that is none, in diagonals."""
_EARLIER = 4
"""Clicks before the last one that are explained, the latest ones."""
_NEAREST, _ENDS = 4, 2
"""Steps between a front and what a box may end at, and how many ends are tried to each side."""


def main_directions(normal: Float, weight: Float) -> npt.NDArray[np.float64]:
    """(3, 3) orthonormal rows along which most of the surface faces, the last nearest to z.

    Args:
        normal: (C, 3) unit normals, or zeros.
        weight: (C,) share of the surface.
    """
    step = max(len(normal) // _AXES_TRIED, 1)
    tried = np.concatenate([np.eye(3), normal[::step]])
    tried = tried[np.linalg.norm(tried, axis=1) > 0.5]
    total = max(float(weight.sum()), 1e-12)
    found: list[npt.NDArray[np.float64]] = []
    for _ in range(2):
        for axis in found:
            tried = tried[np.abs(tried @ axis) < _SQUARE]
            tried = tried - np.outer(tried @ axis, axis)
        tried = tried / np.linalg.norm(tried, axis=1, keepdims=True)
        if not len(tried):
            break
        support = (np.abs(tried @ normal.T) > _ALONG) @ weight / total
        best = tried[int(support.argmax())]
        if support.max() < _LEAST_SUPPORT:
            break
        near = np.abs(normal @ best) > _ALONG
        mean = (normal[near] * np.sign(normal[near] @ best)[:, None] * weight[near, None]).sum(0)
        for axis in found:
            mean -= mean @ axis * axis
        found.append(mean / np.linalg.norm(mean))
    if len(found) < 2:
        return np.eye(3)
    axes = np.stack([*found, np.cross(found[0], found[1])])
    upright = int(np.abs(axes[:, 2]).argmax())
    return np.roll(axes, 2 - upright, axis=0)


class Boxes:
    """The superpoints on a grid of 256 steps along the object's main directions.

    Attributes:
        place: (3, C) uint8 step of each superpoint along each direction.
        facing: (3, C) whether the superpoint faces along it.
        size: (C,) float32 nodes in each superpoint; square: the same where it faces along any of them.
        step: (3,) metres.
        axes: (3, 3) the directions, in rows.
    """

    def __init__(self, superpoints: Superpoints, axes: Float | None = None) -> None:
        unit = superpoints.normal / np.maximum(
            np.linalg.norm(superpoints.normal, axis=1, keepdims=True), 1e-9
        )
        axes = main_directions(unit, superpoints.size) if axes is None else axes
        self.axes = axes
        at = superpoints.center @ axes.T
        low, side = at.min(0), np.maximum(np.ptp(at, axis=0), 1e-9)
        self.step = side / _STEPS
        place = np.minimum((at - low) / self.step, _STEPS - 1)
        self.place = np.ascontiguousarray(place.T.astype(np.uint8))
        self.facing = np.ascontiguousarray(np.abs(unit @ axes.T).T > 0.9)
        self.size = superpoints.size.astype(np.float32)
        self.square = self.facing.any(0) * self.size
        number = len(superpoints)
        rows = (self.place.astype(np.int64) + _STEPS * np.arange(3)[:, None]).ravel()
        self._bins = csr_matrix(
            (np.tile(self.size, 3), (rows, np.tile(np.arange(number), 3))),
            shape=(3 * _STEPS, number),
        )

    def between_planes(self, superpoints: Superpoints) -> PlaneBoxes:
        """The boxes between the object's planes."""
        links = superpoints.links
        apart = np.linalg.norm(superpoints.center[links.a] - superpoints.center[links.b], axis=1)
        # Superpoints are patches of some nodes: their distance tells how dense those lie.
        spacing = float(np.median(apart)) if len(apart) else 1.0
        spacing /= max(float(np.sqrt(np.median(superpoints.size))), 1.0)
        return plane_boxes(superpoints, self.place, self.facing, self.step, max(spacing, 1e-9))

    def bounds(self, masks: Bool) -> tuple[Int, Int]:
        """(H, 3) first and last step of each mask, but for a hundredth of it at each end."""
        held = (self._bins @ masks.T.astype(np.float32)).T.reshape(len(masks), 3, _STEPS)
        low, high = trimmed(held)
        return low.astype(np.int16), high.astype(np.int16)

    def contents(self, low: Int, high: Int, margin: int = 1) -> Bool:
        """(H, C) what lies in boxes (H, 3)."""
        first = np.clip(low - margin, 0, _STEPS - 1).astype(np.uint8)
        last = np.clip(high + margin, 0, _STEPS - 1).astype(np.uint8)
        out = np.ones((len(low), self.place.shape[1]), bool)
        for axis in range(3):
            out &= self.place[axis] >= first[:, axis, None]
            out &= self.place[axis] <= last[:, axis, None]
        return out

    def behind(self, low: Int, high: Int, most: int) -> tuple[Int, Int]:
        """Boxes that reach from flat ones (the ``most`` largest) to what faces them, both ways."""
        lows: list[Int] = []
        highs: list[Int] = []
        side = (high - low + 1) * self.step
        order = np.sort(side, axis=1)
        flat = np.nonzero(order[:, 0] <= _FLAT * order[:, 1])[0]
        flat = flat[np.argsort(-order[flat, 1] * order[flat, 2], kind="stable")][:most]
        for one, other, long in zip(low[flat], high[flat], side[flat], strict=True):
            axis = int(long.argmin())
            deep_low, deep_high = one.copy(), other.copy()
            deep_low[axis], deep_high[axis] = 0, _STEPS - 1
            inside = self.contents(deep_low[None], deep_high[None])[0] & self.facing[axis]
            at = self.place[axis][inside]
            held = np.bincount(at, self.size[inside], _STEPS)
            held = held + np.r_[held[1:], 0] + np.r_[0, held[:-1]]
            own = held[one[axis] : other[axis] + 1].max()
            peak = (held >= np.r_[0, held[:-1]]) & (held > np.r_[held[1:], 0])
            ends = np.nonzero(peak & (held > _COVER * own))[0]
            after = ends[ends >= other[axis] + _NEAREST][:_ENDS]
            before = ends[ends <= one[axis] - _NEAREST][::-1][:_ENDS]
            for end in after:
                lows.append(one)
                more = other.copy()
                more[axis] = end
                highs.append(more)
            for end in before:
                more = one.copy()
                more[axis] = end
                lows.append(more)
                highs.append(other)
        if not lows:
            return np.zeros((0, 3), np.int16), np.zeros((0, 3), np.int16)
        return np.stack(lows), np.stack(highs)


class _Shells:
    """The shells of a mesh: what is made of several is cut between them."""

    def __init__(self, shell: npt.NDArray[np.integer], size: npt.NDArray[np.float64]) -> None:
        _, self._of = np.unique(shell, return_inverse=True)
        number = int(self._of.max()) + 1
        at = np.arange(len(self._of))
        self._held = csr_matrix((size.astype(np.float32), (self._of, at)), (number, len(at)))
        self._size = np.bincount(self._of, size, number).astype(np.float32)

    def within(self, masks: Bool) -> Bool:
        """(H, C) the shells that masks hold all but whole: not the carcass beside a drawer."""
        held = self._held @ masks.T.astype(np.float32)
        return (held > _WHOLE * self._size[:, None]).T[:, self._of]


class ObjectDescriber(MaskDescriber):
    """Adds how well a mask fills its box, where and how large that is, and what explains clicks.

    Attributes:
        explains: whether ``HISTORY_FEATURES`` are looked at; they are 0 else.
    """

    explains = True
    names = OBJECT_FEATURE_NAMES
    among = (*MaskDescriber.among, "from_box")

    def __init__(self, superpoints: Superpoints, hierarchy: Hierarchy, boxes: Boxes) -> None:
        super().__init__(superpoints, hierarchy)
        self._boxes = boxes
        self._tree = KDTree(superpoints.center)
        self._near = min(_ROUND, len(superpoints))
        self._depths = Depths(self._x)

    def __call__(self, candidates: Candidates, clicked: Clicked) -> Float:
        """(H, F) features, in the order of ``OBJECT_FEATURE_NAMES``."""
        out = super().__call__(candidates, clicked)
        out[:, self._column["from_box"]] = candidates.source == _FROM_BOX
        return out

    def _own(self, masks: Bool, words: npt.NDArray[np.uint64], clicked: Clicked) -> Float:
        boxes = self._boxes
        base = super()._own(masks, words, clicked)
        m = masks.astype(np.float32)
        size = m @ boxes.size
        low, high = boxes.bounds(masks)
        held = (boxes.contents(low, high) | masks).astype(np.float32) @ boxes.size
        steps = (high - low + 1).astype(np.float32)
        sides = np.sort(steps * boxes.step.astype(np.float32), axis=1)
        sides /= np.float32(np.linalg.norm(_STEPS * boxes.step))
        volume = np.log(steps / _STEPS).sum(1)
        growth, outside = np.zeros(len(masks), np.float32), 0.0
        if clicked.before is not None and clicked.before.any():
            first, last = boxes.bounds(clicked.before[None])
            growth = volume - np.log((last - first + 1) / _STEPS).sum()
            spot = boxes.place[:, clicked.last].astype(np.int64)
            beyond = np.maximum(first[0] - spot, spot - last[0])
            outside = float((beyond * boxes.step).max() / np.linalg.norm(_STEPS * boxes.step))
        columns = [
            size / np.maximum(held, 1e-9),
            volume,
            *np.log(sides).T,
            low[:, 2] / _STEPS,
            high[:, 2] / _STEPS,
            ((low <= 2) | (high >= _STEPS - 3)).sum(1),
            np.clip(growth, -5, 5),
            np.full(len(masks), outside),
            m @ boxes.square / np.maximum(size, 1e-9),
            *self._round(masks, clicked.positive),
            *self._round(~masks, clicked.negative),
            self._first_deepest(words, base),
            *self._sides(m, size, clicked),
            *self._history(words, m, size, clicked),
        ]
        extra = np.stack([np.asarray(c, np.float32) for c in columns], axis=1)
        return np.concatenate([base, extra], axis=1)

    def _first_deepest(self, words: npt.NDArray[np.uint64], base: Float) -> Float:
        """(H,) log of how deep the first click lies against the deepest spot, -4..1.

        Args:
            base: (H, K) what :class:`MaskDescriber` finds; its depths are relative to the root of
                the masks' sizes.
        """
        log_size, relative = base[:, _LOG_SIZE], base[:, _FIRST_DEPTH]
        own = relative * np.exp(log_size / 2)
        most = self._depths(words, len(base))
        ratio = np.log(np.maximum(own, _SHALLOW) / np.maximum(most, _SHALLOW))
        return np.clip(ratio, -4, 1)

    def _history(
        self, words: npt.NDArray[np.uint64], m: Float, held: Float, clicked: Clicked
    ) -> list[Float]:
        """(H,) columns of ``HISTORY_FEATURES``.

        People click into the middle of what is most wrong. So if a mask is what they mean, every
        click so far was deep in what was missing or too much then, and that was the larger error.
        """
        number, size = len(m), self._boxes.size
        if clicked.before is None or not self.explains:
            return [np.zeros(number, np.float32)] * len(HISTORY_FEATURES)
        this = MendingClick(clicked.last, clicked.last_positive, clicked.before)
        now = self._explained(words, m, held, this)
        earlier = clicked.steps[-_EARLIER:]
        past = [self._explained(words, m, held, step) for step in earlier] or [now]
        deepest, other, depth = (np.stack([p[k] for p in past]) for k in range(3))
        last = clicked.steps[-1].before if clicked.steps else clicked.before
        changed = float(size @ (last ^ clicked.before)) + 1
        own = float(size @ clicked.before) + 1
        return [
            now[0], now[1], deepest.mean(0), deepest.min(0), other.mean(0), other.min(0),
            np.full(number, np.log(changed / own)), np.clip(np.log((now[3] + 1) / changed), -6, 6),
            depth.mean(0), depth.min(0),
        ]  # fmt: skip

    def _explained(
        self, words: npt.NDArray[np.uint64], m: Float, held: Float, step: MendingClick
    ) -> tuple[Float, Float, Float, Float]:
        """How well each of H masks explains a click, were it what is meant.

        Args:
            held: (H,) nodes in each mask.

        Returns:
            (H,) log of how deep the click lies in what it was to mend against the deepest spot of
            that, -4..1; log of how much more that is than the other kind of error, -4..4; the depth
            in roots of its share of the surface; nodes of both errors.
        """
        size, before = self._boxes.size, step.before
        none = np.uint64(0)
        wrong = (
            np.where(before[:, None], none, words)
            if step.positive
            else np.where(before[:, None], ~words, none)
        )
        own, most = self._depth(wrong, len(m), step.superpoint), self._depths(wrong, len(m))
        common = m @ (size * before)
        missing, extra = held - common, float(size @ before) - common
        mended, other = (missing, extra) if step.positive else (extra, missing)
        share = np.maximum(mended / size.sum(), 1e-9)
        ratio = np.log(np.maximum(own, _SHALLOW) / np.maximum(most, _SHALLOW))
        return (
            np.clip(ratio, -4, 1),
            np.clip(np.log((mended + 1) / (other + 1)), -4, 4),
            own / np.sqrt(share),
            mended + other,
        )

    def _sides(self, m: Float, size: Float, clicked: Clicked) -> tuple[Float, Float]:
        """(H,) share of each mask that lies nearer to a negative click than to a positive one,
        and share of what lies between the positive clicks that it holds.

        A negative click deep in a mask seldom means only what is next to it, and clicks all over
        a part mean what is between them, too.
        """
        none, all_ = np.zeros(len(m), np.float32), np.ones(len(m), np.float32)
        if not clicked.positive or len(clicked.positive) + len(clicked.negative) < 2:
            return none, all_
        cell_size = self._boxes.size

        def apart(superpoints: tuple[int, ...]) -> Float:
            return np.min([self._around(c)[0] for c in superpoints], axis=0)

        wrong = np.zeros(len(cell_size), bool)
        if clicked.negative:
            wrong = apart(clicked.negative) < apart(clicked.positive)
        place = self._boxes.place[:, list(clicked.positive)].astype(np.int16)
        between = ~wrong & self._boxes.contents(place.min(1)[None], place.max(1)[None])[0]
        beyond = m @ (cell_size * wrong) / np.maximum(size, 1e-9)
        if len(clicked.positive) < 2:
            return beyond, all_
        held = cell_size * between
        return beyond, m @ held / np.maximum(held.sum(), 1e-9)

    def _round(self, masks: Bool, clicks: tuple[int, ...]) -> Float:
        """(2, H) share of the superpoints next to the clicks that each mask holds, mean and least.

        People click into the middle of what they mean, so what lies round an earlier click
        belongs with it.
        """
        if not clicks:
            return np.ones((2, len(masks)), np.float32)
        _, near = self._tree.query(self._superpoints.center[list(clicks)], k=self._near)
        near = np.reshape(near, (len(clicks), self._near))
        share = masks[:, near].mean(2, dtype=np.float32)
        return np.stack([share.mean(1), share.min(1)])


class ObjectSolver(PartSolver):
    """Finds the part of an object that clicks mean."""

    def __init__(
        self,
        superpoints: Superpoints,
        hierarchy: Hierarchy,
        walk: RandomWalk,
        first_scorer: Scorer | None,
        later_scorer: Scorer | None,
        shell: npt.NDArray[np.integer] | None = None,
        axes: Float | None = None,
        of_mesh: bool = False,
    ) -> None:
        """``shell`` (C,): of a mesh, the shell of each superpoint; ``axes`` (3, 3): the main directions,
        where they are known; ``of_mesh``: whether the superpoints are of faces, with ``shell`` or not.
        """
        self.fronts: Fronts | None = None
        self.moving_scorers: tuple[Scorer | None, Scorer | None] = (None, None)
        self._boxes = Boxes(superpoints, axes)
        self._mesh = shell is not None
        self._large_beside = LARGE_PENALTY
        if len(superpoints) < superpoints.size.sum():
            self._detail_penalty = DETAIL_PENALTY
        else:  # a close-up, of single nodes, is there for details
            self._first_speck = CLOSE_SPECK
        if self._mesh or of_mesh:
            # Whole shells come and go, however near to their border a click is.
            self._far_penalty = 0.0
            self._large_penalty = LARGE_PENALTY
        self._shells = None
        if shell is not None and len(np.unique(shell)) > 1:
            self._shells = _Shells(shell, superpoints.size)
        grid = self._boxes
        planes, describe = together(
            lambda: grid.between_planes(superpoints),
            lambda: ObjectDescriber(superpoints, hierarchy, grid),
        )
        # A scorer that doesn't ask for it would only wait.
        describe.explains = later_scorer is None or not set(HISTORY_FEATURES).isdisjoint(
            later_scorer.names
        )
        # Faces tell the parts of a mesh better: there the network made later clicks worse.
        model = None if self._mesh else shipped_box_model()
        self._most = _OF_SIZES if self._mesh else _BETWEEN
        self._beliefs = BoxBeliefs(planes, grid.place, grid.facing, grid.step, model)
        super().__init__(superpoints, hierarchy, walk, first_scorer, later_scorer, describe)

    @property
    def axes(self) -> Float:
        """(3, 3) the main directions, in rows."""
        return self._boxes.axes

    def first_regions(self, superpoint: int) -> Candidates:
        """The nested regions, the boxes round them, and those behind flat ones."""
        chain = super().first_regions(superpoint)
        regions, boxes = self._some(chain.masks), self._boxes
        low, high = boxes.bounds(regions)
        deep = boxes.contents(*boxes.behind(low, high, _FRONTS))
        round_all = boxes.contents(low, high) | regions
        return self._with(chain, [round_all, deep, self._between((superpoint,), (), self._most)])

    def part_regions(self, superpoint: int, outside: tuple[int, ...]) -> Candidates:
        """The same, and rectangles of the front that was clicked, with what is behind them."""
        found = self.first_regions(superpoint)
        if self.fronts is None:
            return found
        made = [self.fronts.masks(f, self.fronts.rectangles(f, superpoint, outside))
                for f in self.fronts.of(superpoint)]  # fmt: skip
        if not made:
            return found
        likely = np.concatenate([m[:_FRONTS] for m in made])
        boxes = self._boxes
        deep = boxes.contents(*boxes.behind(*boxes.bounds(likely[likely.any(1)]), _FRONTS))
        return self._with(found, [*made, deep])

    def _as_part(
        self, found: Candidates, features: Float, scores: Float, clicked: Clicked
    ) -> tuple[Float, Float]:
        first, _ = self.moving_scorers
        alike = scores * _OF_TREES if isinstance(self._first, Trees) else scores
        both, scores = self._with_fronts(found, features, alike, clicked, first, _SAY)
        return both, scores - self._bar_alone(found.masks, scores, clicked.last)

    def _bar_alone(self, masks: Bool, scores: Float, superpoint: int) -> Float | float:
        """(H,) what speaks against masks that leave behind what a clicked handle is on: whoever
        clicks a bar means the door or drawer that it moves.

        No more than it takes, so that Tab shows the handle alone.
        """
        bar = None if self.fronts is None else self.fronts.bar(superpoint)
        if bar is None:
            return 0.0
        size = (bar.behind * self.superpoints.size).astype(np.float32)
        alone = masks.astype(np.float32) @ size < 0.5 * size.sum()
        if alone.all():
            return 0.0
        ahead = float(scores.max(where=alone, initial=-np.inf) - scores[~alone].max())
        most = _BAR_PENALTY * np.clip(np.log2(bar.length) - 1, 0, 1)
        return np.clip(ahead + ALONE_BEHIND, 0, most) * alone

    def _as_mended(
        self, found: Candidates, features: Float, scores: Float, clicked: Clicked
    ) -> tuple[Float, Float]:
        _, later = self.moving_scorers
        return self._with_fronts(found, features, scores, clicked, later, _MENDING_SAY)

    def _with_fronts(
        self, found: Candidates, features: Float, scores: Float, clicked: Clicked,
        scorer: Scorer | None, say: float,
    ) -> tuple[Float, Float]:  # fmt: skip
        """Features with what masks show on the front that was clicked, and scores in which
        ``scorer``, of parts that move, has its ``say``.
        """
        if self.fronts is None:
            return features, scores
        shown = front_features(found.masks, self.superpoints, self.axes, self._front(clicked))
        both = np.concatenate([features, shown], axis=1)
        if scorer is not None:
            scores = say * scorer(both) + (1 - say) * scores
        return both, scores

    def _front(self, clicked: Clicked) -> Front | None:
        """The front that a part was first clicked on."""
        assert self.fronts is not None
        first = clicked.positive[0] if clicked.positive else clicked.last
        fronts = self.fronts.of(first)
        return fronts[-1] if fronts else None

    def part_hypotheses(
        self, state: PartState, after: PartState, superpoint: int, positive: bool
    ) -> list[Candidates]:
        """Rectangles of the front that hold the part's clicks, with the mask or without, and, where
        something is too much, the mask without those round it.
        """
        if self.fronts is None or not after.positive:
            return []
        assert state.mask is not None
        made: list[Bool] = []
        own = superpoint if positive else after.positive[-1]
        for front in self.fronts.of(own):
            round_own = self.fronts.rectangles(front, own, after.negative)[:_RECTANGLES]
            masks = self.fronts.masks(front, round_own)
            made.append(masks[masks[:, list(after.positive)].all(1)])
            if positive:
                made.append(masks | state.mask)
        if not positive:
            for front in self.fronts.of(superpoint):
                off = self.fronts.rectangles(front, superpoint, after.positive)[:_RECTANGLES]
                made.append(state.mask & ~self.fronts.masks(front, off))
        return [self._made(made)] if made else []

    def _region_hypotheses(
        self, state: PartState, after: PartState, superpoint: int, positive: bool
    ) -> Candidates:
        found = super()._region_hypotheses(state, after, superpoint, positive)
        assert state.mask is not None
        mask, boxes = state.mask, self._boxes
        regions = self._some(self.chain(superpoint).masks)
        low, high = boxes.bounds(regions)
        if positive:
            wider = regions | mask
            round_all = boxes.contents(*boxes.bounds(wider)) | wider
            deep = boxes.contents(*boxes.behind(low, high, _FRONTS)) | mask
            own = (boxes.contents(low, high) | mask)[::2]
            beside = self._tight(superpoint, after.negative, self._most // 2) | mask
            made = [round_all, deep, own, beside]
        else:
            without = mask & ~boxes.contents(low, high)
            outside = mask & ~self._tight(superpoint, after.positive, self._most)
            made = [without, outside, self._cut(mask, low, high, after, superpoint)]
        if after.positive:
            made.append(self._between(after.positive, after.negative, self._most))
            made.append(self._alike(mask, after.positive, after.negative))
        return self._with(found, made)

    def _between(self, inside: tuple[int, ...], outside: tuple[int, ...], most: int) -> Bool:
        """(H, C) the likeliest boxes between planes that hold some superpoints and not others."""
        believed = self._beliefs(inside, outside)
        return self._within(believed, self._few(believed, most))

    def _tight(self, superpoint: int, outside: tuple[int, ...], most: int) -> Bool:
        """(H, C) boxes between planes that hold a superpoint and not others, the least leaking ones."""
        believed = self._beliefs.tight(superpoint, outside)
        return self._within(believed, self._few(believed, most))

    def _few(self, believed: Believed, most: int) -> npt.NDArray[np.int64]:
        return believed.of_all_sizes(most) if self._mesh else believed.apart(most)

    def _alike(self, mask: Bool, inside: tuple[int, ...], outside: tuple[int, ...]) -> Bool:
        """(H, C) boxes between planes that hold some superpoints and not others, like the mask's."""
        low, high = self._boxes.bounds(mask[None])
        believed = self._beliefs(inside, outside)
        return self._within(believed, believed.like(low, high, _LIKE)[: self._most])

    def _within(self, believed: Believed, index: npt.NDArray[np.int64]) -> Bool:
        return self._boxes.contents(believed.low[:, index].T, believed.high[:, index].T, 0)

    def _with(self, found: Candidates, more: list[Bool]) -> Candidates:
        return joined([found, self._made(more)])

    def _made(self, more: list[Bool]) -> Candidates:
        """Boxes and rectangles as hypotheses, on a mesh with the shells within them."""
        masks = np.concatenate(more)
        if self._shells is not None:
            masks = np.concatenate([masks, self._shells.within(masks)])
        masks = masks[masks.any(1)]
        zero = np.zeros(len(masks), np.float32)
        return Candidates(masks, np.full(len(masks), _FROM_BOX, np.int8), zero, zero.copy())

    def _some(self, masks: Bool) -> Bool:
        """At most ``_REGIONS`` of the masks, of all sizes."""
        size = masks.astype(np.float32) @ self._boxes.size
        return masks[_evenly(np.argsort(size, kind="stable"), _REGIONS)]

    def _cut(self, mask: Bool, low: Int, high: Int, after: PartState, superpoint: int) -> Bool:
        """(H, C) the mask without what lies beyond a plane along a side of a box, or halfway
        between the click and the part's own ones; all planes keep the latter.
        """
        place = self._boxes.place
        spot = place[:, superpoint].astype(int)
        kept = place[:, list(after.positive)].astype(int)
        stays: list[Bool] = []
        for axis in range(3):
            inner, outer = int(kept[axis].min(initial=255)), int(kept[axis].max(initial=0))
            upper = {int(v) - 1 for v in low[:, axis]} | {(outer + int(spot[axis])) // 2}
            lower = {int(v) + 1 for v in high[:, axis]} | {(inner + int(spot[axis]) + 1) // 2}
            stays += [place[axis] <= v for v in sorted(upper) if outer <= v < spot[axis]]
            stays += [place[axis] >= v for v in sorted(lower) if spot[axis] < v <= inner]
        if not stays:
            return np.zeros((0, len(mask)), bool)
        made = np.stack(stays) & mask
        size = made.astype(np.float32) @ self._boxes.size
        return made[_evenly(np.argsort(-size, kind="stable"), _PLANES)]


def _evenly(order: npt.NDArray[np.int64], most: int) -> npt.NDArray[np.int64]:
    """At most ``most`` of what is ordered, evenly."""
    if len(order) <= most:
        return order
    return order[np.linspace(0, len(order) - 1, most).astype(int)]
