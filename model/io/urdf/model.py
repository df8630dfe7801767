"""A URDF, MJCF or USD as read, before its meshes are loaded, with its declared physics.

Declared physics is what a file states of masses, collision shapes and of what resists its joints.
It isn't needed to move an object, so a mistake in it is a remark, not an error. It is kept beside
part meshes that are written of it, so that a working copy of a scene's asset loses nothing.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import (
    Affordance,
    ArticulatedObject,
    Inertial,
    Part,
    belongs,
    inertial_problems,
)
from model.core.errors import InputFileError, KinematicsError
from model.core.files import free_name
from model.core.geometry import rotation_from_rpy
from model.core.joint import DeclaredDynamics, Joint
from model.core.progress import Progress, no_progress
from model.core.shapes import Shape, moved_shape
from model.core.tree import KinematicTree
from model.io.urdf.meshes import DeclaredCollision, UrdfVisual, declared_shapes, load_part
from model.physics.collision.store import load_arrays, packed, unpacked

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
    odd = [
        f"{key} {element.get(key)!r} of joint {joint.get('name')!r}"
        for joint in robot.findall("joint")
        for element in (*joint.findall("dynamics"), *joint.findall("limit"))
        for key in ("damping", "friction", "effort", "velocity")
        if key in element.attrib and _from_zero(_one(element, key)) is None
    ]
    notes += tuple(f"{what} is no amount; it was left out" for what in odd)
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
    xx, xy, xz, yy, yz, zz = (
        _one(tensor, k) or 0.0 for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    )
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


@dataclass(frozen=True, eq=False)
class UrdfModel:
    """A URDF, or another file that tells the same, without its meshes loaded.

    Attributes:
        tree: joints in the object's rest frame, which is the root link's frame.
        visuals: geometry in the file's order.
        notes: human-readable remarks on changes made on reading.
        rescaled: those of the notes about an axis whose length wasn't 1: it means the same.
        renamed: those about a link that became a helper by name alone.
        faulty: joints that couldn't be read and stand as fixed ones; only of a lenient reading.
        swapped: joints whose lower limit was written above the upper one; here they are in order.
        declared: masses, joint dynamics and collision shapes; :meth:`load` leaves them out.
        files: that were read beside the file itself and the meshes.
        part_names: link → display name that the file declares.
        category: what the file says of the whole, or None.
    """

    path: Path
    name: str
    tree: KinematicTree
    visuals: tuple[UrdfVisual, ...]
    notes: tuple[str, ...] = ()
    faulty: tuple[str, ...] = ()
    swapped: tuple[str, ...] = ()
    rescaled: tuple[str, ...] = ()
    renamed: tuple[str, ...] = ()
    declared: DeclaredPhysics = field(default_factory=DeclaredPhysics)
    files: tuple[Path, ...] = ()
    part_names: Mapping[str, str] = field(default_factory=dict)
    category: str | None = None

    @cached_property
    def by_link(self) -> Mapping[str, tuple[UrdfVisual, ...]]:
        """Link → its visuals; links without any are left out."""
        out: dict[str, tuple[UrdfVisual, ...]] = {}
        for visual in self.visuals:
            out[visual.link] = (*out.get(visual.link, ()), visual)
        return out

    def load(self, progress: Progress = no_progress) -> ArticulatedObject:
        """Read the meshes. Links without geometry become helpers.

        Raises:
            InputFileError: for a mesh file that can't be read.
        """
        parts: list[Part] = []
        for i, (link, visuals) in enumerate(self.by_link.items()):
            progress(i / len(self.by_link), f"reading {link}")
            part = load_part(link, visuals)
            parts.append(replace(part, name=self.part_names.get(link, part.name)))
        progress(1.0, "read")
        return ArticulatedObject(self.name, tuple(parts), self.tree, self.category)


def model_from(
    path: Path,
    name: str,
    links: Sequence[str],
    joints: Sequence[Joint],
    visuals: Sequence[UrdfVisual],
    notes: Sequence[str],
    declared: DeclaredPhysics,
    **more: Any,
) -> UrdfModel:
    """A model whose helpers aren't called like parts; all is given by the file's names.

    Raises:
        InputFileError: where links and joints are no tree.
    """
    renotes: list[str] = []
    renamed = renamed_helpers(links, {v.link for v in visuals}, renotes)
    try:
        tree = KinematicTree(tuple(links), tuple(joints)).renamed(renamed)
    except KinematicsError as error:
        raise InputFileError(path, str(error)) from None
    now = {link: renamed.get(link, link) for link in links}
    declared = replace(
        declared,
        inertials={now[k]: v for k, v in declared.inertials.items() if k in now},
        collision={now[k]: v for k, v in declared.collision.items() if k in now},
        affordances=tuple(replace(a, link=now[a.link]) for a in declared.affordances),
    )
    said = tuple(dict.fromkeys([*notes, *renotes]))
    more |= {"renamed": tuple(renotes), "declared": declared}
    return UrdfModel(path, name, tree, tuple(visuals), said, **more)


def renamed_helpers(
    links: Sequence[str], owning: Collection[str], notes: list[str]
) -> dict[str, str]:
    """New names of links without geometry whose own begin with ``link_``, as parts' do.

    Args:
        links: all of the file.
        owning: those with geometry.
        notes: gets a human-readable remark on each.
    """
    out: dict[str, str] = {}
    for link in links:
        if link.startswith("link_") and link not in owning:
            base = "helper_" + link.removeprefix("link_").removesuffix("_helper")
            out[link] = new = free_name(base, {*links, *out.values()})
            notes.append(f"link {link!r} has no geometry; it became the helper {new!r}")
    return out


FILE = "told.npz"
_SHAPE = "shape "


def save_declared(
    folder: Path,
    inertials: Mapping[str, Inertial],
    shapes: Mapping[str, tuple[Shape, ...]],
) -> None:
    """Write ``told.npz`` if anything is declared.

    Args:
        inertials, shapes: by link, in the frame of the folder's meshes; ``link_2`` is the third
            part of its ``object.json``.

    Raises:
        OSError: where it can't be written.
    """
    if not inertials and not shapes:
        return
    arrays = {f"{_SHAPE}{name}": array for name, array in packed(shapes).items()}
    each = list(inertials.values())
    arrays["inertial links"] = np.array(list(inertials), dtype=np.str_)
    arrays["mass"] = np.array([i.mass for i in each])
    arrays["center"] = np.array([i.center for i in each]).reshape(-1, 3)
    arrays["tensor"] = np.array([i.tensor for i in each]).reshape(-1, 3, 3)
    np.savez(folder / FILE, **arrays)  # type: ignore[arg-type]


def load_declared(
    folder: Path, target_from_folder: npt.NDArray[np.float64]
) -> tuple[dict[str, Inertial], dict[str, tuple[Shape, ...]]]:
    """Read what :func:`save_declared` wrote, under (4, 4) a rotation and a uniform scale; nothing
    where the file is absent or damaged."""
    data = load_arrays(folder / FILE)
    if data is None:
        return {}, {}
    try:
        rows = zip(
            data["inertial links"].tolist(),
            data["mass"].tolist(),
            data["center"],
            data["tensor"],
            strict=True,
        )
        inertials = {
            link: Inertial(mass, center, tensor).moved(target_from_folder)
            for link, mass, center, tensor in rows
        }
        shapes = unpacked(
            {k.removeprefix(_SHAPE): v for k, v in data.items() if k.startswith(_SHAPE)}
        )
        moved = {k: tuple(moved_shape(s, target_from_folder) for s in v) for k, v in shapes.items()}
    except (ValueError, KeyError, TypeError, AssertionError):
        return {}, {}
    return ({}, {}) if inertial_problems(inertials) else (inertials, moved)
