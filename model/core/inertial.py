"""Mass properties of links: moving and combining them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, eq=False)
class Inertial:
    """Mass properties of a link at rest.

    Attributes:
        mass: kg.
        center: (3,) centre of mass in metres, object frame.
        tensor: (3, 3) inertia about ``center`` in kg m², object-frame axes.
    """

    mass: float
    center: npt.NDArray[np.float64]
    tensor: npt.NDArray[np.float64]

    @property
    def exact_tensor(self) -> npt.NDArray[np.float64]:
        """``tensor`` to 12 digits, without products of inertia that are rounding errors."""
        least = 1e-12 * np.abs(self.tensor).max()
        exact = [0.0 if abs(v) < least else float(f"{v:.12g}") for v in self.tensor.ravel()]
        return np.reshape(exact, (3, 3))

    def moved(self, matrix: npt.NDArray[np.float64]) -> Inertial:
        """The same mass under (4, 4) ``matrix``: a rotation, a uniform scale, a translation."""
        linear = matrix[:3, :3]
        center = linear @ self.center + matrix[:3, 3]
        return Inertial(self.mass, center, linear @ self.tensor @ linear.T)


def together(inertials: Sequence[Inertial]) -> Inertial:
    """Those of several bodies that are fixed to each other; at least one."""
    if len(inertials) == 1:
        return inertials[0]
    mass = sum(i.mass for i in inertials)
    center = np.sum([i.mass * i.center for i in inertials], axis=0) / mass
    tensor = np.zeros((3, 3))
    for i in inertials:
        arm = i.center - center
        tensor += i.tensor + i.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Inertial(mass, center, tensor)


def inertial_problems(inertials: Mapping[str, Inertial]) -> list[str]:
    """Links with mass properties that no rigid body can have."""
    out: list[str] = []
    for link, inertial in inertials.items():
        if not (np.isfinite(inertial.center).all() and np.isfinite(inertial.tensor).all()):
            out.append(f"{link}: inertia is not a number")
            continue
        values = np.linalg.eigvalsh(inertial.tensor)
        if not inertial.mass > 0 or not values[0] > 0:
            out.append(f"{link}: mass and inertia must be above 0")
        elif values[0] + values[1] < values[2] * (1 - 1e-9):
            out.append(f"{link}: inertia breaks the triangle inequality")
    return out
