"""Assemblies with round or free forms: bottles, pots, faucets, scissors, chairs, composites."""

from __future__ import annotations

import numpy as np

from model.data.simulated.primitives import Builder, ball, block, lathe, ring, rod, tube, turned


def _profile(b: Builder, radius: float, height: float, wall: float) -> list[tuple[float, float]]:
    """An open vessel with an inside."""
    n = int(b.rng.integers(2, 6))
    z = np.linspace(0, height, n + 1)
    r = radius * np.clip(1 + b.rng.normal(0, 0.12, n + 1), 0.6, 1.3)
    outside = [(0.0, 0.0), *zip(r, z, strict=True)]
    inside = [(max(a - wall, wall), max(h, wall)) for a, h in outside[1:]][::-1]
    return [*outside, *inside, (0.0, wall)]


def vessel(b: Builder) -> None:
    """Pot, kettle, jar, bucket: body, handles, lid with a knob."""
    radius, height = b.uniform(0.03, 0.18), b.uniform(0.04, 0.3)
    wall = b.uniform(0.03, 0.08) * radius
    profile = _profile(b, radius, height, wall)
    rim = max(r for r, z in profile if abs(z - height) < 1e-9)
    b.add(0, lathe(profile))
    metal = b.color(0.4)
    kind = b.rng.integers(4)
    if kind == 0:
        for s in (-1, 1):
            turn = np.linspace(0, np.pi, 12)[:, None]
            path = np.array([s * rim * 0.97, 0, height * 0.75]) + (
                np.cos(turn) * [0, 0.3 * radius, 0] + np.sin(turn) * [s * 0.4 * radius, 0, 0]
            )
            b.add(0, tube(path, 0.06 * radius), metal)
    elif kind == 1:
        b.add(
            0,
            rod(
                (rim * 0.9, 0, height * 0.8),
                (rim * 0.9 + 2 * radius, 0, height * 0.9),
                0.1 * radius,
            ),
            metal,
        )
    elif kind == 2:
        part = b.new_part() if b.chance(0.6) else 0
        turn = np.linspace(0, np.pi, 24)[:, None]
        path = np.array([0, 0, height * 0.9]) + (
            np.cos(turn) * [rim * 1.02, 0, 0] + np.sin(turn) * [0, 0, 1.2 * radius]
        )
        b.add(
            part,
            turned(
                tube(path, 0.04 * radius), (1, 0, 0), b.uniform(-1.2, 1.2), (0, 0, height * 0.9)
            ),
            metal,
        )
    if b.chance(0.85):
        part = b.new_part()
        lift = b.uniform(0, 0.02) if b.chance(0.7) else b.uniform(0.05, 0.4) * height
        z = height + 0.001 + lift
        angle = np.linspace(0.05, np.pi / 2, 10)
        dome = b.uniform(0.05, 0.4) * radius
        lid = [(0, z - 0.002), (rim * 0.95, z - 0.002), (rim * 1.02, z), (rim * 1.02, z + wall)]
        lid += [(rim * 0.97 * np.cos(a), z + wall + dome * np.sin(a)) for a in angle]
        color = b.color(0.6)
        b.add(part, lathe([*lid, (0, lid[-1][1])]), color)
        top = z + wall + dome
        if b.chance(0.8):
            b.add(part, rod((0, 0, top - 0.01), (0, 0, top + 0.15 * radius), 0.08 * radius), metal)
            b.add(part, ball((0, 0, top + 0.22 * radius), 0.14 * radius), metal)


def bottle(b: Builder) -> None:
    """Bottle with a cap, perhaps a pump."""
    radius, height = b.uniform(0.02, 0.06), b.uniform(0.1, 0.3)
    neck = b.uniform(0.2, 0.6) * radius
    z0 = height * b.uniform(0.6, 0.85)
    glass = [(radius, 0), (radius, z0), (neck, z0 + 0.08 * height), (neck, height)]
    b.add(0, lathe([(0, 0), *glass, (0, height)]))
    if b.chance(0.4):
        b.add(0, lathe([(radius * 1.005, 0.2 * z0), (radius * 1.005, 0.7 * z0)]), b.palette[3])
    part = b.new_part()
    cap = neck * b.uniform(1.02, 1.4)
    low = height * b.uniform(0.9, 0.97)
    color = b.color(0.3)
    top = height + b.uniform(0.01, 0.05)
    b.add(part, lathe([(0, low), (cap, low), (cap * b.uniform(0.8, 1), top), (0, top)]), color)
    if b.chance(0.3):
        b.add(part, rod((0, 0, top), (0, 0, top + 0.03), 0.3 * cap), color)
        b.add(part, rod((0, 0, top + 0.03), (radius * 1.3, 0, top + 0.025), 0.3 * cap), color)


def faucet(b: Builder) -> None:
    """Column, bent spout, one or two levers or wheels."""
    s = b.uniform(0.6, 1.4)
    b.add(0, rod((0, 0, 0), (0, 0, 0.012 * s), 0.03 * s))
    b.add(0, rod((0, 0, 0), (0, 0, 0.09 * s), 0.02 * s))
    part = b.new_part() if b.chance(0.7) else 0
    turn = np.linspace(0, np.pi * b.uniform(0.6, 1.05), 20)[:, None]
    reach = b.uniform(0.04, 0.09) * s
    rise = b.uniform(0.12, 0.25) * s
    arc = np.array([0, -reach, rise]) + np.cos(turn) * [0, reach, 0] + np.sin(turn) * [0, 0, reach]
    b.add(part, tube(np.concatenate([[[0, 0, 0.092 * s]], arc]), 0.012 * s), b.color(0.7))
    sides = [(-1, 0), (1, 0)] if b.chance(0.5) else [(1, 0)]
    for x, _ in sides:
        lever = b.new_part()
        color = b.color(0.6)
        b.add(0, rod((x * 0.01 * s, 0, 0.05 * s), (x * 0.035 * s, 0, 0.05 * s), 0.013 * s))
        b.add(
            lever, rod((x * 0.036 * s, 0, 0.05 * s), (x * 0.056 * s, 0, 0.05 * s), 0.015 * s), color
        )
        if b.chance(0.6):
            end = (
                x * b.uniform(0.07, 0.12) * s,
                b.uniform(-0.04, 0.02) * s,
                b.uniform(0.05, 0.12) * s,
            )
            b.add(lever, rod((x * 0.046 * s, 0, 0.05 * s), end, 0.005 * s), color)
        else:
            for a in np.arange(4) * np.pi / 2:
                spoke = 0.03 * s * np.array([0, np.cos(a), np.sin(a)])
                hub = np.array([x * 0.05 * s, 0, 0.05 * s])
                b.add(lever, rod(hub, hub + spoke, 0.006 * s), color)


def blades(b: Builder) -> None:
    """Scissors, pliers, folding knife, stapler: two or three long bodies on one pin."""
    length, width, thick = b.uniform(0.08, 0.2), b.uniform(0.01, 0.025), b.uniform(0.002, 0.01)
    crossed = b.chance(0.6)
    grip = b.color(0.3)
    for i in range(2):
        part = 0 if i == 0 else b.new_part()
        start = len(b.solids)
        z = i * thick * 1.02
        b.add(
            part,
            block((-width / 2, 0, z), (width / 2, length, z + thick), thick * 0.3),
            b.palette[1],
        )
        if crossed:
            b.add(
                part, block((-width / 2, -0.5 * length, z), (width / 2, 0, z + thick)), b.palette[1]
            )
            if b.chance(0.7):
                side = width if i else -width
                b.add(
                    part,
                    ring((side, -0.65 * length, z + thick / 2), (0, 0, 1), 0.18 * length, thick),
                    grip,
                )
        elif i == 0 or b.chance(0.5):
            b.add(
                part,
                block(
                    (-width * 0.6, 0, z + (0.1 if i == 0 else 1) * thick),
                    (width * 0.6, length * 0.8, z + thick * (0.9 if i == 0 else 1.8)),
                ),
                grip,
            )
        open_by = (1 if i else -1) * b.uniform(0.05, 0.6) if crossed else i * b.uniform(0.1, 2.8)
        axis = (0, 0, 1) if crossed or b.chance(0.5) else (1, 0, 0)
        b.turn_since(start, axis, open_by, (0, 0, thick))
    b.add(0, rod((0, 0, -0.3 * thick), (0, 0, 2.3 * thick), 0.25 * width), b.palette[3])


def eyeglasses(b: Builder) -> None:
    """Two rims and a bridge, two temples."""
    r, t = b.uniform(0.018, 0.028), b.uniform(0.001, 0.003)
    color = b.color(0.8)
    for s in (-1, 1):
        b.add(0, ring((s * 1.25 * r, 0, 0), (0, 1, 0), r, t), color)
        if b.chance(0.7):
            b.add(0, rod((s * 1.25 * r, -t / 3, 0), (s * 1.25 * r, t / 3, 0), r), b.palette[1])
        part = b.new_part()
        start = len(b.solids)
        bend = np.array([[0, 0, 0], [0, 0.1, 0], [0, 0.12, -0.01], [0, 0.14, -0.035]])
        b.add(part, tube(bend + [s * 2.3 * r, 0.002, 0.3 * r], 1.2 * t), color)
        if b.chance(0.5):
            b.turn_since(start, (0, 0, s), b.uniform(0, 1.4), (s * 2.3 * r, 0, 0))
    b.add(0, rod((-0.3 * r, 0, 0.2 * r), (0.3 * r, 0, 0.2 * r), t), color)


def wheel(b: Builder, at, axis, radius: float, part: int) -> None:
    """A tyre with a hub, perhaps spokes."""
    p, a = np.asarray(at, float), np.asarray(axis, float)
    half = a * radius * b.uniform(0.15, 0.4)
    if b.chance(0.6):
        b.add(part, rod(p - half, p + half, radius), b.palette[1])
        b.add(part, rod(p - 1.1 * half, p + 1.1 * half, 0.5 * radius), b.palette[2])
    else:
        b.add(part, ring(p, a, radius * 0.85, radius * 0.15), b.palette[1])
        b.add(part, rod(p - half, p + half, 0.2 * radius), b.palette[2])
        u = np.cross(a, (0.3, 0.5, 0.8))
        u /= np.linalg.norm(u)
        for k in range(5):
            spoke = np.cos(k * 1.257) * u + np.sin(k * 1.257) * np.cross(a, u)
            b.add(part, rod(p, p + 0.8 * radius * spoke, 0.06 * radius), b.palette[2])


def chair(b: Builder) -> None:
    """Seat, back, arms; legs or a column on a star with castors."""
    w, h = b.uniform(0.4, 0.6), b.uniform(0.4, 0.5)
    swivel = b.chance(0.7)
    seat = b.new_part() if swivel else 0
    color = b.color(0.5)
    b.add(seat, block((-w / 2, -w / 2, h), (w / 2, w / 2, h + 0.06), 0.02), color)
    b.add(seat, block((-w / 2, w / 2 - 0.05, h + 0.1), (w / 2, w / 2, h + 0.6), 0.02), color)
    b.add(seat, rod((0, w / 2 - 0.03, h), (0, w / 2 - 0.03, h + 0.2), 0.02), b.palette[1])
    if b.chance(0.6):
        for s in (-1, 1):
            b.add(seat, rod((s * w / 2, 0, h), (s * w / 2, 0, h + 0.2), 0.015), b.palette[1])
            b.add(
                seat, block((s * w / 2 - 0.03, -0.15, h + 0.2), (s * w / 2 + 0.03, 0.15, h + 0.23))
            )
    if not swivel:
        for x in (-0.9, 0.9):
            for y in (-0.9, 0.9):
                b.add(0, rod((x * w / 2, y * w / 2, 0), (x * w / 2, y * w / 2, h), 0.02))
        return
    b.add(0, rod((0, 0, 0.12), (0, 0, h), 0.025), b.palette[1])
    for k in range(5):
        out = np.array([np.cos(k * 1.257), np.sin(k * 1.257), 0])
        b.add(0, rod((0, 0, 0.13), 0.3 * out + (0, 0, 0.1), 0.02), b.palette[1])
        castor = b.new_part()
        wheel(b, 0.3 * out + (0, 0, 0.035), np.cross(out, (0, 0, 1)), 0.035, castor)


def cart(b: Builder) -> None:
    """Platform or basket with a push bar and wheels, each a part."""
    w, d, z = b.uniform(0.3, 0.7), b.uniform(0.5, 1.0), b.uniform(0.12, 0.3)
    b.add(0, block((0, 0, z), (w, d, z + 0.04)))
    if b.chance(0.5):
        for low, high in (
            ((0, 0, z), (0.01, d, z + 0.4)),
            ((w - 0.01, 0, z), (w, d, z + 0.4)),
            ((0, d - 0.01, z), (w, d, z + 0.4)),
        ):
            b.add(0, block(low, high), b.palette[2])
    for x in (0.05 * w, 0.95 * w):
        b.add(0, rod((x, 0.02, z), (x, -0.1, z + 0.7), 0.012), b.palette[1])
    b.add(0, rod((0.05 * w, -0.1, z + 0.7), (0.95 * w, -0.1, z + 0.7), 0.015), b.palette[3])
    radius = 0.4 * z
    for x in (0.1 * w, 0.9 * w):
        for y in (0.1 * d, 0.9 * d):
            b.add(0, rod((x, y, z), (x, y, 2 * radius), 0.015), b.palette[1])
            wheel(b, (x, y, radius), (1, 0, 0), radius, b.new_part())


def device(b: Builder) -> None:
    """Camera, speaker, coffee machine: a body with stacked round and square outgrowths."""
    w, d, h = b.uniform(0.08, 0.4), b.uniform(0.05, 0.3), b.uniform(0.05, 0.4)
    b.add(0, block((0, 0, 0), (w, d, h), b.uniform(0, 0.1) * min(w, d, h)))
    radius = b.uniform(0.2, 0.4) * min(w, h)
    at = np.array([w * b.uniform(0.3, 0.7), 0, h * 0.5])
    y = 0.0
    for k in range(int(b.rng.integers(1, 4))):
        part = b.new_part() if b.chance(0.6) else (b.parts - 1 if k else 0)
        deep = b.uniform(0.1, 0.5) * d
        b.add(part, rod(at + (0, y, 0), at + (0, y - deep, 0), radius), b.color(0.3))
        y -= deep
        radius *= b.uniform(0.7, 1.02)
    for _ in range(int(b.rng.integers(1, 5))):
        part = b.new_part()
        r = b.uniform(0.04, 0.1) * min(w, d)
        c = np.array([b.uniform(0.1, 0.9) * w, b.uniform(0.2, 0.8) * d, h])
        b.add(part, rod(c - (0, 0, r), c + (0, 0, r * b.uniform(0.5, 2)), r), b.color(0.3))


def lamp(b: Builder) -> None:
    """A chain of arms on a foot, with a shade or a fan."""
    b.add(0, rod((0, 0, 0), (0, 0, 0.02), 0.1))
    at = np.array([0, 0, 0.02])
    direction = np.array([0.0, 0, 1])
    for k in range(int(b.rng.integers(1, 4))):
        part = 0 if k == 0 and b.chance(0.5) else b.new_part()
        end = at + direction * b.uniform(0.1, 0.3)
        color = b.color(0.7)
        b.add(part, rod(at, end, 0.01), color)
        b.add(part, ball(at, 0.017), color)
        at = end
        direction = direction + b.rng.normal(0, 0.6, 3) * (1, 0.4, 1)
        direction /= np.linalg.norm(direction)
    part = b.new_part()
    if b.chance(0.5):
        b.add(part, rod(at, at + direction * 0.12, 0.02, 0.08), b.color(0.3))
    else:
        b.add(part, rod(at, at + direction * 0.03, 0.03), b.color(0.3))
        u = np.cross(direction, (0.3, 0.5, 0.8))
        u /= np.linalg.norm(u)
        for k in range(4):
            blade = block((-0.03, 0.02, 0.0), (0.03, 0.18, 0.004))
            frame = np.stack([np.cross(direction, u), u, direction], axis=1)
            blade = turned(blade, (0, 0, 1), k * np.pi / 2, (0, 0, 0)) @ frame.T
            b.add(part, blade + at + direction * 0.02, b.color(0.3))


def composite(b: Builder) -> None:
    """Random solids, each part one to four of them, each part on an earlier one."""
    anchors = [np.zeros(3)]
    size = 1.0
    for k in range(int(b.rng.integers(2, 8))):
        part = 0 if k == 0 else b.new_part()
        at = anchors[b.rng.integers(len(anchors))]
        for _ in range(int(b.rng.integers(1, 5))):
            e = size * b.rng.uniform(0.05, 0.6, 3) * b.rng.choice([0.15, 0.5, 1], 3)
            kind = b.rng.integers(5)
            color = b.color(0.5)
            if kind <= 1:
                solid = block(-e / 2, e / 2, b.uniform(0, 0.2) * e.min())
            elif kind == 2:
                solid = rod((0, 0, -e[2] / 2), (0, 0, e[2] / 2), e[0] / 2, b.uniform(0.3, 1) * e[0])
            elif kind == 3:
                solid = ball((0, 0, 0), e[0] / 2)
            else:
                solid = ring((0, 0, 0), (0, 0, 1), e[0], 0.15 * e[0])
            if b.chance(0.6):
                solid = turned(
                    solid, b.rng.normal(size=3), np.pi / 2 * b.rng.integers(4), (0, 0, 0)
                )
            low, high = solid.reshape(-1, 3).min(0), solid.reshape(-1, 3).max(0)
            face = b.rng.integers(3)
            sign = b.rng.choice([-1, 1])
            move = at.copy()
            move[face] -= low[face] if sign > 0 else high[face]
            b.add(part, solid + move, color)
            spread = low + b.rng.random(3) * (high - low) + move
            spread[face] = (high if sign > 0 else low)[face] + move[face]
            anchors.append(spread)
            at = anchors[-1] if b.chance(0.5) else at
        size *= 0.85


FAMILIES = (vessel, vessel, bottle, faucet, blades, eyeglasses, chair, cart, device, lamp)
FAMILIES += (composite, composite)
