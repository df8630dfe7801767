"""ArtiWorld's own scene file, ``scene.json``: reading and writing.

::

    {"artiworld_scene": 1, "name", "source": {"file", "reader", "frame": {…}},
     "objects": [{"id", "description", "category", "room", "asset", "position", "quaternion_wxyz",
                  "scale", "anchor", "fit", "static", "obstacle", "base", "solid", "box",
                  …what the conversion says}],
     "problems": [{"object", "reason", "skipped"}]}

Metres, right-handed, +z up, whatever the source's frame, which ``frame`` tells. See
:class:`~model.scenes.scene.SceneObject` for what the values mean.
"""

from __future__ import annotations

import difflib
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from model.core.errors import InputFileError
from model.core.geometry import quaternion_wxyz
from model.io.urdf.writer import rounded
from model.scenes.scene import (
    ANCHORS,
    BASES,
    Scene,
    SceneObject,
    SceneObjectError,
    SceneProblem,
    upright,
)
from model.scenes.values import (
    JsonReader,
    Place,
    collect,
    maybe_text,
    numbers,
    pose,
    read_json,
    rotation_from_quaternion,
    shown,
    table,
    text,
)

MARK = "artiworld_scene"
FORMAT = 1


_KNOWN = frozenset({MARK, "name", "source", "objects", "problems"})
_ASKED = (
    "id", "description", "category", "room", "asset", "position", "quaternion_wxyz", "scale",
    "anchor", "fit", "static", "obstacle", "base", "solid", "box",
)  # fmt: skip
_KNOWN_OF_OBJECT = frozenset({
    *_ASKED,
    # A conversion's outcome, and the place to write it back to.
    "state", "reason", "articulable", "why", "kind", "expected_parts", "urdf", "decided", "held",
    "passes", "world_from_urdf", "asset_folder", "joints", "shortened", "articulation",
})  # fmt: skip


class OwnReader(JsonReader):
    """``{"artiworld_scene": 1, "objects": […]}``, metres, +z up."""

    name = "artiworld"
    description = "ArtiWorld's own scene.json"
    marks = (f'"{MARK}"'.encode(),)

    def read(self, path: Path) -> Scene:
        """See :class:`~model.scenes.scene.SceneReader`."""
        data = read_json(path)
        version = data.get(MARK) if isinstance(data, dict) else None
        if not isinstance(version, int) or not isinstance(data.get("objects"), list):
            raise InputFileError(path, f"has no {MARK!r} and 'objects'", "give a scene.json")
        if version > FORMAT:
            raise InputFileError(path, f"has format {version}, newer than {FORMAT}", "update")
        entries = [(("objects", i), e) for i, e in enumerate(data["objects"])]
        objects, problems = collect(entries, _object, lambda e: maybe_text(e.get("id")))
        name = maybe_text(data.get("name")) or path.stem
        return Scene(name, path, self.name, objects, (*_unknown(path, data), *problems))


def _unknown(path: Path, data: dict[str, Any]) -> list[SceneProblem]:
    """Notes on ignored entries, such as ``units``: everything is metres."""
    counts = Counter(k for k in data if k not in _KNOWN)
    notes = [f"{shown(k)} means nothing to a scene" for k in counts]
    entries = [e for e in data["objects"] if isinstance(e, dict)]
    for key, count in Counter(k for e in entries for k in e if k not in _KNOWN_OF_OBJECT).items():
        near = difflib.get_close_matches(key, _ASKED, 1)
        more = f"; is it {near[0]!r}?" if near else ""
        notes.append(f"{shown(key)} of {count} objects means nothing here{more}")
    if notes:
        notes[-1] += " (metres and +z up are taken)"
    return [SceneProblem(path.name, n, skipped=False) for n in notes]


def _object(place: Place, entry: Any) -> SceneObject:
    entry = table(entry, "id and pose")
    w, x, y, z = numbers(entry.get("quaternion_wxyz"), 4, "quaternion_wxyz")
    turn = rotation_from_quaternion(np.array([x, y, z, w]))
    scale = numbers(entry.get("scale"), 3, "scale")
    if scale.all():
        turn, scale = upright(turn, scale)
    anchor = entry.get("anchor", "origin")
    if anchor not in ANCHORS:
        raise SceneObjectError(f"anchor is {shown(anchor)}; one of {', '.join(ANCHORS)} is needed")
    static, base = entry.get("static"), entry.get("base")
    return SceneObject(
        id=text(entry.get("id"), "id"),
        description=text(entry.get("description"), "description"),
        world_from_object=pose(numbers(entry.get("position"), 3, "position"), turn),
        scale=scale,
        asset=maybe_text(entry.get("asset")),
        category=maybe_text(entry.get("category")),
        room=maybe_text(entry.get("room")),
        anchor=anchor,
        fit=_size(entry.get("fit"), "fit"),
        static=static if isinstance(static, bool) else None,
        box=_size(entry.get("box"), "box"),
        obstacle=entry.get("obstacle") is not False,
        base=base if base in BASES else None,
        solid=entry.get("solid") is not False,
        place=place,
    )


def _size(value: Any, what: str) -> tuple[float, float, float] | None:
    if value is None:
        return None
    x, y, z = numbers(value, 3, what)
    return x, y, z


def scene_to_json(scene: Scene, said: Mapping[str, Mapping[str, Any]] | None = None) -> Any:
    """The scene as JSON values.

    Args:
        said: object id → further entries, such as its URDF.
    """
    said = said or {}
    return {
        MARK: FORMAT,
        "name": scene.name,
        "source": {
            "file": scene.path.name,
            "reader": scene.reader,
            "frame": asdict(scene.frame),
        },
        "objects": [{**_entry(o), **said.get(o.id, {})} for o in scene.objects],
        "problems": [asdict(p) for p in scene.problems],
    }


def _entry(o: SceneObject) -> dict[str, Any]:
    return {
        "id": o.id,
        "description": o.description,
        "category": o.category,
        "room": o.room,
        "asset": o.asset,
        "position": rounded(o.world_from_object[:3, 3]),
        "quaternion_wxyz": quaternion_wxyz(o.world_from_object),
        "scale": rounded(o.scale),
        "anchor": o.anchor,
        "fit": None if o.fit is None else [float(v) for v in o.fit],
        "static": o.static,
        "obstacle": o.obstacle,
        "base": o.base,
        "solid": o.solid,
        "box": None if o.box is None else [float(v) for v in o.box],
    }
