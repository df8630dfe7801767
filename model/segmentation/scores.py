"""Score described masks: trained scorers by input domain, parts that move, penalties.

Parts that move are scored by what they show on the front that was clicked. Penalties are for
proposals that people seldom mean, whatever they look like. Scores are log-odds; a penalty is taken
off. Sizes are numbers of nodes. The figures were chosen on PartNet-Mobility objects and procedural
ones; see docs/benchmarks/segmentation.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np

from model.core.files import static_assets
from model.segmentation.arrays import Bool, Float
from model.segmentation.fronts import Fronts
from model.segmentation.mask_features import ROOM_FEATURE_NAMES, ClickContext
from model.segmentation.models import Scorer, Trees, load_scorer
from model.segmentation.object_features import (
    MOVING_FEATURE_NAMES,
    OBJECT_FEATURE_NAMES,
    front_features,
)
from model.segmentation.proposals import PartState
from model.segmentation.superpoints import Superpoints

_TREES_SCALE = 3.0
"""Scores of trees for first clicks times this vary as much as a network's."""
_FIRST_WEIGHT, _LATER_WEIGHT = 0.8, 0.5
"""Weights of the scorers of moving parts; the general ones, trained on other objects, have the
rest. Chosen on PartNet-Mobility objects."""
ALONE_MARGIN = 1.0
"""Least distance of the score of a clicked handle alone to the best answer with what it moves."""
_BAR_PENALTY = 12.0
"""Limit of the penalty for a handle alone if it is four times as long as wide; less for shorter
ones, none below twice."""


@dataclass(frozen=True, eq=False)
class MovingPartScoring:
    """Blends the scorers of moving parts into the scores.

    Attributes:
        axes: (3, 3) main directions, in rows.
        first, later: scorers of first and of later clicks; None leaves the scores.
    """

    fronts: Fronts
    superpoints: Superpoints
    axes: Float
    first: Scorer | None = None
    later: Scorer | None = None

    def of_first(
        self,
        masks: Bool,
        features: Float,
        scores: Float,
        general: Scorer | None,
        context: ClickContext,
    ) -> tuple[Float, Float]:
        """(H, F) features and (H,) scores of first answers; ``general`` gave ``scores``."""
        scaled = scores * _TREES_SCALE if isinstance(general, Trees) else scores
        features, scores = self._blended(
            masks, features, scaled, self.first, _FIRST_WEIGHT, context
        )
        return features, scores - self._bar_penalty(masks, scores, context.last)

    def of_later(
        self, masks: Bool, features: Float, scores: Float, context: ClickContext
    ) -> tuple[Float, Float]:
        """(H, F) features and (H,) scores of later answers."""
        return self._blended(masks, features, scores, self.later, _LATER_WEIGHT, context)

    def _blended(
        self,
        masks: Bool,
        features: Float,
        scores: Float,
        scorer: Scorer | None,
        weight: float,
        context: ClickContext,
    ) -> tuple[Float, Float]:
        fronts = self.fronts.of(context.first)
        front = fronts[-1] if fronts else None
        shown = front_features(masks, self.superpoints, self.axes, front)
        both = np.concatenate([features, shown], axis=1)
        if scorer is not None:
            scores = weight * scorer(both) + (1 - weight) * scores
        return both, scores

    def _bar_penalty(self, masks: Bool, scores: Float, superpoint: int) -> Float | float:
        """(H,) of masks that hold a clicked handle without the front behind it.

        People who click a bar mean the door or drawer that it moves. The penalty is no larger than
        necessary, so that Tab shows the handle alone.
        """
        bar = self.fronts.bar(superpoint)
        if bar is None:
            return 0.0
        size = (bar.behind * self.superpoints.size).astype(np.float32)
        alone = masks.astype(np.float32) @ size < 0.5 * size.sum()
        if alone.all():
            return 0.0
        ahead = float(scores.max(where=alone, initial=-np.inf) - scores[~alone].max())
        most = _BAR_PENALTY * np.clip(np.log2(bar.length) - 1, 0, 1)
        return np.clip(ahead + ALONE_MARGIN, 0, most) * alone


_IDLE_SUPERPOINTS, _IDLE_SHARE, _IDLE = 2, 0.1, 3.0
"""An early click that changes no more than so many superpoints, or so much of the mask."""
_LOSS = 3.0
"""A late click that throws away most of the mask."""
_DRAWN_CLICKS, _DRAWN_LOSS = 4, 5.0
"""A mask that the person chose or drew counts as so many clicks, and its loss so many times."""
NEARLY_ALL = 0.9
"""Share of the free surface above which a first answer is no part: it has to move against
something."""
_ALL_RAMP, _ALL = 0.05, 12.0
_LARGE_FROM, _LARGE_RAMP = 0.5, 0.2
"""Share of the object above which hardly any moving part lies."""
LARGE = 2.0
_SIZE, _SIZE_MOST = 4.0, 1.0
"""A mask outside the bounds on the part's size, by the logarithm of the factor, and its limit."""
_INEFFECTIVE = 4.0
"""A click that follows ineffective ones and again changes little."""
_DEMAND, _DEMAND_GROWTH, _DEMAND_MOST = 0.05, 3.0, 0.5
"""Share of the mask that such a click has to change, growth with each ineffective one, limit."""
_STREAK_FREE = 2
"""Clicks of one sign in a row that are normal."""
_FAR, _FAR_MOST = 10.0, 3.0
"""A mask that changes more than this times the nodes nearer to the click than the border, by the
logarithm of the factor, up to a limit."""
_SMALL_FIRST, _SMALL_NODES, _SMALL, _SMALL_MOST = 32.0, 16.0, 3.0, 3.0
"""A first answer and a later mask of fewer nodes, by the logarithm of the factor, up to a limit."""
_DETAIL, _NO_DETAIL = 2e-4, 0.02
"""Shares of the object at which a first answer is a detail, and none any more."""


@dataclass(frozen=True)
class Penalties:
    """Weights that differ between input domains.

    Attributes:
        far: of a change far larger than the click's distance from the border.
        large, large_beside: of a first answer that is most of the object: of the first part, and
            beside other parts.
        detail: of a first answer that is a detail of the object.
        streak: how much of an ineffective click each further click of one sign counts.
        demand_near: limit of the demanded change, in the nodes nearer than the border.
    """

    far: float = 0.3
    large: float = 0.0
    large_beside: float = 0.0
    detail: float = 0.0
    streak: float = 0.5
    demand_near: float = 2.0

    @classmethod
    def for_object(cls, *, of_mesh: bool) -> Penalties:
        """Penalties for objects.

        Args:
            of_mesh: whole shells come and go, however near to their border a click is.
        """
        far, large = (0.0, LARGE) if of_mesh else (cls.far, 0.0)
        return cls(far=far, large=large, large_beside=LARGE, detail=1.0)

    def of_first(
        self,
        superpoints: Superpoints,
        masks: Bool,
        after: PartState,
        blocked: Bool | None,
        moving: bool,
    ) -> Float:
        """(H,) of first answers: nearly all that is free, most of the object, or very small.

        Args:
            after: the clicks so far. blocked: (C,) superpoints of other parts.
            moving: whether the click means a moving part.
        """
        size = superpoints.size
        held = masks.astype(np.float64) @ size
        free = size if blocked is None else size[~blocked]
        share = held / max(float(free.sum()), 1e-9)
        out = _ALL * np.clip((share - NEARLY_ALL) / _ALL_RAMP, 0, 1)
        # People who have clicked other parts are after those that move, not after the base.
        beside = bool(after.negative) or (blocked is not None and bool(blocked.any()))
        if beside or moving:
            most = np.clip((held / size.sum() - _LARGE_FROM) / _LARGE_RAMP, 0, 1)
            out += (self.large_beside if beside else self.large) * most
        out += _small(held, _SMALL_FIRST)
        larger = np.log(np.maximum(held, 1.0) / (_DETAIL * size.sum()))
        return out + self.detail * (1 - np.clip(larger / np.log(_NO_DETAIL / _DETAIL), 0, 1))

    def of_later(
        self,
        superpoints: Superpoints,
        before: PartState,
        superpoint: int,
        positive: bool,
        masks: Bool,
        lost: Float,
    ) -> Float:
        """(H,) of answers to a click on ``superpoint`` that corrects the mask of ``before``.

        Args:
            lost: (H,) 0..1 how much of that mask is gone.
        """
        assert before.mask is not None
        size = superpoints.size
        own = float(size[before.mask].sum())
        sides = np.stack([size, size * before.mask], axis=1)
        now, kept = (masks.astype(np.float64) @ sides).T
        changed = now + own - 2 * kept
        informative = len(before.positive) + len(before.negative) - sum(before.confirmed)
        clicks = max(informative, 1) + _DRAWN_CLICKS * before.drawn
        early = np.exp(-(clicks - 1) / 2)
        idle = changed <= min(_IDLE_SUPERPOINTS * size.mean(), _IDLE_SHARE * own)
        out = _IDLE * early * idle
        # A mask that was chosen or drawn isn't thrown away because a click brought little.
        loss = _LOSS * (_DRAWN_LOSS if before.drawn else 1 / (1 + before.ineffective))
        out += loss * (1 - early) * lost
        least, most = before.size_bounds(positive, size)
        log_now = np.log(np.maximum(now, 1))
        over, under = log_now - np.log(max(most, 1)), np.log(max(least, 1)) - log_now
        out += _SIZE * np.clip(np.maximum(over, under), 0, _SIZE_MOST)
        out += _small(now, np.minimum(_SMALL_NODES, own))
        near = _nearer_than_border(superpoints, before.mask, superpoint)
        # People who click right beside the border of a mask mean what is there.
        far = np.log(np.maximum(changed, 1.0) / (_FAR * max(near, 1e-9)))
        out += self.far * np.clip(far, 0, _FAR_MOST)
        # If the next click lies far from a first answer, that was a detail: the handle of a door.
        detail = near > own and not before.mask[superpoint]
        demand = self._demanded(before, positive, near, own, detail)
        if demand is not None:
            out += _INEFFECTIVE * np.clip(1 - changed / max(demand, 1.0), 0, 1)
        return out

    def _demanded(
        self, before: PartState, positive: bool, near: float, own: float, detail: bool
    ) -> float | None:
        """Nodes that a click has to change: more after ineffective ones, None without any."""
        streak = before.streak if positive else -before.streak
        ineffective = before.ineffective + self.streak * max(streak - _STREAK_FREE, 0)
        if not ineffective and not detail:
            return None
        share = min(_DEMAND * _DEMAND_GROWTH**ineffective, _DEMAND_MOST)
        return min(share * (near if detail else own), self.demand_near * near)


def _small(nodes: Float, least: float | np.floating) -> Float:
    return _SMALL * np.clip(np.log(least / np.maximum(nodes, 1.0)), 0, _SMALL_MOST)


def _nearer_than_border(superpoints: Superpoints, mask: Bool, superpoint: int) -> float:
    """Nodes nearer to a superpoint than what lies on the other side of the mask's border."""
    size = superpoints.size
    apart = ((superpoints.center - superpoints.center[superpoint]) ** 2).sum(1)
    other = mask != mask[superpoint]
    return float(size[apart < apart[other].min()].sum() if other.any() else size.sum())


MOVING_SCORERS = ("first_click_moving.npz", "later_click_moving.npz")

InputDomain = Literal["mesh", "cloud", "room"]
"""Input domain: a mesh, a cloud, or a room."""
SCORERS: dict[InputDomain, tuple[str, str]] = {
    "mesh": ("first_click.npz", "later_click.npz"),
    "cloud": ("first_click_cloud.npz", "later_click_cloud.npz"),
    "room": ("room_first_click.npz", "room_later_click.npz"),
}
"""Files of the scorers of first and later clicks."""

Scorers = tuple[Scorer | None, Scorer | None]
"""Scorers of first and of later clicks."""


@lru_cache(maxsize=len(SCORERS))
def shipped_scorers(domain: InputDomain = "mesh") -> Scorers:
    """The project's scorers; None for absent files."""
    return read_scorers(static_assets() / "segmentation", domain)


def read_scorers(folder: Path, domain: InputDomain = "mesh") -> Scorers:
    """The scorers in ``folder``; None for absent files."""
    names = ROOM_FEATURE_NAMES if domain == "room" else OBJECT_FEATURE_NAMES
    return _read(folder, SCORERS[domain], names)


@lru_cache(maxsize=1)
def shipped_moving_scorers() -> Scorers:
    """The project's scorers of moving parts on clouds of objects; None for absent files."""
    return _read(static_assets() / "segmentation", MOVING_SCORERS, MOVING_FEATURE_NAMES)


def _read(folder: Path, files: tuple[str, str], names: tuple[str, ...]) -> Scorers:
    first, later = (folder / name for name in files)
    return (
        load_scorer(first, names) if first.is_file() else None,
        load_scorer(later, names) if later.is_file() else None,
    )
