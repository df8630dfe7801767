"""Motion sweeps: where a moving part runs into the others.

Penetration is measured beyond what is there at rest; see ``crossing`` for what counts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from model.errors import KinematicsError
from model.kinematics.articulated_object import ArticulatedObject
from model.kinematics.crossing import Crossings, Path, crossings, inverse, moved
from model.kinematics.joint import Joint, motion
from model.kinematics.surface import POINTS, Surface, surface_of
from model.kinematics.tree import KinematicTree

TOLERANCE = 0.005
"""Penetration that is no collision yet, in the object's diagonal."""
CHORD = math.radians(6.0)
"""Longest arc between two poses of the sweep."""

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sweep:
    """Penetration of a joint's subtree into the other parts.

    Attributes:
        joint: its name.
        q: (S,) joint values in radians or metres, ascending.
        depth: (S,) metres beyond the penetration at rest; 0 where nothing is touched.
        where: (S, 3) the deepest point at that pose, object frame; NaN where nothing is touched.
        others: (S,) link that is penetrated, or None.
        tolerance: metres that the surfaces' noise may cause.
    """

    joint: str
    q: FloatArray
    depth: FloatArray
    where: FloatArray
    others: tuple[str | None, ...]
    tolerance: float

    @property
    def collides(self) -> npt.NDArray[np.bool_]:
        """(S,) whether the depth is beyond the tolerance."""
        return self.depth > self.tolerance


@dataclass(frozen=True, eq=False)
class _Contact:
    """Crossings between two links in one direction of a joint; ``forward`` tells whose points."""

    moving: str
    still: str
    forward: bool
    found: Crossings


def sweep_joint(
    obj: ArticulatedObject,
    joint: str | Joint,
    samples: int = 33,
    *,
    tolerance: float | None = None,
    points: int = POINTS,
) -> Sweep:
    """Move a joint through its range, the others at rest, and see what its subtree runs into.

    Args:
        joint: a name, or a joint that takes the place of its child's joint.
        samples: number of joint values; a continuous joint is swept from -π to π.
        tolerance: metres; by default :data:`TOLERANCE` of the object's diagonal, and no less than
            the spacing of a cloud's points.
        points: sample points a part.

    Raises:
        KinematicsError: for a joint that isn't there or doesn't move.
    """
    tree, moving = _tree_with(obj, joint)
    lower, upper = (moving.lower, moving.upper) if moving.limited else (-math.pi, math.pi)
    assert lower is not None and upper is not None
    q = np.linspace(lower, upper, samples)
    surfaces = _surfaces(obj, points)
    scale = _tolerance(surfaces, tolerance)
    depth, where = np.zeros(samples), np.full((samples, 3), np.nan)
    others: list[str | None] = [None] * samples
    for end in (min(lower, 0.0), max(upper, 0.0)):
        if end == 0.0:
            continue
        for contact in _contacts(tree, moving, surfaces, end, scale):
            mine = np.flatnonzero((q * end > 0) & (abs(end) >= np.abs(q)))
            _deepen(tree, moving, contact, q, mine, depth, where, others)
    return Sweep(moving.name, q, depth, where, tuple(others), scale)


def free_range(
    obj: ArticulatedObject,
    joint: str | Joint,
    maximum: float | None = None,
    *,
    tolerance: float | None = None,
    points: int = POINTS,
) -> tuple[float, float]:
    """How far a joint moves either way from rest before its subtree runs into another part.

    The joint's own limits play no part. The values are where surfaces first meet that penetrate
    beyond the tolerance later on.

    Args:
        maximum: radians or metres to try each way; π or the object's diagonal by default.

    Returns:
        (lower ≤ 0, upper ≥ 0); ∓maximum where nothing is in the way.

    Raises:
        KinematicsError: as :func:`sweep_joint`.
    """
    tree, moving = _tree_with(obj, joint)
    surfaces = _surfaces(obj, points)
    if maximum is None:
        maximum = math.pi if moving.rotates else _diagonal(surfaces)
    scale = _tolerance(surfaces, tolerance)
    free = [
        _first_collision(tree, moving, _contacts(tree, moving, surfaces, end, scale), end, scale)
        for end in (-maximum, maximum)
    ]
    return min(free[0], 0.0), max(free[1], 0.0)


def _tree_with(obj: ArticulatedObject, joint: str | Joint) -> tuple[KinematicTree, Joint]:
    tree = obj.tree
    if isinstance(joint, Joint):
        tree = tree.with_joint(joint)
    elif joint not in tree.by_name:
        there = ", ".join(tree.by_name) or "none"
        raise KinematicsError([f"no joint {joint!r}; there are {there}"])
    else:
        joint = tree.by_name[joint]
    if not joint.moves:
        raise KinematicsError([f"joint {joint.name!r} is fixed; only a moving joint can be swept"])
    return tree, joint


def _diagonal(surfaces: Mapping[str, Surface]) -> float:
    each = np.stack([s.bounds for s in surfaces.values()])
    return float(np.linalg.norm(each[:, 1].max(0) - each[:, 0].min(0)))


def _tolerance(surfaces: Mapping[str, Surface], tolerance: float | None) -> float:
    if tolerance is not None or not surfaces:
        return tolerance or 1e-9
    finest = max(s.resolution for s in surfaces.values())
    return max(TOLERANCE * _diagonal(surfaces), finest, 1e-9)


def _surfaces(obj: ArticulatedObject, points: int) -> dict[str, Surface]:
    found = {p.link: surface_of(p, points) for p in obj.parts}
    return {link: s for link, s in found.items() if s is not None}


def _followers(tree: KinematicTree, joint: Joint) -> bool:
    return joint.mimic is not None or any(j.mimic is not None for j in tree.joints)


def _steps(joint: Joint, end: float) -> FloatArray:
    count = math.ceil(abs(end) / CHORD) if joint.rotates else 16
    return np.linspace(0.0, end, max(count, 1) + 1)


def _poses(
    tree: KinematicTree, joint: Joint, q: Sequence[float] | FloatArray
) -> dict[str, FloatArray]:
    """Link → (K, 4, 4) ``posed_from_rest`` of the links that ``joint`` moves."""
    if not _followers(tree, joint):
        here = np.stack([motion(joint, float(v)) for v in q])
        return dict.fromkeys(tree.descendants(joint.child), here)
    # Followers move too, and a follower that is dragged by hand leaves its leader alone.
    if joint.mimic is not None:
        tree = tree.with_joint(replace(joint, mimic=None))
    all_ = [tree.pose({joint.name: float(v)}) for v in q]
    stacked = {link: np.stack([p[link] for p in all_]) for link in tree.links}
    return {k: v for k, v in stacked.items() if not np.allclose(v, np.eye(4), atol=1e-12)}


def _contacts(
    tree: KinematicTree, joint: Joint, surfaces: dict[str, Surface], end: float, tolerance: float
) -> list[_Contact]:
    """Crossings of every pair of links that move against each other from rest to ``end``."""
    q = _steps(joint, end)
    poses = _poses(tree, joint, q)
    straight = not joint.rotates and not _followers(tree, joint)
    still = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    out: list[_Contact] = []
    moving = [link for link in poses if link in surfaces]
    for i, a in enumerate(moving):
        for b in [*(link for link in surfaces if link not in poses), *moving[i + 1 :]]:
            b_from_a = inverse(poses.get(b, still)) @ poses[a]
            if np.allclose(b_from_a, b_from_a[0], atol=1e-12):
                continue
            there = Path(q, b_from_a, straight)
            back = Path(q, inverse(b_from_a), straight)
            for part, target, path in ((a, b, there), (b, a, back)):
                found = crossings(surfaces[part], surfaces[target], path, tolerance)
                if len(found.q) > found.outliers:
                    out.append(_Contact(a, b, part == a, found))
    return out


def _relative(poses: dict[str, FloatArray], contact: _Contact, count: int) -> FloatArray:
    """(K, 4, 4) from the points' link to the crossed one."""
    still = np.broadcast_to(np.eye(4), (count, 4, 4))
    a, b = poses.get(contact.moving, still), poses.get(contact.still, still)
    return inverse(b) @ a if contact.forward else inverse(a) @ b


def _deepen(
    tree: KinematicTree,
    joint: Joint,
    contact: _Contact,
    q: FloatArray,
    index: npt.NDArray[np.int64],
    depth: FloatArray,
    where: FloatArray,
    others: list[str | None],
) -> None:
    """Enter a contact's depths at ``q[index]`` where they exceed those found before."""
    poses = _poses(tree, joint, q[index])
    each = contact.found.depth(_relative(poses, contact, len(index)))
    each[np.abs(q[index])[:, None] < np.abs(contact.found.q)] = 0.0
    rank = np.argpartition(-each, contact.found.outliers, axis=1)[:, contact.found.outliers]
    link = contact.moving if contact.forward else contact.still
    for row, i in enumerate(index):
        worst = each[row, rank[row]]
        if worst > depth[i]:
            place = contact.found.points[rank[row]][None]
            object_from_link = poses[link][row : row + 1] if link in poses else np.eye(4)[None]
            depth[i], others[i] = worst, contact.still
            where[i] = moved(object_from_link, place)[0, 0]


def _first_collision(
    tree: KinematicTree, joint: Joint, contacts: list[_Contact], end: float, tolerance: float
) -> float:
    """The joint value where the surfaces meet that penetrate beyond the tolerance first."""
    if not contacts:
        return end
    q = _steps(joint, end)
    fine = np.unique(np.concatenate([np.interp(np.linspace(0, 1, 129), [0, 1], [0, end]), q]))
    fine = fine if end > 0 else fine[::-1]
    poses = _poses(tree, joint, fine)
    first = abs(end)
    for contact in contacts:
        each = contact.found.depth(_relative(poses, contact, len(fine))) > tolerance
        each &= np.abs(fine)[:, None] >= np.abs(contact.found.q)
        beyond = each.any(axis=0)
        if beyond.sum() <= contact.found.outliers:
            continue
        when = np.abs(fine)[each.argmax(axis=0)]
        when[~beyond] = np.inf
        settled = np.partition(when, contact.found.outliers)[contact.found.outliers]
        onsets = np.abs(contact.found.q)[when <= settled]
        rank = min(contact.found.outliers, len(onsets) - 1)
        first = min(first, float(np.partition(onsets, rank)[rank]))
    return math.copysign(first, end)
