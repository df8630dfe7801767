"""Which part is the base, and which part hangs on which."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.core.motion_lexicon import CATEGORY_PARENTS
from model.core.part_names import base_score, category_key, known_word, mechanism_of, words
from model.prediction.geometric.assembly import TOUCHING, Scene
from model.prediction.geometric.shape import blades

Array = npt.NDArray[np.float64]

LEAF = 0.3
"""Thickness of a leaf, at most, in its smaller side."""


def root_scores(scene: Scene) -> Array:
    """(P,) how much each part looks like the base: names first, then size, contacts, lowness."""
    n = len(scene)
    shapes = scene.shapes
    size = np.array([s.size for s in shapes])
    volume = np.array([s.box.volume for s in shapes])
    touches = (scene.gap < TOUCHING) & ~np.eye(n, dtype=bool)
    # Large neighbours count by their size; of small ones (keys on a door) many count little.
    heft = np.minimum(1.0, (size / 0.06) ** 2)
    touching = 0.5 * (touches @ size) / max(size.sum(), 1e-9)
    touching += 0.5 * (touches @ heft) / max(heft.sum(), 1e-9)
    low = np.array([s.low[2] for s in shapes]) - scene.low[2]
    height = max(float(scene.high[2] - scene.low[2]), 1e-6)
    named = np.array([base_score(s.name, scene.category) for s in shapes])
    area = np.array([s.area for s in shapes])
    out = 1.2 * size / max(size.max(), 1e-9)
    out += 0.8 * (volume / max(volume.max(), 1e-12)) ** (1 / 3)
    out += 0.5 * np.sqrt(area / max(area.max(), 1e-12))
    out += 1.0 * touching
    out += 0.8 * (1 - np.clip(low / height, 0, 1))
    # What stands on the ground holds the rest; wheels do too, but they are small.
    grounded = (low < 0.02) & (size > 0.3 * size.max())
    out += 0.9 * grounded
    feet = (low < 0.06) & (size < 0.2) & (low < low.max())
    if feet.sum() >= 3:
        out += 0.9 * (touches @ feet) / feet.sum()  # it stands on its wheels
    out += 1.5 * named
    # Balls and propellers are held; they hold nothing.
    for i, s in enumerate(shapes):
        if size[i] > 0.3 and low[i] > 0.06 and (s.ball or blades(s) is not None):
            out[i] -= 1.5
    for i in np.argsort(-out)[: min(3, n)]:
        out[i] += 1.2 * _encloses(scene, int(i))
    return out


def _encloses(scene: Scene, i: int) -> float:
    """0..1: how far the other parts lie within part ``i``, mean over the larger ones."""
    found = []
    for j in sorted(scene.others(i), key=lambda j: -scene.shapes[j].size)[:6]:
        covers = [scene.cover(j, d, (i,)) for d in (*np.eye(3), *-np.eye(3))]
        found.append(float(np.mean(covers)))
    return float(np.mean(found)) if found else 0.0


def spanning_parents(scene: Scene, root: int) -> list[int]:
    """Parent of each part (-1 for the root).

    A part hangs on the root where the two touch; else on the part that it touches and through
    which the root is reached with the smallest gaps. A part that touches another far more than it
    touches the root (a wheel in its fork, a knob on a door) hangs on that one.
    """
    n = len(scene)
    gap = scene.gap
    parent = [-1] * n
    placed = {root}
    # A scan hides much of the root: being nearer to another part says less there.
    detour = 0.06 if scene.scanned else 0.012
    held = {i: _holder(scene, root, i) for i in range(n) if i != root}
    while len(placed) < n:
        best: tuple[float, float, int, int] | None = None
        for i in range(n):
            if i in placed:
                continue
            for j in placed:
                cost = max(0.0, gap[i, j] - TOUCHING / 2 - 3 * scene.noise)
                cost += 0.0 if j == root else detour + 0.015 * _small(scene, j, i)
                key = (cost, gap[i, j], i, j)
                if best is None or key < best:
                    best = key
        assert best is not None
        parent[best[2]] = best[3]
        placed.add(best[2])
    for i, j in held.items():
        # Of two that hold each other the one nearer to the root holds.
        mutual = j is not None and held.get(j) == i
        if mutual and (gap[i, root], i) < (gap[j, root], j):
            continue
        if j is not None and (mutual or held.get(j) is None) and not _below(parent, j, i):
            parent[i] = j
    return _named_parents(scene, root, _leaves_apart(scene, root, parent))


def _leaves_apart(scene: Scene, root: int, parent: list[int]) -> list[int]:
    """Hang leaves that close one front side by side on what holds the first of them."""
    out = list(parent)
    for i in sorted(range(len(out)), key=lambda i: len(_above(parent, i))):
        j = out[i]
        if j in (-1, root) or not _side_by_side(scene, i, j):
            continue
        # The second leaf of a folding door is far from what holds the first.
        holder = out[j]
        own, others = scene.gap[i, holder], scene.gap[j, holder]
        if own < 2 * TOUCHING or own < others + TOUCHING:
            out[i] = holder
    return out


def _side_by_side(scene: Scene, i: int, j: int) -> bool:
    """Whether two leaves lie in one plane, an edge of one along an edge of the other."""
    if not (_leaf(scene, i) and _leaf(scene, j)):
        return False
    a, b = scene.shapes[i], scene.shapes[j]
    k = a.panel.normal
    if abs(float(a.box.axes[:, k] @ b.box.axes[:, b.panel.normal])) < 0.97:
        return False
    offset = a.box.axes.T @ (b.center - a.center)
    reach = np.array([b.box.reach(axis) for axis in a.box.axes.T])
    apart = np.abs(offset) - a.box.half - reach
    lies = abs(offset[k]) < max(a.box.half[k], reach[k]) + TOUCHING
    # Along one edge they overlap, across it one begins where the other ends.
    u, v = (x for x in range(3) if x != k)
    along, across = (u, v) if apart[u] < apart[v] else (v, u)
    shared = -apart[along] >= 0.5 * 2 * min(a.box.half[along], reach[along])
    return bool(lies and shared and -0.1 * a.box.half[across] < apart[across] < 2 * TOUCHING)


def _leaf(scene: Scene, i: int) -> bool:
    """Whether a part is a flat panel that is called a door or the like, or has no name."""
    shape = scene.shapes[i]
    if words(shape.name) and mechanism_of(shape.name, scene.category)[0] != "hinge":
        return False
    panel = shape.panel
    sides = np.delete(2 * shape.box.half, panel.normal)
    return bool(panel.high - panel.low < LEAF * sides.min())


def _holder(scene: Scene, root: int, i: int) -> int | None:
    """The part that ``i`` touches far more than it touches the root."""
    shape = scene.shapes[i]

    def share(j: int) -> float:
        return float((scene.distances(i, j) < TOUCHING).mean())

    near = [
        j
        for j in scene.others(i)
        if j != root
        and scene.gap[i, j] < TOUCHING / 2
        and scene.shapes[j].size > 0.6 * shape.size
        and not _alike(scene, i, j)
        and not _both_slivers(scene, root, i, j)
    ]
    if not near:
        return None
    best = max(near, key=lambda j: (share(j), -j))
    mine, roots = share(best), share(root)
    if shape.scanned:
        # What lies behind a part is missing from a scan: only a part that lies within another's
        # outline is taken to hang on it.
        inside = (shape.points > scene.shapes[best].low) & (shape.points < scene.shapes[best].high)
        return best if mine > 0.5 and roots < 0.1 and inside.all(1).mean() > 0.5 else None
    return best if mine > 0.15 + 2.0 * roots else None


def _both_slivers(scene: Scene, root: int, i: int, j: int) -> bool:
    """Two long thin parts by the root, like the hands of a clock: neither holds the other."""
    slender = max(scene.shapes[i].slenderness, scene.shapes[j].slenderness) < 0.3
    return slender and bool(max(scene.gap[i, root], scene.gap[j, root]) < 2 * TOUCHING)


def _alike(scene: Scene, i: int, j: int) -> bool:
    """Whether two parts have nearly the same box, like neighbouring doors or keys."""
    a, b = np.sort(scene.shapes[i].box.half), np.sort(scene.shapes[j].box.half)
    return bool(np.all(np.abs(a - b) < 0.2 * b + 0.001))


def _small(scene: Scene, holder: int, held: int) -> float:
    """1 where the holder is smaller than what it should hold."""
    return float(scene.shapes[holder].size < 0.8 * scene.shapes[held].size)


def _named_parents(scene: Scene, root: int, parent: list[int]) -> list[int]:
    """Apply what the category says about pairs of names."""
    table = CATEGORY_PARENTS.get(category_key(scene.category), {})
    if not table:
        return parent
    said = [words(s.name) for s in scene.shapes]
    for i, own in enumerate(said):
        if i == root or not own:
            continue
        for word, above in table.items():
            if known_word(own[-1], (word,)) is None:
                continue
            near = [
                j
                for j, other in enumerate(said)
                if j not in (i, root)
                and other
                and known_word(other[-1], (above,)) is not None
                and scene.gap[i, j] < 4 * TOUCHING
                and not _below(parent, j, i)
            ]
            if near:
                parent[i] = min(near, key=lambda j: (scene.gap[i, j], j))
    return parent


def _above(parent: list[int], link: int) -> list[int]:
    """The parts that ``link`` hangs on, nearest first."""
    out = []
    while parent[link] >= 0 and len(out) < len(parent):
        link = parent[link]
        out.append(link)
    return out


def _below(parent: list[int], link: int, top: int) -> bool:
    """Whether ``link`` hangs somewhere below ``top``."""
    while link >= 0:
        if link == top:
            return True
        link = parent[link]
    return False


def descendants(parent: list[int], top: int) -> set[int]:
    """``top`` and everything that hangs on it."""
    return {i for i in range(len(parent)) if _below(parent, i, top)}
