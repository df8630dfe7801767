"""Convex bodies: vertices, faces, planes, and the arithmetic that decomposition needs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

FLAT = 1e-6
"""Volume below which points count as flat, in the cube of their extent."""


@dataclass(frozen=True, eq=False)
class Hull:
    """A convex polyhedron with volume.

    Attributes:
        vertices: (V, 3) corners in metres, object frame.
        faces: (F, 3) triangles, wound outwards.
        planes: (F, 4) of the faces: ``n·x + d <= 0`` inside, n unit.
        volume: m³.
    """

    vertices: FloatArray
    faces: npt.NDArray[np.int32]
    planes: FloatArray
    volume: float

    @cached_property
    def normals(self) -> FloatArray:
        """(N, 3) distinct unit normals of the faces."""
        found = np.unique(np.round(self.planes[:, :3], 4), axis=0)
        return found / np.linalg.norm(found, axis=1, keepdims=True)

    @cached_property
    def edges(self) -> FloatArray:
        """(E, 3) distinct unit directions of the edges, signs left out."""
        turned = np.roll(self.faces, -1, axis=1)
        way = self.vertices[turned.reshape(-1)] - self.vertices[self.faces.reshape(-1)]
        way = way[np.linalg.norm(way, axis=1) > 0]
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        lead = way[np.arange(len(way)), np.abs(way).argmax(axis=1)]
        return np.unique(np.round(way * np.sign(lead)[:, None], 4), axis=0)

    @cached_property
    def bounds(self) -> FloatArray:
        """(2, 3) lowest and highest corner."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @cached_property
    def thickness(self) -> float:
        """Metres: the smallest distance between two parallel planes along the faces' normals."""
        reach = self.vertices @ self.planes[:, :3].T
        return float((reach.max(axis=0) - reach.min(axis=0)).min())

    @property
    def measured(self) -> tuple[FloatArray, ...]:
        """All that overlaps are worked out from."""
        return self.vertices, self.normals, self.edges, self.bounds

    def contains(self, points: FloatArray, margin: float = 0.0) -> npt.NDArray[np.bool_]:
        """(N,) whether (N, 3) points lie inside by ``margin`` metres or more."""
        out = ((points >= self.bounds[0]) & (points <= self.bounds[1])).all(axis=1)
        near = np.flatnonzero(out)
        heights = points[near] @ self.planes[:, :3].T + self.planes[:, 3]
        out[near] = (heights <= -margin).all(axis=1)
        return out

    def moved(self, target_from_hull: FloatArray) -> Hull:
        """Under a rigid (4, 4) motion."""
        rotation, shift = target_from_hull[:3, :3], target_from_hull[:3, 3]
        normals = self.planes[:, :3] @ rotation.T
        planes = np.column_stack([normals, self.planes[:, 3] - normals @ shift])
        out = Hull(self.vertices @ rotation.T + shift, self.faces, planes, self.volume)
        for name in ("normals", "edges"):  # found once: finding them takes longer than turning them
            vars(out)[name] = getattr(self, name) @ rotation.T
        return out


def hull_of(points: FloatArray) -> Hull | None:
    """The convex hull of (N, 3) points; None where they are flat."""
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 4:
        return None
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    scale = float(np.abs(points - middle).max())
    if not scale > 0:
        return None
    try:
        found = ConvexHull((points - middle) / scale)
    except (QhullError, ValueError):
        return None
    if found.volume < FLAT:
        return None
    rank = np.full(len(points), -1, np.int32)
    rank[found.vertices] = np.arange(len(found.vertices))
    vertices, faces = points[found.vertices], rank[found.simplices]
    normal = found.equations[:, :3]
    u, v = (
        vertices[faces[:, 1]] - vertices[faces[:, 0]],
        vertices[faces[:, 2]] - vertices[faces[:, 0]],
    )
    cross = u[:, [1, 2, 0]] * v[:, [2, 0, 1]] - u[:, [2, 0, 1]] * v[:, [1, 2, 0]]
    inward = (cross * normal).sum(axis=1) < 0
    faces = np.where(inward[:, None], faces[:, ::-1], faces)
    planes = np.column_stack([normal, found.equations[:, 3] * scale - normal @ middle])
    return Hull(vertices, faces, planes, float(found.volume) * scale**3)


DUST = 1e-6
"""Share of the thickness up to which points are a single place."""


def thick_hull(points: FloatArray, thickness: float) -> Hull:
    """The hull of (N, 3) points; where they are thinner than ``thickness``, grown to it."""
    # What is far smaller than that has no directions to grow in: they drown in rounding.
    if float(np.ptp(points, axis=0).max()) < DUST * thickness:
        return _box_round(points, thickness)
    found = hull_of(points)
    if found is not None and found.thickness >= 0.99 * thickness:
        return found
    middle = points.mean(axis=0)
    axes = np.linalg.svd(points - middle, full_matrices=True)[2] if len(points) > 1 else np.eye(3)
    if found is not None:  # its thinnest direction is a face's normal, not a principal axis
        reach = found.vertices @ found.planes[:, :3].T
        axes = found.planes[np.ptp(reach, axis=0).argmin(), None, :3]
    grown = points
    for axis in axes:
        half = (thickness - float(np.ptp(grown @ axis))) / 2
        if half > 0:
            grown = np.concatenate([grown - half * axis, grown + half * axis])
    return hull_of(grown) or found or _box_round(grown, thickness)


def _box_round(points: FloatArray, thickness: float) -> Hull:
    low, high = points.min(axis=0) - thickness / 2, points.max(axis=0) + thickness / 2
    box = hull_of(np.array([[x, y, z] for x, y, z in np.ndindex(2, 2, 2)]) * (high - low) + low)
    assert box is not None
    return box


@lru_cache(maxsize=4)
def directions(count: int) -> FloatArray:
    """(count, 3) unit directions spread evenly: a Fibonacci lattice, the six axes first."""
    number = np.arange(count - 6) + 0.5
    polar, turn = np.arccos(1 - 2 * number / (count - 6)), np.pi * (1 + np.sqrt(5)) * number
    ring = np.sin(polar)
    spread = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), np.cos(polar)])
    return np.concatenate([np.eye(3), -np.eye(3), spread])


def coarse(hull: Hull, vertices: int) -> Hull:
    """With at most ``vertices`` corners, quickly: those that lie farthest in as many directions."""
    if len(hull.vertices) <= vertices:
        return hull
    middle = hull.bounds.mean(axis=0)
    # Directions are spread over the body's own proportions, so that flat bodies keep their rim.
    scaled = (hull.vertices - middle) / np.maximum(np.ptp(hull.bounds, axis=0), 1e-12)
    chosen = np.unique((scaled @ directions(vertices).T).argmax(axis=0))
    return hull_of(hull.vertices[chosen]) or hull


def simplified(hull: Hull, vertices: int) -> Hull:
    """With at most ``vertices`` corners: those that stand out most, one after the other."""
    if len(hull.vertices) <= vertices:
        return hull
    at = coarse(hull, 3 * vertices).vertices  # one by one is slow for hundreds
    axes = np.linalg.svd(at - at.mean(axis=0), full_matrices=False)[2]
    along = at @ axes.T
    chosen = list(dict.fromkeys([*along.argmin(axis=0).tolist(), *along.argmax(axis=0).tolist()]))
    growing = hull_of(at[chosen])
    if growing is None:
        return coarse(hull, vertices)
    while len(chosen) < vertices:
        out = (at @ growing.planes[:, :3].T + growing.planes[:, 3]).max(axis=1)
        farthest = int(out.argmax())
        if out[farthest] <= 1e-9 or farthest in chosen:
            break
        chosen.append(farthest)
        better = hull_of(at[chosen])
        if better is None:
            break
        growing = better
    return growing


def clipped(hull: Hull, normal: FloatArray, offset: float) -> Hull | None:
    """The half where ``normal·x <= offset``; None where nothing with volume is left."""
    height = hull.vertices @ normal - offset
    if (height <= 0).all():
        return hull
    kept = height < 0
    if not kept.any():
        return None
    pairs = np.stack([hull.faces.reshape(-1), np.roll(hull.faces, -1, axis=1).reshape(-1)], 1)
    crossing = pairs[kept[pairs[:, 0]] & ~kept[pairs[:, 1]]]
    a, b = hull.vertices[crossing[:, 0]], hull.vertices[crossing[:, 1]]
    ha, hb = height[crossing[:, 0], None], height[crossing[:, 1], None]
    cut = a + (b - a) * (ha / (ha - hb))
    return hull_of(np.concatenate([hull.vertices[kept], cut]))
