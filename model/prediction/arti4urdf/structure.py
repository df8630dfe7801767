"""The structure prompt: geometry's input to the language model about each part.

For every part the geometric rules propose the joints of each mechanism. The language model reads
where these candidates lie, how the parts touch, and the parts' features, and chooses; the numbers
of the URDF follow from its choice (the paper's "potential motion axes"). Lengths are in the working
frame of :mod:`model.prediction.geometric.sampled_object`: diagonal 1, +z up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import SegmentedObject
from model.core.joint import JOINT_KINDS
from model.core.motion_lexicon import MECHANISMS as ALL_MECHANISMS
from model.core.motion_lexicon import Mechanism
from model.core.names import mechanism_of
from model.core.progress import Progress, no_progress
from model.prediction.geometric.context import (
    Assembly,
    JointProposal,
    PartContext,
    distinct_motions,
)
from model.prediction.geometric.mechanisms import face_front, proposals_for, swept_limits
from model.prediction.geometric.motion_scores import PartFeatures, measure_features, motion_scores
from model.prediction.geometric.roles import guess_mechanisms
from model.prediction.geometric.sampled_object import SAMPLE_BUDGET, SampledObject, sample_object
from model.prediction.geometric.shape import rotation
from model.prediction.geometric.tree import root_scores, spanning_parents

Array = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]

MECHANISMS: tuple[Mechanism, ...] = tuple(m for m in ALL_MECHANISMS if m != "fixed")
RANKS = 2
SLOTS = len(MECHANISMS) * RANKS
"""Candidates per part: the best ``RANKS`` of each mechanism; slot = mechanism * RANKS + rank."""
POINTS = 512
"""Points of each part (and of the whole object) for Point-BERT."""

CANDIDATE_SCALARS = 7
CANDIDATE_VECTORS = 2
VECTORS = 5
SIZES, FEATURES = 17, 35
SCALARS = SIZES + FEATURES + 2 * len(MECHANISMS) + 2
"""Numbers per part: sizes and place, features, a score per mechanism, mechanism of the name."""
FIRST_FEATURE = 15
"""From this scalar on they are judgements of the geometric rules."""
FIRST_NAME_SCALAR = SCALARS - len(MECHANISMS) - 2
"""From this scalar on they depend on the name; the last one is 1 without a name."""
AREA_ROOT = 12
"""Index of the square root of the area."""
RELATIONS = 8


@dataclass(frozen=True, eq=False)
class StructureArrays:
    """The structure prompt as numbers, working frame.

    Attributes:
        points: (P, POINTS, 3) of each part.
        scalars: (P, SCALARS), see there.
        box: (P, 6) centre and half extents along the working axes.
        vectors: (P, VECTORS, 3) open direction, exit, contact, handle, panel normal.
        candidate_scalars: (P, SLOTS, CANDIDATE_SCALARS); the first is 1 if the candidate exists.
        candidate_vectors: (P, SLOTS, CANDIDATE_VECTORS, 3): axis; point of its line nearest to the
            part's centre, relative to the centre.
        relations: (P, P, RELATIONS) of part i (row) to part j: gap, sizes, heights.
        parents: (P,) parent by geometry, -1 for the root.
    """

    points: Floats
    scalars: Floats
    box: Floats
    vectors: Floats
    candidate_scalars: Floats
    candidate_vectors: Floats
    relations: Floats
    parents: npt.NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.points)

    def turned(self, quarter: int, mirrored: bool) -> StructureArrays:
        """The same object after quarter turns about +z and a reflection of x.

        Rotation axes are pseudo-vectors: a reflection reverses them.
        """
        m = rotation(np.array([0.0, 0.0, 1.0]), quarter * np.pi / 2)
        if mirrored:
            m = m @ np.diag([-1.0, 1.0, 1.0])
        m = m.astype(np.float32)
        vectors = self.candidate_vectors @ m.T
        if mirrored:
            rotates = self.candidate_scalars[..., 6] > 0
            vectors = vectors.copy()
            vectors[..., 0, :] *= np.where(rotates, -1.0, 1.0)[..., None]
        box = np.concatenate([self.box[:, :3] @ m.T, self.box[:, 3:] @ np.abs(m).T], 1)
        return StructureArrays(
            self.points @ m.T,
            self.scalars,
            box.astype(np.float32),
            self.vectors @ m.T,
            self.candidate_scalars,
            vectors.astype(np.float32),
            self.relations,
            self.parents,
        )

    def ordered(self, order: npt.NDArray[np.int64]) -> StructureArrays:
        """The same with part ``order[k]`` at index k."""
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        parents = self.parents[order]
        return StructureArrays(
            self.points[order],
            self.scalars[order],
            self.box[order],
            self.vectors[order],
            self.candidate_scalars[order],
            self.candidate_vectors[order],
            self.relations[np.ix_(order, order)],
            np.where(parents >= 0, place[parents], -1),
        )


@dataclass(eq=False)
class Structure:
    """The candidates of one object.

    Attributes:
        sampled: the parts in the working frame.
        assembly: with the tree from geometry alone.
        slots: per part the proposals by slot; None for those that a mechanism lacks.
        contexts: of the parts; the root is a child of the likeliest other base.
        root_scores: (P,) of each part as the base.
    """

    sampled: SampledObject
    assembly: Assembly
    slots: list[list[JointProposal | None]]
    contexts: list[PartContext]
    root_scores: Array
    _candidates: dict[tuple[int, int], JointProposal] = field(default_factory=dict)

    @cached_property
    def features(self) -> list[PartFeatures | None]:
        """Features of each part; None for the only part of an object."""
        return [measure_features(c) if len(self.sampled) > 1 else None for c in self.contexts]

    def candidate(self, part: int, slot: int) -> JointProposal | None:
        """The proposal in a slot, with limits from a motion sweep if its mechanism has them."""
        key = (part, slot)
        if key not in self._candidates:
            found = self.slots[part][slot]
            if found is None:
                return None
            sweep = swept_limits(MECHANISMS[slot // RANKS])
            if sweep is not None:
                found = sweep(self.contexts[part], found)
            self._candidates[key] = found
        return self._candidates[key]


def read_structure(
    segmented: SegmentedObject,
    seed: int = 0,
    *,
    budget: int = SAMPLE_BUDGET,
    progress: Progress = no_progress,
) -> Structure:
    """Find the candidates of every part.

    Args:
        segmented: the parts, with or without names.
        seed: random seed of the samples. budget: surface points of all parts together.
        progress: reports each part.
    """
    sampled = sample_object(segmented, seed, budget=budget)
    scores = root_scores(sampled)
    root = int(np.argmax(scores))
    parent = spanning_parents(sampled, root)
    assembly = Assembly(sampled, root, parent)
    face_front(assembly, {i: g.mechanism for i, g in guess_mechanisms(assembly).items()})
    contexts = [PartContext(_as_child(assembly, scores, i), i) for i in range(len(sampled))]
    slots: list[list[JointProposal | None]] = []
    for i, context in enumerate(contexts):
        progress(i / len(contexts), f"proposals for {sampled.shapes[i].link}")
        slots.append(_slots(context) if len(sampled) > 1 else [None] * SLOTS)
    return Structure(sampled, assembly, slots, contexts, scores)


def _as_child(assembly: Assembly, scores: Array, part: int) -> Assembly:
    """The assembly with ``part`` as a child: a root hangs on the next likeliest base."""
    if assembly.parent[part] >= 0 or len(assembly.sampled) == 1:
        return assembly
    others = [j for j in range(len(scores)) if j != part]
    parent = list(assembly.parent)
    base = max(others, key=lambda j: scores[j])
    parent[part], parent[base] = base, -1
    return Assembly(assembly.sampled, base, parent, assembly.front, assembly.front_certainty)


FARTHEST = 2.0
"""Largest distance (diagonals) of an axis from its part."""


def _slots(context: PartContext) -> list[JointProposal | None]:
    out: list[JointProposal | None] = []
    center = context.shape.center
    for mechanism in MECHANISMS:
        near = [h for h in proposals_for(context, mechanism) if _sound(h, center)]
        found = distinct_motions(sorted(near, key=lambda h: -h.score), signed=True)[:RANKS]
        out += [*found, *[None] * (RANKS - len(found))]
    return out


def _sound(h: JointProposal, center: Array) -> bool:
    # Plain numbers: for three of them numpy takes ten times as long.
    a, b, c = (float(v) for v in h.axis)
    x, y, z = (float(v) for v in h.origin - center)
    off = math.hypot(b * z - c * y, c * x - a * z, a * y - b * x)
    return all(map(math.isfinite, (off, h.lower, h.upper, h.score))) and off < FARTHEST


def structure_arrays(structure: Structure, rng: np.random.Generator) -> StructureArrays:
    """The structure prompt as numbers; ``rng`` draws the points."""
    sampled = structure.sampled
    n = len(sampled)
    features, scores = structure.features, structure.root_scores
    known = {i: k for i, k in enumerate(features) if k is not None}
    rows = [
        _scalars(structure.contexts[i], features[i], known, float(scores[i] - scores.max()))
        for i in range(n)
    ]
    candidates = [_candidates(structure.slots[i], sampled.shapes[i].center) for i in range(n)]
    box = [
        np.concatenate([(s.low + s.high) / 2, np.maximum((s.high - s.low) / 2, 1e-4)])
        for s in sampled.shapes
    ]
    return StructureArrays(
        np.stack([_drawn(s.points, POINTS, rng) for s in sampled.shapes]).astype(np.float32),
        np.clip(np.array(rows), -8, 8).astype(np.float32),
        np.array(box, np.float32),
        np.stack([_vectors(c, k) for c, k in zip(structure.contexts, features, strict=True)]),
        np.stack([c[0] for c in candidates]),
        np.stack([c[1] for c in candidates]),
        _relations(structure, scores),
        np.array(structure.assembly.parent, np.int64),
    )


def _drawn(points: Array, count: int, rng: np.random.Generator) -> Array:
    if not len(points):
        return np.zeros((count, 3))
    return points[rng.choice(len(points), count, replace=len(points) < count)]


def _scalars(
    context: PartContext, k: PartFeatures | None, others: dict[int, PartFeatures], root_score: float
) -> list[float]:
    shape, sampled = context.shape, context.sampled
    half = np.sort(shape.box.half)
    out = [root_score, len(sampled) / 10, float(sampled.scanned), 10 * shape.noise, *(4 * half)]
    out += [*np.log(np.maximum(half, 1e-4)), shape.thinness, shape.slenderness]
    out += [float(np.sqrt(max(shape.area, 0.0))), float(shape.low[2] - sampled.low[2])]
    out += [float(sampled.high[2] - shape.high[2]), float(context.assembly.root == context.part)]
    out += [context.assembly.front_certainty]
    out += _feature_scalars(context, k)
    scored = motion_scores(context, k, others) if k is not None else {}
    scored.pop("drop", None)  # the shipped network was trained without it
    out += [scored.get(m, -2.0) for m in MECHANISMS]
    named, _ = mechanism_of(shape.name, sampled.category)
    out += [float(named == m) for m in (*MECHANISMS, "fixed")] + [float(named is None)]
    return out


def _feature_scalars(context: PartContext, k: PartFeatures | None) -> list[float]:
    if k is None:
        return [0.0] * FEATURES
    shape = context.shape
    around = [r.spread for r in shape.roundnesses[:3]]
    handle = context.handle
    radius = k.shape.roundest.radius if k.shape.roundest is not None else 0.0
    out = [
        k.relative,
        k.shape.size,
        float(k.shape.roundest is not None),
        radius,
        k.flat,
        k.axis_up,
        float(k.shape.ball),
    ]
    out += [
        k.height,
        float(k.grounded),
        k.cover.above,
        k.cover.below,
        k.cover.sides,
        k.cover.count / 6,
        k.cover.exposed,
    ]
    out += [
        k.cover.backed,
        k.exit.score,
        k.exit.depth,
        *k.exit.face,
        k.shape.panel.fill,
        k.normal_up,
        k.aligned,
        k.end_contact,
    ]
    out += [*np.clip(k.contact_spread, 0, 2), k.same_size / 4, 3 * k.above_parent]
    out += [5 * s for s in (*around, 1.0, 1.0, 1.0)[:3]]
    out += [float(context.in_contact), float(context.closed)]
    return out + ([handle.strength, handle.share] if handle is not None else [0.0, 0.0])


def _vectors(context: PartContext, k: PartFeatures | None) -> Floats:
    out = np.zeros((VECTORS, 3), np.float32)
    if k is None:
        return out
    shape = context.shape
    out[0], out[1] = k.cover.outward, k.exit.direction
    out[2] = context.contact_center - shape.center
    handle = context.handle
    if handle is not None:
        out[3] = shape.box.axes @ handle.center
    out[4] = context.panel_normal
    return out


def _candidates(slots: list[JointProposal | None], center: Array) -> tuple[Floats, Floats]:
    scalars = np.zeros((SLOTS, CANDIDATE_SCALARS), np.float32)
    vectors = np.zeros((SLOTS, CANDIDATE_VECTORS, 3), np.float32)
    for k, h in enumerate(slots):
        if h is None:
            continue
        rotates = JOINT_KINDS[h.type].rotates
        # A prismatic axis has only a direction.
        arm = (h.origin - center) - h.axis * float((h.origin - center) @ h.axis)
        best = slots[k - k % RANKS]
        assert best is not None
        scalars[k] = (
            1.0,
            np.clip(h.score - best.score, -4, 0),
            np.clip(h.score, -4, 4) / 2,
            np.clip(h.lower, -4, 4),
            np.clip(h.upper, -4, 4),
            float(np.linalg.norm(arm)) if rotates else 0.0,
            float(rotates),
        )
        vectors[k, 0] = h.axis
        vectors[k, 1] = arm if rotates else 0.0
    return scalars, vectors


def _relations(structure: Structure, scores: Array) -> Floats:
    sampled = structure.sampled
    n = len(sampled)
    size = np.array([s.size for s in sampled.shapes])
    center = np.stack([s.center for s in sampled.shapes])
    parent = np.array(structure.assembly.parent)
    out = np.zeros((n, n, RELATIONS), np.float32)
    gap = np.minimum(sampled.gap, 1.0)
    out[..., 0] = np.exp(-gap / 0.01)
    out[..., 1] = np.sqrt(gap)
    out[..., 2] = parent[:, None] == np.arange(n)[None]
    out[..., 3] = parent[None] == np.arange(n)[:, None]
    out[..., 4] = np.tanh(np.log(np.maximum(size[:, None], 1e-4) / np.maximum(size[None], 1e-4)))
    out[..., 5] = np.tanh(5 * (center[:, None, 2] - center[None, :, 2]))
    out[..., 6] = np.tanh(scores[:, None] - scores[None])
    out[..., 7] = np.eye(n)
    return out
