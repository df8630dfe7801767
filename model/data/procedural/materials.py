"""Surfaces: plain colours, drawn textures and pictures, and palettes that go together.

Textures are seamless materials from filtered noise, pictures are for screens and dials. Each is
drawn once for each kind and tint, seamless where it tiles, and shared by all objects. Everything is
deterministic: the noise is seeded by the kind.
"""

from __future__ import annotations

import io
import math
import zlib
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFilter

from model.core.geometry import Material

RGB = tuple[int, int, int]
SIZE = 512


def _noise(
    rng: np.random.Generator, size: int, along: float, across: float
) -> npt.NDArray[np.float64]:
    """(size, size) seamless noise of zero mean and unit variance, longer along x than y."""
    fy, fx = np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size), indexing="ij")
    window = np.exp(-2 * (np.pi**2) * ((fx * along) ** 2 + (fy * across) ** 2))
    out = np.fft.ifft2(np.fft.fft2(rng.standard_normal((size, size))) * window).real
    return (out - out.mean()) / max(float(out.std()), 1e-12)


def _jpeg(pixels: npt.NDArray[np.float64] | Image.Image, quality: int = 85) -> Image.Image:
    """Through JPEG and back, so that exporters keep the small encoding."""
    image = (
        pixels
        if isinstance(pixels, Image.Image)
        else Image.fromarray(np.clip(pixels, 0, 255).astype(np.uint8), "RGB")
    )
    buffer = io.BytesIO()
    image.convert("RGB").save(buffer, "JPEG", quality=quality)
    out = Image.open(io.BytesIO(buffer.getvalue()))
    out.load()
    return out


def _mix(low: RGB, high: RGB, t: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    t = np.clip(t, 0, 1)[..., None]
    return np.asarray(low) * (1 - t) + np.asarray(high) * t


def draw(kind: str, colors: tuple[RGB, ...]) -> Image.Image:
    """A seamless texture: wood, brushed or fabric, between two colours; x is along the grain."""
    rng = np.random.default_rng(zlib.crc32(repr((kind, colors)).encode()))
    low, high = colors[0], colors[-1]
    if kind == "wood":
        y = np.arange(SIZE)[:, None] / SIZE
        warp = _noise(rng, SIZE, 90, 22)
        rings = 0.5 + 0.5 * np.sin(2 * np.pi * (7 * y + 0.55 * warp))
        streaks = _noise(rng, SIZE, 70, 1.2)
        cloud = _noise(rng, SIZE, 120, 60)
        t = 0.62 + 0.22 * (rings**2 - 0.4) + 0.10 * streaks + 0.09 * cloud
        pores = _noise(rng, SIZE, 12, 0.7) > 2.3
        return _jpeg(_mix(low, high, t - 0.25 * pores))
    if kind == "brushed":
        t = 0.5 + 0.14 * _noise(rng, SIZE, 80, 0.6) + 0.06 * _noise(rng, SIZE, 200, 40)
        return _jpeg(_mix(low, high, t), 80)
    if kind == "fabric":
        y, x = np.mgrid[0:256, 0:256]
        weave = 0.5 + 0.25 * np.sin(2 * np.pi * x / 8) * np.sign(np.sin(2 * np.pi * y / 16))
        t = weave + 0.12 * np.sin(2 * np.pi * y / 8) + 0.07 * _noise(rng, 256, 2, 2)
        return _jpeg(_mix(low, high, t), 80)
    raise ValueError(f"no texture {kind!r}; there are wood, brushed, fabric")


def picture(kind: str, variant: int = 0) -> Image.Image:
    """A picture that is fitted to a solid once.

    Args:
        kind: desktop, phone, clock, dial, globe, keys or panel.
        variant: another layout or other colours.
    """
    rng = np.random.default_rng(zlib.crc32(kind.encode()) + variant)
    painters = {
        "desktop": _desktop,
        "phone": _phone,
        "clock": _clock,
        "dial": _dial,
        "globe": _globe,
        "keys": _keys,
        "panel": _panel,
    }
    if kind not in painters:
        raise ValueError(f"no picture {kind!r}; there are {', '.join(painters)}")
    return _jpeg(painters[kind](rng), 85)


def _gradient(rng: np.random.Generator, width: int, height: int) -> Image.Image:
    """Hills under a sky, as on a desktop."""
    y, x = np.mgrid[0:height, 0:width] / np.array([height, width])[:, None, None]
    hue = rng.random()
    top = 120 + 100 * np.cos(2 * np.pi * (hue + np.array([0.0, 0.33, 0.66])))
    low = 150 + 80 * np.cos(2 * np.pi * (hue + 0.2 + np.array([0.0, 0.33, 0.66])))
    out = top * (1 - y[..., None]) + low * y[..., None]
    for level in range(4):
        phase, waves = rng.random(2) * [6.3, 2.0] + [0, 1]
        ridge = 0.45 + 0.13 * level + 0.07 * np.sin(phase + 6.3 * waves * x)
        shade = low * (0.8 - 0.17 * level)
        out = np.where((y > ridge)[..., None], 0.25 * out + 0.75 * shade, out)
    return Image.fromarray(np.clip(out, 0, 255).astype(np.uint8))


def _desktop(rng: np.random.Generator) -> Image.Image:
    image = _gradient(rng, 800, 500)
    d = ImageDraw.Draw(image)
    for i in range(2):
        x, y = int(90 + 260 * i), int(60 + 70 * i)
        d.rounded_rectangle((x, y, x + 340, y + 250), 8, (245, 246, 248))
        d.rounded_rectangle((x, y, x + 340, y + 24), 8, (70, 76, 90))
        for k in range(3):
            d.ellipse(
                (x + 10 + 18 * k, y + 7, x + 20 + 18 * k, y + 17),
                ((236, 90, 80), (240, 190, 70), (90, 190, 90))[k],
            )
        for row in range(9):
            length = int(rng.integers(120, 300))
            tone = int(rng.integers(120, 190))
            d.rectangle(
                (x + 18, y + 42 + 22 * row, x + 18 + length, y + 50 + 22 * row),
                (tone, tone, tone + 10),
            )
    d.rectangle((0, 470, 800, 500), (28, 30, 38))
    for k in range(8):
        d.rounded_rectangle(
            (250 + 38 * k, 474, 276 + 38 * k, 496),
            5,
            tuple(int(v) for v in rng.integers(80, 240, 3)),
        )
    return image


def _phone(rng: np.random.Generator) -> Image.Image:
    image = _gradient(rng, 270, 540)
    d = ImageDraw.Draw(image)
    for row in range(5):
        for col in range(4):
            x, y = 24 + 60 * col, 90 + 72 * row
            d.rounded_rectangle(
                (x, y, x + 42, y + 42), 10, tuple(int(v) for v in rng.integers(60, 245, 3))
            )
    return image


def _clock(rng: np.random.Generator) -> Image.Image:
    image = Image.new("RGB", (512, 512), (246, 244, 238))
    d = ImageDraw.Draw(image)
    for k in range(60):
        a = 2 * math.pi * k / 60
        r0, width = (190, 9) if k % 5 == 0 else (214, 3)
        d.line(
            [(256 + r * math.sin(a), 256 - r * math.cos(a)) for r in (r0, 232)], (34, 34, 38), width
        )
    return image


def _dial(rng: np.random.Generator) -> Image.Image:
    image = Image.new("RGB", (256, 256), (222, 222, 222))
    d = ImageDraw.Draw(image)
    for k in range(21):
        a = math.radians(-150 + 15 * k)
        d.line([(128 + r * math.sin(a), 128 - r * math.cos(a)) for r in (96, 112)], (50, 50, 54), 4)
    return image


def _globe(rng: np.random.Generator) -> Image.Image:
    """Invented continents over a graticule; x is longitude and wraps."""
    size = 512
    land = (
        _noise(rng, size, 40, 40) + 0.5 * _noise(rng, size, 14, 14) + 0.2 * _noise(rng, size, 5, 5)
    )
    height = np.linspace(1, -1, size)[:, None]
    sea = _mix((46, 96, 158), (96, 158, 204), 0.5 + 0.12 * land)
    ground = _mix((112, 142, 82), (206, 188, 138), 0.4 + 0.35 * land * 0.6)
    out = np.where((land - 0.25 * np.abs(height) > 0.25)[..., None], ground, sea)
    out = np.where((np.abs(height) > 0.88)[..., None], [236, 240, 244], out)
    out[:: size // 12] *= 0.86
    out[:, :: size // 16] *= 0.86
    return Image.fromarray(np.clip(out, 0, 255).astype(np.uint8))


KEY_ROWS: tuple[tuple[float, ...], ...] = (
    (1.0,) * 14 + (1.0,),
    (1.0,) * 13 + (2.0,),
    (1.5,) + (1.0,) * 12 + (1.5,),
    (1.75,) + (1.0,) * 11 + (2.25,),
    (2.25,) + (1.0,) * 10 + (2.75,),
    (1.25, 1.25, 1.25, 5.5, 1.25, 1.25, 1.25, 1.0, 1.0),
)
"""Key widths row by row from the back, in key pitches; each row is 15 wide."""

_LEGENDS = (
    ("esc", *(f"F{k}" for k in range(1, 13)), "ins", "del"),
    ("`", *"1234567890-=", "back"),
    ("tab", *"QWERTYUIOP[]", "\\"),
    ("caps", *"ASDFGHJKL;'", "enter"),
    ("shift", *"ZXCVBNM,./", "shift"),
    ("ctrl", "fn", "alt", "", "alt", "menu", "ctrl", "<", ">"),
)


def _keys(rng: np.random.Generator) -> Image.Image:
    pitch = 64
    image = Image.new("RGB", (15 * pitch, 6 * pitch), (40, 42, 46))
    d = ImageDraw.Draw(image)
    for row, (widths, legends) in enumerate(zip(KEY_ROWS, _LEGENDS, strict=True)):
        x = 0.0
        for width, legend in zip(widths, legends, strict=True):
            size = 24 if len(legend) == 1 else 14
            spot = ((x + width / 2) * pitch, (row + 0.5) * pitch)
            d.text(spot, legend, (222, 224, 228), anchor="mm", font_size=size)
            x += width
    return image


def _panel(rng: np.random.Generator) -> Image.Image:
    image = Image.new("RGB", (320, 120), (24, 26, 30))
    d = ImageDraw.Draw(image)
    d.text(
        (160, 60),
        f"{rng.integers(1, 13):02d}:{rng.integers(60):02d}",
        (110, 226, 196),
        anchor="mm",
        font_size=76,
    )
    return image.filter(ImageFilter.GaussianBlur(0.6))


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
    image = draw(kind, colors)
    return Surface(Material(name, (255, 255, 255, 255), image), tile)


@lru_cache(maxsize=64)
def _picture(name: str, kind: str, variant: int) -> Surface:
    material = Material(name, (255, 255, 255, 255), picture(kind, variant))
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


def pictured(kind: str, variant: int = 0) -> Surface:
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


UNPAINTED = Palette(*[plain("plain", (200, 200, 200))] * 5)
"""Of families that bring the surface of each solid."""


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
