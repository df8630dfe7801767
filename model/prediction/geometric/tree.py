"""The kinematic tree from geometry: the base, the parent of each part, serial chains.

Serial chains are slender parts, as in a desk lamp, with the plane in which they move.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.core.names import base_score, mechanism_of, words
from model.core.progress import attempt
from model.prediction.geometric.context import UP, Assembly, snapped, unit
from model.prediction.geometric.sampled_object import CONTACT_GAP, SampledObject
from model.prediction.geometric.shape import blades, same_extents

Array = npt.NDArray[np.float64]

LEAF = 0.3
"""Largest thickness of a door leaf over its smaller side."""


def rooted_tree(
    sampled: SampledObject, locked: Mapping[int, int], faults: list[str]
) -> tuple[int, list[int]]:
    """The root, and the parent of each part, -1 for the root.

    Args:
        locked: part → the parent that it keeps, -1 for one that is no part.
        faults: gets remarks on rules that failed.
    """
    count = len(sampled)
    sizes = np.array([s.size for s in sampled.shapes])
    scores = attempt(faults, "the rules on the base", lambda: root_scores(sampled), sizes)
    free = [i for i in range(count) if i not in locked] or list(range(count))
    root = max(free, key=lambda i: (scores[i], -i))
    all_on_root = [-1 if i == root else root for i in range(count)]
    parent = attempt(
        faults, "the rules on parents", lambda: spanning_parents(sampled, root), all_on_root
    )
    for part, above in locked.items():
        if above >= 0:
            parent[part] = above
    _break_cycles(parent, root, locked)
    return root, parent


def _break_cycles(parent: list[int], root: int, locked: Mapping[int, int]) -> None:
    """Attach parts that locked joints cut off to the root."""
    for i in range(len(parent)):
        path: list[int] = []
        at = i
        while at != root and at >= 0 and at not in path:
            path.append(at)
            at = parent[at]
        if at != root:
            loose = next((k for k in path if k not in locked), None)
            if loose is not None:
                parent[loose] = root


def root_scores(sampled: SampledObject) -> Array:
    """(P,) score of each part as the base: name first, then size, contacts and low position."""
    n = len(sampled)
    shapes = sampled.shapes
    size = np.array([s.size for s in shapes])
    volume = np.array([s.box.volume for s in shapes])
    touches = (sampled.gap < CONTACT_GAP) & ~np.eye(n, dtype=bool)
    # Neighbours count by their size, so that many small ones (keys on a door) count little.
    heft = np.minimum(1.0, (size / 0.06) ** 2)
    touching = 0.5 * (touches @ size) / max(size.sum(), 1e-9)
    touching += 0.5 * (touches @ heft) / max(heft.sum(), 1e-9)
    low = np.array([s.low[2] for s in shapes]) - sampled.low[2]
    height = max(float(sampled.high[2] - sampled.low[2]), 1e-6)
    named = np.array([base_score(s.name, sampled.category) for s in shapes])
    area = np.array([s.area for s in shapes])
    out = 1.2 * size / max(size.max(), 1e-9)
    out += 0.8 * (volume / max(volume.max(), 1e-12)) ** (1 / 3)
    out += 0.5 * np.sqrt(area / max(area.max(), 1e-12))
    out += 1.0 * touching
    out += 0.8 * (1 - np.clip(low / height, 0, 1))
    # The base stands on the ground; so do wheels, but they are small.
    grounded = (low < 0.02) & (size > 0.3 * size.max())
    out += 0.9 * grounded
    out += 1.5 * named
    # Balls and propellers carry nothing.
    for i, s in enumerate(shapes):
        if size[i] > 0.3 and low[i] > 0.06 and (s.ball or blades(s) is not None):
            out[i] -= 1.5
    return out


def spanning_parents(sampled: SampledObject, root: int) -> list[int]:
    """Parent of each part, -1 for the root.

    The parent is the root if the two are in contact, else the part through which the root is
    reached over the smallest gaps. A part with far more contact to another part than to the root
    (a wheel in its fork, a knob on a door) has that one as its parent.
    """
    n = len(sampled)
    gap = sampled.gap
    parent = [-1] * n
    placed = {root}
    # A scan hides much of the root, so that distances mean less.
    detour = 0.06 if sampled.scanned else 0.012
    held = {i: _holder(sampled, root, i) for i in range(n) if i != root}
    while len(placed) < n:
        best: tuple[float, float, int, int] | None = None
        for i in range(n):
            if i in placed:
                continue
            for j in placed:
                cost = max(0.0, gap[i, j] - CONTACT_GAP / 2 - 3 * sampled.noise)
                cost += 0.0 if j == root else detour + 0.015 * _small(sampled, j, i)
                key = (cost, gap[i, j], i, j)
                if best is None or key < best:
                    best = key
        assert best is not None
        parent[best[2]] = best[3]
        placed.add(best[2])
    for i, j in held.items():
        # Of two parts that would carry each other the one nearer to the root is the parent.
        mutual = j is not None and held.get(j) == i
        if mutual and (gap[i, root], i) < (gap[j, root], j):
            continue
        if j is not None and (mutual or held.get(j) is None) and not is_below(parent, j, i):
            parent[i] = j
    return _leaves_apart(sampled, root, parent)


def _leaves_apart(sampled: SampledObject, root: int, parent: list[int]) -> list[int]:
    """Give adjacent leaves of one front the parent of the first."""
    out = list(parent)
    for i in sorted(range(len(out)), key=lambda i: len(_above(parent, i))):
        j = out[i]
        if j in (-1, root) or not _side_by_side(sampled, i, j):
            continue
        # The second leaf of a folding door is far from the parent of the first.
        holder = out[j]
        gap = sampled.gap[i, holder]
        if gap < 2 * CONTACT_GAP or gap < sampled.gap[j, holder] + CONTACT_GAP:
            out[i] = holder
    return out


def _side_by_side(sampled: SampledObject, i: int, j: int) -> bool:
    """True if two leaves lie in one plane and share an edge."""
    if not (_leaf(sampled, i) and _leaf(sampled, j)):
        return False
    a, b = sampled.shapes[i], sampled.shapes[j]
    k = a.panel.normal
    if abs(float(a.box.axes[:, k] @ b.box.axes[:, b.panel.normal])) < 0.97:
        return False
    offset = a.box.axes.T @ (b.center - a.center)
    reach = np.array([b.box.reach(axis) for axis in a.box.axes.T])
    apart = np.abs(offset) - a.box.half - reach
    lies = abs(offset[k]) < max(a.box.half[k], reach[k]) + CONTACT_GAP
    # They overlap along the shared edge and are adjacent across it.
    u, v = (x for x in range(3) if x != k)
    along, across = (u, v) if apart[u] < apart[v] else (v, u)
    shared = -apart[along] >= 0.5 * 2 * min(a.box.half[along], reach[along])
    return bool(lies and shared and -0.1 * a.box.half[across] < apart[across] < 2 * CONTACT_GAP)


def _leaf(sampled: SampledObject, i: int) -> bool:
    """True if a part is a flat panel without a name or with that of a door."""
    shape = sampled.shapes[i]
    if words(shape.name) and mechanism_of(shape.name, sampled.category)[0] != "hinge":
        return False
    panel = shape.panel
    sides = np.delete(2 * shape.box.half, panel.normal)
    return bool(panel.high - panel.low < LEAF * sides.min())


def _holder(sampled: SampledObject, root: int, i: int) -> int | None:
    """The part with which ``i`` has far more contact than with the root."""
    shape = sampled.shapes[i]

    def share(j: int) -> float:
        return float((sampled.distances(i, j) < CONTACT_GAP).mean())

    near = [
        j
        for j in sampled.others(i)
        if j != root
        and sampled.gap[i, j] < CONTACT_GAP / 2
        and sampled.shapes[j].size > 0.6 * shape.size
        and not same_extents(shape, sampled.shapes[j], 0.2, 0.001)
        and not _both_slender(sampled, root, i, j)
    ]
    if not near:
        return None
    best = max(near, key=lambda j: (share(j), -j))
    mine, roots = share(best), share(root)
    if shape.scanned:
        # A scan lacks the surface behind a part: the other part must surround this one.
        inside = (shape.points > sampled.shapes[best].low) & (
            shape.points < sampled.shapes[best].high
        )
        return best if mine > 0.5 and roots < 0.1 and inside.all(1).mean() > 0.5 else None
    return best if mine > 0.15 + 2.0 * roots else None


def _both_slender(sampled: SampledObject, root: int, i: int, j: int) -> bool:
    """True if both are slender and at the root, as clock hands: neither carries the other."""
    slender = max(sampled.shapes[i].slenderness, sampled.shapes[j].slenderness) < 0.3
    return slender and bool(max(sampled.gap[i, root], sampled.gap[j, root]) < 2 * CONTACT_GAP)


def _small(sampled: SampledObject, holder: int, held: int) -> float:
    """1 if the holder is smaller than the part that it would carry."""
    return float(sampled.shapes[holder].size < 0.8 * sampled.shapes[held].size)


def _above(parent: list[int], link: int) -> list[int]:
    """The ancestors of ``link``, nearest first."""
    out = []
    while parent[link] >= 0 and len(out) < len(parent):
        link = parent[link]
        out.append(link)
    return out


def is_below(parent: list[int], link: int, top: int) -> bool:
    """True if ``link`` is ``top`` or a descendant of it."""
    while link >= 0:
        if link == top:
            return True
        link = parent[link]
    return False


SLENDER = 0.4
"""Middle over long extent up to which a part can be a member of a chain."""
BENT = 0.2
"""Sine of the angle between two members, or a member and gravity, from which they span a plane."""
LYING = 0.97
"""Sine of the angle to gravity from which a member is level and may also turn about a vertical
axis."""
FLAT = 0.2
"""Sine of the largest angle between a member and the plane of its chain."""


@dataclass(frozen=True, eq=False)
class ChainPlane:
    """The plane of a chain; its members turn about the normal.

    Attributes:
        normal: (3,) unit, working frame.
        certainty: 0..1; 1 if the members span an upright plane, less if they span another one or
            only one direction together with gravity.
    """

    normal: Array
    certainty: float


def is_slender(assembly: Assembly, part: int) -> bool:
    """True if a part is long and thin."""
    return assembly.sampled.shapes[part].slenderness <= SLENDER


def chain_plane(assembly: Assembly, part: int) -> ChainPlane | None:
    """The plane of the chain that a part or its parent belongs to; None if there is none.

    Neighbours in a chain have parallel axes, so members at an angle to each other span the plane
    of motion. For members in one oblique line it is the vertical plane through them.
    """
    directions = np.array([_long(assembly, k) for k in chain_of(assembly, part)])
    if not len(directions):
        return None
    alone = np.linalg.svd(directions)
    spread = alone.S / np.sqrt(len(directions))
    if len(directions) > 1 and spread[1] > BENT / 2:
        normal = snapped(unit(alone.Vh[2]), np.eye(3), 0.15)
        if np.abs(directions @ normal).max() > FLAT:
            return None  # several joint directions
        return ChainPlane(normal, 1.0 if abs(float(normal @ UP)) < FLAT else 0.7)
    along = unit(alone.Vh[0])
    lean = float(np.linalg.norm(np.cross(along, UP)))
    if not BENT < lean < LYING:
        return None
    return ChainPlane(snapped(unit(np.cross(along, UP)), np.eye(3), 0.15), 0.5)


def chain_of(assembly: Assembly, part: int) -> list[int]:
    """Members of the chain of a part (of its parent, if the part isn't slender).

    A chain ends at a part that carries several slender parts, such as the legs of a tripod.
    """
    parent = assembly.parent
    start = part if is_slender(assembly, part) else parent[part]
    if start < 0 or not is_slender(assembly, start):
        return []
    chain, at = [start], parent[start]
    while (
        at >= 0
        and at not in chain
        and is_slender(assembly, at)
        and len(_slender_children(assembly, at)) < 2
    ):
        chain.append(at)
        at = parent[at]
    below = _slender_children(assembly, start)
    while len(below) == 1 and below[0] not in chain:
        chain.append(below[0])
        below = _slender_children(assembly, below[0])
    return chain


def _slender_children(assembly: Assembly, part: int) -> list[int]:
    return [
        k for k, above in enumerate(assembly.parent) if above == part and is_slender(assembly, k)
    ]


def _long(assembly: Assembly, part: int) -> Array:
    shape = assembly.sampled.shapes[part]
    return shape.box.axes[:, shape.order[2]]
