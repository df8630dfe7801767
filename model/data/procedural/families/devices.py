"""Laptop, Display, Keyboard, Phone, Remote, Mouse, Switch."""

from __future__ import annotations

import numpy as np

from model.data.procedural import controls
from model.data.procedural import modules as m
from model.data.procedural import shapes as s
from model.data.procedural.grammar import Body, Builder, ProceduralObject
from model.data.procedural.materials import (
    KEY_ROWS,
    PLASTICS,
    Surface,
    dark_glass,
    metal,
    pictured,
    plain,
    rubber,
)

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
    legends = pictured("keys")
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
    lid.add(view, pictured("desktop", screen), "display", flipped=True)
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
        metal("brushed"),
        plain("alloy", (188, 190, 194)),
        plain("alloy_dark", (74, 77, 84)),
        plain("alloy_blue", (96, 118, 146)),
    )
    size = rng.uniform((0.28, 0.19, 0.011), (0.38, 0.26, 0.022))
    return build_laptop(
        (float(size[0]), float(size[1]), float(size[2])),
        rng,
        shells[rng.integers(4)],
        open_angle=float(rng.uniform(0.4, 2.3)),
        barrels=int(rng.integers(1, 3)),
        screen=int(rng.integers(6)),
    )


GREY = plain("plastic_grey", (70, 73, 78))


LIGHT = plain("plastic_light", (222, 222, 220))


def _case(rng: np.random.Generator) -> Surface:
    return plain("case", PLASTICS[rng.choice([0, 1, 1, 2, 3, 4, 8])])


def display(rng: np.random.Generator) -> ProceduralObject:
    """A monitor that tips, turns and slides on its stand, with buttons."""
    b = Builder("Display", rng)
    case = plain("case", (40, 42, 46)) if rng.random() < 0.6 else LIGHT
    w = float(rng.uniform(0.4, 0.75))
    h, t = w * float(rng.uniform(0.52, 0.68)), float(rng.uniform(0.025, 0.045))
    base = b.base("stand")
    deep = float(rng.uniform(0.16, 0.24))
    if rng.random() < 0.5:
        size = (0.45 * w, deep, 0.012)
        base.add(s.rounded_box(size, 0.03, rim=0.004).moved((0, 0, 0.006)), case, "foot")
    else:
        offset = (0, 0, 0.006)
        base.add(s.cylinder(deep / 2, 0.012, segments=36, bevel=0.004).moved(offset), case, "foot")
    rise = float(rng.uniform(0.08, 0.16))
    y0 = 0.035
    size = (0.055, 0.024, rise + h * 0.5)
    base.add(s.box(size, (0, y0, 0.01 + (rise + h * 0.5) / 2), 0.004), case, "post")
    parent = base
    cz = rise + h * 0.5
    front = y0 - 0.0126
    lift = float(rng.uniform(0.05, 0.12))
    if rng.random() < 0.4:
        parent = b.slide("carriage", base, (0, 0, 1), 0.0, min(lift, 0.4 * h), (0, front, cz))
        parent.add(s.box((0.07, 0.012, 0.07), (0, front - 0.0064, cz), 0.002), GREY, "carriage")
        front -= 0.0126
    else:
        base.add(s.box((0.07, 0.012, 0.07), (0, front - 0.006, cz), 0.002), GREY, "carriage")
        front -= 0.0122
    at = np.array([0, front - 0.014, cz])
    screen = b.hinge("screen", parent, (-1, 0, 0), at, -0.15, 0.35)
    for side in (-1, 1):
        size = (0.008, 0.022, 0.026)
        parent.add(s.box(size, (side * 0.028, front - 0.009, cz), 0.002), GREY, "fork")
    screen.add(s.along(s.cylinder(0.007, 0.046, segments=14), 0).moved(at), metal("steel"), "hinge")
    back = at[1] - 0.014
    screen.add(s.box((0.03, 0.016, 0.016), (0, at[1] - 0.009, cz)), GREY, "lug")
    slab = s.rounded_box((w, h, t), 0.012, rim=0.006).turned((1, 0, 0), np.pi / 2)
    screen.add(slab.moved((0, back - t / 2, cz)), case, "case")
    face = back - t
    size = (w - 0.02, 0.003, h - 0.03)
    screen.add(s.box(size, (0, face - 0.0002, cz + 0.005)), dark_glass(), "bezel")
    size = (w - 0.034, 0.003, h - 0.05)
    center = (0, face - 0.0006, cz + 0.006)
    screen.add(s.box(size, center), pictured("desktop", int(rng.integers(6))), "display")
    for k in range(int(rng.integers(0, 5))):
        spot = (0.4 * w - 0.022 * k, face, cz - h / 2 + 0.009)
        controls.push_button(b, screen, spot, (0.012, 0.005, 0.003), GREY)
    return b.build()


def keyboard(rng: np.random.Generator) -> ProceduralObject:
    """A keyboard whose keys go down, perhaps with folding feet."""
    b = Builder("Keyboard", rng)
    case = _case(rng)
    base = b.base("keyboard_base")
    w, d = float(rng.uniform(0.28, 0.36)), float(rng.uniform(0.1, 0.13))
    t, z = 0.012, 0.004
    size = (w + 0.02, d + 0.02, t)
    base.add(s.rounded_box(size, 0.006, rim=0.003).moved((0, 0, z + t / 2)), case, "case")
    top = z + t
    travel = 0.003
    grid = key_grid(w, d)
    # A part a key would be sixty and more; some keyboards have keys that stay.
    share = float(rng.choice([0.15, 0.3, 0.6]))
    cap_skin = KEY if rng.random() < 0.6 else LIGHT
    for x, y, kw, kd in grid:
        body = base
        if rng.random() < share:
            body = b.slide("key", base, (0, 0, -1), 0.0, 0.8 * travel, (x, y, top))
        outline = s.rectangle(kw, kd, 0.001)
        solid = s.rectangle(0.8 * kw, 0.8 * kd, 0.001)
        cap = s.loft([s.at(outline, top + 0.0004), s.at(solid, top + 0.0004 + travel + 0.004)])
        body.add(cap.moved((x, y, 0)), cap_skin, "key")
    if rng.random() < 0.6:
        for side in (-1, 1):
            at = (side * 0.4 * w, d / 2 - 0.004, z)
            foot = b.hinge("foot", base, (1, 0, 0), at, 0.0, 1.4)
            size = (0.03, 0.022, 0.0028)
            foot.add(s.box(size, (at[0], at[1] - 0.011, z - 0.002), 0.0005), GREY, "foot")
    return b.build()


def phone(rng: np.random.Generator) -> ProceduralObject:
    """A flip phone, a slider, a desk telephone with its receiver, or a phone with buttons."""
    b = Builder("Phone", rng)
    case = _case(rng)
    kind = ("flip", "slide", "bar")[rng.integers(3)]
    w, h, t = (float(v) for v in rng.uniform((0.045, 0.085, 0.009), (0.07, 0.13, 0.013)))
    z = t / 2
    base = b.base("phone_base")
    base.add(s.rounded_box((w, h, t), 0.008, rim=0.002).moved((0, 0, z)), case, "case")
    if kind == "bar":
        surface = pictured("phone", int(rng.integers(4)))
        base.add(s.box((0.86 * w, 0.56 * h, 0.001), (0, 0.15 * h, t + 0.0001)), surface, "display")
        _keypad(b, base, w, h, t, -0.29 * h, 0.3 * h)
        side = s.box((0.002, 0.014, 0.004))
        volume = b.slide("button", base, (-1, 0, 0), 0.0, 0.0008, (w / 2, 0.2 * h, z))
        volume.add(side.moved((w / 2 + 0.0011, 0.2 * h, z)), GREY, "button")
        return b.build()
    _keypad(b, base, w, h, t, -0.05 * h, 0.8 * h)
    top = t + 0.0022
    if kind == "slide":
        lid = b.slide("translation_screen", base, (0, 1, 0), 0.0, 0.52 * h, (0, 0, top))
        size = (w, h, 0.7 * t)
        lid.add(s.rounded_box(size, 0.008, rim=0.002).moved((0, 0, top + 0.35 * t)), case, "case")
        size = (0.86 * w, 0.84 * h, 0.001)
        center = (0, 0, top + 0.7 * t + 0.0001)
        lid.add(s.box(size, center), pictured("phone", int(rng.integers(4))), "display")
        rest = float(rng.uniform(0.1, 0.5)) * h if rng.random() < 0.6 else 0.0
        return b.build({lid.link: rest} if rest else None)
    at = (0, h / 2 + 0.0046, t + 0.0011)
    lid = b.hinge("screen", base, (-1, 0, 0), at, 0.0, float(rng.uniform(2.5, 2.9)))
    size = (w, h, 0.7 * t)
    lid.add(s.rounded_box(size, 0.008, rim=0.002).moved((0, 0, top + 0.35 * t)), case, "case")
    lid.add(s.along(s.cylinder(0.004, 0.45 * w, segments=14), 0).moved(at), GREY, "hinge")
    lid.add(s.box((0.4 * w, 0.008, 0.003), (0, h / 2, top + 0.003)), GREY, "hinge")
    size = (0.84 * w, 0.8 * h, 0.001)
    center = (0, 0, top - 0.0002)
    lid.add(s.box(size, center), pictured("phone", int(rng.integers(4))), "display", flipped=True)
    return b.build({lid.link: float(rng.uniform(1.2, 2.4))} if rng.random() < 0.8 else None)


def _keypad(b: Builder, base: Body, w: float, h: float, top: float, cy: float, span: float) -> None:
    for i in range(4):
        for j in range(3):
            at = ((j - 1) * 0.29 * w, cy + (1.5 - i) * span / 4, top)
            controls.push_button(b, base, at, (0.23 * w, 0.7 * span / 4, 0.0014), GREY, face="up")


def remote(rng: np.random.Generator) -> ProceduralObject:
    """A handset with rows of buttons."""
    b = Builder("Remote", rng)
    case = _case(rng)
    w, h, t = (float(v) for v in rng.uniform((0.036, 0.12, 0.014), (0.052, 0.21, 0.022)))
    base = b.base("remote_base")
    body = s.rounded_box((w, h, t), 0.3 * w, rim=0.3 * t, rings=1)

    def waist(v: np.ndarray) -> np.ndarray:
        v[:, 0] *= 1 - 0.08 * np.cos(v[:, 1] / h * 6.0)
        return v

    base.add(body.shaped(waist).moved((0, 0, t / 2)), case, "case")
    skin = GREY if sum(case.material.base_color[:3]) > 300 else LIGHT
    red = plain("power", (200, 50, 44))
    offset = (-0.26 * w, 0.42 * h, t)
    controls.push_button(b, base, offset, (0.18 * w, 0.18 * w, 0.002), red, face="up", round_=True)
    rows, cols = int(rng.integers(4, 8)), int(rng.integers(2, 4))
    pitch = 0.72 * h / rows
    for i in range(rows):
        for j in range(cols):
            at = ((j - (cols - 1) / 2) * 0.66 * w / cols * 1.15, 0.3 * h - i * pitch, t)
            size = (0.5 * w / cols, min(0.6 * pitch, 0.012), 0.002)
            round_ = bool((i + rows) % 3 == 0)
            controls.push_button(b, base, at, size, skin, face="up", round_=round_)
    return b.build()


def mouse(rng: np.random.Generator) -> ProceduralObject:
    """Two buttons and a wheel on a domed body."""
    b = Builder("Mouse", rng)
    case, top_skin = _case(rng), _case(rng)
    w, d, h = (float(v) for v in rng.uniform((0.056, 0.095, 0.03), (0.068, 0.12, 0.04)))
    base = b.base("mouse_body")
    a = np.arange(32) * 2 * np.pi / 32
    egg = np.stack(
        [0.5 * w * np.sign(np.cos(a)) * np.abs(np.cos(a)) ** 0.7, 0.5 * d * np.sin(a)], 1
    )
    split = -0.02 * d
    floor = 0.45 * h

    def dome(z: np.ndarray, y: np.ndarray) -> np.ndarray:
        return z * (1 - 0.55 * np.clip(-(y - 0.1 * d) / d, 0, 1))

    loops = [s.at(0.94 * egg, 0.001), s.at(egg, 0.3 * floor), s.at(egg, floor)]
    base.add(s.loft(loops), case, "shell")
    rear = [
        s.at(egg * f, z)
        for f, z in ((1.0, floor - 0.001), (0.96, 0.75 * h), (0.8, 0.93 * h), (0.4, h))
    ]
    rear_solid = s.loft(rear).shaped(
        lambda v: np.column_stack([v[:, 0], np.maximum(v[:, 1], split + 0.001), v[:, 2]])
    )
    base.add(rear_solid, case, "palm")
    slot = 0.0045
    for side in (-1, 1):
        button = b.hinge("button", base, (1, 0, 0), (0, split, 0.8 * h), 0.0, 0.03)

        def press(v: np.ndarray, side: int = side) -> np.ndarray:
            v[:, 1] = np.minimum(v[:, 1], split)
            v[:, 0] = side * np.maximum(side * v[:, 0], slot)
            return v

        lid = [
            s.at(egg * f, z)
            for f, z in ((1.0, floor + 0.0025), (0.97, 0.68 * h), (0.84, 0.86 * h), (0.5, 0.92 * h))
        ]
        button.add(s.loft(lid).shaped(press), top_skin, "button")
    wheel_at = (0, -0.24 * d, 0.74 * h)
    for side in (-1, 1):
        post = s.box((0.0008, 0.006, 0.35 * h), (side * 0.004, -0.24 * d, floor + 0.12 * h))
        base.add(post, GREY, "fork")
    wheel = b.spin("wheel", base, (1, 0, 0), wheel_at)
    tyre, hub = controls.wheel(0.24 * h, 0.0055)
    m.add(wheel, [x.moved(wheel_at) for x in (*tyre, *hub)], rubber(), "wheel")
    return b.build()


def switch(rng: np.random.Generator) -> ProceduralObject:
    """A wall plate with rockers, toggles or dials."""
    b = Builder("Switch", rng)
    skin = LIGHT if rng.random() < 0.7 else GREY
    count = int(rng.integers(1, 5))
    pitch = 0.046
    w, h, t = 0.04 + pitch * count, float(rng.uniform(0.08, 0.12)), 0.008
    plate = b.base("switch_frame")
    kind = ("rocker", "toggle", "dial")[rng.integers(3)]
    inner_w, inner_h = 0.034, 0.064
    cz = h / 2
    bars = np.linspace(-w / 2, w / 2, count + 1)
    if kind == "rocker":
        for k in range(count):
            lo, hi = float(bars[k]), float(bars[k + 1])
            ring = s.frame((hi - lo, h), (inner_w + 0.002, inner_h + 0.002), t)
            plate.add(ring.moved(((lo + hi) / 2, 0, cz)), skin, "plate")
        plate.add(s.box((w, 0.002, h), (0, t / 2 + 0.001, cz)), skin, "plate")
    else:
        solid = s.rounded_box((w, h, t), 0.006, rim=0.002)
        plate.add(solid.turned((1, 0, 0), np.pi / 2).moved((0, 0, cz)), skin, "plate")
    for k in range(count):
        x = float(bars[k] + bars[k + 1]) / 2
        if kind == "rocker":
            tilt = 0.1 * (1 if rng.random() < 0.5 else -1)
            axis = (1, 0, 0)
            lower = min(0.0, -2 * tilt)
            rocker = b.hinge("switch", plate, axis, (x, -0.001, cz), lower, max(0.0, -2 * tilt))
            outline = np.array(
                [
                    (-0.002, -inner_h / 2),
                    (0.0, -inner_h / 2),
                    (0.0, inner_h / 2),
                    (-0.002, inner_h / 2),
                    (-0.0055, 0),
                ]
            )
            solid = s.slab(outline, inner_w, axis=0)
            surface = plain("rocker", (246, 246, 244))
            offset = (x, -0.001, cz)
            rocker.add(solid.turned((1, 0, 0), tilt * 0.9).moved(offset), surface, "rocker")
        elif kind == "toggle":
            collar = s.along(s.cylinder(0.007, 0.004, segments=18), 1)
            collar = collar.moved((x, -t / 2 - 0.002, cz))
            plate.add(collar, metal("steel"), "collar")
            at = np.array([x, -t / 2 - 0.0045, cz])
            lever = b.hinge("switch", plate, (1, 0, 0), at, -0.9, 0.0)
            bar = s.lathe([(0.0025, 0), (0.004, 0.02), (0.0, 0.0215)], 14)
            lever.add(s.along(bar, 1).turned((1, 0, 0), 0.45).moved(at), metal("steel"), "lever")
        else:
            controls.knob(
                b,
                plate,
                (x, -t / 2, cz),
                (0.016, 0.016),
                (plain("dial", (246, 246, 244)), GREY),
                style=int(rng.integers(3)),
                limits=(0.0, 4.7),
            )
    return b.build()
