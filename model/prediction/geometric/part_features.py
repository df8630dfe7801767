"""Features of a part within its object, from which its mechanism is predicted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.prediction.geometric.context import PartContext
from model.prediction.geometric.proposal import UP
from model.prediction.geometric.shape import Roundness, same_extents

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PartFeatures:
    """Features of one part; lengths in diagonals of the object.

    Attributes:
        size: diagonal of the part's box. relative: over that of its parent.
        disc: circle fit along the symmetry axis, None if the part isn't round.
        flat: half thickness over radius of the disc; 0 without one.
        axis_up: 0..1, how vertical the disc's axis is.
        scanned: a cloud, so the back may be missing. ball: round about three axes.
        height: of the part's centre, 0 at the object's bottom, 1 at its top.
        grounded: reaches the object's bottom.
        top, bottom, sides: how much the parent covers it from above, from below, and from the
            four sides on average, 0..1. covered_sides: number of covered sides of six.
        outward: open direction. exposed: how open it is, 0..1. backed: how much of the parent
            lies behind, 0..1.
        exit: horizontal direction in which a drawer would open. exit_score: 0..1, 1 with nothing
            in front and the parent behind.
        depth: extent along exit. face: horizontal and other extent across exit.
        fill: share of its rectangle that a panel fills.
        panel: thin over middle extent. slender: middle over long extent.
        normal_up: 0..1, how vertical the thin axis is. aligned: 0..1, how well the box is aligned
            with the object's directions.
        end_contact: 0..1, 1 if it is held at one end of its long axis.
        contact_spread: extent of the contact over that of the part, along (thin, middle, long).
        same_size: number of other parts of nearly the same size.
        above_parent: height of its centre above that of the parent.
        parts: number of parts of the object.
    """

    size: float
    relative: float
    disc: Roundness | None
    flat: float
    axis_up: float
    scanned: bool
    ball: bool
    height: float
    grounded: bool
    top: float
    bottom: float
    sides: float
    covered_sides: int
    outward: Array
    exposed: float
    backed: float
    exit: Array
    exit_score: float
    depth: float
    face: tuple[float, float]
    fill: float
    panel: float
    slender: float
    normal_up: float
    aligned: float
    end_contact: float
    contact_spread: Array
    same_size: int
    above_parent: float
    parts: int


def measure_features(context: PartContext) -> PartFeatures:
    """Measure one part."""
    sampled, shape, base = context.sampled, context.shape, context.parent_shape
    box, disc, covers = shape.box, shape.roundest, context.covers
    height = max(float(sampled.high[2] - sampled.low[2]), 1e-6)
    axes = context.directions
    up = int(np.argmax(axes[:, 2]))
    down = (up + 3) % 6
    side = [k for k in range(6) if k not in (up, down)]
    outward = int(np.argmax(context.outwardness))
    exits = {k: (1 - covers[k]) * (0.35 + 0.65 * covers[(k + 3) % 6]) for k in side}
    exit_ = max(exits, key=lambda k: (round(exits[k], 2), -k))
    across = next(k % 3 for k in side if k % 3 != exit_ % 3)
    thin, _, long = shape.order
    contact = box.local(context.contact)
    spread = [np.ptp(contact[:, k]) / max(2 * float(box.half[k]), 1e-6) for k in shape.order]
    return PartFeatures(
        size=shape.size,
        relative=shape.size / max(base.size, 1e-6),
        disc=disc,
        # Noise thickens a thin disc.
        flat=max(0.0, disc.half - 2.5 * shape.noise) / max(disc.radius, 1e-6) if disc else 0.0,
        axis_up=abs(float(disc.axis @ UP)) if disc is not None else 0.0,
        scanned=shape.scanned,
        ball=shape.ball,
        height=float((shape.center[2] - sampled.low[2]) / height),
        grounded=float(shape.low[2] - sampled.low[2]) < 0.03 * height + 0.005,
        top=float(covers[up]),
        bottom=float(covers[down]),
        sides=float(np.mean(covers[side])),
        covered_sides=int((covers > 0.5).sum()),
        outward=axes[outward],
        exposed=1 - float(covers[outward]),
        backed=float(covers[(outward + 3) % 6]),
        exit=axes[exit_],
        exit_score=float(exits[exit_]),
        depth=2 * float(box.half[exit_ % 3]),
        face=(2 * float(box.half[across]), 2 * float(box.half[up % 3])),
        fill=shape.panel.fill,
        panel=shape.thinness,
        slender=shape.slenderness,
        normal_up=abs(float(box.axes[2, thin])),
        aligned=float(np.abs(box.axes).max(0).min()),
        end_contact=_end_contact(context, long),
        contact_spread=np.array(spread),
        same_size=_count_same_size(context),
        above_parent=float(shape.center[2] - base.center[2]),
        parts=len(sampled),
    )


def _end_contact(context: PartContext, long: int) -> float:
    half = float(context.shape.box.half[long])
    along = context.shape.box.local(context.shape.points)[:, long] / max(half, 1e-6)
    d = context.distance
    near = {}
    for side in (-1.0, 1.0):
        band = side * along > 0.75
        near[side] = float(np.median(d[band])) if band.sum() >= 3 else float(np.median(d))
    gain = abs(near[1.0] - near[-1.0]) / max(2 * half, 1e-6)
    return float(np.clip((gain - 0.1) / 0.4, 0, 1))


def _count_same_size(context: PartContext) -> int:
    shapes, root = context.sampled.shapes, context.assembly.root
    others = (shapes[j] for j in context.sampled.others(context.part) if j != root)
    return sum(same_extents(other, context.shape, 0.25, 0.002) for other in others)
