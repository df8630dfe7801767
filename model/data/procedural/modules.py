"""Modules that families are made of: handles, fronts, doors, drawers, carcasses, legs.

Functions that return solids build them at the origin on the mounting plane y = 0, reaching to -y;
``place`` turns them to another side. Functions that take a :class:`Builder` add a jointed part.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from model.data.procedural import shapes as s
from model.data.procedural.grammar import Body, Builder
from model.data.procedural.materials import Palette, Surface, dark_glass, glass
from model.data.procedural.shapes import Solid, Vector

HandleStyle = Literal["bar", "bow", "flat", "knob", "cup", "ball", "lip"]


Side = Literal["left", "right", "top", "bottom"]


BEVEL = 0.002


def place(
    solids: list[Solid],
    at: Vector,
    *,
    face: Literal["front", "back", "left", "right", "up", "down"] = "front",
    roll: float = 0.0,
) -> list[Solid]:
    """Solids built reaching to -y, rolled about that direction, turned to ``face`` and moved."""
    out = [x.turned((0, 1, 0), roll) if roll else x for x in solids]
    if face in ("left", "right", "back"):
        angle = {"left": -np.pi / 2, "right": np.pi / 2, "back": np.pi}[face]
        out = [x.turned((0, 0, 1), angle) for x in out]
    elif face in ("up", "down"):
        angle = -np.pi / 2 if face == "up" else np.pi / 2
        out = [x.turned((1, 0, 0), angle) for x in out]
    return [x.moved(at) for x in out]


def add(body: Body, solids: list[Solid], surface: Surface, piece: str) -> None:
    """Add several solids with one surface."""
    for solid in solids:
        body.add(solid, surface, piece)


def handle(style: HandleStyle, length: float, depth: float = 0.03) -> list[Solid]:
    """A handle, long along z."""
    thick = 0.3 * depth
    if style == "bar":
        bar = s.cylinder(thick * 0.6, length, segments=12, bevel=0.001).moved((0, -depth, 0))
        posts = [
            s.along(s.cylinder(thick * 0.5, depth, segments=10), 1).moved((0, -depth / 2, z))
            for z in (-0.38 * length, 0.38 * length)
        ]
        return [bar, *posts]
    if style == "bow":
        half = length / 2
        corners = [
            (0, 0.001, -half),
            (0, -depth, -0.8 * half),
            (0, -depth, 0.8 * half),
            (0, 0.001, half),
        ]
        path = s.bent_path(corners, 0.6 * depth)
        return [s.sweep(path, s.rectangle(1.6 * thick, 0.9 * thick, 0.25 * thick))]
    if style == "flat":
        plate = s.box((2.2 * thick, 0.7 * thick, length), (0, -depth, 0), 0.001)
        posts = [
            s.box((1.4 * thick, depth, 1.4 * thick), (0, -depth / 2, z))
            for z in (-0.4 * length, 0.4 * length)
        ]
        return [plate, *posts]
    if style == "cup":
        outline = [
            (0.5 * length * np.cos(a), 0.55 * depth * np.sin(a)) for a in np.linspace(0, np.pi, 9)
        ]
        shell = s.loft(
            [
                np.array([[x, -depth * f, z * (1 - 0.25 * f)] for x, z in outline])
                for f in (0.0, 0.75, 1.0)
            ]
        )
        return [shell.turned((0, 1, 0), np.pi / 2)]
    if style == "lip":
        return [s.box((0.5 * depth, 0.8 * depth, length), (0, -0.4 * depth, 0), 0.0015)]
    radius = 0.5 * depth
    if style == "ball":
        stem = s.along(s.cylinder(0.4 * radius, depth, segments=12), 1).moved((0, -depth / 2, 0))
        return [stem, s.sphere(0.75 * radius, 14).moved((0, -1.1 * depth, 0))]
    profile = [
        (0.75 * radius, -0.0005),
        (0.45 * radius, 0.3 * depth),
        (0.5 * radius, 0.55 * depth),
        (radius, 0.75 * depth),
        (0.95 * radius, 0.95 * depth),
        (0.5 * radius, 1.05 * depth),
    ]
    return [s.along(s.lathe(profile, 18), 1)]


@dataclass(frozen=True)
class Opening:
    """A rectangle in a front plane: x and z ranges, metres."""

    x0: float
    x1: float
    z0: float
    z1: float

    @property
    def width(self) -> float:
        """Metres along x."""
        return self.x1 - self.x0

    @property
    def height(self) -> float:
        """Metres along z."""
        return self.z1 - self.z0

    @property
    def center(self) -> tuple[float, float]:
        """(x, z)."""
        return (self.x0 + self.x1) / 2, (self.z0 + self.z1) / 2

    def shrunk(self, by: float) -> Opening:
        """Smaller by ``by`` on every side."""
        return Opening(self.x0 + by, self.x1 - by, self.z0 + by, self.z1 - by)


PanelStyle = Literal["plain", "shaker", "glass", "window", "raised"]


def panel(
    body: Body,
    r: Opening,
    y: float,
    thickness: float,
    style: PanelStyle,
    palette: Palette,
    *,
    border: float | None = None,
    bevel: float = BEVEL,
) -> None:
    """A front in the plane y (its back) .. y - thickness over the rectangle ``r``."""
    cx, cz = r.center
    mid = y - thickness / 2
    w, h = r.width, r.height
    border = min(0.075, 0.24 * min(w, h)) if border is None else border
    if style in ("plain", "raised") or min(w, h) < 3 * border:
        body.add(s.box((w, thickness, h), (cx, mid, cz), bevel), palette.front, "panel")
        if style == "raised" and min(w, h) > 4 * border:
            size = (w - 2.4 * border, 0.006, h - 2.4 * border)
            lift = s.box(size, (cx, y - thickness - 0.002, cz), 0.003)
            body.add(lift, palette.front, "panel_relief")
        return
    inner = (w - 2 * border, h - 2 * border)
    if style == "shaker":
        # Stiles and rails, with their own grain, round a thinner panel.
        for x in (r.x0 + border / 2, r.x1 - border / 2):
            body.add(s.box((border, thickness, h), (x, mid, cz), bevel), palette.front, "stile")
        for z in (r.z0 + border / 2, r.z1 - border / 2):
            size = (inner[0], 0.98 * thickness, border)
            body.add(s.box(size, (cx, mid, z), 0.5 * bevel), palette.front, "rail")
        size = (inner[0] + 0.004, 0.45 * thickness, inner[1] + 0.004)
        fill = s.box(size, (cx, y - 0.35 * thickness, cz))
        body.add(fill, palette.front, "panel")
        return
    at = (cx, mid, cz)
    body.add(s.frame((w, h), inner, thickness, bevel=bevel).moved(at), palette.front, "frame")
    size = (inner[0] + 0.004, 0.3 * thickness, inner[1] + 0.004)
    pane = s.box(size, (cx, y - 0.5 * thickness, cz))
    body.add(pane, glass() if style == "glass" else dark_glass(), "glass")


@dataclass(frozen=True)
class DoorSpec:
    """Appearance and hinge of a door.

    Attributes:
        hinge: which edge the hinge is on.
        swing: radians that it opens.
        handle: None for none.
        handle_length: metres; handle_at: 0..1 along the edge opposite the hinge.
    """

    hinge: Side = "left"
    swing: float = np.pi / 2
    style: PanelStyle = "plain"
    handle: HandleStyle | None = "bar"
    handle_length: float = 0.14
    handle_depth: float = 0.03
    handle_at: float = 0.5
    handle_inset: float = 0.04
    thickness: float = 0.018
    barrels: bool = True


def door(
    b: Builder, parent: Body, r: Opening, y: float, spec: DoorSpec, *, name: str = "door"
) -> Body:
    """A door whose back lies in the plane ``y``; hinged at its front edge, it swings free."""
    palette = b.palette
    t = spec.thickness
    front = y - t
    cx, cz = r.center
    axis, origin = {
        "left": ((0, 0, -1), (r.x0, front, cz)),
        "right": ((0, 0, 1), (r.x1, front, cz)),
        "top": ((-1, 0, 0), (cx, front, r.z1)),
        "bottom": ((1, 0, 0), (cx, front, r.z0)),
    }[spec.hinge]
    body = b.hinge(name, parent, axis, origin, 0.0, spec.swing)
    panel(body, r, y, t, spec.style, palette)
    if spec.barrels:
        _barrels(body, r, front, spec.hinge, palette)
    if spec.handle is not None:
        body_handle(body, r, front, spec, palette)
    return body


def _barrels(body: Body, r: Opening, front: float, side: Side, palette: Palette) -> None:
    """Two small knuckles on the hinge line, half sunk in the door's front edge."""
    radius, length = 0.0045, min(0.05, 0.15 * max(r.width, r.height))
    for f in (0.14, 0.86):
        if side in ("left", "right"):
            x = r.x0 + radius if side == "left" else r.x1 - radius
            solid = s.cylinder(radius, length, segments=10).moved((x, front, r.z0 + f * r.height))
        else:
            z = r.z0 + radius if side == "bottom" else r.z1 - radius
            at = (r.x0 + f * r.width, front, z)
            solid = s.along(s.cylinder(radius, length, segments=10), 0).moved(at)
        body.add(solid, palette.metal, "hinge")


def body_handle(body: Body, r: Opening, front: float, spec: DoorSpec, palette: Palette) -> None:
    """The handle of a door, opposite its hinge."""
    assert spec.handle is not None
    upright = spec.hinge in ("left", "right")
    inset = min(spec.handle_inset, 0.3 * min(r.width, r.height))
    long = spec.handle not in ("knob", "ball")
    length = min(spec.handle_length, 0.8 * (r.height if upright else r.width)) if long else 0.0
    run = (r.height if upright else r.width) - length
    along = min(max(spec.handle_at * run, 0.0), run) + length / 2
    if upright:
        x = r.x1 - inset if spec.hinge == "left" else r.x0 + inset
        at = (x, front, r.z0 + along)
    else:
        z = r.z1 - inset if spec.hinge == "bottom" else r.z0 + inset
        at = (r.x0 + along, front, z)
    solids = handle(spec.handle, length, spec.handle_depth)
    add(body, place(solids, at, roll=0.0 if upright else np.pi / 2), palette.accent, "handle")


def drawer(
    b: Builder,
    parent: Body,
    r: Opening,
    y: float,
    depth: float,
    *,
    inner: Opening,
    style: PanelStyle = "plain",
    handle_style: HandleStyle | None = "bar",
    handles: int = 1,
    thickness: float = 0.018,
    inside: Surface,
    travel: float = 0.85,
    handle_length: float = 0.14,
    name: str = "drawer",
) -> Body:
    """A drawer: a front over ``r`` and a tray that fits the cell ``inner``, ``depth`` deep."""
    body = b.slide(name, parent, (0, -1, 0), 0.0, travel * depth, (*_xz(r, y),))
    panel(body, r, y, thickness, style, b.palette)
    cell = Opening(
        max(r.x0, inner.x0) + 0.004,
        min(r.x1, inner.x1) - 0.004,
        max(r.z0, inner.z0) + 0.004,
        min(r.z1, inner.z1) - 0.004,
    )
    wall = min(0.012, 0.1 * cell.height)
    height = 0.82 * cell.height
    box = s.tray((cell.width, depth, height), wall, floor=0.6 * wall)
    at = (cell.center[0], y + depth / 2 - 0.0005, cell.z0)
    body.add(box.moved(at), inside, "drawer_box", grain=1)
    if handle_style is not None:
        length = min(handle_length, 0.7 * r.width / handles)
        for k in range(handles):
            x = r.x0 + r.width * (k + 0.5) / handles
            solids = handle(handle_style, length)
            at = (x, y - thickness, r.center[1])
            add(body, place(solids, at, roll=np.pi / 2), b.palette.accent, "handle")
    return body


def _xz(r: Opening, y: float) -> tuple[float, float, float]:
    cx, cz = r.center
    return cx, y, cz


def carcass(
    body: Body,
    size: Vector,
    wall: float,
    palette: Palette,
    *,
    bottom: float = 0.0,
    back: bool = True,
    top_overhang: float = 0.0,
) -> None:
    """Side walls, floor, top and back of a hollow cupboard, its front open at y = -depth/2.

    ``size`` is (x, y, z); it stands with its underside at ``bottom``.
    """
    w, d, h = (float(v) for v in size)
    for side in (-1, 1):
        center = (side * (w - wall) / 2, 0, bottom + h / 2)
        body.add(s.box((wall, d, h), center, 0.0015), palette.body, "side_wall", grain=2)
    inner = w - 2 * wall
    body.add(s.box((inner, d, wall), (0, 0, bottom + wall / 2)), palette.body, "floor", grain=0)
    center = (0, 0, bottom + h - wall / 2)
    body.add(s.box((inner, d, wall), center), palette.body, "ceiling", grain=0)
    if top_overhang > 0:
        # The board reaches over the fronts, as a worktop does.
        center = (0, -0.015 + 0.002, bottom + h + wall / 2)
        board = s.box((w + top_overhang, d + 0.03, wall), center, 0.003)
        body.add(board, palette.body, "top", grain=0)
    if back:
        thin = 0.006
        center = (0, d / 2 - thin / 2, bottom + h / 2)
        body.add(s.box((inner, thin, h - 2 * wall), center), palette.body, "back", grain=2)


LegStyle = Literal["block", "taper", "round", "plinth", "sled", "hairpin"]


def legs(
    body: Body, width: float, depth: float, height: float, style: LegStyle, surface: Surface
) -> None:
    """Four legs (or a plinth, or sledges) from z = 0 to ``height`` under a width by depth plan."""
    if style == "plinth":
        size = (0.94 * width, 0.88 * depth, height)
        body.add(s.box(size, (0, 0.03 * depth, height / 2)), surface, "plinth")
        return
    thick = float(np.clip(0.09 * min(width, depth), 0.02, 0.06))
    x0, y0 = width / 2 - 0.8 * thick, depth / 2 - 0.8 * thick
    if style == "sled":
        bar = s.rectangle(0.7 * thick, 0.7 * thick, 0.1 * thick)
        for x in (-x0, x0):
            path = s.bent_path(
                [(x, -y0, height), (x, -y0, 0.35 * thick), (x, y0, 0.35 * thick), (x, y0, height)],
                0.04,
            )
            body.add(s.sweep(path, bar), surface, "leg")
        return
    for x in (-x0, x0):
        for y in (-y0, y0):
            if style == "block":
                solid = s.box((thick, thick, height), (0, 0, height / 2), 0.002)
            elif style == "round":
                solid = s.lathe([(0.35 * thick, 0), (0.6 * thick, height)], 14)
            elif style == "hairpin":
                run = 0.7 * thick
                path = s.bent_path([(-run, 0, height), (0, 0, 0.006), (run, 0, height)], 0.01)
                solid = s.tube(path, 0.006, 8)
            else:
                outlines = [
                    s.at(s.rectangle(f * thick, f * thick, 0.08 * thick), z)
                    for f, z in ((0.55, 0), (1.1, height))
                ]
                solid = s.loft(outlines)
            body.add(solid.moved((x, y, 0)), surface, "leg")
