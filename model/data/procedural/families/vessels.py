"""Kettle, KitchenPot, Bottle, Bucket, Dispenser: surfaces of revolution."""

from __future__ import annotations

import numpy as np

from model.data.procedural import shapes as s
from model.data.procedural.grammar import Body, Builder, ProceduralObject
from model.data.procedural.materials import METALS, PLASTICS, Surface, glass, metal, plain


def vessel_surface(rng: np.random.Generator) -> Surface:
    """Steel, copper, enamel or plastic."""
    if rng.random() < 0.5:
        return metal(("steel", "copper", "dark", "white")[rng.integers(4)])
    return plain("enamel", PLASTICS[rng.integers(len(PLASTICS))])


def shell_profile(outline: list[tuple[float, float]], wall: float) -> list[tuple[float, float]]:
    """Up the outside of an (r, z) outline and down inside: an open vessel with a floor."""
    inside = [(max(r - wall, 1e-4), max(z, wall)) for r, z in reversed(outline)]
    return [*outline, *inside]


def _knob_on_lid(rng: np.random.Generator, z: float) -> s.Solid:
    r = float(rng.uniform(0.012, 0.02))
    profile = [
        (0.5 * r, z - 0.001),
        (0.45 * r, z + 0.4 * r),
        (r, z + 0.9 * r),
        (0.9 * r, z + 1.4 * r),
        (0.3 * r, z + 1.6 * r),
    ]
    return s.lathe(profile, 18)


def kettle(rng: np.random.Generator) -> ProceduralObject:
    """A belly with a spout, a handle over it or behind it, and a lid that lifts or tips."""
    b = Builder("Kettle", rng)
    skin = vessel_surface(rng)
    dark = plain("grip", (36, 36, 40)) if rng.random() < 0.7 else metal("brass")
    body = b.base("kettle_body")
    r, h = float(rng.uniform(0.07, 0.1)), float(rng.uniform(0.12, 0.2))
    mouth = float(rng.uniform(0.45, 0.65)) * r
    low, foot = float(rng.uniform(0.2, 0.42)), float(rng.uniform(0.72, 0.95)) * r
    outline = [(0.96 * foot, 0.0)]
    outline += [
        (foot + (r - foot) * np.sin(t), low * h * t / (np.pi / 2))
        for t in np.linspace(0.08, np.pi / 2, 5)
    ]
    outline += [
        (mouth + (r - mouth) * np.cos(t), h * (low + (1 - low) * np.sin(t) ** 1.2))
        for t in np.linspace(0.15, np.pi / 2, 9)
    ]
    body.add(s.lathe(shell_profile(outline, 0.003), 36), skin, "body")
    _spout(body, r, h, float(rng.uniform(0.012, 0.018)), skin, bool(rng.random() < 0.5))
    lid_r, lid_z = mouth - 0.006, h + 0.0012
    over = rng.random() < 0.5
    dome = [
        (mouth, lid_z),
        (mouth, lid_z + 0.004),
        (0.7 * mouth, lid_z + 0.012),
        (0.0, lid_z + 0.016),
    ]
    plug = s.lathe([(lid_r, lid_z - 0.008), *dome], 32)
    if rng.random() < 0.5 and not over:
        hinge = (mouth + 0.006, 0.0, lid_z + 0.004)
        lid = b.hinge("lid", body, (0, 1, 0), hinge, 0.0, 1.35)
        plug = s.lathe(dome, 32)
        lid.add(s.along(s.cylinder(0.004, 0.02, segments=12), 1).moved(hinge), dark, "hinge")
        lid.add(s.box((0.012, 0.014, 0.003), (mouth, 0, lid_z + 0.003)), skin, "hinge")
    elif over:
        lid = b.screw("lid", body, (0, 0, 1), (0, 0, lid_z), 0.028)
    else:
        lid = b.slide("lid", body, (0, 0, 1), 0.0, 0.1, (0, 0, lid_z))
    lid.add(plug, skin, "lid")
    lid.add(_knob_on_lid(rng, lid_z + 0.015), dark, "knob")
    if over:
        _bow(b, body, outline, h, skin, dark, swings=bool(rng.random() < 0.6))
    else:
        corners = [
            (0.93 * r, 0, 0.85 * h),
            (r + 0.055, 0, 0.86 * h),
            (r + 0.05, 0, 0.2 * h),
            (0.98 * r, 0, 0.16 * h),
        ]
        path = s.bent_path(corners, 0.04)
        body.add(s.sweep(path, s.rectangle(0.02, 0.012, 0.004)), dark, "handle")
    return b.build()


def _bow(
    b: Builder,
    body: Body,
    outline: list[tuple[float, float]],
    h: float,
    skin: Surface,
    grip: Surface,
    *,
    swings: bool,
) -> None:
    """A handle over the lid; where it swings, it turns on ears at its two feet."""
    rows = np.asarray(outline)
    z = 0.7 * h
    wall = float(np.interp(z, rows[:, 1], rows[:, 0]))
    widest = float(rows[:, 0].max())
    reach = max(wall + 0.012, widest + 0.008) if swings else wall
    a = np.linspace(0.0, np.pi, 21)
    rise = 0.3 * h + 0.09
    path = np.stack([0 * a, reach * np.cos(a), z + rise * np.sin(a) ** 0.85], 1)
    bow = s.sweep(path, s.rectangle(0.009, 0.018, 0.003))
    if not swings:
        body.add(bow, grip, "handle")
        return
    handle = b.hinge("handle", body, (0, 1, 0), (0, 0, z), -0.5, 0.5)
    handle.add(bow, grip, "handle")
    for side in (-1, 1):
        length = reach - 0.0052 - wall + 0.006
        ear = s.along(s.cylinder(0.008, length, segments=14), 1)
        body.add(ear.moved((0, side * (wall - 0.006 + length / 2), z)), skin, "ear")


def _spout(body: Body, r: float, h: float, thick: float, skin: Surface, gooseneck: bool) -> None:
    if gooseneck:
        corners = [
            (-0.85 * r, 0, 0.25 * h),
            (-1.45 * r, 0, 0.3 * h),
            (-1.5 * r, 0, 0.85 * h),
            (-2.0 * r, 0, 0.97 * h),
        ]
        path = s.bent_path(corners, 0.05)
        outline = s.circle(thick, 14)
        body.add(s.sweep(path, outline, scale=np.linspace(1.2, 0.55, len(path))), skin, "spout")
    else:
        path = np.linspace([-0.7 * r, 0, 0.5 * h], [-1.5 * r, 0, 0.95 * h], 5)
        outline = s.circle(1.4 * thick, 16)
        body.add(s.sweep(path, outline, scale=np.linspace(1.3, 0.7, 5)), skin, "spout")


def kitchen_pot(rng: np.random.Generator) -> ProceduralObject:
    """A pot or pan with one or two handles and a lid."""
    b = Builder("KitchenPot", rng)
    skin = vessel_surface(rng)
    grip = plain("grip", (36, 36, 40)) if rng.random() < 0.6 else metal("steel")
    r, h = float(rng.uniform(0.08, 0.15)), float(rng.uniform(0.06, 0.2))
    body = b.base("pot_body")
    flare = rng.uniform(0.0, 0.12)
    outline = [
        (r * (0.9 - flare), 0.0),
        (r * (0.97 - flare), 0.006),
        (r * (1 - 0.6 * flare), 0.3 * h),
        (r, h),
        (1.03 * r, h + 0.002),
    ]
    body.add(s.lathe(shell_profile(outline, 0.0035), 40), skin, "body")
    if rng.random() < 0.65:
        for side in (-1, 1):
            x = side * (r - 0.002)
            corners = [
                (x, -0.035, 0.82 * h),
                (x + side * 0.035, -0.03, 0.84 * h),
                (x + side * 0.035, 0.03, 0.84 * h),
                (x, 0.035, 0.82 * h),
            ]
            path = s.bent_path(corners, 0.02)
            body.add(s.tube(path, 0.005, 10), grip, "handle")
    else:
        path = np.linspace([r - 0.003, 0, 0.75 * h], [r + 0.19, 0, 0.75 * h + 0.03], 6)
        scale = [0.7, 0.8, 1, 1.1, 1.1, 1.0]
        body.add(s.sweep(path, s.rectangle(0.024, 0.014, 0.005), scale=scale), grip, "handle")
    z = h + 0.003
    clear = glass() if rng.random() < 0.4 else skin
    rise = float(rng.uniform(0.015, 0.035))
    dome = [(1.03 * r, z), (1.03 * r, z + 0.004)]
    dome += [
        (1.02 * r * np.cos(t), z + 0.004 + rise * np.sin(t)) for t in np.linspace(0.2, np.pi / 2, 6)
    ]
    under = [(max(rr - 0.002, 0), zz - 0.0035) for rr, zz in reversed(dome[2:])]
    lid = (
        b.slide("lid", body, (0, 0, 1), 0.0, float(rng.uniform(0.1, 0.2)), (0, 0, z))
        if rng.random() < 0.6
        else b.screw("lid", body, (0, 0, 1), (0, 0, z), float(rng.uniform(0.1, 0.2)))
    )
    lid.add(s.lathe([*dome, *under, (1.0 * r, z)], 40), clear, "lid")
    lid.add(_knob_on_lid(rng, z + rise + 0.0035), grip, "knob")
    return b.build()


def bottle(rng: np.random.Generator) -> ProceduralObject:
    """A body with a neck and a screw cap, a flip cap or a pump."""
    b = Builder("Bottle", rng)
    glass = [(60, 110, 80), (120, 70, 40), (190, 210, 220), (60, 90, 150), *PLASTICS]
    skin = plain("bottle", glass[rng.integers(len(glass))])
    cap = (
        plain("cap", PLASTICS[rng.integers(len(PLASTICS))])
        if rng.random() < 0.7
        else metal("steel")
    )
    body = b.base("bottle_body")
    r, h = float(rng.uniform(0.025, 0.05)), float(rng.uniform(0.1, 0.24))
    neck = float(rng.uniform(0.3, 0.55)) * r
    neck_h = float(rng.uniform(0.1, 0.35)) * h
    shoulder = float(rng.uniform(0.1, 0.25)) * h
    top = h - neck_h
    bend = [
        (r + (neck - r) * (1 - np.cos(t)) / 1.0, top - shoulder * (1 - np.sin(t)))
        for t in np.linspace(0, np.pi / 2, 6)
    ]
    profile = [(0.85 * r, 0), (r, 0.012), *bend, (neck, h)]
    body.add(s.lathe(shell_profile(profile, 0.0015), 32), skin, "body")
    outline = [
        (neck, h - 0.32 * neck_h),
        (1.25 * neck, h - 0.32 * neck_h),
        (1.25 * neck, h - 0.25 * neck_h),
        (neck, h - 0.25 * neck_h),
    ]
    body.add(s.ring(outline, 24), skin, "collar")
    cap_h = 0.24 * neck_h + 0.014
    z0 = h - 0.24 * neck_h
    style = rng.random()
    if style < 0.7:
        lid = b.screw("lid", body, (0, 0, 1), (0, 0, h), cap_h + float(rng.uniform(0.0, 0.03)))
        angles = np.arange(36) * 2 * np.pi / 36
        knurl = (1.22 * neck * (1 + 0.025 * np.cos(12 * angles)))[:, None] * np.stack(
            [np.cos(angles), np.sin(angles)], 1
        )
        inner = 1.04 * neck * np.stack([np.cos(angles), np.sin(angles)], 1)
        loops = [
            s.at(inner, h + 0.001),
            s.at(inner, z0),
            s.at(knurl, z0),
            s.at(knurl, z0 + cap_h - 0.002),
            s.at(0.92 * knurl, z0 + cap_h),
        ]
        lid.add(s.loft(loops), cap, "cap")
    elif style < 0.85:
        at = (0, 0, h + 0.005)
        body.add(s.cylinder(1.2 * neck, 0.012, segments=24, bevel=0.001).moved(at), cap, "cap_base")
        z = h + 0.0115
        lid = b.hinge("lid", body, (-1, 0, 0), (0, 1.22 * neck, z), 0.0, 2.2)
        at = (0, 0, z + 0.0055)
        lid.add(s.cylinder(1.2 * neck, 0.01, segments=24, bevel=0.0015).moved(at), cap, "cap")
        at = (0, 1.22 * neck, z)
        lid.add(s.along(s.cylinder(0.0016, neck, segments=8), 0).moved(at), cap, "hinge")
    else:
        pump = b.slide("lid", body, (0, 0, -1), 0.0, 0.018, (0, 0, h))
        outline = [
            (0.32 * neck, h - 0.001),
            (1.2 * neck, h - 0.001),
            (1.2 * neck, h + 0.012),
            (0.32 * neck, h + 0.012),
        ]
        body.add(s.ring(outline, 24), cap, "cap_base")
        at = (0, 0, h + 0.023)
        pump.add(s.cylinder(0.28 * neck, 0.05, segments=14).moved(at), metal("steel"), "stem")
        at = (0, 0, h + 0.05)
        pump.add(s.cylinder(0.8 * neck, 0.012, segments=20, bevel=0.002).moved(at), cap, "head")
        nozzle = np.array(
            [(0, 0, h + 0.05), (0, -1.2 * neck, h + 0.05), (0, -2.6 * neck, h + 0.044)]
        )
        pump.add(s.sweep(nozzle, s.circle(0.25 * neck, 10)), cap, "nozzle")
    return b.build()


def bucket(rng: np.random.Generator) -> ProceduralObject:
    """A bucket whose bow handle swings on two ears."""
    b = Builder("Bucket", rng)
    skin = (
        vessel_surface(rng)
        if rng.random() < 0.5
        else plain("bucket", PLASTICS[rng.integers(len(PLASTICS))])
    )
    body = b.base("bucket_body")
    r, h = float(rng.uniform(0.1, 0.16)), float(rng.uniform(0.2, 0.32))
    low = r * float(rng.uniform(0.65, 0.85))
    outline = [(low, 0), (low + 0.002, 0.004), (r, h - 0.012), (1.04 * r, h - 0.01), (1.04 * r, h)]
    body.add(s.lathe([*outline, (r - 0.004, h), (low - 0.002, 0.005)], 36), skin, "body")
    z = h - 0.03
    reach = 1.04 * r + 0.006
    for side in (-1, 1):
        at = (side * (reach - 0.0075), 0, z)
        ear = s.along(s.cylinder(0.012, 0.012, segments=14), 0).moved(at)
        body.add(ear, skin, "ear")
    handle = b.hinge("handle", body, (1, 0, 0), (0, 0, z), -1.5, 1.5)
    a = np.linspace(0, np.pi, 21)
    rise = reach + float(rng.uniform(0.014, 0.05))
    path = np.stack([(reach + 0.0035) * np.cos(a), 0 * a, z + rise * np.sin(a)], 1)
    handle.add(s.tube(path, 0.003, 8), metal("steel"), "handle")
    if rng.random() < 0.6:
        grip = s.along(s.cylinder(0.01, 0.09, segments=14, bevel=0.002), 0).moved((0, 0, z + rise))
        handle.add(grip, plain("grip", (40, 40, 44)), "grip")
    rest = float(rng.choice([0.0, 0.0, 1.2, -1.2]))
    return b.build({handle.link: rest} if rest else None)


def dispenser(rng: np.random.Generator) -> ProceduralObject:
    """A soap bottle with a pump, or a box whose lever is pressed."""
    b = Builder("Dispenser", rng)
    skin = plain("body", PLASTICS[rng.integers(len(PLASTICS))])
    top = metal("steel") if rng.random() < 0.5 else plain("pump", METALS["black"])
    body = b.base("dispenser_body")
    w, d, h = (float(v) for v in rng.uniform((0.06, 0.05, 0.1), (0.09, 0.08, 0.17)))
    if rng.random() < 0.5:
        body.add(s.tray((w, d, h), 0.002, radius=0.015), skin, "body")
        # A lid with a round hole for the stem.
        plate, hole = s.rectangle(w, d, 0.015, 3), s.circle(0.0062, 16)
        hole = hole[np.roll(np.arange(16), -1)]
        levels = [s.at(hole, h - 0.002), s.at(plate, h - 0.002), s.at(plate, h), s.at(hole, h)]
        body.add(s.loft(levels, ring=True), skin, "shoulder")
    else:
        outline = [
            (0.42 * w, 0),
            (0.5 * w, 0.01),
            (0.5 * w, 0.8 * h),
            (0.3 * w, 0.97 * h),
            (0.25 * w, h),
        ]
        body.add(s.lathe(shell_profile(outline, 0.002), 30), skin, "body")
    r = 0.016
    profile = [(0.0062, h - 0.0005), (r, h - 0.0005), (r, h + 0.016), (0.0062, h + 0.016)]
    body.add(s.ring(profile, 24), top, "collar")
    travel = float(rng.uniform(0.012, 0.022))
    z = h + 0.016 + travel
    pump = b.slide("lid", body, (0, 0, -1), 0.0, 0.95 * travel, (0, 0, h))
    at = (0, 0, z - 0.011 - travel / 2 + 0.004)
    pump.add(s.cylinder(0.0055, 0.03 + travel, segments=14).moved(at), metal("steel"), "stem")
    at = (0, 0, z + 0.0075)
    pump.add(s.cylinder(0.012, 0.014, segments=20, bevel=0.003).moved(at), top, "head")
    path = s.bent_path([(0, 0, z + 0.009), (0, -0.036, z + 0.009), (0, -0.044, z + 0.001)], 0.01)
    pump.add(s.sweep(path, s.circle(0.0042, 10)), top, "nozzle")
    return b.build()
