"""The whole scene as one MJCF file, from the assets' own MJCF files.

An asset's meshes, materials and textures are there once under ``<key>/``; bodies, joints and all
that names them begin with the object's id.
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
from model.io.urdf.writer import number, vector, xml_name
from model.scenes.jobs import ASSETS, MJCF
from model.scenes.readers.lisdf import parse_xml
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
                contact, "exclude", body1=_body(stand.id, found.link),
                body2=_body(found.through, found.through_link),
            )  # fmt: skip
    root.extend(e for e in (contact, equality) if len(e))
    ET.indent(root)
    with draft_of(out / file) as draft:
        draft.write_bytes(ET.tostring(root, encoding="utf-8") + b"\n")
    return out / file


def _read(out: Path, key: str, assets: ET.Element) -> ET.Element:
    """The asset's MJCF; its meshes and materials go into ``assets``."""
    root = parse_xml(out / ASSETS / key / MJCF / "object.xml")
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
        world, "body", name=xml_name(stand.id), pos=vector(stand.world_from_asset[:3, 3]),
        quat=vector(quaternion_wxyz(stand.world_from_asset)),
    )  # fmt: skip
    ET.SubElement(
        body, "geom", type="box", size=vector(np.asarray(stand.box) / 2), rgba="0.8 0.8 0.8 1"
    )


def _prefix(element: ET.Element, names: Sequence[str], before: str) -> None:
    for name in names:
        if element.get(name) is not None:
            element.set(name, f"{xml_name(before)}/{element.get(name)}")
