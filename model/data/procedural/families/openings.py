"""Door and Window, and the latch lever that doors carry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from model.data.procedural import modules as m
from model.data.procedural import shapes as s
from model.data.procedural.grammar import Body, Builder, ProceduralObject
from model.data.procedural.materials import (
    PAINTS,
    Palette,
    Surface,
    furniture_palette,
    metal,
    one_color,
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
    palette = furniture_palette(rng)
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
        look = Palette(palette.body, palette.front, metal_, metal_, palette.dark)
        panel = m.door(b, frame, r, -deep / 2 + thick, spec, look)
        at = np.array([(r.x1 if side < 0 else r.x0) + side * 0.07, -deep / 2, 1.02])
        kind = rng.random()
        if kind < 0.55:
            lever_handle(b, panel, at, float(side), metal_)
        elif kind < 0.85:
            knob = b.spin("knob", panel, (0, -1, 0), at) if rng.random() < 0.5 else panel
            profile = [
                (0.014, 0.0006), (0.012, 0.03), (0.027, 0.042), (0.027, 0.055), (0.012, 0.062),
            ]  # fmt: skip
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
    thick = 0.034
    if kind in ("slide", "hung"):
        _sliding_sashes(b, frame, area, (w, h), kind == "hung", palette)
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
        sash = m.door(b, frame, opening, -deep / 2 + thick + 0.004, spec, palette, name="window")
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


def _sliding_sashes(
    b: Builder, frame: Body, area: m.Opening, size: Vector, upright: bool, palette: Palette
) -> None:
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
        m.panel(sash, r.shrunk(0.002), y, thick, "glass", palette, border=border)
        if k == 0 or not upright:
            grip = m.handle("lip", 0.12, 0.012)
            z = r.z0 + 0.02 if upright else r.center[1]
            x = r.center[0] if upright else (r.x0 + 0.02 if k == 0 else r.x1 - 0.02)
            if k == 0:
                solids = m.place(grip, (x, y - thick, z), roll=np.pi / 2 if upright else 0.0)
                m.add(sash, solids, palette.accent, "handle")
