"""How each part moves: by its name where that says it, else by what it looks like."""

from __future__ import annotations

import numpy as np

from model.geometric.context import Assembly, PartContext
from model.geometric.looks import Looks, look
from model.geometric.scene import TOUCHING
from model.geometric.spins import blades
from model.geometric.vocabulary import Mechanism, mechanism_of


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
        said, _ = mechanism_of(shape.name, assembly.scene.category)
        if said is not None:
            mechanisms[i], reasons[i], sureness[i] = said, f"named {shape.name!r}", 0.95
        else:
            unnamed[i] = look(PartContext(assembly, i))
    for i, looks in unnamed.items():
        scores = shape_scores(PartContext(assembly, i), looks, unnamed)
        best = max(scores, key=lambda m: scores[m])
        values = np.array(list(scores.values()))
        weights = np.exp(1.5 * (values - values.max()))
        mechanisms[i] = best
        reasons[i] = f"looks like a part that {MOTION_WORDS[best]}"
        sureness[i] = float(0.9 * weights.max() / weights.sum())
    return mechanisms, reasons, sureness


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


def _step(value: float, at: float, width: float) -> float:
    """0 well below ``at``, 1 well above; straight in between."""
    return float(np.clip((value - at) / width + 0.5, 0, 1))


def shape_scores(
    context: PartContext, k: Looks, others: dict[int, Looks]
) -> dict[Mechanism, float]:
    """Mechanism → score; the largest wins."""
    s: dict[Mechanism, float] = {}
    small = 1 - _step(k.size, 0.14, 0.08)
    large = _step(k.size, 0.2, 0.15)
    disc = k.disc
    upright_disc = disc is not None and k.axis_up > 0.8
    level_disc = disc is not None and k.axis_up < 0.35
    faces_out = disc is not None and abs(float(disc.axis @ k.outward)) > 0.9
    embedded = _step(k.walls, 3.0, 2.0)
    rod = 1 - _step(k.slender, 0.42, 0.2)
    is_panel = (1 - _step(k.panel, 0.32, 0.2)) * _step(k.fill, 0.5, 0.3) * (1 - 0.8 * rod)
    standing = 1 - _step(k.normal_up, 0.5, 0.4)
    # Two long things, one turning in or sliding along the other, or two of a kind.
    pair = k.parts <= 3 and not k.twins and k.relative > 0.6 and context.base.slenderness < 0.33
    pair = pair or (k.parts == 2 and k.relative > 0.85 and _alike(context))

    s["press"] = 2.2 * small + 0.15 * min(k.twins, 6) * small - 0.5 * (1 - k.exposed)

    clear = disc is not None and disc.radius > 10 * context.shape.noise
    knob = clear and (k.flat >= 0.27 or (k.size >= 0.085 and k.flat >= 0.15)) and k.size > 0.035
    s["spin"] = 0.0
    if disc is not None:
        s["spin"] += 0.6
        if knob and k.flat < 1.6 and faces_out and k.size < 0.3:
            s["spin"] += 2.2
        if level_disc and k.flat < 1.2 and k.size < 0.6:
            s["spin"] += 2.6 if k.grounded else 1.2 * (1 - _step(k.height, 0.5, 0.3))
        if level_disc and k.flat < 0.9:
            s["spin"] += 1.0
        if k.ball and clear:
            s["spin"] += 2.5
        if (
            level_disc
            and k.size > 0.3
            and k.backed > 0.8
            and not k.grounded
            and k.walls <= 2
            and k.flat < 0.3
        ):
            s["spin"] -= 1.5  # a round door

    if blades(context.shape) is not None:
        s["spin"] += 4.0
    if context.hand:
        s["spin"] += 3.0

    s["swivel"] = 0.0
    if upright_disc and k.flat < 0.35 and k.top > 0.5 and k.bottom > 0.5:
        s["swivel"] += 2.8  # a turntable inside
    if _holds_wheel(context, k, others):
        s["swivel"] += 3.5
    held_below = k.end_contact > 0.4 or max(k.contact_spread[1:]) < 0.35
    on_stem = held_below and k.on_top > 0 and large > 0.5
    if on_stem:
        s["swivel"] += 1.0 + 0.9 * (1 - is_panel)
    wheels = sum(o.disc is not None and o.axis_up < 0.35 and o.grounded for o in others.values())
    s["screw"] = s["swivel"] + 1.0 if on_stem and wheels >= 3 and k.size > 0.4 else 0.0

    if k.scanned and k.grounded and small > 0 and k.height < 0.2:
        s["spin"] += 2.6 * small  # a wheel of which a scan shows too little to be round

    top_width = 2 * min(float(x) for x in np.sort(context.base.box.half)[:2])
    cap = upright_disc and k.top < 0.3 and (k.bottom > 0.4 or k.scanned) and k.height > 0.6
    cap = cap and disc is not None and disc.radius > 0.1 * top_width and k.flat > 0.085
    aside = context.shape.center - context.base.center
    cap = cap and float(np.linalg.norm(aside[:2])) < 0.6 * disc.radius  # type: ignore[union-attr]
    cap = cap and float(context.base.high[2]) < float(context.shape.high[2]) + 0.02
    tall = _tallness(context)
    if cap:
        s["screw"] = max(s["screw"], 2.9 if tall > 1.1 else 1.2)
    s["lift"] = (2.9 if tall <= 1.1 else 1.0) if cap else 0.1

    s["hinge"] = 0.8 + is_panel * standing * (1.2 * large + 0.4 * k.exposed)
    s["flap"] = 0.5 + is_panel * (1 - standing) * (1.2 * large + 0.6 * (1 - k.top))
    if k.aligned < 0.985:
        s["flap"] += is_panel * (0.8 * large * (1 - standing) + 0.3)
        s["hinge"] += is_panel * 0.8 * large * standing

    deep = _step(k.depth / max(min(k.face), 1e-6), 0.8, 0.5)
    drawer = k.way_out * embedded * (0.5 + 1.5 * deep) + k.way_out * deep * large * 1.0
    wide = _step(k.face[0] / max(k.face[1], 1e-6), 1.9, 0.6)
    low = 1 - _step(k.face[1] / max(context.base.size, 1e-6), 0.22, 0.1)
    if k.scanned:
        # Of a closed drawer a scan shows only the front, and perhaps a rim.
        flat_out = 1 - _step(k.depth / max(k.face[0], 1e-6), 1.0, 0.4)
        drawer += 2.4 * context.closed * wide * low * large * flat_out
    else:
        drawer += 0.9 * k.way_out * is_panel * standing * wide * low * large
    s["slide_out"] = 0.3 + drawer - (2.0 if upright_disc else 0.0)

    s["temple"] = 0.2 + rod * (1.3 * k.end_contact + 0.4 * large)
    if k.twins and not context.closed:
        s["temple"] += 0.5 * rod * k.end_contact
    middling = (1 - small) * (1 - _step(k.size, 0.42, 0.1))
    if context.closed:
        middling *= 0.5
    s["lever"] = 0.3 + middling * (1 - is_panel) * (0.9 + 0.8 * k.end_contact)
    bail, legs = _bail(context, k)
    # A long-legged bow that stands on its parent is pulled out of it.
    s["swing"] = 0.2 + 1.6 * bail * (1 - legs)
    s["lift"] += 2.2 * bail * legs
    s["tilt"] = 0.3 + (1.2 * is_panel if on_stem else 0.0)
    if context.parent != context.assembly.root and context.base.slenderness < 0.35:
        s["tilt"] += 1.5 * (1 - small)
        s["swivel"] -= 1.0
    s["toggle"] = 0.2
    if k.parts <= 4 and context.closed and 0.2 < k.relative < 0.75 and k.panel > 0.3:
        s["toggle"] += 1.5 * k.exposed * k.backed * (disc is None)

    s["pivot"] = 0.2 + 0.5 * rod * (k.parts <= 4)
    s["slide_along"] = 0.2 + 3.0 * is_panel * standing * _passes_sibling(context)
    if pair and rod > 0.5:
        # A blade that is free on one edge turns out of its handle; one that is not slides.
        covers = context.covers
        middle = context.shape.order[1]
        held = min(covers[middle], covers[middle + 3]) > 0.6 and k.walls >= 4
        s["slide_along" if held else "pivot"] += 3.2 * rod
    return s


def _alike(context: PartContext) -> bool:
    """Whether part and parent have nearly the same box."""
    a, b = np.sort(context.shape.box.half), np.sort(context.base.box.half)
    return bool(np.all(np.abs(a - b) < 0.25 * b + 0.01))


def _tallness(context: PartContext) -> float:
    """Height over width of the whole object."""
    extent = context.scene.high - context.scene.low
    return float(extent[2] / max(extent[0], extent[1], 1e-6))


def _holds_wheel(context: PartContext, k: Looks, others: dict[int, Looks]) -> bool:
    """A small part near the ground that a wheel hangs on."""
    if k.size > 0.2 or k.height > 0.3:
        return False
    for j, other in others.items():
        if j == context.part or context.scene.gap[j, context.part] > 2 * TOUCHING:
            continue
        wheel = other.disc is not None and other.axis_up < 0.35 and other.grounded
        if wheel and context.assembly.parent[j] == context.part:
            return True
    return False


def _passes_sibling(context: PartContext) -> bool:
    """Whether another panel lies in a parallel plane and laps over this one at the side."""
    shape, scene = context.shape, context.scene
    n = shape.panel.normal
    axes = shape.box.axes
    thick = shape.panel.high - shape.panel.low
    for j in scene.others(context.part):
        other = scene.shapes[j]
        if j in (context.parent, context.assembly.root) or other.size < 0.6 * shape.size:
            continue
        if abs(other.box.axes[:, other.panel.normal] @ axes[:, n]) < 0.98:
            continue
        step = axes.T @ (other.center - shape.center)
        if not 0.6 * thick < abs(step[n]) < 5 * thick + 0.02:
            continue
        lap = [
            shape.box.half[k] + other.box.reach(axes[:, k]) - abs(step[k])
            for k in range(3)
            if k != n
        ]
        narrow = 2 * min(float(shape.box.half[k]) for k in range(3) if k != n)
        if 0.0 < min(lap) < 0.6 * narrow:
            return True
    return False


def _bail(context: PartContext, k: Looks) -> tuple[float, float]:
    """How much it is a bow held at two far ends of one level axis, and whether it has long legs.

    Returns:
        0..1, and 0..1: 1 where the bow stands upright on its parent and is higher than wide.
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
            legs = _step(tall, 0.95, 0.3) * float(k.on_top > 0)
    thin_walled = 1 - _step(shape.area / max(2 * shape.size**2, 1e-9), 0.25, 0.3)
    return float(np.clip(best, 0, 1)) * thin_walled, legs
