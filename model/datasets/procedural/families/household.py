"""Door, Window, Table, Box, Safe, Suitcase, TrashCan, Toilet, Faucet, Cart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from model.datasets.procedural import modules as m
from model.datasets.procedural import shapes as s
from model.datasets.procedural.families.storage import Cell
from model.datasets.procedural.grammar import Body, Builder, ProceduralObject
from model.datasets.procedural.materials import (
    PAINTS,
    PLASTICS,
    Palette,
    Surface,
    furniture_palette,
    metal,
    plain,
    plastic_palette,
    rubber,
    wood,
)


def _pick(rng: np.random.Generator, colors: tuple[tuple[int, int, int], ...]) -> Surface:
    return plain("colour", colors[rng.integers(len(colors))])


def lever_handle(b: Builder, door: Body, at: np.ndarray, side: float, surface: Surface) -> None:
    """A latch lever on a rose before a door's front; ``side`` is where it points along x."""
    rose = s.along(s.cylinder(0.025, 0.008, segments=20), 1).moved(at + np.array([0, -0.004, 0]))
    door.add(rose, surface, "rose")
    lever = b.hinge("lever", door, (0, side, 0), at, 0.0, 0.8)
    neck = s.along(s.cylinder(0.009, 0.045, segments=14), 1)
    lever.add(neck.moved(at + np.array([0, -0.0312, 0])), surface, "neck")
    bar = s.rounded_box((0.115, 0.014, 0.02), 0.006, rim=0.003)
    lever.add(bar.moved(at + np.array([side * 0.047, -0.05, 0])), surface, "lever")


def door(rng: np.random.Generator) -> ProceduralObject:
    """A door in its frame, or two, with levers or knobs."""
    b = Builder("Door", rng)
    palette = furniture_palette(rng)
    double = rng.random() < 0.25
    w = float(rng.uniform(1.3, 1.7) if double else rng.uniform(0.72, 1.0))
    h, jamb, thick = float(rng.uniform(1.95, 2.2)), float(rng.uniform(0.05, 0.09)), 0.04
    deep = float(rng.uniform(0.06, 0.14))
    frame = b.base("door_frame")
    for side in (-1, 1):
        x = side * (w + jamb) / 2
        frame.add(s.box((jamb, deep, h + jamb), (x, 0, (h + jamb) / 2), 0.003), palette.body, "jamb")
    frame.add(s.box((w, deep, jamb), (0, 0, h + jamb / 2), 0.003), palette.body, "lintel")
    stop = s.box((w, 0.012, 0.02), (0, -deep / 2 + thick + 0.008, h - 0.01))
    frame.add(stop, palette.body, "stop")
    style: m.PanelStyle = ("plain", "shaker", "raised", "glass")[rng.integers(4)]
    gap = 0.003
    side_of = [-1, 1] if double else [-1 if rng.random() < 0.5 else 1]
    metal_ = metal(("steel", "brass", "black")[rng.integers(3)])
    rest = {}
    for side in side_of:
        hinge: m.Side = "left" if side < 0 else "right"
        r = m.Opening(-w / 2, w / 2, 0.006, h).shrunk(gap)
        if double:
            r = replace(r, x1=-gap / 2) if side < 0 else replace(r, x0=gap / 2)
        spec = m.DoorSpec(hinge, float(rng.uniform(1.4, 2.2)), style, None, thickness=thick)
        look = Palette(palette.body, palette.front, metal_, metal_, palette.dark)
        panel = m.door(b, frame, r, -deep / 2 + thick, spec, look)
        at = np.array([(r.x1 if side < 0 else r.x0) + side * 0.07, -deep / 2, 1.02])
        kind = rng.random()
        if kind < 0.55:
            lever_handle(b, panel, at, float(side), metal_)
        elif kind < 0.85:
            knob = b.spin("knob", panel, (0, -1, 0), at) if rng.random() < 0.5 else panel
            profile = [(0.014, 0.0006), (0.012, 0.03), (0.027, 0.042), (0.027, 0.055), (0.012, 0.062)]
            knob.add(s.along(s.lathe(profile, 20), 1).moved(at), metal_, "knob")
        else:
            m.add(panel, m.place(m.handle("bow", 0.3, 0.05), at), metal_, "handle")
        if rng.random() < 0.3:
            rest[panel.link] = float(rng.uniform(0.1, spec.swing))
    return b.build(rest)


def window(rng: np.random.Generator) -> ProceduralObject:
    """Sashes that swing, tip or slide in a frame."""
    b = Builder("Window", rng)
    paint = _pick(rng, PAINTS[:6]) if rng.random() < 0.7 else wood("oak")
    palette = Palette(paint, paint, metal("steel"), metal("steel"), paint)
    w, h = (float(v) for v in rng.uniform((0.7, 0.8), (1.5, 1.5)))
    bar, deep = float(rng.uniform(0.05, 0.08)), 0.08
    frame = b.base("window_frame")
    outer = s.frame((w + 2 * bar, h + 2 * bar), (w, h), deep, bevel=0.004)
    frame.add(outer.moved((0, 0, h / 2 + bar)), paint, "frame")
    if rng.random() < 0.5:
        sill = s.box((w + 2.6 * bar, deep + 0.06, 0.025), (0, -0.03, -0.0125), 0.003)
        frame.add(sill, paint, "sill")
    area = m.Opening(-w / 2, w / 2, bar, h + bar)
    kind = ("casement", "slide", "hung", "awning")[rng.integers(4)]
    thick, border = 0.034, 0.045
    if kind in ("slide", "hung"):
        upright = kind == "hung"
        for k in range(2):
            overlap = border / 2
            if upright:
                mid = area.center[1]
                r = replace(area, z1=mid + overlap) if k == 0 else replace(area, z0=mid - overlap)
                axis, travel = ((0, 0, 1), 0.85 * (h / 2 - overlap)) if k == 0 else ((0, 0, -1), 0.85 * (h / 2 - overlap))
            else:
                r = replace(area, x1=overlap) if k == 0 else replace(area, x0=-overlap)
                axis = (1, 0, 0) if k == 0 else (-1, 0, 0)
                travel = 0.85 * (w / 2 - overlap)
            y = -0.002 if k == 0 else thick + 0.002
            sash = b.slide("window", frame, axis, 0.0, travel, (r.center[0], y, r.center[1]))
            m.panel(sash, r.shrunk(0.002), y, thick, "glass", palette, border=border)
            if k == 0 or not upright:
                grip = m.handle("lip", 0.12, 0.012)
                z = r.z0 + 0.02 if upright else r.center[1]
                x = r.center[0] if upright else (r.x0 + 0.02 if k == 0 else r.x1 - 0.02)
                if k == 0:
                    m.add(sash, m.place(grip, (x, y - thick, z), roll=np.pi / 2 if upright else 0.0), palette.accent, "handle")
        return b.build()
    count = 1 if kind == "awning" or w < 0.9 else 2
    rest = {}
    for k in range(count):
        r = area if count == 1 else (replace(area, x1=0.0) if k == 0 else replace(area, x0=0.0))
        side: m.Side = ("left", "right")[k] if count == 2 else ("top" if kind == "awning" else "left")
        spec = m.DoorSpec(side, float(rng.uniform(0.9, 1.6)), "glass", None, thickness=thick)
        sash = m.door(b, frame, r.shrunk(0.003), -deep / 2 + thick + 0.004, spec, palette, name="window")
        end = r.x1 - 0.022 if side == "left" else r.x0 + 0.022
        at = np.array([end if side != "top" else 0.0, -deep / 2 + 0.004, r.center[1] if side != "top" else r.z0 + 0.025])
        if k == 0 and rng.random() < 0.6:
            lever = b.hinge("lever", sash, (0, 1, 0), at, 0.0, np.pi / 2)
            lever.add(s.along(s.cylinder(0.009, 0.022, segments=12), 1).moved(at + np.array([0, -0.0115, 0])), palette.metal, "neck")
            lever.add(s.box((0.016, 0.012, 0.11), at + np.array([0, -0.027, -0.045]), 0.003), palette.metal, "lever")
        if rng.random() < 0.25:
            rest[sash.link] = float(rng.uniform(0.1, spec.swing))
    return b.build(rest)


def table(rng: np.random.Generator) -> ProceduralObject:
    """A desk with drawers under its top, perhaps a pedestal with a door, or on casters."""
    b = Builder("Table", rng)
    palette = furniture_palette(rng)
    w, d, h = (float(v) for v in rng.uniform((0.8, 0.5, 0.68), (1.6, 0.8, 0.78)))
    base = b.base("table_body")
    t = 0.025
    base.add(s.box((w, d, t), (0, 0, h - t / 2), 0.004), palette.front, "tabletop", grain=0)
    style: m.LegStyle = ("block", "taper", "round")[rng.integers(3)]
    pedestals = [side for side in (-1, 1) if rng.random() < 0.4]
    m.legs(base, w, d, h - t, style, palette.body)
    tall = float(rng.uniform(0.09, 0.13))
    low = h - t - tall
    left, right = -w / 2 + 0.09, w / 2 - 0.09
    count = int(rng.integers(1, 4))
    deep = d - 0.1
    wall = 0.015
    y = -d / 2 + 0.045
    for x in np.linspace(left, right, count + 1):
        base.add(s.box((wall, deep, tall), (x, y + deep / 2, low + tall / 2)), palette.body, "apron")
    base.add(s.box((right - left, wall, tall), (0, y + deep - wall / 2, low + tall / 2)), palette.body, "apron")
    base.add(s.box((right - left, deep, 0.008), (0, y + deep / 2, low - 0.004)), palette.body, "apron")
    handle: m.HandleStyle = ("bar", "knob", "cup", "flat", "ball")[rng.integers(5)]
    cuts = np.linspace(left, right, count + 1)
    for a, z in zip(cuts[:-1], cuts[1:], strict=True):
        r = m.Opening(float(a), float(z), low, low + tall)
        clear = m.Opening(float(a) + wall / 2, float(z) - wall / 2, low + 0.001, low + tall)
        m.drawer(b, base, r.shrunk(0.0025), y - 0.001, 0.8 * deep, palette, inner=clear, handle_style=handle,
                 inside=wood("birch"), thickness=0.016, handle_length=0.1)
    for side in pedestals:
        _pedestal(b, base, side, w, d, low - 0.01, palette, handle, rng)
    return b.build()


def _pedestal(
    b: Builder, base: Body, side: int, w: float, d: float, top: float, palette: Palette,
    handle: m.HandleStyle, rng: np.random.Generator,
) -> None:
    width, bottom = min(0.4, 0.36 * w), 0.09
    x0 = side * (w / 2 - 0.085) - (width if side > 0 else 0)
    r = m.Opening(x0, x0 + width, bottom, top)
    deep, wall = d - 0.12, 0.016
    y = -d / 2 + 0.05
    for x in (r.x0 + wall / 2, r.x1 - wall / 2):
        base.add(s.box((wall, deep, r.height), (x, y + deep / 2, r.center[1])), palette.body, "side_wall")
    base.add(s.box((width, deep, wall), (r.center[0], y + deep / 2, bottom + wall / 2)), palette.body, "floor")
    base.add(s.box((width, wall, r.height), (r.center[0], y + deep - wall / 2, r.center[1])), palette.body, "back")
    clear = replace(r.shrunk(wall), z1=r.z1 - 0.004)
    cells = [Cell("door", r)] if rng.random() < 0.5 else [
        Cell("drawer", replace(r, z0=float(a), z1=float(z)))
        for a, z in zip(*(lambda c: (c[:-1], c[1:]))(np.linspace(bottom, top, int(rng.integers(2, 4)) + 1)), strict=True)
    ]
    for cell in cells:
        if cell.use == "door":
            spec = m.DoorSpec("left" if side < 0 else "right", 1.7, "plain", handle, 0.12, handle_at=0.8)
            m.door(b, base, r.shrunk(0.002), y - 0.001, spec, palette)
        else:
            inner = m.Opening(clear.x0, clear.x1, max(cell.area.z0, clear.z0), min(cell.area.z1, clear.z1))
            m.drawer(b, base, cell.area.shrunk(0.002), y - 0.001, 0.8 * deep, palette, inner=inner,
                     handle_style=handle, inside=wood("birch"), handle_length=0.1)


def box(rng: np.random.Generator) -> ProceduralObject:
    """A chest with one lid, a carton with two or four flaps, or a box whose lid lifts off."""
    b = Builder("Box", rng)
    kind = ("chest", "carton", "lift")[rng.integers(3)]
    skin = wood(("oak", "walnut", "cherry", "beech")[rng.integers(4)]) if kind == "chest" else (
        plain("cardboard", (190, 152, 108)) if kind == "carton" else _pick(rng, PLASTICS))
    w, d, h = (float(v) for v in rng.uniform((0.2, 0.15, 0.1), (0.6, 0.42, 0.35)))
    wall = 0.004 if kind == "carton" else 0.008
    body = b.base("box_body")
    body.add(s.tray((w, d, h), wall), skin, "body", grain=0)
    rest: dict[str, float] = {}
    if kind == "carton":
        z = h + 0.0005
        pairs = [((0, -d / 2, z), (1, 0, 0), (w, d / 2)), ((0, d / 2, z), (-1, 0, 0), (w, d / 2))]
        for at, axis, (length, reach) in pairs:
            sign = np.sign(at[1])
            flap = b.hinge("lid", body, axis, at, 0.0, float(rng.uniform(2.6, 3.4)))
            flap.add(s.box((length - 0.002, reach - 0.001, 0.003), (0, at[1] - sign * reach / 2, z + 0.0015)), skin, "flap")
            rest[flap.link] = float(rng.uniform(0.0, 2.5)) if rng.random() < 0.7 else 0.0
        return b.build({k: v for k, v in rest.items() if v})
    lid_h = float(rng.uniform(0.012, 0.3 * h))
    top = s.tray((w, d, lid_h), wall).scaled((1, 1, -1)).moved((0, 0, h + 0.001 + lid_h))
    trim = metal(("brass", "black", "steel")[rng.integers(3)])
    if kind == "lift":
        over = s.tray((w + 0.009, d + 0.009, lid_h), 0.002).scaled((1, 1, -1)).moved((0, 0, h + 0.003))
        lid = b.slide("lid", body, (0, 0, 1), 0.0, 1.1 * lid_h + 0.05, (0, 0, h))
        lid.add(over, skin, "lid")
        if rng.random() < 0.5:
            m.add(lid, m.place(m.handle("bow", 0.35 * w, 0.03), (0, 0, h + 0.002), face="up", roll=np.pi / 2), trim, "handle")
        return b.build()
    swing = float(rng.uniform(1.5, 2.0))
    lid = b.hinge("lid", body, (-1, 0, 0), (0, d / 2 + 0.001, h + 0.0005), 0.0, swing)
    lid.add(top, skin, "lid", grain=0)
    for x in (-0.3 * w, 0.3 * w):
        lid.add(s.along(s.cylinder(0.004, 0.04, segments=10), 0).moved((x, d / 2 + 0.0045, h + 0.0005)), trim, "hinge")
    clasp = s.box((0.03, 0.004, 0.03), (0, -d / 2 - 0.0025, h + 0.004), 0.001)
    lid.add(clasp, trim, "clasp")
    if rng.random() < 0.3:
        rest[lid.link] = float(rng.uniform(0.1, swing))
    return b.build(rest)


def safe(rng: np.random.Generator) -> ProceduralObject:
    """A steel box with a thick door, a dial or a keypad, and a handle that turns."""
    b = Builder("Safe", rng)
    skin = plain("safe", PAINTS[3:][rng.integers(len(PAINTS) - 3)])
    palette = Palette(skin, skin, metal("steel"), metal("steel"), plain("dark", (36, 38, 42)))
    w, d, h = (float(v) for v in rng.uniform((0.3, 0.28, 0.25), (0.6, 0.5, 0.8)))
    wall, thick = float(rng.uniform(0.02, 0.045)), float(rng.uniform(0.025, 0.05))
    body = b.base("safe_body")
    m.carcass(body, (w, d, h), wall, palette, bottom=0.015)
    for x in (-1, 1):
        for y in (-1, 1):
            foot = s.cylinder(0.02, 0.018, segments=12)
            body.add(foot.moved((x * 0.4 * w, y * 0.4 * d, 0.009)), rubber(), "foot")
    body.add(s.box((w - 2 * wall, 0.6 * d, 0.006), (0, 0.1 * d, 0.015 + h / 2)), palette.metal, "shelf")
    side: m.Side = "left" if rng.random() < 0.5 else "right"
    inset = rng.random() < 0.5
    r = m.Opening(-w / 2, w / 2, 0.015, 0.015 + h)
    r = r.shrunk(wall + 0.003) if inset else r.shrunk(0.001)
    y = -d / 2 + thick if inset else -d / 2 - 0.002
    spec = m.DoorSpec(side, float(rng.uniform(1.4, 1.9)), "plain", None, thickness=thick)
    door_ = m.door(b, body, r, y, spec, palette)
    front = y - thick
    free = 1 if side == "left" else -1
    cx, cz = r.center
    mark = plain("mark", (240, 240, 240))
    if rng.random() < 0.6:
        m.knob(b, door_, (cx + free * 0.12 * w, front, cz + 0.12 * h), 0.032, 0.025, palette.dark, mark, style=2)
    else:
        for i in range(3):
            for j in range(3):
                at = (cx + (i - 1) * 0.024, front, cz + 0.12 * h + (j - 1) * 0.024)
                m.push_button(b, door_, at, (0.018, 0.018, 0.004), mark)
    at = np.array([cx + free * 0.1 * w, front, cz - 0.15 * h])
    if rng.random() < 0.5:
        lever_handle(b, door_, at, -float(free), palette.metal)
    else:
        wheel = b.spin("knob", door_, (0, -1, 0), at)
        hub = s.along(s.cylinder(0.014, 0.045, segments=16), 1).moved(at + np.array([0, -0.0232, 0]))
        wheel.add(hub, palette.metal, "hub")
        for k in range(int(rng.integers(3, 6))):
            spoke = s.cylinder(0.0055, 0.06, segments=10).moved((0, 0, 0.04)).turned((0, 1, 0), 2 * np.pi * k / 4)
            wheel.add(spoke.moved(at + np.array([0, -0.038, 0])), palette.metal, "spoke")
    return b.build()


def suitcase(rng: np.random.Generator) -> ProceduralObject:
    """A trolley case: shell that opens, telescopic handle, wheels."""
    b = Builder("Suitcase", rng)
    skin = plain("shell", PLASTICS[rng.integers(len(PLASTICS))])
    w, d, h = (float(v) for v in rng.uniform((0.34, 0.2, 0.48), (0.5, 0.3, 0.72)))
    wheel = 0.024
    bottom = 2 * wheel + 0.004
    body = b.base("suitcase_body")
    half = d / 2 - 0.001

    def shell(front: bool) -> s.Solid:
        solid = s.tray((w, h, half), 0.004, radius=0.06, taper=0.012, corner=5)
        turned = solid.turned((1, 0, 0), -np.pi / 2) if front else solid.turned((1, 0, 0), np.pi / 2)
        y = -half - 0.001 if front else half + 0.001
        return turned.moved((0, y, bottom + h / 2))

    body.add(shell(False), skin, "shell")
    side = -1 if rng.random() < 0.5 else 1
    axis = (0, 0, -1) if side < 0 else (0, 0, 1)
    lid = b.hinge("lid", body, axis, (side * (w / 2 + 0.001), 0.0, bottom + h / 2), 0.0, float(rng.uniform(1.8, 3.0)))
    lid.add(shell(True), skin, "shell")
    for k in range(int(rng.integers(0, 5))):
        rib = s.box((0.012, 0.006, 0.72 * h), ((k - 2) * 0.14 * w, -half - 0.001, bottom + h / 2), 0.002)
        lid.add(rib, skin, "rib")
    pull = float(rng.uniform(0.25, 0.4))
    handle = b.slide("handle", body, (0, 0, 1), 0.0, pull, (0, d / 4, bottom + h))
    grey = metal("steel")
    y = half + 0.016
    length = 0.85 * h
    for x in (-0.18 * w, 0.18 * w):
        sleeve = s.ring([(0.0075, bottom), (0.0105, bottom), (0.0105, bottom + h - 0.03), (0.0075, bottom + h - 0.03)], 14)
        body.add(sleeve.moved((x, y, 0)), plain("sleeve", (50, 52, 56)), "sleeve")
        bar = s.cylinder(0.0065, length, segments=12).moved((x, y, bottom + h - length / 2 + 0.02))
        handle.add(bar, grey, "bar")
    grip = s.rounded_box((0.36 * w + 0.04, 0.022, 0.026), 0.009, rim=0.006)
    handle.add(grip.moved((0, y, bottom + h + 0.03)), plain("grip", (40, 40, 44)), "grip")
    spinner = rng.random() < 0.6
    palette = Palette(skin, skin, metal("dark"), metal("dark"), plain("dark", (40, 40, 44)))
    spots = [(-1, -0.6), (1, -0.6), (-1, 0.6), (1, 0.6)] if spinner else [(-1, 0.6), (1, 0.6)]
    for sx, sy in spots:
        parent = lid if sy < 0 else body
        top = (sx * (w / 2 - 0.07), sy * half, bottom - 0.001)
        m.caster(b, parent, top, wheel, palette, rubber(), swivel=spinner, heading=float(rng.random() * 6.28) if spinner else 0.0)
    return b.build()


def trash_can(rng: np.random.Generator) -> ProceduralObject:
    """A bin with a hinged, swinging or lift-off lid, perhaps a pedal or wheels."""
    b = Builder("TrashCan", rng)
    skin = metal("brushed") if rng.random() < 0.3 else _pick(rng, PLASTICS)
    dark = plain("dark", (44, 46, 50))
    body = b.base("trashcan_body")
    h = float(rng.uniform(0.3, 0.8))
    round_ = rng.random() < 0.4
    w = float(rng.uniform(0.45, 0.75)) * h
    d = w if round_ else w * float(rng.uniform(0.75, 1.0))
    wall, lift = 0.004, 0.02
    if round_:
        r = w / 2
        body.add(s.lathe([(0.88 * r, lift), (r, lift + h), (r - wall, lift + h), (0.88 * r - wall, lift + wall)], 32), skin, "body")
    else:
        body.add(s.tray((w, d, h), wall, radius=0.03, taper=0.08 * w).moved((0, 0, lift)), skin, "body")
    body.add(s.box((0.7 * w, 0.7 * d, lift), (0, 0, lift / 2)), dark, "base")
    top, kind = lift + h + 0.001, rng.random()
    rest: dict[str, float] = {}
    outline = s.circle(w / 2, 32) if round_ else s.rectangle(w, d, 0.03, 3)
    if kind < 0.55:
        lid = b.hinge("lid", body, (-1, 0, 0), (0, d / 2 + 0.004, top), 0.0, float(rng.uniform(1.2, 1.7)))
        loops = [s.at(outline, top), s.at(outline, top + 0.012), s.at(0.9 * outline, top + 0.025)]
        lid.add(s.loft(loops), dark if rng.random() < 0.5 else skin, "lid")
        lid.add(s.along(s.cylinder(0.006, 0.35 * w, segments=12), 0).moved((0, d / 2 + 0.004, top + 0.002)), dark, "hinge")
        if rng.random() < 0.5:
            pedal = b.hinge("pedal", body, (1, 0, 0), (0, -d / 2 + 0.12 * d, 0.014), 0.0, 0.1)
            reach = 0.1 * d + 0.05
            pedal.add(s.box((0.3 * w, reach, 0.006), (0, -d / 2 - reach / 2 + 0.05 * d + 0.003, 0.0145), 0.001), metal("steel"), "pedal")
        elif rng.random() < 0.4:
            for side in (-1, 1):
                at = (side * (0.35 * w + 0.012), d / 2 - 0.02, 0.05)
                wheel = b.spin("wheel", body, (1, 0, 0), at)
                tyre, hub = m.wheel(0.05, 0.02)
                m.add(wheel, [t.moved((side * (w / 2 + 0.014), d / 2 - 0.02, 0.05)) for t in tyre], rubber(), "tyre")
                m.add(wheel, [t.moved((side * (w / 2 + 0.014), d / 2 - 0.02, 0.05)) for t in hub], dark, "hub")
        if rng.random() < 0.25:
            rest[lid.link] = float(rng.uniform(0.1, 1.2))
    elif kind < 0.8:
        rim = [s.at(outline * f, z) for f, z in ((1.0, top), (1.0, top + 0.1), (0.86, top + 0.12), (0.84, top + 0.12), (0.97, top + 0.1), (0.97, top))]
        body.add(s.loft(rim, ring=True), dark, "rim")
        inner = np.abs(outline).max(0) * 0.8
        z = top + 0.125
        lid = b.hinge("lid", body, (1, 0, 0), (0, 0, z), -0.9, 0.9)
        flap = s.slab(s.circle(inner[0], 28) if round_ else s.rectangle(2 * inner[0], 1.7 * inner[1], 0.02, 2), 0.005)
        lid.add(flap.moved((0, 0, z)), skin, "flap")
    else:
        lid = b.slide("lid", body, (0, 0, 1), 0.0, float(rng.uniform(0.08, 0.2)), (0, 0, top))
        loops = [s.at(1.02 * outline, top), s.at(1.02 * outline, top + 0.015), s.at(0.85 * outline, top + 0.035)]
        lid.add(s.loft(loops), dark, "lid")
        m.add(lid, m.place(m.handle("bow", 0.4 * w, 0.035), (0, 0, top + 0.034), face="up", roll=np.pi / 2), dark, "handle")
    return b.build(rest)


def toilet(rng: np.random.Generator) -> ProceduralObject:
    """Bowl, seat, lid, cistern, and a button or a lever."""
    b = Builder("Toilet", rng)
    white = plain("ceramic", (240, 240, 238))
    seat_skin = white if rng.random() < 0.6 else wood("oak")
    body = b.base("toilet_body")
    h, length, w = float(rng.uniform(0.36, 0.42)), float(rng.uniform(0.42, 0.5)), float(rng.uniform(0.34, 0.39))
    a = np.arange(36) * 2 * np.pi / 36
    egg = np.stack([0.5 * w * np.cos(a), 0.5 * length * np.sin(a) * (1 - 0.08 * np.sin(a))], 1)

    def at(f: float, z: float, shift: float = 0.0) -> np.ndarray:
        return s.at(egg * f + np.array([0, shift]), z)

    levels = [at(0.6, 0, 0.05), at(0.55, 0.08, 0.05), at(0.75, 0.6 * h, 0.03), at(1.0, h - 0.02), at(1.0, h),
              at(0.75, h), at(0.5, 0.55 * h, 0.02)]
    body.add(s.loft(levels), white, "bowl")
    back = length / 2
    tank_d, tank_h, tank_w = 0.18, float(rng.uniform(0.3, 0.4)), w + float(rng.uniform(0.0, 0.08))
    y = back + tank_d / 2 - 0.02
    body.add(s.rounded_box((tank_w - 0.06, tank_d, h - 0.02), 0.03).moved((0, y, h / 2 - 0.01)), white, "foot")
    body.add(s.rounded_box((tank_w, tank_d, tank_h), 0.025).moved((0, y, h + tank_h / 2)), white, "tank")
    top = h + tank_h
    body.add(s.rounded_box((tank_w + 0.014, tank_d + 0.012, 0.025), 0.028).moved((0, y, top + 0.0115)), white, "tank_lid")
    hinge = (0.0, back - 0.05, h + 0.026)
    ring = s.loft([at(1.02, h + 0.004), at(1.02, h + 0.018), at(0.68, h + 0.018), at(0.68, h + 0.004)], ring=True)
    cut = ring.shaped(lambda v: np.column_stack([v[:, 0], np.minimum(v[:, 1], back - 0.05), v[:, 2]]))
    seat = b.hinge("seat", body, (-1, 0, 0), hinge, 0.0, float(rng.uniform(1.45, 1.57)))
    seat.add(cut, seat_skin, "seat")
    cover = s.loft([at(1.03, h + 0.0215), at(1.03, h + 0.03), at(0.97, h + 0.037)])
    cover = cover.shaped(lambda v: np.column_stack([v[:, 0], np.minimum(v[:, 1], back - 0.05), v[:, 2]]))
    lid = b.hinge("lid", body, (-1, 0, 0), hinge, 0.0, float(rng.uniform(1.45, 1.57)))
    lid.add(cover, seat_skin, "lid")
    if rng.random() < 0.6:
        m.push_button(b, body, (0, y, top + 0.024), (0.05, 0.05, 0.006), metal("steel"), face="up", round_=True)
    else:
        spot = np.array([-0.35 * tank_w, y - tank_d / 2, h + 0.8 * tank_h])
        lever = b.hinge("lever", body, (0, 1, 0), spot, 0.0, 0.6)
        lever.add(s.along(s.cylinder(0.007, 0.02, segments=12), 1).moved(spot + np.array([0, -0.0105, 0])), metal("steel"), "neck")
        lever.add(s.box((0.09, 0.008, 0.014), spot + np.array([0.035, -0.022, 0]), 0.003), metal("steel"), "lever")
    rest = {lid.link: 1.4} if rng.random() < 0.35 else {}
    return b.build(rest)


def faucet(rng: np.random.Generator) -> ProceduralObject:
    """A spout that swivels, and one lever or two knobs."""
    b = Builder("Faucet", rng)
    skin = metal(("steel", "brass", "black", "copper")[rng.integers(4)])
    base = b.base("faucet_base")
    two = rng.random() < 0.45
    r = float(rng.uniform(0.014, 0.02))
    h = float(rng.uniform(0.05, 0.12))
    width = float(rng.uniform(0.14, 0.2))
    if two:
        base.add(s.rounded_box((width + 0.05, 0.05, 0.014), 0.02).moved((0, 0, 0.007)), skin, "plate")
    else:
        base.add(s.cylinder(1.7 * r, 0.01, segments=28, bevel=0.002).moved((0, 0, 0.005)), skin, "plate")
    base.add(s.cylinder(1.15 * r, h, segments=24).moved((0, 0, h / 2)), skin, "post")
    z = h + 0.0008
    reach, rise = float(rng.uniform(0.12, 0.2)), float(rng.uniform(0.08, 0.24))
    swivel = b.hinge("spout", base, (0, 0, 1), (0, 0, z), -1.8, 1.8) if rng.random() < 0.8 else base
    thin = 0.6 * r
    if rng.random() < 0.5:
        a = np.linspace(np.pi, 0, 13)
        arc = np.stack([0 * a, -reach / 2 - reach / 2 * np.cos(a), z + rise + 0.5 * reach * np.sin(a)], 1)
        path = np.vstack([[0, 0, z + 0.001], arc, [0, -reach, z + rise - 0.03]])
    else:
        path = s.bent_path([(0, 0, z + 0.001), (0, 0, z + rise), (0, -reach, z + rise + 0.01), (0, -reach, z + rise - 0.03)], 0.03)
    swivel.add(s.tube(path, thin, 14), skin, "spout")
    swivel.add(s.cylinder(1.1 * r, 0.02, segments=24).moved((0, 0, z + 0.0108)), skin, "collar")
    if two:
        for side in (-1, 1):
            x = side * width / 2
            base.add(s.cylinder(0.015, 0.03, segments=20).moved((x, 0, 0.028)), skin, "valve")
            at = (x, 0, 0.044)
            turn = b.hinge("switch", base, (0, 0, side), at, 0.0, float(rng.uniform(1.4, 3.2)))
            if rng.random() < 0.5:
                turn.add(s.cylinder(0.013, 0.018, segments=18, bevel=0.002).moved((x, 0, 0.0535)), skin, "hub")
                for k in range(2):
                    bar = s.along(s.cylinder(0.0045, 0.062, segments=10), k).moved((x, 0, 0.055))
                    turn.add(bar, skin, "cross")
            else:
                turn.add(s.cylinder(0.012, 0.014, segments=18).moved((x, 0, 0.0518)), skin, "hub")
                turn.add(s.box((0.016, 0.075, 0.009), (x, -0.03, 0.058), 0.003), skin, "lever")
        return b.build()
    side = 1 if rng.random() < 0.5 else -1
    spot = np.array([side * 1.1 * r, 0, 0.65 * h])
    base.add(s.along(s.cylinder(0.011, 0.024, segments=18), 0).moved(spot), skin, "valve")
    at = spot + np.array([side * 0.0125, 0, 0])
    lever = b.hinge("switch", base, (-side, 0, 0), at, 0.0, float(rng.uniform(0.5, 1.2)))
    lever.add(s.along(s.cylinder(0.0125, 0.014, segments=18, bevel=0.001), 0).moved(at + np.array([side * 0.0075, 0, 0])), skin, "hub")
    lever.add(s.cylinder(0.004, 0.075, segments=10).moved(at + np.array([side * 0.0085, 0, 0.046])), skin, "lever")
    return b.build()


def cart(rng: np.random.Generator) -> ProceduralObject:
    """A trolley with shelves or a tray on four casters, perhaps with drawers."""
    b = Builder("Cart", rng)
    palette = plastic_palette(rng)
    frame = metal(("steel", "white", "dark")[rng.integers(3)])
    w, d, h = (float(v) for v in rng.uniform((0.4, 0.32, 0.55), (0.9, 0.5, 0.95)))
    wheel = float(rng.uniform(0.03, 0.055))
    low = 2 * wheel + 0.012
    body = b.base("cart_body")
    swivels = [True, True, bool(rng.random() < 0.6)]
    for x in (-1, 1):
        for y in (-1, 1):
            spot = (x * (w / 2 - 0.02), y * (d / 2 - 0.02))
            body.add(s.cylinder(0.011, h - low, segments=12).moved((*spot, low + (h - low) / 2)), frame, "post")
            m.caster(b, body, (*spot, low), wheel, palette, rubber(), swivel=swivels[1 + (y > 0)],
                     heading=float(rng.random() * 6.28) if swivels[1 + (y > 0)] else np.pi / 2)
    levels = np.linspace(low + 0.03, h - 0.08, int(rng.integers(2, 4)))
    for z in levels:
        body.add(s.tray((w, d, 0.05), 0.004, radius=0.02).moved((0, 0, float(z))), palette.front, "tray")
    if rng.random() < 0.7:
        path = s.bent_path([(w / 2 - 0.02, -d / 2 + 0.02, h - 0.03), (w / 2 + 0.1, -d / 2 + 0.02, h + 0.05),
                            (w / 2 + 0.1, d / 2 - 0.02, h + 0.05), (w / 2 - 0.02, d / 2 - 0.02, h - 0.03)], 0.05)
        body.add(s.tube(path, 0.011), frame, "handle")
    if rng.random() < 0.4 and len(levels) > 1:
        z0, z1 = float(levels[-2]) + 0.055, float(levels[-1]) - 0.005
        if z1 - z0 > 0.1:
            r = m.Opening(-w / 2 + 0.035, w / 2 - 0.035, z0, z1)
            m.drawer(b, body, r, -d / 2 + 0.014, 0.85 * d, palette, inner=r.shrunk(0.002), handle_style="bar",
                     inside=palette.front, thickness=0.012)
    return b.build()

