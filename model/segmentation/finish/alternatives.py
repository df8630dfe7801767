"""Which other masks a person is offered for a click: a few, that cover what may be meant."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Bool = npt.NDArray[np.bool_]
Float = npt.NDArray[np.floating]

ALTERNATIVES = 5
_TEMPERATURE = 2.0
"""Scores are surer than they should be; chosen of one to five by the best mask offered."""
_ALIKE = 0.9
"""Masks that overlap by more look the same."""


def overlaps(masks: Bool, size: Float) -> tuple[Float, Float]:
    """How much every two masks have in common, and their IoU.

    Args:
        masks: (H, C). size: (C,) how much each superpoint counts.

    Returns:
        (H, H) each; the diagonal of the first is how large the masks are.
    """
    weighted = masks * np.sqrt(size).astype(np.float32)
    common = weighted @ weighted.T
    area = np.diagonal(common)
    return common, common / np.maximum(area[:, None] + area[None] - common, 1e-9)


def look_alike(one: Bool, other: Bool, size: Float) -> bool:
    """Whether two masks (N,) overlap so much that a person would not tell them apart.

    Args:
        size: (N,) how much each element counts.
    """
    return float(size @ (one & other)) >= _ALIKE * float(size @ (one | other))


def offered(
    masks: Bool, scores: Float, shown: Bool, size: Float, most: int = ALTERNATIVES
) -> list[int]:
    """Masks such that one of them, or the one shown, is expected to overlap most with the part.

    The highest scores often go to one mask with small changes; whoever presses Tab wants another
    one. So each next mask is the one that adds most to the expected overlap of the best one with
    the true one, where every hypothesis is the true one with the probability that its score gives
    (greedy for a submodular gain: Nemhauser, Wolsey and Fisher, 1978).

    Args:
        masks: (H, C) hypotheses. scores: (H,) their log-odds. shown: (C,) the mask on the screen.
        size: (C,) how much each superpoint counts.
        most: masks at most.

    Returns:
        Rows of ``masks``, the most useful first.
    """
    _, overlap = overlaps(np.concatenate([shown[None], masks]), size)
    likely = np.exp((scores - scores.max()) / _TEMPERATURE)
    likely /= likely.sum()
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
