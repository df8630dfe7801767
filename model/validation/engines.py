"""Physics engines that can drive an object's joints, behind one small protocol."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject
from model.core.errors import ConfigurationError
from model.core.joint import Joint
from model.core.packages import at_place, install_command
from model.physics.simulation_values import Physics

FloatArray = npt.NDArray[np.float64]

STEP = 0.002
"""Seconds."""
MUJOCO, SAPIEN = "mujoco", "sapien"


@dataclass(frozen=True)
class Drive:
    """A critically damped position drive.

    Attributes:
        stiffness: N/m or N m/rad.
        damping: N s/m or N m s/rad.
        most: N or N m, limit of its force.
    """

    stiffness: float
    damping: float
    most: float


@dataclass(frozen=True)
class Touch:
    """Shapes of two links that touch.

    Attributes:
        a, b: link names.
        gap: metres; negative where they overlap.
        where: (3,) metres, object frame.
    """

    a: str
    b: str
    gap: float
    where: tuple[float, float, float]


class Engine(Protocol):
    """An object with a fixed base in an engine, whose joints are driven to targets.

    Constructed from (object, its J drivable joints, physics); raises ``ValueError`` where the
    engine refuses the object.
    """

    title: str
    """For people."""

    def set_drives(self, drives: Sequence[Drive]) -> None:
        """One for each joint; those that follow another need none but may use it."""
        ...

    def rest(self, q: FloatArray) -> None:
        """Put the joints at (J,) values, at rest, with their targets there."""
        ...

    def set_gravity(self, along_z: float) -> None:
        """In m/s²."""
        ...

    def step(self, targets: FloatArray) -> None:
        """Simulate :data:`STEP` seconds with (J,) targets; those of followers have no meaning."""
        ...

    @property
    def q(self) -> FloatArray:
        """(J,) joint values, radians or metres."""
        ...

    @property
    def force(self) -> FloatArray:
        """(J,) of the drives, N or N m."""
        ...

    @property
    def stable(self) -> bool:
        """True if all values are finite numbers."""
        ...

    def touches(self) -> list[Touch]:
        """Present contacts."""
        ...


@dataclass(frozen=True)
class EngineInfo:
    """Location and requirements of an engine.

    Attributes:
        title: display name. module: that must be installed. extra: of artiworld, installs it.
        place: of its class.
    """

    title: str
    module: str
    extra: str
    place: str

    @property
    def installed(self) -> bool:
        """True if its package is installed."""
        return importlib.util.find_spec(self.module) is not None

    @property
    def command(self) -> str:
        """Command that installs it."""
        return install_command(f"artiworld[{self.extra}]")

    def build(self, obj: ArticulatedObject, joints: Sequence[Joint], physics: Physics) -> Engine:
        """Load an object.

        Raises:
            ValueError: where the engine refuses it.
        """
        return at_place(self.place)(obj, joints, physics)


ENGINES = {
    MUJOCO: EngineInfo("MuJoCo", "mujoco", "physics", "model.validation.simulators:Mujoco"),
    SAPIEN: EngineInfo("SAPIEN", "sapien", "sapien", "model.validation.simulators:Sapien"),
}


def require_engines(text: str, option: str = "--engine") -> tuple[str, ...]:
    """Parse comma-separated engines, and check that they are installed.

    Raises:
        ConfigurationError: where one isn't known or installed.
    """
    names = tuple(dict.fromkeys(n.strip() for n in text.split(",") if n.strip()))
    for name in names:
        if name not in ENGINES:
            known = ", ".join(ENGINES)
            raise ConfigurationError(f"{option}: there is no engine {name!r}; there are {known}")
        if not ENGINES[name].installed:
            raise ConfigurationError(
                f"{option} needs {ENGINES[name].title}, which isn't installed; "
                f"{ENGINES[name].command}"
            )
    if not names:
        raise ConfigurationError(f"{option} needs one of {', '.join(ENGINES)}")
    return names


@dataclass(frozen=True)
class Load:
    """Load of a joint at rest.

    Attributes:
        inertia: kg along its axis, or kg m² about it.
        mass: kg.
        lever: metres from its axis to the centre of mass, across the axis; 1 for a slide.
    """

    inertia: float
    mass: float
    lever: float


def load_of(obj: ArticulatedObject, joint: Joint, physics: Physics) -> Load:
    """The load of a joint: its child and all that hangs on it, in the scanned pose."""
    links = [x for x in obj.tree.descendants(joint.child) if x in physics.inertials]
    found = [physics.inertials[link] for link in links]
    mass = sum(i.mass for i in found)
    if not joint.rotates or not mass:
        return Load(mass, mass, 1.0)
    axis, origin = np.asarray(joint.axis), np.asarray(joint.origin)
    about = sum(
        float(axis @ i.tensor @ axis)
        + i.mass * float((np.cross(axis, np.asarray(i.center) - origin) ** 2).sum())
        for i in found
    )
    center = np.sum([i.mass * np.asarray(i.center) for i in found], axis=0) / mass
    return Load(about, mass, float(np.linalg.norm(np.cross(center - origin, axis))))
