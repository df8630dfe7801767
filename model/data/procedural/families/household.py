"""Door and Window, and the latch lever that doors carry; Box, Safe, Suitcase, TrashCan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from model.data.procedural import controls
from model.data.procedural import modules as m
from model.data.procedural import shapes as s
from model.data.procedural.grammar import Body, Builder, ProceduralObject
from model.data.procedural.materials import (
    PAINTS,
    PLASTICS,
    Palette,
    Surface,
    furniture_palette,
    metal,
    one_color,
    plain,
    rubber,
    wood,
)
from model.data.procedural.shapes import Vector


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
    b.palette = palette = furniture_palette(rng)
    double = rng.random() < 0.25
    w = float(rng.uniform(1.3, 1.7) if double else rng.uniform(0.72, 1.0))
    h, jamb, thick = float(rng.uniform(1.95, 2.2)), float(rng.uniform(0.05, 0.09)), 0.04
    deep = float(rng.uniform(0.06, 0.14))
    frame = b.base("door_frame")
    for side in (-1, 1):
        x = side * (w + jamb) / 2
        size = (jamb, deep, h + jamb)
        frame.add(s.box(size, (x, 0, (h + jamb) / 2), 0.003), palette.body, "jamb")
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
        b.palette = replace(palette, accent=metal_, metal=metal_)
        panel = m.door(b, frame, r, -deep / 2 + thick, spec)
        at = np.array([(r.x1 if side < 0 else r.x0) + side * 0.07, -deep / 2, 1.02])
        kind = rng.random()
        if kind < 0.55:
            lever_handle(b, panel, at, float(side), metal_)
        elif kind < 0.85:
            knob = b.spin("knob", panel, (0, -1, 0), at) if rng.random() < 0.5 else panel
            profile = [
                (0.014, 0.0006),
                (0.012, 0.03),
                (0.027, 0.042),
                (0.027, 0.055),
                (0.012, 0.062),
            ]
            knob.add(s.along(s.lathe(profile, 20), 1).moved(at), metal_, "knob")
        else:
            m.add(panel, m.place(m.handle("bow", 0.3, 0.05), at), metal_, "handle")
        if rng.random() < 0.3:
            rest[panel.link] = float(rng.uniform(0.1, spec.swing))
    return b.build(rest)


def window(rng: np.random.Generator) -> ProceduralObject:
    """Sashes that swing, tip or slide in a frame."""
    b = Builder("Window", rng)
    paint = one_color(rng, PAINTS[:6]) if rng.random() < 0.7 else wood("oak")
    b.palette = palette = Palette(paint, paint, metal("steel"), metal("steel"), paint)
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
    thick = 0.034
    if kind in ("slide", "hung"):
        _sliding_sashes(b, frame, area, (w, h), kind == "hung")
        return b.build()
    count = 1 if kind == "awning" or w < 0.9 else 2
    rest = {}
    for k in range(count):
        r = area if count == 1 else (replace(area, x1=0.0) if k == 0 else replace(area, x0=0.0))
        side: m.Side = (
            ("left", "right")[k] if count == 2 else ("top" if kind == "awning" else "left")
        )
        spec = m.DoorSpec(side, float(rng.uniform(0.9, 1.6)), "glass", None, thickness=thick)
        opening = r.shrunk(0.003)
        sash = m.door(b, frame, opening, -deep / 2 + thick + 0.004, spec, name="window")
        end = r.x1 - 0.022 if side == "left" else r.x0 + 0.022
        at = np.array(
            [
                end if side != "top" else 0.0,
                -deep / 2 + 0.004,
                r.center[1] if side != "top" else r.z0 + 0.025,
            ]
        )
        if k == 0 and rng.random() < 0.6:
            lever = b.hinge("lever", sash, (0, 1, 0), at, 0.0, np.pi / 2)
            lever.add(
                s.along(s.cylinder(0.009, 0.022, segments=12), 1).moved(
                    at + np.array([0, -0.0115, 0])
                ),
                palette.metal,
                "neck",
            )
            center = at + np.array([0, -0.027, -0.045])
            lever.add(s.box((0.016, 0.012, 0.11), center, 0.003), palette.metal, "lever")
        if rng.random() < 0.25:
            rest[sash.link] = float(rng.uniform(0.1, spec.swing))
    return b.build(rest)


def _sliding_sashes(b: Builder, frame: Body, area: m.Opening, size: Vector, upright: bool) -> None:
    """Two sashes, one before the other; only the front one has a handle."""
    w, h = size
    thick, border = 0.034, 0.045
    for k in range(2):
        overlap = border / 2
        if upright:
            mid = area.center[1]
            r = replace(area, z1=mid + overlap) if k == 0 else replace(area, z0=mid - overlap)
            axis, travel = (
                ((0, 0, 1), 0.85 * (h / 2 - overlap))
                if k == 0
                else ((0, 0, -1), 0.85 * (h / 2 - overlap))
            )
        else:
            r = replace(area, x1=overlap) if k == 0 else replace(area, x0=-overlap)
            axis = (1, 0, 0) if k == 0 else (-1, 0, 0)
            travel = 0.85 * (w / 2 - overlap)
        y = -0.002 if k == 0 else thick + 0.002
        sash = b.slide("window", frame, axis, 0.0, travel, (r.center[0], y, r.center[1]))
        m.panel(sash, r.shrunk(0.002), y, thick, "glass", b.palette, border=border)
        if k == 0 or not upright:
            grip = m.handle("lip", 0.12, 0.012)
            z = r.z0 + 0.02 if upright else r.center[1]
            x = r.center[0] if upright else (r.x0 + 0.02 if k == 0 else r.x1 - 0.02)
            if k == 0:
                solids = m.place(grip, (x, y - thick, z), roll=np.pi / 2 if upright else 0.0)
                m.add(sash, solids, b.palette.accent, "handle")


def box(rng: np.random.Generator) -> ProceduralObject:
    """A chest with one lid, a carton with two or four flaps, or a box whose lid lifts off."""
    b = Builder("Box", rng)
    kind = ("chest", "carton", "lift")[rng.integers(3)]
    skin = (
        wood(("oak", "walnut", "cherry", "beech")[rng.integers(4)])
        if kind == "chest"
        else (plain("cardboard", (190, 152, 108)) if kind == "carton" else one_color(rng, PLASTICS))
    )
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
            size = (length - 0.002, reach - 0.001, 0.003)
            flap.add(s.box(size, (0, at[1] - sign * reach / 2, z + 0.0015)), skin, "flap")
            rest[flap.link] = float(rng.uniform(0.0, 2.5)) if rng.random() < 0.7 else 0.0
        return b.build({k: v for k, v in rest.items() if v})
    lid_h = float(rng.uniform(0.012, 0.3 * h))
    top = s.tray((w, d, lid_h), wall).scaled((1, 1, -1)).moved((0, 0, h + 0.001 + lid_h))
    trim = metal(("brass", "black", "steel")[rng.integers(3)])
    if kind == "lift":
        over = s.tray((w + 0.009, d + 0.009, lid_h), 0.002).scaled((1, 1, -1))
        over = over.moved((0, 0, h + 0.003))
        lid = b.slide("lid", body, (0, 0, 1), 0.0, 1.1 * lid_h + 0.05, (0, 0, h))
        lid.add(over, skin, "lid")
        if rng.random() < 0.5:
            solids = m.handle("bow", 0.35 * w, 0.03)
            roll = np.pi / 2
            m.add(lid, m.place(solids, (0, 0, h + 0.002), face="up", roll=roll), trim, "handle")
        return b.build()
    swing = float(rng.uniform(1.5, 2.0))
    lid = b.hinge("lid", body, (-1, 0, 0), (0, d / 2 + 0.0045, h + 0.0005), 0.0, swing)
    lid.add(top, skin, "lid", grain=0)
    for x in (-0.3 * w, 0.3 * w):
        offset = (x, d / 2 + 0.0045, h + 0.0005)
        lid.add(s.along(s.cylinder(0.004, 0.04, segments=10), 0).moved(offset), trim, "hinge")
    clasp = s.box((0.03, 0.004, 0.03), (0, -d / 2 - 0.0025, h + 0.004), 0.001)
    lid.add(clasp, trim, "clasp")
    if rng.random() < 0.3:
        rest[lid.link] = float(rng.uniform(0.1, swing))
    return b.build(rest)


def safe(rng: np.random.Generator) -> ProceduralObject:
    """A steel box with a thick door, a dial or a keypad, and a handle that turns."""
    b = Builder("Safe", rng)
    skin = plain("safe", PAINTS[3:][rng.integers(len(PAINTS) - 3)])
    b.palette = palette = Palette(
        skin, skin, metal("steel"), metal("steel"), plain("dark", (36, 38, 42))
    )
    w, d, h = (float(v) for v in rng.uniform((0.3, 0.28, 0.25), (0.6, 0.5, 0.8)))
    wall, thick = float(rng.uniform(0.02, 0.045)), float(rng.uniform(0.025, 0.05))
    body = b.base("safe_body")
    m.carcass(body, (w, d, h), wall, palette, bottom=0.015)
    for x in (-1, 1):
        for y in (-1, 1):
            foot = s.cylinder(0.02, 0.018, segments=12)
            body.add(foot.moved((x * 0.4 * w, y * 0.4 * d, 0.009)), rubber(), "foot")
    size = (w - 2 * wall, 0.6 * d, 0.006)
    body.add(s.box(size, (0, 0.1 * d, 0.015 + h / 2)), palette.metal, "shelf")
    side: m.Side = "left" if rng.random() < 0.5 else "right"
    inset = rng.random() < 0.5
    r = m.Opening(-w / 2, w / 2, 0.015, 0.015 + h)
    r = r.shrunk(wall + 0.003) if inset else r.shrunk(0.001)
    y = -d / 2 + thick if inset else -d / 2 - 0.002
    spec = m.DoorSpec(side, float(rng.uniform(1.4, 1.9)), "plain", None, thickness=thick)
    door_ = m.door(b, body, r, y, spec)
    front = y - thick
    free = 1 if side == "left" else -1
    cx, cz = r.center
    mark = plain("mark", (240, 240, 240))
    if rng.random() < 0.6:
        offset = (cx + free * 0.12 * w, front, cz + 0.12 * h)
        controls.knob(b, door_, offset, (0.032, 0.025), (palette.dark, mark), style=2)
    else:
        for i in range(3):
            for j in range(3):
                at = (cx + (i - 1) * 0.024, front, cz + 0.12 * h + (j - 1) * 0.024)
                controls.push_button(b, door_, at, (0.018, 0.018, 0.004), mark)
    at = np.array([cx + free * 0.1 * w, front, cz - 0.15 * h])
    if rng.random() < 0.5:
        lever_handle(b, door_, at, -float(free), palette.metal)
    else:
        wheel = b.spin("knob", door_, (0, -1, 0), at)
        hub = s.along(s.cylinder(0.014, 0.045, segments=16), 1)
        hub = hub.moved(at + np.array([0, -0.0232, 0]))
        wheel.add(hub, palette.metal, "hub")
        for k in range(int(rng.integers(3, 6))):
            spoke = s.cylinder(0.0055, 0.06, segments=10)
            spoke = spoke.moved((0, 0, 0.04)).turned((0, 1, 0), 2 * np.pi * k / 4)
            wheel.add(spoke.moved(at + np.array([0, -0.038, 0])), palette.metal, "spoke")
    return b.build()


def suitcase(rng: np.random.Generator) -> ProceduralObject:
    """A trolley case: shell that opens, telescopic handle, wheels."""
    b = Builder("Suitcase", rng)
    skin = plain("shell", PLASTICS[rng.integers(len(PLASTICS))])
    w, d, h = (float(v) for v in rng.uniform((0.34, 0.2, 0.48), (0.5, 0.3, 0.72)))
    wheel = 0.024
    bottom = 2 * wheel + 0.01
    body = b.base("suitcase_body")
    half = d / 2 - 0.001

    def shell(front: bool) -> s.Solid:
        solid = s.tray((w, h, half), 0.004, radius=0.06, taper=0.012, corner=5)
        turned = (
            solid.turned((1, 0, 0), -np.pi / 2) if front else solid.turned((1, 0, 0), np.pi / 2)
        )
        y = -half - 0.001 if front else half + 0.001
        return turned.moved((0, y, bottom + h / 2))

    body.add(shell(False), skin, "shell")
    side = -1 if rng.random() < 0.5 else 1
    axis = (0, 0, -1) if side < 0 else (0, 0, 1)
    origin = (side * (w / 2 + 0.001), 0.0, bottom + h / 2)
    lid = b.hinge("lid", body, axis, origin, 0.0, float(rng.uniform(1.8, 3.0)))
    lid.add(shell(True), skin, "shell")
    for k in range(int(rng.integers(0, 5))):
        size = (0.012, 0.006, 0.72 * h)
        rib = s.box(size, ((k - 2) * 0.14 * w, -half - 0.001, bottom + h / 2), 0.002)
        lid.add(rib, skin, "rib")
    pull = float(rng.uniform(0.25, 0.4))
    handle = b.slide("handle", body, (0, 0, 1), 0.0, pull, (0, d / 4, bottom + h))
    grey = metal("steel")
    y = half + 0.016
    length = 0.85 * h
    for x in (-0.18 * w, 0.18 * w):
        profile = [
            (0.0075, bottom),
            (0.0105, bottom),
            (0.0105, bottom + h - 0.03),
            (0.0075, bottom + h - 0.03),
        ]
        sleeve = s.ring(profile, 14)
        body.add(sleeve.moved((x, y, 0)), plain("sleeve", (50, 52, 56)), "sleeve")
        bar = s.cylinder(0.0065, length, segments=12).moved((x, y, bottom + h - length / 2 + 0.02))
        handle.add(bar, grey, "bar")
    grip = s.rounded_box((0.36 * w + 0.04, 0.022, 0.026), 0.009, rim=0.006)
    handle.add(grip.moved((0, y, bottom + h + 0.03)), plain("grip", (40, 40, 44)), "grip")
    spinner = rng.random() < 0.6
    dark = plain("dark", (40, 40, 44))
    b.palette = Palette(skin, skin, metal("dark"), metal("dark"), dark)
    spots = [(-1, -0.6), (1, -0.6), (-1, 0.6), (1, 0.6)] if spinner else [(-1, 0.6), (1, 0.6)]
    for sx, sy in spots:
        parent = lid if sy < 0 else body
        top = (sx * (w / 2 - 0.07), sy * half, bottom - 0.001)
        controls.caster(
            b,
            parent,
            top,
            wheel,
            rubber(),
            swivel=spinner,
            heading=float(rng.random() * 6.28) if spinner else 0.0,
        )
    return b.build()


def trash_can(rng: np.random.Generator) -> ProceduralObject:
    """A bin with a hinged, swinging or lift-off lid, perhaps a pedal or wheels."""
    b = Builder("TrashCan", rng)
    skin = metal("brushed") if rng.random() < 0.3 else one_color(rng, PLASTICS)
    dark = plain("dark", (44, 46, 50))
    body = b.base("trashcan_body")
    h = float(rng.uniform(0.3, 0.8))
    round_ = rng.random() < 0.4
    w = float(rng.uniform(0.45, 0.75)) * h
    d = w if round_ else w * float(rng.uniform(0.75, 1.0))
    wall, lift = 0.004, 0.02
    if round_:
        r = w / 2
        profile = [
            (0.88 * r, lift),
            (r, lift + h),
            (r - wall, lift + h),
            (0.88 * r - wall, lift + wall),
        ]
        body.add(s.lathe(profile, 32), skin, "body")
    else:
        size = (w, d, h)
        body.add(s.tray(size, wall, radius=0.03, taper=0.08 * w).moved((0, 0, lift)), skin, "body")
    body.add(s.box((0.7 * w, 0.7 * d, lift), (0, 0, lift / 2)), dark, "base")
    top, kind = lift + h + 0.001, rng.random()
    rest: dict[str, float] = {}
    outline = s.circle(w / 2, 32) if round_ else s.rectangle(w, d, 0.03, 3)
    if kind < 0.55:
        axis = (-1, 0, 0)
        lid = b.hinge("lid", body, axis, (0, d / 2 + 0.004, top), 0.0, float(rng.uniform(1.2, 1.7)))
        loops = [s.at(outline, top), s.at(outline, top + 0.012), s.at(0.9 * outline, top + 0.025)]
        lid.add(s.loft(loops), dark if rng.random() < 0.5 else skin, "lid")
        offset = (0, d / 2 + 0.004, top + 0.002)
        lid.add(s.along(s.cylinder(0.006, 0.35 * w, segments=12), 0).moved(offset), dark, "hinge")
        _pedal_or_wheels(b, body, w, d, dark)
        if rng.random() < 0.25:
            rest[lid.link] = float(rng.uniform(0.1, 1.2))
    elif kind < 0.8:
        rim = [
            s.at(outline * f, z)
            for f, z in (
                (1.0, top),
                (1.0, top + 0.1),
                (0.86, top + 0.12),
                (0.84, top + 0.12),
                (0.97, top + 0.1),
                (0.97, top),
            )
        ]
        body.add(s.loft(rim, ring=True), dark, "rim")
        inner = np.abs(outline).max(0) * 0.8
        z = top + 0.125
        lid = b.hinge("lid", body, (1, 0, 0), (0, 0, z), -0.9, 0.9)
        flap = s.slab(
            s.circle(inner[0], 28)
            if round_
            else s.rectangle(2 * inner[0], 1.7 * inner[1], 0.02, 2),
            0.005,
        )
        lid.add(flap.moved((0, 0, z)), skin, "flap")
    else:
        lid = b.slide("lid", body, (0, 0, 1), 0.0, float(rng.uniform(0.08, 0.2)), (0, 0, top))
        loops = [
            s.at(1.02 * outline, top),
            s.at(1.02 * outline, top + 0.015),
            s.at(0.85 * outline, top + 0.035),
        ]
        lid.add(s.loft(loops), dark, "lid")
        solids = m.handle("bow", 0.4 * w, 0.035)
        m.add(lid, m.place(solids, (0, 0, top + 0.034), face="up", roll=np.pi / 2), dark, "handle")
    return b.build(rest)


def _pedal_or_wheels(b: Builder, body: Body, w: float, d: float, dark: Surface) -> None:
    if b.rng.random() < 0.5:
        pedal = b.hinge("pedal", body, (1, 0, 0), (0, -d / 2 + 0.12 * d, 0.014), 0.0, 0.1)
        reach = 0.1 * d + 0.05
        center = (0, -d / 2 - reach / 2 + 0.05 * d + 0.003, 0.0145)
        pedal.add(s.box((0.3 * w, reach, 0.006), center, 0.001), metal("steel"), "pedal")
    elif b.rng.random() < 0.4:
        for side in (-1, 1):
            at = (side * (0.35 * w + 0.012), d / 2 - 0.02, 0.05)
            wheel = b.spin("wheel", body, (1, 0, 0), at)
            tyre, hub = controls.wheel(0.05, 0.02)
            solids = [t.moved((side * (w / 2 + 0.014), d / 2 - 0.02, 0.05)) for t in tyre]
            m.add(wheel, solids, rubber(), "tyre")
            solids = [t.moved((side * (w / 2 + 0.014), d / 2 - 0.02, 0.05)) for t in hub]
            m.add(wheel, solids, dark, "hub")
