"""The whole scene as one MJCF file or one SDFormat world, from the assets' own files.

In MJCF an asset's meshes, materials and textures are there once under ``<key>/``; bodies, joints
and all that names them begin with the object's id.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET  # writes; reading is defusedxml's

import numpy as np

from model.core.files import draft_of
from model.core.geometry import quaternion_wxyz
from model.io.export.sdf import FILE, VERSION
from model.io.robot_xml import parse
from model.io.urdf.writer import number, rpy_from_rotation, vector, xml_name
from model.scenes.jobs import ASSETS, MJCF
from model.scenes.scene import FloatArray

_BODY_NAMES = ("name", "body1", "body2", "joint1", "joint2")
_ASSET_NAMES = ("mesh", "material", "texture")


@dataclass(frozen=True)
class Pass:
    """Two links that start inside one another, so that contact between them would throw them apart.

    Attributes:
        link: of the object.
        through: id of the other object.
        through_link: of that one; None where it is a plain box.
        depth: metres.
    """

    link: str
    through: str
    through_link: str | None
    depth: float


@dataclass(frozen=True, eq=False)
class Stand:
    """An object of the MuJoCo scene.

    Attributes:
        id: of the object.
        key: of its asset; None for a plain box.
        world_from_asset: (4, 4).
        free: whether its base may move.
        limits: joint → (lower, upper) where they were shortened.
        friction: joint → N or N m where it is another one than the asset's, which stands upright.
        box: (3,) full sizes of a plain box.
        passes: what passes through other objects.
    """

    id: str
    key: str | None
    world_from_asset: FloatArray
    free: bool = False
    limits: Mapping[str, Sequence[float]] = field(default_factory=dict)
    friction: Mapping[str, float] = field(default_factory=dict)
    box: tuple[float, float, float] | None = None
    passes: tuple[Pass, ...] = ()


def write_scene_mjcf(name: str, stands: Sequence[Stand], out: Path, file: str) -> Path:
    """Write ``out/file``, which refers to the assets' meshes below ``out``.

    Args:
        stands: everything in the scene, in order.
    """
    root = ET.Element("mujoco", model=xml_name(name))
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    assets, world = ET.SubElement(root, "asset"), ET.SubElement(root, "worldbody")
    ET.SubElement(world, "light", pos="0 0 5", dir="0 0 -1", directional="true")
    contact, equality = ET.Element("contact"), ET.Element("equality")
    read: dict[str, ET.Element] = {}
    for stand in stands:
        if stand.key is None:
            _box(world, stand)
            continue
        if stand.key not in read:
            read[stand.key] = _read(out, stand.key, assets)
        source = read[stand.key]
        for body in source.findall("worldbody/body"):
            _place(world, copy.deepcopy(body), stand)
        for tag, target in (("contact", contact), ("equality", equality)):
            for element in source.findall(f"{tag}/*"):
                made = copy.deepcopy(element)
                _prefix(made, _BODY_NAMES, stand.id)
                target.append(made)
    for stand in stands:
        for found in stand.passes:
            ET.SubElement(
                contact,
                "exclude",
                body1=_body(stand.id, found.link),
                body2=_body(found.through, found.through_link),
            )
    root.extend(e for e in (contact, equality) if len(e))
    ET.indent(root)
    with draft_of(out / file) as draft:
        draft.write_bytes(ET.tostring(root, encoding="utf-8") + b"\n")
    return out / file


def _read(out: Path, key: str, assets: ET.Element) -> ET.Element:
    """The asset's MJCF; its meshes and materials go into ``assets``."""
    root = parse(out / ASSETS / key / MJCF / "object.xml")
    compiler = root.find("compiler")
    below = "meshes" if compiler is None else compiler.get("meshdir", ".")
    for element in root.findall("asset/*"):
        made = copy.deepcopy(element)
        if made.get("file"):
            made.set("file", f"{ASSETS}/{key}/{MJCF}/{below}/{made.get('file')}")
        for entry in made.iter():  # a material's layers name textures
            _prefix(entry, ("name", *_ASSET_NAMES), key)
        assets.append(made)
    for geom in root.iter("geom"):
        _prefix(geom, _ASSET_NAMES, key)
    return root


def _place(world: ET.Element, body: ET.Element, stand: Stand) -> None:
    for joint in body.iter("joint"):
        friction = stand.friction.get(joint.get("name", ""))
        if friction is not None:
            joint.set("frictionloss", number(friction))
        limits = stand.limits.get(joint.get("name", ""))
        if limits is not None and limits[0] < limits[1]:
            joint.set("range", vector(limits))
        elif limits is not None:
            # MuJoCo refuses an empty range; a joint that can't move is held where it is.
            joint.set("range", vector([limits[0] - 1e-6, limits[1] + 1e-6]))
    for element in body.iter():
        _prefix(element, _BODY_NAMES, stand.id)
    body.set("pos", vector(stand.world_from_asset[:3, 3]))
    body.set("quat", vector(quaternion_wxyz(stand.world_from_asset)))
    if stand.free:
        body.insert(0, ET.Element("freejoint"))
    world.append(body)


def _body(id: str, link: str | None) -> str:
    return xml_name(id) if link is None else f"{xml_name(id)}/{link}"


def _box(world: ET.Element, stand: Stand) -> None:
    assert stand.box is not None
    body = ET.SubElement(
        world,
        "body",
        name=xml_name(stand.id),
        pos=vector(stand.world_from_asset[:3, 3]),
        quat=vector(quaternion_wxyz(stand.world_from_asset)),
    )
    ET.SubElement(
        body, "geom", type="box", size=vector(np.asarray(stand.box) / 2), rgba="0.8 0.8 0.8 1"
    )


def _prefix(element: ET.Element, names: Sequence[str], before: str) -> None:
    for name in names:
        if element.get(name) is not None:
            element.set(name, f"{xml_name(before)}/{element.get(name)}")


def write_scene_sdf(name: str, stands: Sequence[Stand], out: Path, file: str) -> Path:
    """Write ``out/file``, which refers to the assets' meshes below ``out``.

    Args:
        stands: everything in the scene, in order, each with ``sdf/`` in its asset's folder.
    """
    root = ET.Element("sdf", version=VERSION)
    world = ET.SubElement(root, "world", name=xml_name(name))
    read: dict[str, ET.Element] = {}
    for stand in stands:
        if stand.key is None:
            world.append(_sdf_box(stand))
            continue
        if stand.key not in read:
            model = parse(out / ASSETS / stand.key / "sdf" / FILE).find("model")
            assert model is not None
            for uri in model.iter("uri"):
                uri.text = f"{ASSETS}/{stand.key}/sdf/{uri.text}"
            read[stand.key] = model
        world.append(_placed(copy.deepcopy(read[stand.key]), stand))
    ET.indent(root)
    with draft_of(out / file) as draft:
        draft.write_bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")
    return out / file


def _placed(model: ET.Element, stand: Stand) -> ET.Element:
    model.set("name", xml_name(stand.id))
    pose = ET.Element("pose")
    pose.text = pose_text(stand.world_from_asset)
    model.insert(0, pose)
    world = [j for j in model.findall("joint") if j.findtext("parent") == "world"]
    if stand.free:
        for joint in world:
            model.remove(joint)
    elif not world:
        joint = ET.SubElement(model, "joint", name="fixed_to_world", type="fixed")
        ET.SubElement(joint, "parent").text = "world"
        ET.SubElement(joint, "child").text = model.get("canonical_link")
    for joint in model.findall("joint"):
        friction = stand.friction.get(joint.get("name", ""))
        resists = joint.find("axis/dynamics/friction")
        if friction is not None and resists is not None:
            resists.text = number(friction)
        limits = stand.limits.get(joint.get("name", ""))
        if limits is not None:
            _limit(joint, limits)
    return model


def _limit(joint: ET.Element, limits: Sequence[float]) -> None:
    if joint.get("type") == "continuous":
        joint.set("type", "revolute")
    limit = joint.find("axis/limit")
    assert limit is not None
    for tag, value in (("lower", limits[0]), ("upper", limits[1])):
        element = limit.find(tag)
        element = ET.SubElement(limit, tag) if element is None else element
        element.text = number(value)


def _sdf_box(stand: Stand) -> ET.Element:
    assert stand.box is not None
    model = ET.Element("model", name=xml_name(stand.id))
    ET.SubElement(model, "static").text = "true"
    ET.SubElement(model, "pose").text = pose_text(stand.world_from_asset)
    link = ET.SubElement(model, "link", name="box")
    for tag in ("collision", "visual"):
        shape = ET.SubElement(ET.SubElement(link, tag, name=tag), "geometry")
        ET.SubElement(ET.SubElement(shape, "box"), "size").text = vector(np.asarray(stand.box))
    return model


def pose_text(world: FloatArray) -> str:
    """A (4, 4) pose as SDF has it: metres, then roll, pitch and yaw in radians."""
    return f"{vector(world[:3, 3])} {vector(rpy_from_rotation(world[:3, :3]))}"
