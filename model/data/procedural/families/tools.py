"""Scissors, Pliers, Knife, Stapler: tools for one hand."""

from __future__ import annotations

import numpy as np

from model.data.procedural import shapes as s
from model.data.procedural.grammar import Body, Builder, ProceduralObject
from model.data.procedural.materials import any_plastic, metal, plain, wood


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
            (-0.004, -0.008 * sign), (0.02, -0.0075 * sign), (blade, 0.0005 * sign),
            (0.02, 0.0055 * sign), (-0.004, 0.006 * sign),
        ]  # fmt: skip
        half.add(_flat(edge, t, z), steel, "blade")
        # The shank crosses to the other side behind the screw.
        y = -(loop_r[k] + 0.006) * sign
        path = np.array(
            [(0.004, -0.001 * sign, z), (-0.4 * back, 0.35 * y, z), (-back, 0.75 * y, z)]
        )
        half.add(s.sweep(path, s.rectangle(0.011, t)), steel, "shank")
        profile = [
            (loop_r[k] - 0.0045, -0.003), (loop_r[k], -0.004), (loop_r[k] + 0.0015, 0),
            (loop_r[k], 0.004), (loop_r[k] - 0.0045, 0.003),
        ]  # fmt: skip
        ring = s.ring(profile, 28)
        stretch = float(rng.uniform(1.0, 1.5))
        at = (-back - loop_r[k] * stretch * 0.9, y, lift + 0.0002 * sign)
        half.add(ring.scaled((stretch, 1, 1)).moved(at), grip, "handle")
    at = (0, 0, lift + t + 0.001)
    halves[0].add(s.cylinder(0.0045, 0.002, segments=18, bevel=0.0004).moved(at), steel, "screw")
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
            (0.006, 0.0005 * sign), (jaw, 0.0005 * sign), (jaw, 0.004 * sign),
            (0.006, 0.0105 * sign),
        ]  # fmt: skip
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
