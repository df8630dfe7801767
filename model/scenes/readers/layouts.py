"""Layouts of generated scenes, which name assets or boxes: InternScenes, MesaTask, OptiScene.

InternScenes ``layout.json`` is a list of boxes with the asset that fills each. Metres, +z up.
``bbox`` is taken as centre, size and Euler angles in radians, applied about the fixed x, y and z
axes in turn; the asset is stretched to fill the box.

MesaTask tables are ``layout.json`` (metres, +z up, quaternions x y z w), or what the language model
writes before assets are chosen: centimetres and degrees about +z, without assets; its ``size`` is
what an asset would be stretched to. The position is taken as the middle of an object's bounding
box.

OptiScene is a language model's text with a design and JSON, and maybe the prompt before it. Metres,
radians about +z, origin at the room's middle. Sizes are in the prompt's
``bounding box: [{h, w, d}]`` where the text has it. The position is taken as the middle of an
object's bottom, which the format doesn't tell. Objects have no ids of assets: an asset is found by
the object's own words.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from model.core.errors import InputFileError
from model.scenes.readers.lisdf import readable
from model.scenes.scene import FloatArray, Scene, SceneFrame, SceneObject, SceneObjectError, upright
from model.scenes.values import (
    JsonReader,
    Place,
    about_z,
    collect,
    from_rpy,
    maybe_text,
    numbers,
    pose,
    read_json,
    read_text,
    rotation_from_quaternion,
    shown,
    table,
    text,
)


class InternScenesReader(JsonReader):
    """A list of ``{id, category, model_uid, bbox}``."""

    name = "internscenes"
    description = "InternScenes layouts (layout.json)"
    marks = (b'"model_uid"',)

    def read(self, path: Path) -> Scene:
        """See :class:`~model.scenes.scene.SceneReader`."""
        layout = read_json(path)
        if not isinstance(layout, list):
            raise InputFileError(path, "is no list of objects", "give an InternScenes layout.json")
        entries = [((i,), e) for i, e in enumerate(layout)]
        objects, problems = collect(entries, _filled_box, _id)
        return Scene(path.parent.name or path.stem, path, self.name, objects, problems)


def _id(entry: Any) -> str | None:
    value = entry.get("id")
    return None if value is None or isinstance(value, bool) else str(value)


def _filled_box(place: Place, entry: Any) -> SceneObject:
    entry = table(entry, "model_uid and bbox")
    id = _id(entry)
    if not id:
        raise SceneObjectError(f"id is {shown(entry.get('id'))}; a text or number is needed")
    asset = text(entry.get("model_uid"), "model_uid")
    box = numbers(entry.get("bbox"), 9, "bbox")
    category = maybe_text(entry.get("category"))
    x, y, z = box[3:6]
    return SceneObject(
        id=id,
        description=readable(category or id),
        world_from_object=from_rpy(np.concatenate([box[:3], box[6:]])),
        scale=np.ones(3),
        asset=asset,
        category=category,
        anchor="center",
        fit=(x, y, z),
        place=place,
    )


CENTIMETRES = 0.01


class MesaTaskReader(JsonReader):
    """``objects`` with ``instance`` and either ``retrieved_uid`` or ``description``."""

    name = "mesatask"
    description = "MesaTask tables (layout.json, or the language model's output)"
    marks = (b'"item_placement_zone"', b'"retrieved_uid"')

    def read(self, path: Path) -> Scene:
        """See :class:`~model.scenes.scene.SceneReader`."""
        layout = read_json(path)
        if not isinstance(layout, dict) or not isinstance(layout.get("objects"), list):
            raise InputFileError(path, "has no list 'objects'", "give a MesaTask layout")
        entries = [(("objects", i), e) for i, e in enumerate(layout["objects"])]
        words = any(isinstance(e, dict) and "z_rotation" in e for _, e in entries)
        make = _from_words if words else _from_layout
        objects, problems = collect(entries, make, lambda e: maybe_text(e.get("instance")))
        frame = SceneFrame(unit_scale=CENTIMETRES if words else 1.0)
        return Scene(path.parent.name or path.stem, path, self.name, objects, problems, frame)


def _from_layout(place: Place, entry: Any) -> SceneObject:
    entry = table(entry, "instance")
    name = text(entry.get("instance"), "instance")
    turn = rotation_from_quaternion(numbers(entry.get("rotation"), 4, "rotation"))
    factor = entry.get("scale_factor")
    if isinstance(factor, (int, float)) and not isinstance(factor, bool):
        factor = [factor] * 3
    scale = np.ones(3) if factor is None else numbers(factor, 3, "scale_factor")
    if scale.all():
        turn, scale = upright(turn, scale)
    return SceneObject(
        id=name,
        description=maybe_text(entry.get("description")) or readable(name),
        world_from_object=pose(numbers(entry.get("position"), 3, "position"), turn),
        scale=scale,
        asset=text(entry.get("retrieved_uid"), "retrieved_uid"),
        category=maybe_text(entry.get("category")),
        anchor="center",
        place=place,
    )


def _from_words(place: Place, entry: Any) -> SceneObject:
    entry = table(entry, "instance")
    name = text(entry.get("instance"), "instance")
    angle = entry.get("z_rotation", 0.0)
    turn = about_z(math.radians(float(numbers([angle], 1, "z_rotation")[0])))
    x, y, z = numbers(entry.get("size"), 3, "size") * CENTIMETRES
    where = numbers(entry.get("position"), 3, "position") * CENTIMETRES
    return SceneObject(
        id=name,
        description=maybe_text(entry.get("description")) or readable(name),
        world_from_object=pose(where, turn),
        scale=np.ones(3),
        asset=maybe_text(entry.get("retrieved_uid")),
        anchor="center",
        fit=(x, y, z),
        place=place,
    )


Size = tuple[float, float, float]
_MOST_BRACES = 2_000
"""Places where JSON may begin that are tried; a design has a handful."""


class OptiSceneReader:
    """Text with ``[Design]`` or ``"room type"``, and objects with ``coordinates``."""

    name = "optiscene"
    description = "OptiScene texts"

    def recognises(self, path: Path, head: bytes) -> bool:
        """See :class:`~model.scenes.scene.SceneReader`."""
        known = path.suffix.lower() in (".txt", ".json", ".md")
        return known and (b"[Design]" in head or b'"room type"' in head)

    def read(self, path: Path) -> Scene:
        """See :class:`~model.scenes.scene.SceneReader`."""
        found = find_design(read_text(path))
        if found is None:
            raise InputFileError(
                path,
                "holds no JSON with a list 'objects' that have coordinates",
                "give OptiScene's answer as it was written",
            )
        design, sizes, _ = found
        room = maybe_text(design.get("room type"))
        entries = [(("objects", i), e) for i, e in enumerate(design["objects"])]
        make = partial(_object, sizes, room)
        objects, problems = collect(entries, make, lambda e: maybe_text(e.get("object")))
        return Scene(room or path.stem, path, self.name, objects, problems)


def find_design(whole: str) -> tuple[dict[str, Any], dict[str, Size], tuple[int, int]] | None:
    """The design, sizes by object, and where the design's JSON stands in the text."""
    design: tuple[dict[str, Any], tuple[int, int]] | None = None
    sizes: dict[str, Size] = {}
    for value, span in _json_values(whole):
        for entry in _dicts(value):
            name, size = maybe_text(entry.get("object")), _size(entry.get("bounding box"))
            if name is not None and size is not None:
                sizes.setdefault(name.lower(), size)
        listed = value.get("objects") if isinstance(value, dict) else None
        if isinstance(listed, list) and any(
            isinstance(e, dict) and "coordinates" in e for e in listed
        ):
            design = value, span  # the last one is the answer
    return None if design is None else (design[0], sizes, design[1])


def _json_values(whole: str) -> Iterator[tuple[Any, tuple[int, int]]]:
    decoder = json.JSONDecoder()
    at = 0
    for _ in range(_MOST_BRACES):
        begin = re.compile(r"[{\[]").search(whole, at)
        if begin is None:
            return
        try:
            value, at = decoder.raw_decode(whole, begin.start())
            yield value, (begin.start(), at)
        except ValueError:
            at = begin.end()
        except RecursionError:
            return


def _dicts(value: Any) -> Iterator[dict[str, Any]]:
    stack = [value]
    while stack:
        here = stack.pop()
        if isinstance(here, dict):
            yield here
            stack += here.values()
        elif isinstance(here, list):
            stack += here


def _size(value: Any) -> Size | None:
    """(x, y, z) metres of ``[{h, w, d}]``."""
    entry = value[0] if isinstance(value, list) and value else value
    if not isinstance(entry, dict):
        return None
    try:
        x, y, z = numbers([entry.get(k) for k in "wdh"], 3, "bounding box")
    except SceneObjectError:
        return None
    return (x, y, z) if min(x, y, z) > 0 else None


def _first(value: Any, what: str) -> dict[str, Any]:
    entry = value[0] if isinstance(value, list) and value else value
    if not isinstance(entry, dict):
        raise SceneObjectError(f"{what} is {shown(value)}; as in [{{…}}] is needed")
    return entry


def _object(sizes: dict[str, Size], room: str | None, place: Place, entry: Any) -> SceneObject:
    entry = table(entry, "coordinates")
    name = text(entry.get("object"), "object")
    where: FloatArray = numbers(_first(entry.get("coordinates"), "coordinates"), 3, "coordinates")
    angle = 0.0
    if entry.get("rotate") is not None:
        given = _first(entry["rotate"], "rotate").get("angle")
        angle = float(numbers([given], 1, "rotate angle")[0])
    return SceneObject(
        id=name,
        description=maybe_text(entry.get("description")) or name,
        world_from_object=pose(where, about_z(angle)),
        scale=np.ones(3),
        asset=maybe_text(entry.get("asset")) or name,
        room=room,
        anchor="base",
        fit=_size(entry.get("bounding box")) or sizes.get(name.lower()),
        place=place,
    )
