"""Scores of the mechanisms for a part without a name, from its features within its object.

The rules are grouped by kinds of objects: round parts, parts on top of others, panels, drawers,
long parts, pairs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from model.core.motion_lexicon import Mechanism
from model.prediction.geometric.context import UP, PartContext, unit
from model.prediction.geometric.sampled_object import CONTACT_GAP
from model.prediction.geometric.shape import Roundness, blades, same_extents

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


Scores = dict[Mechanism, float]

LAP = 0.5 * CONTACT_GAP
"""Smallest overlap (diagonals) of panels that slide past each other; the edges of neighbours in one
plane are located to within that."""

NEXT_TO = 0.06
"""Largest gap (diagonals) between adjacent fronts."""


def _step(value: float, at: float, width: float) -> float:
    """0 well below ``at``, 1 well above, linear in between."""
    return float(np.clip((value - at) / width + 0.5, 0, 1))


@dataclass(frozen=True, eq=False)
class _Cues:
    """Soft classifications (0..1) that several mechanisms share.

    Attributes:
        small, large: in comparison to the object. rod: long and thin. panel: flat and filled.
        standing: the panel's normal is horizontal. on_stem: held by a small area from below.
        upright_disc, level_disc: round about a vertical or horizontal axis.
    """

    part: PartContext
    features: PartFeatures
    others: dict[int, PartFeatures]
    small: float
    large: float
    rod: float
    panel: float
    standing: float
    on_stem: bool
    upright_disc: bool
    level_disc: bool


def _cues(part: PartContext, k: PartFeatures, others: dict[int, PartFeatures]) -> _Cues:
    rod = 1 - _step(k.slender, 0.42, 0.2)
    large = _step(k.size, 0.2, 0.15)
    held_below = k.end_contact > 0.4 or max(k.contact_spread[1:]) < 0.35
    return _Cues(
        part,
        k,
        others,
        small=1 - _step(k.size, 0.14, 0.08),
        large=large,
        rod=rod,
        panel=(1 - _step(k.panel, 0.32, 0.2)) * _step(k.fill, 0.5, 0.3) * (1 - 0.8 * rod),
        standing=1 - _step(k.normal_up, 0.5, 0.4),
        on_stem=held_below and k.above_parent > 0 and large > 0.5,
        upright_disc=k.disc is not None and k.axis_up > 0.8,
        level_disc=k.disc is not None and k.axis_up < 0.35,
    )


def motion_scores(
    part: PartContext, features: PartFeatures, others: dict[int, PartFeatures]
) -> Scores:
    """Mechanism → score; the highest is the likeliest.

    Args:
        part: within its object. features: of the part. others: of all unnamed parts, by index.
    """
    c = _cues(part, features, others)
    scores: Scores = {}
    for group in (_round_parts, _parts_on_top, _panels, _drawers, _long_parts, _pairs):
        name = f"the rule on {group.__name__.strip('_').replace('_', ' ')}"
        for mechanism, value in part.attempt(name, partial(group, c), {}).items():
            scores[mechanism] = scores.get(mechanism, 0.0) + value
    return scores


def _round_parts(c: _Cues) -> Scores:
    """Knobs, wheels, balls, propellers, clock hands; all other small parts are buttons."""
    k, disc = c.features, c.features.disc
    press = 2.2 * c.small - 0.5 * (1 - k.exposed)
    many = 0.15 * min(k.same_size, 6) * c.small
    spin = 0.0
    if disc is not None:
        clear = disc.radius > 10 * c.part.shape.noise
        spin += 0.6
        knob = k.flat >= 0.27 or (k.size >= 0.085 and k.flat >= 0.15)
        stands = abs(float(disc.axis @ unit(c.part.shape.center - c.part.contact_center))) > 0.8
        faces_out = stands or abs(float(disc.axis @ k.outward)) > 0.9
        if clear and knob and 0.035 < k.size < 0.3 and k.flat < 1.6 and faces_out:
            spin += 2.2
            many = 0.0  # a row of knobs
        if c.level_disc and k.flat < 1.2 and k.size < 0.6 and (clear or k.grounded):
            spin += 2.6 if k.grounded else 1.2 * (1 - _step(k.height, 0.5, 0.3))
        if c.level_disc and k.flat < 0.9 and (clear or k.grounded):
            spin += 1.0
        if k.ball and clear:
            spin += 2.5
        covers_front = k.backed > 0.8 and not k.grounded and k.covered_sides <= 2
        if c.level_disc and covers_front and k.size > 0.3 and k.flat < 0.3:
            spin -= 1.5  # a round door
    if blades(c.part.shape) is not None:
        spin += 4.0
    if c.part.clock_hand:
        spin += 3.0
    if k.scanned and k.grounded and k.height < 0.2:
        spin += 2.6 * c.small  # a wheel that was scanned in part
    drum = c.level_disc and k.covered_sides >= 4 and k.size > 0.25
    if drum and disc is not None and abs(float(disc.axis @ k.exit)) > 0.9:
        spin += 2.5
    return {"press": press + many, "spin": spin}


def _parts_on_top(c: _Cues) -> Scores:
    """Caps, pot lids, turntables, casters, seats, heads on stems."""
    k, disc, part = c.features, c.features.disc, c.part
    swivel, screw, lift = 0.0, 0.0, 0.1
    if c.upright_disc and k.flat < 0.35 and k.top > 0.5 and k.bottom > 0.5:
        swivel += 2.8  # a turntable inside
    if _holds_wheel(c):
        swivel += 3.5
    if c.on_stem:
        swivel += 1.0 + 0.9 * (1 - c.panel)
    wheels = sum(o.disc is not None and o.axis_up < 0.35 and o.grounded for o in c.others.values())
    if c.on_stem and wheels >= 3 and k.size > 0.4:
        screw = swivel + 1.0  # the seat of an office chair
    if c.upright_disc and disc is not None:
        aside = float(np.linalg.norm((part.shape.center - part.parent_shape.center)[:2]))
        width = 2 * float(np.sort(part.parent_shape.box.half)[0])
        cap = (
            k.top < 0.3
            and (k.bottom > 0.4 or k.scanned)
            and k.height > 0.6
            and k.flat > 0.085
            and disc.radius > 0.1 * width
            and aside < 0.6 * disc.radius
            and float(part.parent_shape.high[2]) < float(part.shape.high[2]) + 0.02
        )
        if cap:
            tall = _tallness(part) > 1.1
            if tall and disc.radius > 0.55 * width:
                swivel = max(swivel, 2.9)  # wider than what it caps: the head of a mill
            else:
                screw = max(screw, 2.9 if tall else 1.2)
            lift = 1.0 if tall else 2.9
    tilt = 0.3 + (1.2 * c.panel if c.on_stem else 0.0)
    if part.parent != part.assembly.root and part.parent_shape.slenderness < 0.35:
        tilt += 1.5 * (1 - c.small)  # the head of a lamp
        swivel -= 1.0
    return {"swivel": swivel, "screw": screw, "lift": lift, "tilt": tilt}


def _panels(c: _Cues) -> Scores:
    """Doors, lids, sliding panels, rockers."""
    k, part = c.features, c.part
    hinge = 0.8 + c.panel * c.standing * (1.2 * c.large + 0.4 * k.exposed)
    between = _step(min(k.top, k.bottom), 0.5, 0.3)  # a rack, no lid
    lid = 1.2 * c.large + 0.6 * (1 - k.top)
    flap = 0.5 + c.panel * (1 - c.standing) * (1 - between) * lid
    if k.aligned < 0.985:  # ajar
        flap += c.panel * (0.8 * c.large * (1 - c.standing) + 0.3)
        hinge += c.panel * 0.8 * c.large * c.standing
    toggle = 0.2
    if k.parts <= 4 and part.closed and 0.2 < k.relative < 0.75 and k.panel > 0.3:
        toggle += 1.5 * k.exposed * k.backed * (k.disc is None)
    slide = 3.0 * c.panel * c.standing * passes_sibling(part)
    drop = (hinge + 0.8) * c.panel * c.standing * _top_bar(part)
    return {"hinge": hinge, "flap": flap, "drop": drop, "toggle": toggle, "slide_along": slide}


def _top_bar(part: PartContext) -> float:
    """0..1: strength of a level handle in the middle of the upper edge of a standing panel as wide
    as its parent, as ovens and dishwashers have it."""
    box, normal = part.shape.box, part.shape.panel.normal
    up = max((k for k in range(3) if k != normal), key=lambda k: abs(float(box.axes[2, k])))
    level = 3 - up - normal
    if box.half[level] < 0.75 * part.parent_shape.box.reach(box.axes[:, level]):
        return 0.0  # one of several doors
    sign = np.sign(box.axes[2, up])
    return max(
        (
            strength
            for at, spread, strength in part.grips
            if sign * at[up] > 0.5 * box.half[up]
            and abs(at[level]) < 0.15 * box.half[level]
            and spread[level] > max(2 * spread[up], 0.15 * box.half[level])
        ),
        default=0.0,
    )


def _drawers(c: _Cues) -> Scores:
    """Parts that can leave horizontally, with the parent around and behind them."""
    k, part = c.features, c.part
    embedded = _step(k.covered_sides, 3.0, 2.0)
    deep = _step(k.depth / max(min(k.face), 1e-6), 0.8, 0.5)
    drawer = k.exit_score * embedded * (0.5 + 1.5 * deep) + k.exit_score * deep * c.large
    wide = _step(k.face[0] / max(k.face[1], 1e-6), 1.9, 0.6)
    low = 1 - _step(k.face[1] / max(part.parent_shape.size, 1e-6), 0.22, 0.1)
    if k.scanned:
        # A scan shows only the front of a closed drawer, and perhaps a rim.
        flat = 1 - _step(k.depth / max(k.face[0], 1e-6), 1.0, 0.4)
        drawer += 2.4 * part.closed * wide * low * c.large * flat
    else:
        drawer += 1.8 * k.exit_score * c.panel * c.standing * wide * low * c.large
    drawer += 3.4 * part.closed * c.panel * c.standing * c.large * spans_doors(part)
    return {"slide_out": 0.3 + drawer - (2.0 if k.disc is not None else 0.0)}


def _long_parts(c: _Cues) -> Scores:
    """Long parts held at one or both ends."""
    k, part = c.features, c.part
    temple = 0.2 + c.rod * (1.3 * k.end_contact + 0.4 * c.large)
    if k.same_size and not part.closed:
        temple += 0.5 * c.rod * k.end_contact
    middling = (1 - c.small) * (1 - _step(k.size, 0.42, 0.1)) * (0.5 if part.closed else 1.0)
    lever = 0.3 + middling * (1 - c.panel) * (0.9 + 0.8 * k.end_contact)
    lever += 2.6 * c.small * c.rod * k.end_contact * (1 - c.panel)
    bail, legs = _bail(part, k)
    bail *= 1 - c.panel  # one face of a scanned door is as thin as a bail's wire
    # A bail with long legs that stands on its parent is pulled out of it.
    return {
        "temple": temple,
        "lever": lever,
        "swing": 0.2 + 1.6 * bail * (1 - legs),
        "lift": 2.2 * bail * legs,
    }


def _pairs(c: _Cues) -> Scores:
    """Two long parts, one turning in or sliding along the other, or two equal ones."""
    k, part = c.features, c.part
    scores: Scores = {"pivot": 0.2 + 0.5 * c.rod * (k.parts <= 4), "slide_along": 0.2}
    base = part.parent_shape
    pair = k.parts <= 3 and not k.same_size and k.relative > 0.6 and base.slenderness < 0.33
    pair = pair or (k.parts == 2 and k.relative > 0.85 and same_extents(part.shape, base))
    if pair and c.rod > 0.5:
        # A blade free on one edge turns out of its handle; an enclosed one slides.
        middle = part.shape.order[1]
        held = min(part.covers[middle], part.covers[middle + 3]) > 0.6 and k.covered_sides >= 4
        scores["slide_along" if held else "pivot"] += 3.2 * c.rod
    elif _caps_the_end(part):
        scores["slide_along"] += 2.6
    return scores


def _caps_the_end(part: PartContext) -> bool:
    """True if it is on one end of a long parent and equally thick, as the cap of a pen."""
    shape, base = part.shape, part.parent_shape
    thin, middle, long = base.order
    if base.slenderness > 0.5 or shape.size > 0.8 * base.size:
        return False
    axes = base.box.axes
    step = axes.T @ (shape.center - base.center)
    reach = np.array([shape.box.reach(axes[:, k]) for k in (thin, middle)])
    thick = base.box.half[[thin, middle]]
    return bool(
        abs(axes[2, long]) < 0.5
        and abs(step[long]) > 0.6 * base.box.half[long]
        and np.all(np.abs(step[[thin, middle]]) < 0.35 * thick + 0.005)
        and np.all(reach > 0.55 * thick)
        and np.all(reach < 1.6 * thick + 0.005)
    )


def _tallness(context: PartContext) -> float:
    """Height over width of the whole object."""
    extent = context.sampled.high - context.sampled.low
    return float(extent[2] / max(extent[0], extent[1], 1e-6))


def _holds_wheel(c: _Cues) -> bool:
    """True if it is a small part near the ground that carries a wheel."""
    context = c.part
    if c.features.size > 0.2 or c.features.height > 0.3:
        return False
    for j, other in c.others.items():
        if j == context.part or context.sampled.gap[j, context.part] > 2 * CONTACT_GAP:
            continue
        wheel = other.disc is not None and other.axis_up < 0.35 and other.grounded
        if wheel and context.assembly.parent[j] == context.part:
            return True
    return False


def passes_sibling(context: PartContext) -> bool:
    """True if another panel in a parallel plane partly overlaps this one."""
    shape, sampled = context.shape, context.sampled
    n = shape.panel.normal
    axes = shape.box.axes
    thick = shape.panel.high - shape.panel.low
    for j in sampled.others(context.part):
        other = sampled.shapes[j]
        if j in (context.parent, context.assembly.root) or other.size < 0.6 * shape.size:
            continue
        if abs(other.box.axes[:, other.panel.normal] @ axes[:, n]) < 0.98:
            continue
        step = axes.T @ (other.center - shape.center)
        # Handles shift the centres of boxes, but not the slabs.
        apart = abs(float(axes[:, n] @ (other.slab_center - shape.slab_center)))
        if not 0.6 * thick < apart < 5 * thick + 0.02:
            continue
        lap = [
            shape.box.half[k] + other.box.reach(axes[:, k]) - abs(step[k])
            for k in range(3)
            if k != n
        ]
        narrow = 2 * min(float(shape.box.half[k]) for k in range(3) if k != n)
        if LAP < min(lap) < 0.6 * narrow:
            return True
    return False


def spans_doors(context: PartContext) -> bool:
    """True if it is a wide front above or below two or more adjacent doors in its plane, as the
    freezer drawer of a refrigerator."""
    shape, sampled = context.shape, context.sampled
    normal = context.panel_normal
    if abs(normal[2]) > 0.3:
        return False
    level = unit(np.cross(UP, normal))
    width, height = 2 * shape.box.reach(level), float(shape.high[2] - shape.low[2])
    doors: dict[float, list[float]] = {1.0: [], -1.0: []}
    for j in sampled.others(context.part):
        other = sampled.shapes[j]
        if j in (context.parent, context.assembly.root):
            continue
        wide, tall = 2 * other.box.reach(level), float(other.high[2] - other.low[2])
        step = other.center - shape.center
        in_plane = abs(float((other.slab_center - shape.slab_center) @ normal)) < 2 * CONTACT_GAP
        within = abs(float(step @ level)) + wide / 2 < width / 2 + 2 * CONTACT_GAP
        gap = abs(float(step[2])) - (height + tall) / 2
        level_with = step[2] == 0  # neither above nor below
        if in_plane and within and tall > wide and abs(gap) < NEXT_TO and not level_with:
            doors[float(np.sign(step[2]))].append(wide)
    return width > 1.1 * height and any(
        len(side) > 1 and sum(side) > 0.7 * width for side in doors.values()
    )


def _bail(context: PartContext, k: PartFeatures) -> tuple[float, float]:
    """Scores of a bail, held at the two ends of a horizontal axis, and of its long legs.

    Returns:
        0..1, and 0..1: 1 if the bail stands upright on its parent and is higher than wide.
    """
    shape = context.shape
    if k.size < 0.15:
        return 0.0, 0.0
    contact = context.contact
    best, legs = 0.0, 0.0
    for axis in shape.box.axes.T:
        if abs(axis[2]) > 0.5:
            continue
        along = (contact - shape.center) @ axis / max(shape.box.reach(axis), 1e-6)
        middle = float((np.abs(along) < 0.5).mean())
        both = min(float((along > 0.6).mean()), float((along < -0.6).mean()))
        value = 2 * both * (1 - min(1.0, 2 * middle))
        if value > best:
            best = value
            tall = shape.box.reach(context.upright()) / max(shape.box.reach(axis), 1e-6)
            legs = _step(tall, 0.95, 0.3) * float(k.above_parent > 0)
    thin_walled = 1 - _step(shape.area / max(2 * shape.size**2, 1e-9), 0.25, 0.3)
    return float(np.clip(best, 0, 1)) * thin_walled, legs
