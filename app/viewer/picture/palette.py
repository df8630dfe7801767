"""Colors of the screens, and the names that parts and objects are given."""

from __future__ import annotations

import colorsys
from typing import Final

import numpy as np
import numpy.typing as npt

from app.server.scene_saving_tasks import STATES
from model.validation.report import Severity

Rgb = tuple[int, int, int]
Tint = tuple[Rgb, float]
"""Color and opacity over a surface."""

BASE_COLOR: Final[Rgb] = (148, 156, 166)
PART_COLORS: Final[tuple[Rgb, ...]] = (
    (214, 118, 46), (10, 250, 250), (118, 46, 178), (10, 154, 250), (250, 214, 10), (10, 118, 118),
    (154, 58, 34), (190, 178, 250), (166, 118, 190), (10, 214, 130), (190, 178, 34),
    (178, 238, 166),
)  # fmt: skip
"""Chosen greedily for the largest least distance (OKLab) as seen with normal, red-, green- and
blue-blind eyes (Machado et al. 2009), away from the selection's, the axes' and the base's color."""
_LIGHTER, _DARKER, _TURN = 0.66, 0.52, 0.14
"""Changes of the first parts' colors for further ones: light, and a turn of the hue each round."""
SELECTED: Final[Rgb] = (236, 0, 140)
GHOST: Final[Rgb] = (150, 150, 160)
CONTACT: Final[Rgb] = (220, 20, 40)
COMMENT: Final[Rgb] = (214, 108, 0)
DIRECTIONS: Final[tuple[Rgb, Rgb, Rgb]] = ((204, 51, 51), (60, 150, 60), (51, 90, 204))
"""Colors of X, Y and Z, as everywhere in 3D."""
MARKED: Final[Rgb] = (176, 182, 190)
"""Color of elements that are marked for removal or removed."""
NEGATIVE: Final[Rgb] = (25, 25, 30)

PART_NAMES: Final[tuple[str, ...]] = (
    *"base door drawer lid knob button handle wheel lever switch screen seat leg arm cap".split(),
    *"blade tray shelf panel pedal spout hinge rotor caster".split(),
)
CATEGORIES: Final[tuple[str, ...]] = (
    *"Bottle Box Bucket Camera Cart Chair Clock CoffeeMachine Dishwasher Dispenser Display".split(),
    *"Door Eyeglasses Fan Faucet FoldingChair Globe Kettle Keyboard KitchenPot Knife Lamp".split(),
    *"Laptop Lighter Microwave Mouse Oven Pen Phone Pliers Printer Refrigerator Remote".split(),
    *"Safe Scissors Stapler StorageFurniture Suitcase Switch Table Toaster Toilet TrashCan".split(),
    *"USB WashingMachine Window".split(),
)
SCENE_COLORS: Final[dict[str, Rgb]] = {
    **{state: color for state, (_, color) in STATES.items()},
    "validating": (165, 200, 150),
}
"""Objects of a scene by state; "to do" must differ from "static"."""


def albedo(color: Rgb) -> Rgb:
    """The albedo that appears in that color under the lights of the picture."""
    r, g, b = (int(255 * (c / 255) ** 1.9) for c in color)
    return r, g, b


SCENE_ALBEDO: Final[dict[str, Rgb]] = {s: albedo(color) for s, color in SCENE_COLORS.items()}
"""The same for surfaces."""
SCENE_GHOST: Final[Rgb] = (120, 130, 145)
SCAN_GHOST: Final[Rgb] = (186, 192, 201)
"""Color of points, which nothing shows through."""
SEVERITY_COLORS: Final[dict[Severity, Rgb]] = {
    Severity.OK: (47, 158, 68),
    Severity.WARNING: (201, 118, 0),
    Severity.ERROR: (201, 42, 42),
}


_CONTRAST = 65.0
"""Distance of a tinted surface from its own color, RGB."""
_LIGHTEST, _STRONGEST = 0.4, 0.8
"""Least and most opacity over a surface."""


def tint(part: int, own: npt.ArrayLike) -> Tint:
    """A part's color so that it is seen on a surface of its ``own`` color, (3,): stronger on one
    that is alike, at last lighter or darker."""
    under, color = np.asarray(own, float), np.array(part_color(part), float)
    for shade in (color, color * 0.45 if under.mean() > 128 else color + 0.6 * (255 - color)):
        step = (shade - under) - (shade - under).mean() / 2
        opacity = _CONTRAST / max(float(np.linalg.norm(step)), 1.0)
        if opacity <= _STRONGEST:  # lightness counts half: lit sides differ by that, too
            break
    r, g, b = (round(v) for v in shade)
    return (r, g, b), round(float(np.clip(opacity, _LIGHTEST, _STRONGEST)), 1)


def link_color(link: str) -> Rgb:
    """The color of the part that a link moves; helpers and links of a file's own have none."""
    number = link.removeprefix("link_")
    return part_color(int(number)) if number.isdigit() else GHOST


def part_color(part: int) -> Rgb:
    """The color of a part; the first 36 are distinct."""
    if part == 0:
        return BASE_COLOR
    times, which = divmod(part - 1, len(PART_COLORS))
    if not times:
        return PART_COLORS[which]
    hue, light, saturation = colorsys.rgb_to_hls(*(c / 255 for c in PART_COLORS[which]))
    light = 1 - (1 - light) * _LIGHTER if times % 2 else light * _DARKER
    r, g, b = colorsys.hls_to_rgb((hue + _TURN * times) % 1.0, light, saturation)
    return (round(255 * r), round(255 * g), round(255 * b))
