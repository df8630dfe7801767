"""Answer a click on one part: propose masks, describe them, score them, choose the best.

Which sources propose, what describes and what penalises depends on the input domain. To add a
proposal source, write a class with the members of :class:`.ProposalSource` and list it in
:func:`solver_of`. A person is offered a few other masks that cover what
the click may mean.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt
from scipy.special import softmax

from model.segmentation.arrays import Bool, Float, Int64, together
from model.segmentation.boxes import Boxes, RoomBoxes, Shells
from model.segmentation.encoding import Encoding, Hierarchy, RandomWalk
from model.segmentation.fronts import FrontRectangles, Fronts
from model.segmentation.graph import components
from model.segmentation.mask_features import (
    FEATURE_NAMES,
    ClickContext,
    MaskDescriber,
    RoomDescriber,
)
from model.segmentation.models import Scorer
from model.segmentation.object_features import HISTORY_FEATURES, ObjectDescriber
from model.segmentation.plane_boxes import BoxGrid
from model.segmentation.proposals import (
    PartState,
    Proposals,
    ProposalSource,
    Regions,
    Walks,
    concatenated,
    distinct_proposals,
)
from model.segmentation.scores import MovingPartScoring, Penalties, Scorers
from model.segmentation.superpoints import Superpoints

ALTERNATIVES = 5
_TEMPERATURE = 2.0
"""Temperature of the softmax over scores, which are overconfident; chosen of one to five by the
best mask offered."""
_ALIKE = 0.9
"""IoU above which two masks look the same."""


def overlaps(masks: Bool, size: Float) -> tuple[Float, Float]:
    """Intersection and IoU of every two masks.

    Args:
        masks: (H, C). size: (C,) weight of each superpoint.

    Returns:
        (H, H) each; the diagonal of the first holds the masks' sizes.
    """
    common = (masks * size.astype(np.float32)) @ masks.T.astype(np.float32)
    area = np.diagonal(common)
    return common, common / np.maximum(area[:, None] + area[None] - common, 1e-9)


def look_alike(one: Bool, other: Bool, size: Float) -> bool:
    """True if two masks (N,) overlap so far that a person can't distinguish them.

    Args:
        size: (N,) weight of each element.
    """
    return float(size @ (one & other)) >= _ALIKE * float(size @ (one | other))


def offered(
    masks: Bool, scores: Float, shown: Bool, size: Float, most: int = ALTERNATIVES
) -> list[int]:
    """Masks such that one of them, or the one shown, is expected to overlap most with the part.

    The highest scores often go to one mask with small changes, but people press Tab for another
    one. So each next mask is the one that adds most to the expected overlap of the best mask with
    the true one, where every proposal is the true one with the probability that its score gives
    (greedy for a submodular gain: Nemhauser, Wolsey and Fisher, 1978).

    Args:
        masks: (H, C) proposals. scores: (H,) their log-odds. shown: (C,) the mask on the screen.
        size: (C,) weight of each superpoint.
        most: largest number of masks.

    Returns:
        Rows of ``masks``, the most useful first.
    """
    _, overlap = overlaps(np.concatenate([shown[None], masks]), size)
    likely = softmax(scores / _TEMPERATURE)
    covered, overlap = overlap[0, 1:], overlap[1:, 1:]
    free = covered <= _ALIKE
    out: list[int] = []
    while len(out) < most and free.any():
        gain = likely @ np.maximum(overlap - covered[:, None], 0)
        best = int(np.where(free, gain, -1.0).argmax())
        out.append(best)
        covered = np.maximum(covered, overlap[:, best])
        free &= overlap[best] <= _ALIKE
    return out


_OVERLAP_BEFORE, _BORDER, _LIFE, _AGREEMENT = (
    FEATURE_NAMES.index(n) for n in ("overlap_before", "border", "life_relative", "agreement")
)
_USUAL_OVERLAP = 0.8
"""Overlap with the mask before above which nothing counts as lost."""
_TIE = 1e-5
"""Log-odds by which scores differ that aren't equal: rounding makes a tenth of that."""
_CORRECTED = 2
"""Best proposals of the first round that a random walk makes agree with the clicks."""
_PATCH_OF_ALL, _PATCH_OF_MASK = 0.001, 0.02
"""Largest share of all nodes and of the mask that a patch or hole without clicks has."""


@dataclass(frozen=True, eq=False)
class ScoredProposals:
    """H proposals with their features and scores.

    Attributes:
        features: (H, F). scores: (H,) log-odds less penalties.
    """

    proposals: Proposals
    features: Float
    scores: Float

    @classmethod
    def of(cls, groups: list[ScoredProposals]) -> ScoredProposals:
        """Join several groups in order."""
        return cls(
            concatenated([g.proposals for g in groups]),
            np.concatenate([g.features for g in groups]),
            np.concatenate([g.scores for g in groups]),
        )

    def take(self, index: npt.NDArray) -> ScoredProposals:
        """Proposals at ``index``, with their scores."""
        return ScoredProposals(self.proposals.take(index), self.features[index], self.scores[index])

    @property
    def order(self) -> Int64:
        """(H,) best first; of equal scores, to ``_TIE``, the larger mask, then the first."""
        size = np.count_nonzero(self.proposals.masks, axis=1)
        return np.lexsort((-size, -np.round(self.scores / _TIE)))

    @property
    def best(self) -> Bool:
        """(C,) the first mask in that order."""
        return self.proposals.masks[self.order[0]]


class PartSolver:
    """Finds the mask that a part's clicks mean.

    Attributes:
        describe: computes the proposals' features.
        sources: propose masks; the first one are the ``regions``.
        regions: the nested regions of the merge trees.
        moving_parts: scores clicks that mean moving parts; None where fronts aren't laid out.
    """

    def __init__(
        self,
        superpoints: Superpoints,
        hierarchy: Hierarchy,
        walk: RandomWalk,
        first_scorer: Scorer | None,
        later_scorer: Scorer | None,
        *,
        describe: MaskDescriber | None = None,
        sources: tuple[ProposalSource, ...] | None = None,
        regions: Regions | None = None,
        penalties: Penalties | None = None,
        moving_parts: MovingPartScoring | None = None,
    ) -> None:
        """``sources`` propose besides ``regions``; scorers of None stand for a hand-set rule."""
        self.superpoints = superpoints
        self.describe = describe or MaskDescriber(superpoints, hierarchy)
        self.regions = regions or Regions(superpoints, hierarchy)
        self.moving_parts = moving_parts
        self.penalties = penalties or Penalties()
        self.sources: tuple[ProposalSource, ...] = (self.regions, *(sources or ()))
        self._walks = Walks(walk, len(superpoints))
        self._first = first_scorer
        self._later = later_scorer

    def with_first(self, scorer: Scorer | None) -> Self:
        """The same solver with another scorer of first clicks."""
        other = copy(self)
        other._first = scorer
        return other

    def first_answer(self, superpoint: int, *, moving: bool = True) -> ScoredProposals:
        """Proposals for a first click without any other; ``moving`` as in :meth:`answer`."""
        return self.answer(PartState(), superpoint, True, None, moving=moving)

    def answer(
        self,
        state: PartState,
        superpoint: int,
        positive: bool,
        blocked: Bool | None,
        *,
        moving: bool = True,
    ) -> ScoredProposals:
        """Scored proposals for a new click.

        Args:
            state: before the click.
            superpoint: the clicked one.
            positive: whether the part should hold it.
            blocked: (C,) superpoints of other parts that this part may not take.
            moving: the click means a part that moves; otherwise it may mean the base, too. People
                don't click the base: what no click claims belongs to it.
        """
        after = state.with_click(superpoint, positive)
        if state.mask is None or not state.has_mask:
            return self._first_answer(after, superpoint, blocked, moving)
        context = ClickContext.of(state, after, superpoint, positive)
        groups = [
            p
            for source in self.sources
            if moving or not source.moving_only
            for p in source.later(state, after, superpoint, positive)
        ]
        found = self._constrained(distinct_proposals(groups), after, blocked)
        scores = self._score_later(self.describe(found, context))
        best = np.argsort(-scores, kind="stable")[:_CORRECTED]
        corrected = [self._walks.corrected(found.masks[int(i)], after) for i in best]
        more = [Proposals.of(corrected, "mend"), *self._walks.from_clicks(state.mask, after)]
        more = self._constrained(distinct_proposals(more), after, blocked)
        both = distinct_proposals([found, more])
        features = self.describe(both, context)
        scores = self._score_later(features)
        if moving and self.moving_parts is not None:
            features, scores = self.moving_parts.of_later(both.masks, features, scores, context)
        lost = np.clip(1 - features[:, _OVERLAP_BEFORE] / _USUAL_OVERLAP, 0, 1)
        penalty = self.penalties.of_later(
            self.superpoints, state, superpoint, positive, both.masks, lost
        )
        return ScoredProposals(both, features, scores - penalty)

    def _first_answer(
        self, after: PartState, superpoint: int, blocked: Bool | None, moving: bool
    ) -> ScoredProposals:
        context = ClickContext(after.positive, after.negative, superpoint, True)
        if not after.positive:
            empty = Proposals.of([np.zeros(len(self.superpoints), bool)], "keep")
            return ScoredProposals(empty, self.describe(empty, context), np.zeros(1, np.float32))
        groups = [
            p
            for source in self.sources
            if moving or not source.moving_only
            for p in source.first(superpoint, after.negative)
        ]
        found = distinct_proposals(groups)
        if blocked is not None:
            found = found.with_masks(found.masks & ~blocked)
        if after.negative:
            clean = ~found.masks[:, list(after.negative)].any(1)
            if clean.any():
                found = found.take(np.nonzero(clean)[0])
        found = self._constrained(found, after, blocked)
        features = self.describe(found, context)
        scores = self._score_first(features)
        if moving and self.moving_parts is not None:
            features, scores = self.moving_parts.of_first(
                found.masks, features, scores, self._first, context
            )
        penalty = self.penalties.of_first(self.superpoints, found.masks, after, blocked, moving)
        return ScoredProposals(found, features, scores - penalty)

    def _constrained(self, found: Proposals, after: PartState, blocked: Bool | None) -> Proposals:
        """Distinct proposals that agree with the clicks and leave out what is blocked."""
        masks = found.masks.copy()
        if blocked is not None:
            masks &= ~blocked
        masks[:, list(after.negative)] = False
        masks[:, list(after.positive)] = True
        return distinct_proposals([found.with_masks(masks)])

    def _score_first(self, features: Float) -> Float:
        if self._first is not None:
            return self._first(features)
        # Without a trained scorer: strong borders, lasting regions, a usual size.
        usual = -0.5 * ((features[:, 0] - np.log(0.06)) / 1.6) ** 2
        return features[:, _BORDER] + 0.5 * features[:, _LIFE] + 0.5 * usual

    def _score_later(self, features: Float) -> Float:
        if self._later is not None:
            return self._later(features)
        return features[:, _BORDER] / 9 + 0.1 * features[:, _AGREEMENT]

    def tidy(self, mask: Bool, state: PartState, superpoint: int) -> Bool:
        """``mask`` without small patches and holes that hold no click."""
        links, size = self.superpoints.links, self.superpoints.size
        same = mask[links.a] == mask[links.b]
        number, component = components(len(mask), links.a[same], links.b[same])
        held = np.bincount(component, size, number)
        small = held < min(_PATCH_OF_ALL * size.sum(), _PATCH_OF_MASK * size[mask].sum())
        small[component[[superpoint, *state.positive, *state.negative]]] = False
        return mask ^ small[component]

    def moved(self, state: PartState, superpoint: int, positive: bool, mask: Bool) -> PartState:
        """``state`` after a click that made the part ``mask``."""
        return state.with_correction(superpoint, positive, mask, self.superpoints.size)


def solver_of(
    encoding: Encoding,
    first: Scorer | None,
    later: Scorer | None,
    moving: Scorers = (None, None),
    *,
    with_fronts: bool = False,
) -> PartSolver:
    """The solver of an encoded object or room.

    Args:
        first, later: scorers of clicks that may mean the base, too.
        moving: scorers of clicks that mean a moving part.
        with_fronts: lay out fronts on meshes, too. For clicks, their faces and shells separate
            parts better.
    """
    superpoints, hierarchy, walk = encoding.superpoints, encoding.hierarchy, encoding.walk
    if encoding.room is not None:
        describe = RoomDescriber(superpoints, hierarchy, encoding.room)
        regions = Regions(superpoints, hierarchy)
        return PartSolver(
            superpoints,
            hierarchy,
            walk,
            first,
            later,
            describe=describe,
            regions=regions,
            sources=(RoomBoxes(superpoints, encoding.room, regions),),
            # A room's objects are many regions: a click for each is normal.
            penalties=Penalties(streak=0.0, demand_near=1.0),
        )
    nodes = encoding.nodes
    grid = BoxGrid(superpoints)
    planes, describe = together(
        lambda: grid.between_planes(superpoints),
        lambda: ObjectDescriber(superpoints, hierarchy, grid),
    )
    describe.with_history = later is None or not set(HISTORY_FEATURES).isdisjoint(later.names)
    regions = Regions(superpoints, hierarchy)
    shells = None
    if nodes.of_mesh and np.ptp(nodes.shell) > 0:
        shell = np.zeros(len(superpoints), np.int32)
        shell[superpoints.of_node] = nodes.shell
        shells = Shells(shell, superpoints.size)
    sources: list[ProposalSource] = [Boxes(grid, planes, regions, shells, nodes.of_mesh)]
    moving_parts = None
    if with_fronts or not nodes.of_mesh:
        fronts = Fronts(nodes, encoding.graph, encoding.strength, superpoints, grid.axes)
        sources.append(FrontRectangles(fronts, grid, shells))
        moving_parts = MovingPartScoring(fronts, superpoints, grid.axes, *moving)
    return PartSolver(
        superpoints,
        hierarchy,
        walk,
        first,
        later,
        describe=describe,
        regions=regions,
        sources=tuple(sources),
        moving_parts=moving_parts,
        penalties=Penalties.for_object(of_mesh=nodes.of_mesh),
    )
