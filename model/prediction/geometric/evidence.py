"""What makes a joint's decisions go wrong, for its confidence: see
:mod:`model.prediction.confidence`."""

from __future__ import annotations

import numpy as np

from model.core.motion_lexicon import Mechanism
from model.core.part_names import mechanism_of
from model.prediction.geometric.assembly import TOUCHING
from model.prediction.geometric.context import PartContext

GROUPS: dict[str, tuple[Mechanism, ...]] = {
    "panel": ("hinge", "flap", "drop"),
    "arm": ("temple", "pivot", "swing", "lever", "tilt"),
    "rocker": ("toggle",),
    "round": ("spin", "swivel"),
    "screw": ("screw",),
    "drawer": ("slide_out",),
    "slider": ("slide_along", "lift"),
    "button": ("press",),
}
"""Ways to move that go wrong alike: the side of a door, the travel of a cap."""


def part_evidence(context: PartContext, mechanism: Mechanism | None) -> dict[str, float]:
    """What is known of a part beside the probabilities: 0..1 unless said otherwise.

    Args:
        mechanism: how it was decided to move; None where no mechanism was.
    """
    scene, shape = context.scene, context.shape
    said, _ = mechanism_of(shape.name, scene.category)
    panel = mechanism in GROUPS["panel"]
    out = {
        "named": float(said is not None),
        "scanned": float(scene.scanned),
        "apart": float(scene.gap[context.part, context.parent] > 2 * TOUCHING),
        # Standard deviation in percent of the diagonal, and decades below it.
        "noise": min(100 * float(scene.noise), 5.0),
        "small": float(np.clip(-np.log10(max(shape.size, 1e-3)), 0, 3)),
        "shut panel": float(panel and context.closed),
        "panel with a handle": float(panel and bool(context.grips)),
    }
    return out | {name: float(mechanism in kinds) for name, kinds in GROUPS.items()}
