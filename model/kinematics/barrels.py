"""Hinge barrels and pins: small cylinders along a hinge line."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Part
from model.core.joint import Joint
from model.core.mesh import Mesh
from model.geometry.topology import connected_shells, weld

Array = npt.NDArray[np.float64]

LEAST_CORNERS = 6
"""Fewest corners of a circular cross-section."""
ROUND = 0.06
"""Largest standard deviation of a barrel's radius over its mean."""
LONG = 0.8
"""Smallest length over diameter of a barrel: a screw's head is shorter."""
NEAR, WIDEST = 0.06, 0.03
"""Largest distance of barrels from the joint, and their largest radius, over the part's size."""
PIANO = 0.25
"""Smallest length of a hinge with a single barrel, over the part's size."""
IN_LINE = 0.5
"""Largest distance of barrels from their common line, in radii."""


@dataclass(frozen=True, eq=False)
class BarrelLine:
    """Cylinders around one line.

    Attributes:
        point: (3,) on the line, metres, object frame. radius: of the widest barrel, in metres.
        count: number of barrels.
        length: from end to end, in metres.
    """

    point: Array
    radius: float
    count: int
    length: float


@dataclass(frozen=True, eq=False)
class _Shells:
    """Connected shells of a mesh: corners (N, 3), start of each shell, boxes."""

    corners: Array
    starts: npt.NDArray[np.int64]
    low: Array
    high: Array


_CACHE: WeakKeyDictionary[Mesh, _Shells] = WeakKeyDictionary()


def barrel_line(
    parts: Iterable[Part], axis: Array, origin: Array, reach: float, widest: float
) -> BarrelLine | None:
    """Find the line of barrels near a hinge's line and parallel to it, or None.

    Barrels are separate shells of a mesh; clouds have none. Of several lines, the one with the most
    barrels is chosen, then the longest.

    Args:
        parts: both sides of the hinge, whose barrels may alternate.
        axis: (3,) unit. origin: (3,) on the hinge's line.
        reach: largest distance of barrels from it, metres. widest: their largest radius, metres.
    """
    found = [c for p in parts if p.mesh is not None for c in _near(p.mesh, axis, origin, reach)]
    round_ = [r for c in found if (r := _circle(c, axis)) is not None and r[1] <= widest]
    if not round_:
        return None
    centers = np.array([r[0] for r in round_])
    radii = np.array([r[1] for r in round_])
    ends = np.array([r[2] for r in round_])
    off = centers - np.outer(centers @ axis, axis)
    best = None
    for k in range(len(centers)):
        line = np.linalg.norm(off - off[k], axis=1) <= IN_LINE * radii[k]
        # A duplicate, or a pin in its knuckle, counts as one barrel.
        count = len(np.unique(np.round(centers[line] @ axis / max(radii[k], 1e-9))))
        length = float(ends[line, 1].max() - ends[line, 0].min())
        if best is None or (count, length) > (best.count, best.length):
            place = off[line].mean(0) + axis * float(origin @ axis)
            best = BarrelLine(place, float(radii[line].max()), count, length)
    return best


def on_barrels(joint: Joint, child: Part, parent: Part) -> Joint | None:
    """Move the joint to the line of its hinge's barrels; None without two or a long one."""
    if joint.type != "revolute" or child.mesh is None:
        return None
    size = float(np.linalg.norm(np.ptp(child.bounds, axis=0)))
    axis, origin = np.asarray(joint.axis), np.asarray(joint.origin)
    line = barrel_line((child, parent), axis, origin, NEAR * size, WIDEST * size)
    if line is None or (line.count < 2 and line.length < PIANO * size):
        return None
    return replace(joint, origin=tuple(float(v) for v in line.point))


def _near(mesh: Mesh, axis: Array, origin: Array, reach: float) -> list[Array]:
    """Corners of each shell within reach of the line."""
    if not len(mesh.faces):
        return []
    shells = _shells(mesh)
    middle, half = (shells.low + shells.high) / 2, (shells.high - shells.low) / 2
    off = middle - origin
    off = off - np.outer(off @ axis, axis)
    # A barrel's box extends at most twice its radius sideways.
    close = np.linalg.norm(off, axis=1) <= reach
    ends = np.append(shells.starts[1:], len(shells.corners))
    across = half - np.outer(half @ np.abs(axis), np.abs(axis))
    small = np.linalg.norm(across, axis=1) <= 4 * reach
    return [shells.corners[shells.starts[k] : ends[k]] for k in np.flatnonzero(close & small)]


def _circle(corners: Array, axis: Array) -> tuple[Array, float, tuple[float, float]] | None:
    """Centre, radius and ends of a cylinder along the axis; None for another shape."""
    u = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    u = u / np.linalg.norm(u)
    v = np.cross(axis, u)
    flat = np.unique(np.round(corners @ np.stack([u, v], 1), 7), axis=0)
    if len(flat) < LEAST_CORNERS:
        return None
    low, high = flat.min(0), flat.max(0)
    middle, size = (low + high) / 2, high - low
    if size.min() < 0.85 * size.max() or size.max() <= 0:
        return None
    distance = np.linalg.norm(flat - middle, axis=1)
    # Rings of a bevel and centres of caps are inside.
    rim = flat[distance > 0.9 * distance.max()]
    angles = np.sort(np.arctan2(*(rim - middle).T[::-1]))
    gap = np.diff(np.append(angles, angles[0] + 2 * np.pi)).max() if len(rim) else np.inf
    if len(rim) < LEAST_CORNERS or gap > np.pi / 2:
        return None
    solved = np.linalg.lstsq(np.column_stack([2 * rim, np.ones(len(rim))]), (rim**2).sum(1))[0]
    center = solved[:2]
    radii = np.linalg.norm(rim - center, axis=1)
    radius = float(radii.mean())
    along = corners @ axis
    ends = float(along.min()), float(along.max())
    if radii.std() > ROUND * radius or ends[1] - ends[0] < LONG * 2 * radius:
        return None
    return center[0] * u + center[1] * v + axis * (sum(ends) / 2), radius, ends


def _shells(mesh: Mesh) -> _Shells:
    if mesh not in _CACHE:
        shell = np.repeat(connected_shells(mesh, weld(mesh, 0.0)), 3)
        order = np.argsort(shell, kind="stable")
        corners = mesh.vertices[mesh.faces.reshape(-1)[order]]
        starts = np.flatnonzero(np.diff(shell[order], prepend=-1))
        _CACHE[mesh] = _Shells(
            corners,
            starts,
            np.minimum.reduceat(corners, starts, axis=0),
            np.maximum.reduceat(corners, starts, axis=0),
        )
    return _CACHE[mesh]
