"""Refrigerator."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from model.data.procedural import modules as m
from model.data.procedural import shapes as s
from model.data.procedural.families.kitchen import INSIDE
from model.data.procedural.grammar import Body, Builder, ProceduralObject
from model.data.procedural.materials import Palette, appliance_palette, glass, rubber


def refrigerator(rng: np.random.Generator) -> ProceduralObject:
    """One door, two over each other, side by side, or French doors over freezer drawers."""
    layout = ("single", "freezer_top", "freezer_bottom", "side_by_side", "french")[rng.integers(5)]
    wide = layout in ("side_by_side", "french")
    size = (
        float(rng.uniform(0.8, 0.95) if wide else rng.uniform(0.5, 0.7)),
        float(rng.uniform(0.5, 0.65)),
        float(rng.uniform(0.7, 1.2) if layout == "single" else rng.uniform(1.5, 1.95)),
    )
    ajar = float(rng.uniform(0.1, 1.2)) if rng.random() < 0.2 else 0.0
    return build_refrigerator(layout, size, appliance_palette(rng), rng, ajar=ajar)


def build_refrigerator(
    layout: str,
    size: tuple[float, float, float],
    palette: Palette,
    rng: np.random.Generator,
    *,
    ajar: float = 0.0,
    gap: float = 0.004,
) -> ProceduralObject:
    """A refrigerator of one of the layouts that :func:`refrigerator` names; ``gap`` in metres."""
    b = Builder("Refrigerator", rng)
    w, d, h = size
    body = b.base("refrigerator_body")
    bottom, wall, thick = 0.04, 0.045, float(rng.uniform(0.045, 0.07))
    front = -d / 2
    body.add(s.box((0.9 * w, 0.85 * d, bottom), (0, 0.03 * d, bottom / 2)), palette.dark, "plinth")
    cut = {"freezer_top": 0.7, "freezer_bottom": 0.36, "french": 0.38}.get(layout, 0.0)
    split = bottom + cut * h
    zones = (
        [m.Opening(-w / 2, w / 2, bottom, bottom + h)]
        if not cut
        else [m.Opening(-w / 2, w / 2, bottom, split), m.Opening(-w / 2, w / 2, split, bottom + h)]
    )
    hollow = 0.85 * d
    for x in (-1, 1):
        center = (x * (w - wall) / 2, front + hollow / 2, bottom + h / 2)
        body.add(s.box((wall, hollow, h), center, 0.004), palette.body, "side_wall")
    center = (0, d / 2 - (d - hollow) / 2, bottom + h / 2)
    body.add(s.box((w, d - hollow, h), center, 0.004), palette.body, "back")
    inner = w - 2 * wall
    levels = [bottom + wall / 2, bottom + h - wall / 2] + ([split] if cut else [])
    for z in levels:
        body.add(s.box((inner, hollow, wall), (0, front + hollow / 2, z)), palette.body, "wall")
    if layout == "side_by_side":
        center = (0, front + hollow / 2, bottom + h / 2)
        body.add(s.box((wall, hollow, h - 2 * wall), center), palette.body, "divider")
    shelf = glass((190, 214, 220), 150)
    for zone in zones[1:] if layout == "french" else zones:
        for k in range(int(zone.height // 0.3)):
            z = zone.z0 + zone.height * (k + 1) / (zone.height // 0.3 + 1)
            center = (0, front + 0.55 * hollow, z)
            body.add(s.box((inner, 0.8 * hollow, 0.008), center), shelf, "shelf")
    style: m.HandleStyle = ("bar", "bow", "flat")[rng.integers(3)]
    length = float(rng.uniform(0.25, 0.6))
    side: m.Side = "left" if rng.random() < 0.5 else "right"
    swing = float(rng.uniform(1.6, 2.2))
    look = m.DoorSpec(side, swing, "plain", style, length, 0.05, 0.5, 0.05, thick)
    moving: list[Body] = []

    def close(r: m.Opening, hinge: m.Side, at: float) -> None:
        spec = replace(look, hinge=hinge, handle_at=at)
        part = m.door(b, body, r.shrunk(gap / 2), front - 0.006, spec, palette)
        seal = s.frame((r.width - 0.05, r.height - 0.05), (r.width - 0.09, r.height - 0.09), 0.005)
        part.add(seal.moved((r.center[0], front - 0.0035, r.center[1])), rubber(), "gasket")
        moving.append(part)

    top = zones[-1]
    if layout in ("side_by_side", "french"):
        close(replace(top, x1=0.0), "left", 0.4)
        close(replace(top, x0=0.0), "right", 0.4)
    else:
        close(top, side, 0.15 if cut else 0.6)
    if cut and layout == "french":
        count = int(rng.integers(1, 3))
        _freezer_drawers(b, body, zones[0], front, thick, inner, hollow, palette, style, count)
    elif cut:
        close(zones[0], side, 0.85)
    rest = {moving[-1].link: min(ajar, look.swing)} if ajar else None
    return b.build(rest)


def _freezer_drawers(
    b: Builder,
    body: Body,
    zone: m.Opening,
    front: float,
    thick: float,
    inner: float,
    hollow: float,
    palette: Palette,
    style: m.HandleStyle,
    count: int,
) -> None:
    cuts = np.linspace(zone.z0, zone.z1, count + 1)
    for a, z in itertools.pairwise(cuts):
        r = m.Opening(zone.x0, zone.x1, float(a), float(z)).shrunk(0.002)
        cell = m.Opening(
            -inner / 2,
            inner / 2,
            max(float(a), zone.z0 + 0.045) + 0.002,
            min(float(z), zone.z1 - 0.025) - 0.002,
        )
        m.drawer(
            b, body, r, front - 0.006, 0.75 * hollow, palette, inner=cell, handle_style=style,
            thickness=thick, inside=INSIDE, travel=0.8, handle_length=0.6,
        )  # fmt: skip
