"""All that a simulator needs beside shapes and joints, worked out once for every format."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject
from model.core.inertial import Inertial
from model.core.joint import Joint, JointDynamics
from model.core.progress import Progress, no_progress
from model.core.shapes import hull_of_shape
from model.core.tree import KinematicTree
from model.physics.collision.build import Collision, CollisionSettings, collision_of
from model.physics.collision.narrow_phase import overlaps
from model.physics.collision.overlap_resolution import moving_pairs
from model.physics.inertia import inertials_of
from model.physics.materials import MaterialTable, read_materials
from model.physics.part_mesh import part_mesh

TURNING = JointDynamics(damping=0.05, friction=0.02)
"""N m s/rad and N m: a door that a finger moves and that comes to rest."""
SLIDING = JointDynamics(damping=2.0, friction=0.5)
"""N s/m and N: a drawer on rails."""
GRAVITY = 9.81
"""m/s², against UP."""
UP = (0.0, 0.0, 1.0)
"""Where an asset that stands alone has its up."""
HOLD = 1.5
"""Friction of a joint that holds itself, over what gravity asks for."""
INNER = 0.05
"""Share of its range that a joint must be away from both ends to stand somewhere in between."""
NAMED = 5
"""Links that are named before "…"."""


@dataclass(frozen=True)
class PhysicsSettings:
    """What people may change of it.

    Attributes:
        collision: how shapes are made; None leaves them out.
        materials: densities and walls; None is the table that ships.
        turning, sliding: dynamics of revolute and of prismatic joints.
        hold: whether a joint that gravity would move out of the scanned pose has the friction to
            hold itself, as a laptop's hinge has.
        fixed_base: whether the root stands still, in formats that say so (MJCF, SDF, USD).
        declared_masses, declared_dynamics, declared_shapes: whether what the object's source tells of masses,
            joint dynamics and collision shapes counts.
    """

    collision: CollisionSettings | None = field(default_factory=CollisionSettings)
    materials: MaterialTable | None = None
    turning: JointDynamics = TURNING
    sliding: JointDynamics = SLIDING
    hold: bool = True
    fixed_base: bool = True
    declared_masses: bool = True
    declared_dynamics: bool = True
    declared_shapes: bool = True


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
        declared_shapes: links whose shapes are those of the object's source.
    """

    inertials: Mapping[str, Inertial]
    collision: Collision
    dynamics: Mapping[str, JointDynamics]
    overlapping: tuple[tuple[str, str], ...] = ()
    fixed_base: bool = True
    declared_shapes: tuple[str, ...] = ()


def physics_of(
    obj: ArticulatedObject,
    settings: PhysicsSettings | None = None,
    *,
    store: Path | None = None,
    progress: Progress = no_progress,
) -> Physics:
    """Work out mass, collision shapes and joint dynamics.

    What the object's source tells of masses, dynamics and collision shapes is taken as it is, also
    where a joint would not hold itself by its friction then.

    Args:
        store: where collision shapes, and surfaces through clouds, are kept between runs; None
            keeps none.

    Raises:
        ArtiworldError: for a part without geometry.
    """
    settings = settings or PhysicsSettings()
    table = settings.materials or read_materials()
    collision: Collision = {}
    told: tuple[str, ...] = ()
    if settings.collision is not None:
        shaped = obj if settings.declared_shapes else replace(obj, shapes={})
        collision = collision_of(shaped, settings.collision, store=store, progress=progress)
        told = tuple(sorted(collision.keys() & shaped.shapes.keys()))
    progress(1.0, "weighing the parts")
    for part in obj.parts if store is not None else ():
        if part.cloud is not None and len(part.cloud):
            part_mesh(part, store)
    inertials = inertials_of(
        obj, material_of=lambda part: table.of(part, obj.category), told=settings.declared_masses
    )
    return Physics(
        inertials, collision, _dynamics(obj.tree, inertials, settings),
        overlapping_pairs(obj, collision), settings.fixed_base, told,
    )  # fmt: skip


def plain_physics(obj: ArticulatedObject) -> Physics:
    """Masses by the table that ships, no collision shapes, the usual dynamics."""
    return physics_of(obj, PhysicsSettings(collision=None))


def rough_physics(obj: ArticulatedObject) -> Physics:
    """Masses of filled hulls, no collision shapes, the usual dynamics: for driving joints alone."""
    settings = PhysicsSettings(collision=None)
    inertials = inertials_of(obj)
    return Physics(inertials, {}, _dynamics(obj.tree, inertials, settings))


def _dynamics(
    tree: KinematicTree, inertials: Mapping[str, Inertial], settings: PhysicsSettings
) -> dict[str, JointDynamics]:
    out: dict[str, JointDynamics] = {}
    for joint in tree.joints:
        if not joint.moves:
            continue
        made = settings.turning if joint.rotates else settings.sliding
        if settings.hold:
            made = resisting(tree, inertials, joint, made)
        told = asdict(joint.dynamics) if settings.declared_dynamics and joint.dynamics else {}
        out[joint.name] = replace(made, **{k: v for k, v in told.items() if v is not None})
    return out


def resisting(
    tree: KinematicTree,
    inertials: Mapping[str, Inertial],
    joint: Joint,
    usual: JointDynamics | None = None,
    up: npt.ArrayLike = UP,
) -> JointDynamics:
    """The dynamics of a joint that holds itself against gravity.

    Args:
        usual: what it has anyway; None is what its type has.
        up: see :func:`holding_load`.
    """
    usual = usual or (TURNING if joint.rotates else SLIDING)
    asked = HOLD * holding_load(tree, inertials, joint, up)
    if asked <= usual.friction:
        return usual
    return replace(usual, friction=asked, effort=max(usual.effort, 2 * asked))


def holding_load(
    tree: KinematicTree,
    inertials: Mapping[str, Inertial],
    joint: Joint,
    up: npt.ArrayLike = UP,
) -> float:
    """N or N m that a joint resists so that gravity doesn't move it out of the scanned pose; 0
    where nothing does, or its limit is in the way.

    What stands somewhere within its range (a laptop's lid, the arms of a lamp) is made to stay
    where it is put, so all of the range counts; what rests at an end of it (an oven's door) is
    only held there.

    Args:
        up: (3,) unit, against gravity, object frame.
    """
    if joint.mimic is not None:
        return 0.0
    low, high = (joint.lower, joint.upper) if joint.limited else (-math.pi, math.pi)
    assert low is not None and high is not None
    against = np.asarray(up, np.float64)
    load = _load(tree, inertials, joint, 0.0, against)
    edge = INNER * (high - low)
    if (low > -edge and load > 0) or (high < edge and load < 0):
        return 0.0
    if low > -edge or high < edge or abs(load) < (TURNING if joint.rotates else SLIDING).friction:
        return abs(load)
    values = np.linspace(low, high, 13)
    return max(abs(_load(tree, inertials, joint, q, against)) for q in values)


def _load(
    tree: KinematicTree,
    inertials: Mapping[str, Inertial],
    joint: Joint,
    q: float,
    up: npt.NDArray[np.float64],
) -> float:
    """Gravity's energy over the joint's value, at ``q``, in N or N m; above 0 where it falls
    towards lower values."""
    step = 1e-4
    energy: list[float] = []
    for value in (q - step, q + step):
        poses = tree.pose({joint.name: value})
        heights = [
            i.mass * float(up @ (poses[k][:3, :3] @ i.center + poses[k][:3, 3]))
            for k, i in inertials.items() if k in poses
        ]  # fmt: skip
        energy.append(GRAVITY * sum(heights))
    return (energy[1] - energy[0]) / (2 * step)


def whose_shapes(obj: ArticulatedObject, physics: Physics) -> str:
    """Which collision shapes are the source's and which are made, for people; "" where all are
    made."""
    if not physics.declared_shapes:
        return ""
    made = [p.link for p in obj.parts if p.link not in physics.declared_shapes]
    if not made:
        return "all collision shapes are the file's own"
    whose = f"collision shapes of {_listed(physics.declared_shapes)} are the file's own"
    return f"{whose}, those of {_listed(made)} are made"


def _listed(links: Sequence[str]) -> str:
    return ", ".join(links[:NAMED]) + (", …" if len(links) > NAMED else "")


def overlapping_pairs(obj: ArticulatedObject, collision: Collision) -> tuple[tuple[str, str], ...]:
    """Pairs of links that move against each other and whose shapes overlap at rest."""
    bodies = {link: [hull_of_shape(s) for s in held] for link, held in collision.items()}
    found = overlaps(bodies, moving_pairs(obj.tree), obj.tree.pose({}))
    return tuple(dict.fromkeys((t.a, t.b) for t in found))
