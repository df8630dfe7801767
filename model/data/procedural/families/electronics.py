"""Laptop, Display, Keyboard, Phone, Remote, Mouse, Camera, USB, Switch, Printer."""

from __future__ import annotations

import numpy as np

from model.data.procedural import shapes as s
from model.data.procedural.grammar import Body, Builder, ProceduralObject
from model.data.procedural.materials import Surface, metal, picture, plain, rubber
from model.data.procedural.textures import KEY_ROWS

KEY = plain("key", (46, 48, 52))


def key_grid(width: float, depth: float) -> list[tuple[float, float, float, float]]:
    """(x, y, width, depth) of each key of a keyboard about the origin, the back row first."""
    pitch, row_pitch = width / 15.0, depth / len(KEY_ROWS)
    out = []
    for row, widths in enumerate(KEY_ROWS):
        x = -width / 2
        y = depth / 2 - (row + 0.5) * row_pitch
        for units in widths:
            out.append((x + units * pitch / 2, y, units * pitch - 0.12 * pitch, 0.88 * row_pitch))
            x += units * pitch
    return out


def keys(
    body: Body, width: float, depth: float, at: tuple[float, float, float], height: float
) -> None:
    """Keys with legends as part of ``body``; ``at`` is the middle of their underside."""
    whole = s.box((width, depth, height)).moved(at)
    legends = picture("keys")
    for x, y, w, d in key_grid(width, depth):
        cap = s.box((w, d, height), bevel=0.25 * height)
        cap = cap.moved((at[0] + x, at[1] + y, at[2] + height / 2))
        body.add(cap, legends, "key", fit_to=whole)


def build_laptop(
    size: tuple[float, float, float],
    rng: np.random.Generator,
    shell: Surface,
    *,
    open_angle: float,
    barrels: int = 2,
    screen: int = 0,
) -> ProceduralObject:
    """A laptop.

    Args:
        size: (x, y) of the closed laptop and the base's thickness, metres.
        open_angle: radians between base and lid as it stands; π / 2 is upright.
    """
    b = Builder("Laptop", rng)
    w, d, t = size
    lid_t, radius = 0.0065, 0.0055
    base = b.base("base")
    at = (0, 0, t / 2 + 0.002)
    base.add(s.rounded_box((w, d, t), 0.012, rim=0.0022).moved(at), shell, "base")
    top = t + 0.002
    for x in (-1, 1):
        for y in (-1, 1):
            at = (x * 0.42 * w, y * 0.4 * d, 0.002)
            base.add(s.cylinder(0.007, 0.004, segments=12).moved(at), rubber(), "foot")
    kw, kd = 0.86 * w, 0.42 * d
    surface = plain("well", (28, 29, 32))
    base.add(s.box((1.02 * kw, 1.06 * kd, 0.0012), (0, 0.17 * d, top)), surface, "keyboard_well")
    keys(base, kw, kd, (0, 0.17 * d, top + 0.0006), 0.0018)
    pad = s.rounded_box((0.34 * w, 0.3 * d, 0.0012), 0.006, rim=0.0004)
    at = (0, -0.28 * d, top + 0.0002)
    base.add(pad.moved(at), plain("touchpad", (128, 130, 136)), "touchpad")
    for side in (-1, 1):
        for k in range(2):
            center = (side * w / 2, 0.2 * d + 0.03 * k, 0.55 * t + 0.002)
            port = s.box((0.0016, 0.011, 0.0045), center)
            base.add(port, plain("port", (24, 24, 26)), "port")
    # The lid is built closed and lies 1 mm above the keys; the hinge runs behind the base's edge.
    gap = 0.0032
    axis_y, axis_z = d / 2 + radius + 0.0006, top + gap * 0.5
    lid = b.hinge("screen", base, (-1, 0, 0), (0, axis_y, axis_z), 0.0, 2.4)
    slab = s.rounded_box((w, d - 0.008, lid_t), 0.012, rim=0.0018)
    lid_z = top + gap + lid_t / 2
    lid.add(slab.moved((0, -0.004 + 0.002, lid_z)), shell, "lid")
    glass_z = top + gap - 0.0001
    center = (0, -0.004, glass_z + 0.0003)
    surface = plain("bezel", (20, 21, 24))
    lid.add(s.box((0.975 * w, 0.94 * d - 0.008, 0.0012), center), surface, "bezel")
    view = s.box((0.93 * w, 0.82 * d, 0.001), (0, -0.002, glass_z - 0.0001))
    lid.add(view, picture("desktop", screen), "display", flipped=True)
    logo = s.cylinder(0.016, 0.0012, segments=24).moved((0, 0, lid_z + lid_t / 2))
    lid.add(logo, metal("white"), "logo")
    spots = np.linspace(-0.33, 0.33, barrels) * w if barrels > 1 else np.array([0.0])
    length = 0.16 * w if barrels > 1 else 0.6 * w
    for x in spots:
        bar = s.along(s.cylinder(radius, length, segments=16, bevel=0.0008), 0)
        lid.add(bar.moved((float(x), axis_y, axis_z)), plain("hinge", (40, 41, 44)), "hinge")
        bridge = s.box((0.8 * length, 0.02, 0.003), (float(x), axis_y - 0.01, top + gap + 0.0015))
        lid.add(bridge, plain("hinge", (40, 41, 44)), "hinge")
    return b.build({lid.link: open_angle})


def laptop(rng: np.random.Generator) -> ProceduralObject:
    """Open at any angle; its hinge is two barrels or one long one."""
    shells = (
        metal("brushed"), plain("alloy", (188, 190, 194)), plain("alloy_dark", (74, 77, 84)),
        plain("alloy_blue", (96, 118, 146)),
    )  # fmt: skip
    size = rng.uniform((0.28, 0.19, 0.011), (0.38, 0.26, 0.022))
    return build_laptop(
        (float(size[0]), float(size[1]), float(size[2])), rng, shells[rng.integers(4)],
        open_angle=float(rng.uniform(0.4, 2.3)), barrels=int(rng.integers(1, 3)),
        screen=int(rng.integers(6)),
    )  # fmt: skip
