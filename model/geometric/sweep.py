"""How far a part moves before it runs into another, judged on surface samples alone.

Works on clouds as on meshes: it looks for points that come close to a surface they were not
close to at rest.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from model.geometric.scene import Scene
from model.geometric.shape import rotation

Array = npt.NDArray[np.float64]

MOVING_POINTS = 350


def moved(points: Array, rotates: bool, axis: Array, origin: Array, q: float) -> Array:
    """(N, 3) points after turning about, or sliding along, the axis by ``q``."""
    if not rotates:
        return points + axis * q
    return (points - origin) @ rotation(axis, q).T + origin


def free_range(
    scene: Scene,
    part: int,
    obstacles: tuple[int, ...],
    *,
    rotates: bool,
    axis: Array,
    origin: Array,
    stop: float,
    tolerance: float = 0.012,
    share: float = 0.02,
) -> float:
    """The largest q in [0, stop] (or [stop, 0]) that is reached without a new contact.

    Args:
        scene: all parts.
        part: which one moves. obstacles: which ones stand still.
        rotates, axis, origin: the motion, working frame.
        stop: rad or diagonals; its sign gives the direction.
        tolerance: distance (diagonals) at which a point touches.
        share: of the moving points that must touch to be a collision.
    """
    if not obstacles or stop == 0:
        return stop
    own = scene.shapes[part].points
    own = own[:: max(1, len(own) // MOVING_POINTS)]
    tree = scene.tree(obstacles[0]) if len(obstacles) == 1 else KDTree(scene.union(obstacles))
    rest = tree.query(own)[0]
    candidate = rest > 2.0 * tolerance
    if rotates:
        arm = own - origin
        radius = np.linalg.norm(arm - np.outer(arm @ axis, axis), axis=1)
        candidate &= radius > 3 * tolerance
        reach = float(radius.max())
    else:
        reach = 1.0
    own = own[candidate]
    if len(own) < 8:
        return stop
    needed = max(4, int(share * MOVING_POINTS))
    steps = int(np.clip(abs(stop) * reach / (1.6 * tolerance), 6, 90))
    for q in np.linspace(0, stop, steps + 1)[1:]:
        touching = tree.query(
            moved(own, rotates, axis, origin, float(q)), distance_upper_bound=tolerance
        )[0]
        if np.isfinite(touching).sum() >= needed:
            return float(q - stop / steps)
    return stop
