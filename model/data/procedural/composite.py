"""Random composites: bodies of no category, with modules where they fit.

They teach a network the joints' cues apart from the categories' habits.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from model.data.procedural import controls
from model.data.procedural import modules as m
from model.data.procedural import shapes as s
from model.data.procedural.grammar import Body, Builder, ProceduralObject
from model.data.procedural.materials import (
    Palette,
    appliance_palette,
    furniture_palette,
    plain,
    plastic_palette,
    rubber,
    wood,
)
from model.data.procedural.modules import LegStyle, legs

HANDLES: tuple[m.HandleStyle, ...] = ("bar", "bow", "flat", "knob", "cup", "ball", "lip")


def random_composite(rng: np.random.Generator) -> ProceduralObject:
    """A hollow or solid body of any proportions with one to about eight modules on it."""
    b = Builder(COMPOSITE_CATEGORY, rng)
    b.palette = palette = (furniture_palette, appliance_palette, plastic_palette)[rng.integers(3)](
        rng
    )
    body = b.base("body")
    scale = float(np.exp(rng.uniform(np.log(0.15), np.log(1.6))))
    w, d, h = (float(v) for v in scale * rng.uniform((0.4, 0.35, 0.3), (1.0, 0.8, 1.2)))
    wheeled = rng.random() < 0.2
    lift = 0.09 * min(w, d) * 2 + 0.02 * scale if wheeled else float(rng.uniform(0.0, 0.15)) * h
    wall = float(np.clip(0.03 * min(w, d, h), 0.004, 0.025))
    if wheeled:
        _wheels(b, body, w, d, lift - 0.012 * scale)
    elif lift > 0.02:
        style: LegStyle = ("block", "taper", "round", "plinth")[rng.integers(4)]
        legs(body, w, d, lift, style, palette.body)
    m.carcass(body, (w, d, h), wall, palette, bottom=lift)
    free = _fronts(b, body, m.Opening(-w / 2, w / 2, lift, lift + h), d, wall)
    _top(b, body, w, d, lift + h)
    if free is not None:
        _controls(b, body, free, -d / 2)
    return b.build(_ajar(b))


COMPOSITE_CATEGORY = "Composite"


def _ajar(b: Builder) -> dict[str, float]:
    """Leave the first front somewhat open, sometimes."""
    rng = b.rng
    hinged = [j for j in b.joints if j.type == "revolute" and j.lower == 0.0 and j.upper]
    if not hinged or rng.random() > 0.25:
        return {}
    joint = hinged[rng.integers(len(hinged))]
    assert joint.upper is not None
    return {joint.child: float(rng.uniform(0.1, 0.9)) * joint.upper}


def _wheels(b: Builder, body: Body, w: float, d: float, top: float) -> None:
    radius = 0.42 * top
    body.add(s.box((w, d, 0.03 * top + 0.004), (0, 0, top + 0.006)), b.palette.dark, "chassis")
    swivel = b.rng.random() < 0.6
    for x in (-1, 1):
        for y in (-1, 1):
            spot = (x * (w / 2 - 0.9 * radius), y * (d / 2 - 1.2 * radius), top)
            controls.caster(
                b,
                body,
                spot,
                radius,
                rubber(),
                swivel=bool(swivel and y < 0),
                heading=np.pi / 2 if not (swivel and y < 0) else float(b.rng.random() * 6.28),
            )


def _fronts(b: Builder, body: Body, area: m.Opening, d: float, wall: float) -> m.Opening | None:
    """Divide the front into a column or row of cells; returns the cell kept for controls."""
    rng = b.rng
    count = int(rng.integers(1, 4))
    upright = area.width > area.height
    cuts = np.sort(rng.uniform(0.25, 0.75, count - 1)) if count > 1 else np.zeros(0)
    edges = np.concatenate([[0.0], cuts, [1.0]])
    if np.diff(edges).min() < 0.18:
        edges = np.linspace(0, 1, count + 1)
    front, thick = -d / 2, float(np.clip(0.9 * wall, 0.004, 0.03))
    panel_cell = int(rng.integers(count)) if rng.random() < 0.6 else -1
    kept: m.Opening | None = None
    for k in range(count):
        lo, hi = float(edges[k]), float(edges[k + 1])
        r = (
            replace(area, x0=area.x0 + lo * area.width, x1=area.x0 + hi * area.width)
            if upright
            else replace(area, z0=area.z0 + lo * area.height, z1=area.z0 + hi * area.height)
        )
        if k < count - 1:
            _divider(body, r, d, wall, b.palette, upright)
        clear = m.Opening(
            max(r.x0 + wall / 2, area.x0 + wall),
            min(r.x1 - wall / 2, area.x1 - wall),
            max(r.z0 + wall / 2, area.z0 + wall),
            min(r.z1 - wall / 2, area.z1 - wall),
        )
        if k == panel_cell:
            plate = s.box((r.width, 2 * thick, r.height), (r.center[0], front + thick, r.center[1]))
            body.add(plate, b.palette.dark, "control_panel")
            kept = r
            continue
        _front(b, body, r, clear, front, d, thick, alone=count == 1)
    return kept


def _divider(
    body: Body, r: m.Opening, d: float, wall: float, palette: Palette, upright: bool
) -> None:
    deep = d - 0.01
    if upright:
        solid = s.box((wall, deep, r.height - 2 * wall), (r.x1, 0.004, r.center[1]))
    else:
        solid = s.box((r.width - 2 * wall, deep, wall), (r.center[0], 0.004, r.z1))
    body.add(solid, palette.body, "divider")


def _front(
    b: Builder,
    body: Body,
    r: m.Opening,
    clear: m.Opening,
    front: float,
    d: float,
    thick: float,
    *,
    alone: bool,
) -> None:
    """A door hinged on any side, a drawer, or where nothing is beside it a sliding panel."""
    rng = b.rng
    gap = float(rng.uniform(0.0015, 0.004)) * max(1.0, 2 * r.width)
    face = r.shrunk(gap / 2)
    size = min(r.width, r.height)
    style: m.HandleStyle | None = (
        HANDLES[rng.integers(len(HANDLES))] if rng.random() < 0.85 else None
    )
    kind = rng.random()
    if kind < 0.55:
        hinge: m.Side = ("left", "right", "top", "bottom")[
            rng.choice(4, p=[0.35, 0.35, 0.12, 0.18])
        ]
        look: m.PanelStyle = ("plain", "shaker", "raised", "window")[rng.integers(4)]
        spec = m.DoorSpec(
            hinge,
            float(rng.uniform(1.2, 2.3 if alone and hinge in ("left", "right") else 1.55)),
            look,
            style,
            0.4 * size,
            0.08 * size + 0.012,
            float(rng.uniform(0.3, 0.7)),
            0.1 * size,
            thick,
            bool(rng.random() < 0.6),
        )
        m.door(b, body, face, front - 0.002, spec)
    elif kind < 0.9 or not alone:
        m.drawer(
            b, body, face, front - 0.002, 0.8 * d, inner=clear, handle_style=style,
            thickness=thick, inside=wood("birch"), travel=float(rng.uniform(0.6, 0.9)),
            handle_length=0.4 * r.width
        )  # fmt: skip
    else:
        side = 1 if rng.random() < 0.5 else -1
        axis = (side, 0, 0)
        slide = b.slide("door", body, axis, 0.0, 0.9 * r.width, (r.center[0], front, r.center[1]))
        m.panel(slide, face.shrunk(0.02 * size), front - 0.003, thick, "plain", b.palette)
        for z in (r.z0, r.z1):
            center = (0.45 * side * r.width, front - thick, z)
            rail = s.box((1.9 * r.width, 2 * thick, 0.03 * size), center)
            body.add(rail, b.palette.metal, "rail")


def _top(b: Builder, body: Body, w: float, d: float, z: float) -> None:
    """Something on the top: a lid, a swivelling plate, a telescopic post, a jar with a cap."""
    palette, rng = b.palette, b.rng
    kind = rng.random()
    size = min(w, d)
    if kind < 0.2:
        origin = (0, d / 2 - 0.02 * d, z + 0.002)
        lid = b.hinge("lid", body, (-1, 0, 0), origin, 0.0, float(rng.uniform(1.2, 1.9)))
        center = (0, 0, z + 0.002 + 0.03 * size)
        lid.add(s.box((0.94 * w, 0.94 * d, 0.06 * size), center, 0.01 * size), palette.front, "lid")
    elif kind < 0.35:
        body.add(
            s.cylinder(0.12 * size, 0.06 * size, segments=20).moved((0, 0, z + 0.03 * size)),
            palette.metal,
            "bearing",
        )
        plate = b.spin("tray", body, (0, 0, 1), (0, 0, z))
        shape = (
            s.rounded_box((0.8 * w, 0.7 * d, 0.05 * size), 0.1 * size)
            if rng.random() < 0.5
            else s.cylinder(0.42 * size, 0.05 * size, segments=30)
        )
        plate.add(shape.moved((0, 0, z + 0.0875 * size)), palette.front, "plate")
    elif kind < 0.5:
        r, tall = 0.06 * size, float(rng.uniform(0.4, 1.0)) * size
        profile = [(r, z - 0.001), (1.3 * r, z - 0.001), (1.3 * r, z + tall), (r, z + tall)]
        tube = s.ring(profile, 20)
        body.add(tube, palette.metal, "sleeve")
        post = b.slide("post", body, (0, 0, 1), 0.0, 0.8 * tall, (0, 0, z))
        solid = s.cylinder(0.92 * r, 1.05 * tall, segments=18).moved((0, 0, z + 0.56 * tall))
        post.add(solid, palette.accent, "post")
        offset = (0, 0, z + 1.09 * tall + 1.2 * r)
        post.add(s.sphere(1.6 * r, 18).moved(offset), palette.front, "head")
    elif kind < 0.62:
        r, tall = 0.14 * size, 0.3 * size
        offset = (0, 0, z + tall / 2)
        body.add(s.cylinder(r, tall, segments=26).moved(offset), palette.front, "neck")
        cap = b.screw("cap", body, (0, 0, 1), (0, 0, z + tall), 0.3 * size)
        profile = [
            (1.06 * r, z + tall + 0.004),
            (1.06 * r, z + 0.6 * tall),
            (1.25 * r, z + 0.6 * tall),
            (1.25 * r, z + 1.12 * tall),
            (0.9 * r, z + 1.18 * tall),
        ]
        shell = s.lathe(profile, 26)
        cap.add(shell, palette.accent, "cap")
    elif kind < 0.72:
        at = np.array([0, 0, z + 0.05 * size])
        for side in (-1, 1):
            center = at + np.array([side * 0.05 * size, 0, -0.002 * size])
            body.add(s.box((0.02 * size, 0.08 * size, 0.1 * size), center), palette.metal, "fork")
        arm = b.hinge("lever", body, (1, 0, 0), at, -1.0, 1.0)
        arm.add(
            s.along(s.cylinder(0.02 * size, 0.075 * size, segments=14), 0).moved(at),
            palette.metal,
            "axle",
        )
        center = at + np.array([0, 0, 0.25 * size])
        bevel = 0.004 * size
        extent = (0.05 * size, 0.03 * size, 0.5 * size)
        arm.add(s.box(extent, center, bevel), palette.accent, "lever")
        offset = at + np.array([0, 0, 0.5 * size])
        arm.add(s.sphere(0.06 * size, 16).moved(offset), palette.front, "grip")


def _controls(b: Builder, body: Body, r: m.Opening, y: float) -> None:
    """Knobs, buttons or levers in a grid on the control panel."""
    palette, rng = b.palette, b.rng
    cols, rows = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    if r.height > r.width:
        cols, rows = rows, cols
    step = min(r.width / cols, r.height / rows)
    mark = plain("mark", (240, 240, 240))
    use = rng.integers(3)
    for i in range(cols):
        for j in range(rows):
            at = (r.x0 + r.width * (i + 0.5) / cols, y, r.z0 + r.height * (j + 0.5) / rows)
            size = float(np.clip(0.3 * step, 0.004, 0.05))
            if use == 0:
                controls.knob(
                    b,
                    body,
                    at,
                    (size, 0.9 * size),
                    (palette.accent, mark),
                    style=int(rng.integers(3)),
                    limits=None if rng.random() < 0.5 else (0.0, float(rng.uniform(1.5, 5.0))),
                )
            elif use == 1:
                extent = (1.5 * size, 1.2 * size, 0.25 * size)
                round_ = bool(rng.random() < 0.4)
                controls.push_button(b, body, at, extent, palette.accent, round_=round_)
            else:
                place = np.asarray(at) - np.array([0, 0.0008, 0])
                lever = b.hinge("lever", body, (0, 1, 0), place, -0.7, 0.7)
                hub = s.along(s.cylinder(0.35 * size, 0.6 * size, segments=16), 1)
                lever.add(hub.moved(place + np.array([0, -0.3 * size, 0])), palette.metal, "hub")
                center = (0, -0.6 * size, 0.5 * size)
                bar = s.box((0.3 * size, 0.25 * size, 1.3 * size), center, 0.03 * size)
                lever.add(bar.moved(place), palette.accent, "lever")
