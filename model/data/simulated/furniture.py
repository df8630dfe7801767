"""Assemblies with flat fronts: cabinets, tables, appliances, doors, boxes, keypads."""

from __future__ import annotations

import numpy as np

from model.data.simulated.primitives import Builder, ball, block, rod, tube


def handle(b: Builder, part: int, at: tuple[float, float, float], length: float) -> None:
    """A pull, bar, knob or cup on a front that looks along -y."""
    x, y, z = at
    color = b.color(0.25)
    kind = b.rng.integers(5)
    upright = b.chance(0.5)
    d = np.array([0, 0, length / 2]) if upright else np.array([length / 2, 0, 0])
    p = np.array([x, y, z])
    out = np.array([0, -b.uniform(0.2, 0.4) * max(length, 0.02), 0])
    thick = b.uniform(0.04, 0.09) * length
    if kind == 0:
        b.add(part, rod(p - d + out, p + d + out, thick), color)
        for s in (-0.8, 0.8):
            b.add(part, rod(p + s * d, p + s * d + out, thick * 0.8), color)
    elif kind == 1:
        turn = np.linspace(0, np.pi, 14)[:, None]
        b.add(part, tube(p + d * np.cos(turn) + out * np.sin(turn), thick), color)
    elif kind == 2:
        b.add(part, rod(p, p + out * 0.7, thick), color)
        b.add(part, ball(p + out, thick * 2), color)
    elif kind == 3:
        side = np.array([thick, 0, thick])
        b.add(part, block(p - d - side + out * 0.5, p + d + side), color)
    else:
        b.add(part, rod(p, p + out * 0.6, length * 0.2, length * 0.14), color)


def shell(b: Builder, part: int, low, high, thick: float, open_front: bool = True) -> None:
    """Boards around an inside that is open towards -y."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    boards = [
        ((x0, y0, z0), (x0 + thick, y1, z1)),
        ((x1 - thick, y0, z0), (x1, y1, z1)),
        ((x0, y0, z0), (x1, y1, z0 + thick)),
        ((x0, y0, z1 - thick), (x1, y1, z1)),
        ((x0, y1 - thick, z0), (x1, y1, z1)),
    ]
    if not open_front:
        boards.append(((x0, y0, z0), (x1, y0 + thick, z1)))
    color = b.color(0.8)
    for board in boards:
        b.add(part, block(*board), color)


def _split(b: Builder, rect, depth: int) -> list:
    x0, z0, x1, z1 = rect
    if depth == 0 or b.chance(0.15):
        return [rect]
    if (x1 - x0) * b.uniform(0.6, 1.6) > z1 - z0:
        n = int(b.rng.integers(2, 4))
        cuts = np.linspace(x0, x1, n + 1)
        rects = [(cuts[i], z0, cuts[i + 1], z1) for i in range(n)]
    else:
        n = int(b.rng.integers(2, 5))
        cuts = np.linspace(z0, z1, n + 1)
        rects = [(x0, cuts[i], x1, cuts[i + 1]) for i in range(n)]
    return [leaf for c in rects for leaf in _split(b, c, depth - 1)]


def front(b: Builder, part: int, rect, y: float, thick: float, framed: bool) -> None:
    """A door's or drawer's front panel from (x0, z0) to (x1, z1), standing before ``y``."""
    x0, z0, x1, z1 = rect
    color = b.color(0.6)
    if framed and min(x1 - x0, z1 - z0) > 0.12:
        w = b.uniform(0.12, 0.25) * min(x1 - x0, z1 - z0)
        inset = b.uniform(0.2, 0.7) * thick
        b.add(part, block((x0, y - thick, z0), (x0 + w, y, z1)), color)
        b.add(part, block((x1 - w, y - thick, z0), (x1, y, z1)), color)
        b.add(part, block((x0 + w, y - thick, z0), (x1 - w, y, z0 + w)), color)
        b.add(part, block((x0 + w, y - thick, z1 - w), (x1 - w, y, z1)), color)
        pane = b.color(0.5)
        b.add(part, block((x0 + w, y - thick + inset, z0 + w), (x1 - w, y, z1 - w)), pane)
    else:
        bevel = thick * 0.3 if b.chance(0.3) else 0.0
        b.add(part, block((x0, y - thick, z0), (x1, y, z1), bevel), color)


def cabinet(b: Builder) -> None:
    """Doors, drawers and open shelves in one carcass."""
    w, d, h = b.uniform(0.4, 1.6), b.uniform(0.3, 0.6), b.uniform(0.5, 1.9)
    t = b.uniform(0.01, 0.03)
    shell(b, 0, (0, 0, 0), (w, d, h), t)
    gap = float(b.rng.choice([0.0005, 0.002, 0.004, 0.008]))
    inset = b.chance(0.4)
    m = t if inset or b.chance(0.3) else 0.0
    framed, handles = b.chance(0.4), b.chance(0.85)
    for rect in _split(b, (m, m, w - m, h - m), int(b.rng.integers(1, 3))):
        x0, z0, x1, z1 = rect[0] + gap, rect[1] + gap, rect[2] - gap, rect[3] - gap
        if min(x1 - x0, z1 - z0) < 0.05:
            continue
        if b.chance(0.5):
            b.add(0, block((rect[0], t, rect[1] - t / 3), (rect[2], d, rect[1] + t / 3)))
        kind = b.rng.random()
        if kind < 0.15:
            continue
        part = b.new_part()
        y = t if inset else -0.0005
        start = len(b.solids)
        front(b, part, (x0, z0, x1, z1), y, t * b.uniform(0.7, 1.3), framed)
        drawer = z1 - z0 < 0.7 * (x1 - x0) if b.chance(0.9) else b.chance(0.5)
        if handles:
            size = min(b.uniform(0.08, 0.2), 0.5 * min(x1 - x0, z1 - z0) + 0.02)
            side = b.uniform(0.08, 0.15) * (x1 - x0)
            at_x = (x0 + x1) / 2 if drawer else (x0 + side if b.chance(0.5) else x1 - side)
            handle(b, part, (at_x, y - t, (z0 + z1) / 2 + b.uniform(-0.1, 0.2) * (z1 - z0)), size)
        if drawer:
            low = (x0 + 0.02, y, z0 + 0.1 * (z1 - z0))
            high = (x1 - 0.02, d * 0.9, z0 + b.uniform(0.4, 0.9) * (z1 - z0))
            for board in (
                (low, (low[0] + 0.008, high[1], high[2])),
                ((high[0] - 0.008, low[1], low[2]), high),
                (low, (high[0], high[1], low[2] + 0.008)),
                ((low[0], high[1] - 0.008, low[2]), high),
            ):
                b.add(part, block(*board), b.palette[2])
        elif b.chance(0.25):
            hinge = (x0 if b.chance(0.5) else x1, y, 0)
            sign = -1 if hinge[0] == x0 else 1
            b.turn_since(start, (0, 0, 1), sign * b.uniform(0.2, 1.5), hinge)
    if b.chance(0.4):
        leg = b.uniform(0.04, 0.2)
        for x in (0.04, w - 0.04):
            for y in (0.04, d - 0.04):
                b.add(0, rod((x, y, -leg), (x, y, 0), 0.02))
    if b.chance(0.3):
        over = b.uniform(0, 0.03)
        b.add(0, block((-over, -over, h), (w + over, d, h + 0.03)), b.color(0.3))


def flush_front(b: Builder) -> None:
    """Doors and drawers in one plane with their frame: lines alone tell them apart."""
    w, d, h = b.uniform(0.4, 2.0), b.uniform(0.3, 0.6), b.uniform(0.4, 2.0)
    t, gap = b.uniform(0.012, 0.025), float(b.rng.choice([0.001, 0.002, 0.003, 0.005]))
    groove = float(b.rng.choice([0.0002, 0.001, 0.003, 0.01]))
    frame = b.uniform(0.02, 0.06) if b.chance(0.5) else 0.0
    body = b.color(0.8)
    b.add(0, block((0, t, 0), (w, d, h)), body)
    dark = body * b.uniform(0.2, 0.8) if b.chance(0.7) else body
    b.add(0, block((frame, groove, frame), (w - frame, t, h - frame)), dark)
    if frame:
        for x in (0, w - frame):
            b.add(0, block((x, 0, 0), (x + frame, t, h)), body)
        for z in (0, h - frame):
            b.add(0, block((frame, 0, z), (w - frame, t, z + frame)), body)
    color, handles, framed = b.color(0.8), b.chance(0.8), b.chance(0.25)
    size, at_side = b.uniform(0.04, 0.16), b.chance(0.6)
    for rect in _split(b, (frame, frame, w - frame, h - frame), int(b.rng.integers(1, 3))):
        x0, z0, x1, z1 = rect[0] + gap, rect[1] + gap, rect[2] - gap, rect[3] - gap
        if min(x1 - x0, z1 - z0) < 0.05:
            continue
        part = 0 if b.chance(0.1) else b.new_part()
        if framed:
            front(b, part, (x0, z0, x1, z1), t, t, True)
        else:
            b.add(part, block((x0, 0, z0), (x1, t, z1)), color)
        if handles and part:
            drawer = z1 - z0 < 0.7 * (x1 - x0)
            aside = 0.1 * (x1 - x0)
            left = (x0 + x1) / 2 < w / 2
            x = (x0 + x1) / 2 if drawer or not at_side else (x1 - aside if left else x0 + aside)
            handle(b, part, (x, 0, (z0 + z1) / 2), min(size, 0.5 * min(x1 - x0, z1 - z0)))


def table(b: Builder) -> None:
    """A top on legs, drawers below, perhaps a cabinet at one side."""
    w, d, h = b.uniform(0.6, 1.6), b.uniform(0.4, 0.9), b.uniform(0.4, 0.8)
    t = b.uniform(0.02, 0.04)
    b.add(0, block((0, 0, h - t), (w, d, h)))
    for x in (0.03, w - 0.08):
        for y in (0.03, d - 0.08):
            b.add(0, block((x, y, 0), (x + 0.05, y + 0.05, h - t)))
    n = int(b.rng.integers(1, 4))
    z1 = h - t - 0.005
    z0 = z1 - b.uniform(0.08, 0.2)
    cuts = np.linspace(0.1, w - 0.1, n + 1)
    shell(b, 0, (0.09, 0.02, z0 - 0.015), (w - 0.09, d - 0.02, z1), 0.012)
    for i in range(n):
        part = b.new_part()
        slide = -b.uniform(0.05, 0.2) if b.chance(0.25) else 0.0
        x0, x1 = cuts[i] + 0.008, cuts[i + 1] - 0.008
        front(b, part, (x0, z0, x1, z1 - 0.01), 0.02 + slide, 0.018, False)
        b.add(part, block((x0 + 0.01, 0.02 + slide, z0), (x1 - 0.01, d * 0.8 + slide, z0 + 0.01)))
        handle(b, part, ((x0 + x1) / 2, 0.002 + slide, (z0 + z1) / 2), 0.07)


def knob(b: Builder, at, radius: float) -> None:
    """One knob as a part of its own, on a front that looks along -y."""
    part = b.new_part()
    p = np.asarray(at, float)
    depth = radius * b.uniform(0.5, 1.6)
    b.add(part, rod(p, p + (0, -depth, 0), radius, radius * b.uniform(0.7, 1)), b.color(0.3))
    if b.chance(0.5):
        s = radius * 0.15
        b.add(part, block(p + (-s, -depth * 1.3, -radius), p + (s, -depth, radius)), b.color(0.3))


def appliance(b: Builder) -> None:
    """Oven, microwave, refrigerator, dishwasher: hollow body, doors with windows, controls."""
    w, d, h = b.uniform(0.4, 0.9), b.uniform(0.35, 0.7), b.uniform(0.25, 1.9)
    t = b.uniform(0.02, 0.05)
    gap = float(b.rng.choice([0.001, 0.003, 0.006]))
    side = h < 0.6 * w or b.chance(0.3)
    strip = b.uniform(0.12, 0.25)
    door = (0, 0, w * (1 - strip), h) if side else (0, 0, w, h * (1 - strip))
    panel = (door[2] + gap, 0, w, h) if side else (0, door[3] + gap, w, h)
    shell(b, 0, (0, 0, 0), (w, d, h), t)
    for _ in range(int(b.rng.integers(0, 3))):
        z = b.uniform(0.2, 0.7) * h
        b.add(0, block((t, t, z), (door[2] - t, d - t, z + 0.006)), b.palette[1])
    proud = b.uniform(0.0, 0.03)
    b.add(0, block((panel[0], -proud, panel[1]), (panel[2], t, panel[3])), b.color(0.5))
    n = int(b.rng.integers(1, 3)) if h > 0.9 else 1
    cuts = np.linspace(door[1], door[3], n + 1)
    for i in range(n):
        part = b.new_part()
        start = len(b.solids)
        rect = (door[0], cuts[i] + gap, door[2], cuts[i + 1] - gap)
        thick = b.uniform(0.02, 0.06)
        front(b, part, rect, -0.001, thick, b.chance(0.6))
        length = b.uniform(0.3, 0.8) * min(rect[2] - rect[0], rect[3] - rect[1])
        z = rect[3] - 0.06 if b.chance(0.5) else (rect[1] + rect[3]) / 2
        handle(
            b,
            part,
            ((rect[0] + rect[2]) / 2 if z > rect[3] - 0.1 else rect[2] - 0.05, -thick, z),
            length,
        )
        if b.chance(0.3):
            flap = b.chance(0.5)
            origin = (0, 0, rect[1]) if flap else (rect[0], 0, 0)
            b.turn_since(start, (1, 0, 0) if flap else (0, 0, -1), b.uniform(0.3, 1.5), origin)
    along = np.linspace(0.15, 0.85, int(b.rng.integers(2, 7)))
    px, pz = panel[2] - panel[0], panel[3] - panel[1]
    radius = min(0.25 * min(px, pz), 0.35 * max(px, pz) / len(along))
    for u in along:
        x, z = (0.5, u) if side else (u, 0.5)
        at = (panel[0] + x * px, -proud, panel[1] + z * pz)
        if b.chance(0.6):
            knob(b, at, radius * 0.7)
        else:
            part = b.new_part()
            b.add(
                part,
                block(
                    (at[0] - radius * 0.7, -proud - 0.008, at[2] - radius * 0.4),
                    (at[0] + radius * 0.7, -proud, at[2] + radius * 0.4),
                ),
                b.color(0.4),
            )


def house_door(b: Builder) -> None:
    """One or two wings in a frame, levers, a letter box."""
    w, h, t = b.uniform(0.7, 1.8), b.uniform(1.8, 2.3), b.uniform(0.03, 0.05)
    f = b.uniform(0.03, 0.1)
    for low, high in (
        ((-f, 0, 0), (0, 0.1, h)),
        ((w, 0, 0), (w + f, 0.1, h)),
        ((-f, 0, h), (w + f, 0.1, h + f)),
    ):
        b.add(0, block(low, high), b.palette[1])
    cuts = np.linspace(0, w, 3 if w > 1.2 else 2)
    for i in range(len(cuts) - 1):
        part = b.new_part()
        start = len(b.solids)
        rect = (cuts[i] + 0.004, 0.005, cuts[i + 1] - 0.004, h - 0.004)
        front(b, part, rect, 0.05, t, b.chance(0.6))
        x = rect[0] + 0.07 if i else rect[2] - 0.07
        lever = b.new_part() if b.chance(0.4) else part
        for s in (-1, 1):
            y = 0.05 - t if s < 0 else 0.05
            b.add(lever, rod((x, y, 1), (x, y + s * 0.05, 1), 0.012), b.palette[3])
            b.add(lever, rod((x, y + s * 0.05, 1), (x - 0.1, y + s * 0.05, 1), 0.01), b.palette[3])
        if b.chance(0.5):
            hinge = (rect[2] if i else rect[0], 0.05, 0)
            b.turn_since(start, (0, 0, 1 if i else -1), b.uniform(0.1, 1.5), hinge)


def lidded_box(b: Builder) -> None:
    """A case, bin or carton with one to four flaps, closed or open."""
    w, d, h = b.uniform(0.1, 0.6), b.uniform(0.1, 0.5), b.uniform(0.06, 0.6)
    t = b.uniform(0.003, 0.012)
    for low, high in (
        ((0, 0, 0), (t, d, h)),
        ((w - t, 0, 0), (w, d, h)),
        ((0, 0, 0), (w, t, h)),
        ((0, d - t, 0), (w, d, h)),
        ((0, 0, 0), (w, d, t)),
    ):
        b.add(0, block(low, high))
    n = int(b.rng.choice([1, 1, 2, 4]))
    flaps = [((0, 0), (w, d), (1, 0, 0), (0, d, h), -1)]
    if n >= 2:
        flaps = [
            ((0, 0), (w / 2, d), (0, 1, 0), (0, 0, h), -1),
            ((w / 2, 0), (w, d), (0, 1, 0), (w, 0, h), 1),
        ]
    if n == 4:
        flaps += [
            ((0, 0), (w, d / 2), (1, 0, 0), (0, 0, h), 1),
            ((0, d / 2), (w, d), (1, 0, 0), (0, d, h), -1),
        ]
    for i, (low, high, axis, origin, sign) in enumerate(flaps):
        part = b.new_part()
        start = len(b.solids)
        z = h + 0.001 + (t if i >= 2 else 0)
        color = b.color(0.6)
        deep = b.uniform(0.01, 0.4) * h if n == 1 and b.chance(0.5) else t
        b.add(part, block((*low, z), (*high, z + deep)), color)
        if b.chance(0.3):
            b.add(part, rod((w / 2, 0.02, z + deep), (w / 2, 0.02, z + deep + 0.02), 0.012))
        if b.chance(0.65):
            b.turn_since(start, axis, sign * b.uniform(0.2, 2.2), origin)
    if b.chance(0.2):
        part = b.new_part()
        b.add(part, block((w / 2 - 0.04, -0.05, 0.01), (w / 2 + 0.04, 0, 0.02)), b.palette[1])


def clamshell(b: Builder) -> None:
    """Laptop, folding phone, waffle iron: two slabs on a hinge, keys on one of them."""
    w, d, t = b.uniform(0.15, 0.4), b.uniform(0.1, 0.3), b.uniform(0.008, 0.05)
    bevel = 0.2 * t if b.chance(0.5) else 0.0
    b.add(0, block((0, 0, 0), (w, d, t), bevel))
    keys_are_parts = b.chance(0.3)
    if b.chance(0.8):
        pads(b, (0.05 * w, 0.35 * d, 0.95 * w, 0.92 * d), t, "z", keys_are_parts)
    part = b.new_part()
    start = len(b.solids)
    color = b.color(0.6)
    b.add(part, block((0, 0, t + 0.001), (w, d, t + b.uniform(0.4, 1.0) * t), bevel), color)
    b.add(
        part, block((0.05 * w, 0.05 * d, t + 0.0005), (0.95 * w, 0.95 * d, t + 0.001)), b.palette[1]
    )
    if b.chance(0.85):
        b.turn_since(start, (-1, 0, 0), b.uniform(0.4, 2.4), (0, d, t))
    for x in (0.2 * w, 0.7 * w):
        b.add(0, rod((x, d, t), (x + 0.1 * w, d, t), 0.4 * t), b.palette[1])


def pads(b: Builder, rect, at: float, axis: str, parts: bool) -> None:
    """A grid of keys or buttons on the plane z = ``at`` (or y = -``at`` for axis y)."""
    x0, y0, x1, y1 = rect
    columns, rows = int(b.rng.integers(2, 13)), int(b.rng.integers(1, 6))
    fill = b.uniform(0.6, 0.92)
    px, py = (x1 - x0) / columns, (y1 - y0) / rows
    high = b.uniform(0.08, 0.5) * min(px, py)
    round_ = b.chance(0.3)
    color = b.color(0.4)
    for i in range(columns):
        for j in range(rows):
            if b.chance(0.05):
                continue
            part = b.new_part() if parts else 0
            cx, cy = x0 + (i + 0.5) * px, y0 + (j + 0.5) * py
            if round_:
                solid = rod((cx, cy, at), (cx, cy, at + high), 0.5 * fill * min(px, py))
            else:
                sx, sy = 0.5 * fill * px, 0.5 * fill * py
                solid = block((cx - sx, cy - sy, at - 0.3 * high), (cx + sx, cy + sy, at + high))
            b.add(part, solid, color)


def keypad(b: Builder) -> None:
    """Remote, keyboard, telephone, switch plate: a slab with buttons that are parts."""
    w, d, t = b.uniform(0.05, 0.45), b.uniform(0.05, 0.25), b.uniform(0.008, 0.04)
    b.add(0, block((0, 0, 0), (w, d, t), 0.2 * t if b.chance(0.5) else 0))
    if b.chance(0.3):
        for i in range(int(b.rng.integers(1, 4))):
            part = b.new_part()
            x = w * (0.15 + 0.28 * i)
            solid = block((x, 0.25 * d, t - 0.002), (x + 0.2 * w, 0.75 * d, t + 0.01))
            solid = solid if b.chance(0.5) else solid + 0
            b.add(part, solid, b.color(0.6))
        return
    pads(b, (0.08 * w, 0.1 * d, 0.92 * w, b.uniform(0.5, 0.9) * d), t, "z", True)
    if b.chance(0.4):
        b.add(0, block((0.1 * w, 0.92 * d, t), (0.9 * w, 0.98 * d, t + 0.001)), b.palette[1])


FAMILIES = (
    cabinet,
    cabinet,
    table,
    appliance,
    appliance,
    house_door,
    lidded_box,
    clamshell,
    keypad,
)
