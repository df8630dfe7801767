"""Motion sweeps: penetration over a joint's range, and along a path of several joints.

Penetration at rest doesn't count; see :mod:`model.kinematics.penetration`.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject
from model.core.errors import KinematicsError
from model.core.joint import Joint, motions
from model.core.tree import KinematicTree
from model.kinematics.penetration import Penetrations, RelativePath, inverse, moved, penetrations
from model.kinematics.surface import POINTS, Surface, surface_of

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


TOLERANCE = 0.005
"""Largest penetration that is no collision, in the object's diagonal."""
CHORD = math.radians(6.0)
"""Longest arc between two poses of the sweep, radians."""
SLIDE_STEPS = 16
FINE = 129
"""Poses at which the first collision is searched."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """Penetration of a joint's subtree into the other parts.

    Attributes:
        joint: its name.
        q: (S,) joint values in radians or metres, ascending.
        depth: (S,) metres beyond the penetration at rest, at most the sidestep that avoids it; 0
            without one.
        where: (S, 3) the deepest point at that pose, object frame; NaN without one.
        others: (S,) penetrated link, or None.
        tolerance: metres that the surfaces' noise may cause.
        free: joint values within the limits, about 0, between which nothing collides.
    """

    joint: str
    q: FloatArray
    depth: FloatArray
    where: FloatArray
    others: tuple[str | None, ...]
    tolerance: float
    free: tuple[float, float]

    @property
    def collides(self) -> npt.NDArray[np.bool_]:
        """(S,) whether the depth is beyond the tolerance."""
        return self.depth > self.tolerance


@dataclass(frozen=True, eq=False)
class PathSweep:
    """Penetration between links along a path in joint space.

    Attributes:
        depth, where: as in :class:`Sweep`, (K,) and (K, 3).
        pairs: (K,) the two links, or None.
        tolerance: as in :class:`Sweep`.
    """

    depth: FloatArray
    where: FloatArray
    pairs: tuple[tuple[str, str] | None, ...]
    tolerance: float


def sweep_joint(
    obj: ArticulatedObject,
    joint: str | Joint,
    samples: int = 33,
    *,
    tolerance: float | None = None,
    points: int = POINTS,
) -> Sweep:
    """Move a joint through its range, the others at rest, and find what its subtree penetrates.

    Args:
        joint: a name, or a joint that replaces its child's joint.
        samples: number of joint values; a continuous joint is swept from -π to π.
        tolerance: metres; by default :data:`TOLERANCE` of the object's diagonal, or the spacing of
            a cloud's points if that is more.
        points: samples per part.

    Raises:
        KinematicsError: for an unknown or fixed joint.
    """
    tree, moving = _tree_with(obj, joint)
    lower, upper = moving.motion_range
    q = np.linspace(lower, upper, samples)
    surfaces = surfaces_of(obj, points)
    scale = sweep_tolerance(surfaces) if tolerance is None else tolerance or 1e-9
    found = _Deepest(samples)
    free = [0.0, 0.0]
    for k, end in enumerate((min(lower, 0.0), max(upper, 0.0))):
        if end == 0.0:
            continue
        contacts = contacts_along(_joint_path(tree, moving, end), surfaces, scale)
        mine = np.flatnonzero((q * end > 0) & (abs(end) >= np.abs(q)))
        if contacts and len(mine):
            poses = joint_poses(tree, moving, q[mine])
            for contact in contacts:
                found.add(contact, poses, q[mine], mine)
        free[k] = _first_collision(tree, moving, contacts, end, scale)
    others = tuple(None if p is None else p[1] for p in found.pairs)
    return Sweep(moving.name, q, found.depth, found.where, others, scale, (free[0], free[1]))


def free_range(
    obj: ArticulatedObject,
    joint: str | Joint,
    maximum: float | None = None,
    *,
    tolerance: float | None = None,
    points: int = POINTS,
) -> tuple[float, float]:
    """Find how far a joint moves either way from rest before its subtree collides.

    The joint's own limits are ignored. The values are at the first contact of surfaces that later
    penetrate beyond the tolerance.

    Args:
        maximum: radians or metres to try each way; π or the object's diagonal by default.

    Returns:
        (lower ≤ 0, upper ≥ 0); ∓maximum without a collision.

    Raises:
        KinematicsError: as :func:`sweep_joint`.
    """
    tree, moving = _tree_with(obj, joint)
    surfaces = surfaces_of(obj, points)
    if maximum is None:
        maximum = math.pi if moving.rotates else diagonal_of(surfaces)
    scale = sweep_tolerance(surfaces) if tolerance is None else tolerance or 1e-9
    free = [free_until(tree, moving, surfaces, end, scale) for end in (-maximum, maximum)]
    return min(free[0], 0.0), max(free[1], 0.0)


def free_until(
    tree: KinematicTree,
    joint: Joint,
    surfaces: Mapping[str, Surface],
    end: float,
    tolerance: float,
) -> float:
    """Return the joint value between 0 and ``end`` where the first collision begins, or ``end``.

    Args:
        surfaces: by link; links without one are left out.
        tolerance: largest penetration in metres that is no collision.
    """
    contacts = contacts_along(_joint_path(tree, joint, end), surfaces, tolerance)
    return _first_collision(tree, joint, contacts, end, tolerance)


def sweep_path(
    obj: ArticulatedObject,
    values: Sequence[Mapping[str, float]],
    *,
    pairs: Collection[frozenset[str]] | None = None,
    tolerance: float | None = None,
    points: int = POINTS,
) -> PathSweep:
    """Move several joints at once and find which links penetrate each other.

    Args:
        values: (K,) joint values in small steps; the first must be rest. Missing joints are at 0.
        pairs: of links to check; all that move against each other by default.
        tolerance, points: as in :func:`sweep_joint`.

    Raises:
        KinematicsError: for an unknown joint.
    """
    surfaces = surfaces_of(obj, points)
    scale = sweep_tolerance(surfaces) if tolerance is None else tolerance or 1e-9
    path = JointPath(np.arange(len(values), dtype=np.float64), tree_poses(obj.tree, values))
    found = _Deepest(len(values))
    for contact in contacts_along(path, surfaces, scale, pairs):
        found.add(contact, path.poses, path.q, np.arange(len(values)))
    return PathSweep(found.depth, found.where, tuple(found.pairs), scale)


def surfaces_of(obj: ArticulatedObject, points: int = POINTS) -> dict[str, Surface]:
    """Return link → surface of its part, without parts that have no geometry."""
    found = {p.link: surface_of(p, points) for p in obj.parts}
    return {link: s for link, s in found.items() if s is not None}


def diagonal_of(surfaces: Mapping[str, Surface]) -> float:
    """Diagonal of the box around all surfaces in metres."""
    each = np.stack([s.bounds for s in surfaces.values()])
    return float(np.linalg.norm(each[:, 1].max(0) - each[:, 0].min(0)))


def sweep_tolerance(surfaces: Mapping[str, Surface]) -> float:
    """Return :data:`TOLERANCE` of the diagonal in metres, or a cloud's spacing if more."""
    if not surfaces:
        return 1e-9
    finest = max(s.resolution for s in surfaces.values())
    return max(TOLERANCE * diagonal_of(surfaces), finest, 1e-9)


class _Deepest:
    """The deepest contact at each of ``count`` poses."""

    def __init__(self, count: int) -> None:
        self.depth, self.where = np.zeros(count), np.full((count, 3), np.nan)
        self.pairs: list[tuple[str, str] | None] = [None] * count

    def add(
        self, contact: LinkContact, poses: Poses, q: FloatArray, index: npt.NDArray[np.int64]
    ) -> None:
        """Update the depths at (K,) ``index`` by those of a contact at (K,) ``q``."""
        depth, point = contact.depth(poses, q)
        for k in np.flatnonzero(depth > self.depth[index]):
            i = int(index[k])
            self.depth[i], self.pairs[i] = depth[k], (contact.moving, contact.still)
            self.where[i] = contact.place(poses, int(k), int(point[k]))


def _tree_with(obj: ArticulatedObject, joint: str | Joint) -> tuple[KinematicTree, Joint]:
    tree = obj.tree
    if isinstance(joint, Joint):
        tree = tree.with_joint(joint)
    elif joint not in tree.by_name:
        known = ", ".join(tree.by_name) or "none"
        raise KinematicsError([f"no joint {joint!r}; known are {known}"])
    else:
        joint = tree.by_name[joint]
    if not joint.moves:
        raise KinematicsError([f"joint {joint.name!r} is fixed; only a moving joint can be swept"])
    return tree, joint


def _steps(joint: Joint, end: float) -> FloatArray:
    count = math.ceil(abs(end) / CHORD) if joint.rotates else SLIDE_STEPS
    return np.linspace(0.0, end, max(count, 1) + 1)


def _joint_path(tree: KinematicTree, joint: Joint, end: float) -> JointPath:
    """The joint's path from rest to ``end``."""
    q = _steps(joint, end)
    straight = not joint.rotates and not has_mimics(tree, joint)
    return JointPath(q, joint_poses(tree, joint, q), straight)


def _first_collision(
    tree: KinematicTree, joint: Joint, contacts: list[LinkContact], end: float, tolerance: float
) -> float:
    """Joint value at the first contact that later penetrates beyond the tolerance, or ``end``."""
    if not contacts:
        return end
    q = _steps(joint, end)
    fine = np.unique(np.concatenate([np.interp(np.linspace(0, 1, FINE), [0, 1], [0, end]), q]))
    fine = fine if end > 0 else fine[::-1]
    poses = joint_poses(tree, joint, fine)
    first = min(contact.onset(poses, fine, tolerance) for contact in contacts)
    return math.copysign(min(first, abs(end)), end)
