"""Plain versions of everyday things with their true joints, a table and functions.

Objects face -x and stand on z = 0. They are rough on purpose: what is tested is the rule, not the
modelling.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

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


def thing(category: str, *rows: Any) -> Thing:
    """Rows have the key and name of a part, its joint where it moves, and the meshes it is of."""
    parts, truth = {}, {}
    for key, name, *pieces in rows:
        parts[key] = name, join(*(p for p in pieces if not isinstance(p, Truth)))
        truth.update((key, p) for p in pieces if isinstance(p, Truth))
    return Thing(category, parts, truth)


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


def toilet() -> Thing:
    bowl = join(rod((0, 0, 0.2), Z, 0.19, 0.4), box((0.28, 0, 0.45), (0.18, 0.4, 0.4)))
    seat = trimesh.creation.annulus(r_min=0.11, r_max=0.19, height=0.02, sections=40)
    seat.apply_translation((0, 0, 0.415))
    return thing(
        "Toilet",
        ("base", "toilet_body", bowl),
        ("seat", "seat", Truth("revolute", Y, (0.19, 0, 0.41)), seat),
        ("lid", "lid", Truth("revolute", Y, (0.19, 0, 0.43)), rod((0, 0, 0.437), Z, 0.19, 0.02)),
    )


def fan() -> Thing:
    hub = rod((-0.06, 0, 0.5), X, 0.025, 0.03)
    blades = [
        turned(box((-0.06, 0.09, 0.5), (0.004, 0.14, 0.06)), X, (0, 0, 0.5), a)
        for a in (0, 90, 180, 270)
    ]
    return thing(
        "Fan",
        (
            "base",
            "fan_base",
            rod((0, 0, 0.01), Z, 0.12, 0.02),
            rod((0, 0, 0.25), Z, 0.012, 0.48),
            rod((0, 0, 0.5), X, 0.05, 0.09),
        ),
        ("rotor", "rotor", Truth("continuous", X, (0, 0, 0.5)), hub, *blades),
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
    return thing(
        "Scissors",
        ("base", "leg", turned(blade, Z, (0, 0, 0), 15)),
        ("leg", "leg", Truth("revolute", Z, (0, 0, 0)), turned(other, Z, (0, 0, 0), -15)),
    )


def globe() -> Thing:
    tilt = np.array([np.sin(0.41), 0.0, np.cos(0.41)])
    return thing(
        "Globe",
        (
            "base",
            "globe_base",
            rod((0, 0, 0.01), Z, 0.1, 0.02),
            rod((0, 0, 0.05), Z, 0.01, 0.07),
            arc((0, 0, 0.25), Y, 0.165, 0.006, 20, 200),
        ),
        (
            "sphere",
            "sphere",
            Truth("continuous", tuple(tilt), (0, 0, 0.25)),
            ball((0, 0, 0.25), 0.15),
            rod(np.array((0, 0, 0.25)), tilt, 0.004, 0.34),
        ),
    )


def lamp() -> Thing:
    lower = rod((0, 0.02, 0.2), Z, 0.01, 0.36)
    upper = turned(rod((0, 0.04, 0.56), Z, 0.01, 0.36), Y, (0, 0, 0.38), -60)
    tip = np.array((-0.312, 0.04, 0.56))
    head = join(rod(np.add(tip, (-0.02, 0.02, -0.03)), Z, 0.05, 0.1))
    return thing(
        "Lamp",
        ("base", "lamp_base", rod((0, 0, 0.01), Z, 0.1, 0.02), rod((0, 0, 0.025), Y, 0.012, 0.05)),
        ("lower", "arm", Truth("revolute", Y, (0, 0, 0.03)), lower),
        ("upper", "arm", Truth("revolute", Y, (0, 0, 0.38), "lower"), upper),
        ("head", "head", Truth("revolute", Y, tuple(tip), "upper"), head),
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
    return thing(
        "Lamp",
        ("base", "lamp_base", foot_plate),
        ("lower", "arm", Truth("revolute", Y, tuple(foot)), strip(foot, elbow, 0.008)),
        ("upper", "arm", Truth("revolute", Y, tuple(elbow), "lower"), strip(elbow, wrist, 0.016)),
        ("head", "head", Truth("revolute", Y, tuple(wrist), "upper"), head),
    )


def lidded_box() -> Thing:
    body = turned(carcass((0, 0, 0), (0.2, 0.4, 0.3)), Y, (0, 0, 0), 90)
    body.apply_translation((0, 0, 0.1))
    return thing(
        "Box",
        ("base", "box_body", body),
        (
            "lid",
            "rotation_lid",
            Truth("revolute", Y, (0.15, 0, 0.2)),
            box((0, 0, 0.21), (0.3, 0.4, 0.02)),
            box((-0.16, 0, 0.2), (0.02, 0.05, 0.04)),
        ),
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


def door_frame() -> trimesh.Trimesh:
    posts = [box((0, y, 1.05), (0.1, 0.08, 2.1)) for y in (-0.5, 0.5)]
    return join(*posts, box((0, 0, 2.08), (0.1, 1.0, 0.08)))


def entrance(side: float = -1.0) -> Thing:
    """A leaf with a bar that is pushed, on the side ``side`` of x."""
    return thing(
        "Door",
        ("base", "door frame", door_frame()),
        ("leaf", "door", Truth("revolute", Z), box((0, 0, 1.02), (0.06, 0.9, 2.0))),
        (
            "bar",
            "push bar paddle",
            Truth("prismatic", X, parent="leaf"),
            box((side * 0.06, 0, 1.0), (0.03, 0.6, 0.06)),
        ),
    )


def room_door() -> Thing:
    """A leaf with a lever on both sides, on one spindle."""
    lever = join(
        rod((0, -0.39, 1.05), X, 0.012, 0.2),
        *(box((x, -0.34, 1.05), (0.02, 0.11, 0.025)) for x in (-0.1, 0.1)),
    )
    return thing(
        "Door",
        ("base", "door frame", door_frame()),
        ("leaf", "door", Truth("revolute", Z, (0, 0.45, 0)), box((0, 0, 1.02), (0.06, 0.9, 2.0))),
        ("lever", "handle", Truth("revolute", X, (0, -0.39, 1.05), parent="leaf"), lever),
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
    return thing(
        "Pepper mill",
        ("base", "body", rod((0, 0, 0.08), Z, 0.025, 0.16)),
        ("head", "lid", Truth("continuous", Z, (0, 0, 0)), rod((0, 0, 0.19), Z, 0.031, 0.06)),
    )


TABLE = """
cabinet StorageFurniture
base furniture_body | carcass .25 0 .5 .5 .8 1 | box .25 0 .7 .48 .78 .02
left rotation_door revolute Z 0 -.395 0 | box -.01 -.2 .35 .02 .39 .68
   | box -.035 -.05 .4 .03 .015 .12
right rotation_door revolute Z 0 .395 0 | box -.01 .2 .35 .02 .39 .68
   | box -.035 .05 .4 .03 .015 .12
drawer drawer prismatic X | tray .22 0 .84 .42 .7 .2 | box -.01 0 .85 .02 .78 .28
   | box -.035 0 .85 .03 .15 .015

laptop Laptop
base laptop_base | box 0 0 .01 .24 .34 .02
screen screen revolute Y .12 0 .025 | box 0 0 .03 .24 .34 .01 turned Y .12 0 .025 110

bucket Bucket
base bucket_body | tube 0 0 .15 .15 .3 | rod 0 0 .005 Z .15 .01
handle handle revolute Y 0 0 .28 | arc 0 0 .28 X .16 .005 -90 90

kettle Kettle
base kettle_body | rod 0 0 .08 Z .09 .16 | rod -.11 0 .12 -1,0,1 .012 .1
lid lid prismatic Z | rod 0 0 .165 Z .06 .01 | rod 0 0 .18 Z .012 .02

display Display
base display_base | box .02 0 .01 .2 .3 .02 | box .03 0 .15 .02 .05 .28
screen rotation_screen revolute Y .015 0 .24 | box 0 0 .33 .03 .55 .32

pedal_bin TrashCan
base trashcan_body | tube 0 0 .2 .15 .4 | rod 0 0 .01 Z .15 .02
lid lid revolute Y .15 0 .4 | rod 0 0 .41 Z .15 .02
pedal foot_pad revolute Y -.14 0 .03 | box -.17 0 .03 .06 .08 .015

sliding_window Window
base window_frame | box 0 -.5 .5 .08 .04 1 | box 0 .5 .5 .08 .04 1 | box 0 0 .02 .08 1 .04
   | box 0 0 .98 .08 1 .04
a translation_window prismatic Y | box -.02 -.23 .5 .02 .5 .92
b translation_window prismatic Y | box .02 .23 .5 .02 .5 .92

clock Clock
base clock_body | rod 0 0 .2 X .2 .04
hour hand continuous X 0 0 .2 | box -.025 0 .24 .004 .012 .1
minute hand continuous X 0 0 .2 | box -.032 0 .26 .004 .01 .15 turned X 0 0 .2 60

toaster Toaster
base toaster_body | box 0 0 .1 .16 .28 .18
slider slider prismatic Z | box 0 -.15 .14 .04 .03 .015
knob knob continuous Y 0 0 .06 | rod 0 -.145 .06 Y .015 .015

mouse Mouse
base mouse_body | box 0 0 .015 .11 .06 .03
wheel wheel continuous Y -.035 0 .028 | rod -.035 0 .028 Y .01 .006
left button prismatic Z | box -.035 -.017 .0315 .035 .022 .003
right button prismatic Z | box -.035 .017 .0315 .035 .022 .003

washer WashingMachine
base body | carcass .3 0 .42 .6 .6 .85
door door revolute Z 0 -.2 0 | rod -.015 0 .42 X .2 .03 | box -.04 .17 .42 .03 .015 .08
knob knob continuous X 0 .15 .77 | rod -.02 .15 .77 X .03 .04

safe Safe
base safe_body | carcass .2 0 .2 .4 .4 .4
door door revolute Z 0 -.19 0 | box -.015 0 .2 .03 .38 .38
knob knob continuous X 0 .12 .2 on door | rod -.045 .12 .2 X .03 .03

pen Pen
base pen_body | rod 0 0 .006 X .005 .1 | rod -.055 0 .006 X .003 .02
cap cap prismatic X | rod -.045 0 .006 X .0062 .045

folding_knife Knife
base knife_body | box .06 0 .01 .12 .025 .016
blade rotation_blade revolute Z .003 0 .01 | box -.045 0 .01 .1 .02 .003

closed_knife Knife
base knife_body | box 0 0 .01 .12 .025 .016
blade rotation_blade revolute Z -.039 0 .01 | box 0 0 .01 .085 .012 .003 turned Z -.042 0 .01 -6

sliding_door Door
base door_frame | box 0 -.9 1 .1 .06 2 | box 0 .9 1 .1 .06 2 | box 0 0 1.97 .1 1.8 .06
   | box 0 0 .02 .1 1.8 .04
a translation_door prismatic Y | box -.025 -.42 1 .03 .88 1.88
b translation_door prismatic Y | box .025 .42 1 .03 .88 1.88

microwave Microwave
base microwave_body | carcass .18 -.06 .15 .36 .38 .3 | box .18 .19 .15 .36 .12 .3
door door revolute Z 0 -.245 0 | box -.01 -.06 .15 .02 .37 .28
tray rotation_tray continuous Z .17 -.06 0 | rod .17 -.06 .035 Z .14 .01
knob knob continuous X 0 .19 .1 | rod -.01 .19 .1 X .022 .02
button button prismatic X | box -.003 .19 .05 .006 .05 .02

pump_bottle Dispenser
base dispenser_body | rod 0 0 .08 Z .035 .16 | rod 0 0 .17 Z .012 .02
head pressing_lid prismatic Z | rod 0 0 .2 Z .006 .04 | box -.012 0 .222 .05 .014 .012

rocker_switch Switch
base switch_frame | box .006 0 .06 .012 .08 .12
rocker toggle_button revolute Y 0 0 .06 | box -.004 0 .06 .012 .03 .06

flip_phone Phone
base phone_base | box 0 0 .005 .09 .045 .01
flip flip_cover revolute Y .045 0 .012 | box -0 0 .016 .09 .045 .008 turned Y .045 0 .012 160
"""
"""A thing a block: its name and category, then a row a part: key, name and, where it moves, type,
axis and a point of its joint (``on`` another part than the base), and the solids it is of."""
SHAPES = {f.__name__: f for f in (box, rod, tube, carcass, tray, arc)}
AXES = {"X": X, "Y": Y, "Z": Z}


def axis_of(word: str) -> Any:
    return AXES[word] if word in AXES else tuple(map(float, word.split(",")))


def solid(text: str) -> trimesh.Trimesh:
    """A shape's name, its center and what its function takes after that."""
    text, _, turn = text.partition(" turned ")
    kind, x, y, z, *rest = text.split()
    values: list[Any] = [axis_of(w) if w[-1] in AXES or "," in w else float(w) for w in rest]
    values = [values] if kind in ("box", "carcass", "tray") else values
    made = SHAPES[kind]((float(x), float(y), float(z)), *values)
    if not turn:
        return made
    axis, *point, degrees = turn.split()
    return turned(made, AXES[axis], tuple(map(float, point)), float(degrees))


def row_of(text: str) -> list[Any]:
    head, *solids = text.split("|")
    about, _, parent = head.partition(" on ")
    key, name, *joint = about.split()
    made: list[Any] = [solid(s) for s in solids]
    if joint:
        kind, axis, *point = joint
        at: Any = tuple(map(float, point)) or None
        made.append(Truth(kind, axis_of(axis), at, parent.strip() or "base"))
    return [key, name, *made]


def from_table(block: str) -> Thing:
    head, *rows = block.replace("\n   |", " |").splitlines()
    return thing(head.partition(" ")[2], *map(row_of, rows))


THINGS: dict[str, Callable[[], Thing]] = {
    block.split()[0]: partial(from_table, block) for block in TABLE.strip().split("\n\n")
}
MADE = """toilet fan suitcase keyboard oven scissors globe lamp plate_lamp lidded_box office_chair
    entrance room_door cooktop mill"""
THINGS |= {name: globals()[name] for name in MADE.split()}
