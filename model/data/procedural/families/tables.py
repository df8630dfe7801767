"""Table and Cart."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from model.data.procedural import controls
from model.data.procedural import modules as m
from model.data.procedural import shapes as s
from model.data.procedural.families.storage import Cell
from model.data.procedural.grammar import Body, Builder, ProceduralObject
from model.data.procedural.legs import LegStyle, legs
from model.data.procedural.materials import (
    Palette,
    furniture_palette,
    metal,
    plastic_palette,
    rubber,
    wood,
)


def table(rng: np.random.Generator) -> ProceduralObject:
    """A desk with drawers under its top, perhaps a pedestal with a door, or on casters."""
    b = Builder("Table", rng)
    palette = furniture_palette(rng)
    w, d, h = (float(v) for v in rng.uniform((0.8, 0.5, 0.68), (1.6, 0.8, 0.78)))
    base = b.base("table_body")
    t = 0.025
    base.add(s.box((w, d, t), (0, 0, h - t / 2), 0.004), palette.front, "tabletop", grain=0)
    style: LegStyle = ("block", "taper", "round")[rng.integers(3)]
    pedestals = [side for side in (-1, 1) if rng.random() < 0.4]
    legs(base, w, d, h - t, style, palette.body)
    tall = float(rng.uniform(0.09, 0.13))
    low = h - t - tall
    left, right = -w / 2 + 0.09, w / 2 - 0.09
    count = int(rng.integers(1, 4))
    deep = d - 0.1
    wall = 0.015
    y = -d / 2 + 0.045
    for x in np.linspace(left, right, count + 1):
        size = (wall, deep, tall)
        base.add(s.box(size, (x, y + deep / 2, low + tall / 2)), palette.body, "apron")
    size = (right - left, wall, tall)
    base.add(s.box(size, (0, y + deep - wall / 2, low + tall / 2)), palette.body, "apron")
    size = (right - left, deep, 0.008)
    base.add(s.box(size, (0, y + deep / 2, low - 0.004)), palette.body, "apron")
    handle: m.HandleStyle = ("bar", "knob", "cup", "flat", "ball")[rng.integers(5)]
    cuts = np.linspace(left, right, count + 1)
    for a, z in pairwise(cuts):
        r = m.Opening(float(a), float(z), low, low + tall)
        clear = m.Opening(float(a) + wall / 2, float(z) - wall / 2, low + 0.001, low + tall)
        m.drawer(
            b, base, r.shrunk(0.0025), y - 0.001, 0.8 * deep, palette, inner=clear,
            handle_style=handle, inside=wood("birch"), thickness=0.016, handle_length=0.1,
        )  # fmt: skip
    for side in pedestals:
        _pedestal(b, base, side, w, d, low - 0.01, palette, handle, rng)
    return b.build()


def _pedestal(
    b: Builder,
    base: Body,
    side: int,
    w: float,
    d: float,
    top: float,
    palette: Palette,
    handle: m.HandleStyle,
    rng: np.random.Generator,
) -> None:
    width, bottom = min(0.4, 0.36 * w), 0.09
    x0 = side * (w / 2 - 0.085) - (width if side > 0 else 0)
    r = m.Opening(x0, x0 + width, bottom, top)
    deep, wall = d - 0.12, 0.016
    y = -d / 2 + 0.05
    for x in (r.x0 + wall / 2, r.x1 - wall / 2):
        size = (wall, deep, r.height)
        base.add(s.box(size, (x, y + deep / 2, r.center[1])), palette.body, "side_wall")
    size = (width, deep, wall)
    base.add(s.box(size, (r.center[0], y + deep / 2, bottom + wall / 2)), palette.body, "floor")
    size = (width, wall, r.height)
    base.add(s.box(size, (r.center[0], y + deep - wall / 2, r.center[1])), palette.body, "back")
    clear = replace(r.shrunk(wall), z1=r.z1 - 0.004)
    cells = [Cell("door", r)]
    if rng.random() < 0.5:
        levels = np.linspace(bottom, top, int(rng.integers(2, 4)) + 1)
        cells = [Cell("drawer", replace(r, z0=float(a), z1=float(z))) for a, z in pairwise(levels)]
    for cell in cells:
        if cell.use == "door":
            hinge = "left" if side < 0 else "right"
            spec = m.DoorSpec(hinge, 1.7, "plain", handle, 0.12, handle_at=0.8)
            m.door(b, base, r.shrunk(0.002), y - 0.001, spec, palette)
        else:
            inner = m.Opening(
                clear.x0, clear.x1, max(cell.area.z0, clear.z0), min(cell.area.z1, clear.z1)
            )
            m.drawer(
                b, base, cell.area.shrunk(0.002), y - 0.001, 0.8 * deep, palette, inner=inner,
                handle_style=handle, inside=wood("birch"), handle_length=0.1,
            )  # fmt: skip


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
            at = (*spot, low + (h - low) / 2)
            body.add(s.cylinder(0.011, h - low, segments=12).moved(at), frame, "post")
            controls.caster(
                b, body, (*spot, low), wheel, palette, rubber(), swivel=swivels[1 + (y > 0)],
                heading=float(rng.random() * 6.28) if swivels[1 + (y > 0)] else np.pi / 2,
            )  # fmt: skip
    levels = np.linspace(low + 0.03, h - 0.08, int(rng.integers(2, 4)))
    for z in levels:
        at = (0, 0, float(z))
        body.add(s.tray((w, d, 0.05), 0.004, radius=0.02).moved(at), palette.front, "tray")
    if rng.random() < 0.7:
        corners = [
            (w / 2 - 0.02, -d / 2 + 0.02, h - 0.03), (w / 2 + 0.1, -d / 2 + 0.02, h + 0.05),
            (w / 2 + 0.1, d / 2 - 0.02, h + 0.05), (w / 2 - 0.02, d / 2 - 0.02, h - 0.03),
        ]  # fmt: skip
        path = s.bent_path(corners, 0.05)
        body.add(s.tube(path, 0.011), frame, "handle")
    if rng.random() < 0.4 and len(levels) > 1:
        z0, z1 = float(levels[-2]) + 0.055, float(levels[-1]) - 0.005
        if z1 - z0 > 0.1:
            r = m.Opening(-w / 2 + 0.035, w / 2 - 0.035, z0, z1)
            m.drawer(
                b, body, r, -d / 2 + 0.014, 0.85 * d, palette, inner=r.shrunk(0.002),
                handle_style="bar", inside=palette.front, thickness=0.012,
            )  # fmt: skip
    return b.build()
