"""LISDF and SDF worlds: XML that places models by ``<include>``, and others inline by ``<model>``.

Metres, radians unless ``degrees`` says otherwise, +z up. A pose that is left out is the identity,
as SDF has it; ``relative_to`` names a frame, a model or an include of the world.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from model.core.errors import InputFileError
from model.io.export.part_files import write_collision, write_parts
from model.io.robot_xml import XmlSchema, parse
from model.io.urdf.sdf import MODEL
from model.io.urdf.sdf_frames import find_model, frame_from_model, model_in, pose_of
from model.io.urdf.writer import read_urdf_model, to_urdf_text
from model.scenes.scene import (
    FloatArray,
    Scene,
    SceneObject,
    SceneObjectError,
    SceneProblem,
    upright,
)
from model.scenes.unpacking import Unpacked, Unpacker
from model.scenes.values import collect, numbers, shown

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_WORLD = XmlSchema.of(
    (
        ("sdf", "world", "version"),
        ("world", "include model frame", "name"),
        ("include", "name uri pose static scale placement_frame", "name merge placement_frame"),
        *((leaf, "", "") for leaf in ("name", "uri", "static", "scale", "placement_frame")),
    ),
    # Simulation and looks.
    "physics scene gui gravity magnetic_field atmosphere spherical_coordinates audio wind light "
    "state road population layer",
)
SDF = replace(
    MODEL,
    elements={**MODEL.elements, **_WORLD.elements},
    passed_over=MODEL.passed_over | _WORLD.passed_over,
    repeated=frozenset("world include model frame link joint visual collision".split()),
    choices=frozenset({"geometry"}),
)
"""The elements and attributes of a world that are read."""
_GENERIC = frozenset({"models", "urdf", "robots", "meshes", "assets", "", ".", ".."})


class LisdfReader:
    """``<include>`` are objects with an asset; of ``<model>`` a single box is a plain box, all
    others hold their asset."""

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
        reported: list[SceneProblem] = []
        make = partial(_object, path, _frames(world), reported)
        objects, problems = collect(entries, make, _name)
        name = world.get("name") or path.stem
        notes = SDF.unread(root)
        if len(root.findall("world")) > 1:
            notes.append(f"only the first of {len(root.findall('world'))} worlds is read")
        reported += [SceneProblem(name, note, False) for note in notes]
        return Scene(name, path, self.name, objects, (*problems, *reported))

    def unpack(self, scene: Scene, folder: Path) -> Unpacked:
        """See :class:`~model.scenes.unpacking.GeometryReader`."""
        made = Unpacker(folder)
        models = parse(scene.path).findall("world/model")[:]
        for obj in scene.objects:
            if obj.place and obj.place[0] == "model" and obj.asset is not None:
                index = int(obj.place[1])
                write = partial(_written, scene.path, models[index], folder / f"model_{index}")
                made.put(obj.asset, write)
        return made.result()


def _written(path: Path, model: Element, folder: Path) -> Path:
    """The folder of a URDF that says the same as an inline model."""
    read = read_urdf_model(path, model=model)
    obj = read.declared.of(read.load())
    folder.mkdir()
    meshes = {p.link: [p.mesh] for p in write_parts(obj, folder, clouds=False)}
    shapes = write_collision(obj.shapes, obj.parts, folder)
    text = to_urdf_text(obj, meshes, collisions=shapes, inertials=obj.inertials)
    (folder / "object.urdf").write_text(text, encoding="utf-8")
    return folder


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
    path: Path,
    frames: Mapping[str, Element],
    reported: list[SceneProblem],
    place: tuple[str | int, ...],
    element: Element,
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
        box = _box(element)
        if box is None:
            return _inline(path, element, world, reported, common)
        local, size = box
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
    world = world @ _from_frame(path, element, uri, reported)
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


def _from_frame(path: Path, include: Element, uri: str, reported: list[SceneProblem]) -> FloatArray:
    """(4, 4) of the model's origin as seen from what ``<include>`` places: a frame of the model,
    or, where it says no pose, the model in its own."""
    frame = (include.findtext("placement_frame") or "").strip()
    if not frame and include.find("pose") is not None:
        return np.eye(4)
    file = find_model(uri, path)
    if file is None:
        if frame:
            what = f"its placement_frame {shown(frame)} is not read: no SDF is beside the world"
            reported.append(SceneProblem(_name(include) or uri, what, False))
        return np.eye(4)
    try:
        model = model_in(file)
        return frame_from_model(model, file, frame) if frame else pose_of(model)
    except (InputFileError, ValueError) as error:
        raise SceneObjectError(str(error)) from None


def _inline(
    path: Path,
    model: Element,
    world: FloatArray,
    reported: list[SceneProblem],
    common: dict[str, Any],
) -> SceneObject:
    """An object whose links and joints stand in the world."""
    name, frame = common["id"], model.get("placement_frame", "")
    try:
        read = read_urdf_model(path, model=deepcopy(model))
        world = world @ frame_from_model(model, path, frame)
    except (InputFileError, ValueError) as error:
        raise SceneObjectError(str(error).removeprefix(f"{path}: ")) from None
    if not read.visuals:
        raise SceneObjectError("has no mesh, box, cylinder, sphere or capsule; its links hold none")
    reported += [SceneProblem(name, note, False) for note in read.notes]
    return SceneObject(
        description=readable(name),
        world_from_object=world,
        scale=np.ones(3),
        asset=f"{path.name}#{name}",
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


def _box(model: Element) -> tuple[FloatArray, tuple[float, float, float]] | None:
    """Pose and size of a model that is one box and nothing else; None for others."""
    shapes = [s for s in model.iter() if s.tag in ("collision", "visual")]
    sizes = {s.findtext("geometry/box/size") for s in shapes}
    links = [e for e in model if e.tag in ("link", "model", "include", "joint")]
    if len(links) != 1 or len(sizes) != 1 or None in sizes or model.find("link") is None:
        return None
    poses = [_pose(links[0]) @ _pose(s) for s in shapes]
    if not all(np.allclose(p, poses[0]) for p in poses):
        return None
    x, y, z = numbers(_floats(str(next(iter(sizes))), "box size"), 3, "box size")
    return poses[0], (x, y, z)


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
