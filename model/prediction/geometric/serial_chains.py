"""Arms that hang on each other, as a desk lamp's: the plane in which such a chain moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.prediction.geometric.context import Assembly
from model.prediction.geometric.hypothesis import UP, snapped, unit

Array = npt.NDArray[np.float64]

SLENDER = 0.4
"""Middle over long extent up to which a part counts as an arm."""
BENT = 0.2
"""Sine of the angle between two arms, or of an arm and gravity, from which they span a plane."""
LYING = 0.97
"""Sine of the angle to gravity from which an arm lies: it may turn about an upright axis too."""
FLAT = 0.2
"""How far (sine) an arm may lie off the plane of its chain."""


@dataclass(frozen=True, eq=False)
class ArmPlane:
    """Where the arms of one chain lie; all of them turn about its normal.

    Attributes:
        normal: (3,) unit, working frame.
        sureness: 0..1: 1 for arms that span it together with gravity, less for arms alone or for
            one arm and gravity.
    """

    normal: Array
    sureness: float


def is_arm(assembly: Assembly, part: int) -> bool:
    """Whether it is long and thin."""
    return assembly.scene.shapes[part].slenderness <= SLENDER


def arm_plane(assembly: Assembly, part: int) -> ArmPlane | None:
    """The plane of the chain of arms that a part belongs to or hangs on; None where there is none.

    Neighbours in a chain have parallel axes, so arms that are bent against each other show the
    plane that they move in. It is upright where gravity would fold them within it. Of arms in
    one line that lean only gravity tells it.
    """
    directions = np.array([_long(assembly, k) for k in chain_of(assembly, part)])
    if not len(directions):
        return None
    alone = np.linalg.svd(directions)
    spread = alone.S / np.sqrt(len(directions))
    if len(directions) > 1 and spread[1] > BENT / 2:
        normal = snapped(unit(alone.Vh[2]), np.eye(3), 0.15)
        if np.abs(directions @ normal).max() > FLAT:
            return None  # they turn about several directions
        return ArmPlane(normal, 1.0 if abs(float(normal @ UP)) < FLAT else 0.7)
    along = unit(alone.Vh[0])
    lean = float(np.linalg.norm(np.cross(along, UP)))
    if not BENT < lean < LYING:
        return None
    return ArmPlane(snapped(unit(np.cross(along, UP)), np.eye(3), 0.15), 0.5)


def chain_of(assembly: Assembly, part: int) -> list[int]:
    """The arms in line with a part: it and those above and below, or those that it hangs on.

    Several arms on one part, as the legs of a tripod or of glasses, each go their own way: there
    a chain ends.
    """
    parent = assembly.parent
    start = part if is_arm(assembly, part) else parent[part]
    if start < 0 or not is_arm(assembly, start):
        return []
    chain, at = [start], parent[start]
    while at >= 0 and at not in chain and is_arm(assembly, at) and len(_arms_on(assembly, at)) < 2:
        chain.append(at)
        at = parent[at]
    below = _arms_on(assembly, start)
    while len(below) == 1 and below[0] not in chain:
        chain.append(below[0])
        below = _arms_on(assembly, below[0])
    return chain


def _arms_on(assembly: Assembly, part: int) -> list[int]:
    return [k for k, above in enumerate(assembly.parent) if above == part and is_arm(assembly, k)]


def _long(assembly: Assembly, part: int) -> Array:
    shape = assembly.scene.shapes[part]
    return shape.box.axes[:, shape.order[2]]
