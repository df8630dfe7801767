"""The :class:`Joint` value, the sign of its axis, and the motion it makes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from model.core.errors import KinematicsError

JointType = Literal["revolute", "continuous", "prismatic", "fixed"]
JOINT_TYPES: tuple[JointType, ...] = get_args(JointType)


@dataclass(frozen=True)
class JointKind:
    """Properties of one joint type, and its words elsewhere. URDF, SDF and SAPIEN use our names.

    Attributes:
        unit: of q, "rad" or "m"; "" for a joint that doesn't move.
        limited: True where it needs a lower and an upper limit.
        noun: in the names that files give joints.
        mjcf: value of MJCF's ``type``; "" for a joint that MJCF doesn't write.
        usd: schema of UsdPhysics.
    """

    unit: Literal["rad", "m", ""]
    limited: bool
    noun: str
    mjcf: str
    usd: str

    @property
    def rotates(self) -> bool:
        """True where q is an angle."""
        return self.unit == "rad"

    @property
    def slides(self) -> bool:
        """True where q is a length."""
        return self.unit == "m"


JOINT_KINDS: dict[str, JointKind] = {
    "revolute": JointKind("rad", True, "hinge", "hinge", "PhysicsRevoluteJoint"),
    "continuous": JointKind("rad", False, "spin", "hinge", "PhysicsRevoluteJoint"),
    "prismatic": JointKind("m", True, "slide", "slide", "PhysicsPrismaticJoint"),
    "fixed": JointKind("", False, "fixed", "", "PhysicsFixedJoint"),
}
"""Joint type → its row; a new type is one row, and the code that only it needs."""


def value_text(q: float, rotates: bool) -> str:
    """A joint value as people read it: degrees or millimetres, to one decimal ("94.5°", "3 mm")."""
    shown = round(math.degrees(q) if rotates else 1000 * q, 1) + 0.0
    return f"{shown:.1f}".removesuffix(".0") + ("°" if rotates else " mm")


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another: q = multiplier * q(joint) + offset."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class DeclaredDynamics:
    """Resistance and limits of motion that a joint's source declares; None where it doesn't.

    Attributes:
        damping: N s/m or N m s/rad.
        friction: N or N m that must be overcome.
        effort: N or N m, most that a motor may give.
        velocity: m/s or rad/s, most that is allowed.
    """

    damping: float | None = None
    friction: float | None = None
    effort: float | None = None
    velocity: float | None = None


EFFORT = 100.0
"""N or N m. URDF demands an effort for every limit, and a scan has none."""
VELOCITY = 3.0
"""m/s or rad/s, demanded too."""


@dataclass(frozen=True)
class JointDynamics:
    """Resistance and limits of a joint's motion; N, N m, metres, radians, seconds.

    Attributes:
        damping: N s/m or N m s/rad.
        friction: N or N m that must be overcome.
        effort: most that a motor may give.
        velocity: most that is allowed.
    """

    damping: float
    friction: float
    effort: float = EFFORT
    velocity: float = VELOCITY


@dataclass(frozen=True)
class Joint:
    """One joint of an articulated object, in the object's rest frame.

    q = 0 is the pose that was scanned.

    Attributes:
        name: unique within the tree.
        type: revolute, continuous, prismatic or fixed.
        parent, child: link names.
        axis: unit vector, object frame. Positive q turns right-handed about it, or slides along it.
        origin: a point on the axis in metres, object frame.
        lower, upper: radians or metres; None for continuous and fixed.
        mimic: the joint that this one follows, or None.
        give_way: whether collision shapes are cut back over the whole range however deep they
            meet there; else only grazes are (see
            :mod:`model.physics.collision.overlap_resolution`).
        dynamics: what the source tells of the joint's own, else None; exporters write it.
    """

    name: str
    type: JointType
    parent: str
    child: str
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lower: float | None = None
    upper: float | None = None
    mimic: Mimic | None = None
    give_way: bool = False
    dynamics: DeclaredDynamics | None = None

    def __post_init__(self) -> None:
        problems = self._problems()
        if problems:
            raise KinematicsError([f"joint {self.name!r}: {p}" for p in problems])
        axis = np.asarray(self.axis, dtype=np.float64)
        norm = float(np.linalg.norm(axis))
        if self.moves and abs(norm - 1.0) > 1e-12:
            axis = axis / norm
        set_ = object.__setattr__
        set_(self, "axis", tuple(float(v) for v in axis))
        set_(self, "origin", tuple(float(v) for v in self.origin))
        if not self.limited:
            set_(self, "lower", None)
            set_(self, "upper", None)
        if not self.moves:
            set_(self, "dynamics", None)

    def _problems(self) -> list[str]:
        out: list[str] = []
        if not self.name:
            out.append("needs a name")
        if self.type not in JOINT_TYPES:
            out.append(f"type {self.type!r} is none of {', '.join(JOINT_TYPES)}")
        if self.parent == self.child:
            out.append(f"parent and child are both {self.child!r}")
        for what in ("axis", "origin"):
            value = np.asarray(getattr(self, what), dtype=np.float64)
            if value.shape != (3,) or not np.isfinite(value).all():
                out.append(f"{what} must be three finite numbers, got {getattr(self, what)}")
            elif what == "axis" and self.moves and np.linalg.norm(value) < 1e-9:
                out.append("axis must not be zero")
        if self.limited:
            if self.lower is None or self.upper is None:
                out.append(f"a {self.type} joint needs lower and upper limits")
            elif not (math.isfinite(self.lower) and math.isfinite(self.upper)):
                out.append(f"limits must be finite, got {self.lower}..{self.upper}")
            elif self.lower > self.upper:
                lower, upper = (value_text(q, self.rotates) for q in (self.lower, self.upper))
                out.append(f"lower limit {lower} is above upper limit {upper}")
        return out

    @property
    def moves(self) -> bool:
        """True where the joint has a degree of freedom."""
        return self.type != "fixed"

    @property
    def limited(self) -> bool:
        """True where the joint has limits."""
        return self.type in JOINT_KINDS and JOINT_KINDS[self.type].limited

    @property
    def rotates(self) -> bool:
        """True where q is an angle in radians."""
        return self.type in JOINT_KINDS and JOINT_KINDS[self.type].rotates

    @property
    def slides(self) -> bool:
        """True where q is a length in metres."""
        return self.type in JOINT_KINDS and JOINT_KINDS[self.type].slides

    @property
    def motion_range(self) -> tuple[float, float]:
        """Lower and upper limit; ∓π where the joint has none."""
        if not self.limited:
            return -math.pi, math.pi
        assert self.lower is not None and self.upper is not None
        return self.lower, self.upper

    def flipped(self) -> Joint:
        """The same motion with the axis pointing the other way."""
        lower = None if self.upper is None else -self.upper
        upper = None if self.lower is None else -self.lower
        axis = tuple(-v if v else 0.0 for v in self.axis)
        return replace(self, axis=axis, lower=lower, upper=upper)  # type: ignore[arg-type]


def canonical_axis_sign(joint: Joint) -> Joint:
    """The one place that decides the sign of a joint's axis.

    Positive q opens: where limits say that the joint moves further to the negative side, the axis
    is flipped. Ties and continuous joints: the largest component of the axis is positive.
    """
    if not joint.moves:
        return joint
    if joint.limited:
        assert joint.lower is not None and joint.upper is not None
        if not math.isclose(-joint.lower, joint.upper, rel_tol=1e-6, abs_tol=1e-9):
            return joint.flipped() if -joint.lower > joint.upper else joint
    axis = np.asarray(joint.axis)
    return joint.flipped() if axis[np.argmax(np.abs(axis))] < 0 else joint


def same_motion(a: Joint, b: Joint, angle: float, line: float) -> bool:
    """True if both turn, or both slide, along one axis; its sign and the limits don't count.

    Args:
        angle: between the axes, radians. line: between those of joints that turn, metres.
    """
    if a.moves != b.moves or a.rotates != b.rotates:
        return False
    along = np.asarray(b.axis)
    if abs(float(along @ np.asarray(a.axis))) < np.cos(angle):
        return False
    offset = np.asarray(b.origin) - np.asarray(a.origin)
    return not a.rotates or float(np.linalg.norm(np.cross(along, offset))) <= line


def motion(joint: Joint, q: float) -> npt.NDArray[np.float64]:
    """(4, 4) transform at one joint value, see :func:`motions`."""
    return motions(joint, np.array([q]))[0]


def motions(joint: Joint, q: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """The one place that turns (joint, q) into a motion.

    Args:
        q: (K,) radians or metres.

    Returns:
        (K, 4, 4) transforms of the child's points from the rest pose to the pose at each ``q``, in
        the object's rest frame (the parent not moved). Identity at q = 0; ``motion(j, a) @
        motion(j, b) == motion(j, a + b)``.
    """
    out = np.tile(np.eye(4), (len(q), 1, 1))
    if not joint.moves:
        return out
    axis = np.asarray(joint.axis, dtype=np.float64)
    if joint.slides:
        out[:, :3, 3] = q[:, None] * axis
        return out
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, rest = np.sin(q)[:, None, None], (1.0 - np.cos(q))[:, None, None]
    out[:, :3, :3] = np.eye(3) + sine * skew + rest * (skew @ skew)
    origin = np.asarray(joint.origin, dtype=np.float64)
    out[:, :3, 3] = origin - out[:, :3, :3] @ origin
    return out
