"""The evidence of rules, words and accepted joints, as log-probabilities of the answer's words.

Geometry offers candidates. Its rules with the parts' words, the network's reading and the accepted
joints of a workspace give each joint type a log-probability, the highest sum is the answer; the
candidates are scored by :mod:`model.prediction.arti4urdf.motion_ranker`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import softmax

from model.core.joint import JOINT_KINDS, Joint
from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.structure import MECHANISMS, RANKS, SLOTS, Structure
from model.prediction.arti4urdf.vocabulary import Decision
from model.prediction.experience import (
    MOST,
    UNSEEN,
    Experience,
    Motions,
    Recalled,
    extent_along,
    in_part,
    part_name,
)
from model.prediction.geometric.context import ACROSS, PARALLEL
from model.prediction.geometric.roles import NAMED, mechanism_scores, named_mechanism
from model.prediction.geometric.tree import is_below, rooted_tree

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

FLOOR = 0.002
"""Probability of words that the rules exclude."""
ACCEPTED_TYPES = 40.0
"""Weight of the log-shares of accepted joints by joint type: two that agree outweigh the rules, one
doesn't."""


@dataclass(frozen=True)
class HybridSettings:
    """Influence of geometry, which also decides the tree.

    Attributes:
        weight: of geometry's log-probabilities of joint types and candidates.
        swept: log-odds in favour of a candidate's own limits, from rules and motion sweep.
    """

    weight: float = 5.0
    swept: float = 10.0


def geometric_prior(structure: Structure) -> Array:
    """(P, SIZE) log-probabilities of joint types and candidates; 0 for all other words."""
    known = {i: k for i, k in enumerate(structure.features) if k is not None}
    out = np.zeros((len(structure.sampled), v.SIZE))
    for i, context in enumerate(structure.contexts):
        if i not in known:
            continue
        named, fixed = named_mechanism(context), FLOOR
        scores = mechanism_scores(context, known[i], known)
        mechanisms = softmax(1.5 * np.array([scores.get(m, -2.0) for m in MECHANISMS]))
        if named is not None:  # a name may be wrong: what it leaves open is the shape's
            mechanisms *= 1 - NAMED
            if named == "fixed":
                fixed = NAMED
            else:
                mechanisms[MECHANISMS.index(named)] += NAMED
        out[i] = _word_odds(structure, i, mechanisms, fixed)
    return out


def _word_odds(structure: Structure, part: int, mechanisms: Array, fixed: float) -> Array:
    """(SIZE,) log-probabilities from those of the mechanisms."""
    slots, types = np.zeros(SLOTS), np.full(len(v.TYPES), FLOOR)
    types[v.TYPES.index("fixed")] = fixed
    for k, mechanism in enumerate(MECHANISMS):
        found = structure.slots[part][k * RANKS : (k + 1) * RANKS]
        scores = np.array([p.score for p in found if p is not None])
        if not len(scores):
            continue
        slots[k * RANKS : k * RANKS + len(scores)] = mechanisms[k] * softmax(2.0 * scores)
        best = found[0]
        assert best is not None
        comes_off = best.travel is not None or mechanism == v.TYPES[v.SCREW]
        kind = v.TYPES[v.SCREW] if comes_off else best.type
        types[v.TYPES.index(kind)] += mechanisms[k]
    out = np.zeros(v.SIZE)
    out[v.TYPE_IDS] = np.log(types / types.sum())
    out[v.SLOT_IDS] = np.log(np.maximum(slots, FLOOR / SLOTS))
    out[v.ID["<free>"]] = np.log(FLOOR)
    return out


def recalled(experience: Experience | None, structure: Structure) -> dict[int, Recalled]:
    """Evidence about parts from accepted objects of the same category."""
    if experience is None:
        return {}
    parts = {i: _motions(structure, i) for i in range(len(structure.sampled))}
    return experience.recall(structure.sampled.category, parts)


def _motions(structure: Structure, part: int) -> Motions:
    found = [p for p in structure.slots[part] if p is not None]
    lines = [in_part(structure.sampled, part, p.axis, p.origin) for p in found]
    axes, arms = (np.array([line[k] for line in lines]).reshape(-1, 3) for k in (0, 1))
    turns = np.array([not JOINT_KINDS[p.type].slides for p in found], bool)
    return Motions(structure.sampled.shapes[part].name, axes, arms, turns)


def accepted_types(structure: Structure, known: Mapping[int, Recalled]) -> Array:
    """(P, SIZE) weighted log-shares of accepted joints by joint type; 0 for all other words."""
    out = np.zeros((len(structure.sampled), v.SIZE))
    for i, found in known.items():
        types = np.array([found.objects * found.types.get(t, 0.0) for t in v.TYPES])
        out[i, v.TYPE_IDS] = ACCEPTED_TYPES * np.log((types + UNSEEN) / (found.objects + UNSEEN))
    return out


def accepted_motions(structure: Structure, known: Mapping[int, Recalled]) -> dict[int, Array]:
    """Part → (SLOTS,) log-shares of accepted joints with the motion of each candidate."""
    out: dict[int, Array] = {}
    for i, found in known.items():
        out[i] = np.zeros(SLOTS)
        present = [p is not None for p in structure.slots[i]]
        out[i][present] = np.log((found.agreeing + UNSEEN) / (found.objects + UNSEEN))
    return out


LIKELY, ACROSS_IT = 0.5, -8.0
"""Share by rules and words from which a part is a drawer or a knob, and the log-share of its
candidates that slide within the plane of its front, or turn about another axis than its panel's
normal."""


def motion_evidence(
    structure: Structure, rules: Array, known: Mapping[int, Recalled]
) -> dict[int, Array]:
    """Part → (SLOTS,) log-shares of its candidates: of accepted joints, and of what drawers and
    knobs don't do. A badly cut drawer has the front of its siblings of the same name.

    Args:
        rules: (P, SIZE) of :func:`geometric_prior`. known: about parts, from accepted objects.
    """
    out = accepted_motions(structure, known)
    names = [(part_name(c.shape.name), c.parent) for c in structure.contexts]
    fronts = {
        n: c.front_normal
        for n, c in zip(names, structure.contexts, strict=True)
        if c.front_normal is not None
    }
    for i, context in enumerate(structure.contexts):
        shares = np.exp(rules[i][v.SLOT_IDS]).reshape(-1, RANKS).sum(1)
        for mechanism, normal, least in (
            ("slide_out", fronts.get(names[i]), ACROSS),
            ("spin", context.knob_normal, PARALLEL),
        ):
            if normal is None or shares[MECHANISMS.index(mechanism)] < LIKELY:
                continue
            there, slides = out.setdefault(i, np.zeros(SLOTS)), mechanism == "slide_out"
            for slot, p in enumerate(structure.slots[i]):
                if p is not None and JOINT_KINDS[p.type].slides == slides:
                    there[slot] += ACROSS_IT * (abs(float(p.axis @ normal)) < least)
    return out


def of_accepted_type(decision: Decision, known: Recalled) -> Decision:
    """The decision, with or without a stop as most accepted joints have it, if it turns."""
    agreed, turning = known.agreed(known.types), (v.REVOLUTE, v.CONTINUOUS)
    if decision.type in turning and agreed in ("revolute", "continuous"):
        return replace(decision, type=v.TYPES.index(agreed))
    return decision


def parents(
    structure: Structure, kept: Mapping[int, int], known: Mapping[int, Recalled]
) -> list[int]:
    """Parent of each part by geometry, or by name where most accepted objects have that one.

    Args:
        kept: part → the parent that a person fixed. known: about parts, from accepted objects.
    """
    sampled = structure.sampled
    root, found = structure.assembly.root, list(structure.assembly.parent)
    if kept:
        root, found = rooted_tree(sampled, kept, [])
    names = [part_name(s.name) for s in sampled.shapes]
    for i, about in known.items():
        parent = about.agreed(about.parents)
        if parent is None or i in kept or i == root:
            continue
        fitting = [k for k, name in enumerate(names) if name == parent and k != i]
        above = root if not parent else min(fitting, key=lambda k: sampled.gap[i, k], default=None)
        if above is not None and not is_below(found, above, i):
            found[i] = above
    return found


def with_known_range(
    joints: list[Joint], structure: Structure, part: int, known: Recalled
) -> list[Joint]:
    """The joint of a part with the limits on which accepted joints agree, if it has limits."""
    if len(joints) != 1 or not joints[0].limited:
        return joints
    [joint] = joints
    axis = structure.sampled.frame.object_from_working.T @ np.asarray(joint.axis)
    found = known.range_about(axis)
    if found is None:
        return joints
    scale = 1.0
    if not joint.rotates:
        scale = extent_along(structure.sampled, part, axis) * structure.sampled.frame.diagonal
    return [replace(joint, lower=found[0] * scale, upper=found[1] * scale)]


def follows(structure: Structure, decision: Decision, part: int, known: Recalled) -> bool:
    """True if the decision about a part has the type and motion of most accepted joints."""
    if known.agreed(known.types) != v.TYPES[decision.type]:
        return False
    if decision.slot < 0:
        return True
    if decision.slot == v.FREE:
        return False
    at = sum(p is not None for p in structure.slots[part][: decision.slot])
    return bool(known.agreeing[at] >= MOST * known.objects)
