"""What holds a part: which parts touch nothing, and where a joint takes its part off its parent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.kinematics.joint_path import joint_poses
from model.kinematics.penetration import inverse, moved
from model.kinematics.surface import Surface

FloatArray = npt.NDArray[np.float64]

POSES = 9
"""Joint values at which the gap to the parent is measured."""
SAMPLES = 512
"""Of a part, of which those nearest to the other are followed to where the two come closest."""
CANDIDATES = 16
TURNS = 3


@dataclass(frozen=True, eq=False)
class Hold:
    """The gap between a joint's part and what held it at rest.

    Attributes:
        q: (S,) joint values. gap: (S,) metres. rest: metres at q = 0.
        where: (S, 3) the point of the part that is nearest to its holder, object frame.
        holder: the link that holds it.
    """

    q: FloatArray
    gap: FloatArray
    rest: float
    where: FloatArray
    holder: str

    @property
    def growth(self) -> FloatArray:
        """(S,) metres beyond the gap at rest."""
        return np.maximum(self.gap - self.rest, 0.0)


def loose_parts(
    tree: KinematicTree, surfaces: Mapping[str, Surface], tolerance: float
) -> dict[str, tuple[float, str | None]]:
    """Links whose parts neither touch the main body nor anything that does.

    Args:
        tolerance: metres of gap that still count as touching.

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
    """A part of the main body: the root's, else the one that the most surface hangs together
    with."""
    if tree.root in surfaces:
        return links.index(tree.root)
    size = np.array([surfaces[k].diagonal ** 2 for k in links])
    return int(np.argmax(reach @ size))


def hold(
    tree: KinematicTree, joint: Joint, surfaces: Mapping[str, Surface], lower: float, upper: float
) -> Hold | None:
    """How far ``joint`` takes its part off its parent over its range; None where either has none.

    A child without a part stands for what hangs on it, a parent without one for what it hangs on.
    """
    moving = [joint.child] if joint.child in surfaces else []
    moving = moving or [k for k in tree.descendants(joint.child) if k in surfaces]
    holder = joint.parent
    while holder not in surfaces and holder in tree.joint_of:
        holder = tree.joint_of[holder].parent
    if not moving or holder not in surfaces:
        return None
    q = np.unique(np.append(np.linspace(lower, upper, POSES), 0.0))
    poses = joint_poses(tree, joint, q)
    still = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    gaps, places = [], []
    for link in moving:
        to_holder = inverse(poses.get(holder, still)) @ poses.get(link, still)
        gap, at = _gaps(surfaces[link], surfaces[holder], to_holder)
        gaps.append(gap)
        places.append(_all(poses.get(holder, still), at[:, None])[:, 0])
    first = np.argmin(np.stack(gaps), axis=0)
    rows = np.arange(len(q))
    gap, where = np.stack(gaps)[first, rows], np.stack(places)[first, rows]
    rest = float(gap[int(np.argmin(np.abs(q)))])
    return Hold(q, gap, rest, where, holder)


def _gaps(part: Surface, holder: Surface, to_holder: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(S,) gaps at (S, 4, 4) poses, and (S, 3) the nearest point of the part, holder's frame.

    The nearest samples are moved to the nearest points of the two surfaces in turn, which finds
    where they come closest nearby (alternating projections).
    """
    poses = len(to_holder)
    few = part.points[:SAMPLES]
    at = moved(to_holder, few)
    distance = np.asarray(holder.tree.query(at.reshape(-1, 3))[0]).reshape(poses, -1)
    count = min(CANDIDATES, len(few))
    best = np.argpartition(distance, count - 1, axis=1)[:, :count]
    mine = np.take_along_axis(at, best[:, :, None], axis=1)
    to_part = inverse(to_holder)
    for _ in range(TURNS):
        gap, theirs = holder.distance(mine.reshape(-1, 3))
        back = _all(to_part, theirs.reshape(poses, -1, 3))
        closest = part.distance(back.reshape(-1, 3))[1].reshape(poses, -1, 3)
        mine = _all(to_holder, closest)
    gap = holder.distance(mine.reshape(-1, 3))[0].reshape(poses, -1)
    k = gap.argmin(axis=1)
    rows = np.arange(poses)
    return gap[rows, k], mine[rows, k]


def _all(poses: FloatArray, points: FloatArray) -> FloatArray:
    """(S, N, 3): the k-th (N, 3) points moved by the k-th of (S, 4, 4) poses."""
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
