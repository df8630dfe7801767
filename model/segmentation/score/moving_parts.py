"""Score proposals as parts that move, by what they show on the front that was clicked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model.segmentation.arrays import Bool, Float
from model.segmentation.describe.fronts import front_features
from model.segmentation.describe.masks import ClickContext
from model.segmentation.encode.superpoints import Superpoints
from model.segmentation.models.trees import Scorer, Trees
from model.segmentation.propose.fronts import Fronts

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
        self, masks: Bool, features: Float, scores: Float, general: Scorer | None,
        context: ClickContext,
    ) -> tuple[Float, Float]:  # fmt: skip
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
        self, masks: Bool, features: Float, scores: Float, scorer: Scorer | None, weight: float,
        context: ClickContext,
    ) -> tuple[Float, Float]:  # fmt: skip
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
