"""LISDF and SDF worlds: XML that places URDFs by ``<include>`` and plain boxes by ``<model>``.

Metres, radians unless ``degrees`` says otherwise, +z up. A pose that is left out is the identity,
as SDF has it; ``relative_to`` names a frame, a model or an include of the world.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from model.core.errors import InputFileError
from model.io.robot_xml import XmlSchema, parse
from model.io.urdf.sdf import pose_of
from model.scenes.scene import (
    FloatArray,
    Scene,
    SceneObject,
    SceneObjectError,
    SceneProblem,
    upright,
)
from model.scenes.values import collect, numbers, shown

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

SDF = XmlSchema.of(
    (
        ("sdf", "world", "version"),
        ("world", "include model frame", "name"),
        ("include", "name uri pose static scale", "name"),
        ("model", "pose static link", "name canonical_link"),
        ("frame", "pose", "name attached_to"),
        ("link", "pose collision visual", "name"),
        ("collision", "pose geometry", "name"),
        ("visual", "pose geometry", "name"),
        ("geometry", "box", ""),
        ("box", "size", ""),
        ("pose", "", "relative_to degrees rotation_format"),
        *((leaf, "", "") for leaf in ("name", "uri", "static", "scale", "size")),
    ),
    # Simulation and looks.
    "physics plugin scene gui gravity magnetic_field atmosphere spherical_coordinates audio wind "
    "light sensor material surface inertial laser_retro max_contacts cast_shadows transparency "
    "visibility_flags meta layer enable_wind self_collide kinematic velocity_decay "
    "allow_auto_disable",
    repeated="world include model frame link collision visual",
    choices="geometry",
)
"""The elements and attributes of a world that are read."""
_GENERIC = frozenset({"models", "urdf", "robots", "meshes", "assets", "", ".", ".."})


class LisdfReader:
    """``<include>`` are objects with an asset; ``<model>`` with a box geometry are plain boxes."""

    name = "lisdf"
    description = "LISDF and SDF worlds"

    def recognises(self, path: Path, head: bytes) -> bool:
        """See :class:`~model.scenes.scene.SceneReader`."""
        return path.suffix.lower() in (".lisdf", ".sdf", ".world") or b"<sdf" in head[:2048]

    def read(self, path: Path) -> Scene:
        """See :class:`~model.scenes.scene.SceneReader`."""
        root = parse(path)
        world = root.find("world") if root.tag == "sdf" else None
        if world is None:
            raise InputFileError(path, "holds no <sdf> with a <world>", "give an LISDF world")
        entries = [
            ((element.tag, i), element)
            for tag in ("include", "model")
            for i, element in enumerate(world.findall(tag))
        ]
        objects, problems = collect(entries, partial(_object, _frames(world)), _name)
        name = world.get("name") or path.stem
        problems += tuple(SceneProblem(name, note, False) for note in _notes(root, world))
        return Scene(name, path, self.name, objects, problems)


def _notes(root: Element, world: Element) -> list[str]:
    """Remarks about what is in the file and not in the scene."""
    out = SDF.unread(root)
    if len(root.findall("world")) > 1:
        out.append(f"only the first of {len(root.findall('world'))} worlds is read")
    several = [m for m in world.findall("model") if len(m.findall("link")) > 1]
    if several:
        out.append(f"only the first box is read of {len(several)} models with several links")
    return out


def _name(element: Element) -> str | None:
    return element.get("name") or (element.findtext("name") or "").strip() or None


def _frames(world: Element) -> dict[str, Element]:
    """Name → element of the world to whose pose another may be relative."""
    return {
        name: element
        for tag in ("frame", "model", "include")
        for element in world.findall(tag)
        if (name := _name(element)) is not None
    }


def _object(
    frames: Mapping[str, Element], place: tuple[str | int, ...], element: Element
) -> SceneObject:
    name = _name(element)
    if name is None:
        raise SceneObjectError("has no name; each object needs one")
    static = (element.findtext("static") or "").strip().lower()
    common: dict[str, Any] = {
        "id": name,
        "static": {"true": True, "1": True, "false": False, "0": False}.get(static),
        "place": place,
    }
    world = _placed(frames, element)
    if element.tag == "model":
        local, size = _box(element)
        return SceneObject(
            description=readable(name),
            world_from_object=world @ local,
            scale=np.ones(3),
            box=size,
            anchor="center",
            **common,
        )
    uri = (element.findtext("uri") or "").strip()
    if not uri:
        raise SceneObjectError("has no <uri>; the URDF or mesh that it shows is needed")
    category = category_of(uri)
    words = readable(name)
    description = words if category is None else f"{words} ({readable(category)})"
    scale = _scale(element)
    if scale.all():
        world[:3, :3], scale = upright(world[:3, :3], scale)
    return SceneObject(
        description=description,
        world_from_object=world,
        scale=scale,
        asset=uri,
        category=category,
        **common,
    )


def _floats(text: str, what: str) -> list[float]:
    try:
        return [float(word) for word in text.split()]
    except ValueError:
        raise SceneObjectError(f"{what} is {shown(text)}; numbers are needed") from None


def _placed(frames: Mapping[str, Element], element: Element) -> FloatArray:
    """(4, 4) world_from_element along the chain of ``relative_to`` (and ``attached_to``)."""
    out, seen = _pose(element), set[str]()
    while True:
        given = element.find("pose")
        above = "" if given is None else given.get("relative_to", "")
        above = above or element.get("attached_to", "")
        if above in ("", "world", "__root__"):
            return out
        if above not in frames or above in seen:
            what = "is in a cycle of frames" if above in seen else "is no frame of the world"
            raise SceneObjectError(f"its pose is relative to {shown(above)}, which {what}")
        seen.add(above)
        element = frames[above]
        out = _pose(element) @ out


def _pose(element: Element) -> FloatArray:
    """(4, 4) of its ``<pose>``."""
    try:
        return pose_of(element)
    except ValueError as error:
        raise SceneObjectError(str(error)) from None


def _scale(element: Element) -> FloatArray:
    text = element.findtext("scale")
    if text is None:
        return np.ones(3)
    values = _floats(text, "scale")
    return numbers(values * 3 if len(values) == 1 else values, 3, "scale")


def _box(model: Element) -> tuple[FloatArray, tuple[float, float, float]]:
    for link in model.iter("link"):
        for tag in ("collision", "visual"):
            for shape in link.findall(tag):
                size = shape.findtext("geometry/box/size")
                if size is not None:
                    x, y, z = numbers(_floats(size, "box size"), 3, "box size")
                    return _pose(link) @ _pose(shape), (x, y, z)
    raise SceneObjectError("is a <model> without a box; boxes and <include> are read")


def category_of(uri: str) -> str | None:
    """``models/Microwave/7128/mobility.urdf`` → ``Microwave``: the folder with a word in it."""
    folders = uri.replace("\\", "/").split("/")[:-1]
    for folder in reversed(folders):
        if folder.lower() not in _GENERIC and re.fullmatch(r"[A-Za-z][A-Za-z_ ]*[A-Za-z]", folder):
            return folder
    return None


def readable(name: str) -> str:
    """``CabinetLower#2`` → ``cabinet lower``."""
    text = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    text = re.sub(r"[^A-Za-z]+", " ", text)
    return text.strip().lower() or name
