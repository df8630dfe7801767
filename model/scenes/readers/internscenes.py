"""InternScenes ``layout.json``: a list of boxes with the asset that fills each.

Metres, +z up. ``bbox`` is taken as centre, size and Euler angles in radians, applied about the
fixed x, y and z axes in turn; the asset is stretched to fill the box.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from model.core.errors import InputFileError
from model.scenes.poses import from_rpy
from model.scenes.readers.lisdf import readable
from model.scenes.scene import Scene, SceneObject, SceneObjectError
from model.scenes.values import Place, collect, maybe_text, numbers, read_json, shown, text


class InternScenesReader:
    """A list of ``{id, category, model_uid, bbox}``."""

    name = "internscenes"
    description = "InternScenes layouts (layout.json)"

    def recognises(self, path: Path, head: bytes) -> bool:
        """See :class:`~model.scenes.protocol.SceneReader`."""
        return path.suffix.lower() == ".json" and b'"model_uid"' in head

    def read(self, path: Path) -> Scene:
        """See :class:`~model.scenes.protocol.SceneReader`."""
        layout = read_json(path)
        if not isinstance(layout, list):
            raise InputFileError(path, "is no list of objects", "give an InternScenes layout.json")
        entries = [((i,), e) for i, e in enumerate(layout)]
        objects, problems = collect(entries, _object, _id)
        return Scene(path.parent.name or path.stem, path, self.name, objects, problems)


def _id(entry: Any) -> str | None:
    value = entry.get("id")
    return None if value is None or isinstance(value, bool) else str(value)


def _object(place: Place, entry: Any) -> SceneObject:
    if not isinstance(entry, dict):
        raise SceneObjectError(f"is {shown(entry)}; an object with model_uid and bbox is needed")
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
