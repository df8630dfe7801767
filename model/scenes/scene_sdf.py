"""The whole scene as one SDFormat world, from the assets' own ``sdf/model.sdf``."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree as ET  # writes; reading is defusedxml's

import numpy as np

from model.core.files import draft_of
from model.io.export.sdf import FILE, VERSION
from model.io.urdf.writer import number, rpy_from_rotation, vector, xml_name
from model.scenes.jobs import ASSETS
from model.scenes.readers.lisdf import parse_xml
from model.scenes.scene import FloatArray
from model.scenes.scene_mjcf import Stand


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
            world.append(_box(stand))
            continue
        if stand.key not in read:
            model = parse_xml(out / ASSETS / stand.key / "sdf" / FILE).find("model")
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


def _box(stand: Stand) -> ET.Element:
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
