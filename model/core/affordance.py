"""Affordance: a place where a robot grasps a moving part."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

from model.core.errors import GeometryError
from model.core.tree import KinematicTree

AffordanceKind = Literal["grasp", "hook", "push", "turn"]
AFFORDANCE_KINDS: tuple[AffordanceKind, ...] = get_args(AffordanceKind)
UNIT_TOLERANCE = 1e-3
"""Largest difference of a direction's length from 1."""

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Affordance:
    """One place on a link from which its joint can be moved, in the link frame.

    The link frame sits at the joint's origin with the object's axes at rest, as in the URDF.

    Attributes:
        joint, link: the joint that is moved, and its child link.
        kind: grasp (pinch and pull), hook (a finger behind an edge), push (with the fingertips),
            turn (pinch across the axis).
        center: (3,) metres: between the pads, or the point that the finger touches.
        normal: (3,) unit, from the link to the hand; the hand comes against it.
        closing: (3,) unit, along which the fingers close, perpendicular to ``normal``. The closed
            fingers of a hook pull along ``closing`` × ``normal``.
        width: metres between the pads when they touch; 0 for a hook or a push.

    Raises:
        GeometryError: for an unknown kind, or values that are no directions or lengths.
    """

    joint: str
    link: str
    kind: AffordanceKind
    center: Vector
    normal: Vector
    closing: Vector
    width: float = 0.0

    def __post_init__(self) -> None:
        problems: list[str] = []
        if self.kind not in AFFORDANCE_KINDS:
            problems.append(f"kind {self.kind!r} is none of {', '.join(AFFORDANCE_KINDS)}")
        for name in ("center", "normal", "closing"):
            value = tuple(float(v) for v in getattr(self, name))
            object.__setattr__(self, name, value)
            if len(value) != 3 or not all(map(math.isfinite, value)):
                problems.append(f"{name} must be three finite numbers, got {value}")
            elif name != "center" and abs(math.hypot(*value) - 1.0) > UNIT_TOLERANCE:
                problems.append(f"{name} must have length 1, got {math.hypot(*value):.4g}")
        if not (math.isfinite(self.width) and self.width >= 0):
            problems.append(f"width must be 0 m or more, got {self.width}")
        if problems:
            raise GeometryError(f"affordance of {self.joint!r}: {'; '.join(problems)}")

    def to_json(self) -> dict[str, Any]:
        """Everything but the joint and the link, whose entry holds it."""
        values = {name: [round(v, 6) for v in getattr(self, name)]
                  for name in ("center", "normal", "closing")}  # fmt: skip
        return {"kind": self.kind, **values, "width": round(self.width, 6)}

    @classmethod
    def from_json(cls, joint: str, link: str, data: Mapping[str, Any]) -> Affordance:
        """The inverse of :meth:`to_json`.

        Raises:
            GeometryError: where an entry is missing or wrong.
        """
        try:
            vectors = [tuple(float(v) for v in data[k]) for k in ("center", "normal", "closing")]
            width = float(data.get("width", 0.0))
            return cls(joint, link, data["kind"], *vectors, width)  # type: ignore[arg-type]
        except (KeyError, TypeError, ValueError) as error:
            raise GeometryError(
                f"affordance of {joint!r} needs kind, center, normal and closing: {error}"
            ) from None


def belongs(affordance: Affordance, tree: KinematicTree) -> bool:
    """True if its joint is in ``tree``, moves, and has the same child."""
    joint = tree.by_name.get(affordance.joint)
    return joint is not None and joint.moves and joint.child == affordance.link
