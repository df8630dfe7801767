"""Choose the other masks that a person is offered for a click: few that cover what may be meant."""

from __future__ import annotations

import numpy as np
from scipy.special import softmax

from model.segmentation.arrays import Bool, Float

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
