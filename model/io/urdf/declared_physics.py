"""Declared physics of a URDF: masses, collision shapes, joint dynamics; ``urdf_reader`` reads the
rest.

It isn't needed to move an object, so a mistake in it is a remark, not an error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from model.core.affordance import Affordance, belongs
from model.core.articulated_object import ArticulatedObject
from model.core.inertial import Inertial, inertial_problems
from model.core.joint import DeclaredDynamics
from model.core.rotations import rotation_from_rpy
from model.core.shapes import Shape
from model.io.urdf.collision import DeclaredCollision, declared_shapes

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

ROUNDED = 0.01
"""By how much the largest moment of inertia may exceed the sum of the others, relatively, to be
taken for a rounding error."""
_NAMED = 3

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DeclaredPhysics:
    """Masses, joint dynamics and collision shapes as a file has them, in the object's rest frame.

    Attributes:
        inertials: by link.
        dynamics: by joint.
        notes: human-readable remarks on skipped content.
        collision: by link; its meshes aren't loaded.
        affordances: where a robot takes hold.
    """

    inertials: Mapping[str, Inertial] = field(default_factory=dict)
    dynamics: Mapping[str, DeclaredDynamics] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    collision: Mapping[str, DeclaredCollision] = field(default_factory=dict)
    affordances: tuple[Affordance, ...] = ()

    def of(self, obj: ArticulatedObject) -> ArticulatedObject:
        """``obj`` with the declared physics of its links and joints, collision meshes loaded; what
        can't be loaded of these is a remark of the part."""
        joints = tuple(replace(j, dynamics=self.dynamics.get(j.name)) for j in obj.tree.joints)
        links = set(obj.tree.links)
        inertials = {link: i for link, i in self.inertials.items() if link in links}
        obj = replace(obj, tree=replace(obj.tree, joints=joints), inertials=inertials)
        shapes: dict[str, tuple[Shape, ...]] = {}
        remarks: dict[str, list[str]] = {}
        for link in obj.tree.links:
            held = declared_shapes((link,), self.collision, remarks.setdefault(link, []))
            if held:
                shapes[link] = held
        parts = tuple(replace(p, remarks=(*p.remarks, *remarks[p.link])) for p in obj.parts)
        kept = tuple(a for a in self.affordances if belongs(a, obj.tree))
        return replace(obj, parts=parts, shapes=shapes, affordances=kept)


def read_declared_physics(
    robot: Element, object_from_link: Mapping[str, FloatArray]
) -> DeclaredPhysics:
    """Declared physics of the file, by the names that links and joints have there.

    Args:
        robot: the document's root.
        object_from_link: link → (4, 4) at rest.
    """
    inertials: dict[str, Inertial] = {}
    wrong: list[str] = []
    for link in robot.findall("link"):
        name, element = link.get("name", ""), link.find("inertial")
        if element is None or _massless(link, element):
            continue
        try:
            inertials[name] = _inertial(element).moved(object_from_link[name])
        except ValueError:
            wrong.append(repr(name))
    notes: tuple[str, ...] = ()
    if wrong:
        named = ", ".join(wrong[:_NAMED]) + (", …" if len(wrong) > _NAMED else "")
        which = f"link {named}" if len(wrong) == 1 else f"links {named}"
        notes = (f"{which}: mass and inertia are none that a body can have; they were left out",)
    dynamics = {
        joint.get("name", ""): declared
        for joint in robot.findall("joint")
        if (declared := _dynamics(joint)) != DeclaredDynamics()
    }
    return DeclaredPhysics(inertials, dynamics, notes)


def _massless(link: Element, inertial: Element) -> bool:
    """True if it is a frame of declared zero mass, which is no mistake."""
    mass = inertial.find("mass")
    bare = link.find("visual") is None and link.find("collision") is None
    try:
        return bare and (mass is None or float(mass.get("value", "0")) == 0)
    except ValueError:
        return False


def _inertial(element: Element) -> Inertial:
    """In the link's frame.

    Raises:
        ValueError: where no body has it.
    """
    origin, tensor, mass = (element.find(tag) for tag in ("origin", "inertia", "mass"))
    if tensor is None or mass is None:
        raise ValueError("incomplete")
    xx, xy, xz, yy, yz, zz = (_one(tensor, k) or 0.0 for k in
                              ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))  # fmt: skip
    turned = rotation_from_rpy(_three(origin, "rpy"))
    own = turned @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turned.T
    found = Inertial(_one(mass, "value") or 0.0, _three(origin, "xyz"), _balanced(own))
    if inertial_problems({"": found}):
        raise ValueError("no body has it")
    return found


def _balanced(tensor: FloatArray) -> FloatArray:
    """Reduce moments that rounding put over the triangle inequality."""
    values, axes = np.linalg.eigh(tensor)
    most = values[0] + values[1]
    if not most < values[2] <= most * (1 + ROUNDED):
        return tensor
    return np.asarray(axes @ np.diag([values[0], values[1], most]) @ axes.T)


def _dynamics(joint: Element) -> DeclaredDynamics:
    """Declared dynamics; absent and impossible values are None, also an effort or velocity of 0,
    which exporters write that know neither."""
    resists, limit = joint.find("dynamics"), joint.find("limit")
    damping = friction = None
    if resists is not None:  # URDF's default is 0
        damping = _from_zero(_one(resists, "damping", 0.0))
        friction = _from_zero(_one(resists, "friction", 0.0))
    effort = velocity = None
    if limit is not None:
        effort = _from_zero(_one(limit, "effort")) or None
        velocity = _from_zero(_one(limit, "velocity")) or None
    return DeclaredDynamics(damping, friction, effort, velocity)


def _from_zero(value: float | None) -> float | None:
    return value if value is not None and value >= 0 else None


def _one(element: Element, attribute: str, otherwise: float | None = None) -> float | None:
    """A finite number, or None."""
    text = element.get(attribute)
    if text is None:
        return otherwise
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _three(element: Element | None, attribute: str) -> FloatArray:
    text = "0 0 0" if element is None else element.get(attribute, "0 0 0")
    values = np.array([float(word) for word in text.replace(",", " ").split()])
    if values.shape != (3,) or not np.isfinite(values).all():
        raise ValueError(f"{text!r} is not three numbers")
    return values
