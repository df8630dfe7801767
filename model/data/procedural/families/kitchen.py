"""Oven, Microwave and Refrigerator; the housing that kitchen machines share."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from model.data.procedural import controls
from model.data.procedural import modules as m
from model.data.procedural import shapes as s
from model.data.procedural.grammar import Body, Builder, ProceduralObject
from model.data.procedural.materials import (
    Palette,
    Surface,
    appliance_palette,
    glass,
    pictured,
    plain,
    rubber,
)

INSIDE = plain("inside", (206, 208, 210))


def housing(
    body: Body,
    size: tuple[float, float, float],
    opening: m.Opening,
    palette: Palette,
    bottom: float,
    *,
    depth: float | None = None,
    inside: Surface = INSIDE,
) -> None:
    """A body whose front is closed but for one opening into a hollow of ``depth``."""
    w, d, h = size
    hollow = 0.86 * d if depth is None else depth
    front, back = -d / 2, d / 2
    x0, x1, z0, z1 = -w / 2, w / 2, bottom, bottom + h
    blocks = (
        ((x0, opening.x0), (z0, z1), "side_wall"),
        ((opening.x1, x1), (z0, z1), "side_wall"),
        ((opening.x0, opening.x1), (z0, opening.z0), "floor"),
        ((opening.x0, opening.x1), (opening.z1, z1), "ceiling"),
    )
    for (a, b), (low, high), piece in blocks:
        center = ((a + b) / 2, front + hollow / 2, (low + high) / 2)
        solid = s.box((b - a, hollow, high - low), center, 0.003)
        body.add(solid, palette.body, piece)
    rear = s.box((w, d - hollow, h), (0, back - (d - hollow) / 2, (z0 + z1) / 2), 0.004)
    body.add(rear, palette.body, "back")
    center = (opening.center[0], front + hollow - 0.002, opening.center[1])
    lining = s.box((opening.width, 0.004, opening.height), center)
    body.add(lining, inside, "lining")


def rack(
    body: Body,
    width: float,
    depth: float,
    at: tuple[float, float, float],
    surface: Surface,
    bars: int = 9,
) -> None:
    """A wire shelf centred on ``at``."""
    x, y, z = at
    for side in (-1, 1):
        rail = s.along(s.cylinder(0.004, depth, segments=8), 1)
        rail = rail.moved((x + side * (width / 2 - 0.004), y, z))
        body.add(rail, surface, "rail")
    for k in range(bars):
        wire = s.along(s.cylinder(0.0025, width, segments=6), 0)
        body.add(wire.moved((x, y - depth / 2 + depth * (k + 0.5) / bars, z)), surface, "wire")


@dataclass(frozen=True)
class OvenSpec:
    """The shape of an oven.

    Attributes:
        size: (x, y, z) metres; knobs: number; burners: 0 for a built-in oven.
        drawer: a warming drawer below the door; knob_limits: radians, None turns without end.
        gap: metres above and below the door.
    """

    size: tuple[float, float, float] = (0.6, 0.6, 0.86)
    knobs: int = 6
    knob_style: int = 0
    burners: int = 4
    drawer: bool = True
    display: bool = True
    feet: float = 0.03
    fascia: float = 0.11
    handle: m.HandleStyle = "bar"
    knob_limits: tuple[float, float] | None = None
    door_open: float = 0.0
    gap: float = 0.003


def build_oven(spec: OvenSpec, palette: Palette, rng: np.random.Generator) -> ProceduralObject:
    """An oven, with a cooktop where it has burners."""
    b = Builder("Oven", rng, palette)
    w, d, h = spec.size
    body = b.base("oven_body")
    bottom = spec.feet
    low = bottom + (0.16 if spec.drawer else 0.03)
    high = bottom + h - spec.fascia
    wall = 0.05
    opening = m.Opening(-w / 2 + wall, w / 2 - wall, low + 0.03, high - 0.03)
    housing(body, spec.size, opening, palette, bottom, inside=plain("oven_lining", (60, 62, 66)))
    for x in (-1, 1):
        for y in (-1, 1):
            at = (x * (w / 2 - 0.05), y * (d / 2 - 0.05), (bottom + 0.01) / 2)
            body.add(s.cylinder(0.02, bottom + 0.01, segments=12).moved(at), palette.dark, "foot")
    front = -d / 2
    thick = 0.035
    size = (w - 0.004, thick, spec.fascia - 0.006)
    fascia = s.box(size, (0, front - thick / 2, bottom + h - spec.fascia / 2), 0.004)
    body.add(fascia, palette.front if rng.random() < 0.6 else palette.dark, "control_panel")
    for k, z in enumerate((low + 0.15, low + 0.3)):
        if z < high - 0.08:
            rack(body, w - 2 * wall, 0.7 * d, (0, front + 0.4 * d, z), palette.metal, 9 + k)
    door = m.door(
        b,
        body,
        m.Opening(-w / 2 + 0.002, w / 2 - 0.002, low, high + 0.002 - spec.gap),
        front - 0.002,
        m.DoorSpec(
            "bottom", np.pi / 2, "window", spec.handle, 0.76 * w, 0.045, 0.5, 0.05, thick - 0.002
        ),
    )
    if spec.drawer:
        _warming_drawer(b, body, w, d, bottom, low + 0.001 - spec.gap, thick)
    _oven_knobs(b, body, spec, front - thick, bottom + h - spec.fascia / 2)
    if spec.burners:
        _cooktop(body, w, d, bottom + h, spec.burners, palette)
    return b.build({door.link: spec.door_open} if spec.door_open else None)


def _warming_drawer(
    b: Builder, body: Body, w: float, d: float, bottom: float, low: float, thick: float
) -> None:
    front = -d / 2
    part = b.slide("drawer", body, (0, -1, 0), 0.0, 0.3, (0, front, (bottom + low) / 2))
    r = m.Opening(-w / 2 + 0.002, w / 2 - 0.002, bottom + 0.004, low - 0.001)
    m.panel(part, r, front - 0.002, thick - 0.002, "plain", b.palette)
    grip = m.handle("lip", 0.5 * w, 0.025)
    solids = m.place(grip, (0, front - thick, low - 0.03), roll=np.pi / 2)
    m.add(part, solids, b.palette.accent, "handle")


def _oven_knobs(b: Builder, body: Body, spec: OvenSpec, y: float, z: float) -> None:
    palette = b.palette
    w = spec.size[0]
    middle = spec.display and spec.knobs % 2 == 0
    xs = np.linspace(-0.42, 0.42, spec.knobs) * w if spec.knobs > 1 else np.array([0.25 * w])
    if middle:
        half = spec.knobs // 2
        xs = np.concatenate([np.linspace(-0.42, -0.2, half), np.linspace(0.2, 0.42, half)]) * w
    if spec.display and (middle or spec.knobs == 1):
        size = (0.12, 0.006, 0.045)
        body.add(s.box(size, (0, y - 0.002, z)), pictured("panel", int(spec.knobs)), "display")
    spread = float(np.diff(xs).min()) if len(xs) > 1 else 0.1
    radius = min(0.024, 0.38 * spread, 0.33 * spec.fascia)
    mark = (
        plain("mark", (240, 240, 240))
        if sum(palette.accent.material.base_color[:3]) < 300
        else palette.dark
    )
    for x in xs:
        controls.knob(
            b,
            body,
            (float(x), y, z),
            (radius, 0.026),
            (palette.accent, mark),
            style=spec.knob_style,
            limits=spec.knob_limits,
        )


def _cooktop(body: Body, w: float, d: float, top: float, burners: int, palette: Palette) -> None:
    body.add(s.box((w, d, 0.012), (0, 0, top + 0.004), 0.003), palette.dark, "cooktop")
    iron = plain("iron", (28, 28, 30))
    rows = [(-0.24, -0.22), (0.24, -0.22), (-0.24, 0.2), (0.24, 0.2), (0.0, 0.0)][: max(burners, 1)]
    for k, (x, y) in enumerate(rows):
        r = 0.085 if k % 3 else 0.068
        plate = s.lathe([(r, 0), (r, 0.01), (0.9 * r, 0.014), (0.3 * r, 0.014)], 24)
        body.add(plate.moved((x * w, y * d, top + 0.009)), iron, "burner")
        profile = [(1.06 * r, 0), (1.12 * r, 0), (1.12 * r, 0.004), (1.06 * r, 0.004)]
        body.add(s.ring(profile, 24).moved((x * w, y * d, top + 0.009)), palette.metal, "trim")


def oven(rng: np.random.Generator) -> ProceduralObject:
    """A range, or a built-in oven."""
    stove = rng.random() < 0.6
    size = (
        float(rng.uniform(0.5, 0.76)),
        float(rng.uniform(0.55, 0.65)),
        float(rng.uniform(0.8, 0.9) if stove else rng.uniform(0.45, 0.65)),
    )
    knobs = int(rng.integers(1, 7))
    limits = [None, (0.0, 4.71), (-2.4, 2.4)][rng.integers(3)]
    spec = OvenSpec(
        size,
        knobs,
        int(rng.integers(3)),
        int(rng.integers(2, 6)) if stove else 0,
        bool(stove and rng.random() < 0.6),
        bool(rng.random() < 0.6),
        float(rng.uniform(0.01, 0.06)),
        float(rng.uniform(0.08, 0.13)),
        ("bar", "bow", "flat")[rng.integers(3)],
        limits,
        float(rng.uniform(0.1, 1.3)) if rng.random() < 0.15 else 0.0,
    )
    return build_oven(spec, appliance_palette(rng), rng)


def microwave(rng: np.random.Generator) -> ProceduralObject:
    """A door beside a panel of buttons or knobs, perhaps a turntable."""
    b = Builder("Microwave", rng)
    b.palette = palette = appliance_palette(rng)
    w, d, h = (float(v) for v in rng.uniform((0.42, 0.32, 0.24), (0.6, 0.46, 0.36)))
    bottom, wall, thick = 0.012, 0.025, 0.028
    panel_width = float(rng.uniform(0.18, 0.26)) * w
    body = b.base("microwave_body")
    split = w / 2 - panel_width
    opening = m.Opening(-w / 2 + wall, split - wall, bottom + wall, bottom + h - wall)
    housing(body, (w, d, h), opening, palette, bottom)
    for x in (-1, 1):
        for y in (-1, 1):
            height = bottom + 0.004
            offset = (x * 0.4 * w, y * 0.38 * d, bottom / 2 + 0.002)
            body.add(s.cylinder(0.015, height, segments=12).moved(offset), palette.dark, "foot")
    front = -d / 2
    fascia = m.Opening(split + 0.0015, w / 2, bottom, bottom + h)
    size = (fascia.width, thick, fascia.height)
    center = (fascia.center[0], front - thick / 2, fascia.center[1])
    body.add(s.box(size, center, 0.003), palette.dark, "control_panel")
    face = front - thick
    side: m.Side = "left"
    look = m.DoorSpec(
        side,
        float(rng.uniform(1.5, 2.0)),
        "window",
        ("bar", "flat", "bow", None)[rng.integers(4)],
        0.6 * h,
        0.03,
        0.5,
        0.03,
        thick - 0.002,
    )
    m.door(b, body, m.Opening(-w / 2, split - 0.0015, bottom, bottom + h), front - 0.002, look)
    cx = fascia.center[0]
    size = (0.75 * panel_width, 0.004, 0.14 * h)
    center = (cx, face - 0.001, bottom + 0.87 * h)
    body.add(s.box(size, center), pictured("panel", int(rng.integers(6))), "display")
    if rng.random() < 0.5:
        mark = plain("mark", (240, 240, 240))
        for z in (0.3, 0.62)[: int(rng.integers(1, 3))]:
            controls.knob(
                b,
                body,
                (cx, face, bottom + z * h),
                (0.3 * panel_width, 0.02),
                (palette.accent, mark),
                style=int(rng.integers(3)),
                limits=(0.0, 4.71) if rng.random() < 0.5 else None,
            )
    else:
        rows, cols = int(rng.integers(3, 6)), 3
        pitch = (0.28 * panel_width, 0.6 * h / rows)
        for i in range(rows):
            for j in range(cols):
                at = (cx + (j - 1) * pitch[0], face, bottom + 0.1 * h + (i + 0.5) * pitch[1])
                size = (0.8 * pitch[0], 0.7 * pitch[1], 0.004)
                controls.push_button(b, body, at, size, palette.accent)
    if rng.random() < 0.6:
        origin = (opening.center[0], front + 0.43 * d, opening.z0 + 0.012)
        plate = b.spin("tray", body, (0, 0, 1), origin)
        r = 0.45 * min(opening.width, 0.86 * d)
        profile = [(0.3 * r, 0.012), (r, 0.016), (r, 0.02), (0.95 * r, 0.019), (0.3 * r, 0.016)]
        dish = s.lathe(profile, 28)
        plate.add(dish.moved((opening.center[0], front + 0.43 * d, opening.z0)), glass(), "plate")
    return b.build()


def refrigerator(rng: np.random.Generator) -> ProceduralObject:
    """One door, two over each other, side by side, or French doors over freezer drawers."""
    layout = ("single", "freezer_top", "freezer_bottom", "side_by_side", "french")[rng.integers(5)]
    wide = layout in ("side_by_side", "french")
    size = (
        float(rng.uniform(0.8, 0.95) if wide else rng.uniform(0.5, 0.7)),
        float(rng.uniform(0.5, 0.65)),
        float(rng.uniform(0.7, 1.2) if layout == "single" else rng.uniform(1.5, 1.95)),
    )
    ajar = float(rng.uniform(0.1, 1.2)) if rng.random() < 0.2 else 0.0
    return build_refrigerator(layout, size, appliance_palette(rng), rng, ajar=ajar)


def build_refrigerator(
    layout: str,
    size: tuple[float, float, float],
    palette: Palette,
    rng: np.random.Generator,
    *,
    ajar: float = 0.0,
    gap: float = 0.004,
) -> ProceduralObject:
    """A refrigerator of one of the layouts that :func:`refrigerator` names; ``gap`` in metres."""
    b = Builder("Refrigerator", rng, palette)
    w, d, h = size
    body = b.base("refrigerator_body")
    bottom, wall, thick = 0.04, 0.045, float(rng.uniform(0.045, 0.07))
    front = -d / 2
    body.add(s.box((0.9 * w, 0.85 * d, bottom), (0, 0.03 * d, bottom / 2)), palette.dark, "plinth")
    cut = {"freezer_top": 0.7, "freezer_bottom": 0.36, "french": 0.38}.get(layout, 0.0)
    split = bottom + cut * h
    zones = (
        [m.Opening(-w / 2, w / 2, bottom, bottom + h)]
        if not cut
        else [m.Opening(-w / 2, w / 2, bottom, split), m.Opening(-w / 2, w / 2, split, bottom + h)]
    )
    hollow = 0.85 * d
    for x in (-1, 1):
        center = (x * (w - wall) / 2, front + hollow / 2, bottom + h / 2)
        body.add(s.box((wall, hollow, h), center, 0.004), palette.body, "side_wall")
    center = (0, d / 2 - (d - hollow) / 2, bottom + h / 2)
    body.add(s.box((w, d - hollow, h), center, 0.004), palette.body, "back")
    inner = w - 2 * wall
    levels = [bottom + wall / 2, bottom + h - wall / 2] + ([split] if cut else [])
    for z in levels:
        body.add(s.box((inner, hollow, wall), (0, front + hollow / 2, z)), palette.body, "wall")
    if layout == "side_by_side":
        center = (0, front + hollow / 2, bottom + h / 2)
        body.add(s.box((wall, hollow, h - 2 * wall), center), palette.body, "divider")
    shelf = glass((190, 214, 220), 150)
    for zone in zones[1:] if layout == "french" else zones:
        for k in range(int(zone.height // 0.3)):
            z = zone.z0 + zone.height * (k + 1) / (zone.height // 0.3 + 1)
            center = (0, front + 0.55 * hollow, z)
            body.add(s.box((inner, 0.8 * hollow, 0.008), center), shelf, "shelf")
    style: m.HandleStyle = ("bar", "bow", "flat")[rng.integers(3)]
    length = float(rng.uniform(0.25, 0.6))
    side: m.Side = "left" if rng.random() < 0.5 else "right"
    swing = float(rng.uniform(1.6, 2.2))
    look = m.DoorSpec(side, swing, "plain", style, length, 0.05, 0.5, 0.05, thick)
    moving: list[Body] = []

    def close(r: m.Opening, hinge: m.Side, at: float) -> None:
        spec = replace(look, hinge=hinge, handle_at=at)
        part = m.door(b, body, r.shrunk(gap / 2), front - 0.006, spec)
        seal = s.frame((r.width - 0.05, r.height - 0.05), (r.width - 0.09, r.height - 0.09), 0.005)
        part.add(seal.moved((r.center[0], front - 0.0035, r.center[1])), rubber(), "gasket")
        moving.append(part)

    top = zones[-1]
    if layout in ("side_by_side", "french"):
        close(replace(top, x1=0.0), "left", 0.4)
        close(replace(top, x0=0.0), "right", 0.4)
    else:
        close(top, side, 0.15 if cut else 0.6)
    if cut and layout == "french":
        count = int(rng.integers(1, 3))
        _freezer_drawers(b, body, zones[0], front, thick, inner, hollow, style, count)
    elif cut:
        close(zones[0], side, 0.85)
    rest = {moving[-1].link: min(ajar, look.swing)} if ajar else None
    return b.build(rest)


def _freezer_drawers(
    b: Builder,
    body: Body,
    zone: m.Opening,
    front: float,
    thick: float,
    inner: float,
    hollow: float,
    style: m.HandleStyle,
    count: int,
) -> None:
    cuts = np.linspace(zone.z0, zone.z1, count + 1)
    for a, z in itertools.pairwise(cuts):
        r = m.Opening(zone.x0, zone.x1, float(a), float(z)).shrunk(0.002)
        cell = m.Opening(
            -inner / 2,
            inner / 2,
            max(float(a), zone.z0 + 0.045) + 0.002,
            min(float(z), zone.z1 - 0.025) - 0.002,
        )
        m.drawer(
            b, body, r, front - 0.006, 0.75 * hollow, inner=cell, handle_style=style,
            thickness=thick, inside=INSIDE, travel=0.8, handle_length=0.6
        )  # fmt: skip
