"""What simulators collide: primitives, convex polyhedra, and meshes that a source has for it; in
the object frame at rest."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from model.physics.collision.hulls import Hull, hull_of, simplified

Kind = Literal["box", "cylinder", "sphere", "capsule"]
SIDES = 32
"""Of the polyhedron that stands for a round primitive."""

MOST_CORNERS = 64
"""Of the hull that stands for a mesh where shapes are measured; PhysX takes no more either."""

FloatArray = npt.NDArray[np.float64]


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
        """A polyhedron that holds the primitive."""
        found = hull_of(self._corners() @ self.object_from_shape[:3, :3].T
                        + self.object_from_shape[:3, 3])  # fmt: skip
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
    """A mesh that a source has for collisions, convex or not; simulators that need convex shapes
    take its hull.

    Attributes:
        vertices: (V, 3) metres.
        faces: (F, 3) triangles.
    """

    vertices: FloatArray
    faces: npt.NDArray[np.int32]

    @cached_property
    def hull(self) -> Hull:
        """Its convex hull, whole."""
        found = hull_of(self.vertices)
        assert found is not None, "a mesh without a volume is no collision shape"
        return found

    @cached_property
    def rough(self) -> Hull:
        """Its hull with at most :data:`MOST_CORNERS` corners."""
        return simplified(self.hull, MOST_CORNERS)


Shape: TypeAlias = Primitive | Hull | Solid


def hull_of_shape(shape: Shape) -> Hull:
    """The polyhedron of a shape; of a primitive one that holds it, of a mesh a rough one."""
    if isinstance(shape, Hull):
        return shape
    return shape.rough if isinstance(shape, Solid) else shape.hull


def moved_shape(shape: Shape, target_from_shape: FloatArray) -> Shape:
    """Under (4, 4): a rotation, a uniform scale above 0, a translation."""
    linear, shift = target_from_shape[:3, :3], target_from_shape[:3, 3]
    if isinstance(shape, Solid):
        return Solid(shape.vertices @ linear.T + shift, shape.faces)
    if isinstance(shape, Hull):
        made = hull_of(shape.vertices @ linear.T + shift)
        assert made is not None
        return made
    scale = float(np.cbrt(np.linalg.det(linear)))
    pose = np.eye(4)
    pose[:3, :3] = linear / scale @ shape.object_from_shape[:3, :3]
    pose[:3, 3] = linear @ shape.object_from_shape[:3, 3] + shift
    return Primitive(shape.kind, pose, tuple(scale * size for size in shape.sizes))
