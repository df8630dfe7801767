"""Equal parts of an object, as its drawers, knobs and mirrored doors, and how one of them moves
where it moves as another one does.

Parts are equal where the points of one lie on the other after a shift, or after a mirroring in the
direction from one to the other. Points are (N, 3), metres, object frame. The thresholds were chosen
on every second object of PartNet-Mobility and Infinigen; of the others' 724 pairs 714 move alike.
Of 44 pairs of one name in scans there all 36 equal ones are found, and 4 of nearly one size.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from model.core.articulated_object import Part
from model.core.geometry import affine
from model.core.joint import Joint
from model.core.names import words
from model.core.tree import KinematicTree, moved_joint

Float = npt.NDArray[np.float64]

Tolerance = tuple[float, float, float, float]
EXACT, SCANNED, SIMILAR = (0.0, 0.05, 0.04, 0.9), (2.0, 0.1, 0.08, 0.8), (2.0, 0.3, 0.08, 0.8)
"""Percent of the points beyond each side of a part's box; largest difference of the sides of equal
parts and distance to the other's points, in the diagonal; and the share of points within that.
Of clean parts, of scanned ones, and of those that share a confidence."""
ASIDE = 0.3
"""Share of the way from one part to the other in a direction from which they may be mirrored."""
LEAST = 0.02
"""Difference of two fits that counts, in the part's diagonal."""
PARALLEL = math.cos(math.radians(20))
HINGE = 0.2
"""Distance between the lines of two equal hinges, in the part's diagonal."""


def namesakes(a: Part, b: Part) -> bool:
    """True if two parts may be equal by their names, numbers aside: a drawer's front is no door."""
    return words(a.name) == words(b.name) or not (a.name and b.name)


def images(a: Float, b: Float, within: Tolerance = EXACT) -> Iterator[Float]:
    """Yield the (4, 4) maps that lay part ``a`` over ``b``, where these are equally large: a shift,
    then the mirrorings."""
    outside, extent, *_ = within
    one, other = (np.percentile(p, (outside, 100 - outside), axis=0) for p in (a, b))
    sides, size = np.ptp(one, axis=0) - np.ptp(other, axis=0), np.ptp(other, axis=0)
    if np.abs(sides).max() > extent * np.linalg.norm(size):
        return
    here, there = one.mean(0), other.mean(0)
    step = there - here
    far = float(np.linalg.norm(step))
    level = np.array([step[0], step[1], 0.0])
    normals = [np.eye(3)[k] for k in range(3) if abs(step[k]) > ASIDE * far]
    if min(abs(level[:2])) > ASIDE * far:  # their object faces between two axes
        normals.append(level / np.linalg.norm(level))
    for turn in (np.eye(3), *(np.eye(3) - 2 * np.outer(n, n) for n in normals)):
        yield affine(turn, there - turn @ here)


def fitting(a: Float, b: Float, within: Tolerance = EXACT) -> list[Float]:
    """Return those of :func:`images` after which the points of ``a`` lie on ``b``, best first: by
    the few points that lie farthest, as handles are small. Of equally good ones the shift is first;
    the list is empty where the parts aren't equal."""
    size, tree = float(np.linalg.norm(np.ptp(b, axis=0))), KDTree(b)
    *_, near, covered = within
    found: list[tuple[int, Float]] = []
    for image in images(a, b, within):
        off = np.sort(tree.query(a @ image[:3, :3].T + image[:3, 3])[0]) / size
        if (off < near).mean() > covered:
            found.append((round(float(off[-max(len(off) // 100, 1) :].mean()) / LEAST), image))
    return [image for _, image in sorted(found, key=lambda f: f[0])]


def carried(joint: Joint, own: Joint, image: Float) -> Joint:
    """Return ``joint`` after the (4, 4) map to another part, in place of that part's ``own``."""
    there = moved_joint(joint, image)
    return replace(there, name=own.name, child=own.child, parent=own.parent)


def alike(a: Joint, b: Joint, size: float) -> bool:
    """True if two joints move one part of ``size`` (metres) alike, whatever their ranges."""
    if a.type != b.type and not (a.rotates and b.rotates):
        return False
    if not a.moves:
        return True
    cosine = float(np.dot(a.axis, b.axis))
    if abs(cosine) < PARALLEL or cosine * _way(a) * _way(b) < 0:
        return False
    apart = np.cross(np.subtract(a.origin, b.origin), b.axis)
    return not a.rotates or float(np.linalg.norm(apart)) < HINGE * size


def _way(joint: Joint) -> float:
    """Sign of the values that a joint moves to; 0 where it moves both ways."""
    lower, upper = joint.motion_range
    return 0.0 if not joint.limited or min(-lower, upper) > 0.3 * upper else np.sign(lower + upper)


def move_alike(joint: Joint, own: Joint, a: Float, b: Float) -> bool:
    """True if part ``b`` moves by ``own`` as ``a`` does by ``joint``; neither shape is compared."""
    size = float(np.linalg.norm(np.ptp(b, axis=0)))
    return any(alike(carried(joint, own, image), own, size) for image in images(a, b))


def share_confidence(
    confidence: Mapping[str, float], tree: KinematicTree, parts: Iterable[Part]
) -> dict[str, float]:
    """Return child link → confidence, 0..1: the highest among parts of one name and similar size
    that move in the same way, since one knob of a row may show more clearly how all move."""
    boxes: dict[str, tuple[Part, Float]] = {}
    for part in parts:  # a few points of a scan lie far off
        points = part.bounds if part.cloud is None else np.float64(part.cloud.points)
        boxes[part.link] = part, np.percentile(points, (SIMILAR[0], 100 - SIMILAR[0]), axis=0)
    joints = [j for j in tree.joints if j.moves and j.child in confidence and j.child in boxes]
    joints.sort(key=lambda j: -confidence[j.child])
    out = dict(confidence)
    for rank, own in enumerate(joints):
        part, box = boxes[own.child]
        size = float(np.linalg.norm(np.ptp(box, axis=0)))
        for other in joints[:rank]:  # those of a higher confidence
            sibling, there = boxes[other.child]
            if own.type == other.type and namesakes(part, sibling):
                shift = next(images(there, box, SIMILAR), None)
                if shift is not None and alike(carried(other, own, shift), own, size):
                    out[own.child] = confidence[other.child]
                    break
    return out
