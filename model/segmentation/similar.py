"""Parts like another one: the same shape elsewhere, across a plane, or on a similar object.

Parts are carried over from an example that is laid over an object; see
:mod:`model.geometry.like_object`. Each part is the segmenter's own proposal that covers best what
the example has there, so borders lie where this object has them. Where none fits, superpoints take
the part most of them lie on. Where no object has its shape, the masks of several of its kind tell
which of its own are parts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree

from model.core.errors import PromptError
from model.geometry.like_object import Match, UprightBox, symmetries
from model.segmentation.arrays import Bool, Float, Float64
from model.segmentation.default import DefaultSession
from model.segmentation.mask_tools import to_elements, to_nodes
from model.segmentation.prompts import BASE, PartSegmentation

_AGREES = 0.7
"""Overlap (IoU) from which a proposal is taken for a carried part."""


@dataclass(frozen=True)
class ProposedParts(PartSegmentation):
    """A proposal of all parts.

    Attributes:
        names: of the parts from 1 on, "" where no accepted object tells one.
        known: accepted objects that it follows.
        agreement: 0..1, mean overlap of the parts of an object that was laid over this one with
            the answers to a click on each: whether they are parts here, too.
    """

    names: tuple[str, ...] = ()
    known: int = 0
    agreement: float = 1.0


def proposed(
    session: DefaultSession, masks: Iterable[Bool], names: Sequence[str], known: int = 0
) -> ProposedParts:
    """Label elements by (C,) masks of superpoints: later ones win, the rest is the base."""
    of_superpoint = np.full(len(session.encoding.superpoints), BASE, np.int16)
    for part, mask in enumerate(masks, start=BASE + 1):
        of_superpoint[mask] = part
    labels = session.finisher.without_prompts(of_superpoint)
    kept, labels = np.unique(np.append(labels, BASE), return_inverse=True)  # some have merged
    kept_names = tuple(names[part - 1] for part in map(int, kept[kept > BASE]))
    return ProposedParts(labels[:-1].astype(np.int16), "default", names=kept_names, known=known)


def carry_over(session: DefaultSession, match: Match) -> ProposedParts:
    """Take over the parts of ``match`` but its root, which is the base."""
    nodes, superpoints = session.encoding.nodes, session.encoding.superpoints
    example = match.example
    nearest = example.part[example.tree.query(match.to_example(nodes.points))[1]]
    found: list[tuple[Bool, float, str]] = []
    wanted = np.bincount(example.part, minlength=len(example.links)) / len(example.part)
    moving = [k for k, link in enumerate(example.links) if link != example.root]
    # The large ones first: what lies on them is theirs only where no smaller one has it.
    for k in sorted(moving, key=lambda k: -wanted[k]):
        share = np.bincount(superpoints.of_node, nearest == k, len(superpoints)) / superpoints.size
        if (share > 0.5).any():
            found.append((*_proposal(session, share), example.names[k] or ""))
    parts = proposed(session, (mask for mask, *_ in found), [name for *_, name in found], 1)
    return replace(parts, agreement=float(np.mean([overlap for _, overlap, _ in found] or [0.0])))


def _proposal(session: DefaultSession, share: Float64) -> tuple[Bool, float]:
    """The superpoints of a part of which ``share`` (C,) of each belongs to it, and its overlap with
    the first answer to a click on it.
    """
    superpoints = session.encoding.superpoints
    size, own = superpoints.size, share > 0.5
    middle = np.average(superpoints.center[own], axis=0, weights=size[own])
    apart = np.linalg.norm(superpoints.center - middle, axis=1)
    seed = int(np.flatnonzero(own)[apart[own].argmin()])
    found = session.solver.first_answer(seed, moving=True)
    masks = found.proposals.masks
    common = masks @ (size * share)
    union = masks @ size + (size * share).sum() - common
    overlap = common / np.maximum(union, 1e-9)
    best, first = int(overlap.argmax()), float(overlap[found.order[0]])
    return (masks[best] if overlap[best] >= _AGREES else own), first


_SAMPLE = 3000
_SYMMETRIC = 0.025
_REACH = 0.006


def mirrored(session: DefaultSession, mask: Bool) -> Bool:
    """(E,) the mask's counterpart across the object's plane of symmetry.

    Raises:
        PromptError: if the object has no such plane, or the mask lies on both sides of it.
    """
    inside = to_nodes(session, mask)
    points = session.encoding.nodes.points.astype(float)
    if not inside.any():
        return np.zeros(session.asset.element_count, bool)
    normal, offset = symmetry_plane(session, points[inside])
    image = points[inside]
    image = image - 2 * (image @ normal - offset)[:, None] * normal
    reach = max(2.0 * session.encoding.graph.spacing, _REACH * session.asset.diagonal)
    far, _ = KDTree(image).query(points, distance_upper_bound=reach, workers=2)
    # Whole superpoints: the border follows the gaps and creases of that side.
    superpoints = session.encoding.superpoints
    share = (
        np.bincount(superpoints.of_node, np.isfinite(far) & ~inside, len(superpoints))
        / superpoints.size
    )
    return to_elements(session, (share > 0.5)[superpoints.of_node]) & ~mask


def symmetry_plane(session: DefaultSession, part: Float64) -> tuple[Float64, float]:
    """The vertical plane that maps the object onto itself and ``part`` elsewhere.

    Planes perpendicular to the sides of the tightest upright box are tried, near its middle.

    Args:
        part: (K, 3) points of the part to mirror, metres.

    Returns:
        Unit normal (3,) and offset: x lies on the plane where normal · x = offset.

    Raises:
        PromptError: if no plane fits.
    """
    points = session.encoding.nodes.points.astype(float)
    some = points[:: max(1, len(points) // _SAMPLE)]
    tree, diagonal = session.encoding.nodes.tree, max(session.asset.diagonal, 1e-9)
    best, answer = _SYMMETRIC * diagonal, None
    for normal in UprightBox.around(points[:: max(1, len(points) // _SAMPLE)]).turn.T[:2]:
        along = some @ normal
        low, high = np.percentile(along, [0.5, 99.5])
        for shift in np.linspace(-0.04, 0.04, 17):
            offset = (low + high) / 2 + shift * (high - low)
            here = part @ normal - offset
            if min((here > 0).mean(), (here < 0).mean()) > 0.1:
                continue  # the part would be its own counterpart
            image = some - 2 * (along - offset)[:, None] * normal
            far, _ = tree.query(image, distance_upper_bound=0.05 * diagonal)
            cost = float(np.minimum(far, 0.05 * diagonal).mean())
            if cost < best:
                best, answer = cost, (normal, float(offset))
    if answer is None:
        raise PromptError(f"{session.asset.name}: no plane of symmetry with this part on one side")
    return answer


_BETWEEN_COLORS = 10.0
"""Lab distance of mean colors up to which masks are alike: 51 of 53 equal parts are, and a sixth of
the 192 patches that have a part's shape and are none (choosing halves of two sources)."""
_CLICKED, _OFFERED = 24, 16
"""Places in line with a part that are asked for masks, and masks of each."""


def same_shape(session: DefaultSession, mask: Bool, limit: int = 50) -> list[Bool]:
    """Other parts like this one (the other knobs, the other drawers), best first.

    Regions of the merge trees, and masks that clicks in line with the part or across the object's
    middle may mean, of about the same size, extents, normals and color are matched with the mask:
    unchanged, mirrored, or turned by quarters about the vertical axis. No two results overlap, and
    none overlaps the mask.
    """
    inside = to_nodes(session, mask)
    superpoints = session.encoding.superpoints
    share = np.bincount(superpoints.of_node, inside, len(superpoints)) / superpoints.size
    model = share > 0.5
    if not model.any():
        model = share == share.max()
    want = _shape(session, model)
    found: list[tuple[float, Bool]] = []
    color = _color(session, model)
    size = float(superpoints.size[model].sum())
    candidates = _regions_of_size(session, size)
    for seed in _in_line(session, model):
        answer = session.solver.first_answer(seed)
        masks = answer.proposals.masks[answer.order[:_OFFERED]]
        held = masks @ superpoints.size
        candidates += list(masks[(held > 0.7 * size) & (held < 1.4 * size)])
    for candidate in candidates:
        if (candidate & model).any():
            continue
        if np.linalg.norm(_color(session, candidate) - color) > _BETWEEN_COLORS:
            continue
        shape = _shape(session, candidate)
        if np.abs(np.log((shape + 1e-6) / (want + 1e-6))).max() > 0.35:
            continue
        fit = _fit(session, model, candidate)
        if fit < 0.25:
            found.append((fit, candidate))
    found.sort(key=lambda pair: pair[0])
    taken = model.copy()
    out: list[Bool] = []
    for _, candidate in found:
        if (candidate & taken).any():
            continue
        taken |= candidate
        out.append(to_elements(session, candidate[superpoints.of_node]))
        if len(out) == limit:
            break
    return out


def _in_line(session: DefaultSession, model: Bool) -> list[int]:
    """Superpoints where parts like ``model`` (C,) may lie, nearest first: half an extent from each
    other along the object's sides, facing the same way, and mirrored.
    """
    superpoints, points = session.encoding.superpoints, session.encoding.nodes.points
    axes = UprightBox.around(points[:: max(1, len(points) // _SAMPLE)].astype(float)).turn.T
    center, least = superpoints.center @ axes.T, 1.5 * session.encoding.graph.spacing
    own = center[model]
    middle = np.average(own, axis=0, weights=superpoints.size[model])
    seed = np.flatnonzero(model)[np.linalg.norm(own - middle, axis=1).argmin()]
    apart, extent = center - center[seed], np.ptp(own, axis=0)
    beside = np.abs(apart) <= np.maximum(0.3 * extent, least)
    free = ~model & (superpoints.normal @ superpoints.normal[seed] > 0.7)
    found: list[tuple[float, int]] = []
    for axis in range(3):
        there = np.flatnonzero(free & np.delete(beside, axis, axis=1).all(axis=1))
        step = np.round(apart[there, axis] / max(0.5 * extent[axis], least))
        for k in np.unique(step):
            of_step = there[step == k]
            off_line = np.abs(np.delete(apart[of_step], axis, axis=1)).sum(axis=1)
            found.append((abs(k), int(of_step[off_line.argmin()])))
    sums = np.percentile(center, [0.5, 99.5], axis=0).sum(axis=0)
    for axis in range(2):
        image = center[seed].copy()
        image[axis] = sums[axis] - image[axis]
        found.append((0.0, int(np.linalg.norm(center - image, axis=1).argmin())))
    places = dict.fromkeys(place for _, place in sorted(found) if not model[place])
    return list(places)[:_CLICKED]


def _color(session: DefaultSession, mask: Bool) -> Float64:
    """(3,) mean Lab."""
    superpoints = session.encoding.superpoints
    return np.average(superpoints.color[mask], axis=0, weights=superpoints.size[mask])


def _regions_of_size(session: DefaultSession, size: float) -> list[Bool]:
    """Different regions of all trees with 0.7 to 1.4 times ``size`` nodes."""
    hierarchy, superpoints = session.encoding.hierarchy, session.encoding.superpoints
    seen: set[bytes] = set()
    out = []
    for labels in hierarchy.labels:
        sizes = np.bincount(labels, superpoints.size)
        for region in np.nonzero((sizes > 0.7 * size) & (sizes < 1.4 * size))[0]:
            mask = labels == region
            key = np.packbits(mask).tobytes()
            if key not in seen:
                seen.add(key)
                out.append(mask)
    return out


def _shape(session: DefaultSession, mask: Bool) -> Float64:
    """(4,) sorted extents and length of the mean normal, which rotations don't change."""
    superpoints = session.encoding.superpoints
    x, w = superpoints.center[mask], superpoints.size[mask] / superpoints.size[mask].sum()
    x = x - w @ x
    values = np.linalg.eigvalsh((x * w[:, None]).T @ x)
    spread = np.sqrt(np.maximum(values, 0)) + 0.5 * session.encoding.graph.spacing
    scale = spread[2]
    return np.array([*spread, scale * (0.3 + np.linalg.norm(w @ superpoints.normal[mask]))])


def _fit(session: DefaultSession, model: Bool, other: Bool) -> float:
    """Mean distance between two matched regions, relative to their radius."""
    center, weight = session.encoding.superpoints.center, session.encoding.superpoints.size
    a = center[model] - np.average(center[model], axis=0, weights=weight[model])
    b = center[other] - np.average(center[other], axis=0, weights=weight[other])
    radius = float(np.sqrt((a**2).sum(1).mean())) + session.encoding.graph.spacing
    tree = KDTree(a)
    best = np.inf
    for turn, _ in symmetries():
        turned = b @ turn.T
        there, _ = tree.query(turned)
        back, _ = KDTree(turned).query(a)
        best = min(best, float(there.mean() + back.mean()) / 2)
    return best / radius


_PLACE, _SIZE, _WORTH = 3.0, 0.6, 0.1
"""Costs of a middle that differs by the object's side, of extents that differ by a factor of e, and
of log-odds that differ by one."""
_LEAST_HALF = 0.004
"""Half extents (diagonals) below which sizes don't differ."""
_SHARP = 0.2
"""Cost at which a mask is 1 / e as like as the same one."""
_UNSEEN = (0.0015, 0.05)
"""Parts and other masks that count as like each mask without any."""
_BY_EXAMPLES = (0.69, 1.06, 0.92)
"""Weights of a mask's log-odds by itself and by examples, and summand; fitted to the masks of 27 of
Infinigen's objects of nine kinds (choosing half)."""


_MOST = 5
"""Accepted objects that are compared, the last ones."""
_GAIN = 0.05
"""Least gain of precision an object from which they are followed."""


@dataclass(frozen=True)
class MaskExample:
    """A mask that a click on an accepted object may mean.

    Attributes:
        worth: its log-odds of a part without examples.
        place: (3,) of its middle in the object's upright box, -0.5..0.5.
        half: (3,) half extents along the box's sides, diagonals.
        part: name of the part that it is, "" without one; None where it is none.
    """

    worth: float
    place: tuple[float, float, float]
    half: tuple[float, float, float]
    part: str | None = None


@dataclass(frozen=True, eq=False)
class MaskTable:
    """Masks of one object, see :class:`MaskExample`.

    Attributes:
        worth: (M,). place, half: (M, 3). parts: of accepted objects, (M,) names or None.
        counts: of their parts of each name.
    """

    worth: Float
    place: Float64
    half: Float64
    parts: tuple[str | None, ...] = ()
    counts: Counter[str] = field(default_factory=Counter)

    @classmethod
    def of(cls, masks: Sequence[MaskExample], part_names: Iterable[str] = ()) -> MaskTable:
        """The masks of an accepted object, and the names of its parts."""
        worth, place, half = zip(*((m.worth, m.place, m.half) for m in masks), strict=True)
        parts = tuple(m.part for m in masks)
        return cls(np.array(worth), np.array(place), np.array(half), parts, Counter(part_names))

    @cached_property
    def right(self) -> Bool:
        """(M,) masks that are parts."""
        return np.array([part is not None for part in self.parts])


def telling(known: Sequence[MaskTable]) -> Sequence[MaskTable]:
    """The masks of accepted objects of a kind, where they tell the parts of each other.

    Each object's masks are sorted by themselves, and by those of the others; its parts have to come
    earlier in the mean (average precision).
    """
    tables = known[-_MOST:]
    gained = 0.0
    for one in tables:
        others = [t for t in tables if t is not one]
        if others and one.right.any():
            worth = by_examples(one, others)[0]
            gained += _precision(worth, one.right) - _precision(one.worth, one.right)
    return tables if gained > _GAIN * len(tables) else []


def _precision(worth: Float, right: Bool) -> float:
    found = right[np.argsort(-worth, kind="stable")]
    return float((np.cumsum(found) / np.arange(1, len(found) + 1))[found].mean())


def by_examples(own: MaskTable, known: Sequence[MaskTable]) -> tuple[Float, list[str]]:
    """(M,) log-odds of masks by what those of accepted objects were, and names of the parts that
    they are most like; "" without one.

    Args:
        known: accepted objects, which are compared in every turn and mirrored.
    """
    nearest, names = np.full(len(own.worth), np.inf), [""] * len(own.worth)
    if not known:
        return own.worth, names
    right, wrong = (np.full(len(own.worth), count) for count in _UNSEEN)
    for table in known:
        cost = _costs(own, table)
        like = np.exp(-cost / _SHARP)
        right += like[:, table.right].sum(axis=1)
        wrong += like[:, ~table.right].sum(axis=1)
        cost[:, ~table.right] = np.inf
        for k in np.flatnonzero(cost.min(axis=1) < nearest):
            best = int(cost[k].argmin())
            nearest[k], names[k] = cost[k, best], table.parts[best] or ""
    by_itself, by_likeness, summand = _BY_EXAMPLES
    return by_itself * own.worth + by_likeness * np.log(right / wrong) + summand, names


def within_counts(
    rows: Iterable[int], worth: Float, names: Sequence[str], known: Sequence[MaskTable]
) -> list[int]:
    """Keep as many masks of a name as an accepted object has parts of it, the likeliest first;
    further ones only where they are likelier than not.

    Args:
        rows: of masks that exclude each other. worth, names: see :func:`by_examples`.
    """
    most, seen = Counter[str](), Counter[str]()
    for table in known:
        most |= table.counts
    kept = []
    for row in sorted(rows, key=lambda row: -worth[row]):
        seen[names[row]] += 1
        if seen[names[row]] <= most[names[row]] or worth[row] > 0:
            kept.append(row)
    return kept


def _costs(own: MaskTable, known: MaskTable) -> Float64:
    """(M, K) costs of taking each mask for an accepted object's, turned as it fits best."""
    size, mine = (np.log(np.maximum(t.half, _LEAST_HALF)) for t in (known, own))

    def compared(turn: Float64) -> Float64:
        apart = np.linalg.norm(own.place[:, None] - known.place @ turn.T, axis=2)
        return _PLACE * apart + _SIZE * np.abs(mine[:, None] - size @ np.abs(turn).T).mean(axis=2)

    costs = [(compared(turn), price) for turn, price in symmetries()]
    best = min(costs, key=lambda pair: float(pair[0].min(axis=0).mean()) + pair[1])[0]
    return best + _WORTH * np.abs(own.worth[:, None] - known.worth)
