"""All that a simulator needs beside shapes and joints, worked out once for every format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from model.collision.build import Collision, CollisionSettings, collision_of
from model.collision.relief import moving_pairs, overlaps
from model.collision.shapes import hull_of_shape
from model.exporters.inertia import inertials_of
from model.exporters.materials import MaterialTable, read_materials
from model.kinematics.articulated_object import ArticulatedObject
from model.kinematics.urdf import Inertial, JointDynamics
from model.progress import Progress, no_progress

TURNING = JointDynamics(damping=0.05, friction=0.02)
"""N m s/rad and N m: a door that a finger moves and that comes to rest."""
SLIDING = JointDynamics(damping=2.0, friction=0.5)
"""N s/m and N: a drawer on rails."""


@dataclass(frozen=True)
class PhysicsSettings:
    """What people may change of it.

    Attributes:
        collision: how shapes are made; None leaves them out.
        materials: densities and walls; None is the table that ships.
        turning, sliding: dynamics of revolute and of prismatic joints.
        fixed_base: whether the root stands still, in formats that say so (MJCF, SDF, USD).
    """

    collision: CollisionSettings | None = field(default_factory=CollisionSettings)
    materials: MaterialTable | None = None
    turning: JointDynamics = TURNING
    sliding: JointDynamics = SLIDING
    fixed_base: bool = True


@dataclass(frozen=True, eq=False)
class Physics:
    """What exporters write.

    Attributes:
        inertials: link → mass properties.
        collision: link → shapes; empty where they were left out.
        dynamics: joint → damping, friction, effort and velocity of those that move.
        touching: pairs of links whose shapes overlap at rest all the same; formats that can tell
            the simulator to let them pass.
        fixed_base: whether the root stands still.
    """

    inertials: Mapping[str, Inertial]
    collision: Collision
    dynamics: Mapping[str, JointDynamics]
    touching: tuple[tuple[str, str], ...] = ()
    fixed_base: bool = True


def physics_of(
    obj: ArticulatedObject,
    settings: PhysicsSettings | None = None,
    *,
    store: Path | None = None,
    progress: Progress = no_progress,
) -> Physics:
    """Work out mass, collision shapes and joint dynamics.

    Args:
        store: where collision shapes are kept between runs; None keeps none.

    Raises:
        ArtiworldError: for a part without geometry.
    """
    settings = settings or PhysicsSettings()
    table = settings.materials or read_materials()
    collision: Collision = {}
    if settings.collision is not None:
        collision = collision_of(obj, settings.collision, store=store, progress=progress)
    inertials = inertials_of(obj, material_of=lambda part: table.of(part, obj.category))
    dynamics = {
        j.name: settings.turning if j.rotates else settings.sliding
        for j in obj.tree.joints if j.moves
    }  # fmt: skip
    return Physics(
        inertials, collision, dynamics, touching_pairs(obj, collision), settings.fixed_base
    )


def plain_physics(obj: ArticulatedObject) -> Physics:
    """Masses by the table that ships, no collision shapes, the usual dynamics."""
    return physics_of(obj, PhysicsSettings(collision=None))


def rough_physics(obj: ArticulatedObject) -> Physics:
    """Masses of filled hulls, no collision shapes, the usual dynamics: for driving joints alone."""
    settings = PhysicsSettings(collision=None)
    dynamics = {
        j.name: settings.turning if j.rotates else settings.sliding
        for j in obj.tree.joints if j.moves
    }  # fmt: skip
    return Physics(inertials_of(obj), {}, dynamics)


def touching_pairs(obj: ArticulatedObject, collision: Collision) -> tuple[tuple[str, str], ...]:
    """Pairs of links that move against each other and whose shapes overlap at rest."""
    bodies = {link: [hull_of_shape(s) for s in held] for link, held in collision.items()}
    found = overlaps(bodies, moving_pairs(obj.tree), obj.tree.pose({}))
    return tuple(dict.fromkeys((t.a, t.b) for t in found))
