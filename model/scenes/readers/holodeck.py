"""Holodeck and ProcTHOR: an AI2-THOR house as JSON.

Metres, degrees, y up, left-handed as Unity has it. AI2-THOR puts the middle of an object's bounding
box at its position. Floors and walls become one static object, ``building``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from model.core.errors import InputFileError
from model.scenes.poses import from_unity
from model.scenes.readers.house import structure_of
from model.scenes.readers.lisdf import readable
from model.scenes.scene import Scene, SceneFrame, SceneObject, SceneObjectError
from model.scenes.unpacking import Unpacked, Unpacker
from model.scenes.values import Place, collect, maybe_text, numbers, read_json, shown, text

_MAX_DEPTH = 16
BUILDING = "building"


class HolodeckReader:
    """``objects`` with ``assetId``, ``position`` and ``rotation``, and what stands on them."""

    name = "holodeck"
    description = "Holodeck and ProcTHOR houses (AI2-THOR JSON)"

    def recognises(self, path: Path, head: bytes) -> bool:
        """See :class:`~model.scenes.protocol.SceneReader`."""
        known = (b'"proceduralParameters"', b'"assetId"', b'"roomType"')
        return path.suffix.lower() == ".json" and any(k in head for k in known)

    def read(self, path: Path) -> Scene:
        """See :class:`~model.scenes.protocol.SceneReader`."""
        house = read_json(path)
        if not isinstance(house, dict) or not isinstance(house.get("objects"), list):
            raise InputFileError(path, "has no list 'objects'", "give an AI2-THOR house")
        rooms = {
            r["id"]: maybe_text(r.get("roomType")) or r["id"]
            for r in house.get("rooms") or []
            if isinstance(r, dict) and isinstance(r.get("id"), str)
        }

        def make(place: Place, entry: Any) -> SceneObject:
            return _object(place, entry, rooms)

        structure, broken = structure_of(house)
        entries = [*_entries(house["objects"], ("objects",))]
        if structure is not None:
            entries.append(((), _building(path)))
        objects, problems = collect(entries, make, lambda e: maybe_text(e.get("id")))
        frame = SceneFrame("y", 1.0, left_handed=True)
        return Scene(path.stem, path, self.name, objects, (*problems, *broken), frame)

    def unpack(self, scene: Scene, folder: Path) -> Unpacked:
        """See :class:`~model.scenes.embedded.GeometryReader`."""
        made = Unpacker(folder)
        structure, _ = structure_of(read_json(scene.path))
        if structure is not None:
            asset = _building(scene.path).asset
            made.add(asset or BUILDING, BUILDING, lambda: [(None, structure)])
        return made.result()


def _building(path: Path) -> SceneObject:
    """Floors and walls; no entry of the file."""
    return SceneObject(
        BUILDING, BUILDING, np.eye(4), np.ones(3), asset=f"{path.name}#{BUILDING}", static=True
    )


def _entries(objects: list[Any], place: Place, depth: int = 0) -> Iterator[tuple[Place, Any]]:
    for i, entry in enumerate(objects):
        here = (*place, i)
        yield here, entry
        children = entry.get("children") if isinstance(entry, dict) else None
        if isinstance(children, list) and depth < _MAX_DEPTH:
            yield from _entries(children, (*here, "children"), depth + 1)


def _object(place: Place, entry: Any, rooms: dict[str, str]) -> SceneObject:
    if isinstance(entry, SceneObject):
        return entry
    if not isinstance(entry, dict):
        raise SceneObjectError(f"is {shown(entry)}; an object with assetId is needed")
    id = text(entry.get("id"), "id")
    asset = text(entry.get("assetId"), "assetId")
    turn = entry.get("rotation")
    degrees = np.zeros(3) if turn is None else numbers(turn, 3, "rotation")
    world = from_unity(numbers(entry.get("position"), 3, "position"), degrees)
    name = maybe_text(entry.get("object_name")) or re.sub(r"\(.*?\)|\|.*", "", id)
    room = entry.get("roomId")
    kinematic = entry.get("kinematic")
    return SceneObject(
        id=id,
        description=maybe_text(entry.get("description")) or readable(name),
        world_from_object=world,
        scale=np.ones(3),
        asset=asset,
        category=maybe_text(entry.get("category")) or maybe_text(entry.get("objectType")),
        room=rooms.get(room, room) if isinstance(room, str) else None,
        anchor="center",
        static=kinematic if isinstance(kinematic, bool) else None,
        place=place,
    )
