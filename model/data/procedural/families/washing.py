"""Dishwasher and WashingMachine, Toilet and Faucet."""

from __future__ import annotations

import numpy as np

from model.data.procedural import controls
from model.data.procedural import modules as m
from model.data.procedural import shapes as s
from model.data.procedural.families.kitchen import housing
from model.data.procedural.grammar import Body, Builder, ProceduralObject
from model.data.procedural.materials import (
    Palette,
    appliance_palette,
    glass,
    metal,
    pictured,
    plain,
    wood,
)


def basket(width: float, depth: float, height: float) -> s.Solid:
    """A rack as a shallow tray on z = 0."""
    return s.tray((width, depth, height), 0.005, radius=0.02)


def dishwasher(rng: np.random.Generator) -> ProceduralObject:
    """A door that folds down, racks that slide out, buttons above."""
    b = Builder("Dishwasher", rng)
    b.palette = palette = appliance_palette(rng)
    w, d, h = (float(v) for v in rng.uniform((0.45, 0.52, 0.76), (0.6, 0.6, 0.84)))
    bottom, wall, thick = 0.08, 0.03, 0.03
    body = b.base("dishwasher_body")
    size = (0.96 * w, 0.8 * d, bottom + 0.002)
    body.add(s.box(size, (0, 0.05 * d, bottom / 2)), palette.dark, "plinth")
    built_in = rng.random() < 0.5
    strip = 0.0 if built_in else 0.1
    opening = m.Opening(-w / 2 + wall, w / 2 - wall, bottom + wall, bottom + h - strip - wall)
    housing(body, (w, d, h), opening, palette, bottom)
    front = -d / 2
    top = bottom + h - strip
    style: m.HandleStyle | None = ("bar", "bow", "flat", "lip")[rng.integers(4)]
    m.door(
        b,
        body,
        m.Opening(-w / 2 + 0.001, w / 2 - 0.001, bottom + 0.002, top - 0.003),
        front - 0.002,
        m.DoorSpec("bottom", np.pi / 2, "plain", style, 0.7 * w, 0.04, 0.5, 0.06, thick),
    )
    count = int(rng.integers(2, 7))
    if strip:
        center = (0, front - thick / 2, top + strip / 2)
        body.add(s.box((w, thick, strip - 0.002), center, 0.003), palette.dark, "control_panel")
        for k in range(count):
            x = (k - (count - 1) / 2) * 0.045
            at = (x, front - thick, top + strip / 2)
            size = (0.026, 0.016, 0.005)
            controls.push_button(b, body, at, size, palette.accent, round_=bool(k % 2))
        controls.knob(
            b,
            body,
            (0.4 * w, front - thick, top + strip / 2),
            (0.028, 0.022),
            (palette.accent, plain("mark", (230, 230, 230))),
            style=int(rng.integers(3)),
        )
    for k in range(int(rng.integers(1, 3))):
        z = opening.z0 + (0.08 + 0.5 * k) * opening.height
        shelf = b.slide("shelf", body, (0, -1, 0), 0.0, 0.62 * d, (0, 0, z))
        deep = 0.76 * d
        solid = basket(opening.width - 0.012, deep, 0.09).moved((0, front + deep / 2 + 0.012, z))
        shelf.add(solid, metal("white"), "rack")
    return b.build()


def washing_machine(rng: np.random.Generator) -> ProceduralObject:
    """A front loader: round door, drum, detergent drawer, programme knob and buttons."""
    b = Builder("WashingMachine", rng)
    b.palette = palette = appliance_palette(rng)
    w, d, h = (float(v) for v in rng.uniform((0.55, 0.48, 0.8), (0.65, 0.6, 0.9)))
    bottom, strip = 0.02, 0.12
    body = b.base("washingmachine_body")
    radius = float(rng.uniform(0.26, 0.32)) * w
    cz = bottom + 0.5 * (h - strip)
    front = -d / 2
    _round_opening(body, w, d, h, bottom, radius, cz, palette)
    for x in (-1, 1):
        for y in (-1, 1):
            at = (x * 0.42 * w, y * 0.4 * d, bottom / 2 + 0.002)
            body.add(s.cylinder(0.02, bottom + 0.004, segments=12).moved(at), palette.dark, "foot")
    _porthole(b, body, radius, front, cz)
    drum = b.spin("drum", body, (0, 1, 0), (0, 0, cz))
    r = 0.93 * radius
    profile = [
        (r, 0),
        (r, 0.6 * d),
        (0.0, 0.6 * d),
        (0.0, 0.59 * d),
        (0.95 * r, 0.59 * d),
        (0.95 * r, 0),
    ]
    shell = s.lathe(profile, 28)
    at = (0, front + 0.05, cz)
    drum.add(s.along(shell, 1).scaled((1, -1, 1)).moved(at), metal("steel"), "drum")
    for k in range(3):
        fin = s.box((0.03, 0.45 * d, 0.16 * r), (0, front + 0.05 + 0.3 * d, 0.86 * r), 0.004)
        drum.add(fin.turned((0, 1, 0), 2.094 * k).moved((0, 0, cz)), metal("steel"), "fin")
    zs = bottom + h - strip / 2
    _washing_controls(b, body, w, front, zs, strip)
    return b.build()


def _round_opening(
    body: Body,
    w: float,
    d: float,
    h: float,
    bottom: float,
    radius: float,
    cz: float,
    palette: Palette,
) -> None:
    """A cabinet with a round hole in its front, hollow behind it."""
    wall, front = 0.015, -d / 2
    angles = (np.arange(32) + 0.5) * 2 * np.pi / 32
    unit = np.stack([np.cos(angles), np.sin(angles)], 1)
    low, high = bottom - cz, bottom + h - cz
    for x, z in ((w / 2, high), (-w / 2, high), (-w / 2, low), (w / 2, low)):
        # The corners belong to the outline: the nearest direction is turned to each.
        corner = np.array([x, z]) / np.hypot(x, z)
        unit[np.argmax(unit @ corner)] = corner
    # The outer rim: where the ray at each angle leaves the rectangle.
    with np.errstate(divide="ignore"):
        reach = np.minimum(
            (w / 2) / np.abs(unit[:, 0]),
            np.where(unit[:, 1] > 0, high / unit[:, 1], low / unit[:, 1]),
        )
    outer, inner = unit * reach[:, None], unit * radius
    loops = [
        s.at(outer, wall / 2),
        s.at(outer, -wall / 2),
        s.at(inner, -wall / 2),
        s.at(inner, wall / 2),
    ]
    plate = s.along(s.loft(loops, ring=True), 1).moved((0, front + wall / 2, cz))
    body.add(plate, palette.front, "front")
    z = bottom + h / 2
    for side in (-1, 1):
        center = (side * (w - wall) / 2, wall / 2, z)
        body.add(s.box((wall, d - wall, h), center, 0.003), palette.body, "side_wall")
    body.add(s.box((w - 2 * wall, wall, h), (0, (d - wall) / 2, z)), palette.body, "back")
    for at in (bottom + wall / 2, bottom + h - wall / 2):
        body.add(s.box((w - 2 * wall, d - 2 * wall, wall), (0, 0, at)), palette.body, "wall")
    size = (w + 0.004, d + 0.004, 0.02)
    body.add(s.box(size, (0, 0, bottom + h + 0.009), 0.005), palette.body, "top")


def _porthole(b: Builder, body: Body, radius: float, front: float, cz: float) -> None:
    palette, rng = b.palette, b.rng
    outer, thick = 1.18 * radius, 0.04
    side = -1 if rng.random() < 0.6 else 1
    hinge_x = side * (outer + 0.012)
    axis = (0, 0, -1) if side < 0 else (0, 0, 1)
    origin = (hinge_x, front - 0.5 * thick, cz)
    door = b.hinge("door", body, axis, origin, 0.0, float(rng.uniform(1.8, 2.6)))
    profile = [
        (0.72 * radius, 0.004),
        (outer, 0.004),
        (outer, 0.6 * thick),
        (0.92 * outer, thick),
        (0.78 * radius, 0.9 * thick),
    ]
    rim = s.ring(profile, 36)
    surface = palette.accent if rng.random() < 0.5 else metal("white")
    door.add(s.along(rim, 1).moved((0, front, cz)), surface, "rim")
    profile = [
        (0.74 * radius, 0.012),
        (0.74 * radius, 0.024),
        (0.0, 0.03),
        (0.0, 0.024),
        (0.7 * radius, 0.012),
    ]
    bowl = s.lathe(profile, 28)
    door.add(s.along(bowl, 1).moved((0, front, cz)), glass((90, 110, 120), 160), "glass")
    lug = s.box((0.05, 0.02, 0.09), (side * (outer - 0.012), front - 0.5 * thick, cz), 0.004)
    door.add(lug, palette.metal, "hinge")
    grip = m.handle("flat", 0.09, 0.02)
    solids = m.place(grip, (-side * 0.9 * outer, front - 0.8 * thick, cz))
    m.add(door, solids, palette.dark, "handle")


def _washing_controls(
    b: Builder, body: Body, w: float, front: float, z: float, strip: float
) -> None:
    palette, rng = b.palette, b.rng
    face = front - 0.012
    if rng.random() < 0.85:
        r = m.Opening(-0.47 * w, -0.2 * w, z - 0.4 * strip, z + 0.38 * strip)
        drawer = b.slide("drawer", body, (0, -1, 0), 0.0, 0.18, (r.center[0], front, r.center[1]))
        m.panel(drawer, r, front - 0.001, 0.014, "plain", palette)
        grip = m.handle("lip", 0.6 * r.width, 0.016)
        solids = m.place(grip, (r.center[0], front - 0.015, r.z0 + 0.02), roll=np.pi / 2)
        m.add(drawer, solids, palette.dark, "handle")
    size = (0.64 * w, 0.012, 0.74 * strip)
    body.add(s.box(size, (0.155 * w, front - 0.006, z), 0.003), palette.dark, "control_panel")
    mark = plain("mark", (240, 240, 240))
    controls.knob(
        b,
        body,
        (0.0, face, z),
        (0.03, 0.025),
        (metal("white"), palette.dark),
        style=int(rng.integers(3)),
        limits=None if rng.random() < 0.7 else (-2.6, 2.6),
    )
    size = (0.15 * w, 0.004, 0.35 * strip)
    center = (0.17 * w, face - 0.001, z)
    body.add(s.box(size, center), pictured("panel", int(rng.integers(5))), "display")
    for k in range(int(rng.integers(2, 6))):
        at = (0.29 * w + 0.034 * k - 0.02, face, z)
        controls.push_button(b, body, at, (0.018, 0.018, 0.005), mark, round_=True)


def toilet(rng: np.random.Generator) -> ProceduralObject:
    """Bowl, seat, lid, cistern, and a button or a lever."""
    b = Builder("Toilet", rng)
    white = plain("ceramic", (240, 240, 238))
    seat_skin = white if rng.random() < 0.6 else wood("oak")
    body = b.base("toilet_body")
    h, length, w = map(float, rng.uniform((0.36, 0.42, 0.34), (0.42, 0.5, 0.39)))
    a = np.arange(36) * 2 * np.pi / 36
    egg = np.stack([0.5 * w * np.cos(a), 0.5 * length * np.sin(a) * (1 - 0.08 * np.sin(a))], 1)

    def at(f: float, z: float, shift: float = 0.0) -> np.ndarray:
        return s.at(egg * f + np.array([0, shift]), z)

    levels = [
        at(0.6, 0, 0.05),
        at(0.55, 0.08, 0.05),
        at(0.75, 0.6 * h, 0.03),
        at(1.0, h - 0.02),
        at(1.0, h),
        at(0.75, h),
        at(0.5, 0.55 * h, 0.02),
    ]
    body.add(s.loft(levels), white, "bowl")
    back = length / 2
    tank_d, tank_h, tank_w = 0.18, float(rng.uniform(0.3, 0.4)), w + float(rng.uniform(0.0, 0.08))
    y = back + tank_d / 2 - 0.02
    size = (tank_w - 0.06, tank_d, h - 0.02)
    body.add(s.rounded_box(size, 0.03).moved((0, y, h / 2 - 0.01)), white, "foot")
    size = (tank_w, tank_d, tank_h)
    body.add(s.rounded_box(size, 0.025).moved((0, y, h + tank_h / 2)), white, "tank")
    top = h + tank_h
    size = (tank_w + 0.014, tank_d + 0.012, 0.025)
    body.add(s.rounded_box(size, 0.028).moved((0, y, top + 0.0115)), white, "tank_lid")
    hinge = (0.0, back - 0.05, h + 0.026)
    loops = [at(1.02, h + 0.004), at(1.02, h + 0.018), at(0.68, h + 0.018), at(0.68, h + 0.004)]
    ring = s.loft(loops, ring=True)
    cut = ring.shaped(
        lambda v: np.column_stack([v[:, 0], np.minimum(v[:, 1], back - 0.05), v[:, 2]])
    )
    upright = float(rng.uniform(1.45, 1.57))
    # Both stop against the cistern; the lid lies behind the seat there.
    seat = b.hinge("seat", body, (-1, 0, 0), hinge, 0.0, upright - 0.06)
    seat.add(cut, seat_skin, "seat")
    cover = s.loft([at(1.03, h + 0.0215), at(1.03, h + 0.03), at(0.97, h + 0.037)])
    cover = cover.shaped(
        lambda v: np.column_stack([v[:, 0], np.minimum(v[:, 1], back - 0.05), v[:, 2]])
    )
    lid = b.hinge("lid", body, (-1, 0, 0), hinge, 0.0, upright)
    lid.add(cover, seat_skin, "lid")
    if rng.random() < 0.6:
        size = (0.05, 0.05, 0.006)
        surface = metal("steel")
        controls.push_button(b, body, (0, y, top + 0.024), size, surface, face="up", round_=True)
    else:
        spot = np.array([-0.35 * tank_w, y - tank_d / 2, h + 0.8 * tank_h])
        lever = b.hinge("lever", body, (0, 1, 0), spot, 0.0, 0.6)
        offset = spot + np.array([0, -0.0105, 0])
        lever.add(
            s.along(s.cylinder(0.007, 0.02, segments=12), 1).moved(offset), metal("steel"), "neck"
        )
        size = (0.09, 0.008, 0.014)
        lever.add(s.box(size, spot + np.array([0.035, -0.022, 0]), 0.003), metal("steel"), "lever")
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
        size = (width + 0.05, 0.05, 0.014)
        base.add(s.rounded_box(size, 0.02).moved((0, 0, 0.007)), skin, "plate")
    else:
        offset = (0, 0, 0.005)
        base.add(s.cylinder(1.7 * r, 0.01, segments=28, bevel=0.002).moved(offset), skin, "plate")
    base.add(s.cylinder(1.15 * r, h, segments=24).moved((0, 0, h / 2)), skin, "post")
    z = h + 0.0008
    reach, rise = float(rng.uniform(0.12, 0.2)), float(rng.uniform(0.08, 0.24))
    swivel = b.hinge("spout", base, (0, 0, 1), (0, 0, z), -1.8, 1.8) if rng.random() < 0.8 else base
    thin = 0.6 * r
    if rng.random() < 0.5:
        a = np.linspace(np.pi, 0, 13)
        arc = np.stack(
            [0 * a, -reach / 2 - reach / 2 * np.cos(a), z + rise + 0.5 * reach * np.sin(a)], 1
        )
        path = np.vstack([[0, 0, z + 0.001], arc, [0, -reach, z + rise - 0.03]])
    else:
        corners = [
            (0, 0, z + 0.001),
            (0, 0, z + rise),
            (0, -reach, z + rise + 0.01),
            (0, -reach, z + rise - 0.03),
        ]
        path = s.bent_path(corners, 0.03)
    swivel.add(s.tube(path, thin, 14), skin, "spout")
    swivel.add(s.cylinder(1.1 * r, 0.02, segments=24).moved((0, 0, z + 0.0108)), skin, "collar")
    if two:
        for side in (-1, 1):
            x = side * width / 2
            base.add(s.cylinder(0.015, 0.03, segments=20).moved((x, 0, 0.028)), skin, "valve")
            at = (x, 0, 0.044)
            turn = b.hinge("switch", base, (0, 0, side), at, 0.0, float(rng.uniform(1.4, 3.2)))
            if rng.random() < 0.5:
                turn.add(
                    s.cylinder(0.013, 0.018, segments=18, bevel=0.002).moved((x, 0, 0.0535)),
                    skin,
                    "hub",
                )
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
    offset = at + np.array([side * 0.0075, 0, 0])
    lever.add(
        s.along(s.cylinder(0.0125, 0.014, segments=18, bevel=0.001), 0).moved(offset), skin, "hub"
    )
    solid = s.cylinder(0.004, 0.075, segments=10).moved(at + np.array([side * 0.0085, 0, 0.046]))
    lever.add(solid, skin, "lever")
    return b.build()
