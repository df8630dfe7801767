"""Mass, collision shapes and joint dynamics of an object, the same for every export format."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject, Inertial
from model.core.joint import Joint, JointDynamics
from model.core.progress import Progress, no_progress
from model.core.shapes import hull_of_shape
from model.core.tree import KinematicTree
from model.physics.collision.build import Collision, CollisionSettings, collision_of
from model.physics.collision.narrow_phase import overlaps
from model.physics.collision.overlap_resolution import moving_pairs
from model.physics.inertia import MaterialTable, inertials_of, read_materials
from model.physics.part_mesh import part_mesh

TURNING = JointDynamics(damping=0.05, friction=0.02)
"""N m s/rad and N m: a door that a finger moves and that comes to rest, a choice."""
SLIDING = JointDynamics(damping=2.0, friction=0.5)
"""N s/m and N: a drawer on rails, a choice."""
GRAVITY = 9.81
"""m/s², against :data:`UP`."""
UP = (0.0, 0.0, 1.0)
"""Up direction of an asset outside of a scene."""
HOLD = 1.5
"""Holding friction over the load of gravity."""
INNER = 0.05
"""Share of its range up to which a joint counts as at its limit."""
NAMED = 5
"""Links that are listed before "…"."""


@dataclass(frozen=True)
class PhysicsSettings:
    """Settings for computing physics.

    Attributes:
        collision: how shapes are made; None leaves them out.
        materials: densities and wall thicknesses; None is the bundled table.
        turning, sliding: dynamics of revolute and of prismatic joints.
        hold: whether a joint that gravity would move out of the scanned pose gets holding
            friction, as a laptop's hinge has.
        fixed_base: whether the root is fixed, in formats that have this (MJCF, SDF, USD).
        declared_masses, declared_dynamics, declared_shapes: whether masses, joint dynamics and
            collision shapes that the source declares are used.
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
    """Values that exporters write.

    Attributes:
        inertials: link → mass properties.
        collision: link → shapes; empty where they were left out.
        dynamics: moving joint → damping, friction, effort and velocity.
        overlapping: pairs of links whose shapes still overlap at rest; formats that can exclude
            contacts exclude theirs.
        fixed_base: whether the root is fixed.
        declared_shapes: links whose shapes the source declares.
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
    """Compute mass, collision shapes and joint dynamics.

    Declared values are used unchanged, even where they give a joint too little holding friction.

    Args:
        store: folder that keeps collision shapes and surfaces of clouds between runs, or None.

    Raises:
        ArtiworldError: for a part without geometry.
    """
    settings = settings or PhysicsSettings()
    table = settings.materials or read_materials()
    collision: Collision = {}
    declared: tuple[str, ...] = ()
    if settings.collision is not None:
        shaped = obj if settings.declared_shapes else replace(obj, shapes={})
        collision = collision_of(shaped, settings.collision, store=store, progress=progress)
        declared = tuple(sorted(collision.keys() & shaped.shapes.keys()))
    progress(1.0, "weighing the parts")
    for part in obj.parts if store is not None else ():
        if part.cloud is not None and len(part.cloud):
            part_mesh(part, store)
    inertials = inertials_of(
        obj,
        material_of=lambda part: table.of(part, obj.category),
        declared=settings.declared_masses,
    )
    return Physics(
        inertials,
        collision,
        _dynamics(obj.tree, inertials, settings),
        overlapping_pairs(obj, collision),
        settings.fixed_base,
        declared,
    )


def plain_physics(obj: ArticulatedObject) -> Physics:
    """Masses by the bundled table, no collision shapes, default dynamics."""
    return physics_of(obj, PhysicsSettings(collision=None))


def rough_physics(obj: ArticulatedObject) -> Physics:
    """Masses of solid hulls, no collision shapes, default dynamics: for driving joints alone."""
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
        own = asdict(joint.dynamics) if settings.declared_dynamics and joint.dynamics else {}
        out[joint.name] = replace(made, **{k: v for k, v in own.items() if v is not None})
    return out


def resisting(
    tree: KinematicTree,
    inertials: Mapping[str, Inertial],
    joint: Joint,
    usual: JointDynamics | None = None,
    up: npt.ArrayLike = UP,
) -> JointDynamics:
    """Return the dynamics of a joint with holding friction against gravity.

    Args:
        usual: its dynamics without; by default those of its type.
        up: see :func:`holding_load`.
    """
    usual = usual or (TURNING if joint.rotates else SLIDING)
    needed = HOLD * holding_load(tree, inertials, joint, up)
    if needed <= usual.friction:
        return usual
    return replace(usual, friction=needed, effort=max(usual.effort, 2 * needed))


def holding_load(
    tree: KinematicTree,
    inertials: Mapping[str, Inertial],
    joint: Joint,
    up: npt.ArrayLike = UP,
) -> float:
    """Return the load in N or N m that keeps a joint in the scanned pose against gravity.

    A joint scanned within its range (a laptop's lid, the arms of a lamp) is to stay wherever it is
    put, so all of the range counts; one scanned at its limit (an oven's door) is held only there.
    0 where gravity doesn't move it, or moves it against its limit.

    Args:
        up: (3,) unit, against gravity, object frame.
    """
    if joint.mimic is not None:
        return 0.0
    low, high = joint.motion_range
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
    """Derivative of the potential energy by the joint value at ``q``, N or N m."""
    step = 1e-4
    energy: list[float] = []
    for value in (q - step, q + step):
        poses = tree.pose({joint.name: value})
        heights = [
            i.mass * float(up @ (poses[k][:3, :3] @ i.center + poses[k][:3, 3]))
            for k, i in inertials.items()
            if k in poses
        ]
        energy.append(GRAVITY * sum(heights))
    return (energy[1] - energy[0]) / (2 * step)


def whose_shapes(obj: ArticulatedObject, physics: Physics) -> str:
    """Say which collision shapes are declared and which are made; "" where all are made."""
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
    """Pairs of links that move against each other and overlap at rest."""
    bodies = {link: [hull_of_shape(s) for s in shapes] for link, shapes in collision.items()}
    found = overlaps(bodies, moving_pairs(obj.tree), obj.tree.pose({}))
    return tuple(dict.fromkeys((t.a, t.b) for t in found))
