"""Toilet and Faucet."""

from __future__ import annotations

import numpy as np

from model.data.procedural import controls
from model.data.procedural import shapes as s
from model.data.procedural.grammar import Builder, ProceduralObject
from model.data.procedural.materials import metal, plain, wood


def toilet(rng: np.random.Generator) -> ProceduralObject:
    """Bowl, seat, lid, cistern, and a button or a lever."""
    b = Builder("Toilet", rng)
    white = plain("ceramic", (240, 240, 238))
    seat_skin = white if rng.random() < 0.6 else wood("oak")
    body = b.base("toilet_body")
    h, length, w = (
        float(rng.uniform(0.36, 0.42)),
        float(rng.uniform(0.42, 0.5)),
        float(rng.uniform(0.34, 0.39)),
    )
    a = np.arange(36) * 2 * np.pi / 36
    egg = np.stack([0.5 * w * np.cos(a), 0.5 * length * np.sin(a) * (1 - 0.08 * np.sin(a))], 1)

    def at(f: float, z: float, shift: float = 0.0) -> np.ndarray:
        return s.at(egg * f + np.array([0, shift]), z)

    levels = [
        at(0.6, 0, 0.05), at(0.55, 0.08, 0.05), at(0.75, 0.6 * h, 0.03), at(1.0, h - 0.02),
        at(1.0, h), at(0.75, h), at(0.5, 0.55 * h, 0.02),
    ]  # fmt: skip
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
            (0, 0, z + 0.001), (0, 0, z + rise), (0, -reach, z + rise + 0.01),
            (0, -reach, z + rise - 0.03),
        ]  # fmt: skip
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
