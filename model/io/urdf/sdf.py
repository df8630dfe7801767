"""An SDF model (Gazebo, Ignition, Drake) as the URDF that says the same.

Poses are resolved as the specification has them: links and frames stand in the model's frame,
joints in their child's, what a link holds in the link's, each unless ``relative_to`` names another
(sdformat.org, *Pose frame semantics*). Link frames of the URDF lie at the joints, the root's is the
model's frame.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET  # only makes elements; reading is defusedxml's

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from model.core.composite_joints import (
    COMPOSITE_KINDS,
    COMPOSITES,
    Composite,
    CompositeKind,
    composite_joints,
    free_helpers,
)
from model.core.errors import InputFileError, KinematicsError
from model.core.geometry import affine, rotation_from_rpy, rpy_from_rotation
from model.core.joint import JOINT_KINDS, Joint
from model.io.robot_xml import XmlSchema, parse
from model.io.urdf.files import MODEL_URI, PACKAGE_URI

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

SDF_SUFFIX = ".sdf"
UNLIMITED = 1e6
"""Limits beyond it stand for none; the specification's default is 1e16."""
_HEAD = 1 << 16
_BEGINS = re.compile(rb"<sdf\b[^>]*>(?:\s|<!--.*?-->)*<model\b", re.DOTALL)
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
            "link joint frame pose static model include gripper",
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
        ("visual", "pose geometry material", "name"),
        ("collision", "pose geometry", "name"),
        ("geometry", None, ""),
        ("mesh", "uri scale submesh convex_decomposition", "optimization"),
        ("pose", "", "relative_to degrees rotation_format frame"),
    ),
    "plugin sensor light audio_sink battery physics surface laser_retro max_contacts cast_shadows "
    "transparency visibility_flags meta enable_wind self_collide kinematic velocity_decay gravity "
    "allow_auto_disable must_be_base_link particle_emitter projector fluid_added_mass",
    repeated="link joint frame visual collision model include",
)
"""The elements and attributes of a model that are read, or answered for."""

FloatArray = npt.NDArray[np.float64]


def is_sdf(path: Path) -> bool:
    """True if ``path`` is an SDF of one model; worlds are scenes."""
    if path.suffix.lower() != SDF_SUFFIX or path.name.startswith(".") or not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            return _BEGINS.search(file.read(_HEAD)) is not None
    except OSError:
        return False


def pose_of(element: Element) -> FloatArray:
    """(4, 4) of an element's ``<pose>``: Euler angles, in degrees where it says so, or x y z w.

    Raises:
        ValueError: saying what is wrong with it.
    """
    given = element.find("pose")
    text = "" if given is None else (given.text or "").strip()
    if given is None or not text:
        return np.eye(4)
    style = given.get("rotation_format", "euler_rpy")
    counts = {"euler_rpy": 6, "quat_xyzw": 7}
    if style not in counts:
        raise ValueError(f"its rotation_format {style!r} is unknown")
    values = _numbers(text, counts[style], "pose")
    if style == "quat_xyzw":
        if np.linalg.norm(values[3:]) < 1e-9:
            raise ValueError(f"its quaternion {values[3:].tolist()} (x y z w) is zero")
        return affine(Rotation.from_quat(values[3:]).as_matrix(), values[:3])
    if given.get("degrees", "").strip().lower() in ("true", "1"):
        values[3:] = np.radians(values[3:])
    return affine(rotation_from_rpy(values[3:]), values[:3])


def _numbers(text: str, count: int, what: str) -> FloatArray:
    words = text.split()
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        raise ValueError(f"{what} is {text[:80]!r}; numbers are needed") from None
    if len(values) != count or not np.isfinite(values).all():
        raise ValueError(f"{what} is {text[:80]!r}; it needs {count} finite numbers")
    return values


def robot_of_sdf(path: Path) -> tuple[Element, list[str]]:
    """Equivalent ``<robot>``, and human-readable remarks on skipped content.

    Raises:
        InputFileError: where it holds no model, or several, or a pose that can't be resolved.
    """
    root = parse(path, ("sdf",), "an SDF")
    models = root.findall("model")
    if len(models) != 1 or root.find("world") is not None:
        what = "holds a world" if root.find("world") is not None else f"has {len(models)} models"
        raise InputFileError(path, what, "open a world as a scene, and models one by one")
    try:
        robot, notes = _Model(models[0], root.get("version", "1.7")).robot()
    except ValueError as error:
        raise InputFileError(path, str(error)) from None
    return robot, [*notes, *MODEL.unread(root)]


class _Model:
    def __init__(self, model: Element, version: str) -> None:
        self.model = model
        self.notes: list[str] = []
        self.old = re.match(r"1\.[0-4]\b", version) is not None
        self.named: dict[str, tuple[Element, str]] = {}
        for tag, default in (("link", ""), ("frame", ""), ("joint", "child")):
            for element in model.findall(tag):
                above = _text(element, default) if default else element.get("attached_to", "")
                self.named[element.get("name", "")] = (element, above)
        self.places: dict[str, FloatArray] = {"": np.eye(4), "__model__": np.eye(4)}
        skipped = [t for t in ("model", "include", "gripper") if model.find(t) is not None]
        if skipped:
            self.notes.append(f"not read: {', '.join(f'<{t}>' for t in skipped)} in the model")

    def robot(self) -> tuple[Element, list[str]]:
        out = ET.Element("robot", name=self.model.get("name", "object"))
        joints = self.model.findall("joint")
        held = [j for j in joints if _text(j, "parent") != "world"]
        self.frame = {_text(j, "child"): self._place(j.get("name", "")) for j in held}
        for link in self.model.findall("link"):
            self._link(link, out)
        for joint in held:
            self._joint(joint, out)
        return out, self.notes

    def _place(self, name: str, ahead: tuple[str, ...] = ()) -> FloatArray:
        """(4, 4) model_from_frame of a link, joint or frame."""
        if name not in self.places:
            if name in ahead:
                raise ValueError(f"the poses of {' → '.join((*ahead, name))} hang on each other")
            if name not in self.named:
                raise ValueError(f"a pose is relative to {name!r}, which is no frame of the model")
            if len(ahead) > 500:
                raise ValueError("poses hang on more than 500 others")
            element, above = self.named[name]
            self.places[name] = self._within(element, above, (*ahead, name))
        return self.places[name]

    def _within(self, element: Element, above: str, ahead: tuple[str, ...] = ()) -> FloatArray:
        given = element.find("pose")
        said = "" if given is None else given.get("relative_to", given.get("frame", ""))
        try:
            own = pose_of(element)
        except ValueError as error:
            raise ValueError(f"<{element.tag}> {element.get('name', '')!r}: {error}") from None
        return self._place(said or above, ahead) @ own

    def _link(self, link: Element, out: Element) -> None:
        name = link.get("name", "")
        made = ET.SubElement(out, "link", name=name)
        back: FloatArray = np.linalg.inv(self.frame.get(name, np.eye(4))).astype(np.float64)
        inertial = link.find("inertial")
        if inertial is not None and inertial.find("mass") is not None:
            own = ET.SubElement(made, "inertial")
            _origin(own, back @ self._within(inertial, name))
            ET.SubElement(own, "mass", value=_text(inertial, "mass"))
            tensor = inertial.find("inertia")
            if tensor is not None:
                keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
                said = {k: _text(tensor, k) or ("1" if k[1] == k[2] else "0") for k in keys}
                ET.SubElement(own, "inertia", said)
        for tag in ("visual", "collision"):
            for element in link.findall(tag):
                self._geometry(element, tag, name, back, made)

    def _geometry(
        self, element: Element, tag: str, link: str, back: FloatArray, out: Element
    ) -> None:
        geometry = element.find("geometry")
        shape = None if geometry is None else next(iter(geometry), None)
        if shape is None or shape.tag not in (*_SHAPES, "mesh"):
            kind = "nothing" if shape is None else f"<{shape.tag}>"
            self.notes.append(f"link {link!r}: a {tag} of {kind} is not read")
            return
        made = ET.SubElement(out, tag, name=element.get("name", ""))
        _origin(made, back @ self._within(element, link))
        own = ET.SubElement(ET.SubElement(made, "geometry"), shape.tag)
        if shape.tag == "mesh":
            uri = _text(shape, "uri")
            if uri.startswith(MODEL_URI):
                uri = PACKAGE_URI + uri.removeprefix(MODEL_URI)
            own.set("filename", uri.removeprefix("file://"))
            own.set("scale", _text(shape, "scale") or "1 1 1")
            if shape.find("submesh") is not None:
                self.notes.append(f"link {link!r}: the whole mesh is read instead of a submesh")
        for key in _SHAPES.get(shape.tag, ()):
            own.set(key, _text(shape, key) or "1")
        diffuse = _text(element, "material/diffuse")
        if diffuse:
            material = ET.SubElement(made, "material", name="")
            color = diffuse.split()
            ET.SubElement(
                material, "color", rgba=" ".join(color if len(color) > 3 else [*color, "1"])
            )

    def _joint(self, joint: Element, out: Element) -> None:
        name, given = joint.get("name", ""), joint.get("type", "")
        parent, child = _text(joint, "parent"), _text(joint, "child")
        frame = self.frame[child]
        place = np.linalg.inv(self.frame.get(parent, np.eye(4))) @ frame
        try:
            chain = self._chain(joint, given, frame)
        except KinematicsError as error:
            raise ValueError("; ".join(error.problems)) from None
        for k, one in enumerate(chain):
            if one.child != child:
                ET.SubElement(out, "link", name=one.child)
            second = one.name == name and given in _TWO_AXES
            said = joint.find("axis2" if second else "axis") if one.mimic is None else None
            limits = None if one.lower is None or one.upper is None else (one.lower, one.upper)
            made = _begun(out, one.name, one.type, one.parent, one.child, place if k == 0 else None)
            ET.SubElement(made, "axis", xyz=" ".join(map(repr, one.axis)))
            self._resisting(made, said, limits)
            if one.mimic is not None:
                ET.SubElement(
                    made,
                    "mimic",
                    joint=one.mimic.joint,
                    multiplier=repr(one.mimic.multiplier),
                    offset="0",
                )
        if chain:
            return
        kind = given if given in JOINT_KINDS else "fixed"
        if given not in JOINT_KINDS:
            self.notes.append(f"joint {name!r}: {given} joints are not supported; it became fixed")
        axis = joint.find("axis")
        limits = self._limits(axis)
        if kind == "revolute" and limits is None:
            kind = "continuous"
        made = _begun(out, name, kind, parent, child, place)
        if kind == "fixed" or axis is None:
            return
        ET.SubElement(made, "axis", xyz=" ".join(map(repr, self._axis(axis, frame))))
        if limits is None and JOINT_KINDS[kind].slides:
            self.notes.append(f"joint {name!r} slides without limits: its range is taken as 0")
            limits = (0.0, 0.0)
        self._resisting(made, axis, limits)

    def _chain(self, joint: Element, given: str, frame: FloatArray) -> tuple[Joint, ...]:
        """Joints through helper links, in the child's frame; () for one joint alone."""
        name, parent, child = joint.get("name", ""), _text(joint, "parent"), _text(joint, "child")
        taken = {link.get("name", "") for link in self.model.findall("link")}
        helpers = free_helpers(child, 2, taken)
        base = Joint(name or "?", "continuous", parent, child)

        def turn(tag: str) -> Joint:
            axis = joint.find(tag)
            if axis is None:
                return base
            x, y, z = self._axis(axis, frame)
            lower, upper = self._limits(axis) or (None, None)
            kind = "continuous" if lower is None else "revolute"
            return Joint(base.name, kind, parent, child, (x, y, z), (0, 0, 0), lower, upper)

        kinds: dict[str, CompositeKind] = {
            tag: k for k in COMPOSITE_KINDS if (tag := COMPOSITES[k].sdf)
        }
        kind = kinds.get(given, "single")
        pitch = _pitch(joint) if COMPOSITES[kind].pitched else 0.0
        if kind != "single" and (pitch or not COMPOSITES[kind].pitched):
            main = turn("axis") if pitch else base
            return composite_joints(Composite(kind, pitch), main, helpers, swing=math.pi / 2)
        if given in _TWO_AXES:
            first = replace(turn("axis"), name=f"joint_{helpers[0]}", child=helpers[0])
            return first, replace(turn("axis2"), parent=helpers[0])
        return ()

    def _resisting(
        self, made: Element, axis: Element | None, limits: tuple[float, float] | None
    ) -> None:
        """Limits, damping, friction and what the joint follows."""
        limit = ET.SubElement(made, "limit")
        if limits is not None:
            limit.set("lower", repr(limits[0]))
            limit.set("upper", repr(limits[1]))
        if axis is None:
            return
        for key in ("effort", "velocity"):  # negative ones stand for none
            text = _text(axis, f"limit/{key}")
            if text and not text.startswith("-"):
                limit.set(key, text)
        resists = {k: t for k in ("damping", "friction") if (t := _text(axis, f"dynamics/{k}"))}
        if resists:
            ET.SubElement(made, "dynamics", resists)
        mimic = axis.find("mimic")
        if mimic is not None:
            slope, offset, start = (
                float(_numbers(_text(mimic, key) or default, 1, key)[0])
                for key, default in (("multiplier", "1"), ("offset", "0"), ("reference", "0"))
            )
            ET.SubElement(
                made,
                "mimic",
                joint=mimic.get("joint", ""),
                multiplier=repr(slope),
                offset=repr(offset - slope * start),
            )

    def _limits(self, axis: Element | None) -> tuple[float, float] | None:
        if axis is None:
            return None
        ends = [
            float(text) if (text := _text(axis, f"limit/{key}")) else default
            for key, default in (("lower", -math.inf), ("upper", math.inf))
        ]
        if any(map(math.isnan, ends)):
            raise ValueError("a limit is not a number")
        return None if max(map(abs, ends)) > UNLIMITED else (ends[0], ends[1])

    def _axis(self, axis: Element, frame: FloatArray) -> list[float]:
        """(3,) the axis in the joint's frame."""
        given = axis.find("xyz")
        xyz = _numbers((given.text if given is not None else None) or "0 0 1", 3, "axis")
        within = "" if given is None else given.get("expressed_in", "")
        if _text(axis, "use_parent_model_frame").lower() in ("true", "1") or self.old:
            within = "__model__"
        if within:
            xyz = frame[:3, :3].T @ self._place(within)[:3, :3] @ xyz
        return xyz.tolist()


def _begun(
    out: Element, name: str, kind: str, parent: str, child: str, place: FloatArray | None
) -> Element:
    made = ET.SubElement(out, "joint", name=name, type=kind)
    ET.SubElement(made, "parent", link=parent)
    ET.SubElement(made, "child", link=child)
    _origin(made, np.eye(4) if place is None else place)
    return made


def _pitch(joint: Element) -> float:
    """Metres of a right-handed turn of a screw; 0 where no usable pitch is declared."""
    said = _text(joint, "screw_thread_pitch")
    if said:
        return float(_numbers(said, 1, "screw_thread_pitch")[0])
    old = _text(joint, "thread_pitch")  # rad/m, of a left-handed thread
    per_metre = float(_numbers(old, 1, "thread_pitch")[0]) if old else 1.0
    return -2 * math.pi / per_metre if per_metre else 0.0


def _text(element: Element, path: str) -> str:
    return (element.findtext(path) or "").strip()


def _origin(element: Element, matrix: FloatArray) -> None:
    xyz, rpy = matrix[:3, 3].tolist(), np.asarray(rpy_from_rotation(matrix[:3, :3])).tolist()
    ET.SubElement(element, "origin", xyz=" ".join(map(repr, xyz)), rpy=" ".join(map(repr, rpy)))
