"""Things for one hand: Eyeglasses, Pen, Lighter, USB, Scissors, Pliers, Knife, Stapler."""

from __future__ import annotations

import numpy as np

from model.data.procedural import shapes as s
from model.data.procedural.grammar import Body, Builder, ProceduralObject
from model.data.procedural.materials import any_plastic, glass, metal, plain, wood


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
            (0.8 * r, 0),
            (r, 0.004),
            (r, length - cut),
            (0.78 * r, length - cut),
            (0.74 * r, length - 0.014),
            (0.2 * r, length),
        ]
        body.add(lay(s.lathe(profile, 20)), skin, "barrel")
        cap = b.slide("cap", body, (1, 0, 0), 0.0, float(rng.uniform(1.0, 1.4)) * cut, (0, 0, lift))
        z0, z1 = length - cut + 0.0008, length + 0.008
        profile = [
            (0.82 * r, z1 - 0.004),
            (0.86 * r, z0),
            (1.02 * r, z0),
            (1.02 * r, z1 - 0.003),
            (0.7 * r, z1),
        ]
        cap.add(lay(s.lathe(profile, 20)), accent if rng.random() < 0.5 else skin, "cap")
        clip = s.box((0.7 * cut, 0.0026, 0.0012), (z1 - 0.38 * cut, 0, lift + r + 0.0016), 0.0003)
        cap.add(clip, accent, "clip")
        size = (0.004, 0.0026, 0.0022)
        cap.add(s.box(size, (z1 - 0.05 * cut, 0, lift + r + 0.0007)), accent, "clip")
        return b.build()
    travel = 0.004
    profile = [
        (0.2 * r, length),
        (0.55 * r, length - 0.006),
        (r, length - 0.02),
        (r, 0.004),
        (0.8 * r, 0.0),
        (0.5 * r, 0.0),
        (0.5 * r, 0.02),
    ]
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
    w, length, t = map(float, rng.uniform((0.016, 0.032, 0.0085), (0.022, 0.045, 0.0105)))
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


def _flat(
    outline: list[tuple[float, float]], thickness: float, z: float, bevel: float = 0.0
) -> s.Solid:
    """A star-shaped outline lying flat, its middle at height z."""
    return s.slab(np.asarray(outline, np.float64), thickness, bevel=bevel).moved((0, 0, z))


def scissors(rng: np.random.Generator) -> ProceduralObject:
    """Two halves on a screw, lying flat, somewhat open."""
    b = Builder("Scissors", rng)
    grip, steel = any_plastic(rng), metal("steel")
    blade, back = float(rng.uniform(0.07, 0.12)), float(rng.uniform(0.05, 0.07))
    t = 0.0022
    opening = float(rng.uniform(0.5, 1.0))
    loop_r = (float(rng.uniform(0.013, 0.017)), float(rng.uniform(0.019, 0.027)))
    base = b.base("blade")
    halves = [base, b.hinge("blade", base, (0, 0, -1), (0, 0, 0), 0.0, opening)]
    lift = 0.007
    for k, half in enumerate(halves):
        sign = 1 if k == 0 else -1
        z = lift + (t / 2 + 0.0002) * sign
        edge = [
            (-0.004, -0.008 * sign),
            (0.02, -0.0075 * sign),
            (blade, 0.0005 * sign),
            (0.02, 0.0055 * sign),
            (-0.004, 0.006 * sign),
        ]
        half.add(_flat(edge, t, z), steel, "blade")
        # The shank crosses to the other side behind the screw.
        y = -(loop_r[k] + 0.006) * sign
        path = np.array(
            [(0.004, -0.001 * sign, z), (-0.4 * back, 0.35 * y, z), (-back, 0.75 * y, z)]
        )
        half.add(s.sweep(path, s.rectangle(0.011, t)), steel, "shank")
        profile = [
            (loop_r[k] - 0.0045, -0.003),
            (loop_r[k], -0.004),
            (loop_r[k] + 0.0015, 0),
            (loop_r[k], 0.004),
            (loop_r[k] - 0.0045, 0.003),
        ]
        ring = s.ring(profile, 28)
        stretch = float(rng.uniform(1.0, 1.5))
        at = (-back - loop_r[k] * stretch * 0.9, y, lift + 0.0002 * sign)
        half.add(ring.scaled((stretch, 1, 1)).moved(at), grip, "handle")
    at = (0, 0, lift + t + 0.001)
    halves[0].add(s.cylinder(0.0045, 0.002, segments=18, bevel=0.0004).moved(at), steel, "pivot")
    rest = float(rng.uniform(0.2, 0.8)) * opening
    made = b.build({"link_1": rest})
    return made


def pliers(rng: np.random.Generator) -> ProceduralObject:
    """Two halves with jaws and sleeves on a rivet, lying flat."""
    b = Builder("Pliers", rng)
    sleeve, steel = any_plastic(rng), metal("dark") if rng.random() < 0.5 else metal("steel")
    jaw, back = float(rng.uniform(0.035, 0.08)), float(rng.uniform(0.09, 0.13))
    t, lift = 0.005, 0.009
    opening = float(rng.uniform(0.35, 0.7))
    base = b.base("pliers_body")
    halves = [base, b.hinge("leg", base, (0, 0, -1), (0, 0, 0), 0.0, opening)]
    for k, half in enumerate(halves):
        sign = 1 if k == 0 else -1
        z = lift + (t / 2 + 0.0002) * sign
        half.add(s.cylinder(0.011, t, segments=24).moved((0, 0, z)), steel, "joint")
        # Jaws lie on their own side of the middle line (y), handles on the other.
        tip = [
            (0.006, 0.0005 * sign),
            (jaw, 0.0005 * sign),
            (jaw, 0.004 * sign),
            (0.006, 0.0105 * sign),
        ]
        half.add(_flat(tip, 2 * t, lift), steel, "jaw")
        bend = np.array(
            [
                (-0.004, 0, z),
                (-0.3 * back, -0.011 * sign, z),
                (-0.65 * back, -0.024 * sign, z),
                (-back, -0.021 * sign, z),
            ]
        )
        half.add(s.sweep(bend, s.rectangle(0.009, t)), steel, "shank")
        end = bend[-1] + np.array([-0.008, 0.001 * sign, 0])
        cover = np.vstack([bend[0] * 0.35 + bend[1] * 0.65, bend[1:], end])
        half.add(s.sweep(cover, s.rectangle(0.014, 2.6 * t * 0.72, 0.003, 2)), sleeve, "sleeve")
    at = (0, 0, lift + t + 0.001)
    halves[0].add(s.cylinder(0.005, 0.002, segments=18, bevel=0.0004).moved(at), steel, "rivet")
    return b.build({"link_1": float(rng.uniform(0.1, 0.8)) * opening})


def knife(rng: np.random.Generator) -> ProceduralObject:
    """A cutter whose blade slides, or a pocket knife whose blades fold out."""
    b = Builder("Knife", rng)
    skin = any_plastic(rng) if rng.random() < 0.7 else wood("walnut")
    steel = metal("steel")
    length, width = float(rng.uniform(0.09, 0.14)), float(rng.uniform(0.016, 0.024))
    body = b.base("knife_body")
    gap, wall = 0.0034, 0.004
    z0 = wall + 0.0005
    for z in (wall / 2, wall + gap + wall / 2):
        size = (length, width, wall)
        body.add(s.rounded_box(size, 0.3 * width, rim=0.0012).moved((0, 0, z)), skin, "scale")
    if rng.random() < 0.5:
        for y in (-1, 1):
            size = (0.96 * length - 0.3 * width, 0.0022, gap + 0.001)
            body.add(s.box(size, (0, y * (width / 2 - 0.0013), wall + gap / 2)), skin, "rail")
        out = float(rng.uniform(0.0, 0.3)) * length
        reach = 0.75 * length
        blade = b.slide("translation_blade", body, (1, 0, 0), 0.0, 0.7 * length, (0, 0, z0))
        w = width - 0.0068
        edge = [(0, -w / 2), (reach, -w / 2), (reach - 0.8 * w, w / 2), (0, w / 2)]
        solid = _flat(edge, 0.0012, wall + gap / 2).moved((length / 2 - reach + 0.004, 0, 0))
        blade.add(solid, steel, "blade")
        return b.build({blade.link: out} if out > 0.002 else None)
    size = (0.8 * length, 0.0025, gap + 0.001)
    body.add(s.box(size, (0, -width / 2 + 0.0022, wall + gap / 2)), metal("dark"), "spring")
    count = int(rng.integers(1, 3))
    rest = {}
    ends = [1, -1][:count]
    for side in ends:
        pin = np.array([side * (length / 2 - 0.007), 0.002, wall + gap / 2])
        blade = b.hinge("rotation_blade", body, (0, 0, -side), pin, 0.0, np.pi)
        reach = 0.8 * length if count == 1 else 0.78 * length
        layer = 0.0 if count == 1 else side * 0.0008
        w = 0.55 * width
        edge = np.array(
            [
                (-0.004, -w * 0.45),
                (0.01, -w * 0.5),
                (0.7 * reach, -w * 0.5),
                (reach, w * 0.2),
                (0.7 * reach, w * 0.5),
                (-0.004, w * 0.4),
            ]
        )
        edge = edge * [-side, 1]
        solid = s.slab(edge, 0.0012).moved(pin + np.array([0, 0.18 * width, layer]))
        blade.add(solid, steel, "blade")
        rest[blade.link] = float(rng.uniform(0.4, np.pi))
        if rng.random() < 0.3:
            del rest[blade.link]
    return b.build(rest)


def stapler(rng: np.random.Generator) -> ProceduralObject:
    """A base, a magazine and a lever on one hinge."""
    b = Builder("Stapler", rng)
    skin, dark = any_plastic(rng), plain("dark", (44, 46, 50))
    length, w = float(rng.uniform(0.11, 0.17)), float(rng.uniform(0.026, 0.036))
    base = b.base("stapler_base")
    size = (w, length, 0.007)
    base.add(s.rounded_box(size, 0.009, rim=0.002).moved((0, 0, 0.0035)), dark, "base")
    base.add(s.box((0.5 * w, 0.02, 0.0012), (0, -0.4 * length, 0.0072)), metal("steel"), "anvil")
    y, z = 0.42 * length, 0.022
    for side in (-1, 1):
        size = (0.0022, 0.026, 0.024)
        base.add(s.box(size, (side * (w / 2 - 0.0012), y, 0.0175), 0.0006), dark, "ear")
    at = (0.0, y, z)
    angle = float(rng.uniform(0.05, 0.18))

    def arm(name: str, parent: Body, upper: float) -> Body:
        return b.hinge(name, parent, (-1, 0, 0), at, -angle, upper)

    magazine = arm("magazine", base, 1.2)
    inner = w - 0.0075
    reach = 0.88 * length
    tilt = lambda solid: solid.turned((1, 0, 0), -angle, at)  # noqa: E731
    bar = s.box((inner, reach, 0.009), (0, y - reach / 2 + 0.008, z - 0.003), 0.001)
    magazine.add(tilt(bar), metal("steel"), "magazine")
    lever = b.hinge("stapler_body", magazine, (-1, 0, 0), at, -0.06, 1.0)
    top = s.rounded_box((w - 0.0065, reach + 0.004, 0.014), 0.008, rim=0.004)

    def arch(v: np.ndarray) -> np.ndarray:
        v[:, 2] += 0.006 * np.cos(v[:, 1] / reach * 2.4)
        return v

    offset = (0, y - reach / 2 + 0.006, z + 0.0125)
    lever.add(tilt(tilt(top.shaped(arch).moved(offset))), skin, "lever")
    return b.build()
