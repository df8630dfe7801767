"""The only URDF reader and writer: this file writes, ``urdf_reader`` reads.

What is written, so that any reader moves a link as :meth:`KinematicTree.pose` does:

- The root's frame is the object frame. Every other link's frame sits at its joint's origin and is
  parallel to the object frame at rest, so no ``rpy`` is ever needed.
- A joint's ``<origin>`` is the child's origin minus the parent's; a visual's is minus its link's
  origin, because mesh files hold object-frame coordinates.

Hence ``object_from_link(q) = posed_from_rest(q) @ translation(origin of the link)``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias
from xml.sax.saxutils import quoteattr

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject, Inertial
from model.core.errors import ArtiworldError, KinematicsError
from model.core.geometry import rpy_from_rotation
from model.core.joint import EFFORT, VELOCITY, Joint, JointDynamics, Mimic
from model.core.shapes import Primitive
from model.core.tree import KinematicTree
from model.io.urdf.reader import UrdfModel, UrdfVisual, read_urdf, read_urdf_model

__all__ = [
    "CollisionGeometry",
    "UrdfModel",
    "UrdfVisual",
    "link_origins",
    "read_urdf",
    "read_urdf_model",
    "to_urdf_text",
]

CollisionGeometry: TypeAlias = str | Primitive
"""A file in object-frame coordinates, or a box, cylinder or sphere."""


def link_origins(tree: KinematicTree) -> dict[str, npt.NDArray[np.float64]]:
    """Link → (3,) where its URDF frame sits at rest, metres, object frame."""
    out = {tree.root: np.zeros(3)}
    for link in tree.order[1:]:
        out[link] = np.asarray(tree.joint_of[link].origin, dtype=np.float64)
    return out


def to_urdf_text(
    obj: ArticulatedObject,
    mesh_files: Mapping[str, Sequence[str]] | None = None,
    *,
    collisions: Mapping[str, Sequence[CollisionGeometry]] | None = None,
    inertials: Mapping[str, Inertial] | None = None,
    dynamics: Mapping[str, JointDynamics] | None = None,
    mujoco_visuals: bool | None = None,
) -> str:
    """The URDF of ``obj``, links declared before the joints that use them.

    Args:
        mesh_files: link → files of its visuals, relative to the URDF, in object-frame coordinates.
            Links that aren't named have no visual.
        collisions: link → its collision geometry; none by default.
        dynamics: joint → what resists its motion; left out by default.
        inertials: link → mass properties; none by default, as in the paper's answers.
        mujoco_visuals: True adds MuJoCo's extension element so that MuJoCo keeps the visuals, the
            meshes' folder and every link; False keeps the links only, for meshes that MuJoCo
            refuses; None leaves the element out. Other readers ignore it.

    Raises:
        KinematicsError: where files or inertials name a link that isn't there.
    """
    meshes, collisions = mesh_files or {}, collisions or {}
    dynamics = dynamics or {}
    inertials = inertials or {}
    _check_links(obj.tree, {**meshes, **collisions, **inertials})
    origins = link_origins(obj.tree)
    part_names = {p.link: p.name for p in obj.parts}
    if mujoco_visuals:  # a visual's name is a geom's there, and those must be unique
        first = {p.name: p.link for p in reversed(obj.parts)}
        part_names = {link: name for name, link in first.items()}
    lines = ['<?xml version="1.0" encoding="utf-8"?>', f"<robot name={_quoted(obj.name)}>"]
    if mujoco_visuals is not None:
        lines += _mujoco_lines(mujoco_visuals)
    for link in obj.tree.order:
        body: list[str] = []
        if link in inertials:
            body += _inertial_lines(inertials[link], origins[link])
        for file in meshes.get(link, ()):
            body += _mesh_lines("visual", file, origins[link], part_names.get(link))
        for shape in collisions.get(link, ()):
            body += _collision_lines(shape, origins[link])
        start = f"  <link name={_quoted(link)}"
        lines += [start + ">", *body, "  </link>"] if body else [start + "/>"]
    leaders = direct_mimics(obj.tree)
    for link in obj.tree.order[1:]:
        joint = obj.tree.joint_of[link]
        lines += _joint_lines(joint, origins, leaders.get(joint.name), dynamics.get(joint.name))
    return "\n".join([*lines, "</robot>", ""])


def number(value: float) -> str:
    """The shortest text that keeps a billionth of the value, not its last bits; never ``-0``."""
    return f"{float(value) + 0.0:.10g}"


def vector(values: npt.ArrayLike) -> str:
    """Metres, radians or parts of a direction, separated by blanks; below 1e-12 is rounding's."""
    exact = np.asarray(values, np.float64)
    return " ".join(number(v) for v in np.where(np.abs(exact) < 1e-12, 0.0, exact))


def rounded(values: npt.ArrayLike) -> list[float]:
    """The numbers that :func:`vector` writes."""
    return [float(text) for text in vector(values).split()]


def xml_name(name: str) -> str:
    """``name``, if XML can hold it.

    Raises:
        ArtiworldError: for control characters and the like.
    """
    for char in name:
        if ord(char) < 32 or 0xD800 <= ord(char) <= 0xDFFF or ord(char) in (0xFFFE, 0xFFFF):
            raise ArtiworldError(
                f"the name {name!r} has a character that XML can't hold ({char!r}); rename it"
            )
    return name


def _quoted(name: str) -> str:
    return quoteattr(xml_name(name))


def _check_links(tree: KinematicTree, named: Mapping[str, object]) -> None:
    unknown = sorted(set(named) - set(tree.links))
    if unknown:
        there = ", ".join(tree.links)
        raise KinematicsError(
            [f"no link {name!r} in the tree; there are {there}" for name in unknown]
        )


def _mujoco_lines(visuals: bool) -> list[str]:
    discard = "false" if visuals else "true"
    return [
        "  <mujoco>",
        f'    <compiler discardvisual="{discard}" strippath="false" fusestatic="false"/>',
        "  </mujoco>",
    ]


def _inertial_lines(inertial: Inertial, origin: npt.NDArray[np.float64]) -> list[str]:
    t = inertial.exact_tensor
    return [
        "    <inertial>",
        f'      <origin xyz="{vector(inertial.center - origin)}" rpy="0 0 0"/>',
        f'      <mass value="{number(inertial.mass)}"/>',
        f'      <inertia ixx="{number(t[0, 0])}" ixy="{number(t[0, 1])}" ixz="{number(t[0, 2])}"'
        f' iyy="{number(t[1, 1])}" iyz="{number(t[1, 2])}" izz="{number(t[2, 2])}"/>',
        "    </inertial>",
    ]


def _mesh_lines(
    tag: str, file: str, origin: npt.NDArray[np.float64], name: str | None
) -> list[str]:
    named = f" name={_quoted(name)}" if name else ""
    return [
        f"    <{tag}{named}>",
        f'      <origin xyz="{vector(-origin)}" rpy="0 0 0"/>',
        "      <geometry>",
        f"        <mesh filename={_quoted(file)}/>",
        "      </geometry>",
        f"    </{tag}>",
    ]


def _collision_lines(shape: CollisionGeometry, origin: npt.NDArray[np.float64]) -> list[str]:
    if isinstance(shape, str):
        return _mesh_lines("collision", shape, origin, None)
    pose = shape.object_from_shape
    if shape.kind == "box":
        element = f'<box size="{vector(shape.sizes)}"/>'
    elif shape.kind == "cylinder":
        element = f'<cylinder radius="{number(shape.sizes[0])}" length="{number(shape.sizes[1])}"/>'
    elif shape.kind == "sphere":
        element = f'<sphere radius="{number(shape.sizes[0])}"/>'
    else:
        raise ArtiworldError(f"URDF has no {shape.kind}; write it as a mesh")
    place = vector(pose[:3, 3] - origin)
    return [
        "    <collision>",
        f'      <origin xyz="{place}" rpy="{vector(rpy_from_rotation(pose[:3, :3]))}"/>',
        f"      <geometry>{element}</geometry>",
        "    </collision>",
    ]


def _joint_lines(
    joint: Joint,
    origins: Mapping[str, npt.NDArray[np.float64]],
    mimic: Mimic | None,
    dynamics: JointDynamics | None,
) -> list[str]:
    offset = origins[joint.child] - origins[joint.parent]
    lines = [
        f'  <joint name={_quoted(joint.name)} type="{joint.type}">',
        f'    <origin xyz="{vector(offset)}" rpy="0 0 0"/>',
        f"    <parent link={_quoted(joint.parent)}/>",
        f"    <child link={_quoted(joint.child)}/>",
    ]
    if joint.moves:
        limits = ""
        if joint.limited:
            assert joint.lower is not None and joint.upper is not None
            limits = f'lower="{number(joint.lower)}" upper="{number(joint.upper)}" '
        effort = EFFORT if dynamics is None else dynamics.effort
        velocity = VELOCITY if dynamics is None else dynamics.velocity
        lines += [
            f'    <axis xyz="{vector(joint.axis)}"/>',
            f'    <limit {limits}effort="{number(effort)}" velocity="{number(velocity)}"/>',
        ]
        if dynamics is not None:
            damping, friction = number(dynamics.damping), number(dynamics.friction)
            lines.append(f'    <dynamics damping="{damping}" friction="{friction}"/>')
        if mimic is not None:
            lines.append(
                f"    <mimic joint={_quoted(mimic.joint)}"
                f' multiplier="{number(mimic.multiplier)}" offset="{number(mimic.offset)}"/>'
            )
    return [*lines, "  </joint>"]


def direct_mimics(tree: KinematicTree) -> dict[str, Mimic]:
    """Joint name → mimic of a joint that mimics nothing: other readers follow one step only."""
    out: dict[str, Mimic] = {}
    for joint in tree.joints:
        mimic = joint.mimic
        while mimic is not None and (after := tree.by_name[mimic.joint].mimic) is not None:
            offset = mimic.multiplier * after.offset + mimic.offset
            mimic = Mimic(after.joint, mimic.multiplier * after.multiplier, offset)
        if mimic is not None:
            out[joint.name] = mimic
    return out
