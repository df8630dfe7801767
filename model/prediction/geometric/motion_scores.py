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
from model.prediction.builder import left_out
from model.prediction.geometric.context import ACROSS, UP, PartContext, unit
from model.prediction.geometric.sampled_object import CONTACT_GAP
from model.prediction.geometric.shape import NOTHING, TINY, PartShape, blades, same_extents

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Cover:
    """Shares, 0..1, that the parent covers of a part.

    Attributes:
        above, below, sides: from above, from below, from the four sides on average.
        count: covered sides of six. outward: (3,) open direction, working frame.
        exposed: how open it is. backed: how much of the parent lies behind.
    """

    above: float
    below: float
    sides: float
    count: int
    outward: Array
    exposed: float
    backed: float


@dataclass(frozen=True, eq=False)
class Exit:
    """The way in which a drawer would open.

    Attributes:
        direction: (3,) horizontal. score: 0..1, 1 with nothing in front and the parent behind.
        depth: extent along it. face: horizontal and other extent across it.
    """

    direction: Array
    score: float
    depth: float
    face: tuple[float, float]


@dataclass(frozen=True, eq=False)
class PartFeatures:
    """Features of one part; lengths in diagonals of the object.

    Attributes:
        shape: of the part. relative: its size over that of its parent.
        flat: half thickness over radius of the disc; 0 without one.
        axis_up: 0..1, how vertical the disc's axis is.
        height: of the part's centre, 0 at the object's bottom, 1 at its top.
        grounded: reaches the object's bottom.
        normal_up: 0..1, how vertical the thin axis is. aligned: 0..1, how well the box is aligned
            with the object's directions.
        end_contact: 0..1, 1 if it is held at one end of its long axis.
        contact_spread: extent of the contact over that of the part, along (thin, middle, long).
        same_size: number of other parts of nearly the same size.
        above_parent: height of its centre above that of the parent.
        parts: number of parts of the object.
    """

    shape: PartShape
    relative: float
    flat: float
    axis_up: float
    height: float
    grounded: bool
    cover: Cover
    exit: Exit
    normal_up: float
    aligned: float
    end_contact: float
    contact_spread: Array
    same_size: int
    above_parent: float
    parts: int


EXIT, GROUND, COVERED, NOISE = (0.35, 0.65), (0.03, 0.005), 0.5, 2.5
"""Shares of an exit without and with a parent behind; height over the object's, and diagonals, up
to which a part is grounded; least cover of a covered side; noises that thicken a disc."""
END, GAIN, SAME_SIZE = 0.75, (0.1, 0.4), (0.25, 0.002)
"""Place of an end over half the length; least and full difference of the ends' gaps over the
length; share and diagonals by which equal extents differ."""


def measure_features(context: PartContext) -> PartFeatures:
    """Measure one part."""
    sampled, shape, base = context.sampled, context.shape, context.parent_shape
    box, disc, covers = shape.box, shape.roundest, context.covers
    height = max(float(sampled.high[2] - sampled.low[2]), TINY)
    axes = context.directions
    up = int(np.argmax(axes[:, 2]))
    down = (up + 3) % 6
    side = [k for k in range(6) if k not in (up, down)]
    outward = int(np.argmax(context.outwardness))
    exits = {k: (1 - covers[k]) * (EXIT[0] + EXIT[1] * covers[(k + 3) % 6]) for k in side}
    exit_ = max(exits, key=lambda k: (round(exits[k], 2), -k))
    across = next(k % 3 for k in side if k % 3 != exit_ % 3)
    thin, _, long = shape.order
    contact = box.local(context.contact)
    spread = [np.ptp(contact[:, k]) / max(2 * float(box.half[k]), TINY) for k in shape.order]
    face = 2 * float(box.half[across]), 2 * float(box.half[up % 3])
    open_, behind = 1 - float(covers[outward]), float(covers[(outward + 3) % 6])
    around = float(covers[up]), float(covers[down]), float(np.mean(covers[side]))
    cover = Cover(*around, int((covers > COVERED).sum()), axes[outward], open_, behind)
    return PartFeatures(
        shape=shape,
        relative=shape.size / max(base.size, TINY),
        # Noise thickens a thin disc.
        flat=max(0.0, disc.half - NOISE * shape.noise) / max(disc.radius, TINY) if disc else 0.0,
        axis_up=abs(float(disc.axis @ UP)) if disc is not None else 0.0,
        height=float((shape.center[2] - sampled.low[2]) / height),
        grounded=float(shape.low[2] - sampled.low[2]) < GROUND[0] * height + GROUND[1],
        cover=cover,
        exit=Exit(axes[exit_], float(exits[exit_]), 2 * float(box.half[exit_ % 3]), face),
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
    along = context.shape.box.local(context.shape.points)[:, long] / max(half, TINY)
    d = context.distance
    near = {}
    for side in (-1.0, 1.0):
        band = side * along > END
        near[side] = float(np.median(d[band])) if band.sum() >= 3 else float(np.median(d))
    gain = abs(near[1.0] - near[-1.0]) / max(2 * half, TINY)
    return float(np.clip((gain - GAIN[0]) / GAIN[1], 0, 1))


def _count_same_size(context: PartContext) -> int:
    shapes, root = context.sampled.shapes, context.assembly.root
    others = (shapes[j] for j in context.sampled.others(context.part) if j != root)
    return sum(same_extents(other, context.shape, *SAME_SIZE) for other in others)


Scores = dict[Mechanism, float]

LAP = 0.5 * CONTACT_GAP
"""Smallest overlap (diagonals) of panels that slide past each other; the edges of neighbours in one
plane are located to within that."""

NEXT_TO = 0.06
"""Largest gap (diagonals) between adjacent fronts."""

ROD, THIN, LYING, TALL = (0.42, 0.2), (0.32, 0.2), (0.5, 0.4), (0.95, 0.3)
SMALL, LARGE, HUGE, HALF = (0.14, 0.08), (0.2, 0.15), (0.42, 0.1), (0.5, 0.3)
DEEP, WIDE, LOW, FLAT = (0.8, 0.5), (1.9, 0.6), (0.22, 0.1), (1.0, 0.4)
EMBEDDED, SOLID = (3.0, 2.0), (0.25, 0.3)
"""Middle and width of ramps over ratios, sizes (diagonals), shares and counts. These and the
numbers below were written while looking at PartNet-Mobility; none was fitted."""
IDLE: Scores = {"lift": 0.1, "tilt": 0.3, "hinge": 0.8, "flap": 0.5, "toggle": 0.2, "temple": 0.2}
IDLE |= {"slide_out": 0.3, "lever": 0.3, "swing": 0.2, "pivot": 0.2, "slide_along": 0.2}
"""Score of a mechanism without a cue."""
LEVEL, STANDING = 0.35, 0.3
"""Largest cosine between up and a level axis or a standing panel's normal."""
UPRIGHT, ALONG = 0.8, 0.9
"""Cosines: an axis is upright, or along another one."""


def _step(value: float, ramp: tuple[float, float]) -> float:
    """0 well below the ramp's middle, 1 well above, linear over its width."""
    at, width = ramp
    return float(np.clip((value - at) / width + 0.5, 0, 1))


HELD, ROD_IS_PANEL = (0.4, 0.35), 0.8
"""Least contact at one end, or largest spread of the contact, of what a stem holds; and the share
by which a rod is no panel."""


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
    rod = 1 - _step(k.shape.slenderness, ROD)
    large = _step(k.shape.size, LARGE)
    held_below = k.end_contact > HELD[0] or max(k.contact_spread[1:]) < HELD[1]
    return _Cues(
        part,
        k,
        others,
        small=1 - _step(k.shape.size, SMALL),
        large=large,
        rod=rod,
        panel=(1 - _step(k.shape.thinness, THIN))
        * _step(k.shape.panel.fill, HALF)
        * (1 - ROD_IS_PANEL * rod),
        standing=1 - _step(k.normal_up, LYING),
        on_stem=held_below and k.above_parent > 0 and large > HALF[0],
        upright_disc=k.shape.roundest is not None and k.axis_up > UPRIGHT,
        level_disc=k.shape.roundest is not None and k.axis_up < LEVEL,
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


BUTTON, KNOB, WHEEL, BALL, PROPELLER, CLOCK_HAND = 2.2, 2.2, 2.6, 2.5, 4.0, 3.0
DISC, LEVEL_DISC, PULLEY, NO_DISC, HIDDEN, IN_ROW = 0.6, 1.0, 1.2, 1.5, 0.5, 0.15
"""Scores of round and of small parts."""
KNOB_SIZE, KNOB_FLAT, WHEEL_SIZE, DRUM_SIZE = (0.035, 0.085, 0.3), (0.27, 0.15, 1.6), 0.6, 0.25
"""Diagonals, and half thickness over radius: least, least of small ones, and largest."""
WHEEL_FLAT, ROUND_DOOR, NEAR_GROUND = (1.2, 0.9), (0.8, 0.3), (0.2, 0.3)
"""Half thickness over radius; least cover behind, and size and thickness; heights 0..1."""


def _round_parts(c: _Cues) -> Scores:
    """Knobs, wheels, balls, propellers, clock hands; all other small parts are buttons."""
    k, disc = c.features, c.features.shape.roundest
    press = BUTTON * c.small - HIDDEN * (1 - k.cover.exposed)
    many = IN_ROW * min(k.same_size, 6) * c.small
    spin = 0.0
    if disc is not None:
        clear = disc.radius > 10 * c.part.shape.noise
        spin += DISC
        knob = k.flat >= KNOB_FLAT[0] or (k.shape.size >= KNOB_SIZE[1] and k.flat >= KNOB_FLAT[1])
        stands = abs(float(disc.axis @ unit(c.part.shape.center - c.part.contact_center))) > UPRIGHT
        faces_out = stands or abs(float(disc.axis @ k.cover.outward)) > ALONG
        knob = knob and KNOB_SIZE[0] < k.shape.size < KNOB_SIZE[2] and k.flat < KNOB_FLAT[2]
        if clear and knob and faces_out:
            spin += KNOB
            many = 0.0  # a row of knobs
        wheel = c.level_disc and (clear or k.grounded)
        if wheel and k.flat < WHEEL_FLAT[0] and k.shape.size < WHEEL_SIZE:
            spin += WHEEL if k.grounded else PULLEY * (1 - _step(k.height, HALF))
        if wheel and k.flat < WHEEL_FLAT[1]:
            spin += LEVEL_DISC
        if k.shape.ball and clear:
            spin += BALL
        covers_front = k.cover.backed > ROUND_DOOR[0] and not k.grounded and k.cover.count <= 2
        if (
            c.level_disc
            and covers_front
            and k.shape.size > ROUND_DOOR[1]
            and k.flat < ROUND_DOOR[1]
        ):
            spin -= NO_DISC  # a round door
    if blades(c.part.shape) is not None:
        spin += PROPELLER
    if c.part.clock_hand:
        spin += CLOCK_HAND
    if k.shape.scanned and k.grounded and k.height < NEAR_GROUND[0]:
        spin += WHEEL * c.small  # a wheel that was scanned in part
    drum = c.level_disc and k.cover.count >= 4 and k.shape.size > DRUM_SIZE
    if drum and disc is not None and abs(float(disc.axis @ k.exit.direction)) > ALONG:
        spin += BALL
    return {"press": press + many, "spin": spin}


TURNTABLE, CASTER, ON_STEM, NO_PANEL, SCREEN, LAMP = 2.8, 3.5, 1.0, 0.9, 1.2, 1.5
CAP, LIKE_POT, LIKE_BOTTLE = 2.9, 1.2, 1.0
"""Scores of parts that lie or stand on others."""
CAP_COVER, CAP_FLAT, CAP_WIDE = (0.3, 0.4, 0.6), 0.085, (0.1, 0.55)
ABOVE, BOTTLE, SEAT_SIZE = 0.02, 1.1, 0.4
"""Cover above, cover below and height of a cap; half thickness over radius; radius over the width
below; diagonals above; height over width of an object with a screw cap; diagonals of a seat."""


def _parts_on_top(c: _Cues) -> Scores:
    """Caps, pot lids, turntables, casters, seats, heads on stems."""
    k, disc, part = c.features, c.features.shape.roundest, c.part
    swivel, screw, lift = 0.0, 0.0, IDLE["lift"]
    if c.upright_disc and k.flat < LEVEL and k.cover.above > HALF[0] and k.cover.below > HALF[0]:
        swivel += TURNTABLE  # a turntable inside
    if _holds_wheel(c):
        swivel += CASTER
    if c.on_stem:
        swivel += ON_STEM + NO_PANEL * (1 - c.panel)
    wheels = sum(
        o.shape.roundest is not None and o.axis_up < LEVEL and o.grounded for o in c.others.values()
    )
    if c.on_stem and wheels >= 3 and k.shape.size > SEAT_SIZE:
        screw = swivel + ON_STEM  # the seat of an office chair
    if c.upright_disc and disc is not None:
        aside = float(np.linalg.norm((part.shape.center - part.parent_shape.center)[:2]))
        width = 2 * float(np.sort(part.parent_shape.box.half)[0])
        cap = (
            k.cover.above < CAP_COVER[0]
            and (k.cover.below > CAP_COVER[1] or k.shape.scanned)
            and k.height > CAP_COVER[2]
            and k.flat > CAP_FLAT
            and disc.radius > CAP_WIDE[0] * width
            and aside < CAP_COVER[2] * disc.radius
            and float(part.parent_shape.high[2]) < float(part.shape.high[2]) + ABOVE
        )
        if cap:
            tall = _tallness(part) > BOTTLE
            if tall and disc.radius > CAP_WIDE[1] * width:
                swivel = max(swivel, CAP)  # wider than what it caps: the head of a mill
            else:
                screw = max(screw, CAP if tall else LIKE_POT)
            lift = LIKE_BOTTLE if tall else CAP
    tilt = IDLE["tilt"] + (SCREEN * c.panel if c.on_stem else 0.0)
    if part.parent != part.assembly.root and part.parent_shape.slenderness < LEVEL:
        tilt += LAMP * (1 - c.small)  # the head of a lamp
        swivel -= ON_STEM
    return {"swivel": swivel, "screw": screw, "lift": lift, "tilt": tilt}


PANEL, EXPOSED, UNCOVERED, AJAR, ROCKS, SLIDES, DROPS = 1.2, 0.4, 0.6, (0.8, 0.3), 1.5, 3.0, 0.8
"""Scores of panels."""
SQUARE, ROCKER, TOP_BAR = 0.985, (0.2, 0.75, 0.3), (0.75, 0.5, 0.15)
"""Cosine up to which a panel is ajar; size over its parent's and thickness of a rocker; width of a
panel over its parent's, height and length or offset of its bar over half the panel's extents."""


def _panels(c: _Cues) -> Scores:
    """Doors, lids, sliding panels, rockers."""
    k, part = c.features, c.part
    hinge = IDLE["hinge"] + c.panel * c.standing * (PANEL * c.large + EXPOSED * k.cover.exposed)
    between = _step(min(k.cover.above, k.cover.below), HALF)  # a rack, no lid
    lid = PANEL * c.large + UNCOVERED * (1 - k.cover.above)
    flap = IDLE["flap"] + c.panel * (1 - c.standing) * (1 - between) * lid
    if k.aligned < SQUARE:  # ajar
        flap += c.panel * (AJAR[0] * c.large * (1 - c.standing) + AJAR[1])
        hinge += c.panel * AJAR[0] * c.large * c.standing
    toggle = IDLE["toggle"]
    if (
        k.parts <= 4
        and part.closed
        and ROCKER[0] < k.relative < ROCKER[1]
        and k.shape.thinness > ROCKER[2]
    ):
        toggle += ROCKS * k.cover.exposed * k.cover.backed * (k.shape.roundest is None)
    slide = SLIDES * c.panel * c.standing * passes_sibling(part)
    drop = (hinge + DROPS) * c.panel * c.standing * _top_bar(part)
    return {"hinge": hinge, "flap": flap, "drop": drop, "toggle": toggle, "slide_along": slide}


def _top_bar(part: PartContext) -> float:
    """0..1: strength of a level handle in the middle of the upper edge of a standing panel as wide
    as its parent, as ovens and dishwashers have it."""
    box, normal = part.shape.box, part.shape.panel.normal
    up = max((k for k in range(3) if k != normal), key=lambda k: abs(float(box.axes[2, k])))
    level = 3 - up - normal
    reach = part.parent_shape.box.reach(box.axes[:, level])
    if box.half[level] < TOP_BAR[0] * reach or left_out("drop-down doors"):
        return 0.0  # one of several doors
    sign = np.sign(box.axes[2, up])
    return max(
        (
            strength
            for at, spread, strength in part.grips
            if sign * at[up] > TOP_BAR[1] * box.half[up]
            and abs(at[level]) < TOP_BAR[2] * box.half[level]
            and spread[level] > max(2 * spread[up], TOP_BAR[2] * box.half[level])
        ),
        default=0.0,
    )


DRAWER, FRONT, FREEZER, NO_DRAWER = (0.5, 1.5), (2.4, 1.8), 3.4, 2.0
"""Scores of drawers: without depth, for depth; of scanned and modelled fronts; of what spans doors;
of round parts."""


def _drawers(c: _Cues) -> Scores:
    """Parts that can leave horizontally, with the parent around and behind them."""
    k, part = c.features, c.part
    embedded = _step(k.cover.count, EMBEDDED)
    deep = _step(k.exit.depth / max(min(k.exit.face), TINY), DEEP)
    drawer = (
        k.exit.score * embedded * (DRAWER[0] + DRAWER[1] * deep) + k.exit.score * deep * c.large
    )
    wide = _step(k.exit.face[0] / max(k.exit.face[1], TINY), WIDE)
    low = 1 - _step(k.exit.face[1] / max(part.parent_shape.size, TINY), LOW)
    if k.shape.scanned:
        # A scan shows only the front of a closed drawer, and perhaps a rim.
        flat = 1 - _step(k.exit.depth / max(k.exit.face[0], TINY), FLAT)
        drawer += FRONT[0] * part.closed * wide * low * c.large * flat
    else:
        drawer += FRONT[1] * k.exit.score * c.panel * c.standing * wide * low * c.large
    drawer += FREEZER * part.closed * c.panel * c.standing * c.large * spans_doors(part)
    return {
        "slide_out": IDLE["slide_out"]
        + drawer
        - (NO_DRAWER if k.shape.roundest is not None else 0.0)
    }


TEMPLE, SHUT_LEVER, LEVER, BAIL = (1.3, 0.4, 0.5), 0.5, (0.9, 0.8, 2.6), (1.6, 2.2)
"""Scores of long parts: held at one end, large, paired; middling, held, small; swinging, pulled."""


def _long_parts(c: _Cues) -> Scores:
    """Long parts held at one or both ends."""
    k, part = c.features, c.part
    temple = IDLE["temple"] + c.rod * (TEMPLE[0] * k.end_contact + TEMPLE[1] * c.large)
    if k.same_size and not part.closed:
        temple += TEMPLE[2] * c.rod * k.end_contact
    middling = (
        (1 - c.small) * (1 - _step(k.shape.size, HUGE)) * (SHUT_LEVER if part.closed else 1.0)
    )
    lever = IDLE["lever"] + middling * (1 - c.panel) * (LEVER[0] + LEVER[1] * k.end_contact)
    lever += LEVER[2] * c.small * c.rod * k.end_contact * (1 - c.panel)
    bail, legs = _bail(part, k)
    bail *= 1 - c.panel  # one face of a scanned door is as thin as a bail's wire
    # A bail with long legs that stands on its parent is pulled out of it.
    return {
        "temple": temple,
        "lever": lever,
        "swing": IDLE["swing"] + BAIL[0] * bail * (1 - legs),
        "lift": BAIL[1] * bail * legs,
    }


PAIR, HANDLE = (0.5, 3.2, 2.6), (0.6, 0.33, 0.85)
"""Scores of rods, blades and caps; a blade's size or cover, the slenderness of its handle, and the
size of one of two equal parts, over those of the parent."""


def _pairs(c: _Cues) -> Scores:
    """Two long parts, one turning in or sliding along the other, or two equal ones."""
    k, part = c.features, c.part
    scores: Scores = {"slide_along": IDLE["slide_along"]}
    scores["pivot"] = IDLE["pivot"] + PAIR[0] * c.rod * (k.parts <= 4)
    base = part.parent_shape
    pair = (
        k.parts <= 3 and not k.same_size and k.relative > HANDLE[0] and base.slenderness < HANDLE[1]
    )
    pair = pair or (k.parts == 2 and k.relative > HANDLE[2] and same_extents(part.shape, base))
    if pair and c.rod > HALF[0]:
        # A blade free on one edge turns out of its handle; an enclosed one slides.
        middle = part.shape.order[1]
        held = min(part.covers[middle], part.covers[middle + 3]) > HANDLE[0] and k.cover.count >= 4
        scores["slide_along" if held else "pivot"] += PAIR[1] * c.rod
    elif _caps_the_end(part):
        scores["slide_along"] += PAIR[2]
    return scores


PEN_SLENDER, CAP_SIZE, CAP_PLACE, CAP_OFFSET, CAP_THIN, CAP_THICK = 0.5, 0.8, 0.6, 0.35, 0.55, 1.6
PEN_SLACK = 0.005
"""A pen's slenderness; its cap's measures over the pen's; and the slack (diagonals)."""


def _caps_the_end(part: PartContext) -> bool:
    """True if it is on one end of a long parent and equally thick, as the cap of a pen."""
    shape, base = part.shape, part.parent_shape
    thin, middle, long = base.order
    if base.slenderness > PEN_SLENDER or shape.size > CAP_SIZE * base.size:
        return False
    axes = base.box.axes
    step = axes.T @ (shape.center - base.center)
    reach = np.array([shape.box.reach(axes[:, k]) for k in (thin, middle)])
    thick = base.box.half[[thin, middle]]
    return bool(
        abs(axes[2, long]) < ACROSS
        and abs(step[long]) > CAP_PLACE * base.box.half[long]
        and np.all(np.abs(step[[thin, middle]]) < CAP_OFFSET * thick + PEN_SLACK)
        and np.all(reach > CAP_THIN * thick)
        and np.all(reach < CAP_THICK * thick + PEN_SLACK)
    )


def _tallness(context: PartContext) -> float:
    """Height over width of the whole object."""
    extent = context.sampled.high - context.sampled.low
    return float(extent[2] / max(extent[0], extent[1], TINY))


def _holds_wheel(c: _Cues) -> bool:
    """True if it is a small part near the ground that carries a wheel."""
    context = c.part
    if c.features.shape.size > NEAR_GROUND[0] or c.features.height > NEAR_GROUND[1]:
        return False
    for j, other in c.others.items():
        if j == context.part or context.sampled.gap[j, context.part] > 2 * CONTACT_GAP:
            continue
        wheel = other.shape.roundest is not None and other.axis_up < LEVEL and other.grounded
        if wheel and context.assembly.parent[j] == context.part:
            return True
    return False


PASSES, PARALLEL, SPANS = 0.6, 0.98, (1.1, 0.7)
"""Size, distance and overlap of a panel that slides past another over its own; cosine between
parallel normals; width over height and over the doors' width of a front that spans doors."""


def passes_sibling(context: PartContext) -> bool:
    """True if another panel in a parallel plane partly overlaps this one."""
    shape, sampled = context.shape, context.sampled
    n = shape.panel.normal
    axes = shape.box.axes
    thick = shape.panel.high - shape.panel.low
    for j in () if left_out("sliding past") else sampled.others(context.part):
        other = sampled.shapes[j]
        if j in (context.parent, context.assembly.root) or other.size < PASSES * shape.size:
            continue
        if abs(other.box.axes[:, other.panel.normal] @ axes[:, n]) < PARALLEL:
            continue
        step = axes.T @ (other.center - shape.center)
        # Handles shift the centres of boxes, but not the slabs.
        apart = abs(float(axes[:, n] @ (other.slab_center - shape.slab_center)))
        if not PASSES * thick < apart < 5 * thick + ABOVE:
            continue
        lap = [
            shape.box.half[k] + other.box.reach(axes[:, k]) - abs(step[k])
            for k in range(3)
            if k != n
        ]
        narrow = 2 * min(float(shape.box.half[k]) for k in range(3) if k != n)
        if LAP < min(lap) < PASSES * narrow:
            return True
    return False


def spans_doors(context: PartContext) -> bool:
    """True if it is a wide front above or below two or more adjacent doors in its plane, as the
    freezer drawer of a refrigerator."""
    shape, sampled = context.shape, context.sampled
    normal = context.panel_normal
    if abs(normal[2]) > STANDING:
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
    return width > SPANS[0] * height and any(
        len(side) > 1 and sum(side) > SPANS[1] * width for side in doors.values()
    )


BAIL_SIZE, ENDS = 0.15, (0.5, 0.6)
"""Least size (diagonals); the bounds of a bail's middle and of its ends over half its length."""


def _bail(context: PartContext, k: PartFeatures) -> tuple[float, float]:
    """Scores of a bail, held at the two ends of a horizontal axis, and of its long legs.

    Returns:
        0..1, and 0..1: 1 if the bail stands upright on its parent and is higher than wide.
    """
    shape = context.shape
    if k.shape.size < BAIL_SIZE or left_out("bails"):
        return 0.0, 0.0
    contact = context.contact
    best, legs = 0.0, 0.0
    for axis in shape.box.axes.T:
        if abs(axis[2]) > ACROSS:
            continue
        along = (contact - shape.center) @ axis / max(shape.box.reach(axis), TINY)
        middle = float((np.abs(along) < ENDS[0]).mean())
        both = min(float((along > ENDS[1]).mean()), float((along < -ENDS[1]).mean()))
        value = 2 * both * (1 - min(1.0, 2 * middle))
        if value > best:
            best = value
            tall = shape.box.reach(context.upright()) / max(shape.box.reach(axis), TINY)
            legs = _step(tall, TALL) * float(k.above_parent > 0)
    thin_walled = 1 - _step(shape.area / max(2 * shape.size**2, NOTHING), SOLID)
    return float(np.clip(best, 0, 1)) * thin_walled, legs
