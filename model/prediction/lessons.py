"""Motions of parts that are like those of accepted objects.

Accepted objects are compared with another one in every quarter turn and mirrored. Each of its parts
gets the motions of the parts like it there: of about its size, at about its place, with its name
where there is one. Lines are carried over in the box of the part and in that of its carrier. What
agrees counts together, what doesn't stands beside it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.special import expit, logit, softmax

from model.core.composite_joints import free_helpers
from model.core.joint import JOINT_KINDS, Joint, JointType, canonical_axis_sign
from model.geometry.like_object import symmetries
from model.prediction.experience import (
    Experience,
    ObjectExample,
    PartExample,
    Step,
    box_of,
    described,
    extent_along,
)
from model.prediction.geometric.context import JointProposal, three, unit
from model.prediction.geometric.sampled_object import SampledObject
from model.prediction.geometric.tree import is_below

Array = npt.NDArray[np.float64]

PLACE, SIZE, NAMES, ROUND, SKEW = 3.0, 0.6, 1.0, 0.5, 3.0
"""Costs of a place that differs by the object's side, of an extent that differs by a factor of e,
of another name, of a part that is round where the other isn't, and of what stands out of a part
half its extent elsewhere."""
UNKNOWN = 0.7
"""Cost of a place and size that an early version didn't keep."""
LEAST_HALF = 0.004
"""Half extents (diagonals) below which sizes don't differ."""
SHARP, TURN = 0.35, 0.1
"""Costs by which one part, or one way to turn an object, is e times as likely as another."""
RELEVANT = 3.0
"""Cost at which a part counts 1 / e as much as the same one."""
OBJECT = 0.25
"""Cost by which an object counts 1 / e as much as the likest one."""
WEAK = 0.03
"""Least weight of what is kept."""
FRAMES = {"part": 0.6, "carrier": 0.4}
"""Share of a line that is carried over in each box."""
ALONG, LINE = 0.97, 0.04
"""Least cosine of axes, and most between lines (diagonals), of one motion."""
MOST = 0.6
"""Share of the examples that must agree on a carrier, a base or a range."""
SECOND = 0.1
"""Least weight of a second object that agrees on a range."""
SPREAD = 0.25
"""Largest deviation of ranges that agree, as a share of their size."""


@dataclass(frozen=True, eq=False)
class Vote:
    """The motion of a part of an accepted object, on a part that is like it.

    Attributes:
        weight: 0..1. example: the part. object: index of its object.
        steps: joints in the working frame; none if it is fixed.
    """

    weight: float
    example: PartExample
    object: int
    steps: tuple[JointProposal, ...]


@dataclass(eq=False)
class Motion:
    """One motion of a part, with the votes for it.

    Attributes:
        steps: joints in the working frame, from the carrier on; none if it is fixed.
        votes: for it. agreed: whether most of them have its ranges.
    """

    steps: tuple[JointProposal, ...]
    votes: list[Vote] = field(default_factory=list)
    agreed: bool = False

    @property
    def weight(self) -> float:
        """Examples that moved so."""
        return sum(v.weight for v in self.votes)

    def with_ranges(self) -> Motion:
        """Itself with the types and ranges of most examples, or of the likest one."""
        best = max(self.votes, key=lambda v: v.weight)
        steps, agreed = [], True
        for k, step in enumerate(self.steps):
            turned = [(along(v.steps[k], step.axis), v) for v in self.votes]
            kinds: dict[JointType, float] = {}
            for other, vote in turned:
                kinds[other.type] = kinds.get(other.type, 0.0) + vote.weight
            kind = max(kinds, key=lambda t: kinds[t])
            own = [(other, vote) for other, vote in turned if other.type == kind]
            ends = np.array([(o.lower, o.upper) for o, _ in own])
            weights = np.array([vote.weight for _, vote in own])
            lower, upper = (_median(ends[:, c], weights) for c in (0, 1))
            near = np.abs(ends - (lower, upper)).max(1) <= SPREAD * max(upper - lower, 1e-6)
            objects = np.array([vote.object for _, vote in own])
            first = np.bincount(objects[near], weights[near], minlength=1).max()
            agreed &= bool(weights[near].sum() >= max(MOST * weights.sum(), first + SECOND))
            if float(weights[near].sum()) < MOST * float(weights.sum()):
                nearest = along(best.steps[k], step.axis)
                if nearest.type == kind:
                    lower, upper = nearest.lower, nearest.upper
            steps.append(replace(step, type=kind, lower=float(lower), upper=float(upper)))
        return replace(self, steps=tuple(steps), agreed=agreed)


@dataclass(frozen=True, eq=False)
class Lesson:
    """Examples of one part.

    Attributes:
        objects: accepted ones with a part like it. examples: such parts, by weight.
        foreseen: share, 0..1, of those whose joint came out right without experience.
        motions: theirs, likeliest first. carriers: index of the part that carries it → share.
        base: share of the examples that are the base.
    """

    objects: int
    examples: float
    foreseen: float
    motions: tuple[Motion, ...]
    carriers: Mapping[int, float]
    base: float


def along(step: JointProposal, axis: Array) -> JointProposal:
    """A joint whose axis points along another one's, where it has limits."""
    if float(step.axis @ axis) >= 0 or not JOINT_KINDS[step.type].limited:
        return step
    return replace(step, axis=-step.axis, lower=-step.upper, upper=-step.lower)


def _median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][int(np.searchsorted(total, total[-1] / 2))])


def likeness(known: Sequence[PartExample], parts: Sequence[PartExample]) -> Array:
    """(T, E, P) costs of taking each part for a known one, whose object is turned, by
    :func:`symmetries`."""
    place, half, skew = (
        [np.array([getattr(p, name) for p in side]) for side in (known, parts)]
        for name in ("place", "half", "skew")
    )
    rounds = np.array([[a.round != b.round for b in parts] for a in known])
    names = np.array([[_other_name(a.name, b.name) for b in parts] for a in known])
    sizes, own_sizes = (np.log(np.maximum(h, LEAST_HALF)) for h in half)
    turns = np.array([turn for turn, _ in symmetries()])

    def turned(vectors: Array, by: Array) -> Array:  # (T, E, 1, 3)
        return np.einsum("tij,ej->tei", by, vectors)[:, :, None]

    cost = PLACE * np.linalg.norm(turned(place[0], turns) - place[1], axis=3)
    cost += SKEW * np.linalg.norm(turned(skew[0], turns) - skew[1], axis=3)
    cost += SIZE * np.abs(turned(sizes, np.abs(turns)) - own_sizes).mean(axis=3) + ROUND * rounds
    cost[:, (half[0] == 0).all(axis=1)] = UNKNOWN
    return cost + NAMES * names


@lru_cache(maxsize=65536)
def _other_name(a: str, b: str) -> float:
    if a == b:
        return 0.0
    x, y = set(a.split()), set(b.split())
    return 1.0 - 0.5 * len(x & y) / max(1, len(x | y)) if x and y else 0.3


def lessons(experience: Experience, sampled: SampledObject) -> dict[int, Lesson]:
    """The lesson about each part that has accepted ones like it."""
    parts = described(sampled)
    votes: dict[int, list[Vote]] = {i: [] for i in range(len(parts))}
    carriers: dict[int, dict[int, float]] = {i: {} for i in votes}
    turns = [turn for turn, _ in symmetries()]
    compared = [_compared(known, parts) for known in experience.of(sampled.category)]
    nearest = min((float(whole.min()) for _, whole, _ in compared), default=0.0)
    for index, (known, whole, costs) in enumerate(compared):
        odds = -(whole - whole.min())[:, None, None] / TURN - costs / SHARP
        best = odds.reshape(-1, len(parts)).argmax(axis=0)
        weights = np.exp(odds - odds.max(axis=(0, 1)))
        own = np.take_along_axis(costs.reshape(-1, len(parts)), best[None], axis=0)[0]
        weights *= np.exp(-own / RELEVANT - (whole.min() - nearest) / OBJECT)
        weights /= np.exp(odds - odds.max(axis=(0, 1))).sum(axis=(0, 1))
        for t, e, i in zip(*(k.tolist() for k in np.nonzero(weights > WEAK)), strict=True):
            weight, example = float(weights[t, e, i]), known.parts[e]
            held = _carrier(sampled, costs[t].argmin(axis=0), example.carrier, i)
            carriers[i][held] = carriers[i].get(held, 0.0) + weight
            votes[i] += _votes(sampled, i, held, example, turns[t], weight, index)
    return {i: _lesson(found, carriers[i]) for i, found in votes.items() if found}


def _compared(
    known: ObjectExample, parts: Sequence[PartExample]
) -> tuple[ObjectExample, Array, Array]:
    """An example, the costs (T,) of its turns, and (T, E, P) those of its parts in each."""
    costs = likeness(known.parts, parts)
    return known, costs.min(axis=1).mean(axis=1) + [own for _, own in symmetries()], costs


def _carrier(sampled: SampledObject, owner: npt.NDArray[np.intp], above: int, part: int) -> int:
    """The part that is most like an example's carrier, the nearest of several; -1 for none."""
    fitting = (
        [k for k in np.flatnonzero(owner == above).tolist() if k != part] if above >= 0 else []
    )
    return min(fitting, key=lambda k: sampled.gap[part, k], default=-1)


def _votes(
    sampled: SampledObject,
    part: int,
    carrier: int,
    example: PartExample,
    turn: Array,
    weight: float,
    index: int,
) -> Iterator[Vote]:
    frames = FRAMES if carrier >= 0 and any(s.rotates for s in example.steps) else {"part": 1.0}
    for frame, share in frames.items():
        box = part if frame == "part" else carrier
        steps = tuple(_carried(sampled, part, box, s, turn, frame) for s in example.steps)
        yield Vote(weight * share, example, index, steps)


def _carried(
    sampled: SampledObject, part: int, box: int, step: Step, turn: Array, frame: str
) -> JointProposal:
    """A joint of an example on a part, in the working frame."""
    mirrored = float(np.linalg.det(turn)) < 0
    axis = turn @ np.asarray(step.axis) * (-1.0 if mirrored and step.rotates else 1.0)
    middle, half = box_of(sampled, box)
    arm = np.asarray(step.arm if frame == "part" else step.held)
    origin = middle + (turn @ arm) * half
    scale = 1.0 if step.rotates else extent_along(sampled, part, axis)
    return JointProposal(step.type, unit(axis), origin, step.lower * scale, step.upper * scale)


def same_steps(a: Sequence[JointProposal], b: Sequence[JointProposal]) -> bool:
    """True if two chains move a part in one way, whatever their ranges."""
    return len(a) == len(b) and all(_same_step(x, y) for x, y in zip(a, b, strict=True))


def _same_step(a: JointProposal, b: JointProposal) -> bool:
    turns = JOINT_KINDS[a.type].rotates
    if turns != JOINT_KINDS[b.type].rotates or abs(float(a.axis @ b.axis)) < ALONG:
        return False
    return not turns or float(np.linalg.norm(np.cross(a.axis, b.origin - a.origin))) < LINE


def _lesson(votes: Sequence[Vote], carriers: Mapping[int, float]) -> Lesson:
    motions: list[Motion] = []
    for vote in sorted(votes, key=lambda v: -v.weight):
        like = next((m for m in motions if same_steps(m.steps, vote.steps)), None)
        if like is None:
            motions.append(Motion(vote.steps, [vote]))
        else:
            like.votes.append(vote)
    total = sum(v.weight for v in votes)
    foreseen = sum(v.weight for v in votes if v.example.foreseen) / total
    base = sum(v.weight for v in votes if v.example.carrier < 0) / total
    ranked = sorted(motions, key=lambda m: -m.weight)
    shares = {k: w / sum(carriers.values()) for k, w in carriers.items() if k >= 0}
    objects = len({v.object for v in votes})
    return Lesson(objects, total, foreseen, tuple(m.with_ranges() for m in ranked), shares, base)


def taught_tree(
    root: int, parent: Sequence[int], found: Mapping[int, Lesson], kept: Mapping[int, int]
) -> list[int]:
    """Parents, -1 for the base, with the base and the carriers on which examples agree.

    Args:
        root, parent: by geometry. kept: part → the parent that a person fixed.
    """
    out = list(parent)
    base = max(found, key=lambda i: found[i].base, default=root)
    theirs = found[root].base if root in found else 0.0
    if base != root and base not in kept and found[base].base > MOST > theirs:
        out[root], out[base] = base, -1
        root = base
    for i, lesson in found.items():
        if i == root or i in kept or not lesson.carriers:
            continue
        above = max(lesson.carriers, key=lambda k: lesson.carriers[k])
        if lesson.carriers[above] >= MOST and lesson.examples > 0.5 and not is_below(out, above, i):
            out[i] = above
    return out


UNSEEN = 0.15
"""Examples that a motion counts as having without any; fewer trust them more."""
EXCLUDED = -2.5
"""Log-likelihood by geometry of what it doesn't offer."""
HALF = 0.25
"""Examples that geometry counts as having foreseen, and as not having, without any."""
CALIBRATED = (0.76, 0.61)
"""Factor and summand that turn a share's log-odds into those of a right joint; fitted to 313 joints
of Infinigen's choosing half (left-out kinds: calibration error .08)."""
RELIED = (0.15, 1.4)
"""Weight of geometry where it foresaw none of the examples, and what all of them add."""


def decide(
    lesson: Lesson, offered: Sequence[tuple[tuple[JointProposal, ...], float]]
) -> list[tuple[Motion, float]]:
    """The motions of a part, likeliest first, and the probability that each is right.

    Args:
        offered: motions by geometry, and their log-likelihoods, the highest 0.
    """
    motions = list(lesson.motions)
    for steps, _ in offered:
        if not any(same_steps(m.steps, steps) for m in motions):
            motions.append(Motion(steps))
    trust = RELIED[0] + RELIED[1] * (lesson.foreseen * lesson.examples + HALF) / (
        lesson.examples + 2 * HALF
    )
    scores = []
    for m in motions:
        own = max((odds for steps, odds in offered if same_steps(m.steps, steps)), default=EXCLUDED)
        voted = math.log((m.weight + UNSEEN) / (lesson.examples + UNSEEN))
        scores.append(voted + trust * max(own, EXCLUDED))
    shares = softmax(scores)
    odds = CALIBRATED[0] * logit(np.clip(shares, 1e-4, 1 - 1e-4)) + CALIBRATED[1]
    return sorted(zip(motions, expit(odds).tolist(), strict=True), key=lambda pair: -pair[1])


def joints_of_steps(
    sampled: SampledObject, part: int, parent: int, steps: Sequence[JointProposal]
) -> list[Joint]:
    """The joints of a motion, object frame, through helper links; a fixed one without steps."""
    link, above = sampled.shapes[part].link, sampled.shapes[parent].link
    if not steps:
        return [Joint(f"joint_{link}", "fixed", above, link)]
    out: list[Joint] = []
    ends = [*free_helpers(link, len(steps) - 1, ()), link]
    for step, below in zip(steps, ends, strict=True):
        scale = sampled.frame.diagonal if JOINT_KINDS[step.type].slides else 1.0
        axis = three(sampled.frame.direction_in_object(step.axis))
        origin = three(sampled.frame.point_in_object(step.origin))
        range_ = (step.lower * scale, step.upper * scale)
        joint = Joint(f"joint_{below}", step.type, above, below, axis, origin, *range_)
        out.append(canonical_axis_sign(joint))
        above = below
    return out
