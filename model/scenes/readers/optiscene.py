"""OptiScene: a language model's text with a design and JSON, and maybe the prompt before it.

Metres, radians about +z, origin at the room's middle. Sizes are in the prompt's
``bounding box: [{h, w, d}]`` where the text has it. The position is taken as the middle of an
object's bottom, which the format doesn't tell. Objects have no ids of assets: an asset is found by
the object's own words.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from model.core.errors import InputFileError
from model.scenes.poses import about_z, pose
from model.scenes.scene import FloatArray, Scene, SceneObject, SceneObjectError
from model.scenes.values import Place, collect, maybe_text, numbers, read_text, shown, text

Size = tuple[float, float, float]
_MOST_BRACES = 2_000
"""Places where JSON may begin that are tried; a design has a handful."""


class OptiSceneReader:
    """Text with ``[Design]`` or ``"room type"``, and objects with ``coordinates``."""

    name = "optiscene"
    description = "OptiScene texts"

    def recognises(self, path: Path, head: bytes) -> bool:
        """See :class:`~model.scenes.protocol.SceneReader`."""
        known = path.suffix.lower() in (".txt", ".json", ".md")
        return known and (b"[Design]" in head or b'"room type"' in head)

    def read(self, path: Path) -> Scene:
        """See :class:`~model.scenes.protocol.SceneReader`."""
        found = find_design(read_text(path))
        if found is None:
            raise InputFileError(
                path, "holds no JSON with a list 'objects' that have coordinates",
                "give OptiScene's answer as it was written",
            )  # fmt: skip
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
    if not isinstance(entry, dict):
        raise SceneObjectError(f"is {shown(entry)}; an object with coordinates is needed")
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
