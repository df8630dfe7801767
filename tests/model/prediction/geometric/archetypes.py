"""Plain versions of everyday things with their true joints, one function a thing.

Objects face -x and stand on z = 0. They are rough on purpose: what is tested is the rule, not the
modelling.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import trimesh

from model.core.articulated_object import Part, SegmentedObject
from model.core.geometry import Mesh

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Truth:
    """A joint: type, axis, a point on it (None: meaningless), the way it opens (None: both)."""

    type: str
    axis: tuple[float, float, float]
    point: tuple[float, float, float] | None = None
    parent: str = "base"


@dataclass(frozen=True)
class Thing:
    """Named meshes and the truth about those that move; the others are the base."""

    category: str
    parts: dict[str, tuple[str, trimesh.Trimesh]]
    truth: dict[str, Truth]

    def segmented(self, *, names: bool = True, order: np.random.Generator | None = None):
        parts = [
            Part(
                f"link_{key}",
                Mesh(np.asarray(m.vertices), np.asarray(m.faces, np.int32)),
                name=name if names else None,
            )
            for key, (name, m) in self.parts.items()
        ]
        if order is not None:
            parts = [parts[i] for i in order.permutation(len(parts))]
        return SegmentedObject(self.category, tuple(parts), self.category if names else None)


def box(center, size) -> trimesh.Trimesh:
    m = trimesh.creation.box(extents=size)
    m.apply_translation(center)
    return m


def rod(center, axis, radius, length) -> trimesh.Trimesh:
    m = trimesh.creation.cylinder(radius=radius, height=length, sections=40)
    m.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], axis))
    m.apply_translation(center)
    return m


def ball(center, radius) -> trimesh.Trimesh:
    m = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    m.apply_translation(center)
    return m


def arc(center, normal, radius, thick, start, end, up=Z) -> trimesh.Trimesh:
    """A bent round bar about ``normal``; angles in degrees from ``up``."""
    n = np.asarray(normal, float)
    u = np.asarray(up, float)
    v = np.cross(n, u)
    angles = np.deg2rad(np.linspace(start, end, 24))
    points = np.asarray(center) + radius * (
        np.outer(np.cos(angles), u) + np.outer(np.sin(angles), v)
    )
    return join(
        *(
            rod((a + b) / 2, b - a, thick, float(np.linalg.norm(b - a)) * 1.05)
            for a, b in pairwise(points)
        )
    )


def tube(center, radius, height, thick=0.01) -> trimesh.Trimesh:
    m = trimesh.creation.annulus(r_min=radius - thick, r_max=radius, height=height, sections=40)
    m.apply_translation(center)
    return m


def join(*meshes) -> trimesh.Trimesh:
    return trimesh.util.concatenate(list(meshes))


def turned(mesh, axis, point, degrees) -> trimesh.Trimesh:
    out = mesh.copy()
    out.apply_transform(trimesh.transformations.rotation_matrix(np.deg2rad(degrees), axis, point))
    return out


def carcass(center, size, wall=0.02) -> trimesh.Trimesh:
    """A box that is open towards -x."""
    (x, y, z), (a, b, c) = center, size
    return join(
        box((x + a / 2 - wall / 2, y, z), (wall, b, c)),
        box((x, y - b / 2 + wall / 2, z), (a, wall, c)),
        box((x, y + b / 2 - wall / 2, z), (a, wall, c)),
        box((x, y, z - c / 2 + wall / 2), (a, b, wall)),
        box((x, y, z + c / 2 - wall / 2), (a, b, wall)),
    )


def tray(center, size, wall=0.012) -> trimesh.Trimesh:
    """An open drawer."""
    (x, y, z), (a, b, c) = center, size
    return join(
        box((x, y, z - c / 2 + wall / 2), (a, b, wall)),
        box((x, y - b / 2 + wall / 2, z), (a, wall, c)),
        box((x, y + b / 2 - wall / 2, z), (a, wall, c)),
        box((x - a / 2 + wall / 2, y, z), (wall, b, c)),
        box((x + a / 2 - wall / 2, y, z), (wall, b, c)),
    )


def cabinet() -> Thing:
    return Thing(
        "StorageFurniture",
        {
            "base": (
                "furniture_body",
                join(
                    carcass((0.25, 0, 0.5), (0.5, 0.8, 1.0)),
                    box((0.25, 0, 0.7), (0.48, 0.78, 0.02)),
                ),
            ),
            "left": (
                "rotation_door",
                join(
                    box((-0.01, -0.2, 0.35), (0.02, 0.39, 0.68)),
                    box((-0.035, -0.05, 0.4), (0.03, 0.015, 0.12)),
                ),
            ),
            "right": (
                "rotation_door",
                join(
                    box((-0.01, 0.2, 0.35), (0.02, 0.39, 0.68)),
                    box((-0.035, 0.05, 0.4), (0.03, 0.015, 0.12)),
                ),
            ),
            "drawer": (
                "drawer",
                join(
                    tray((0.22, 0, 0.84), (0.42, 0.7, 0.2)),
                    box((-0.01, 0, 0.85), (0.02, 0.78, 0.28)),
                    box((-0.035, 0, 0.85), (0.03, 0.15, 0.015)),
                ),
            ),
        },
        {
            "left": Truth("revolute", Z, (0, -0.395, 0)),
            "right": Truth("revolute", Z, (0, 0.395, 0)),
            "drawer": Truth("prismatic", X),
        },
    )


def laptop() -> Thing:
    screen = turned(box((0, 0, 0.03), (0.24, 0.34, 0.01)), Y, (0.12, 0, 0.025), 110)
    return Thing(
        "Laptop",
        {
            "base": ("laptop_base", box((0, 0, 0.01), (0.24, 0.34, 0.02))),
            "screen": ("screen", screen),
        },
        {"screen": Truth("revolute", Y, (0.12, 0, 0.025))},
    )


def toilet() -> Thing:
    bowl = join(rod((0, 0, 0.2), Z, 0.19, 0.4), box((0.28, 0, 0.45), (0.18, 0.4, 0.4)))
    seat = trimesh.creation.annulus(r_min=0.11, r_max=0.19, height=0.02, sections=40)
    seat.apply_translation((0, 0, 0.415))
    return Thing(
        "Toilet",
        {
            "base": ("toilet_body", bowl),
            "seat": ("seat", seat),
            "lid": ("lid", rod((0, 0, 0.437), Z, 0.19, 0.02)),
        },
        {
            "seat": Truth("revolute", Y, (0.19, 0, 0.41)),
            "lid": Truth("revolute", Y, (0.19, 0, 0.43)),
        },
    )


def bucket() -> Thing:
    return Thing(
        "Bucket",
        {
            "base": (
                "bucket_body",
                join(tube((0, 0, 0.15), 0.15, 0.3), rod((0, 0, 0.005), Z, 0.15, 0.01)),
            ),
            "handle": ("handle", arc((0, 0, 0.28), X, 0.16, 0.005, -90, 90)),
        },
        {"handle": Truth("revolute", Y, (0, 0, 0.28))},
    )


def kettle() -> Thing:
    return Thing(
        "Kettle",
        {
            "base": (
                "kettle_body",
                join(
                    rod((0, 0, 0.08), Z, 0.09, 0.16), rod((-0.11, 0, 0.12), (-1, 0, 1), 0.012, 0.1)
                ),
            ),
            "lid": (
                "lid",
                join(rod((0, 0, 0.165), Z, 0.06, 0.01), rod((0, 0, 0.18), Z, 0.012, 0.02)),
            ),
        },
        {"lid": Truth("prismatic", Z)},
    )


def fan() -> Thing:
    hub = rod((-0.06, 0, 0.5), X, 0.025, 0.03)
    blades = [
        turned(box((-0.06, 0.09, 0.5), (0.004, 0.14, 0.06)), X, (0, 0, 0.5), a)
        for a in (0, 90, 180, 270)
    ]
    return Thing(
        "Fan",
        {
            "base": (
                "fan_base",
                join(
                    rod((0, 0, 0.01), Z, 0.12, 0.02),
                    rod((0, 0, 0.25), Z, 0.012, 0.48),
                    rod((0, 0, 0.5), X, 0.05, 0.09),
                ),
            ),
            "rotor": ("rotor", join(hub, *blades)),
        },
        {"rotor": Truth("continuous", X, (0, 0, 0.5))},
    )


def display() -> Thing:
    return Thing(
        "Display",
        {
            "base": (
                "display_base",
                join(
                    box((0.02, 0, 0.01), (0.2, 0.3, 0.02)), box((0.03, 0, 0.15), (0.02, 0.05, 0.28))
                ),
            ),
            "screen": ("rotation_screen", box((0, 0, 0.33), (0.03, 0.55, 0.32))),
        },
        {"screen": Truth("revolute", Y, (0.015, 0, 0.24))},
    )


def suitcase() -> Thing:
    handle = join(
        box((0, -0.1, 0.62), (0.012, 0.012, 0.36)),
        box((0, 0.1, 0.62), (0.012, 0.012, 0.36)),
        box((0, 0, 0.8), (0.02, 0.22, 0.02)),
    )
    wheels = {
        f"wheel{i}": ("wheel", rod((x, y, 0.03), Y, 0.03, 0.02))
        for i, (x, y) in enumerate(((-0.08, -0.16), (-0.08, 0.16), (0.08, -0.16), (0.08, 0.16)))
    }
    truth = {
        k: Truth("continuous", Y, (x, 0, 0.03))
        for k, x in zip(wheels, (-0.08, -0.08, 0.08, 0.08), strict=True)
    }
    return Thing(
        "Suitcase",
        {
            "base": ("suitcase_body", box((0, 0, 0.35), (0.22, 0.4, 0.6))),
            "handle": ("translation_handle", handle),
            **wheels,
        },
        {"handle": Truth("prismatic", Z), **truth},
    )


def pedal_bin() -> Thing:
    return Thing(
        "TrashCan",
        {
            "base": (
                "trashcan_body",
                join(tube((0, 0, 0.2), 0.15, 0.4), rod((0, 0, 0.01), Z, 0.15, 0.02)),
            ),
            "lid": ("lid", rod((0, 0, 0.41), Z, 0.15, 0.02)),
            "pedal": ("foot_pad", box((-0.17, 0, 0.03), (0.06, 0.08, 0.015))),
        },
        {
            "lid": Truth("revolute", Y, (0.15, 0, 0.4)),
            "pedal": Truth("revolute", Y, (-0.14, 0, 0.03)),
        },
    )


def sliding_window() -> Thing:
    frame = join(
        box((0, -0.5, 0.5), (0.08, 0.04, 1)),
        box((0, 0.5, 0.5), (0.08, 0.04, 1)),
        box((0, 0, 0.02), (0.08, 1, 0.04)),
        box((0, 0, 0.98), (0.08, 1, 0.04)),
    )
    return Thing(
        "Window",
        {
            "base": ("window_frame", frame),
            "a": ("translation_window", box((-0.02, -0.23, 0.5), (0.02, 0.5, 0.92))),
            "b": ("translation_window", box((0.02, 0.23, 0.5), (0.02, 0.5, 0.92))),
        },
        {"a": Truth("prismatic", Y), "b": Truth("prismatic", Y)},
    )


def clock() -> Thing:
    return Thing(
        "Clock",
        {
            "base": ("clock_body", rod((0, 0, 0.2), X, 0.2, 0.04)),
            "hour": ("hand", box((-0.025, 0, 0.24), (0.004, 0.012, 0.1))),
            "minute": (
                "hand",
                turned(box((-0.032, 0, 0.26), (0.004, 0.01, 0.15)), X, (0, 0, 0.2), 60),
            ),
        },
        {
            "hour": Truth("continuous", X, (0, 0, 0.2)),
            "minute": Truth("continuous", X, (0, 0, 0.2)),
        },
    )


def toaster() -> Thing:
    return Thing(
        "Toaster",
        {
            "base": ("toaster_body", box((0, 0, 0.1), (0.16, 0.28, 0.18))),
            "slider": ("slider", box((0, -0.15, 0.14), (0.04, 0.03, 0.015))),
            "knob": ("knob", rod((0, -0.145, 0.06), Y, 0.015, 0.015)),
        },
        {"slider": Truth("prismatic", Z), "knob": Truth("continuous", Y, (0, 0, 0.06))},
    )


def keyboard() -> Thing:
    keys = {
        f"k{r}{c}": (
            "key",
            box((-0.05 + 0.022 * r, -0.2 + 0.022 * c, 0.022), (0.018, 0.018, 0.008)),
        )
        for r in range(4)
        for c in range(10)
    }
    return Thing(
        "Keyboard",
        {
            "base": ("keyboard_base", box((-0.015, -0.1, 0.01), (0.12, 0.26, 0.018))),
            **keys,
        },
        {k: Truth("prismatic", Z) for k in keys},
    )


def mouse() -> Thing:
    return Thing(
        "Mouse",
        {
            "base": ("mouse_body", box((0, 0, 0.015), (0.11, 0.06, 0.03))),
            "wheel": ("wheel", rod((-0.035, 0, 0.028), Y, 0.01, 0.006)),
            "left": ("button", box((-0.035, -0.017, 0.0315), (0.035, 0.022, 0.003))),
            "right": ("button", box((-0.035, 0.017, 0.0315), (0.035, 0.022, 0.003))),
        },
        {
            "wheel": Truth("continuous", Y, (-0.035, 0, 0.028)),
            "left": Truth("prismatic", Z),
            "right": Truth("prismatic", Z),
        },
    )


def washer() -> Thing:
    return Thing(
        "WashingMachine",
        {
            "base": ("body", carcass((0.3, 0, 0.42), (0.6, 0.6, 0.85))),
            "door": (
                "door",
                join(
                    rod((-0.015, 0, 0.42), X, 0.2, 0.03),
                    box((-0.04, 0.17, 0.42), (0.03, 0.015, 0.08)),
                ),
            ),
            "knob": ("knob", rod((-0.02, 0.15, 0.77), X, 0.03, 0.04)),
        },
        {
            "door": Truth("revolute", Z, (0, -0.2, 0)),
            "knob": Truth("continuous", X, (0, 0.15, 0.77)),
        },
    )


def safe() -> Thing:
    return Thing(
        "Safe",
        {
            "base": ("safe_body", carcass((0.2, 0, 0.2), (0.4, 0.4, 0.4))),
            "door": ("door", box((-0.015, 0, 0.2), (0.03, 0.38, 0.38))),
            "knob": ("knob", rod((-0.045, 0.12, 0.2), X, 0.03, 0.03)),
        },
        {
            "door": Truth("revolute", Z, (0, -0.19, 0)),
            "knob": Truth("continuous", X, (0, 0.12, 0.2), "door"),
        },
    )


def oven() -> Thing:
    knobs = {
        f"knob{i}": ("knob", rod((-0.02, y, 0.82), X, 0.025, 0.04))
        for i, y in enumerate((-0.22, -0.08, 0.08, 0.22))
    }
    return Thing(
        "Oven",
        {
            "base": (
                "oven_body",
                join(
                    carcass((0.3, 0, 0.38), (0.6, 0.6, 0.76)), box((0.3, 0, 0.82), (0.6, 0.6, 0.12))
                ),
            ),
            "door": (
                "door",
                join(
                    box((-0.015, 0, 0.42), (0.03, 0.56, 0.5)),
                    box((-0.05, 0, 0.63), (0.02, 0.45, 0.02)),
                ),
            ),
            **knobs,
        },
        {
            "door": Truth("revolute", Y, (0, 0, 0.17)),
            **{
                k: Truth("continuous", X, (0, y, 0.82))
                for k, y in zip(knobs, (-0.22, -0.08, 0.08, 0.22), strict=True)
            },
        },
    )


def scissors() -> Thing:
    blade = join(
        box((0.05, 0, 0.003), (0.2, 0.012, 0.002)),
        turned(box((-0.08, 0, 0.003), (0.08, 0.03, 0.004)), Z, (0, 0, 0), 0),
    )
    other = blade.copy()
    other.apply_translation((0, 0, 0.003))
    return Thing(
        "Scissors",
        {
            "base": ("leg", turned(blade, Z, (0, 0, 0), 15)),
            "leg": ("leg", turned(other, Z, (0, 0, 0), -15)),
        },
        {"leg": Truth("revolute", Z, (0, 0, 0))},
    )


def globe() -> Thing:
    tilt = np.array([np.sin(0.41), 0.0, np.cos(0.41)])
    return Thing(
        "Globe",
        {
            "base": (
                "globe_base",
                join(
                    rod((0, 0, 0.01), Z, 0.1, 0.02),
                    rod((0, 0, 0.05), Z, 0.01, 0.07),
                    arc((0, 0, 0.25), Y, 0.165, 0.006, 20, 200),
                ),
            ),
            "sphere": (
                "sphere",
                join(ball((0, 0, 0.25), 0.15), rod(np.array((0, 0, 0.25)), tilt, 0.004, 0.34)),
            ),
        },
        {"sphere": Truth("continuous", tuple(tilt), (0, 0, 0.25))},
    )


def pen() -> Thing:
    return Thing(
        "Pen",
        {
            "base": (
                "pen_body",
                join(rod((0, 0, 0.006), X, 0.005, 0.1), rod((-0.055, 0, 0.006), X, 0.003, 0.02)),
            ),
            "cap": ("cap", rod((-0.045, 0, 0.006), X, 0.0062, 0.045)),
        },
        {"cap": Truth("prismatic", X)},
    )


def folding_knife() -> Thing:
    return Thing(
        "Knife",
        {
            "base": ("knife_body", box((0.06, 0, 0.01), (0.12, 0.025, 0.016))),
            "blade": ("rotation_blade", box((-0.045, 0, 0.01), (0.1, 0.02, 0.003))),
        },
        {"blade": Truth("revolute", Z, (0.003, 0, 0.01))},
    )


def closed_knife() -> Thing:
    """Folded in: the pin lies near the handle's end, the tip looks out at the side."""
    blade = turned(box((0.0, 0, 0.01), (0.085, 0.012, 0.003)), Z, (-0.042, 0, 0.01), -6)
    return Thing(
        "Knife",
        {
            "base": ("knife_body", box((0, 0, 0.01), (0.12, 0.025, 0.016))),
            "blade": ("rotation_blade", blade),
        },
        {"blade": Truth("revolute", Z, (-0.039, 0, 0.01))},
    )


def lamp() -> Thing:
    lower = rod((0, 0.02, 0.2), Z, 0.01, 0.36)
    upper = turned(rod((0, 0.04, 0.56), Z, 0.01, 0.36), Y, (0, 0, 0.38), -60)
    tip = np.array((-0.312, 0.04, 0.56))
    head = join(rod(np.add(tip, (-0.02, 0.02, -0.03)), Z, 0.05, 0.1))
    return Thing(
        "Lamp",
        {
            "base": (
                "lamp_base",
                join(rod((0, 0, 0.01), Z, 0.1, 0.02), rod((0, 0, 0.025), Y, 0.012, 0.05)),
            ),
            "lower": ("arm", lower),
            "upper": ("arm", upper),
            "head": ("head", head),
        },
        {
            "lower": Truth("revolute", Y, (0, 0, 0.03)),
            "upper": Truth("revolute", Y, (0, 0, 0.38), "lower"),
            "head": Truth("revolute", Y, tuple(tip), "upper"),
        },
    )


def plate_lamp() -> Thing:
    """Arms of flat strips side by side, each pinned to the one before."""
    foot, elbow = np.array((0, 0, 0.1)), np.array((0.14, 0, 0.34))
    wrist = np.array((-0.04, 0, 0.62))

    def strip(a, b, y) -> trimesh.Trimesh:
        length = float(np.linalg.norm(b - a))
        lean = np.degrees(np.arctan2(b[0] - a[0], b[2] - a[2]))
        plate = box((*((a + b) / 2)[:2] + (0, y), (a + b)[2] / 2), (0.03, 0.006, length + 0.03))
        return join(turned(plate, Y, (a + b) / 2, lean), rod(a + (0, y - 0.006, 0), Y, 0.01, 0.018))

    foot_plate = join(rod((0, 0, 0.01), Z, 0.12, 0.02), box((0, 0, 0.06), (0.03, 0.006, 0.1)))
    head = join(rod(wrist + (-0.03, 0.024, -0.03), Z, 0.05, 0.06), rod(wrist, Y, 0.008, 0.05))
    return Thing(
        "Lamp",
        {
            "base": ("lamp_base", foot_plate),
            "lower": ("arm", strip(foot, elbow, 0.008)),
            "upper": ("arm", strip(elbow, wrist, 0.016)),
            "head": ("head", head),
        },
        {
            "lower": Truth("revolute", Y, tuple(foot)),
            "upper": Truth("revolute", Y, tuple(elbow), "lower"),
            "head": Truth("revolute", Y, tuple(wrist), "upper"),
        },
    )


def lidded_box() -> Thing:
    body = turned(carcass((0, 0, 0), (0.2, 0.4, 0.3)), Y, (0, 0, 0), 90)
    body.apply_translation((0, 0, 0.1))
    return Thing(
        "Box",
        {
            "base": ("box_body", body),
            "lid": (
                "rotation_lid",
                join(box((0, 0, 0.21), (0.3, 0.4, 0.02)), box((-0.16, 0, 0.2), (0.02, 0.05, 0.04))),
            ),
        },
        {"lid": Truth("revolute", Y, (0.15, 0, 0.2))},
    )


def sliding_door() -> Thing:
    frame = join(
        box((0, -0.9, 1), (0.1, 0.06, 2)),
        box((0, 0.9, 1), (0.1, 0.06, 2)),
        box((0, 0, 1.97), (0.1, 1.8, 0.06)),
        box((0, 0, 0.02), (0.1, 1.8, 0.04)),
    )
    return Thing(
        "Door",
        {
            "base": ("door_frame", frame),
            "a": ("translation_door", box((-0.025, -0.42, 1), (0.03, 0.88, 1.88))),
            "b": ("translation_door", box((0.025, 0.42, 1), (0.03, 0.88, 1.88))),
        },
        {"a": Truth("prismatic", Y), "b": Truth("prismatic", Y)},
    )


def office_chair() -> Thing:
    legs = [
        turned(box((0.14, 0, 0.08), (0.26, 0.03, 0.03)), Z, (0, 0, 0), a)
        for a in (0, 72, 144, 216, 288)
    ]
    parts, truth = {}, {}
    for i, a in enumerate((0, 72, 144, 216, 288)):
        at = np.array((0.26 * np.cos(np.deg2rad(a)), 0.26 * np.sin(np.deg2rad(a)), 0.0))
        side = (-np.sin(np.deg2rad(a)), np.cos(np.deg2rad(a)), 0.0)
        parts[f"wheel{i}"] = ("wheel", rod(np.add(at, (0, 0, 0.032)), side, 0.032, 0.02))
        truth[f"wheel{i}"] = Truth("continuous", side, tuple(np.add(at, (0, 0, 0.032))))
    return Thing(
        "Chair",
        {
            "base": ("chair_leg", join(*legs, rod((0, 0, 0.22), Z, 0.02, 0.3))),
            "seat": (
                "seat",
                join(box((0, 0, 0.4), (0.45, 0.45, 0.06)), box((0.22, 0, 0.7), (0.04, 0.4, 0.5))),
            ),
            **parts,
        },
        {"seat": Truth("continuous", Z, (0, 0, 0)), **truth},
    )


def microwave() -> Thing:
    return Thing(
        "Microwave",
        {
            "base": (
                "microwave_body",
                join(
                    carcass((0.18, -0.06, 0.15), (0.36, 0.38, 0.3)),
                    box((0.18, 0.19, 0.15), (0.36, 0.12, 0.3)),
                ),
            ),
            "door": ("door", box((-0.01, -0.06, 0.15), (0.02, 0.37, 0.28))),
            "tray": ("rotation_tray", rod((0.17, -0.06, 0.035), Z, 0.14, 0.01)),
            "knob": ("knob", rod((-0.01, 0.19, 0.1), X, 0.022, 0.02)),
            "button": ("button", box((-0.003, 0.19, 0.05), (0.006, 0.05, 0.02))),
        },
        {
            "door": Truth("revolute", Z, (0, -0.245, 0)),
            "tray": Truth("continuous", Z, (0.17, -0.06, 0)),
            "knob": Truth("continuous", X, (0, 0.19, 0.1)),
            "button": Truth("prismatic", X),
        },
    )


def pump_bottle() -> Thing:
    return Thing(
        "Dispenser",
        {
            "base": (
                "dispenser_body",
                join(rod((0, 0, 0.08), Z, 0.035, 0.16), rod((0, 0, 0.17), Z, 0.012, 0.02)),
            ),
            "head": (
                "pressing_lid",
                join(
                    rod((0, 0, 0.2), Z, 0.006, 0.04), box((-0.012, 0, 0.222), (0.05, 0.014, 0.012))
                ),
            ),
        },
        {"head": Truth("prismatic", Z)},
    )


def rocker_switch() -> Thing:
    return Thing(
        "Switch",
        {
            "base": ("switch_frame", box((0.006, 0, 0.06), (0.012, 0.08, 0.12))),
            "rocker": ("toggle_button", box((-0.004, 0, 0.06), (0.012, 0.03, 0.06))),
        },
        {"rocker": Truth("revolute", Y, (0, 0, 0.06))},
    )


def flip_phone() -> Thing:
    flap = turned(box((-0.0, 0, 0.016), (0.09, 0.045, 0.008)), Y, (0.045, 0, 0.012), 160)
    return Thing(
        "Phone",
        {
            "base": ("phone_base", box((0, 0, 0.005), (0.09, 0.045, 0.01))),
            "flip": ("flip_cover", flap),
        },
        {"flip": Truth("revolute", Y, (0.045, 0, 0.012))},
    )


def door_frame() -> trimesh.Trimesh:
    posts = [box((0, y, 1.05), (0.1, 0.08, 2.1)) for y in (-0.5, 0.5)]
    return join(*posts, box((0, 0, 2.08), (0.1, 1.0, 0.08)))


def entrance(side: float = -1.0) -> Thing:
    """A leaf with a bar that is pushed, on the side ``side`` of x."""
    return Thing(
        "Door",
        {
            "base": ("door frame", door_frame()),
            "leaf": ("door", box((0, 0, 1.02), (0.06, 0.9, 2.0))),
            "bar": ("push bar paddle", box((side * 0.06, 0, 1.0), (0.03, 0.6, 0.06))),
        },
        {"leaf": Truth("revolute", Z), "bar": Truth("prismatic", X, parent="leaf")},
    )


def room_door() -> Thing:
    """A leaf with a lever on both sides, on one spindle."""
    lever = join(
        rod((0, -0.39, 1.05), X, 0.012, 0.2),
        *(box((x, -0.34, 1.05), (0.02, 0.11, 0.025)) for x in (-0.1, 0.1)),
    )
    return Thing(
        "Door",
        {
            "base": ("door frame", door_frame()),
            "leaf": ("door", box((0, 0, 1.02), (0.06, 0.9, 2.0))),
            "lever": ("handle", lever),
        },
        {
            "leaf": Truth("revolute", Z, (0, 0.45, 0)),
            "lever": Truth("revolute", X, (0, -0.39, 1.05), parent="leaf"),
        },
    )


def cooktop() -> Thing:
    """A row of equal knobs that stand on a plate."""
    knobs = {
        f"knob{k}": ("knob", rod((-0.25, y, 0.065), Z, 0.03, 0.03))
        for k, y in enumerate(np.linspace(-0.42, 0.42, 8))
    }
    return Thing(
        "Cooktop",
        {"base": ("plate", box((0, 0, 0.025), (0.6, 1.0, 0.05))), **knobs},
        {k: Truth("continuous", Z, (-0.25, m.centroid[1], 0)) for k, (_, m) in knobs.items()},
    )


def mill() -> Thing:
    """A pepper mill: its head turns, and doesn't come off as a bottle's cap does."""
    return Thing(
        "Pepper mill",
        {
            "base": ("body", rod((0, 0, 0.08), Z, 0.025, 0.16)),
            "head": ("lid", rod((0, 0, 0.19), Z, 0.031, 0.06)),
        },
        {"head": Truth("continuous", Z, (0, 0, 0))},
    )


THINGS: dict[str, Callable[[], Thing]] = {
    f.__name__: f
    for f in (
        cabinet,
        laptop,
        toilet,
        bucket,
        kettle,
        fan,
        display,
        suitcase,
        pedal_bin,
        sliding_window,
        clock,
        toaster,
        keyboard,
        mouse,
        washer,
        safe,
        oven,
        scissors,
        globe,
        pen,
        folding_knife,
        closed_knife,
        lamp,
        plate_lamp,
        lidded_box,
        sliding_door,
        office_chair,
        microwave,
        pump_bottle,
        rocker_switch,
        flip_phone,
        entrance,
        room_door,
        cooktop,
        mill,
    )
}
