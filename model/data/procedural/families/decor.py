"""Lamp, Fan, Globe, Clock."""

from __future__ import annotations

import numpy as np

from model.data.procedural import controls
from model.data.procedural import shapes as s
from model.data.procedural.grammar import Body, Builder, ProceduralObject
from model.data.procedural.materials import PLASTICS, Surface, metal, pictured, plain, wood


def _color(rng: np.random.Generator) -> Surface:
    if rng.random() < 0.4:
        return metal(("steel", "brass", "black", "copper", "white")[rng.integers(5)])
    return plain("paint", PLASTICS[rng.integers(len(PLASTICS))])


def _bar_between(a: np.ndarray, b: np.ndarray, radius: float) -> s.Solid:
    return s.tube(np.stack([a, b]), radius, 12)


def _bolt(
    body: Body, at: np.ndarray, x0: float, x1: float, radius: float, surface: Surface
) -> None:
    solid = s.along(s.cylinder(radius, abs(x1 - x0), segments=16, bevel=0.001), 0)
    body.add(solid.moved(at + np.array([(x0 + x1) / 2, 0, 0])), surface, "bolt")


def lamp(rng: np.random.Generator) -> ProceduralObject:
    """A desk lamp: foot, one to three arms on hinges, a shade that tips."""
    b = Builder("Lamp", rng)
    skin, joint_skin = _color(rng), metal("steel")
    base = b.base("lamp_base")
    r = float(rng.uniform(0.07, 0.11))
    base.add(s.lathe([(r, 0), (r, 0.012), (0.85 * r, 0.02), (0.2 * r, 0.026)], 32), skin, "foot")
    neck = 0.06
    base.add(s.cylinder(0.009, neck, segments=14).moved((0, 0, neck / 2 + 0.01)), skin, "neck")
    arms = int(rng.integers(1, 4))
    parent = base
    if rng.random() < 0.5:
        parent = (
            b.spin("swivel", base, (0, 0, 1), (0, 0, 0.075))
            if rng.random() < 0.5
            else b.hinge("swivel", base, (0, 0, 1), (0, 0, 0.075), -2.6, 2.6)
        )
        parent.add(
            s.cylinder(0.016, 0.022, segments=18, bevel=0.002).moved((0, 0, 0.0818)),
            joint_skin,
            "collar",
        )
    here = np.array([0.0, 0.0, 0.1])
    lug = s.box((0.006, 0.022, 0.036), (0, 0, 0.092), 0.002)
    parent.add(lug, joint_skin, "lug")
    half = 0.0035
    # Arms alternate between the two sides of the hinge plane, so that they pass one another.
    lane = 0.0
    for k in range(arms):
        # The last arm leans forward, so that the shade hangs clear of it.
        forward = (arms - 1 - k) % 2 == 0
        angle = -float(rng.uniform(0.3, 1.0)) if forward else float(rng.uniform(0.2, 0.7))
        next_lane = 0.013 * (1 if k % 2 == 0 else 0)
        arm = b.hinge("arm", parent, (1, 0, 0), here, -0.9, 0.9)
        start = 0.0035 if k == 0 else (lane + 0.0085 if next_lane > lane else lane - 0.0045)
        _bolt(arm, here, start, next_lane + 0.004, 0.008, joint_skin)
        length = float(rng.uniform(0.18, 0.3))
        direction = np.array([0.0, np.sin(angle), np.cos(angle)])
        end = here + length * direction
        shift = np.array([next_lane + 0.002, 0, 0])
        arm.add(_bar_between(here + shift, end + shift, 0.006), skin, "arm")
        eye = s.along(s.cylinder(0.011, 2 * half, segments=16), 0)
        arm.add(eye.moved(end + np.array([next_lane, 0, 0])), joint_skin, "eye")
        parent, here, lane = arm, end, next_lane
    head = b.hinge("head", parent, (1, 0, 0), here, -1.0, 0.2)
    _bolt(head, here, lane + 0.0085, lane + 0.016, 0.008, joint_skin)
    out = float(rng.uniform(0.045, 0.065))
    tip = here + np.array([lane + 0.014, 0, 0])
    head.add(_bar_between(tip, tip + np.array([0, -0.055, -0.005]), 0.005), joint_skin, "stem")
    shade = [
        (0.3 * out, 0.0),
        (0.5 * out, -0.35 * out),
        (out, -1.2 * out),
        (0.96 * out, -1.2 * out),
        (0.46 * out, -0.38 * out),
        (0.26 * out, -0.06 * out),
    ]
    head.add(s.lathe(shade, 28).moved(tip + np.array([0, -0.06, 0.004])), skin, "shade")
    bulb = s.sphere(0.38 * out, 16).moved(tip + np.array([0, -0.06, -0.6 * out]))
    head.add(bulb, plain("bulb", (250, 244, 220)), "bulb")
    if rng.random() < 0.5:
        at = (0, -0.62 * r, 0.0222)
        size = (0.014, 0.014, 0.004)
        surface = plain("switch", (40, 40, 44))
        controls.push_button(b, base, at, size, surface, face="up", round_=True, name="switch")
    return b.build()


def fan(rng: np.random.Generator) -> ProceduralObject:
    """A standing fan: head that turns and tips, rotor behind a cage, knob; or a ceiling fan."""
    if rng.random() < 0.3:
        return _ceiling_fan(rng)
    b = Builder("Fan", rng)
    skin = plain("fan", PLASTICS[rng.integers(len(PLASTICS))])
    dark = plain("dark", (50, 52, 56))
    base = b.base("fan_base")
    r = float(rng.uniform(0.14, 0.2))
    h = float(rng.uniform(0.2, 0.95))
    base.add(s.lathe([(0.8 * r, 0), (0.8 * r, 0.012), (0.2 * r, 0.03)], 32), skin, "foot")
    base.add(s.cylinder(0.014, h, segments=16).moved((0, 0, h / 2 + 0.01)), metal("steel"), "pole")
    z = h + 0.012
    yaw = b.hinge("neck", base, (0, 0, 1), (0, 0, z), -0.8, 0.8)
    at = (0, 0, z + 0.0208)
    yaw.add(s.cylinder(0.022, 0.04, segments=18, bevel=0.003).moved(at), dark, "neck")
    top = z + 0.04
    for side in (-1, 1):
        yaw.add(s.box((0.006, 0.024, 0.05), (side * 0.017, 0, top + 0.018), 0.002), dark, "fork")
    tilt_at = np.array([0, 0, top + 0.03])
    head = b.hinge("head", yaw, (1, 0, 0), tilt_at, -0.35, 0.35)
    head.add(s.box((0.0264, 0.016, 0.02), tilt_at, 0.002), skin, "lug")
    cz = top + 0.1
    at = (0, 0.04, cz)
    head.add(s.along(s.rounded_box((0.11, 0.11, 0.14), 0.05), 1).moved(at), skin, "motor")
    for radius, y in ((r, -0.055), (r, -0.115), (0.3 * r, -0.125)):
        profile = [
            (radius - 0.003, -0.003),
            (radius + 0.003, -0.003),
            (radius + 0.003, 0.003),
            (radius - 0.003, 0.003),
        ]
        hoop = s.ring(profile, 36)
        head.add(s.along(hoop, 1).moved((0, y, cz)), metal("steel"), "cage")
    for k in range(18):
        a = 2 * np.pi * k / 18
        u = np.array([np.cos(a), 0, np.sin(a)])
        path = np.stack(
            [
                0.045 * u + [0, -0.02, cz],
                r * u + [0, -0.055, cz],
                r * u + [0, -0.115, cz],
                0.3 * r * u + [0, -0.125, cz],
            ]
        )
        head.add(s.tube(path, 0.0018, 6), metal("steel"), "cage")
    rotor_at = (0, -0.075, cz)
    rotor = b.spin("rotor", head, (0, -1, 0), rotor_at)
    rotor.add(
        s.along(s.cylinder(0.028, 0.03, segments=20, bevel=0.004), 1).moved(rotor_at), dark, "hub"
    )
    add_blades(rotor, rotor_at, int(rng.integers(3, 6)), 0.02, 0.86 * r, 0.3 * r, skin, axis=1)
    if rng.random() < 0.6:
        controls.knob(
            b, head, (0, 0.05, cz + 0.056), (0.012, 0.02), (dark, skin), face="up", style=0
        )
    for k in range(int(rng.integers(0, 4))):
        at = ((k - 1) * 0.03, -0.5 * r, 0.022)
        controls.push_button(b, base, at, (0.016, 0.016, 0.005), dark, face="up")
    return b.build()


def add_blades(
    rotor: Body,
    at: tuple[float, float, float],
    count: int,
    inner: float,
    outer: float,
    width: float,
    surface: Surface,
    *,
    axis: int,
) -> None:
    """Pitched blades round a hub; ``axis`` is 1 where they blow forward, 2 on a ceiling."""
    for k in range(count):
        blade = s.rounded_box((width, outer - inner, 0.003), 0.45 * width, rim=0.001)
        blade = blade.turned((0, 1, 0), 0.38).moved((0, (outer + inner) / 2, 0))
        blade = blade.turned((0, 0, 1), 2 * np.pi * k / count)
        rotor.add(s.along(blade, axis).moved(at), surface, "blade")


def _ceiling_fan(rng: np.random.Generator) -> ProceduralObject:
    b = Builder("Fan", rng)
    skin, blade = _color(rng), wood(("oak", "walnut", "birch")[rng.integers(3)])
    base = b.base("fan_base")
    drop = float(rng.uniform(0.15, 0.35))
    z = 0.14
    profile = [(0.03, z + drop - 0.05), (0.07, z + drop), (0.07, z + drop + 0.005)]
    base.add(s.lathe(profile, 28), skin, "mount")
    base.add(s.cylinder(0.012, drop + 0.02, segments=14).moved((0, 0, z + drop / 2)), skin, "rod")
    offset = (0, 0, z + 0.005)
    base.add(s.cylinder(0.05, 0.03, segments=26, bevel=0.006).moved(offset), skin, "housing")
    at = (0.0, 0.0, z - 0.045)
    rotor = b.spin("rotor", base, (0, 0, 1), at)
    offset = (0, 0, z - 0.0418)
    rotor.add(s.cylinder(0.08, 0.06, segments=30, bevel=0.01).moved(offset), skin, "hub")
    count = int(rng.integers(3, 6))
    add_blades(rotor, at, count, 0.07, float(rng.uniform(0.4, 0.65)), 0.12, blade, axis=2)
    if rng.random() < 0.5:
        light = s.lathe([(0.06, 0.066), (0.07, 0.05), (0.05, 0.02), (0.0, 0.006)][::-1], 26)
        base.add(light, plain("bulb", (250, 244, 220)), "light")
        base.add(s.cylinder(0.006, 0.03, segments=8).moved((0, 0, 0.06)), skin, "rod")
    return b.build()


def globe(rng: np.random.Generator) -> ProceduralObject:
    """A globe that turns in a tilted arc, which may itself turn on its stand."""
    b = Builder("Globe", rng)
    skin = _color(rng) if rng.random() < 0.5 else wood(("walnut", "cherry")[rng.integers(2)])
    base = b.base("globe_base")
    r = float(rng.uniform(0.09, 0.17))
    h = float(rng.uniform(0.05, 0.12))
    profile = [(0.75 * r, 0), (0.75 * r, 0.01), (0.3 * r, 0.025), (0.14 * r, 0.04), (0.12 * r, h)]
    base.add(s.lathe(profile, 32), skin, "stand")
    ring_r = r + 0.016
    center = np.array([0, 0, h + ring_r + 0.008])
    tilt = float(rng.uniform(0.2, 0.45))
    arc_body = base
    if rng.random() < 0.4:
        arc_body = b.spin("circle", base, (0, 0, 1), (0, 0, h))
        at = (0, 0, h + 0.0066)
        arc_body.add(s.cylinder(0.016, 0.012, segments=18).moved(at), skin, "collar")
    whole = rng.random() < 0.4
    span = (
        np.linspace(-np.pi / 2, np.pi / 2, 22)
        if not whole
        else np.linspace(-np.pi / 2, 1.5 * np.pi, 41)[:-1]
    )
    path = (
        np.stack([ring_r * np.cos(span), 0 * span, ring_r * np.sin(span)], 1)
        @ s.rotation((0, 1, 0), tilt).T
    )
    if whole:
        loops = []
        for p in path / ring_r:
            side = np.array([0.0, 1.0, 0.0])
            corners = [(-0.004, -0.008), (0.004, -0.008), (0.004, 0.008), (-0.004, 0.008)]
            loops.append(np.stack([center + p * (ring_r + u) + v * side for u, v in corners]))
        arc_body.add(s.loft(loops, ring=True), metal("brass"), "arc")
    else:
        arc_body.add(s.sweep(path + center, s.rectangle(0.016, 0.008)), metal("brass"), "arc")
    axis = s.rotation((0, 1, 0), tilt) @ np.array([0.0, 0.0, 1.0])
    lowest = center + path[np.argmin(path[:, 2])]
    a = np.array([lowest[0] * 0.0, 0, h - 0.004])
    arc_body.add(
        _bar_between(a, np.array([lowest[0] * 0.3, 0, lowest[2] + 0.004]), 0.009), skin, "foot"
    )
    for sign in (-1, 1):
        tip = center + sign * axis * (r + 0.001)
        arc_body.add(
            _bar_between(tip, center + sign * axis * (ring_r + 0.012), 0.004), metal("brass"), "pin"
        )
    ball = b.spin("sphere", arc_body, axis, center)
    surface = pictured("globe", int(rng.integers(3)))
    ball.add(s.sphere(r, 36).turned((0, 1, 0), tilt).moved(center), surface, "sphere")
    return b.build()


def clock(rng: np.random.Generator) -> ProceduralObject:
    """A wall or table clock with two or three hands, perhaps a pendulum."""
    b = Builder("Clock", rng)
    skin = _color(rng) if rng.random() < 0.6 else wood(("oak", "walnut", "cherry")[rng.integers(3)])
    r, deep = float(rng.uniform(0.08, 0.18)), 0.035
    body = b.base("clock_body")
    pendulum = rng.random() < 0.3
    cz = r + 0.02 + (1.9 * r if pendulum else 0.0)
    if pendulum or rng.random() < 0.3:
        w = 2.3 * r
        size = (w, 0.012, cz + 1.15 * r)
        body.add(s.box(size, (0, deep / 2 - 0.006, (cz + 1.15 * r) / 2), 0.003), skin, "case")
        if pendulum:
            for side in (-1, 1):
                size = (0.02, deep, cz - r)
                body.add(s.box(size, (side * (w / 2 - 0.01), 0, (cz - r) / 2), 0.002), skin, "case")
            body.add(s.box((w, deep, 0.02), (0, 0, 0.01), 0.002), skin, "case")
    profile = [
        (0.94 * r, -deep / 2),
        (1.08 * r, -deep / 2),
        (1.08 * r, deep / 2 - 0.006),
        (1.0 * r, deep / 2),
        (0.94 * r, deep / 2 - 0.004),
    ]
    rim = s.ring(profile, 40)
    body.add(s.along(rim, 1).moved((0, 0, cz)), skin, "rim")
    body.add(
        s.along(s.cylinder(0.97 * r, 0.008, segments=40), 1).moved((0, deep / 2 - 0.016, cz)),
        pictured("clock"),
        "face",
    )
    front = deep / 2 - 0.0205
    hands = (("hand", 0.5, 0.016), ("hand", 0.78, 0.011), ("hand", 0.84, 0.004))[
        : int(rng.integers(2, 4))
    ]
    black = plain("hand", (26, 26, 30))
    for k, (name, length, wide) in enumerate(hands):
        y = front - 0.0015 - 0.0032 * k
        hand = b.spin(name, body, (0, -1, 0), (0, y, cz))
        angle = float(rng.random() * 6.28)
        bar = s.box((wide * r * 3, 0.0016, length * r), (0, 0, 0.4 * length * r), 0.0004)
        surface = black if k < 2 else plain("second", (190, 50, 44))
        hand.add(bar.turned((0, 1, 0), angle).moved((0, y, cz)), surface, "hand")
        hub = s.along(s.cylinder(0.05 * r, 0.0022, segments=16), 1)
        hand.add(hub.moved((0, y, cz)), black, "hub")
    if pendulum:
        at = (0, 0.0, cz - 1.12 * r)
        swing = b.hinge("pendulum", body, (0, 1, 0), at, -0.25, 0.25)
        length = 1.3 * r
        size = (0.008, 0.003, length)
        swing.add(s.box(size, (0, 0, at[2] - length / 2), 0.0005), metal("brass"), "rod")
        bob = s.along(s.cylinder(0.28 * r, 0.008, segments=26, bevel=0.003), 1)
        swing.add(bob.moved((0, 0, at[2] - length)), metal("brass"), "bob")
    return b.build()
