"""From options of ``export`` and ``check`` to settings of physics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import cast, get_args

from app.cli.options import PhysicsOptions
from model.core.errors import ConfigurationError
from model.core.joint import JointDynamics
from model.physics.collision.build import CollisionSettings, Method
from model.physics.collision.store import default_store
from model.physics.inertia import read_materials
from model.physics.simulation_values import SLIDING, TURNING, PhysicsSettings


def physics_settings(options: PhysicsOptions) -> PhysicsSettings:
    """Check the options and turn them into settings.

    Raises:
        ArtiworldError: naming the option and what would be right.
    """
    method = "hollow" if options.method is None else options.method
    if method not in get_args(Method):
        known = ", ".join(get_args(Method))
        raise ConfigurationError(f"no collision method {method!r}; there are {known}")
    collision = None
    if not options.no_collision:
        hulls = 24 if options.max_hulls is None else options.max_hulls
        collision = CollisionSettings(method=cast("Method", method), max_hulls=hulls)
    table = read_materials(options.materials)
    if options.material is not None:
        table = table.only(options.material)
    if (density := options.density) is not None:
        if not 0 < density < 1e5:
            raise ConfigurationError(f"--density {density:g} must be between 0 and 100000")
        table = table.with_density(density)
    default_dynamics = options.turning is None and options.sliding is None
    return PhysicsSettings(
        collision=collision,
        materials=table,
        turning=_dynamics(options.turning, "--turning", TURNING),
        sliding=_dynamics(options.sliding, "--sliding", SLIDING),
        hold=default_dynamics,
        fixed_base=not options.free_base,
        declared_masses=density is None and options.material is None and options.materials is None,
        declared_dynamics=default_dynamics,
        declared_shapes=options.method is None and options.max_hulls is None,
    )


def shape_store(options: PhysicsOptions) -> Path | None:
    """Folder of cached collision shapes; None caches none."""
    return None if options.no_cache else options.cache or default_store()


def _dynamics(text: str | None, option: str, usual: JointDynamics) -> JointDynamics:
    if text is None:
        return usual
    try:
        damping, friction = (float(word) for word in text.split(","))
    except ValueError:
        damping = friction = -1.0
    if not (0 <= damping < float("inf") and 0 <= friction < float("inf")):
        raise ConfigurationError(
            f"{option} {text!r} must be two numbers from 0 on, such as 0.1,0.05"
        )
    return replace(usual, damping=damping, friction=friction)
