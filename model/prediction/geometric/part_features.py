"""What a part looks like within its assembly: the cues from which its mechanism is guessed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.prediction.geometric.context import PartContext
from model.prediction.geometric.hypothesis import UP
from model.prediction.geometric.outline import Roundness

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Looks:
    """Cues of one part; lengths in diagonals of the object.

    Attributes:
        size: diagonal of the part's box. relative: over that of its parent.
        disc: circle that the outline makes, None where it is not round.
        flat: half thickness over radius of the disc; 0 where there is none.
        axis_up: 0..1, how upright the disc's axis is. scanned: it is a cloud: what lies behind may
            be missing.
        ball: round about three axes.
        height: 0 at the object's foot, 1 at its top (the part's middle). grounded: touches down.
        top, bottom, sides: how much the parent covers it from above, from below, and from the
            four sides (mean). walls: number of the six sides that are covered.
        outward: free direction. exposed: how free it is there (1 - cover). backed: how much of
            the parent lies behind.
        exit: level direction in which a drawer would leave. way_out: 0..1, nothing is in front of
            it there and the parent is behind it.
        depth: extent along exit. face: the two extents across exit, level one first.
        fill: share of the panel's face that it covers.
        panel: thin extent over the middle one. slender: middle extent over the long one.
        normal_up: 0..1, how upright the thin axis is. aligned: 0..1, how well the box lies along
            the object's directions.
        end_contact: -1..1, whether it is held at one end of its long axis (1) or not (0).
        end: which end that is, +1 or -1 along the box's long axis.
        contact_spread: extent of the contact over that of the part, along (thin, middle, long).
        twins: number of other parts of nearly the same size.
        on_top: the part's middle is above the parent's.
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
    walls: int
    outward: Array
    exposed: float
    backed: float
    exit: Array
    way_out: float
    depth: float
    face: tuple[float, float]
    fill: float
    panel: float
    slender: float
    normal_up: float
    aligned: float
    end_contact: float
    end: float
    contact_spread: Array
    twins: int
    on_top: float
    parts: int


def look(context: PartContext) -> Looks:
    """Measure one part."""
    scene, shape, base = context.scene, context.shape, context.base
    box = shape.box
    height = max(float(scene.high[2] - scene.low[2]), 1e-6)
    disc = shape.roundest
    axis_up = abs(float(disc.axis @ UP)) if disc is not None else 0.0
    covers = context.covers
    axes = context.directions
    up = int(np.argmax(axes[:, 2]))
    down = (up + 3) % 6
    side = [k for k in range(6) if k not in (up, down)]
    outward = int(np.argmax(context.outwardness))
    ways = {k: (1 - covers[k]) * (0.35 + 0.65 * covers[(k + 3) % 6]) for k in side}
    exit_ = max(ways, key=lambda k: (round(ways[k], 2), -k))
    across = [2 * float(box.half[k]) for k in (x % 3 for x in side) if k != exit_ % 3][:1]
    across.append(2 * float(box.half[up % 3]))
    thin, middle, long = shape.order
    end_contact, end = _end_contact(context, long)
    contact = box.local(context.contact)
    spread = np.array(
        [np.ptp(contact[:, k]) / max(2 * float(box.half[k]), 1e-6) for k in (thin, middle, long)]
    )
    return Looks(
        size=shape.size,
        relative=shape.size / max(base.size, 1e-6),
        disc=disc,
        # Noise thickens a thin disc.
        flat=max(0.0, disc.half - 2.5 * shape.noise) / max(disc.radius, 1e-6) if disc else 0.0,
        axis_up=axis_up,
        scanned=shape.scanned,
        ball=shape.ball,
        height=float((shape.center[2] - scene.low[2]) / height),
        grounded=float(shape.low[2] - scene.low[2]) < 0.03 * height + 0.005,
        top=float(covers[up]),
        bottom=float(covers[down]),
        sides=float(np.mean(covers[side])),
        walls=int((covers > 0.5).sum()),
        outward=axes[outward],
        exposed=1 - float(covers[outward]),
        backed=float(covers[(outward + 3) % 6]),
        exit=axes[exit_],
        way_out=float(ways[exit_]),
        depth=2 * float(box.half[exit_ % 3]),
        face=(across[0], across[1]),
        fill=shape.panel.fill,
        panel=shape.thinness,
        slender=shape.slenderness,
        normal_up=abs(float(box.axes[2, thin])),
        aligned=float(np.abs(box.axes).max(0).min()),
        end_contact=end_contact,
        end=end,
        contact_spread=spread,
        twins=_twins(context),
        on_top=float(shape.center[2] - base.center[2]),
        parts=len(scene),
    )


def _end_contact(context: PartContext, long: int) -> tuple[float, float]:
    half = float(context.shape.box.half[long])
    along = context.shape.box.local(context.shape.points)[:, long] / max(half, 1e-6)
    d = context.distance
    near = {}
    for side in (-1.0, 1.0):
        band = side * along > 0.75
        near[side] = float(np.median(d[band])) if band.sum() >= 3 else float(np.median(d))
    end = 1.0 if near[1.0] < near[-1.0] else -1.0
    gain = abs(near[1.0] - near[-1.0]) / max(2 * half, 1e-6)
    return float(np.clip((gain - 0.1) / 0.4, 0, 1)), end


def _twins(context: PartContext) -> int:
    own = np.sort(context.shape.box.half)
    count = 0
    for j in context.scene.others(context.part):
        if j == context.assembly.root:
            continue
        other = np.sort(context.scene.shapes[j].box.half)
        if np.all(np.abs(other - own) < 0.25 * own + 0.002):
            count += 1
    return count
