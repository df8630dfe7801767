"""Surfaces: plain colours and generated textures, and palettes that go together.

Textures are drawn once for each kind and tint, seamless where they tile, and shared by all objects.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from model.core.geometry import Material
from model.data.procedural import textures

RGB = tuple[int, int, int]
Wood = Literal["oak", "walnut", "beech", "birch", "cherry", "grey"]

WOODS: dict[Wood, tuple[RGB, RGB]] = {
    "oak": ((150, 108, 66), (205, 166, 116)),
    "walnut": ((70, 45, 30), (122, 84, 56)),
    "beech": ((190, 142, 100), (224, 184, 142)),
    "birch": ((205, 180, 142), (236, 218, 188)),
    "cherry": ((128, 62, 38), (176, 98, 62)),
    "grey": ((118, 110, 102), (168, 160, 150)),
}
PAINTS: tuple[RGB, ...] = (
    (238, 236, 230), (222, 220, 214), (196, 206, 208), (92, 112, 120), (58, 74, 86),
    (150, 166, 148), (204, 190, 168), (172, 66, 54), (48, 50, 54), (214, 178, 92), (118, 142, 178),
)  # fmt: skip
PLASTICS: tuple[RGB, ...] = (
    (232, 232, 230), (44, 46, 50), (90, 94, 100), (190, 52, 48), (44, 92, 160), (238, 190, 60),
    (70, 140, 96), (212, 206, 190), (150, 152, 156), (228, 124, 60),
)  # fmt: skip
METALS: dict[str, RGB] = {
    "steel": (186, 190, 194),
    "brushed": (166, 168, 172),
    "dark": (74, 76, 82),
    "brass": (196, 160, 92),
    "copper": (190, 118, 82),
    "black": (38, 38, 42),
    "white": (232, 232, 234),
}


@dataclass(frozen=True, eq=False)
class Surface:
    """The surface of a solid.

    Attributes:
        material: colour and texture.
        tile: metres that one repetition of the texture covers.
        fit: the texture covers the whole solid once instead (screens, dials, key tops).
        globe: the texture is a map of longitude and latitude.
    """

    material: Material
    tile: float = 0.6
    fit: bool = False
    globe: bool = False


def plain(name: str, rgb: RGB, alpha: int = 255) -> Surface:
    """One colour."""
    return Surface(Material(name, (*(int(np.clip(v, 0, 255)) for v in rgb), alpha)))  # type: ignore[arg-type]


@lru_cache(maxsize=64)
def _textured(name: str, kind: str, colors: tuple[RGB, ...], tile: float) -> Surface:
    image = textures.draw(kind, colors)
    return Surface(Material(name, (255, 255, 255, 255), image), tile)


@lru_cache(maxsize=64)
def _picture(name: str, kind: str, variant: int) -> Surface:
    material = Material(name, (255, 255, 255, 255), textures.picture(kind, variant))
    return Surface(material, fit=True, globe=kind == "globe")


def wood(kind: Wood) -> Surface:
    """Wood grain along the solid's longest side."""
    return _textured(f"wood_{kind}", "wood", WOODS[kind], 0.7)


def metal(kind: str = "steel") -> Surface:
    """Bare or coated metal."""
    if kind == "brushed":
        return _textured("metal_brushed", "brushed", ((146, 148, 152), (190, 192, 196)), 0.4)
    return plain(f"metal_{kind}", METALS[kind])


def fabric(rgb: RGB) -> Surface:
    """Woven cloth."""
    dark: RGB = (int(rgb[0] * 0.8), int(rgb[1] * 0.8), int(rgb[2] * 0.8))
    return _textured("fabric", "fabric", (dark, rgb), 0.12)


def glass(tint: RGB = (150, 180, 190), alpha: int = 110) -> Surface:
    """See-through in viewers that can."""
    return plain("glass", tint, alpha)


def dark_glass() -> Surface:
    """An oven window, a dead screen."""
    return plain("dark_glass", (30, 32, 36))


def rubber() -> Surface:
    """Tyres and feet."""
    return plain("rubber", (42, 42, 44))


def picture(kind: str, variant: int = 0) -> Surface:
    """A drawn picture fitted to the solid: desktop, phone, clock, dial, globe, keys, drum."""
    return _picture(f"{kind}_{variant}", kind, variant)


@dataclass(frozen=True, eq=False)
class Palette:
    """Surfaces that go together in one object.

    Attributes:
        body, front, accent, metal, dark: carcass, fronts, handles and knobs, hinges and bars,
            what lies in the shadow.
    """

    body: Surface
    front: Surface
    accent: Surface
    metal: Surface
    dark: Surface


def _vary(rgb: RGB, rng: np.random.Generator, amount: int = 10) -> RGB:
    shade = rng.integers(-amount, amount + 1)
    out = np.clip(np.asarray(rgb) + shade + rng.integers(-4, 5, 3), 0, 255)
    return (int(out[0]), int(out[1]), int(out[2]))


def one_color(rng: np.random.Generator, colors: tuple[RGB, ...]) -> Surface:
    """One of ``colors``."""
    return plain("colour", colors[rng.integers(len(colors))])


def furniture_palette(rng: np.random.Generator) -> Palette:
    """Wood or paint, with fronts that match or contrast."""
    woods: list[Wood] = list(WOODS)
    body = wood(woods[rng.integers(len(woods))])
    paint = plain("paint", _vary(PAINTS[rng.integers(len(PAINTS))], rng))
    style = rng.random()
    front = (
        body if style < 0.45 else paint if style < 0.8 else wood(woods[rng.integers(len(woods))])
    )
    if rng.random() < 0.25:
        body = plain("paint_body", _vary(PAINTS[rng.integers(3)], rng))
    bar = metal(str(rng.choice(["steel", "brass", "dark", "black", "copper"])))
    return Palette(body, front, bar, metal("steel"), plain("shadow", (52, 44, 38)))


def appliance_palette(rng: np.random.Generator) -> Palette:
    """White, black or steel, as kitchens have them."""
    style = rng.integers(4)
    body = (
        plain("enamel", (232, 232, 230)),
        metal("brushed"),
        plain("enamel_black", (46, 47, 50)),
        plain("enamel_colour", _vary(PAINTS[rng.integers(len(PAINTS))], rng)),
    )[style]
    front = metal("brushed") if style == 2 and rng.random() < 0.5 else body
    accent = metal(str(rng.choice(["steel", "dark", "black"])))
    return Palette(body, front, accent, metal("steel"), plain("panel", (36, 37, 40)))


def plastic_palette(rng: np.random.Generator) -> Palette:
    """Two plastics and a metal, for small objects."""
    first, second = rng.choice(len(PLASTICS), 2, replace=False)
    return Palette(
        plain("plastic", _vary(PLASTICS[first], rng)),
        plain("plastic_front", _vary(PLASTICS[first], rng, 18)),
        plain("plastic_accent", _vary(PLASTICS[second], rng)),
        metal(str(rng.choice(["steel", "dark"]))),
        plain("plastic_dark", (36, 37, 40)),
    )


def any_plastic(rng: np.random.Generator) -> Surface:
    """A plastic of any colour."""
    return plain("plastic", PLASTICS[rng.integers(len(PLASTICS))])
