"""Split superpoints of two colours on clouds that were sampled from models.

Where one part lies inside another by less than the point spacing (a drawer's box in its carcass, a
blade in its handle), neither creases nor gaps separate them and a superpoint holds points of both;
their colours may still differ. Depth cameras see only the outer part and never record such flat
colours, so scans gain nothing.
"""

from __future__ import annotations

import numpy as np

from model.segmentation.arrays import Float, Int, Int64, Uint8

_LEAST_STEP = 10.0
"""Least Lab distance of two colours: about four just noticeable differences."""
_CLEAR = 4.0
"""Least distance of two colours in units of the spread around them; texture and noise have less."""
_LEAST_NODES = 2
_ROUNDS = 2
_MOVES = 3
_FLAT = 0.5
_NEAR = 6


def has_flat_colors(colors: Uint8, neighbors: Int) -> bool:
    """True if most colours (N, 3) equal that of one of their (N, K) neighbours."""
    same = (colors[neighbors[:, :_NEAR]] == colors[:, None]).all(axis=2).any(axis=1)
    return bool(same.mean() > _FLAT)


def split_by_color(of_node: Int, lab: Float, number: int) -> tuple[Int64, int]:
    """Split superpoints whose nodes have two to four colours.

    Args:
        of_node: (N,) the superpoint of each node.
        lab: (N, 3) CIE Lab.
        number: of superpoints, C.

    Returns:
        (N,) the new superpoint of each node, and the new number.
    """
    superpoints: Int64 = of_node.astype(np.int64)
    for _ in range(_ROUNDS):
        side, step, spread, fewer = _two_colors(superpoints, lab, number)
        cut = (step > _LEAST_STEP) & (step > _CLEAR * spread) & (fewer >= _LEAST_NODES)
        if not cut.any():
            break
        other = (side == 1) & cut[superpoints]
        new = np.cumsum(cut) - 1 + number
        superpoints = np.where(other, new[superpoints], superpoints)
        number += int(cut.sum())
    return superpoints, number


def _two_colors(of_node: Int64, lab: Float, number: int) -> tuple[Int64, Float, Float, Int64]:
    """Two-means clustering of each superpoint's colours.

    Returns:
        (N,) the cluster 0 or 1 of each node; (C,) distance of the two means, (C,) root mean square
        distance of the nodes to theirs, and (C,) nodes of the smaller cluster.
    """
    order = np.argsort(of_node, kind="stable")
    start = np.searchsorted(of_node[order], np.arange(number))

    def farthest(middle: Float) -> Float:
        """(C, 3) in each superpoint the colour that is farthest from (C, 3) ``middle``."""
        far = np.linalg.norm(lab - middle[of_node], axis=1)[order]
        most = np.maximum.reduceat(far, start)
        at = np.flatnonzero(far == most[of_node[order]])
        first = at[np.r_[True, np.diff(of_node[order][at]) != 0]]
        return lab[order[first]]

    def means(group: Int64, count: int) -> Float:
        size = np.maximum(np.bincount(group, minlength=count), 1)
        return np.stack([np.bincount(group, v, count) for v in lab.T], axis=1) / size[:, None]

    one = farthest(means(of_node, number))
    two = farthest(one)
    side = np.zeros(len(lab), np.int64)
    for _ in range(_MOVES):
        nearer = np.linalg.norm(lab - two[of_node], axis=1)
        side = (nearer < np.linalg.norm(lab - one[of_node], axis=1)).astype(np.int64)
        both = means(2 * of_node + side, 2 * number)
        one, two = both[::2], both[1::2]
    count = np.bincount(2 * of_node + side, minlength=2 * number).reshape(number, 2)
    rest = ((lab - both[2 * of_node + side]) ** 2).sum(1)
    free = np.maximum(count.sum(1) - 2, 1)  # two means of few points fit any noise
    spread = np.sqrt(np.bincount(of_node, rest, number) / free)
    return side, np.linalg.norm(one - two, axis=1), spread, count.min(1)
