"""The mechanism of each part: from its name, else from its features."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.special import softmax

from model.core.motion_lexicon import CATEGORY_MOTIONS, CATEGORY_WORDS, TURN_PREFIX, Mechanism
from model.core.names import mechanism_of, mechanisms_of
from model.prediction.geometric.context import Assembly, PartContext
from model.prediction.geometric.motion_scores import Scores, motion_scores, passes_sibling
from model.prediction.geometric.part_features import PartFeatures, measure_features
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
    for usual in CATEGORY_MOTIONS.get(part.category, ()):
        scores[usual] = scores.get(usual, 0.0) + CATEGORY_BONUS
    return scores


def named_mechanism(part: PartContext) -> Mechanism | None:
    """The mechanism that a part's name implies; its shape decides if the name is ambiguous."""
    named, _ = mechanism_of(part.shape.name, part.sampled.category)
    several = mechanisms_of(part.shape.name, part.sampled.category)
    if len(several) > 1:  # people call a drawer's front a "drawer door": its shape decides
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
