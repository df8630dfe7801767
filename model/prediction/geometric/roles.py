"""The mechanism of each part, from its name or else its features.

With it goes the joint of a part after a change of its type.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.special import softmax

from model.core.articulated_object import SegmentedObject
from model.core.joint import JOINT_KINDS, Joint, JointType, canonical_axis_sign
from model.core.motion_lexicon import (
    CATEGORY_MOTIONS,
    CATEGORY_WORDS,
    MECHANISM_TABLE,
    SLIDING,
    TURN_PREFIX,
    TURNING,
    Mechanism,
)
from model.core.names import mechanism_of, mechanisms_of
from model.core.tree import KinematicTree, moving_chain
from model.prediction.builder import left_out
from model.prediction.geometric.context import (
    PARALLEL,
    Assembly,
    JointProposal,
    PartContext,
    joints_of,
)
from model.prediction.geometric.edge_hinges import edge_proposals
from model.prediction.geometric.limits import from_zero
from model.prediction.geometric.mechanisms import face_front, propose
from model.prediction.geometric.motion_scores import (
    PartFeatures,
    Scores,
    measure_features,
    motion_scores,
    passes_sibling,
)
from model.prediction.geometric.sampled_object import SampledObject, sample_object
from model.prediction.geometric.shape import roundness

CATEGORY_BONUS = 1.2
"""Score of the mechanisms that are usual for the object's category."""
NAMED = 0.95
"""Probability of the mechanism that a part's name implies."""


@dataclass(frozen=True)
class MechanismGuess:
    """The mechanism of a part, its probability, and whether its name implies it."""

    mechanism: Mechanism
    probability: float
    named: bool


def guess_mechanisms(assembly: Assembly) -> dict[int, MechanismGuess]:
    """The likeliest mechanism of each part but the root, by index."""
    guesses: dict[int, MechanismGuess] = {}
    unnamed: dict[int, PartFeatures] = {}
    for i in range(len(assembly.sampled)):
        if i == assembly.root:
            continue
        context = PartContext(assembly, i)
        named: Mechanism | None
        named = context.attempt("its name", partial(named_mechanism, context), None)
        features = None
        if named is None:
            features = context.attempt("its features", partial(measure_features, context), None)
        if features is not None:
            unnamed[i] = features
        else:
            mechanism: Mechanism = named or "fixed"
            guesses[i] = MechanismGuess(mechanism, NAMED, named is not None)
    for i, features in unnamed.items():
        context = PartContext(assembly, i)
        rules = partial(mechanism_scores, context, features, unnamed)
        nothing: Scores = {"fixed": 0.0}
        scores = context.attempt("the rules on its motion", rules, nothing)
        best = max(scores, key=lambda m: scores[m])
        probability = 0.9 * float(softmax(1.5 * np.array(list(scores.values()))).max())
        guesses[i] = MechanismGuess(best, probability, False)
    return guesses


def mechanism_scores(
    part: PartContext, features: PartFeatures, unnamed: dict[int, PartFeatures]
) -> Scores:
    """Scores from a part's features, with the bonus of its category's usual mechanisms.

    Args:
        unnamed: features of all unnamed parts by index, including this one.
    """
    scores = motion_scores(part, features, unnamed)
    bonus = 0.0 if left_out("usual motions of a category") else CATEGORY_BONUS
    for usual in CATEGORY_MOTIONS.get(part.category, ()):
        scores[usual] = scores.get(usual, 0.0) + bonus
    return scores


def named_mechanism(part: PartContext) -> Mechanism | None:
    """The mechanism that a part's name implies; its shape decides if the name is ambiguous."""
    if left_out("names"):
        return None
    named, _ = mechanism_of(part.shape.name, part.sampled.category)
    several = mechanisms_of(part.shape.name, part.sampled.category)
    if "slide_out" in several and part.shape.scanned and part.front_normal is not None:
        named = "slide_out"  # a scan doesn't show the drawer behind its front
    elif len(several) > 1:  # people call a drawer's front a "drawer door": its shape decides
        features = measure_features(part)
        scores = motion_scores(part, features, {part.part: features})
        named = max(several, key=lambda m: scores.get(m, -np.inf))
    turns = any(w in TURN_PREFIX for w in part.words)
    if named == "flap" and not turns and _is_round_cap(part):
        named = "swivel"  # the lid of a jar or a mill
    if named == "hinge" and not turns and passes_sibling(part):
        return "slide_along"  # sashes and doors that slide past each other
    if named == "screw" and part.category == "dispenser" and part.shape.roundest is None:
        return "press"  # a pump, not a cap
    if named == "toggle" and not turns and part.category != "switch" and _flat_round(part):
        return "press"  # a disc has no side to tilt to
    return named


def _is_round_cap(part: PartContext) -> bool:
    """True if a part is round about the upright axis of a round part below it, and its category's
    lexicon doesn't list its name."""
    if CATEGORY_WORDS.get(part.category, {}).keys() & set(part.words):
        return False
    cap, base = part.shape.roundest, part.parent_shape
    if cap is None or abs(float(cap.axis[2])) < 0.98:
        return False
    below = roundness(base.outline, cap.axis, base.scanned, base.noise)
    if below is None or not below.round or cap.center[2] < below.center[2]:
        return False
    return float(np.linalg.norm((cap.center - below.center)[:2])) < 0.1 * cap.radius


def _flat_round(part: PartContext) -> bool:
    """True if a part is a flat disc that lies on its parent."""
    disc = part.shape.roundest
    if disc is None or disc.half > disc.radius:
        return False
    along = (part.shape.points - disc.center) @ disc.axis
    faces = [part.distance[side * along > 0.5 * disc.half] for side in (-1, 1)]
    if not all(len(f) for f in faces):
        return False
    # Both faces of a wheel that stands on its parent are equally far from it.
    return abs(float(np.median(faces[0]) - np.median(faces[1]))) > 0.5 * disc.half


Array = npt.NDArray[np.float64]

ROCKER = 0.6
"""Size over the object's above which a part is no rocker, but a front."""
NAMED_TYPE = 1.0
"""Score of the mechanism that the part's name would imply for the other joint type."""
FREE, HELD = 0.3, 0.5
"""Largest coverage of a drawer in front, and smallest behind and on both sides."""
DEEP = 0.5
"""Depth over the front's shorter side above which a drawer is more than its front."""
TURN, SLIDE = math.pi / 2, 0.3
"""Default range: rad, and diagonals of the object."""


def change_joint_type(
    segmented: SegmentedObject, tree: KinematicTree, child: str, kind: JointType, seed: int = 0
) -> Joint:
    """The joint of ``child`` with another type, and the likeliest axis and limits for that type.

    Name, parent and child stay. Between revolute and continuous the axis stays too, and for a link
    that moves no part everything but the type and the limits.

    Args:
        segmented: parts, object frame, metres. tree: the present joints.
        child: a part's link, or the helper link of a part with several joints.
        kind: the new type.
    """
    joint = tree.joint_of[child]
    if kind == joint.type:
        return joint
    usual = TURN if not JOINT_KINDS[kind].slides else SLIDE * _diagonal(segmented)
    # The ratio of a mimic means nothing for another type.
    bare = replace(joint, type=kind, lower=0.0, upper=usual, mimic=None, give_way=False)
    if joint.rotates != bare.rotates:  # nor does a damping in N s/m
        bare = replace(bare, dynamics=None)
    if kind == "fixed" or (joint.rotates and bare.rotates):
        return bare
    parts = {p.link for p in segmented.parts}
    moved = moving_chain(tree, child, parts.__contains__)[-1]
    if moved not in parts:
        return bare
    sampled = sample_object(segmented, seed)
    assembly = _assembly(sampled, tree)
    part = [s.link for s in sampled.shapes].index(moved)
    if part == assembly.root:
        return bare
    context = PartContext(assembly, part)
    guesses = guess_mechanisms(assembly)
    mechanisms: dict[int, Mechanism] = {i: g.mechanism for i, g in guesses.items()}
    mechanisms[part] = _mechanism(context, kind)
    face_front(assembly, mechanisms)
    out = sampled.frame.object_from_working.T @ np.asarray(joint.axis)
    best = _drawer_hinge(context, out) if kind == "revolute" else None
    if best is None:
        best = from_zero(context, propose(context, mechanisms[part])[0])
    if best.type == "fixed":
        return bare
    [found] = joints_of(sampled, part, context.parent, replace(best, travel=None))
    limits = found if found.type == kind else bare
    return canonical_axis_sign(
        replace(bare, axis=found.axis, origin=found.origin, lower=limits.lower, upper=limits.upper)
    )


def _drawer_hinge(context: PartContext, out: Array) -> JointProposal | None:
    """The hinge of a drawer's front: at its lower edge if it is wide, else at a side.

    Args:
        out: (3,) unit, working frame, the direction in which the drawer opens.

    Returns:
        None if the part is no drawer.
    """
    box = context.shape.box
    deep = int(np.argmax(np.abs(out @ box.axes)))
    if abs(float(out @ box.axes[:, deep])) < PARALLEL or abs(float(out[2])) > 1 - PARALLEL:
        return None
    if _mechanism(context, "prismatic") != "slide_out":
        return None
    up = int(np.argmax(np.abs(box.axes[2])))
    wide = 3 - deep - up
    ahead = deep if float(out @ box.axes[:, deep]) > 0 else deep + 3
    covers = context.covers
    beside = min(covers[wide], covers[wide + 3])
    if covers[ahead] > FREE or beside < HELD or covers[ahead - 3] < HELD:
        return None  # not enclosed, or it opens another way
    if box.half[deep] < DEEP * min(box.half[up], box.half[wide]):
        return None  # a front alone: its features decide
    flap = bool(box.half[up] <= box.half[wide])
    edge = wide if flap else up
    fitting = [
        p
        for p in edge_proposals(context, "drop" if flap else "hinge", front=out)
        if abs(float(p.axis @ box.axes[:, edge])) > PARALLEL
        and (not flap or p.origin[2] < box.center[2])
    ]
    return max(fitting, key=lambda p: p.score)


def _diagonal(segmented: SegmentedObject) -> float:
    return float(np.linalg.norm(np.ptp(segmented.bounds, axis=0)))


def _assembly(sampled: SampledObject, tree: KinematicTree) -> Assembly:
    """The sampled parts with the parents of ``tree``, skipping helper links."""
    index = {s.link: i for i, s in enumerate(sampled.shapes)}
    parent = []
    for link in index:
        above = link
        while above in tree.joint_of:
            above = tree.joint_of[above].parent
            if above in index:
                break
        parent.append(index[above] if above in index and above != link else -1)
    root = index.get(tree.root, parent.index(-1))
    parent = [k if k >= 0 else root for k in parent]
    parent[root] = -1
    return Assembly(sampled, root, parent)


def _mechanism(context: PartContext, kind: JointType) -> Mechanism:
    """The likeliest mechanism of a joint type for a part: by its name, else by its features."""
    fit: list[Mechanism] = [m for m, row in MECHANISM_TABLE.items() if kind in row.types]
    named = named_mechanism(context)
    if named in fit:
        return named
    others = [PartContext(context.assembly, i) for i in range(len(context.sampled))]
    unnamed = {
        i: measure_features(other)
        for i, other in enumerate(others)
        if i != context.assembly.root and (i == context.part or named_mechanism(other) is None)
    }
    scores = mechanism_scores(context, unnamed[context.part], unnamed)
    if named is not None:
        other = (SLIDING if JOINT_KINDS[kind].slides else TURNING).get(named)
        if other is not None:
            scores[other] = scores.get(other, 0.0) + NAMED_TYPE
    if context.shape.size > ROCKER:
        scores["toggle"] = 0.0
    return max(fit, key=lambda m: scores.get(m, 0.0))
