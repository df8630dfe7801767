"""Collision shapes: convex polyhedra, primitives and meshes, in the object frame at rest.

Hulls can be grown to a minimal thickness, or cut by a plane.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from model.core.geometry import affine, uniform_scale

FloatArray = npt.NDArray[np.float64]
Kind = Literal["box", "cylinder", "sphere", "capsule"]

FLAT = 1e-6
"""Volume below which points count as flat, over the cube of half their extent."""
SIDES = 32
"""Sides of the polyhedron that encloses a round primitive."""
MOST_CORNERS = 64
"""Vertices of the hull that replaces a mesh in measurements; PhysX takes no more either."""


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
        """(E, 3) distinct unit directions of the edges, up to sign."""
        turned = np.roll(self.faces, -1, axis=1)
        edge = self.vertices[turned.reshape(-1)] - self.vertices[self.faces.reshape(-1)]
        edge = edge[np.linalg.norm(edge, axis=1) > 0]
        edge /= np.linalg.norm(edge, axis=1, keepdims=True)
        lead = edge[np.arange(len(edge)), np.abs(edge).argmax(axis=1)]
        return np.unique(np.round(edge * np.sign(lead)[:, None], 4), axis=0)

    @cached_property
    def bounds(self) -> FloatArray:
        """(2, 3) lowest and highest corner."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @cached_property
    def thickness(self) -> float:
        """Smallest extent along a face normal, metres."""
        reach = self.vertices @ self.planes[:, :3].T
        return float((reach.max(axis=0) - reach.min(axis=0)).min())

    @property
    def measured(self) -> tuple[FloatArray, ...]:
        """The arrays that overlaps are computed from."""
        return self.vertices, self.normals, self.edges, self.bounds

    def contains(self, points: FloatArray, margin: float = 0.0) -> npt.NDArray[np.bool_]:
        """(N,) whether (N, 3) points lie inside by ``margin`` metres or more."""
        out = np.ones(len(points), bool)
        for value, low, high in zip(points.T, *self.bounds, strict=True):
            out &= (value >= low) & (value <= high)  # reducing rows of three takes far longer
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
        for name in ("normals", "edges"):  # rotating them is faster than finding them
            vars(out)[name] = getattr(self, name) @ rotation.T
        return out


def hull_of(points: FloatArray) -> Hull | None:
    """Return the convex hull of (N, 3) points; None where they are flat."""
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


@lru_cache(maxsize=4)
def directions(count: int) -> FloatArray:
    """Return (count, 3) evenly spread unit directions: the six axes, then a Fibonacci lattice."""
    number = np.arange(count - 6) + 0.5
    polar, turn = np.arccos(1 - 2 * number / (count - 6)), np.pi * (1 + np.sqrt(5)) * number
    ring = np.sin(polar)
    spread = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), np.cos(polar)])
    return np.concatenate([np.eye(3), -np.eye(3), spread])


def coarse(hull: Hull, vertices: int) -> Hull:
    """Keep at most ``vertices`` vertices, quickly: the farthest ones in as many directions."""
    if len(hull.vertices) <= vertices:
        return hull
    middle = hull.bounds.mean(axis=0)
    # Directions are spread in the body's proportions, so that flat bodies keep their rim.
    scaled = (hull.vertices - middle) / np.maximum(np.ptp(hull.bounds, axis=0), 1e-12)
    chosen = np.unique((scaled @ directions(vertices).T).argmax(axis=0))
    return hull_of(hull.vertices[chosen]) or hull


def simplified(hull: Hull, vertices: int) -> Hull:
    """Keep at most ``vertices`` vertices, adding the farthest one in turn."""
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


@dataclass(frozen=True, eq=False)
class Primitive:
    """A box, cylinder, sphere or capsule.

    Attributes:
        kind: which.
        object_from_shape: (4, 4) its pose at rest; cylinders and capsules lie along z.
        sizes: metres: the three edges of a box, (radius, length) of a cylinder, (radius,) of a
            sphere, (radius, length without the caps) of a capsule.
    """

    kind: Kind
    object_from_shape: FloatArray
    sizes: tuple[float, ...]

    @cached_property
    def hull(self) -> Hull:
        """A polyhedron that encloses the primitive."""
        found = hull_of(
            self._corners() @ self.object_from_shape[:3, :3].T + self.object_from_shape[:3, 3]
        )
        assert found is not None
        return found

    def _corners(self) -> FloatArray:
        if self.kind == "box":
            return (np.array(list(np.ndindex(2, 2, 2))) - 0.5) * self.sizes
        turn = np.arange(SIDES) * 2 * np.pi / SIDES
        ring = np.column_stack([np.cos(turn), np.sin(turn)]) / np.cos(np.pi / SIDES)
        radius = self.sizes[0]
        half = self.sizes[1] / 2 if len(self.sizes) > 1 else 0.0
        if self.kind == "cylinder":
            level = np.repeat([-half, half], SIDES)[:, None]
            return np.column_stack([np.tile(ring * radius, (2, 1)), level])
        tilt = np.linspace(-np.pi / 2, np.pi / 2, SIDES // 2 + 1)
        rise = np.sin(tilt) * radius / np.cos(np.pi / SIDES)
        level = np.repeat(rise + np.where(rise < 0, -half, half), SIDES)[:, None]
        wide = np.repeat(np.cos(tilt), SIDES)[:, None] * np.tile(ring, (len(tilt), 1)) * radius
        if half:
            belt = np.repeat([-half, half], SIDES)[:, None]
            level = np.concatenate([level, belt])
            wide = np.concatenate([wide, np.tile(ring * radius, (2, 1))])
        return np.column_stack([wide, level])


@dataclass(frozen=True, eq=False)
class Solid:
    """A collision mesh declared by a source, convex or not.

    Simulators that need convex shapes take its hull.

    Attributes:
        vertices: (V, 3) metres.
        faces: (F, 3) triangles.
    """

    vertices: FloatArray
    faces: npt.NDArray[np.int32]

    @cached_property
    def hull(self) -> Hull:
        """The convex hull, not simplified."""
        found = hull_of(self.vertices)
        assert found is not None, "a mesh without a volume is no collision shape"
        return found

    @cached_property
    def rough(self) -> Hull:
        """The hull with at most :data:`MOST_CORNERS` vertices."""
        return simplified(self.hull, MOST_CORNERS)


Shape: TypeAlias = Primitive | Hull | Solid


def hull_of_shape(shape: Shape) -> Hull:
    """Return the hull, a primitive's enclosing polyhedron, or a mesh's simplified hull."""
    if isinstance(shape, Hull):
        return shape
    return shape.rough if isinstance(shape, Solid) else shape.hull


def moved_shape(shape: Shape, target_from_shape: FloatArray) -> Shape:
    """Transform by (4, 4): a rotation, a uniform scale above 0, a translation."""
    linear, shift = target_from_shape[:3, :3], target_from_shape[:3, 3]
    if isinstance(shape, Solid):
        return Solid(shape.vertices @ linear.T + shift, shape.faces)
    if isinstance(shape, Hull):
        made = hull_of(shape.vertices @ linear.T + shift)
        assert made is not None
        return made
    scale = uniform_scale(linear)
    pose = affine(
        linear / scale @ shape.object_from_shape[:3, :3],
        linear @ shape.object_from_shape[:3, 3] + shift,
    )
    return Primitive(shape.kind, pose, tuple(scale * size for size in shape.sizes))


DUST = 1e-6
"""Extent, as a share of the thickness, up to which points count as a single one."""


def thick_hull(points: FloatArray, thickness: float) -> Hull:
    """Return the hull of (N, 3) points, grown to ``thickness`` metres where it is thinner."""
    # Far smaller points have no reliable directions to grow in.
    if float(np.ptp(points, axis=0).max()) < DUST * thickness:
        return _box_around(points, thickness)
    found = hull_of(points)
    if found is not None and found.thickness >= 0.99 * thickness:
        return found
    middle = points.mean(axis=0)
    axes = np.linalg.svd(points - middle, full_matrices=True)[2] if len(points) > 1 else np.eye(3)
    if found is not None:  # the thinnest direction is a face normal, not a principal axis
        reach = found.vertices @ found.planes[:, :3].T
        axes = found.planes[np.ptp(reach, axis=0).argmin(), None, :3]
    grown = points
    for axis in axes:
        half = (thickness - float(np.ptp(grown @ axis))) / 2
        if half > 0:
            grown = np.concatenate([grown - half * axis, grown + half * axis])
    return hull_of(grown) or found or _box_around(grown, thickness)


def _box_around(points: FloatArray, thickness: float) -> Hull:
    low, high = points.min(axis=0) - thickness / 2, points.max(axis=0) + thickness / 2
    box = hull_of(np.array([[x, y, z] for x, y, z in np.ndindex(2, 2, 2)]) * (high - low) + low)
    assert box is not None
    return box


def clipped(hull: Hull, normal: FloatArray, offset: float) -> Hull | None:
    """Return the half where ``normal·x <= offset``; None where it has no volume."""
    height = hull.vertices @ normal - offset
    if (height <= 0).all():
        return hull
    kept = height < 0
    if not kept.any():
        return None
    pairs = np.stack([hull.faces.reshape(-1), np.roll(hull.faces, -1, axis=1).reshape(-1)], 1)
    edges = pairs[kept[pairs[:, 0]] & ~kept[pairs[:, 1]]]
    a, b = hull.vertices[edges[:, 0]], hull.vertices[edges[:, 1]]
    ha, hb = height[edges[:, 0], None], height[edges[:, 1], None]
    cut = a + (b - a) * (ha / (ha - hb))
    return hull_of(np.concatenate([hull.vertices[kept], cut]))
