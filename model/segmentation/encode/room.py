"""Recognise scanned rooms: floor and walls connect nothing, and clicks mean whole objects."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from model.core.asset import Asset
from model.core.geometry import PointCloud
from model.geometry.crop import ROOM_METRES, floor_and_walls, largest_component
from model.segmentation.arrays import Bool, Float32
from model.segmentation.encode.nodes import Nodes
from model.segmentation.encode.superpoints import Superpoints

_LEAST_FLOOR, _BAND, _LEVEL = 0.05, 0.06, 0.9
"""Least share of nodes on a floor, its unevenness in metres, least vertical part of its normal."""
_LOWEST = 0.25
"""Metres above the lowest points in which a floor is searched."""
_SINGLE = 0.7
"""Share of a wide scan without a floor in one piece, above which it is a single object."""
_CUT = 9.0
"""Strength of links between floor or walls and the rest: a certain cut."""


@dataclass(frozen=True, eq=False)
class Room:
    """Borders of a room.

    Attributes:
        border: (C,) superpoints of floor, ceiling and walls.
        position: (C, 3) float32 metres, in a frame with most walls along x and y, z = 0 on the
            floor.
    """

    border: Bool
    position: Float32


def room_of(asset: Asset, nodes: Nodes, superpoints: Superpoints) -> Room | None:
    """The room that a scan shows, or None if it shows a single object.

    A room is wide and has a floor; a room whose floor and walls were cropped falls into pieces.
    """
    if asset.cloud is None or np.ptp(nodes.points[:, :2], axis=0).max() < ROOM_METRES:
        return None
    border, floor = np.zeros(len(superpoints), bool), _floor(superpoints)
    if floor is not None:
        on_border = floor_and_walls(Asset(asset.name, cloud=PointCloud(nodes.points)))
        border = (
            np.bincount(superpoints.of_node, on_border, len(superpoints)) > 0.5 * superpoints.size
        )
    elif largest_component(nodes.points).mean() > _SINGLE:
        return None
    yaw = _yaw(superpoints, border)
    cos, sin = np.cos(yaw), np.sin(yaw)
    turned = superpoints.center @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    turned[:, 2] -= np.percentile(nodes.points[:, 2], 1) if floor is None else floor
    return Room(border, turned.astype(np.float32))


def _floor(superpoints: Superpoints) -> float | None:
    """Height of the floor, horizontal and below everything else; None if there is none."""
    height, weight = superpoints.center[:, 2], superpoints.size / superpoints.size.sum()
    length = np.maximum(np.linalg.norm(superpoints.normal, axis=1), 1e-9)
    level = np.abs(superpoints.normal[:, 2]) / length > _LEVEL
    order = np.argsort(height, kind="stable")
    low = float(height[order[np.searchsorted(np.cumsum(weight[order]), 0.001)]])
    best, found = _LEAST_FLOOR, None
    for bottom in np.arange(low - _BAND, low + _LOWEST, _BAND / 2):
        inside = level & (height >= bottom) & (height < bottom + _BAND)
        if (share := float(weight[inside].sum())) > best:
            best, found = share, float(np.median(height[inside]))
    return found


def _yaw(superpoints: Superpoints, border: Bool) -> float:
    """Radians, 0 to pi/2: the commonest direction of vertical surfaces."""
    normal = superpoints.normal / np.maximum(
        np.linalg.norm(superpoints.normal, axis=1, keepdims=True), 1e-9
    )
    upright = np.abs(normal[:, 2]) < 0.3
    angle = np.arctan2(normal[upright, 1], normal[upright, 0])
    weight = superpoints.size[upright] * (1 + 2 * border[upright])
    if not len(angle):
        return 0.0
    counts, _ = np.histogram(angle % (np.pi / 2), 90, (0, np.pi / 2), weights=weight)
    smooth = counts + np.roll(counts, 1) + np.roll(counts, -1)
    middle = (smooth.argmax() + 0.5) * np.pi / 180
    # The mean of the directions near it, on the circle of quarter turns.
    off = (angle - middle + np.pi / 4) % (np.pi / 2) - np.pi / 4
    near = np.abs(off) < np.radians(3)
    return float(middle + np.average(off[near], weights=weight[near]))


def with_borders_cut(superpoints: Superpoints, room: Room) -> Superpoints:
    """The superpoints with certain cuts between floor or walls and everything else."""
    links = superpoints.links
    across = room.border[links.a] != room.border[links.b]
    strength = np.where(across, _CUT * links.count, links.strength)
    weakest = np.exp(-_CUT) * links.count
    conductance = np.where(across, np.minimum(links.conductance, weakest), links.conductance)
    return replace(superpoints, links=replace(links, strength=strength, conductance=conductance))
