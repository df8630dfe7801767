"""Support of parts: which parts touch no other, and where a joint takes its part off its parent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.kinematics.penetration import inverse, moved
from model.kinematics.surface import Surface
from model.kinematics.sweep import joint_poses

FloatArray = npt.NDArray[np.float64]

POSES = 9
"""Joint values at which the gap to the parent is measured."""
SAMPLES = 512
"""Samples of a part; the nearest :data:`CANDIDATES` of them are refined to the closest points."""
CANDIDATES = 16
ITERATIONS = 3


@dataclass(frozen=True, eq=False)
class SupportGap:
    """The gap between a joint's part and its support over the joint's range.

    Attributes:
        q: (S,) joint values. gap: (S,) metres. rest: metres at q = 0.
        where: (S, 3) the point of the part that is nearest to the support, object frame.
        link: of the support.
    """

    q: FloatArray
    gap: FloatArray
    rest: float
    where: FloatArray
    link: str

    @property
    def growth(self) -> FloatArray:
        """(S,) metres beyond the gap at rest."""
        return np.maximum(self.gap - self.rest, 0.0)


def loose_parts(
    tree: KinematicTree, surfaces: Mapping[str, Surface], tolerance: float
) -> dict[str, tuple[float, str | None]]:
    """Find parts that are connected to the main body neither directly nor through others.

    Args:
        tolerance: largest gap in metres that counts as touching.

    Returns:
        link → gap to the nearest other part and its link.
    """
    links = [k for k in tree.order if k in surfaces]
    if len(links) < 2:
        return {}
    gap = _box_gaps([surfaces[k] for k in links])
    near = np.eye(len(links), dtype=bool)
    for i, j in np.argwhere(np.triu(gap <= tolerance, 1)):
        near[i, j] = near[j, i] = _gap(surfaces[links[i]], surfaces[links[j]]) <= tolerance
    reach = near
    for _ in range(len(links).bit_length()):
        reach = (reach.astype(np.int64) @ reach) > 0
    main = _main(tree, surfaces, links, reach)
    out: dict[str, tuple[float, str | None]] = {}
    for i in np.flatnonzero(~reach[main]):
        others = np.flatnonzero(~reach[i])
        first = others[np.argsort(gap[i, others])[:4]]
        exact = [_gap(surfaces[links[i]], surfaces[links[k]]) for k in first]
        nearest = int(np.argmin(exact))
        out[links[i]] = (exact[nearest], links[first[nearest]])
    return out


def _main(
    tree: KinematicTree, surfaces: Mapping[str, Surface], links: Sequence[str], reach: npt.NDArray
) -> int:
    """Index of the root's part, else of one in the largest connected group."""
    if tree.root in surfaces:
        return links.index(tree.root)
    size = np.array([surfaces[k].diagonal ** 2 for k in links])
    return int(np.argmax(reach @ size))


def support_gap(
    tree: KinematicTree, joint: Joint, surfaces: Mapping[str, Surface], lower: float, upper: float
) -> SupportGap | None:
    """Measure the gap between ``joint``'s part and its parent's; None where either has none.

    A child without a part is replaced by the links below it, a parent without one by the next link
    above it.
    """
    moving = [joint.child] if joint.child in surfaces else []
    moving = moving or [k for k in tree.descendants(joint.child) if k in surfaces]
    support = joint.parent
    while support not in surfaces and support in tree.joint_of:
        support = tree.joint_of[support].parent
    if not moving or support not in surfaces:
        return None
    q = np.unique(np.append(np.linspace(lower, upper, POSES), 0.0))
    poses = joint_poses(tree, joint, q)
    still = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    gaps, places = [], []
    for link in moving:
        support_from_part = inverse(poses.get(support, still)) @ poses.get(link, still)
        gap, at = _gaps(surfaces[link], surfaces[support], support_from_part)
        gaps.append(gap)
        places.append(_all(poses.get(support, still), at[:, None])[:, 0])
    first = np.argmin(np.stack(gaps), axis=0)
    rows = np.arange(len(q))
    gap, where = np.stack(gaps)[first, rows], np.stack(places)[first, rows]
    rest = float(gap[int(np.argmin(np.abs(q)))])
    return SupportGap(q, gap, rest, where, support)


def _gaps(
    part: Surface, support: Surface, support_from_part: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(S,) gaps at (S, 4, 4) poses, and (S, 3) the nearest point of the part, support's frame.

    Alternating projections: the nearest samples are moved to the closest points of the two
    surfaces in turn.
    """
    poses = len(support_from_part)
    few = part.points[:SAMPLES]
    at = moved(support_from_part, few)
    distance = np.asarray(support.tree.query(at.reshape(-1, 3))[0]).reshape(poses, -1)
    count = min(CANDIDATES, len(few))
    best = np.argpartition(distance, count - 1, axis=1)[:, :count]
    mine = np.take_along_axis(at, best[:, :, None], axis=1)
    part_from_support = inverse(support_from_part)
    for _ in range(ITERATIONS):
        gap, theirs = support.distance(mine.reshape(-1, 3))
        back = _all(part_from_support, theirs.reshape(poses, -1, 3))
        closest = part.distance(back.reshape(-1, 3))[1].reshape(poses, -1, 3)
        mine = _all(support_from_part, closest)
    gap = support.distance(mine.reshape(-1, 3))[0].reshape(poses, -1)
    k = gap.argmin(axis=1)
    rows = np.arange(poses)
    return gap[rows, k], mine[rows, k]


def _all(poses: FloatArray, points: FloatArray) -> FloatArray:
    """(S, N, 3): the k-th (N, 3) points moved by the k-th (4, 4) pose."""
    return np.einsum("sij,snj->sni", poses[:, :3, :3], points) + poses[:, None, :3, 3]


def _gap(a: Surface, b: Surface) -> float:
    """Smallest distance between two surfaces at rest."""
    rest = np.eye(4)[None]
    return float(min(_gaps(a, b, rest)[0][0], _gaps(b, a, rest)[0][0]))


def _box_gaps(surfaces: Sequence[Surface]) -> FloatArray:
    """(P, P) distances between the parts' boxes."""
    low = np.stack([s.bounds[0] for s in surfaces])
    high = np.stack([s.bounds[1] for s in surfaces])
    apart = np.maximum(low[:, None] - high[None], low[None] - high[:, None])
    return np.linalg.norm(np.maximum(apart, 0.0), axis=2)
