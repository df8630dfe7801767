"""Simple mass properties, so that every simulator takes the asset.

A scan tells nothing of what is inside. The link is taken as its convex hull, filled evenly at a
density between that of hollow furniture and of wood. Values are plausible and always valid
(positive definite, within the triangle inequality); who needs the real ones must weigh the thing.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.kinematics.articulated_object import ArticulatedObject, Part
from model.kinematics.urdf import Inertial

DENSITY = 300.0
"""kg/m³ of the filled hull."""
MIN_MASS = 1e-3
"""kg. Lighter links upset solvers."""
MIN_RADIUS = 1e-3
"""Metres: nothing turns more easily than a ball of this radius and the same mass."""
HELPER = Inertial(1e-2, np.zeros(3), np.eye(3) * 1e-5)
"""For links without geometry, which simulators want to have mass where they move."""

FloatArray = npt.NDArray[np.float64]


def inertials_of(obj: ArticulatedObject, density: float = DENSITY) -> dict[str, Inertial]:
    """Link → mass properties. A root without geometry has none: it stands still."""
    parts = {p.link: p for p in obj.parts}
    out: dict[str, Inertial] = {}
    for link in obj.tree.links:
        part = parts.get(link)
        points = np.zeros((0, 3)) if part is None else part_points(part)
        if len(points):
            out[link] = hull_inertial(points, density)
        elif link != obj.tree.root:
            center = np.asarray(obj.tree.joint_of[link].origin, dtype=np.float64)
            out[link] = Inertial(HELPER.mass, center, HELPER.tensor)
    return out


def part_points(part: Part) -> FloatArray:
    """(N, 3) vertices that faces use, or points; empty for empty geometry."""
    if part.mesh is not None and len(part.mesh.faces):
        return part.mesh.vertices[np.unique(part.mesh.faces)]
    if part.cloud is not None:
        return part.cloud.points.astype(np.float64)
    return np.zeros((0, 3))


def hull_inertial(points: npt.ArrayLike, density: float = DENSITY) -> Inertial:
    """Mass properties of the filled convex hull of (N, 3) points; of their box where it is flat.

    Args:
        points: metres; at least one.
        density: kg/m³.
    """
    at = np.asarray(points, dtype=np.float64)
    found = _hull(at)
    volume, center, tensor = found if found is not None else _thick_box(at)
    mass = max(density * volume, MIN_MASS)
    tensor = tensor * (mass / volume)
    # A small ball at the centre of mass: keeps slivers turning like something real.
    tensor = tensor + np.eye(3) * 0.4 * mass * MIN_RADIUS**2
    return Inertial(mass, center, (tensor + tensor.T) / 2)


def _hull(points: FloatArray) -> tuple[float, FloatArray, FloatArray] | None:
    """Volume, centre (3,) and inertia (3, 3) at unit density about it; None where it is flat."""
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 4:
        return None
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    scale = float(np.abs(points - middle).max())
    if scale <= 0:
        return None
    try:
        hull = ConvexHull((points - middle) / scale)
    except QhullError:
        return None
    inside = hull.points[hull.vertices].mean(axis=0)
    corners = hull.points[hull.simplices] - inside
    # Fans from a point inside: each tetrahedron counts positive.
    cross = np.cross(corners[:, 1], corners[:, 2])
    volumes = np.abs(np.einsum("fi,fi->f", corners[:, 0], cross)) / 6
    volume = float(volumes.sum())
    if volume < 1e-6:
        return None
    center = np.einsum("f,fi->i", volumes, corners.sum(axis=1) / 4) / volume
    # Second moments of a tetrahedron with one corner at 0 (Tonon, 2004).
    sums = corners.sum(axis=1)
    moments = np.einsum("f,fi,fj->ij", volumes, sums, sums) / 20
    moments += np.einsum("f,fci,fcj->ij", volumes, corners, corners) / 20
    moments -= volume * np.outer(center, center)
    tensor = np.trace(moments) * np.eye(3) - moments
    return volume * scale**3, (center + inside) * scale + middle, tensor * scale**5


def _thick_box(points: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """As :func:`_hull`, of the principal box, given a least thickness."""
    mean = points.mean(axis=0)
    axes = np.linalg.svd(points - mean, full_matrices=True)[2] if len(points) > 1 else np.eye(3)
    local = (points - mean) @ axes.T
    low, high = local.min(axis=0), local.max(axis=0)
    size = np.maximum(high - low, max(0.01 * float((high - low).max()), 2 * MIN_RADIUS))
    volume = float(np.prod(size))
    squares = size**2
    diagonal = volume * (squares.sum() - squares) / 12
    return volume, mean + axes.T @ ((low + high) / 2), axes.T @ np.diag(diagonal) @ axes
