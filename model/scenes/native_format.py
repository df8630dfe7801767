"""Writing ``scene.json``, ArtiWorld's own scene file.

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

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from model.core.geometry import quaternion_wxyz
from model.io.urdf.writer import rounded
from model.scenes.readers.own import FORMAT, MARK
from model.scenes.scene import Scene, SceneObject


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
            "file": scene.path.name, "reader": scene.reader, "frame": asdict(scene.frame),
        },
        "objects": [{**_object(o), **said.get(o.id, {})} for o in scene.objects],
        "problems": [asdict(p) for p in scene.problems],
    }  # fmt: skip


def _object(o: SceneObject) -> dict[str, Any]:
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
