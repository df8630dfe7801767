"""Eyeglasses, Pen, Lighter, USB."""

from __future__ import annotations

import numpy as np

from model.data.procedural import shapes as s
from model.data.procedural.grammar import Builder, ProceduralObject
from model.data.procedural.materials import any_plastic, glass, metal, plain


def eyeglasses(rng: np.random.Generator) -> ProceduralObject:
    """A frame with two lenses and two temples that fold."""
    b = Builder("Eyeglasses", rng)
    skin = (
        any_plastic(rng)
        if rng.random() < 0.6
        else metal(("black", "brass", "steel")[rng.integers(3)])
    )
    front = b.base("glasses_body")
    lens_w, lens_h = float(rng.uniform(0.045, 0.055)), float(rng.uniform(0.03, 0.046))
    bridge, t = float(rng.uniform(0.014, 0.022)), float(rng.uniform(0.002, 0.0045))
    z = lens_h / 2 + t + 0.001
    tint = glass((70, 76, 84), 200) if rng.random() < 0.4 else glass((200, 214, 220), 90)
    power = float(rng.uniform(2.0, 4.0))
    a = np.arange(36) * 2 * np.pi / 36
    shape = np.stack(
        [
            np.sign(np.cos(a)) * np.abs(np.cos(a)) ** (2 / power),
            np.sign(np.sin(a)) * np.abs(np.sin(a)) ** (2 / power),
        ],
        1,
    )
    for side in (-1, 1):
        x = side * (lens_w + bridge) / 2
        inner = shape * [lens_w / 2, lens_h / 2]
        outer = shape * [lens_w / 2 + t, lens_h / 2 + t]
        half = 0.7 * t
        loops = [s.at(outer, half), s.at(outer, -half), s.at(inner, -half), s.at(inner, half)]
        rim = s.loft(loops, ring=True)
        front.add(s.along(rim, 1).moved((x, 0, z)), skin, "rim")
        front.add(s.slab(inner * 1.01, 0.0012, axis=1).moved((x, 0, z)), tint, "lens")
    arch = np.array(
        [
            (-bridge / 2 - 0.001, 0, z + 0.1 * lens_h),
            (0, 0, z + 0.22 * lens_h),
            (bridge / 2 + 0.001, 0, z + 0.1 * lens_h),
        ]
    )
    front.add(s.tube(arch, 0.5 * t + 0.0008, 10), skin, "bridge")
    edge = lens_w + bridge / 2 + t
    hz = z + 0.22 * lens_h
    length = float(rng.uniform(0.125, 0.145))
    for k, side in enumerate((-1, 1)):
        x = side * (edge + 0.003)
        size = (0.012, 0.006, 0.007)
        front.add(s.box(size, (side * (edge - 0.001), 0.0005, hz), 0.001), skin, "lug")
        # One temple folds onto the other: its hinge stands a little further back.
        back = 0.005 + 0.006 * k
        front.add(s.box((0.004, back + 0.001, 0.006), (x, back / 2 + 0.001, hz)), skin, "lug")
        at = (x, back + 0.0042, hz)
        temple = b.hinge("leg", front, (0, 0, 1 if side > 0 else -1), at, 0.0, 1.5)
        path = s.bent_path(
            [(x, at[1] - 0.001, hz), (x, 0.7 * length, hz), (x - side * 0.004, length, hz - 0.03)],
            0.03,
        )
        temple.add(s.sweep(path, s.rectangle(0.0028, 0.0055, 0.0008)), skin, "temple")
    return b.build()


def pen(rng: np.random.Generator) -> ProceduralObject:
    """A pen with a cap that pulls off, or a button that clicks."""
    b = Builder("Pen", rng)
    skin = any_plastic(rng) if rng.random() < 0.7 else metal("steel")
    accent = metal(("steel", "brass", "black")[rng.integers(3)])
    r, length = float(rng.uniform(0.0042, 0.007)), float(rng.uniform(0.1, 0.13))
    body = b.base("pen_body")
    lift = r + 0.0025
    lay = lambda solid: s.along(solid, 0).moved((0, 0, lift))  # noqa: E731
    if rng.random() < 0.5:
        cut = 0.42 * length
        profile = [
            (0.8 * r, 0), (r, 0.004), (r, length - cut), (0.78 * r, length - cut),
            (0.74 * r, length - 0.014), (0.2 * r, length),
        ]  # fmt: skip
        body.add(lay(s.lathe(profile, 20)), skin, "barrel")
        cap = b.slide("cap", body, (1, 0, 0), 0.0, float(rng.uniform(1.0, 1.4)) * cut, (0, 0, lift))
        z0, z1 = length - cut + 0.0008, length + 0.008
        profile = [
            (0.82 * r, z1 - 0.004), (0.86 * r, z0), (1.02 * r, z0), (1.02 * r, z1 - 0.003),
            (0.7 * r, z1),
        ]  # fmt: skip
        cap.add(lay(s.lathe(profile, 20)), accent if rng.random() < 0.5 else skin, "cap")
        clip = s.box((0.7 * cut, 0.0026, 0.0012), (z1 - 0.38 * cut, 0, lift + r + 0.0016), 0.0003)
        cap.add(clip, accent, "clip")
        size = (0.004, 0.0026, 0.0022)
        cap.add(s.box(size, (z1 - 0.05 * cut, 0, lift + r + 0.0007)), accent, "clip")
        return b.build()
    travel = 0.004
    profile = [
        (0.2 * r, length), (0.55 * r, length - 0.006), (r, length - 0.02), (r, 0.004),
        (0.8 * r, 0.0), (0.5 * r, 0.0), (0.5 * r, 0.02),
    ]  # fmt: skip
    body.add(lay(s.lathe(profile, 20)), skin, "barrel")
    button = b.slide("button", body, (1, 0, 0), 0.0, travel, (0, 0, lift))
    button.add(
        lay(s.cylinder(0.45 * r, 0.016, segments=14, bevel=0.0005).moved((0, 0, -0.0005))),
        accent,
        "button",
    )
    clip = s.box((0.3 * length, 0.0026, 0.0012), (0.2 * length, 0, lift + r + 0.0016), 0.0003)
    body.add(clip, accent, "clip")
    body.add(s.box((0.004, 0.0026, 0.0022), (0.06 * length, 0, lift + r + 0.0007)), accent, "clip")
    return b.build()


def lighter(rng: np.random.Generator) -> ProceduralObject:
    """A flip-top lighter with a wheel, or one with a button."""
    b = Builder("Lighter", rng)
    skin = (
        metal(("steel", "brass", "dark")[rng.integers(3)])
        if rng.random() < 0.5
        else any_plastic(rng)
    )
    w, d, h = (float(v) for v in rng.uniform((0.03, 0.011, 0.05), (0.04, 0.015, 0.07)))
    body = b.base("lighter_body")
    cut = float(rng.uniform(0.55, 0.68)) * h
    body.add(s.rounded_box((w, d, cut), 0.003, rim=0.001).moved((0, 0, cut / 2)), skin, "case")
    chimney = 0.42 * w
    size = (chimney, 0.6 * d, 0.011)
    body.add(s.box(size, (0.08 * w, 0, cut + 0.005), 0.001), metal("steel"), "chimney")
    at = (-0.24 * w, 0, cut + 0.006)
    wheel = b.spin("wheel", body, (0, 1, 0), at)
    height = 0.5 * d
    wheel.add(s.along(s.cylinder(0.0034, height, segments=16), 1).moved(at), metal("dark"), "wheel")
    if rng.random() < 0.65:
        top = h - cut - 0.0006
        origin = (w / 2 + 0.0004, 0, cut + 0.0003)
        lid = b.hinge("lid", body, (0, 1, 0), origin, 0.0, float(rng.uniform(1.8, 2.4)))
        shell = s.tray((w, d, top), 0.0008, radius=0.003).scaled((1, 1, -1))
        lid.add(shell.moved((0, 0, cut + 0.0006 + top)), skin, "lid")
        offset = (w / 2 + 0.0014, 0, cut + 0.0003)
        surface = metal("steel")
        lid.add(
            s.along(s.cylinder(0.0011, 0.6 * d, segments=10), 1).moved(offset), surface, "hinge"
        )
        return b.build({lid.link: float(rng.uniform(0.6, 1.8))} if rng.random() < 0.5 else None)
    button = b.slide("button", body, (0, 0, -1), 0.0, 0.003, (-0.42 * w, 0, cut))
    size = (0.12 * w, 0.7 * d, 0.005)
    center = (-0.43 * w, 0, cut + 0.0032)
    button.add(s.box(size, center, 0.0008), plain("button", (190, 50, 44)), "button")
    return b.build()


def usb(rng: np.random.Generator) -> ProceduralObject:
    """A stick with a cap, a swivelling cover, or a plug that slides out."""
    b = Builder("USB", rng)
    skin = any_plastic(rng)
    w, length, t = (
        float(rng.uniform(0.016, 0.022)),
        float(rng.uniform(0.032, 0.045)),
        float(rng.uniform(0.0085, 0.0105)),
    )
    plug = (0.012, 0.0118, 0.0045)
    lift = t / 2 + 0.002
    body = b.base("usb_body")
    kind = ("cap", "swivel", "slide")[rng.integers(3)]
    if kind == "slide":
        shell = s.frame((w, t), (plug[0] + 0.001, plug[2] + 0.001), length)
        body.add(shell.moved((0, 0, lift)), skin, "case")
        stick = b.slide("usb_rotation", body, (0, -1, 0), 0.0, 0.0118, (0, 0, lift))
        size = (plug[0], 0.7 * length, plug[2])
        stick.add(s.box(size, (0, -0.13 * length, lift), 0.0004), metal("steel"), "plug")
        return b.build()
    body.add(s.rounded_box((w, length, t), 0.003, rim=0.0015).moved((0, 0, lift)), skin, "case")
    front = -length / 2
    body.add(s.box(plug, (0, front - plug[1] / 2 + 0.0004, lift), 0.0004), metal("steel"), "plug")
    if kind == "cap":
        upper = 0.014 + float(rng.uniform(0.0, 0.02))
        cap = b.slide("lid", body, (0, -1, 0), 0.0, upper, (0, front, lift))
        tube = s.tray((w, t, 0.015), 0.001, radius=0.002).turned((1, 0, 0), -np.pi / 2)
        low, high = tube.bounds
        at = (0, front - 0.0006 - high[1], lift - (low[2] + high[2]) / 2)
        cap.add(tube.moved(at), skin, "cap")
        return b.build()
    pin = np.array([0, length / 2 - 0.5 * w, 0])
    cover = (
        b.spin("rotation", body, (0, 0, 1), pin + [0, 0, lift])
        if rng.random() < 0.5
        else b.hinge("rotation", body, (0, 0, 1), pin + [0, 0, lift], -np.pi, np.pi)
    )
    steel = metal("steel")
    far = front - plug[1] - 0.002
    near = pin[1] + 0.5 * w - 0.001
    for z in (lift - t / 2 - 0.0011, lift + t / 2 + 0.0011):
        cover.add(s.box((w, near - far, 0.001), (0, (near + far) / 2, z), 0.0002), steel, "cover")
    # The bridge passes outside the circle that the stick's corners sweep.
    cover.add(s.box((w, 0.001, t + 0.0032), (0, far - 0.0004, lift)), steel, "cover")
    return b.build()
