"""Overlap resolution: cut collision bodies of parts that move against each other.

A drawer fits its cabinet without a gap, a pin its hole: bodies that overlap at rest push each other
away in a simulator and jam the joint. Where two overlap, a plane between them cuts one or both,
whichever loses the least volume.

The same is done along the path from rest to the joint's limits, in steps that are small at both
ends: vertices near a hinge graze the frame as soon as a door moves, and joints rest at their
limits. Deeper overlaps are cut only where the parts themselves don't collide (a tube in a tube,
decomposed coarsely), the deepest first; bodies that can't be cut there are removed. Elsewhere they
stay: they are collisions for the user to fix, by the range or by :attr:`Joint.give_way`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import combinations

import numpy as np
import numpy.typing as npt

from model.core.joint import Joint
from model.core.shapes import Hull, clipped, simplified
from model.core.tree import KinematicTree
from model.kinematics.sweep import joint_poses
from model.physics.collision.narrow_phase import (
    Bodies,
    BodyOverlap,
    Overlap,
    PosePath,
    overlap,
    overlaps,
)

GAP = 2e-4
"""Gap between bodies after a cut, in the object's diagonal."""
CLOSE = 0.5
"""Gaps below this share of :data:`GAP` are cut, too: CAD parts share faces exactly, where a
simulator's friction would hold them."""
GRAZE = 0.01
"""Deepest overlap along the range that is always cut, in the diagonal."""
FIRST_STEP, WIDENING, LONGEST_STEP = 2e-4, 1.05, 1e-3
"""Travel of the fastest point between two poses, in the diagonal: the first, the growth of the
others and the longest. Handles pass each other within a few millimetres."""
MOST_STEPS = 1000
ROUNDS = 4
MOST_CORNERS, CORNERS = 128, 64
"""A cut body with more vertices than the first is simplified to the second: hundreds of tangential
cuts round what turns, and each hull costs more. The final shapes have fewer."""
LEAST = 0.3
"""Smallest share of a body's volume that a cut may leave."""

FloatArray = npt.NDArray[np.float64]
FreeRange = Callable[[Joint], tuple[float, float]]
"""Joint → the joint values, about 0, between which its parts don't collide."""


def moving_pairs(tree: KinematicTree) -> list[tuple[str, str]]:
    """Pairs of links that can move against each other."""
    group: dict[str, str] = {tree.root: tree.root}
    for link in tree.order[1:]:
        joint = tree.joint_of[link]
        group[link] = link if joint.moves else group[joint.parent]
    return [(a, b) for a, b in combinations(tree.order, 2) if group[a] != group[b]]


def poses_over_range(
    tree: KinematicTree, samples: int
) -> Iterator[tuple[Joint, float, Mapping[str, FloatArray]]]:
    """Move each joint that mimics none alone: (joint, q, poses), without the rest pose."""
    for joint in tree.joints:
        if not joint.moves or joint.mimic is not None:
            continue
        for q in np.linspace(*joint.motion_range, samples):
            if abs(q) > 1e-9:
                yield joint, float(q), tree.pose({joint.name: float(q)})


def _steps(travel: float) -> FloatArray:
    """Shares of a path of ``travel`` diagonals, dense at both ends."""
    step = FIRST_STEP * WIDENING ** np.arange(MOST_STEPS)
    path = np.cumsum(np.minimum(step, max(LONGEST_STEP, travel / MOST_STEPS)))
    half = path[path < travel / 2]
    return np.concatenate([half, [travel / 2], travel - half[::-1], [travel]]) / travel


def _travel(bodies: Bodies, joint: Joint, moved: frozenset[str]) -> float:
    """Metres that the outermost vertex moves per unit of the joint."""
    at = [h.vertices for link in moved for h in bodies.get(link, ())]
    if not joint.rotates or not at:
        return 1.0
    arm = np.concatenate(at) - joint.origin
    return float(np.linalg.norm(np.cross(arm, joint.axis), axis=1).max())


def _to_cut(
    bodies: Bodies,
    tree: KinematicTree,
    pairs: list[tuple[str, str]],
    diagonal: float,
    free: FreeRange,
) -> Iterator[tuple[list[BodyOverlap], bool, Joint]]:
    """Find overlaps while each joint that mimics none moves alone from rest to either limit.

    Yields overlaps, whether they are cut at any depth, and the joint: first all overlaps where the
    parts are free, twice, as cuts may leave some; then, pose by pose, those that stay shallower
    than :data:`GRAZE`. The caller may cut bodies, and remove them after the first kind.
    """
    most = GRAZE * diagonal
    for joint in tree.joints:
        if not joint.moves or joint.mimic is not None:
            continue
        for end in joint.motion_range:
            known: _Paths = {}
            q, found = _along_path(bodies, tree, joint, end, pairs, diagonal, known)
            for _ in range(2):
                if max((t.depth for each in found for t in each), default=0.0) <= most:
                    break
                low, high = free(joint)
                before = {link: list(hulls) for link, hulls in bodies.items()}
                yield (
                    [t for v, each in zip(q, found, strict=True) if low <= v <= high for t in each],
                    True,
                    joint,
                )
                if bodies == before:  # compares bodies by identity
                    break
                q, found = _along_path(bodies, tree, joint, end, pairs, diagonal, known)
            for shallow in _shallow(found, most):
                yield shallow, False, joint


_Paths = dict[float, tuple[FloatArray, Mapping[str, FloatArray], PosePath]]
"""Travel in diagonals → joint values, poses, and the path with its cached depths."""


def _along_path(
    bodies: Bodies,
    tree: KinematicTree,
    joint: Joint,
    end: float,
    pairs: list[tuple[str, str]],
    diagonal: float,
    known: _Paths,
) -> tuple[FloatArray, list[list[BodyOverlap]]]:
    """Joint values from rest to ``end``, and the overlaps at each."""
    moved = frozenset(tree.descendants(joint.child))
    across = [(a, b) for a, b in pairs if (a in moved) != (b in moved)]
    travel = abs(end) * _travel(bodies, joint, moved) / diagonal
    if travel < FIRST_STEP:
        return np.zeros(0), []
    if travel not in known:
        q = end * _steps(travel)
        poses = joint_poses(tree, joint, q)
        known[travel] = q, poses, PosePath(poses, len(q))
    q, poses, path = known[travel]
    close = CLOSE * GAP * diagonal
    near = _near_pairs(bodies, across, poses, close)
    if not near:
        return np.zeros(0), []
    return q, path.overlaps(bodies, near, -close)


def _near_pairs(
    bodies: Bodies, pairs: list[tuple[str, str]], poses: Mapping[str, FloatArray], close: float
) -> list[tuple[str, str]]:
    """Pairs of links whose boxes over all poses are closer than ``close`` metres."""
    boxes: dict[str, FloatArray] = {}
    for link in {k for pair in pairs for k in pair if bodies.get(k)}:
        each = np.stack([h.bounds for h in bodies[link]])
        box = np.stack([each[:, 0].min(axis=0), each[:, 1].max(axis=0)])
        if link in poses:
            corners = np.array(np.meshgrid(*box.T)).reshape(3, -1).T
            at = np.einsum("sij,cj->sci", poses[link][:, :3, :3], corners)
            at = (at + poses[link][:, None, :3, 3]).reshape(-1, 3)
            box = np.stack([at.min(axis=0), at.max(axis=0)])
        boxes[link] = box
    return [
        (a, b)
        for a, b in pairs
        if a in boxes
        and b in boxes
        and (boxes[a][0] - boxes[b][1] < close).all()
        and (boxes[b][0] - boxes[a][1] < close).all()
    ]


def _shallow(found: list[list[BodyOverlap]], most: float) -> list[list[BodyOverlap]]:
    """Drop the overlaps of bodies that get deeper than ``most`` while they stay in contact."""
    out: list[list[BodyOverlap]] = [[] for _ in found]
    runs: dict[tuple[str, str, int, int], list[tuple[int, BodyOverlap]]] = {}

    def end(run: list[tuple[int, BodyOverlap]]) -> None:
        if max(t.depth for _, t in run) <= most:
            for k, contact in run:
                out[k].append(contact)

    for k, overlapping in enumerate(found):
        now = {(t.a, t.b, t.i, t.j): t for t in overlapping}
        for key in runs.keys() - now.keys():
            end(runs.pop(key))
        for key, contact in now.items():
            runs.setdefault(key, []).append((k, contact))
    for run in runs.values():
        end(run)
    return out


def resolve_overlaps(
    bodies: Bodies,
    tree: KinematicTree,
    diagonal: float,
    free: FreeRange,
    kept: frozenset[str] = frozenset(),
) -> Bodies:
    """Cut bodies that overlap at rest, where the parts are free, or by less than :data:`GRAZE`.

    Bodies inside of another one are removed; those that can't be cut stay.

    Args:
        free: range of a joint in which its parts don't collide.
        kept: links whose bodies are cut only by joints with :attr:`Joint.give_way`.
    """
    bodies = {link: list(hulls) for link, hulls in bodies.items()}
    pairs = moving_pairs(tree)
    gap = GAP * diagonal
    rest = tree.pose({})
    for _ in range(ROUNDS):
        found = overlaps(bodies, pairs, rest, -CLOSE * gap)
        if not _cut_all(bodies, found, gap, np.inf, kept=kept):
            break
    for found, deep, joint in _to_cut(bodies, tree, pairs, diagonal, free):
        whole = frozenset() if joint.give_way else kept
        if deep:
            _cut_all(bodies, found, gap, np.inf, 0.0, whole)
        else:
            _cut_all(bodies, found, gap, GRAZE * diagonal, kept=whole)
    return bodies


def overlapping_bodies(
    bodies: Bodies, tree: KinematicTree, diagonal: float, free: FreeRange
) -> set[tuple[str, int]]:
    """Bodies (link, index) that overlap where :func:`resolve_overlaps` would cut them."""
    pairs = moving_pairs(tree)
    found = overlaps(bodies, pairs, tree.pose({}), -CLOSE * GAP * diagonal)
    for overlapping, _, _ in _to_cut(bodies, tree, pairs, diagonal, free):
        found += overlapping
    return {one for t in found for one in ((t.a, t.i), (t.b, t.j))}


def _cut_all(
    bodies: Bodies,
    found: list[BodyOverlap],
    gap: float,
    most: float,
    least: float = LEAST,
    kept: frozenset[str] = frozenset(),
) -> bool:
    """Cut in place, the deepest overlap first; return whether anything was cut.

    Args:
        most: deepest overlap that is cut, metres. least: share of a body that must be left.
        kept: links whose bodies aren't cut.
    """
    changed = False
    gone: set[tuple[str, int]] = set()
    for touch in sorted(found, key=lambda t: -t.depth):
        whole = (touch.a in kept, touch.b in kept)
        if all(whole) or {(touch.a, touch.i), (touch.b, touch.j)} & gone:
            continue
        a, b = bodies[touch.a][touch.i], bodies[touch.b][touch.j].moved(touch.a_from_b)
        now = overlap(a, b, -CLOSE * gap)
        if now is None or now.depth > most:
            continue
        answer = _cut(a, b, now, gap, least, whole)
        if answer is None or (None in answer and np.isfinite(most)):  # dropped at rest alone
            continue
        changed = True
        back = np.linalg.inv(touch.a_from_b).astype(np.float64)
        for link, i, made, was in (
            (touch.a, touch.i, answer[0], a),
            (touch.b, touch.j, answer[1], b),
        ):
            if made is None:
                gone.add((link, i))
            elif made is not was:  # what wasn't cut stays the same object
                few = made if len(made.vertices) <= MOST_CORNERS else simplified(made, CORNERS)
                bodies[link][i] = few if link == touch.a else few.moved(back)
    for link in {link for link, _ in gone}:
        lost = {i for name, i in gone if name == link}
        bodies[link] = [h for i, h in enumerate(bodies[link]) if i not in lost]
    return changed


def _cut(
    a: Hull, b: Hull, found: Overlap, gap: float, least: float, whole: tuple[bool, bool]
) -> tuple[Hull | None, Hull | None] | None:
    """Both bodies after the cut that loses least, None for a removed one; None without a cut.

    Args:
        whole: of each, whether it stays as it is. Nothing is removed for it then, since a hull may
            represent a hollow mesh.
    """
    best: tuple[float, Hull | None, Hull | None] | None = None
    for share in (1.0,) if whole[0] else (0.0,) if whole[1] else (0.0, 0.5, 1.0):
        at = found.begin + share * (found.end - found.begin)
        # A body that stays whole keeps its face: all of the gap is taken from the other.
        mine = a if whole[0] else clipped(a, found.axis, at - gap * (1 - share))
        other = b if whole[1] else clipped(b, -found.axis, -(at + gap * share))
        left = (_left(mine, a), _left(other, b))
        if any(whole) and not min(left) > 0:
            continue
        if min(left) >= least and (best is None or 2 - sum(left) < best[0]):
            best = (2 - sum(left), mine, other)
    if best is not None:
        return best[1:]
    # Most of the smaller one is inside the larger one: nothing else can touch it there.
    small, large = (a, b) if a.volume < b.volume else (b, a)
    if any(whole) or (
        large.contains(small.vertices).mean() < 0.5
        and not large.contains(small.vertices.mean(axis=0)[None]).all()
    ):
        return None
    return (None, b) if small is a else (a, None)


def _left(now: Hull | None, before: Hull) -> float:
    return 0.0 if now is None else now.volume / before.volume
