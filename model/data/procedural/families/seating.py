"""Chair and FoldingChair."""

from __future__ import annotations

import numpy as np

from model.data.procedural import controls
from model.data.procedural import shapes as s
from model.data.procedural.grammar import Body, Builder, ProceduralObject
from model.data.procedural.materials import (
    PLASTICS,
    Surface,
    fabric,
    metal,
    plain,
    plastic_palette,
    rubber,
    wood,
)
from model.data.procedural.modules import legs


def office_chair(
    rng: np.random.Generator, *, casters: bool | None = None, back: bool | None = None
) -> ProceduralObject:
    """A swivel chair: star base with casters, a column that lifts, a seat that turns."""
    b = Builder("Chair", rng)
    b.palette = plastic_palette(rng)
    frame = metal("dark") if rng.random() < 0.5 else metal("steel")
    base = b.base("leg")
    arms = int(rng.choice([4, 5, 5, 5, 6]))
    reach = float(rng.uniform(0.26, 0.34))
    casters = bool(rng.random() < 0.75) if casters is None else casters
    wheel = float(rng.uniform(0.024, 0.032))
    hub_z = (2.0 * wheel + 0.055) if casters else 0.06
    at = (0, 0, hub_z + 0.01)
    base.add(s.cylinder(0.04, 0.07, segments=18, bevel=0.004).moved(at), frame, "hub")
    turn = rng.random() * 6.28
    for k in range(arms):
        a = turn + 2 * np.pi * k / arms
        tip_z = 2.0 * wheel + 0.018 if casters else 0.012
        path = np.linspace([0.03, 0, hub_z + 0.01], [reach, 0, tip_z], 4)
        arm = s.sweep(path, s.rectangle(0.032, 0.024, 0.006), scale=np.linspace(1.15, 0.75, 4))
        base.add(arm.turned((0, 0, 1), a), frame, "arm")
        top = (reach * np.cos(a) * 0.97, reach * np.sin(a) * 0.97, tip_z - 0.008)
        if casters:
            heading = float(rng.random() * 6.28)
            controls.caster(b, base, top, wheel, rubber(), heading=heading)
    seat_z = float(rng.uniform(0.42, 0.5))
    profile = [
        (0.0225, hub_z + 0.02),
        (0.029, hub_z + 0.02),
        (0.027, 0.62 * seat_z),
        (0.0225, 0.62 * seat_z),
    ]
    sleeve = s.ring(profile, 18)
    base.add(sleeve, frame, "sleeve")
    seat = b.screw("seat", base, (0, 0, 1), (0, 0, seat_z), float(rng.uniform(0.06, 0.12)))
    height = seat_z - hub_z - 0.07
    at = (0, 0, (seat_z + hub_z + 0.07) / 2 - 0.02)
    seat.add(s.cylinder(0.0215, height, segments=16).moved(at), metal("steel"), "column")
    cloth = fabric(_cloth(rng))
    _swivel_seat(b, seat, seat_z, frame, cloth, bool(rng.random() < 0.85) if back is None else back)
    return b.build()


def _cloth(rng: np.random.Generator) -> tuple[int, int, int]:
    colors = (
        (54, 58, 66),
        (96, 110, 124),
        (150, 60, 52),
        (70, 110, 96),
        (40, 70, 120),
        (168, 152, 128),
    )
    return colors[rng.integers(len(colors))]


def cushion(width: float, depth: float, thick: float) -> s.Solid:
    """A padded slab centred on the origin, lying flat."""
    size = (width, depth, thick)
    return s.rounded_box(size, 0.22 * min(width, depth), corner=5, rim=0.45 * thick)


def _swivel_seat(
    b: Builder, seat: Body, z: float, frame: Surface, cloth: Surface, back: bool
) -> None:
    rng = b.rng
    w, d = (float(v) for v in rng.uniform((0.42, 0.42), (0.52, 0.5)))
    seat.add(s.box((0.18, 0.22, 0.03), (0, 0, z - 0.03), 0.004), frame, "plate")
    seat.add(cushion(w, d, 0.085).moved((0, 0, z + 0.025)), cloth, "cushion")
    if rng.random() < 0.6:
        for side in (-1, 1):
            x = side * (w / 2 + 0.025)
            corners = [(side * 0.08, 0, z - 0.025), (x, 0, z - 0.025), (x, 0, z + 0.2)]
            path = s.bent_path(corners, 0.05)
            seat.add(s.sweep(path, s.rectangle(0.035, 0.014, 0.004)), frame, "arm_post")
            seat.add(cushion(0.06, 0.25, 0.028).moved((x, -0.01, z + 0.21)), frame, "armrest")
    if rng.random() < 0.5:
        lever = b.hinge("lever", seat, (0, 1, 0), (0.09, -0.02, z - 0.035), 0.0, 0.35)
        at = (0.1565, -0.02, z - 0.035)
        solid = s.along(s.cylinder(0.006, 0.13, segments=10, bevel=0.001), 0).moved(at)
        lever.add(solid, frame, "lever")
    if not back:
        return
    hinge_y, hinge_z = 0.122, z - 0.03
    tilt = (
        b.hinge(
            "backrest", seat, (-1, 0, 0), (0, hinge_y, hinge_z), 0.0, float(rng.uniform(0.2, 0.45))
        )
        if rng.random() < 0.5
        else seat
    )
    y = d / 2 + 0.06
    post = s.bent_path([(0, 0.115, hinge_z), (0, y, hinge_z), (0, y + 0.01, z + 0.3)], 0.07)
    tilt.add(s.sweep(post, s.rectangle(0.07, 0.012, 0.003)), frame, "bar")
    h = float(rng.uniform(0.38, 0.58))
    rest = s.rounded_box((0.94 * w, h, 0.06), 0.09, corner=5, rim=0.026, rings=4)
    rest = rest.turned((1, 0, 0), np.pi / 2)

    def curve(v: np.ndarray) -> np.ndarray:
        v[:, 1] -= 0.55 * v[:, 0] ** 2 + 0.04 * np.sin(v[:, 2] / h * 3.0)
        return v

    tilt.add(rest.shaped(curve).moved((0, y - 0.02, z + 0.12 + h / 2)), cloth, "cushion")


def four_legged_chair(rng: np.random.Generator) -> ProceduralObject:
    """A chair on four wheeled legs, or a bar stool whose seat turns."""
    b = Builder("Chair", rng)
    surface = wood("oak") if rng.random() < 0.6 else metal("dark")
    base = b.base("leg")
    w, d, z = (float(v) for v in rng.uniform((0.36, 0.36, 0.4), (0.46, 0.46, 0.75)))
    legs(base, w, d, z - 0.03, ("taper", "round", "block")[rng.integers(3)], surface)
    for side in (-1, 1):
        size = (0.02, 0.86 * d, 0.03)
        base.add(s.box(size, (side * (w / 2 - 0.035), 0, 0.45 * z), 0.002), surface, "rail")
    base.add(s.box((0.9 * w, 0.9 * d, 0.03), (0, 0, z - 0.035), 0.003), surface, "frame")
    at = (0, 0, z - 0.014)
    base.add(s.cylinder(0.05, 0.012, segments=18).moved(at), metal("steel"), "bearing")
    seat = b.spin("seat", base, (0, 0, 1), (0, 0, z))
    pad = s.cylinder(0.46 * w, 0.035, segments=32, bevel=0.012).moved((0, 0, z + 0.0105))
    seat.add(pad, fabric(_cloth(rng)) if rng.random() < 0.6 else surface, "cushion")
    if rng.random() < 0.6:
        h = float(rng.uniform(0.2, 0.4))
        for side in (-1, 1):
            corners = [(side * 0.3 * w, 0.3 * w, z), (side * 0.32 * w, 0.4 * w, z + h)]
            post = s.bent_path(corners, 0.02)
            seat.add(s.tube(post, 0.01), surface, "bar")
        arc = np.array(
            [
                [0.36 * w * np.sin(a) / 0.75, 0.4 * w - 0.05 * (1 - np.cos(a)), z + h]
                for a in np.linspace(-0.75, 0.75, 9)
            ]
        )
        seat.add(s.sweep(arc, s.rectangle(0.018, 0.09, 0.005)), surface, "backrest")
    return b.build()


def chair(rng: np.random.Generator) -> ProceduralObject:
    """Mostly swivel chairs, sometimes a turning stool."""
    return office_chair(rng) if rng.random() < 0.8 else four_legged_chair(rng)


def folding_chair(rng: np.random.Generator) -> ProceduralObject:
    """Front frame with the backrest; rear legs and seat fold onto it."""
    b = Builder("FoldingChair", rng)
    color = PLASTICS[rng.integers(len(PLASTICS))]
    bar, pad = metal(("steel", "dark", "white")[rng.integers(3)]), plain("pad", color)
    w = float(rng.uniform(0.38, 0.46))
    seat_z, top, foot = map(float, rng.uniform((0.42, 0.76, 0.24), (0.46, 0.88, 0.3)))
    r = 0.011
    front = b.base("leg")
    half = w / 2

    def along_front(z: float) -> np.ndarray:
        return np.array([0.0, -foot + (z / top) * (foot + 0.17), z])

    for side in (-1, 1):
        path = np.stack([along_front(r), along_front(top)]) + np.array([side * half, 0, 0])
        front.add(s.tube(path, r), bar, "bar")
    for z in (0.12, top - r):
        mid = along_front(z)
        front.add(s.along(s.cylinder(r * 0.8, w, segments=12), 0).moved(mid), bar, "bar")
    lean = np.arctan2(foot + 0.17, top)
    rest = s.rounded_box((w - 0.03, 0.2, 0.02), 0.03, rim=0.006).turned((1, 0, 0), np.pi / 2)
    front.add(rest.turned((1, 0, 0), -lean).moved(along_front(top - 0.13)), pad, "backrest")
    # The rear frame hangs inside the front one on pins at the seat's height.
    pin = along_front(seat_z + 0.03)
    rear_half = half - 3.2 * r
    end = np.array([0.0, foot, r])
    down = end - pin
    current = np.arctan2(down[1], -down[2])
    along = np.arctan2(*(along_front(r) - pin)[[1, 2]] * [1, -1])
    fold = float(current - along)
    rear = b.hinge("leg", front, (-1, 0, 0), pin, 0.0, 0.92 * fold)
    for side in (-1, 1):
        rear.add(s.tube(np.stack([pin, end]) + np.array([side * rear_half, 0, 0]), r), bar, "bar")
        at = pin + np.array([side * (rear_half + 1.6 * r), 0, 0])
        rear.add(s.along(s.cylinder(0.6 * r, 1.1 * r, segments=10), 0).moved(at), bar, "pin")
    at = pin + 0.8 * down
    rear.add(s.along(s.cylinder(0.8 * r, 2 * rear_half, segments=12), 0).moved(at), bar, "bar")
    hinge = along_front(seat_z - 0.02)
    _folding_seat(b, front, hinge, rear_half - 1.6 * r, pad, bar, float(lean))
    return b.build()


def _folding_seat(
    b: Builder, front: Body, hinge: np.ndarray, half: float, pad: Surface, bar: Surface, lean: float
) -> None:
    seat = b.hinge("seat", front, (-1, 0, 0), hinge, 0.0, float(np.pi / 2 - lean) * 0.9)
    depth = float(b.rng.uniform(0.3, 0.36))
    board = s.rounded_box((2 * half, depth, 0.018), 0.04, rim=0.006)
    seat.add(board.moved(hinge + np.array([0, -depth / 2 + 0.03, 0.004])), pad, "seat")
