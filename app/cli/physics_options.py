"""Options of mass, collision and joint dynamics, which ``export`` and ``check`` share."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from model.core.errors import ConfigurationError

if TYPE_CHECKING:
    from model.core.joint import JointDynamics
    from model.physics.simulation_values import PhysicsSettings


def add_physics(parser: argparse.ArgumentParser) -> None:
    """The options. Those for collision shapes, masses or dynamics take the place of what an
    asset's source tells."""
    add = parser.add_argument
    add("--no-collision", action="store_true", help="leave collision shapes out")
    add("--method", metavar="NAME",
        help="make collision shapes, those that the file tells too: hollow, coacd, hull, or auto: "
             "hollow, and coacd where that is better (default: hollow, for what the file doesn't "
             "tell)")  # fmt: skip
    add("--max-hulls", type=int, metavar="N",
        help="most collision shapes a part, made for all parts (default: 24)")  # fmt: skip
    add("--density", type=float, metavar="KG", help="kg/m³ of every part, instead of the table's")
    add("--material", metavar="NAME", help="what every part is made of, such as wood or metal")
    add("--materials", type=Path, metavar="FILE",
        help="your own table, in the form of static_assets/physics/materials.json")  # fmt: skip
    for name, unit in (("turning", "N m s/rad,N m"), ("sliding", "N s/m,N")):
        add(f"--{name}", metavar="DAMPING,FRICTION", help=f"of {name} joints, in {unit}")
    add("--free-base", action="store_true",
        help="let the base move, in formats that say so (MJCF, SDF, USD)")  # fmt: skip
    add("--cache", type=Path, metavar="DIR",
        help="where collision shapes are kept (default: ~/.cache/artiworld/collision)")  # fmt: skip
    add("--no-cache", action="store_true", help="keep no collision shapes")


def physics_settings(args: argparse.Namespace) -> PhysicsSettings:
    """What the options say.

    Raises:
        ArtiworldError: naming the option and what would be right.
    """
    from model.physics.collision.build import CollisionSettings, Method
    from model.physics.materials import read_materials
    from model.physics.simulation_values import SLIDING, TURNING, PhysicsSettings

    method = args.method if args.method is not None else "hollow"
    if method not in get_args(Method):
        known = ", ".join(get_args(Method))
        raise ConfigurationError(f"no collision method {method!r}; there are {known}")
    collision = None
    if not args.no_collision:
        collision = CollisionSettings(
            method=method, max_hulls=24 if args.max_hulls is None else args.max_hulls
        )
    table = read_materials(args.materials)
    if args.material is not None:
        table = table.only(args.material)
    if args.density is not None:
        if not 0 < args.density < 1e5:
            raise ConfigurationError(f"--density {args.density:g} must be between 0 and 100000")
        table = table.with_density(args.density)
    return PhysicsSettings(
        collision, table, _dynamics(args.turning, "--turning", TURNING),
        _dynamics(args.sliding, "--sliding", SLIDING),
        args.turning is None and args.sliding is None, not args.free_base,
        args.density is None and args.material is None and args.materials is None,
        args.turning is None and args.sliding is None,
        args.method is None and args.max_hulls is None,
    )  # fmt: skip


def store_folder(args: argparse.Namespace) -> Path | None:
    """Where collision shapes are kept, or None."""
    from model.physics.collision.store import default_store

    return None if args.no_cache else args.cache or default_store()


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
