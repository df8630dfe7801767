"""How each part moves: by its name where that says it, else by what it looks like."""

from __future__ import annotations

import numpy as np

from model.core.motion_lexicon import CATEGORY_MOTIONS, TURN_PREFIX, Mechanism
from model.core.part_names import mechanism_of
from model.prediction.geometric.context import Assembly, PartContext
from model.prediction.geometric.motion_scores import Scores, motion_scores, passes_sibling
from model.prediction.geometric.part_features import Looks, look

CATEGORY_BONUS = 1.2
"""Score for what parts of the object's category usually do."""


def guess_mechanisms(
    assembly: Assembly,
) -> tuple[dict[int, Mechanism], dict[int, str], dict[int, float]]:
    """Mechanism, reason and certainty (0..1) of each part but the root."""
    mechanisms: dict[int, Mechanism] = {}
    reasons: dict[int, str] = {}
    sureness: dict[int, float] = {}
    unnamed: dict[int, Looks] = {}
    for i, shape in enumerate(assembly.scene.shapes):
        if i == assembly.root:
            continue
        said = named_mechanism(PartContext(assembly, i))
        if said is not None:
            mechanisms[i], reasons[i], sureness[i] = said, f"named {shape.name!r}", 0.95
        else:
            unnamed[i] = look(PartContext(assembly, i))
    for i, looks in unnamed.items():
        scores = mechanism_scores(PartContext(assembly, i), looks, unnamed)
        best = max(scores, key=lambda m: scores[m])
        values = np.array(list(scores.values()))
        weights = np.exp(1.5 * (values - values.max()))
        mechanisms[i] = best
        reasons[i] = f"looks like a part that {MOTION_WORDS[best]}"
        sureness[i] = float(0.9 * weights.max() / weights.sum())
    return mechanisms, reasons, sureness


def mechanism_scores(part: PartContext, looks: Looks, unnamed: dict[int, Looks]) -> Scores:
    """How much a part looks like each mechanism, what its category usually does included.

    Args:
        unnamed: the cues of all parts without a name, by index; this part's too.
    """
    scores = motion_scores(part, looks, unnamed)
    for usual in CATEGORY_MOTIONS.get(part.category, ()):
        scores[usual] = scores.get(usual, 0.0) + CATEGORY_BONUS
    return scores


MOTION_WORDS: dict[Mechanism, str] = {
    "hinge": "swings like a door",
    "flap": "opens like a lid",
    "drop": "drops open",
    "temple": "folds about its end",
    "pivot": "turns about a pin",
    "swing": "swings like a bail",
    "lever": "turns like a lever",
    "toggle": "rocks",
    "tilt": "tilts",
    "spin": "spins",
    "swivel": "swivels",
    "screw": "screws off",
    "slide_out": "pulls out",
    "slide_along": "slides",
    "lift": "lifts off",
    "press": "is pressed",
    "fixed": "stays",
}


def named_mechanism(part: PartContext) -> Mechanism | None:
    """What a part's name says; where a word leaves two ways to move, the shape decides."""
    said, _ = mechanism_of(part.shape.name, part.scene.category)
    turns = any(w in TURN_PREFIX for w in part.words)
    if said == "hinge" and not turns and passes_sibling(part):
        return "slide_along"  # sashes and doors that pass each other
    if said == "screw" and part.category == "dispenser" and part.shape.roundest is None:
        return "press"  # a pump, not a cap
    if said == "toggle" and not turns and part.category != "switch" and _flat_round(part):
        return "press"  # it has no side to rock to
    return said


def _flat_round(part: PartContext) -> bool:
    """Whether it is a flat disc that lies on its parent."""
    disc = part.shape.roundest
    if disc is None or disc.half > disc.radius:
        return False
    along = (part.shape.points - disc.center) @ disc.axis
    faces = [part.distance[side * along > 0.5 * disc.half] for side in (-1, 1)]
    if not all(len(f) for f in faces):
        return False
    # Of a wheel that stands on it both faces are equally far away.
    return abs(float(np.median(faces[0]) - np.median(faces[1]))) > 0.5 * disc.half
