"""Simulated clicks, by the field's protocol.

The first click is the part's deepest point (or a random one); each next one is the deepest point
of the larger error, missing or extra (Zhou et al., *Point-SAM*, 2024), or, with many parts, of the
largest error cluster by pair of true and given part (Yue et al., *AGILE3D*, 2024).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from model.segmentation.arrays import Bool, Float, Int

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
