"""A scored proposal for the joint of one part, and its joints in the object's frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.special import softmax

from model.core.files import read_json, static_assets
from model.core.joint import JOINT_KINDS, Joint, JointType, canonical_axis_sign
from model.core.motion_lexicon import Mechanism
from model.core.names import known_word, words
from model.prediction.explanation import Reason
from model.prediction.geometric.sampled_object import SampledObject

Array = npt.NDArray[np.float64]

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class JointProposal:
    """One possible joint of a part, in the working frame.

    Attributes:
        type: joint type.
        axis: (3,) unit; positive q opens. origin: (3,) on the axis.
        lower, upper: rad or diagonals; meaningless for continuous joints.
        score: sum of the cues; only differences between proposals for one part have a meaning.
        mechanism: that proposes it; None for a joint without one. reasons: the decisive cues.
        travel: range (diagonals) of a preceding prismatic joint along the same axis, on a helper
            link; for screw caps and seats that rise.
    """

    type: JointType
    axis: Array
    origin: Array
    lower: float = 0.0
    upper: float = 0.0
    score: float = 0.0
    mechanism: Mechanism | None = None
    reasons: tuple[Reason, ...] = ()
    travel: tuple[float, float] | None = None


def unit(v: Array) -> Array:
    """``v`` at length 1; +z if it has none."""
    length = float(np.linalg.norm(v))
    return v / length if length > 1e-12 else UP.copy()


def snapped(axis: Array, candidates: Array, tolerance: float = 0.05) -> Array:
    """The nearest of some unit axes (rows) within ``tolerance`` (rad), sign kept; else ``axis``."""
    dots = candidates @ axis
    k = int(np.argmax(np.abs(dots)))
    if abs(dots[k]) >= np.cos(tolerance):
        return candidates[k] * np.sign(dots[k])
    return axis


def best_share(proposals: list[JointProposal]) -> float:
    """Share of the best proposal in a softmax over the scores, 0..1."""
    if not proposals:
        return 0.0
    return float(softmax(2.0 * np.array([p.score for p in proposals])).max())


def distinct_motions(
    proposals: list[JointProposal], *, signed: bool = False
) -> list[JointProposal]:
    """Proposals, best first, without those that repeat the motion of a better one.

    Args:
        signed: the opposite direction is another motion.
    """
    kept: list[JointProposal] = []
    for p in proposals:
        if not any(
            k.type == p.type
            and (float(k.axis @ p.axis) if signed else abs(float(k.axis @ p.axis))) > 0.99
            and (
                JOINT_KINDS[p.type].slides
                or np.linalg.norm(np.cross(k.axis, p.origin - k.origin)) < 0.02
            )
            for k in kept
        ):
            kept.append(p)
    return kept


@lru_cache(maxsize=1024)
def usual_stop(name: str | None) -> float:
    """Metres after which a part of this name usually stops, infinite where none is known."""
    stops = read_json(static_assets() / "physics" / "stops.json")["stops"]
    known = (known_word(w, tuple(stops)) for w in words(name))
    return min((float(stops[w]["metres"]) for w in known if w is not None), default=math.inf)


def joints_of(
    sampled: SampledObject, part: int, parent: int, proposal: JointProposal
) -> list[Joint]:
    """A proposal's joints, object frame: that of the part, after a helper's if it has travel."""
    frame = sampled.frame
    link, above = sampled.shapes[part].link, sampled.shapes[parent].link
    axis = _three(frame.direction_in_object(proposal.axis))
    origin = _three(frame.point_in_object(proposal.origin))
    scale = 1.0 if JOINT_KINDS[proposal.type].rotates else frame.diagonal
    lower, upper = proposal.lower * scale, proposal.upper * scale
    if JOINT_KINDS[proposal.type].slides:
        stop = usual_stop(sampled.shapes[part].name)
        lower, upper = max(lower, -stop), min(upper, stop)
    joint = Joint(f"joint_{link}", proposal.type, above, link, axis, origin, lower, upper)
    if proposal.travel is None:
        return [canonical_axis_sign(joint)]
    helper = f"helper_{link.removeprefix('link_')}"
    low, high = (end * frame.diagonal for end in proposal.travel)
    slide = Joint(f"joint_{helper}", "prismatic", above, helper, axis, origin, low, high)
    return [canonical_axis_sign(slide), canonical_axis_sign(replace(joint, parent=helper))]


def _three(v: Array) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])
