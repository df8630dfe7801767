"""Camera, Printer, Toaster, CoffeeMachine."""

from __future__ import annotations

import numpy as np

from model.data.procedural import controls
from model.data.procedural import shapes as s
from model.data.procedural.families.devices import GREY, LIGHT
from model.data.procedural.grammar import Builder, ProceduralObject
from model.data.procedural.materials import appliance_palette, glass, metal, plain, rubber


def camera(rng: np.random.Generator) -> ProceduralObject:
    """A camera with a lens that turns or slides, a dial, a release and a screen that folds out."""
    b = Builder("Camera", rng)
    case = plain("case", (44, 45, 48)) if rng.random() < 0.6 else metal("brushed")
    w, d, h = (float(v) for v in rng.uniform((0.095, 0.032, 0.06), (0.135, 0.05, 0.09)))
    body = b.base("camera_body")
    body.add(s.rounded_box((w, d, h), 0.009, rim=0.003).moved((0, 0, h / 2)), case, "body")
    size = (0.24 * w, d + 0.012, 0.9 * h)
    at = (-0.38 * w, -0.006, 0.47 * h)
    body.add(s.rounded_box(size, 0.008, rim=0.003).moved(at), rubber(), "grip")
    if rng.random() < 0.5:
        loops = [
            s.at(s.rectangle(0.36 * w, 0.9 * d, 0.003), h - 0.001),
            s.at(s.rectangle(0.22 * w, 0.6 * d, 0.003), h + 0.016),
        ]
        body.add(s.loft(loops).moved((0.08 * w, 0, 0)), case, "finder")
    r = float(rng.uniform(0.28, 0.4)) * h
    center = (0.1 * w, -d / 2, 0.47 * h)
    at = (center[0], -d / 2 - 0.003, center[2])
    ring = s.along(s.cylinder(1.1 * r, 0.006, segments=36), 1).moved(at)
    body.add(ring, metal("steel"), "mount")
    y = -d / 2 - 0.0066
    lens = (
        b.spin("lens", body, (0, -1, 0), (center[0], y, center[2]))
        if rng.random() < 0.5
        else b.slide(
            "lens", body, (0, -1, 0), 0.0, float(rng.uniform(0.01, 0.03)), (center[0], y, center[2])
        )
    )
    reach = float(rng.uniform(0.02, 0.06))
    knurl = np.arange(40) * 2 * np.pi / 40
    outline = (r * (1 + 0.02 * np.cos(10 * knurl)))[:, None] * np.stack(
        [np.cos(knurl), np.sin(knurl)], 1
    )
    tube = s.loft(
        [
            s.at(outline, 0),
            s.at(outline, 0.7 * reach),
            s.at(0.9 * s.circle(r, 40), 0.72 * reach),
            s.at(0.9 * s.circle(r, 40), reach),
        ]
    )
    lens.add(s.along(tube, 1).moved((center[0], y, center[2])), plain("lens", (36, 37, 40)), "tube")
    eye = s.along(s.lathe([(0.78 * r, 0), (0.6 * r, 0.002), (0.0, 0.003)], 30), 1)
    at = (center[0], y - reach + 0.0004, center[2])
    lens.add(eye.moved(at), glass((90, 110, 160), 200), "glass")
    at = (-0.38 * w, -0.008, h - 0.0005)
    controls.push_button(b, body, at, (0.011, 0.011, 0.003), metal("steel"), face="up", round_=True)
    for k in range(int(rng.integers(0, 3))):
        at = ((0.32 - 0.6 * k) * w + (0.06 * w if k else 0), 0.1 * d, h)
        controls.knob(b, body, at, (0.008, 0.007), (GREY, LIGHT), face="up", style=2)
    if rng.random() < 0.5:
        x0 = -0.22 * w
        origin = (x0, d / 2 + 0.0035, h / 2)
        flap = b.hinge("screen", body, (0, 0, 1), origin, 0.0, float(rng.uniform(2.4, 3.1)))
        flap.add(
            s.rounded_box((0.6 * w, 0.65 * h, 0.005), 0.004, rim=0.001)
            .turned((1, 0, 0), np.pi / 2)
            .moved((x0 + 0.3 * w + 0.001, d / 2 + 0.0036, h / 2)),
            GREY,
            "screen",
        )
    return b.build()


def printer(rng: np.random.Generator) -> ProceduralObject:
    """A printer with a scanner lid, trays, an output flap and buttons."""
    b = Builder("Printer", rng)
    palette = appliance_palette(rng)
    case = LIGHT if rng.random() < 0.6 else GREY
    w, d, h = (float(v) for v in rng.uniform((0.38, 0.3, 0.16), (0.48, 0.4, 0.3)))
    body = b.base("printer_body")
    slot_h = 0.055
    wall = 0.02
    front = -d / 2
    for side in (-1, 1):
        body.add(s.box((wall, d, h), (side * (w - wall) / 2, 0, h / 2), 0.003), case, "side_wall")
    inner = w - 2 * wall
    center = (0, 0, 2 * slot_h + 0.012 + (h - 2 * slot_h - 0.012) / 2)
    body.add(s.box((inner, d, h - 2 * slot_h - 0.012), center, 0.002), case, "case")
    body.add(s.box((inner, d, 0.006), (0, 0, slot_h + 0.009)), case, "shelf")
    body.add(s.box((inner, 0.012, h), (0, d / 2 - 0.006, h / 2)), case, "back")
    body.add(s.box((inner, d, 0.006), (0, 0, 0.003)), case, "floor")
    tray = b.slide("drawer", body, (0, -1, 0), 0.0, 0.6 * d, (0, front, 0.03))
    shell = s.tray((inner - 0.006, 0.85 * d, slot_h - 0.012), 0.004)
    shell = shell.moved((0, front + 0.425 * d, 0.0085))
    tray.add(shell, GREY, "tray")
    size = (inner - 0.004, 0.008, slot_h - 0.006)
    tray.add(s.box(size, (0, front - 0.0042, 0.0085 + (slot_h - 0.006) / 2), 0.002), case, "panel")
    origin = (0, front - 0.0105, slot_h + 0.014)
    flap = b.hinge("tray", body, (1, 0, 0), origin, 0.0, float(rng.uniform(1.2, 1.57)))
    center = (0, front - 0.0035, slot_h + 0.014 + (slot_h - 0.004) / 2)
    flap.add(s.box((inner - 0.006, 0.005, slot_h - 0.004), center, 0.001), GREY, "flap")
    axis = (-1, 0, 0)
    lid = b.hinge("lid", body, axis, (0, d / 2, h + 0.0015), 0.0, float(rng.uniform(1.0, 1.5)))
    lid.add(s.rounded_box((w, d, 0.03), 0.012, rim=0.006).moved((0, 0, h + 0.0165)), case, "lid")
    body.add(s.box((0.8 * w, 0.72 * d, 0.0012), (0, 0, h + 0.0002)), glass(), "glass")
    face = front - 0.004
    size = (0.5 * w, 0.012, 0.6 * (h - 2 * slot_h))
    panel = s.box(size, (0, front + 0.002, h - 0.5 * (h - 2 * slot_h)), 0.002)
    body.add(panel, palette.dark, "control_panel")
    for k in range(int(rng.integers(2, 7))):
        at = ((k - 2.5) * 0.07 * w, face, h - 0.5 * (h - 2 * slot_h))
        controls.push_button(b, body, at, (0.014, 0.014, 0.003), LIGHT, round_=True)
    return b.build()


def toaster(rng: np.random.Generator) -> ProceduralObject:
    """Slots, a lever that slides down, a browning knob, a crumb tray."""
    b = Builder("Toaster", rng)
    palette = appliance_palette(rng)
    w, d, h = (float(v) for v in rng.uniform((0.24, 0.15, 0.16), (0.34, 0.26, 0.2)))
    body = b.base("toaster_body")
    lift = 0.012
    slots = 2 if d > 0.2 or rng.random() < 0.7 else 1
    slot_d = 0.034
    xs = 0.72 * w
    # Length-wise bars between the slots, with end blocks: real slots from the top.
    edges = [-d / 2]
    for k in range(slots):
        y = (k - (slots - 1) / 2) * 0.07
        edges += [y - slot_d / 2, y + slot_d / 2]
    edges.append(d / 2)
    tray_height = 0.014
    low = lift + tray_height + 0.008
    for a, z in zip(edges[::2], edges[1::2], strict=True):
        size = (xs, z - a, h - tray_height - 0.008)
        center = (0, (a + z) / 2, low + (h - tray_height - 0.008) / 2)
        body.add(s.box(size, center, 0.006), palette.body, "side_wall")
    for side in (-1, 1):
        block = s.rounded_box((w / 2 - xs / 2, d, h), 0.02, rim=0.01)
        body.add(block.moved((side * (w / 2 + xs / 2) / 2, 0, lift + h / 2)), palette.dark, "end")
    body.add(s.box((xs, d, 0.006), (0, 0, low)), palette.metal, "floor")
    tray = b.slide("drawer", body, (0, 1, 0), 0.0, 0.7 * d, (0, 0, lift))
    at = (0, 0, lift + 0.001)
    tray.add(s.tray((xs - 0.01, 0.96 * d, tray_height), 0.0015).moved(at), palette.metal, "tray")
    size = (0.3 * w, 0.012, 0.01)
    tray.add(s.box(size, (0, d / 2 + 0.002, lift + 0.008), 0.002), palette.dark, "handle")
    for k in range(slots if rng.random() < 0.4 else 1):
        x = w / 2
        y = 0.0 if slots == 1 else (k - 0.5) * 0.07
        travel = 0.42 * h
        z = lift + 0.75 * h
        lever = b.slide("lever", body, (0, 0, -1), 0.0, travel, (x, y, z))
        size = (0.03, 0.04, 0.014)
        at = (x + 0.0156, y, z)
        lever.add(s.rounded_box(size, 0.006, rim=0.004).moved(at), palette.accent, "lever")
    controls.knob(
        b,
        body,
        (w / 2, 0.3 * d, lift + 0.13 * h),
        (0.016, 0.014),
        (palette.accent, LIGHT),
        face="right",
        style=int(rng.integers(3)),
        limits=(0.0, 4.4),
    )
    for k in range(int(rng.integers(0, 4))):
        at = (w / 2, -0.3 * d, lift + (0.2 + 0.14 * k) * h)
        controls.push_button(b, body, at, (0.014, 0.014, 0.004), LIGHT, face="right", round_=True)
    return b.build()


def coffee_machine(rng: np.random.Generator) -> ProceduralObject:
    """A column with a lid, a jug on its plate, a knob, buttons, perhaps a portafilter or a tray."""
    b = Builder("CoffeeMachine", rng)
    palette = appliance_palette(rng)
    w, d, h = (float(v) for v in rng.uniform((0.18, 0.24, 0.3), (0.28, 0.32, 0.4)))
    body = b.base("coffee_machine_body")
    foot, head = 0.035, 0.32 * h
    back = 0.4 * d
    size = (w, d, foot)
    body.add(s.rounded_box(size, 0.02, rim=0.006).moved((0, 0, foot / 2)), palette.body, "foot")
    extent = (w, back, h - 0.001)
    offset = (0, (d - back) / 2, h / 2)
    body.add(s.rounded_box(extent, 0.02, rim=0.006).moved(offset), palette.body, "tank")
    size = (w, d, head)
    body.add(s.rounded_box(size, 0.02, rim=0.006).moved((0, 0, h - head / 2)), palette.body, "head")
    top = h + 0.001
    axis = (-1, 0, 0)
    lid = b.hinge("lid", body, axis, (0, d / 2 - 0.01, top), 0.0, float(rng.uniform(1.2, 1.7)))
    solid = s.rounded_box((0.94 * w, 0.6 * d, 0.012), 0.015, rim=0.004)
    lid.add(solid.moved((0, d / 2 - 0.01 - 0.3 * d, top + 0.0062)), palette.dark, "lid")
    cy = -d / 2 + (d - back) * 0.5
    room = h - head - foot
    if rng.random() < 0.6:
        r = min(0.42 * (d - back), 0.4 * w)
        jug_h = 0.8 * room
        jug = b.slide("container", body, (0, -1, 0), 0.0, 0.25, (0, cy, foot))
        outer = [(0.85 * r, 0), (r, 0.3 * jug_h), (0.7 * r, 0.9 * jug_h), (0.72 * r, jug_h)]
        inner = [
            (0.7 * r, jug_h),
            (0.68 * r, 0.9 * jug_h),
            (0.97 * r, 0.3 * jug_h),
            (0.8 * r, 0.004),
        ]
        jug.add(s.lathe([*outer, *inner], 30).moved((0, cy, foot + 0.0008)), glass(), "jug")
        corners = [
            (0, -0.7 * r, 0.86 * jug_h),
            (0, -1.5 * r, 0.8 * jug_h),
            (0, -1.4 * r, 0.25 * jug_h),
            (0, -0.96 * r, 0.24 * jug_h),
        ]
        grip = s.bent_path(corners, 0.02)
        outline = s.rectangle(0.018, 0.01, 0.003)
        jug.add(s.sweep(grip + np.array([0, cy, foot]), outline), palette.dark, "handle")
    else:
        at = np.array([0, cy, h - head - 0.0006])
        handle = b.hinge("portafilter", body, (0, 0, 1), at, 0.0, 0.9)
        offset = at + np.array([0, 0, -0.0125])
        surface = metal("steel")
        handle.add(
            s.cylinder(0.028, 0.024, segments=26, bevel=0.002).moved(offset), surface, "basket"
        )
        path = np.stack([at + [0, -0.024, -0.014], at + [0, -0.16, -0.02]])
        handle.add(s.tube(path, 0.008, 12), palette.dark, "handle")
        tray = b.slide("tray", body, (0, -1, 0), 0.0, 0.12, (0, cy, foot))
        size = (0.86 * w, 0.9 * (d - back), 0.014)
        tray.add(s.tray(size, 0.002).moved((0, cy, foot + 0.0008)), metal("steel"), "tray")
    face = -d / 2
    z = h - 0.5 * head
    if rng.random() < 0.7:
        controls.knob(
            b,
            body,
            (0.25 * w, face, z),
            (0.018, 0.018),
            (palette.accent, LIGHT),
            style=int(rng.integers(3)),
            limits=(0.0, 3.1) if rng.random() < 0.5 else None,
        )
    for k in range(int(rng.integers(1, 4))):
        size = (0.018, 0.018, 0.004)
        offset = (-0.3 * w + 0.03 * k, face, z)
        controls.push_button(b, body, offset, size, palette.metal, round_=True)
    return b.build()
