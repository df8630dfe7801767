"""Evidence for the confidence of a joint from geometry and names."""

from __future__ import annotations

import numpy as np

from model.core.motion_lexicon import MECHANISM_TABLE, Mechanism
from model.core.names import mechanism_of
from model.prediction.geometric.context import PartContext
from model.prediction.geometric.sampled_object import CONTACT_GAP

GROUPS = tuple(dict.fromkeys(row.group for row in MECHANISM_TABLE.values() if row.group))


def part_evidence(context: PartContext, mechanism: Mechanism | None) -> dict[str, float]:
    """Name → number, 0..1 unless stated otherwise; see :mod:`model.prediction.confidence`.

    Args:
        mechanism: of the predicted joint; None if none was chosen.
    """
    sampled, shape = context.sampled, context.shape
    named, _ = mechanism_of(shape.name, sampled.category)
    group = "" if mechanism is None else MECHANISM_TABLE[mechanism].group
    panel = group == "panel"
    out = {
        "named": float(named is not None),
        "scanned": float(sampled.scanned),
        "apart": float(sampled.gap[context.part, context.parent] > 2 * CONTACT_GAP),
        # Standard deviation in percent of the diagonal, and decades below it.
        "noise": min(100 * float(sampled.noise), 5.0),
        "small": float(np.clip(-np.log10(max(shape.size, 1e-3)), 0, 3)),
        "shut panel": float(panel and context.closed),
        "panel with a handle": float(panel and bool(context.grips)),
    }
    return out | {name: float(name == group) for name in GROUPS}
