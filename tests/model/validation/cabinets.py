"""A cabinet with a door and a drawer that move as they should, and ways to spoil it."""

from __future__ import annotations

import trimesh

from model.core.articulated_object import ArticulatedObject, Part
from model.core.joint import Joint
from model.core.tree import KinematicTree
from tests.builders import box, part

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


def cabinet(door: Joint = DOOR, drawer: Joint = DRAWER, *more: trimesh.Trimesh):
    """The cabinet; ``more`` belongs to the carcass."""
    parts = (part("link_0", *carcass(), *more, name="carcass"), door_part(), drawer_part())
    tree = KinematicTree(("link_0", "link_1", "link_2"), (door, drawer))
    return ArticulatedObject("cabinet", parts, tree)
