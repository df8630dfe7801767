"""A scanned cabinet with a drawer and a door, of which only the outside in front was seen."""

from __future__ import annotations

import numpy as np

from model.core.articulated_object import ArticulatedObject, Part
from model.core.geometry import PointCloud, merged_clouds
from model.core.joint import Joint
from model.core.tree import KinematicTree

WIDTH, DEPTH, HEIGHT, SPLIT = 0.6, 0.5, 0.8, 0.3
"""A cabinet with its front at y = 0; the drawer reaches up to SPLIT."""


def sheet(corner, first, second, count: int, rng, color=(150, 120, 90)) -> PointCloud:
    """Points on a parallelogram, as a scanner that sees one side gives them."""
    u = rng.random((count, 2))
    points = np.asarray(corner) + u[:, :1] * np.asarray(first) + u[:, 1:] * np.asarray(second)
    points += rng.normal(0, 5e-4, points.shape)
    colors = np.tile(np.array(color, np.uint8), (count, 1))
    return PointCloud(points.astype(np.float32), None, colors)


def cabinet(count: int = 1500) -> ArticulatedObject:
    """Its top, sides and fronts alone: nobody saw the back, the bottom and the inside."""
    rng = np.random.default_rng(0)
    w, d, h = (WIDTH, 0, 0), (0, DEPTH, 0), (0, 0, HEIGHT)
    body = merged_clouds((
        sheet((0, 0, 0), d, h, 2 * count, rng), sheet((WIDTH, 0, 0), d, h, 2 * count, rng),
        sheet((0, 0, HEIGHT), w, d, count, rng)))  # fmt: skip
    low = (0, 0, SPLIT - 0.004)
    drawer = sheet((0, 0, 0), w, low, count, rng, (200, 30, 30))
    high = (0, 0, HEIGHT - SPLIT)
    door = sheet((0, 0, SPLIT), w, high, 2 * count, rng, (30, 30, 200))
    names = {"link_0": body, "link_1": drawer, "link_2": door}
    slide = Joint("pull", "prismatic", "link_0", "link_1", (0, -1, 0), (0, 0, 0.1), 0.0, 0.35)
    swing = Joint("swing", "revolute", "link_0", "link_2", (0, 0, 1), (WIDTH, 0, 0.5), 0.0, 1.5)
    return ArticulatedObject(
        "cabinet",
        tuple(Part(link, cloud=cloud) for link, cloud in names.items()),
        KinematicTree(tuple(names), (slide, swing)),
        "StorageFurniture",
    )
