"""Serial chains of slender parts, as in a desk lamp, and the plane in which they move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.prediction.geometric.context import Assembly
from model.prediction.geometric.proposal import UP, snapped, unit

Array = npt.NDArray[np.float64]

SLENDER = 0.4
"""Middle over long extent up to which a part can be a member of a chain."""
BENT = 0.2
"""Sine of the angle between two members, or a member and gravity, from which they span a plane."""
LYING = 0.97
"""Sine of the angle to gravity from which a member is level and may also turn about a vertical
axis."""
FLAT = 0.2
"""Sine of the largest angle between a member and the plane of its chain."""


@dataclass(frozen=True, eq=False)
class ChainPlane:
    """The plane of a chain; its members turn about the normal.

    Attributes:
        normal: (3,) unit, working frame.
        certainty: 0..1; 1 if the members span an upright plane, less if they span another one or
            only one direction together with gravity.
    """

    normal: Array
    certainty: float


def is_slender(assembly: Assembly, part: int) -> bool:
    """True if a part is long and thin."""
    return assembly.sampled.shapes[part].slenderness <= SLENDER


def chain_plane(assembly: Assembly, part: int) -> ChainPlane | None:
    """The plane of the chain that a part or its parent belongs to; None if there is none.

    Neighbours in a chain have parallel axes, so members at an angle to each other span the plane
    of motion. For members in one oblique line it is the vertical plane through them.
    """
    directions = np.array([_long(assembly, k) for k in chain_of(assembly, part)])
    if not len(directions):
        return None
    alone = np.linalg.svd(directions)
    spread = alone.S / np.sqrt(len(directions))
    if len(directions) > 1 and spread[1] > BENT / 2:
        normal = snapped(unit(alone.Vh[2]), np.eye(3), 0.15)
        if np.abs(directions @ normal).max() > FLAT:
            return None  # several joint directions
        return ChainPlane(normal, 1.0 if abs(float(normal @ UP)) < FLAT else 0.7)
    along = unit(alone.Vh[0])
    lean = float(np.linalg.norm(np.cross(along, UP)))
    if not BENT < lean < LYING:
        return None
    return ChainPlane(snapped(unit(np.cross(along, UP)), np.eye(3), 0.15), 0.5)


def chain_of(assembly: Assembly, part: int) -> list[int]:
    """Members of the chain of a part (of its parent, if the part isn't slender).

    A chain ends at a part that carries several slender parts, such as the legs of a tripod.
    """
    parent = assembly.parent
    start = part if is_slender(assembly, part) else parent[part]
    if start < 0 or not is_slender(assembly, start):
        return []
    chain, at = [start], parent[start]
    while (
        at >= 0
        and at not in chain
        and is_slender(assembly, at)
        and len(_slender_children(assembly, at)) < 2
    ):
        chain.append(at)
        at = parent[at]
    below = _slender_children(assembly, start)
    while len(below) == 1 and below[0] not in chain:
        chain.append(below[0])
        below = _slender_children(assembly, below[0])
    return chain


def _slender_children(assembly: Assembly, part: int) -> list[int]:
    return [
        k for k, above in enumerate(assembly.parent) if above == part and is_slender(assembly, k)
    ]


def _long(assembly: Assembly, part: int) -> Array:
    shape = assembly.sampled.shapes[part]
    return shape.box.axes[:, shape.order[2]]
