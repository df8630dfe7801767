"""Legs of furniture."""

from __future__ import annotations

from typing import Literal

import numpy as np

from model.data.procedural import shapes as s
from model.data.procedural.grammar import Body
from model.data.procedural.materials import Surface

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
