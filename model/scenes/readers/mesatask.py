"""MesaTask tables: ``layout.json``, and what its language model writes before assets are chosen.

``layout.json`` is metres, +z up, quaternions x y z w. The language model's output is centimetres
and degrees about +z, and names no assets; its ``size`` is what an asset would be stretched to. The
position is taken as the middle of an object's bounding box.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from model.core.errors import InputFileError
from model.scenes.poses import about_z, pose, rotation_from_quaternion
from model.scenes.readers.lisdf import readable
from model.scenes.scene import Scene, SceneFrame, SceneObject, SceneObjectError, upright
from model.scenes.values import Place, collect, maybe_text, numbers, read_json, shown, text

CENTIMETRES = 0.01


class MesaTaskReader:
    """``objects`` with ``instance`` and either ``retrieved_uid`` or ``description``."""

    name = "mesatask"
    description = "MesaTask tables (layout.json, or the language model's output)"

    def recognises(self, path: Path, head: bytes) -> bool:
        """See :class:`~model.scenes.protocol.SceneReader`."""
        known = (b'"item_placement_zone"', b'"retrieved_uid"')
        return path.suffix.lower() == ".json" and any(k in head for k in known)

    def read(self, path: Path) -> Scene:
        """See :class:`~model.scenes.protocol.SceneReader`."""
        layout = read_json(path)
        if not isinstance(layout, dict) or not isinstance(layout.get("objects"), list):
            raise InputFileError(path, "has no list 'objects'", "give a MesaTask layout")
        entries = [(("objects", i), e) for i, e in enumerate(layout["objects"])]
        words = any(isinstance(e, dict) and "z_rotation" in e for _, e in entries)
        make = _from_words if words else _from_layout
        objects, problems = collect(entries, make, lambda e: maybe_text(e.get("instance")))
        frame = SceneFrame(unit_scale=CENTIMETRES if words else 1.0)
        return Scene(path.parent.name or path.stem, path, self.name, objects, problems, frame)


def _entry(entry: Any) -> dict[str, Any]:
    if not isinstance(entry, dict):
        raise SceneObjectError(f"is {shown(entry)}; an object with instance is needed")
    return entry


def _from_layout(place: Place, entry: Any) -> SceneObject:
    entry = _entry(entry)
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
    entry = _entry(entry)
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
