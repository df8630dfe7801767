"""StorageFurniture, Table and Cart.

Cupboards and chests of doors and drawers are made by dividing the front into cells.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from model.data.procedural import controls
from model.data.procedural import modules as m
from model.data.procedural import shapes as s
from model.data.procedural.grammar import Body, Builder, ProceduralObject
from model.data.procedural.materials import (
    Palette,
    furniture_palette,
    metal,
    plastic_palette,
    rubber,
    wood,
)
from model.data.procedural.modules import LegStyle, legs

Use = Literal["door", "two_doors", "drawer", "open", "flap"]


@dataclass(frozen=True)
class Cell:
    """A compartment: what closes it, and its rectangle between the middles of its walls."""

    use: Use
    area: m.Opening


@dataclass(frozen=True)
class Cupboard:
    """The shape of a cupboard.

    Attributes:
        size: (x, y, z) of the carcass in metres.
        wall, gap: thickness of the boards, gap between the fronts.
        cells: the compartments.
        shelves: boards in each compartment that isn't a drawer.
        inset: fronts lie between the walls instead of before them.
        open_by: how far each front stands open, 0..1, in the order of the parts.
    """

    size: tuple[float, float, float]
    cells: tuple[Cell, ...]
    wall: float = 0.018
    gap: float = 0.003
    leg: LegStyle = "taper"
    leg_height: float = 0.12
    front: m.PanelStyle = "plain"
    handle: m.HandleStyle | None = "bar"
    handle_length: float = 0.14
    shelves: int = 1
    inset: bool = False
    overhang: float = 0.0
    swing: float = 1.75
    hinge: Literal["left", "right"] = "left"
    drawer_handles: int = 1
    open_by: tuple[float, ...] = ()


def split(
    area: m.Opening, rng: np.random.Generator, depth: int = 0, least: float = 0.14
) -> list[Cell]:
    """Divide a front into compartments: columns first, then rows of drawers and doors."""
    wide, high = area.width, area.height
    if depth == 0 and wide > 0.7 and rng.random() < 0.75:
        columns = int(min(rng.integers(2, 4), wide // 0.3))
        cuts = np.linspace(area.x0, area.x1, columns + 1)
        cuts[1:-1] += rng.uniform(-0.05, 0.05, columns - 1) * wide if rng.random() < 0.4 else 0
        return [
            c
            for a, z in itertools.pairwise(cuts)
            for c in split(replace(area, x0=float(a), x1=float(z)), rng, 1, least)
        ]
    if depth <= 1 and high > 2.2 * least and rng.random() < 0.65:
        if rng.random() < 0.5 or high < 0.5:
            rows = int(min(rng.integers(2, 6), high // least))
            cuts = np.linspace(area.z0, area.z1, rows + 1)
            return [
                Cell("drawer", replace(area, z0=float(a), z1=float(z)))
                for a, z in itertools.pairwise(cuts)
            ]
        cut = area.z0 + high * rng.uniform(0.3, 0.75)
        upper = split(replace(area, z0=float(cut)), rng, 2, least)
        return split(replace(area, z1=float(cut)), rng, 2, least) + upper
    return [Cell(_use(area, rng), area)]


def _use(area: m.Opening, rng: np.random.Generator) -> Use:
    wide, high = area.width, area.height
    if high < 0.3:
        return "drawer" if wide < 1.1 and rng.random() < 0.8 else "flap"
    if wide > 0.62:
        return "two_doors" if rng.random() < 0.85 else "open"
    return "door" if rng.random() < 0.85 else "open"


def cupboard(
    spec: Cupboard, palette: Palette, rng: np.random.Generator, *, mirrored: bool = False
) -> ProceduralObject:
    """Build a cupboard; ``mirrored`` hinges doors in the right half on their right."""
    b = Builder("StorageFurniture", rng, palette)
    w, d, _h = spec.size
    body = b.base("furniture_body")
    bottom = spec.leg_height
    m.carcass(body, spec.size, spec.wall, palette, bottom=bottom, top_overhang=spec.overhang)
    surface = palette.body if spec.leg in ("block", "plinth", "taper") else palette.metal
    legs(body, w, d, bottom, spec.leg, surface)
    inside = wood("birch")
    for cell in spec.cells:
        _inside(body, cell, spec, palette)
    moving: list[Body] = []
    for cell in spec.cells:
        right = mirrored and cell.area.center[0] > 0
        look = replace(spec, hinge="right") if right else spec
        moving += _close(b, body, cell, look, inside)
    rest = {}
    for part, share in zip(moving, spec.open_by, strict=False):
        if share > 0:
            joint = next(j for j in b.joints if j.child == part.link)
            assert joint.upper is not None
            rest[part.link] = share * joint.upper
    return b.build(rest)


def _inside(body: Body, cell: Cell, spec: Cupboard, palette: Palette) -> None:
    """Walls between this compartment and its right and upper neighbours, and its shelves."""
    w, d, h = spec.size
    a, t, bottom = cell.area, spec.wall, spec.leg_height
    deep = d - 0.008 - (0.022 if spec.inset else 0)
    y = (d / 2 - 0.006) - deep / 2
    low, high = max(a.z0 - t / 2, bottom + t), min(a.z1 + t / 2, bottom + h - t)
    if a.x1 < w / 2 - 0.01:
        size = (t, deep, high - low)
        body.add(s.box(size, (a.x1, y, (low + high) / 2)), palette.body, "divider", grain=2)
    left, right = max(a.x0 + t / 2, -w / 2 + t), min(a.x1 - t / 2, w / 2 - t)
    if a.z1 < bottom + h - 0.01:
        size = (right - left, deep, t)
        body.add(s.box(size, ((left + right) / 2, y, a.z1)), palette.body, "divider", grain=0)
    if cell.use == "drawer":
        return
    boards = min(spec.shelves, int(a.height // 0.2))
    for k in range(boards):
        z = a.z0 + a.height * (k + 1) / (boards + 1)
        size = (right - left, 0.88 * deep, 0.8 * t)
        shelf = s.box(size, ((left + right) / 2, y + 0.05 * deep, z))
        body.add(shelf, palette.body, "shelf", grain=0)


def _close(b: Builder, body: Body, cell: Cell, spec: Cupboard, inside: m.Surface) -> list[Body]:
    """The doors or the drawer of one compartment."""
    w, d, h = spec.size
    t, bottom, thick = spec.wall, spec.leg_height, 0.018
    a = cell.area
    clear = m.Opening(
        max(a.x0 + t / 2, -w / 2 + t),
        min(a.x1 - t / 2, w / 2 - t),
        max(a.z0 + t / 2, bottom + t),
        min(a.z1 - t / 2, bottom + h - t),
    )
    face = clear.shrunk(spec.gap) if spec.inset else a.shrunk(spec.gap / 2)
    y = -d / 2 + (thick + 0.001 if spec.inset else -0.002)
    look = m.DoorSpec(
        swing=spec.swing,
        style=spec.front,
        handle=spec.handle,
        handle_length=spec.handle_length,
        thickness=thick,
        barrels=not spec.inset,
    )
    if cell.use == "drawer":
        deep = d - 0.012 - max(y + d / 2, 0)
        return [
            m.drawer(
                b,
                body,
                face,
                y,
                min(0.92 * deep, 0.55),
                inner=clear,
                style="plain" if face.height < 0.24 else spec.front,
                handle_style=spec.handle,
                handles=spec.drawer_handles if face.width > 0.5 else 1,
                thickness=thick,
                inside=inside,
                handle_length=spec.handle_length,
            )
        ]
    if cell.use == "flap":
        return [
            m.door(b, body, face, y, replace(look, hinge="bottom", swing=np.pi / 2, handle_at=0.5))
        ]
    low = a.center[1] < 0.9
    look = replace(look, handle_at=0.85 if low and a.height > 0.5 else 0.5)
    if cell.use == "door":
        return [m.door(b, body, face, y, replace(look, hinge=spec.hinge))]
    if cell.use == "two_doors":
        middle = a.center[0]
        left = replace(face, x1=middle - spec.gap / 2)
        right = replace(face, x0=middle + spec.gap / 2)
        return [
            m.door(b, body, left, y, replace(look, hinge="left")),
            m.door(b, body, right, y, replace(look, hinge="right")),
        ]
    return []


def storage_furniture(rng: np.random.Generator) -> ProceduralObject:
    """A sideboard, chest, wardrobe or kitchen unit."""
    kind = rng.integers(4)
    low, high = (
        ((0.4, 0.35, 0.45), (0.8, 0.5, 1.2)),
        ((0.9, 0.35, 0.5), (1.8, 0.5, 0.9)),
        ((0.8, 0.5, 1.6), (1.6, 0.62, 2.1)),
        ((0.4, 0.5, 0.7), (1.2, 0.6, 0.9)),
    )[kind]
    size = rng.uniform(low, high)
    w, _, h = (float(v) for v in size)
    leg: LegStyle = ("block", "taper", "round", "plinth", "sled", "hairpin")[rng.integers(6)]
    tall = float(rng.uniform(0.05, 0.1) if leg == "plinth" else rng.uniform(0.06, 0.22))
    cells = tuple(split(m.Opening(-w / 2, w / 2, tall, tall + h), rng))
    if all(c.use == "open" for c in cells):
        cells = (
            replace(cells[0], use="two_doors" if cells[0].area.width > 0.5 else "door"),
            *cells[1:],
        )
    fronts = sum({"open": 0, "two_doors": 2}.get(c.use, 1) for c in cells)
    ajar = rng.random(fronts) * (rng.random(fronts) < (0.3 if rng.random() < 0.3 else 0.0))
    spec = Cupboard(
        (w, float(size[1]), h), cells, wall=float(rng.uniform(0.015, 0.025)),
        gap=float(rng.uniform(0.002, 0.005)), leg=leg, leg_height=tall,
        front=("plain", "shaker", "raised", "glass")[rng.choice(4, p=[0.45, 0.3, 0.15, 0.1])],
        handle=("bar", "bow", "flat", "knob", "cup", "ball", "lip", None)[rng.integers(8)],
        handle_length=float(rng.uniform(0.08, 0.25)), shelves=int(rng.integers(0, 4)),
        inset=bool(rng.random() < 0.25), overhang=float(rng.choice([0.0, 0.01, 0.03])),
        swing=float(rng.uniform(1.5, 2.1)), hinge="left" if rng.random() < 0.5 else "right",
        drawer_handles=int(rng.integers(1, 3)), open_by=tuple(float(v) for v in ajar),
    )  # fmt: skip
    return cupboard(spec, furniture_palette(rng), rng)


def table(rng: np.random.Generator) -> ProceduralObject:
    """A desk with drawers under its top, perhaps a pedestal with a door, or on casters."""
    b = Builder("Table", rng)
    b.palette = palette = furniture_palette(rng)
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
            b, base, r.shrunk(0.0025), y - 0.001, 0.8 * deep, inner=clear,
            handle_style=handle, inside=wood("birch"), thickness=0.016, handle_length=0.1
        )  # fmt: skip
    for side in pedestals:
        _pedestal(b, base, side, w, d, low - 0.01, handle)
    return b.build()


def _pedestal(
    b: Builder, base: Body, side: int, w: float, d: float, top: float, handle: m.HandleStyle
) -> None:
    palette = b.palette
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
    if b.rng.random() < 0.5:
        levels = np.linspace(bottom, top, int(b.rng.integers(2, 4)) + 1)
        cells = [Cell("drawer", replace(r, z0=float(a), z1=float(z))) for a, z in pairwise(levels)]
    for cell in cells:
        if cell.use == "door":
            hinge = "left" if side < 0 else "right"
            spec = m.DoorSpec(hinge, 1.7, "plain", handle, 0.12, handle_at=0.8)
            m.door(b, base, r.shrunk(0.002), y - 0.001, spec)
        else:
            inner = m.Opening(
                clear.x0, clear.x1, max(cell.area.z0, clear.z0), min(cell.area.z1, clear.z1)
            )
            m.drawer(
                b, base, cell.area.shrunk(0.002), y - 0.001, 0.8 * deep, inner=inner,
                handle_style=handle, inside=wood("birch"), handle_length=0.1
            )  # fmt: skip


def cart(rng: np.random.Generator) -> ProceduralObject:
    """A trolley with shelves or a tray on four casters, perhaps with drawers."""
    b = Builder("Cart", rng)
    b.palette = palette = plastic_palette(rng)
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
                b,
                body,
                (*spot, low),
                wheel,
                rubber(),
                swivel=swivels[1 + (y > 0)],
                heading=float(rng.random() * 6.28) if swivels[1 + (y > 0)] else np.pi / 2,
            )
    levels = np.linspace(low + 0.03, h - 0.08, int(rng.integers(2, 4)))
    for z in levels:
        at = (0, 0, float(z))
        body.add(s.tray((w, d, 0.05), 0.004, radius=0.02).moved(at), palette.front, "tray")
    if rng.random() < 0.7:
        corners = [
            (w / 2 - 0.02, -d / 2 + 0.02, h - 0.03),
            (w / 2 + 0.1, -d / 2 + 0.02, h + 0.05),
            (w / 2 + 0.1, d / 2 - 0.02, h + 0.05),
            (w / 2 - 0.02, d / 2 - 0.02, h - 0.03),
        ]
        path = s.bent_path(corners, 0.05)
        body.add(s.tube(path, 0.011), frame, "handle")
    if rng.random() < 0.4 and len(levels) > 1:
        z0, z1 = float(levels[-2]) + 0.055, float(levels[-1]) - 0.005
        if z1 - z0 > 0.1:
            r = m.Opening(-w / 2 + 0.035, w / 2 - 0.035, z0, z1)
            m.drawer(
                b, body, r, -d / 2 + 0.014, 0.85 * d, inner=r.shrunk(0.002),
                handle_style="bar", inside=palette.front, thickness=0.012
            )  # fmt: skip
    return b.build()
