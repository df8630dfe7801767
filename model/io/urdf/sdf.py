"""An SDF model (Gazebo, Ignition, Drake) as the URDF that says the same.

Poses are resolved as the specification has them: links and frames stand in the model's frame,
joints in their child's, what a link holds in the link's, each unless ``relative_to`` names another
(sdformat.org, *Pose frame semantics*). Link frames of the URDF lie at the joints, the root's is the
model's frame.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from xml.etree import ElementTree as ET  # only makes elements; reading is defusedxml's

import numpy as np
import numpy.typing as npt

from model.core.composite_joints import (
    COMPOSITE_KINDS,
    COMPOSITES,
    Composite,
    CompositeKind,
    composite_joints,
    free_helpers,
)
from model.core.errors import InputFileError, KinematicsError
from model.core.geometry import rpy_from_rotation
from model.core.joint import JOINT_KINDS, Joint
from model.io.robot_xml import XmlSchema, begins, parse
from model.io.urdf.sdf_frames import ALBEDO, LOOKS, WORLD, Frames, is_true, numbers_in, said

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

SDF_SUFFIX = ".sdf"
SUBMESH, CENTERED = "{sdf}submesh", "{sdf}centered"
"""Attributes of the ``<mesh>`` that a URDF has no word for."""
UNLIMITED = 1e6
"""Limits beyond it stand for none; the specification's default is 1e16."""
_BEGINS = re.compile(rb".*?<sdf\b[^>]*>(?:\s|<!--.*?-->)*<model\b", re.DOTALL)
_TWO_AXES = ("universal", "revolute2")
_SHAPES = {
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "capsule": ("radius", "length"),
}

MODEL = XmlSchema.of(
    (
        ("sdf", "model", "version"),
        (
            "model",
            "link joint frame pose static model include",
            "name canonical_link placement_frame",
        ),
        ("link", "pose inertial visual collision", "name"),
        ("frame", "pose", "name attached_to"),
        ("joint", "pose parent child axis axis2 screw_thread_pitch thread_pitch", "name type"),
        ("axis", "xyz limit dynamics mimic use_parent_model_frame", ""),
        ("axis2", "xyz limit dynamics mimic use_parent_model_frame", ""),
        ("xyz", "", "expressed_in"),
        ("limit", "lower upper effort velocity stiffness dissipation", ""),
        ("dynamics", "damping friction spring_reference spring_stiffness", ""),
        ("mimic", "multiplier offset reference", "joint axis"),
        ("inertial", "pose mass inertia", "auto"),
        ("inertia", "ixx ixy ixz iyy iyz izz", ""),
        ("visual", "pose geometry material transparency", "name"),
        ("material", "script ambient diffuse specular emissive shader lighting pbr", ""),
        ("pbr", "metal specular", ""),
        ("metal", ALBEDO, ""),
        ("specular", ALBEDO, ""),
        ("collision", "pose geometry", "name"),
        ("geometry", None, ""),
        ("mesh", "uri scale submesh convex_decomposition", "optimization"),
        ("pose", "", "relative_to degrees rotation_format frame"),
    ),
    "plugin sensor light double_sided render_order audio_sink battery physics surface laser_retro "
    "max_contacts cast_shadows visibility_flags meta enable_wind self_collide kinematic "
    "velocity_decay gravity allow_auto_disable must_be_base_link particle_emitter projector "
    "fluid_added_mass",
    repeated="link joint frame visual collision model include",
)
"""The elements and attributes of a model that are read, or answered for."""

FloatArray = npt.NDArray[np.float64]


def is_sdf(path: Path) -> bool:
    """True if ``path`` is an SDF of one model; worlds are scenes."""
    return begins(path, (SDF_SUFFIX,), _BEGINS)


def robot_of_sdf(path: Path, model: Element | None = None) -> tuple[Element, list[str]]:
    """Equivalent ``<robot>``, and human-readable remarks on skipped content.

    Args:
        path: the file.
        model: one of its world, whose reader judges what isn't known; by default the only one.

    Raises:
        InputFileError: where it holds no model, or several, or a pose that can't be resolved.
    """
    root = parse(path, ("sdf",), "an SDF")
    models = root.findall("model") if model is None else [model]
    if len(models) != 1 or (model is None and root.find("world") is not None):
        what = "holds a world" if root.find("world") is not None else f"has {len(models)} models"
        raise InputFileError(path, what, "open a world as a scene, and models one by one")
    try:
        robot, notes = _Model(models[0], root.get("version", "1.7"), path).robot()
    except ValueError as error:
        raise InputFileError(path, str(error)) from None
    return robot, notes if model is not None else [*notes, *MODEL.unread(root)]


class _Held(NamedTuple):
    """A joint that counts, and the full names of its links."""

    element: Element
    parent: str
    child: str


class _Model:
    def __init__(self, model: Element, version: str, path: Path) -> None:
        self.model = model
        self.old = re.match(r"1\.[0-4]\b", version) is not None
        self.frames = Frames(model, path)
        self.notes = self.frames.notes
        links = list(self.frames.links)
        self.names = {WORLD: WORLD} | _short(links)
        joints = [self.frames.prefix[j] + j.get("name", "") for j in self.frames.joints]
        self.joint_names = _short(joints)

    def robot(self) -> tuple[Element, list[str]]:
        out = ET.Element("robot", name=self.model.get("name", "object"))
        held, apart = self._rooted(self._held())
        self.frame = {j.child: self.frames.place_of(j.element) for j in held}
        if WORLD not in self.frames.links and any(j.parent == WORLD for j in held):
            ET.SubElement(out, "link", name=WORLD)
        for link, element in self.frames.links.items():
            self._link(link, element, out)
        for joint in held:
            self._joint(joint, out)
        for base, link in apart:
            place = np.asarray(np.linalg.inv(self.frame.get(base, np.eye(4))), np.float64)
            names = self.names[base], self.names[link]
            _begun(out, " to ".join(names), "fixed", *names, place)
        moving = any(j.element.get("type") != "fixed" for j in held)
        if moving and is_true(said(self.model, "static")):
            self.notes.append("static: Gazebo moves nothing of it; its joints are read")
        return out, self.notes

    def _held(self) -> list[_Held]:
        """The joints that make a tree: each link hangs on one."""
        out: dict[str, _Held] = {}
        for element in self.frames.joints:
            name, prefix = element.get("name", ""), self.frames.prefix[element]
            ends = [said(element, end) for end in ("parent", "child")]
            if not all(ends):
                raise ValueError(f"joint {name!r} needs <parent> and <child>")
            parent, child = (self.frames.link_of(end, prefix) for end in ends)
            wrong = ""
            if element.get("type") == "gearbox":
                wrong = "gearbox joints are not supported"
            elif child == WORLD and WORLD not in self.frames.links:
                wrong = "its child is the world"
            elif child in out:
                wrong = f"{child!r} hangs on another joint already"
            if wrong:
                self.notes.append(f"joint {name!r}: {wrong}; it was left out")
            else:
                out[child] = _Held(element, parent, child)
        return list(out.values())

    def _rooted(self, held: list[_Held]) -> tuple[list[_Held], list[tuple[str, str]]]:
        """The joints below one root, and (root, link) of what must be fixed to it: the world is
        it where something moves against the world."""
        free = [link for link in self.frames.links if link not in {j.child for j in held}]
        world = [] if WORLD in self.frames.links else [j for j in held if j.parent == WORLD]
        base = free[0] if free else ""
        if len(world) == 1 and world[0].element.get("type") == "fixed":
            base = world[0].child
            held = [j for j in held if j is not world[0]]
        elif world:
            base = WORLD
        elif free:
            main = self.frames.link_of("__model__", "")
            base = main if main in free else base
        apart = [(base, link) for link in free if link != base]
        for base, link in apart:
            self.notes.append(
                f"link {self.names[link]!r} hangs on nothing; it was fixed to {self.names[base]!r}"
            )
        return held, apart

    def _link(self, name: str, link: Element, out: Element) -> None:
        made = ET.SubElement(out, "link", name=self.names[name])
        back = np.linalg.inv(self.frame.get(name, np.eye(4))).astype(np.float64)
        inertial = link.find("inertial")
        if inertial is not None and is_true(inertial.get("auto", "")):
            self.notes.append(f"link {self.names[name]!r}: its mass is that of its shapes (auto)")
        elif inertial is not None and any(e.tag != "pose" for e in inertial):
            own = ET.SubElement(made, "inertial")
            _origin(own, back @ self._inside(inertial, link))
            ET.SubElement(own, "mass", value=said(inertial, "mass") or "1")
            tensor = inertial.find("inertia")
            if tensor is not None:
                keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
                declared = {k: said(tensor, k) or ("1" if k[1] == k[2] else "0") for k in keys}
                ET.SubElement(own, "inertia", declared)
        for tag in ("visual", "collision"):
            for element in link.findall(tag):
                self._geometry(element, back @ self._inside(element, link), made)

    def _inside(self, element: Element, link: Element) -> FloatArray:
        """(4, 4) model_from_element of what a link holds."""
        self.frames.prefix[element] = self.frames.prefix[link]
        return self.frames.within(element, link.get("name", ""))

    def _geometry(self, element: Element, place: FloatArray, out: Element) -> None:
        geometry, tag = element.find("geometry"), element.tag
        shape = None if geometry is None else next(iter(geometry), None)
        if shape is None or shape.tag not in (*_SHAPES, "mesh"):
            kind = "nothing" if shape is None else f"<{shape.tag}>"
            if kind != "<empty>":
                self.notes.append(f"link {out.get('name')!r}: a {tag} of {kind} is not read")
            return
        made = ET.SubElement(out, tag, name=element.get("name", ""))
        _origin(made, place)
        own = ET.SubElement(ET.SubElement(made, "geometry"), shape.tag)
        if shape.tag == "mesh":
            own.set("filename", said(shape, "uri").removeprefix("file://"))
            own.set("scale", said(shape, "scale") or "1 1 1")
            if shape.find("submesh") is not None:
                own.set(SUBMESH, said(shape, "submesh/name"))
                own.set(CENTERED, said(shape, "submesh/center"))
        for key in _SHAPES.get(shape.tag, ()):
            own.set(key, said(shape, key) or ("1 1 1" if key == "size" else "1"))
        looks = ET.SubElement(made, LOOKS)
        looks.extend((*element.findall("material/*"), *element.findall("transparency")))

    def _joint(self, held: _Held, out: Element) -> None:
        joint = held.element
        prefix, given = self.frames.prefix[joint], joint.get("type", "")
        name = self.joint_names[prefix + joint.get("name", "")]
        parent, child = (self.names.get(x, x) for x in (held.parent, held.child))
        frame = self.frame[held.child]
        place = np.linalg.inv(self.frame.get(held.parent, np.eye(4))) @ frame
        try:
            chain = self._chain(held, name, (parent, child), frame)
        except KinematicsError as error:
            raise ValueError("; ".join(error.problems)) from None
        for k, one in enumerate(chain):
            if one.child != child:
                ET.SubElement(out, "link", name=one.child)
            second = one.name == name and given in _TWO_AXES
            declared = joint.find("axis2" if second else "axis") if one.mimic is None else None
            limits = None if one.lower is None or one.upper is None else (one.lower, one.upper)
            made = _begun(out, one.name, one.type, one.parent, one.child, place if k == 0 else None)
            ET.SubElement(made, "axis", xyz=" ".join(map(repr, one.axis)))
            self._resisting(made, declared, limits, prefix)
            if one.mimic is not None:
                _follow(made, one.mimic.joint, one.mimic.multiplier, 0.0)
        if chain:
            return
        kind = given if given in JOINT_KINDS else "fixed"
        if given not in JOINT_KINDS:
            self.notes.append(f"joint {name!r}: {given} joints are not supported; it became fixed")
        axis = joint.find("axis")
        limits = self._limits(axis, name, JOINT_KINDS[kind].slides)
        if kind == "revolute" and limits is None:
            kind = "continuous"
        made = _begun(out, name, kind, parent, child, place)
        if kind == "fixed" or axis is None:
            return
        ET.SubElement(made, "axis", xyz=" ".join(map(repr, self._axis(axis, held, frame))))
        self._resisting(made, axis, limits, prefix)

    def _chain(
        self, held: _Held, name: str, ends: tuple[str, str], frame: FloatArray
    ) -> tuple[Joint, ...]:
        """Joints through helper links, in the child's frame; () for one joint alone."""
        joint, (parent, child) = held.element, ends
        given = joint.get("type", "")
        helpers = free_helpers(child, 2, set(self.names.values()))
        base = Joint(name or "?", "continuous", parent, child)

        def turn(tag: str) -> Joint:
            axis = joint.find(tag)
            if axis is None:
                return base
            x, y, z = self._axis(axis, held, frame)
            lower, upper = self._limits(axis, name) or (None, None)
            kind = "continuous" if lower is None else "revolute"
            return Joint(base.name, kind, parent, child, (x, y, z), (0, 0, 0), lower, upper)

        kinds: dict[str, CompositeKind] = {
            tag: k for k in COMPOSITE_KINDS if (tag := COMPOSITES[k].sdf)
        }
        kind = kinds.get(given, "single")
        pitch = _pitch(joint) if COMPOSITES[kind].pitched else 0.0
        if kind != "single" and (pitch or not COMPOSITES[kind].pitched):
            main = turn("axis") if pitch else base
            if kind == "ball":
                tilts = "three turns, two of them up to 90 degrees"
                self.notes.append(f"joint {name!r} is a ball: read as {tilts}")
            return composite_joints(Composite(kind, pitch), main, helpers, swing=math.pi / 2)
        if given in _TWO_AXES:
            first = replace(turn("axis"), name=f"joint_{helpers[0]}", child=helpers[0])
            return first, replace(turn("axis2"), parent=helpers[0])
        return ()

    def _resisting(
        self, made: Element, axis: Element | None, limits: tuple[float, float] | None, prefix: str
    ) -> None:
        """Limits, damping, friction and what the joint follows."""
        limit = ET.SubElement(made, "limit")
        if limits is not None:
            limit.set("lower", repr(limits[0]))
            limit.set("upper", repr(limits[1]))
        if axis is None:
            return
        for key in ("effort", "velocity"):  # negative ones stand for none
            text = said(axis, f"limit/{key}")
            if text and 0 <= float(text) <= UNLIMITED:
                limit.set(key, text)
        resists = {k: t for k in ("damping", "friction") if (t := said(axis, f"dynamics/{k}"))}
        if resists:
            ET.SubElement(made, "dynamics", resists)
        if float(said(axis, "dynamics/spring_stiffness") or 0):
            self.notes.append(f"joint {made.get('name')!r} has a spring, which is not kept")
        mimic = axis.find("mimic")
        if mimic is not None:
            leader = mimic.get("joint", "")
            slope, offset, start = (
                float(numbers_in(said(mimic, key) or default, 1, key)[0])
                for key, default in (("multiplier", "1"), ("offset", "0"), ("reference", "0"))
            )
            leader = self.joint_names.get(prefix + leader, leader)
            _follow(made, leader, slope, offset - slope * start)

    def _limits(
        self, axis: Element | None, name: str, slides: bool = False
    ) -> tuple[float, float] | None:
        """Lower and upper limit; None for none. A slide has a range, else of 0."""
        if axis is None:
            return None
        lower, upper = (
            float(text) if (text := said(axis, f"limit/{key}")) else default
            for key, default in (("lower", -math.inf), ("upper", math.inf))
        )
        if math.isnan(lower) or math.isnan(upper):
            raise ValueError("a limit is not a number")
        if max(abs(lower), abs(upper)) <= UNLIMITED:
            return lower, upper
        ends = [end for end in (lower, upper) if abs(end) <= UNLIMITED]
        what = f"has one limit alone ({ends[0]:g})" if ends else "has no limits"
        if slides:
            low, high = sorted([*ends, 0.0, 0.0][:2])
            self.notes.append(f"joint {name!r} {what}: it slides from {low:g} to {high:g} m")
            return low, high
        if ends:
            self.notes.append(f"joint {name!r} {what}: read as none")
        return None

    def _axis(self, axis: Element, held: _Held, frame: FloatArray) -> list[float]:
        """(3,) the axis in the joint's frame."""
        given = axis.find("xyz")
        xyz = numbers_in((given.text if given is not None else None) or "0 0 1", 3, "axis")
        within = "" if given is None else given.get("expressed_in", "")
        if is_true(said(axis, "use_parent_model_frame")) or self.old:
            within = "__model__"
        if within:
            place = self.frames.place(within, self.frames.prefix[held.element])
            xyz = frame[:3, :3].T @ place[:3, :3] @ xyz
        return xyz.tolist()


def _short(names: list[str]) -> dict[str, str]:
    """Full name → the name in its own model, where no other has it."""
    own = Counter(name.rpartition("::")[2] for name in names)
    return {
        name: last if own[last := name.rpartition("::")[2]] == 1 else name.replace("::", "_")
        for name in names
    }


def _begun(
    out: Element, name: str, kind: str, parent: str, child: str, place: FloatArray | None
) -> Element:
    made = ET.SubElement(out, "joint", name=name, type=kind)
    ET.SubElement(made, "parent", link=parent)
    ET.SubElement(made, "child", link=child)
    _origin(made, np.eye(4) if place is None else place)
    return made


def _follow(joint: Element, leader: str, slope: float, offset: float) -> None:
    ET.SubElement(joint, "mimic", joint=leader, multiplier=repr(slope), offset=repr(offset))


def _pitch(joint: Element) -> float:
    """Metres of a right-handed turn of a screw; 0 where no usable pitch is declared."""
    pitch = said(joint, "screw_thread_pitch")
    if pitch:
        return float(numbers_in(pitch, 1, "screw_thread_pitch")[0])
    old = said(joint, "thread_pitch")  # rad/m, of a left-handed thread
    per_metre = float(numbers_in(old, 1, "thread_pitch")[0]) if old else 1.0
    return -2 * math.pi / per_metre if per_metre else 0.0


def _origin(element: Element, matrix: FloatArray) -> None:
    xyz, rpy = matrix[:3, 3].tolist(), np.asarray(rpy_from_rotation(matrix[:3, :3])).tolist()
    ET.SubElement(element, "origin", xyz=" ".join(map(repr, xyz)), rpy=" ".join(map(repr, rpy)))
