"""Modules to turn, push and roll: knobs, buttons, wheels, casters."""

from __future__ import annotations

from typing import Literal

import numpy as np

from model.data.procedural import shapes as s
from model.data.procedural.grammar import Body, Builder
from model.data.procedural.materials import Surface
from model.data.procedural.modules import add, place
from model.data.procedural.shapes import Solid, Vector


def turning_knob(radius: float, depth: float, style: int = 0) -> list[Solid]:
    """A knob to turn about y, with a pointer so that its turning can be seen."""
    if style == 0:
        profile = [(1.15, 0), (1.15, 0.15), (1.0, 0.2), (0.9, 0.9), (0.8, 1.0)]
        knob = s.along(s.lathe([(radius * r, depth * z) for r, z in profile], 22), 1)
        grip = s.box((0.16 * radius, 0.05 * depth, 0.8 * radius), (0, -1.02 * depth, 0.42 * radius))
        return [knob, grip]
    if style == 1:
        disc = s.along(s.cylinder(radius, 0.35 * depth, segments=22, bevel=0.001), 1)
        bar = s.box((0.42 * radius, 0.7 * depth, 1.85 * radius), (0, -0.65 * depth, 0), 0.002)
        return [disc.moved((0, -0.175 * depth, 0)), bar]
    angles = np.arange(24) * 2 * np.pi / 24
    wave = radius * (1 + 0.07 * np.cos(8 * angles))
    outline = np.stack([wave * np.cos(angles), wave * np.sin(angles)], 1)
    knob = s.slab(outline, depth, axis=1, bevel=0.002).moved((0, -depth / 2, 0))
    mark = s.box((0.12 * radius, 0.06 * depth, 0.5 * radius), (0, -1.01 * depth, 0.55 * radius))
    return [knob, mark]


def knob(
    b: Builder,
    parent: Body,
    at: Vector,
    size: tuple[float, float],
    skin: tuple[Surface, Surface],
    *,
    name: str = "knob",
    face: Literal["front", "up", "left", "right"] = "front",
    style: int = 0,
    limits: tuple[float, float] | None = None,
) -> Body:
    """A knob that turns without end, or between ``limits`` radians.

    Args:
        size: radius and depth. skin: surfaces of the knob and of its pointer.
    """
    axis = {"front": (0, -1, 0), "up": (0, 0, 1), "left": (-1, 0, 0), "right": (1, 0, 0)}[face]
    clear = np.asarray(at, np.float64) + 0.0006 * np.asarray(axis)
    body = (
        b.spin(name, parent, axis, at)
        if limits is None
        else b.hinge(name, parent, axis, at, *limits)
    )
    solids = place(turning_knob(*size, style), clear, face=face)
    body.add(solids[0], skin[0], "knob")
    for solid in solids[1:]:
        body.add(solid, skin[style != 1], "pointer")
    return body


def button(size: Vector, *, round_: bool = False) -> list[Solid]:
    """A button; ``size`` is (width, height, how far it stands out)."""
    w, h, d = (float(v) for v in size)
    deep = 1.4 * d
    if round_:
        return [
            s.along(s.cylinder(w / 2, deep, segments=16, bevel=0.2 * d), 1).moved(
                (0, deep / 2 - d, 0)
            )
        ]
    return [s.box((w, deep, h), (0, deep / 2 - d, 0), 0.2 * d)]


def push_button(
    b: Builder,
    parent: Body,
    at: Vector,
    size: Vector,
    surface: Surface,
    *,
    name: str = "button",
    face: Literal["front", "up", "left", "right", "back"] = "front",
    round_: bool = False,
) -> Body:
    """A button that is pushed in by most of its height."""
    axis = {
        "front": (0, 1, 0),
        "up": (0, 0, -1),
        "left": (1, 0, 0),
        "right": (-1, 0, 0),
        "back": (0, -1, 0),
    }[face]
    travel = 0.8 * float(size[2])
    body = b.slide(name, parent, axis, 0.0, travel, at)
    # It ends on the surface: what sinks in when pushed lies inside the parent's hollow or well.
    w, h, d = (float(v) for v in size)
    solid = (
        s.along(s.cylinder(w / 2, d, segments=16, bevel=0.15 * d), 1)
        if round_
        else s.box((w, d, h), bevel=0.15 * d)
    ).moved((0, -d / 2, 0))
    add(body, place([solid], at, face=face), surface, "button")
    return body


def wheel(radius: float, width: float, *, spokes: int = 0) -> tuple[list[Solid], list[Solid]]:
    """(tyre solids, hub solids) of a wheel that turns about x, centred on the origin."""
    half, r = width / 2, radius
    profile = [
        (0.72 * r, -half),
        (0.93 * r, -half),
        (r, -0.5 * half),
        (r, 0.5 * half),
        (0.93 * r, half),
        (0.72 * r, half),
    ]
    tyre = s.along(s.ring(profile, 24), 0)
    if spokes:
        hub = [s.along(s.cylinder(0.2 * r, 1.15 * width, segments=14, bevel=0.001), 0)]
        for k in range(spokes):
            bar = s.box((0.4 * width, 0.16 * r, 0.66 * r), (0, 0, 0.42 * r))
            hub.append(bar.turned((1, 0, 0), 2 * np.pi * k / spokes))
    else:
        hub = [
            s.along(
                s.lathe(
                    [
                        (0.25 * r, -1.1 * half),
                        (0.74 * r, -0.7 * half),
                        (0.74 * r, 0.7 * half),
                        (0.25 * r, 1.1 * half),
                    ],
                    20,
                ),
                0,
            )
        ]
    return [tyre], hub


def caster(
    b: Builder,
    parent: Body,
    top: Vector,
    radius: float,
    rubber: Surface,
    *,
    swivel: bool = True,
    heading: float = 0.0,
) -> None:
    """A caster under ``top``: a fork that swivels about z (or is the parent's) and a wheel."""
    x, y, z = (float(v) for v in top)
    trail = 0.55 * radius if swivel else 0.0
    # The fork's arms end above the wheel's plane so that only the axle joins the two.
    width = 0.55 * radius
    center = np.array([0.0, trail, radius - z])
    arms = [
        s.box(
            (0.12 * radius, 0.5 * radius, z - radius + 0.25 * radius),
            (side * (0.76 * width), 0.6 * trail, -(z - radius) / 2 - 0.13 * radius),
            0.001,
        )
        for side in (-1, 1)
    ]
    size = (1.7 * width, 0.8 * radius + trail, 0.14 * radius)
    plate = s.box(size, (0, 0.3 * trail, -0.08 * radius), 0.001)
    turn = lambda solid: solid.turned((0, 0, 1), heading).moved((x, y, z))  # noqa: E731
    m = s.rotation((0, 0, 1), heading)
    fork = parent
    if swivel:
        fork = b.spin("caster", parent, (0, 0, 1), (x, y, z))
    for solid in (*arms, plate):
        fork.add(turn(solid.moved((0, 0, -0.0005))), b.palette.metal, "fork")
    axle = m @ center + [x, y, z]
    body = b.spin("wheel", fork, m @ np.array([1.0, 0, 0]), axle)
    tyres, hubs = wheel(radius, width)
    add(body, [turn(t.moved(center)) for t in tyres], rubber, "tyre")
    add(body, [turn(t.moved(center)) for t in hubs], b.palette.accent, "hub")
