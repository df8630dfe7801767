"""SDFormat for Gazebo and Drake, with ``model.config`` so that the folder is a Gazebo model.

Links sit where URDF link frames sit (``model.io.urdf.writer``), their poses are the model's frame
at rest, and a joint's frame is its child's, so axes need no turning. Materials are those of the
meshes' MTL, of which Gazebo reads normal and emissive maps too; one in the SDF would replace all of
a link's by itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations_with_replacement
from pathlib import Path
from xml.etree import ElementTree as ET  # only writes; reading is defusedxml's

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject, Inertial
from model.core.composite_joints import COMPOSITES, composite_of
from model.core.files import free_name
from model.core.joint import Joint, Mimic
from model.core.progress import Progress
from model.core.shapes import Primitive, Solid
from model.core.tree import KinematicTree
from model.io.export.formats import FileExporter
from model.io.export.part_files import write_collision, write_parts
from model.io.urdf.writer import (
    direct_mimics,
    link_origins,
    number,
    rpy_from_rotation,
    vector,
    xml_name,
)
from model.physics.inertia import HELPER
from model.physics.simulation_values import Physics

FILE, CONFIG = "model.sdf", "model.config"
VERSION = "1.11"
"""The first version with mimic joints."""


_PITCHED = next(row.sdf for row in COMPOSITES.values() if row.pitched)


def sdf_tree(obj: ArticulatedObject) -> tuple[KinematicTree, dict[str, float]]:
    """The tree as SDF holds it, in which a screw is one joint: without its slide and helper link.

    Returns:
        The tree, and the pitch of each screw in metres by the joint's name. A screw whose slide
        has an offset, or is followed by another joint, stays two joints.
    """
    tree, links = obj.tree, {p.link for p in obj.parts}
    followed = [j.mimic.joint for j in tree.joints if j.mimic is not None]
    pitches: dict[str, float] = {}
    parents: dict[str, str] = {}
    helpers = set()
    for joint in tree.joints:
        motion = composite_of(tree, joint.child, links.__contains__)
        if not motion.pitch:
            continue
        slide = tree.joint_of[joint.parent]
        if slide.name in followed or (slide.mimic is not None and slide.mimic.offset):
            continue
        pitches[joint.name], parents[joint.name] = motion.pitch, slide.parent
        helpers.add(slide.child)
    joints = (
        replace(j, parent=parents.get(j.name, j.parent))
        for j in tree.joints
        if j.child not in helpers
    )
    return KinematicTree(tuple(x for x in tree.links if x not in helpers), tuple(joints)), pitches


class SdfExporter(FileExporter):
    """``model.sdf``, ``model.config`` and ``meshes/``."""

    name = "sdf"

    def write(
        self, obj: ArticulatedObject, folder: Path, physics: Physics, progress: Progress
    ) -> tuple[Path, ...]:
        """See :class:`~model.io.export.formats.FileExporter`."""
        parts = write_parts(obj, folder, clouds=False, progress=progress)
        shapes = write_collision(physics.collision, obj.parts, folder, capsules=True)
        visuals = {p.link: p.mesh for p in parts}
        called = {p.link: p.name for p in obj.parts}
        sdf = ET.Element("sdf", version=VERSION)
        model = ET.SubElement(sdf, "model", name=xml_name(obj.name), canonical_link=obj.tree.root)
        tree, pitches = sdf_tree(obj)
        origins = link_origins(tree)
        for link in tree.order:
            element = ET.SubElement(model, "link", name=xml_name(link))
            _text(element, "pose", _pose(origins[link]))
            _inertial(element, physics.inertials.get(link, HELPER), origins[link])
            if link in visuals:
                _geometry(element, "visual", visuals[link], 0, origins[link])
                if name := called.get(link):  # reading takes the part's name from it
                    element[-1].set("name", xml_name(name))
            held = zip(shapes.get(link, []), physics.collision.get(link, ()), strict=True)
            for i, (shape, whole) in enumerate(held):
                convex = not isinstance(whole, Solid)
                _geometry(element, "collision", shape, i, origins[link], convex)
        names, mimics = sdf_joint_names(tree), direct_mimics(tree)
        for joint in tree.joints:
            mimic, pitch = mimics.get(joint.name), pitches.get(joint.name)
            _joint(model, joint, names, mimic, pitch, physics)
        if physics.fixed_base:
            root = ET.SubElement(
                model, "joint", name=free_name("fixed_to_world", names.values()), type="fixed"
            )
            _text(root, "parent", "world")
            _text(root, "child", obj.tree.root)
        config = ET.Element("model")
        _text(config, "name", xml_name(obj.name))
        _text(config, "version", "1.0")
        ET.SubElement(config, "sdf", version=VERSION).text = FILE
        _text(config, "description", f"Articulated object {xml_name(obj.name)}")
        _write(folder / FILE, sdf)
        _write(folder / CONFIG, config)
        files = [folder / s for held in shapes.values() for s in held if isinstance(s, str)]
        return (folder / FILE, folder / CONFIG, *(folder / p.mesh for p in parts), *files)


def sdf_joint_names(tree: KinematicTree) -> dict[str, str]:
    """Joint → its name in the file: links and joints share one set of names there."""
    taken = {*tree.links, *tree.by_name}
    out: dict[str, str] = {}
    for joint in tree.joints:
        name = joint.name
        while name in tree.links or (name != joint.name and name in taken):
            name += "_joint"
        taken.add(name)
        out[joint.name] = name
    return out


def _text(parent: ET.Element, tag: str, text: str) -> ET.Element:
    element = ET.SubElement(parent, tag)
    element.text = text
    return element


def _pose(place: npt.ArrayLike, rotation: npt.NDArray[np.float64] | None = None) -> str:
    turn = np.zeros(3) if rotation is None else rpy_from_rotation(rotation)
    return f"{vector(place)} {vector(turn)}"


def _inertial(link: ET.Element, inertial: Inertial, origin: npt.NDArray[np.float64]) -> None:
    element = ET.SubElement(link, "inertial")
    center = inertial.center if inertial is not HELPER else origin
    _text(element, "pose", _pose(center - origin))
    _text(element, "mass", number(inertial.mass))
    tensor = ET.SubElement(element, "inertia")
    for i, j in combinations_with_replacement(range(3), 2):
        _text(tensor, f"i{'xyz'[i]}{'xyz'[j]}", number(inertial.exact_tensor[i, j]))


def _geometry(
    link: ET.Element,
    tag: str,
    shape: str | Primitive,
    count: int,
    origin: npt.NDArray[np.float64],
    convex: bool = False,
) -> None:
    element = ET.SubElement(link, tag, name=f"{tag}_{count}")
    if isinstance(shape, str):
        _text(element, "pose", _pose(-origin))
        mesh = ET.SubElement(ET.SubElement(element, "geometry"), "mesh")
        if convex:
            mesh.set("optimization", "convex_hull")
        _text(mesh, "uri", shape)
        return
    pose = shape.object_from_shape
    _text(element, "pose", _pose(pose[:3, 3] - origin, pose[:3, :3]))
    kind = ET.SubElement(ET.SubElement(element, "geometry"), shape.kind)
    if shape.kind == "box":
        _text(kind, "size", vector(shape.sizes))
        return
    _text(kind, "radius", number(shape.sizes[0]))
    if len(shape.sizes) > 1:
        _text(kind, "length", number(shape.sizes[1]))


def _joint(
    model: ET.Element,
    joint: Joint,
    names: Mapping[str, str],
    mimic: Mimic | None,
    pitch: float | None,
    physics: Physics,
) -> None:
    kind = joint.type if pitch is None else _PITCHED
    element = ET.SubElement(model, "joint", name=xml_name(names[joint.name]), type=kind)
    _text(element, "parent", joint.parent)
    _text(element, "child", joint.child)
    if not joint.moves:
        return
    if pitch is not None:
        _text(element, "screw_thread_pitch", number(pitch))
    axis = ET.SubElement(element, "axis")
    _text(axis, "xyz", vector(joint.axis))
    limit = ET.SubElement(axis, "limit")
    if joint.limited:
        _text(limit, "lower", number(joint.lower or 0.0))
        _text(limit, "upper", number(joint.upper or 0.0))
    dynamics = physics.dynamics.get(joint.name)
    if dynamics is not None:
        _text(limit, "effort", number(dynamics.effort))
        _text(limit, "velocity", number(dynamics.velocity))
        resists = ET.SubElement(axis, "dynamics")
        _text(resists, "damping", number(dynamics.damping))
        _text(resists, "friction", number(dynamics.friction))
    if mimic is not None:
        follows = ET.SubElement(axis, "mimic", joint=xml_name(names[mimic.joint]))
        _text(follows, "multiplier", number(mimic.multiplier))
        _text(follows, "offset", number(mimic.offset))
        _text(follows, "reference", "0")


def _write(path: Path, root: ET.Element) -> None:
    ET.indent(root)
    path.write_bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")
