"""Penetration between the links of a tree along a path in joint space."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from model.core.joint import Joint, motions
from model.core.tree import KinematicTree
from model.kinematics.penetration import Penetrations, RelativePath, inverse, moved, penetrations
from model.kinematics.surface import Surface

FloatArray = npt.NDArray[np.float64]
Poses = Mapping[str, FloatArray]
"""Link → (K, 4, 4) ``posed_from_rest``; missing links don't move."""


@dataclass(frozen=True, eq=False)
class JointPath:
    """A path of a tree's links that starts at rest.

    Attributes:
        q: (K,) parameter from 0 on: a joint's value, or any other number.
        poses: of the links at each of them.
        straight: whether it is a single translation, which one chord covers.
    """

    q: FloatArray
    poses: Poses
    straight: bool = False


@dataclass(frozen=True, eq=False)
class LinkContact:
    """Penetrations of the points of one link into the other.

    Attributes:
        forward: whether the points belong to ``moving``.
        sidestep: metres sideways that avoid both links' penetrations, or infinite.
    """

    moving: str
    still: str
    forward: bool
    found: Penetrations
    sidestep: float

    def depth(self, poses: Poses, q: FloatArray) -> tuple[FloatArray, npt.NDArray[np.int64]]:
        """(K,) depths at the poses of (K,) ``q``, and the index of each one's point."""
        each = self.found.depth(self._relative(poses, len(q)))
        each[np.abs(q)[:, None] < np.abs(self.found.q)] = 0.0
        rank = np.argpartition(-each, self.found.outliers, axis=1)[:, self.found.outliers]
        return np.minimum(each[np.arange(len(q)), rank], self.sidestep), rank

    def place(self, poses: Poses, k: int, index: int) -> FloatArray:
        """(3,) position of a penetrating point at pose ``k``, object frame."""
        link = self.moving if self.forward else self.still
        object_from_link = poses[link][k : k + 1] if link in poses else np.eye(4)[None]
        return moved(object_from_link, self.found.points[index][None])[0, 0]

    def onset(self, poses: Poses, q: FloatArray, tolerance: float) -> float:
        """Return abs(q) of the first contact that gets deeper than ``tolerance``, or infinity."""
        if self.sidestep <= tolerance:
            return math.inf
        each = self.found.depth(self._relative(poses, len(q))) > tolerance
        each &= np.abs(q)[:, None] >= np.abs(self.found.q)
        beyond = each.any(axis=0)
        if beyond.sum() <= self.found.outliers:
            return math.inf
        when = np.abs(q)[each.argmax(axis=0)]
        when[~beyond] = np.inf
        settled = np.partition(when, self.found.outliers)[self.found.outliers]
        onsets = np.abs(self.found.q)[when <= settled]
        rank = min(self.found.outliers, len(onsets) - 1)
        return float(np.partition(onsets, rank)[rank])

    def _relative(self, poses: Poses, count: int) -> FloatArray:
        """(K, 4, 4) from the points' link to the penetrated one."""
        still = np.broadcast_to(np.eye(4), (count, 4, 4))
        a, b = poses.get(self.moving, still), poses.get(self.still, still)
        return inverse(b) @ a if self.forward else inverse(a) @ b


def joint_poses(
    tree: KinematicTree, joint: Joint, q: Sequence[float] | FloatArray
) -> dict[str, FloatArray]:
    """Return the poses of the links that ``joint`` moves, the other joints at rest."""
    if not has_mimics(tree, joint):
        here = motions(joint, np.asarray(q, np.float64))
        return dict.fromkeys(tree.descendants(joint.child), here)
    # Mimics move too; a mimic that is moved itself leaves its leader at rest.
    if joint.mimic is not None:
        tree = tree.with_joint(replace(joint, mimic=None))
    return tree_poses(tree, [{joint.name: float(v)} for v in q])


def tree_poses(tree: KinematicTree, values: Sequence[Mapping[str, float]]) -> dict[str, FloatArray]:
    """Return the poses of the links that move on (K,) joint values; missing joints are at 0."""
    each = [tree.pose(v) for v in values]
    stacked = {link: np.stack([p[link] for p in each]) for link in tree.links}
    return {k: v for k, v in stacked.items() if not np.allclose(v, np.eye(4), atol=1e-12)}


def has_mimics(tree: KinematicTree, joint: Joint) -> bool:
    """True if mimics may move links that aren't below ``joint``."""
    return joint.mimic is not None or any(j.mimic is not None for j in tree.joints)


def contacts_along(
    path: JointPath,
    surfaces: Mapping[str, Surface],
    tolerance: float,
    pairs: Collection[frozenset[str]] | None = None,
) -> list[LinkContact]:
    """Find penetrations of all pairs of links that move against each other, or of ``pairs``.

    Args:
        surfaces: by link; links without one are left out.
        tolerance: metres, see :func:`model.kinematics.penetration.penetrations`.
    """
    count = len(path.q)
    still = np.broadcast_to(np.eye(4), (count, 4, 4))
    out: list[LinkContact] = []
    moving = [link for link in path.poses if link in surfaces]
    fixed = [link for link in surfaces if link not in path.poses]
    for i, a in enumerate(moving):
        for b in [*fixed, *moving[i + 1 :]]:
            if pairs is not None and frozenset((a, b)) not in pairs:
                continue
            b_from_a = inverse(path.poses.get(b, still)) @ path.poses[a]
            if np.allclose(b_from_a, b_from_a[0], atol=1e-12):
                continue
            out += _pair(path, a, b, b_from_a, surfaces, tolerance)
    return out


def _pair(
    path: JointPath,
    a: str,
    b: str,
    b_from_a: FloatArray,
    surfaces: Mapping[str, Surface],
    tolerance: float,
) -> list[LinkContact]:
    there = RelativePath(path.q, b_from_a, path.straight)
    back = RelativePath(path.q, inverse(b_from_a), path.straight)
    found = [
        penetrations(surfaces[part], surfaces[target], relative, tolerance)
        for part, target, relative in ((a, b, there), (b, a, back))
    ]
    kept = [(f, k == 0) for k, f in enumerate(found) if len(f.q) > f.outliers]
    # Either link may be the thin one: a sidestep must avoid both.
    sidestep = max((f.sidestep for f, _ in kept), default=0.0)
    return [LinkContact(a, b, forward, f, sidestep) for f, forward in kept]
