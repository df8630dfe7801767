"""A cabinet with a door and a drawer that move as they should, and ways to spoil it."""

from __future__ import annotations

import trimesh

from model.core.articulated_object import ArticulatedObject, Part
from model.core.joint import Joint, Mimic
from tests.builders import box, linked, part, slide

W = 0.02
"""Boards."""


def carcass() -> list[trimesh.Trimesh]:
    """0.8 wide, 0.4 deep, 0.6 high, open at y = 0, with a board between left and right."""
    return [
        box([-0.4, 0, 0], [0.4, 0.4, W]),
        box([-0.4, 0, 0.6 - W], [0.4, 0.4, 0.6]),
        box([-0.4, 0, 0], [-0.4 + W, 0.4, 0.6]),
        box([0.4 - W, 0, 0], [0.4, 0.4, 0.6]),
        box([-W / 2, 0, 0], [W / 2, 0.4, 0.6]),
        box([-0.4, 0.4 - W, 0], [0.4, 0.4, 0.6]),
    ]


def door_part() -> Part:
    """Over the left half, 2 mm before the carcass."""
    return part("link_1", box([-0.4, -W - 0.002, 0], [-0.002, -0.002, 0.6]), name="door")


def drawer_part() -> Part:
    """In the right half, 2 mm off the boards."""
    x0, x1, z0, z1 = W / 2 + 0.002, 0.4 - W - 0.002, W + 0.002, 0.3
    t = 0.01
    return part(
        "link_2",
        box([x0, -W - 0.002, z0], [x1, -0.002, z1]),
        box([x0, 0, z0], [x1, 0.35, z0 + t]),
        box([x0, 0, z0], [x0 + t, 0.35, z1]),
        box([x1 - t, 0, z0], [x1, 0.35, z1]),
        box([x0, 0.35 - t, z0], [x1, 0.35, z1]),
        box([x0, -0.004, z0], [x1, t, z1]),
        name="drawer",
    )


DOOR = Joint(
    "door", "revolute", "link_0", "link_1", (0, 0, -1), (-0.4, -0.002, 0.3), lower=0, upper=1.7
)
DRAWER = Joint("drawer", "prismatic", "link_0", "link_2", (0, -1, 0), lower=0, upper=0.28)


BOARD = part("link_0", box([0, 0, -0.05], [1, 0.5, 0]), name="base")
PUSHER = slide("pusher", "link_1", 0.3)


def followers(multiplier: float) -> ArticulatedObject:
    """Two blocks on a board; the second follows the first, and has 0.1 m to go."""
    return linked(
        (slide("a", "link_1", 0.1), slide("b", "link_2", 0.1, mimic=Mimic("a", multiplier))),
        BOARD,
        part("link_1", box([0.1, 0.1, 0], [0.2, 0.2, 0.1])),
        part("link_2", box([0.1, 0.3, 0], [0.2, 0.4, 0.1])),
    )


def pushed(stop: Joint) -> ArticulatedObject:
    """A drawer that runs into a block, which ``stop`` holds and no joint connects to it."""
    return linked(
        (PUSHER, stop),
        BOARD,
        part("link_1", box([0.1, 0.1, 0.001], [0.2, 0.2, 0.1]), name="drawer"),
        part("link_2", box([0.3, 0.1, 0.001], [0.33, 0.13, 0.03]), name="stop"),
    )


def cabinet(door: Joint = DOOR, drawer: Joint = DRAWER, *more: trimesh.Trimesh):
    """The cabinet; ``more`` belongs to the carcass."""
    body = part("link_0", *carcass(), *more, name="carcass")
    return linked((door, drawer), body, door_part(), drawer_part(), name="cabinet")
