"""Contacts between the links of a tree along a way through joint space."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from model.core.joint import Joint, motion
from model.core.tree import KinematicTree
from model.kinematics.penetration import Penetrations, RelativePath, crossings, inverse, moved
from model.kinematics.surface import Surface

FloatArray = npt.NDArray[np.float64]
Poses = Mapping[str, FloatArray]
"""Link → (K, 4, 4) ``posed_from_rest``; links that aren't there stand still."""


@dataclass(frozen=True, eq=False)
class JointPath:
    """A way of a tree's links that begins at rest.

    Attributes:
        q: (K,) what counts the way: a joint's value, or any number that runs from 0.
        poses: at each of them.
        straight: whether it is one translation, so that a single chord serves.
    """

    q: FloatArray
    poses: Poses
    straight: bool = False


@dataclass(frozen=True, eq=False)
class LinkContact:
    """Crossings between two links in one direction; ``forward`` tells whose points they are.

    Attributes:
        aside: metres to step aside so that none of them happens; infinite where that is much.
    """

    moving: str
    still: str
    forward: bool
    found: Penetrations
    aside: float

    def depth(self, poses: Poses, q: FloatArray) -> tuple[FloatArray, npt.NDArray[np.int64]]:
        """(K,) how deep at the poses that belong to (K,) ``q``, and the crossing that says so."""
        each = self.found.depth(self._relative(poses, len(q)))
        each[np.abs(q)[:, None] < np.abs(self.found.q)] = 0.0
        rank = np.argpartition(-each, self.found.outliers, axis=1)[:, self.found.outliers]
        return np.minimum(each[np.arange(len(q)), rank], self.aside), rank

    def place(self, poses: Poses, k: int, crossing: int) -> FloatArray:
        """(3,) where the point of a crossing is at pose ``k``, object frame."""
        link = self.moving if self.forward else self.still
        object_from_link = poses[link][k : k + 1] if link in poses else np.eye(4)[None]
        return moved(object_from_link, self.found.points[crossing][None])[0, 0]

    def onset(self, poses: Poses, q: FloatArray, tolerance: float) -> float:
        """Where on the way the surfaces meet that are deeper than ``tolerance`` later on.

        Returns:
            |q|; infinite where nothing becomes that deep.
        """
        if self.aside <= tolerance:
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
        """(K, 4, 4) from the points' link to the crossed one."""
        still = np.broadcast_to(np.eye(4), (count, 4, 4))
        a, b = poses.get(self.moving, still), poses.get(self.still, still)
        return inverse(b) @ a if self.forward else inverse(a) @ b


def joint_poses(
    tree: KinematicTree, joint: Joint, q: Sequence[float] | FloatArray
) -> dict[str, FloatArray]:
    """Poses of the links that ``joint`` moves, the other joints at rest."""
    if not follows(tree, joint):
        here = np.stack([motion(joint, float(v)) for v in q])
        return dict.fromkeys(tree.descendants(joint.child), here)
    # Followers move too, and a follower that is dragged by hand leaves its leader alone.
    if joint.mimic is not None:
        tree = tree.with_joint(replace(joint, mimic=None))
    return tree_poses(tree, [{joint.name: float(v)} for v in q])


def tree_poses(tree: KinematicTree, values: Sequence[Mapping[str, float]]) -> dict[str, FloatArray]:
    """Poses of the links that move anywhere on (K,) joint values; missing joints are at 0."""
    each = [tree.pose(v) for v in values]
    stacked = {link: np.stack([p[link] for p in each]) for link in tree.links}
    return {k: v for k, v in stacked.items() if not np.allclose(v, np.eye(4), atol=1e-12)}


def follows(tree: KinematicTree, joint: Joint) -> bool:
    """Whether a mimic may make other links move than those below ``joint``."""
    return joint.mimic is not None or any(j.mimic is not None for j in tree.joints)


def contacts_along(
    way: JointPath,
    surfaces: Mapping[str, Surface],
    tolerance: float,
    pairs: Collection[frozenset[str]] | None = None,
) -> list[LinkContact]:
    """Contacts of every pair of links that move against each other, or of ``pairs`` alone.

    Args:
        surfaces: by link; links without one touch nothing.
        tolerance: metres, see :func:`model.kinematics.penetration.crossings`.
    """
    count = len(way.q)
    still = np.broadcast_to(np.eye(4), (count, 4, 4))
    out: list[LinkContact] = []
    moving = [link for link in way.poses if link in surfaces]
    fixed = [link for link in surfaces if link not in way.poses]
    for i, a in enumerate(moving):
        for b in [*fixed, *moving[i + 1 :]]:
            if pairs is not None and frozenset((a, b)) not in pairs:
                continue
            b_from_a = inverse(way.poses.get(b, still)) @ way.poses[a]
            if np.allclose(b_from_a, b_from_a[0], atol=1e-12):
                continue
            out += _pair(way, a, b, b_from_a, surfaces, tolerance)
    return out


def _pair(
    way: JointPath,
    a: str,
    b: str,
    b_from_a: FloatArray,
    surfaces: Mapping[str, Surface],
    tolerance: float,
) -> list[LinkContact]:
    there = RelativePath(way.q, b_from_a, way.straight)
    back = RelativePath(way.q, inverse(b_from_a), way.straight)
    found = [
        crossings(surfaces[part], surfaces[target], path, tolerance)
        for part, target, path in ((a, b, there), (b, a, back))
    ]
    kept = [(f, k == 0) for k, f in enumerate(found) if len(f.q) > f.outliers]
    # Each side may be the thin one: who passes the other's edge narrowly does so for both.
    aside = max((f.aside for f, _ in kept), default=0.0)
    return [LinkContact(a, b, forward, f, aside) for f, forward in kept]
