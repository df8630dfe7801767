"""PhyScene rooms: retrieved models with their places, or boxes beside the room's floor plan.

Both forms are those of PhyScene's public code (``utils/utils.py``, ``scripts/generate``), metres,
Y up, radians about y. With row vectors a vertex of a retrieved model stands at
``(v * scale - centroid) · R + t``, ``position = t - centroid``. 3D-FUTURE models are found by
their ``jid``, articulated ones by their PartNet-Mobility id, whose URDF turns the OBJ's frame. A
box is the asset called after its label, stretched to it, or stays a box without such an asset.

Floor plan and doors become one static object, ``building``. ``door_box`` tells the square that a
door needs to open in; the door is a panel in its middle, along the nearest edge of the floor.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from model.core.errors import InputFileError
from model.core.geometry import affine
from model.io.formats.loaded import DEFAULT_MAX_BYTES, Loaded, join
from model.io.geometry_files import load_geometry, turned_up
from model.scenes.poses import about_z, pose
from model.scenes.readers.holodeck import BUILDING
from model.scenes.readers.house import THICKNESS, WALL_COLOR, box_solid
from model.scenes.readers.lisdf import readable
from model.scenes.scene import (
    FloatArray,
    Scene,
    SceneFrame,
    SceneObject,
    SceneObjectError,
    SceneProblem,
    upright,
)
from model.scenes.unpacking import Unpacked, Unpacker
from model.scenes.values import Place, collect, maybe_text, numbers, read_json, shown, text

MODELS, MOBILITY_MODELS = "ThreedFront", "GPN"
_UP = turned_up("y")[:3, :3]
_REMEDY = "give a room that PhyScene wrote: ThreedFront and GPN, or objects with rot_degree"


class PhySceneReader:
    """``{"ThreedFront": …, "GPN": …}``, or ``{"objects": […], "floor_center", "door_box"}``."""

    name = "physcene"
    description = "PhyScene rooms (retrieved models, or boxes with a floor plan)"

    def recognises(self, path: Path, head: bytes) -> bool:
        """See :class:`~model.scenes.protocol.SceneReader`."""
        known = (b'"ThreedFront"', b'"GPN"', b'"rot_degree"', b'"door_box"')
        return path.suffix.lower() == ".json" and any(k in head for k in known)

    def read(self, path: Path) -> Scene:
        """See :class:`~model.scenes.protocol.SceneReader`."""
        room = _room(path)
        if isinstance(room.get("objects"), list):
            boxes = [(("objects", i), entry) for i, entry in enumerate(room["objects"])]
            objects, problems = collect(boxes, _box, _label)
        else:
            objects, problems = collect(_models(path, room), _model, _label)
        solids, broken = _building(path, room)
        if solids:
            asset, still = f"{path.name}#{BUILDING}", (np.eye(4), np.ones(3))
            objects = (*objects, SceneObject(BUILDING, BUILDING, *still, asset=asset, static=True))
        every = (*problems, *broken)
        return Scene(path.stem, path, self.name, objects, every, SceneFrame("y"))

    def unpack(self, scene: Scene, folder: Path) -> Unpacked:
        """See :class:`~model.scenes.embedded.GeometryReader`."""
        made = Unpacker(folder)
        solids, _ = _building(scene.path, _room(scene.path))
        if solids:
            made.add(f"{scene.path.name}#{BUILDING}", BUILDING, lambda: [(None, join(solids))])
        return made.result()


def _room(path: Path) -> dict[str, Any]:
    room = read_json(path)
    if not isinstance(room, dict) or not (
        isinstance(room.get("objects"), list) or {MODELS, MOBILITY_MODELS} & set(room)
    ):
        raise InputFileError(path, "is no PhyScene room", _REMEDY)
    return room


def _models(path: Path, room: dict[str, Any]) -> Iterator[tuple[Place, Any]]:
    for kind in (MODELS, MOBILITY_MODELS):
        table = room.get(kind) or {}
        if not isinstance(table, dict):
            raise InputFileError(path, f"{kind!r} is {shown(table)}, no table of models", _REMEDY)
        for id, entries in table.items():
            for i, entry in enumerate(entries if isinstance(entries, list) else [entries]):
                yield ((kind, id, i) if isinstance(entries, list) else (kind, id)), entry


def _label(entry: Any) -> str | None:
    return maybe_text(entry.get("query_label")) or maybe_text(entry.get("label"))


def _model(place: Place, entry: Any) -> SceneObject:
    if not isinstance(entry, dict):
        raise SceneObjectError(f"is {shown(entry)}; an entry with theta and position is needed")
    kind, id = str(place[0]), text(place[1], "the model's id")
    scale = entry.get("scale")
    if isinstance(scale, int | float) and not isinstance(scale, bool):
        scale = [scale] * 3
    factors = numbers(scale, 3, "scale")[[0, 2, 1]]
    turn = about_z(float(numbers([entry.get("theta")], 1, "theta")[0]))
    centroid = numbers(entry.get("centroid"), 3, "centroid")
    where = numbers(entry.get("position"), 3, "position") + centroid
    shift = _UP @ where - turn @ (_UP @ centroid)
    if kind == MOBILITY_MODELS:
        # The URDF's base joint turns the OBJ by (π/2, 0, -π/2), a quarter turn beyond "Y is up".
        turn, factors = turn @ about_z(math.pi / 2), factors[[1, 0, 2]]
    if factors.all():
        turn, factors = upright(turn, factors)
    return SceneObject(
        id="_".join(str(step) for step in place[1:]),
        description=readable(_label(entry) or id),
        world_from_object=pose(shift, turn),
        scale=factors,
        asset=id,
        category=maybe_text(entry.get("label")) or maybe_text(entry.get("query_label")),
        place=place,
    )


def _box(place: Place, entry: Any) -> SceneObject:
    if not isinstance(entry, dict):
        raise SceneObjectError(f"is {shown(entry)}; an object with label and position is needed")
    label = text(entry.get("label"), "label")
    half = numbers(entry.get("scale"), 3, "scale (half of the box' sizes)")
    x, y, z = (2 * half[[0, 2, 1]]).tolist()
    degrees = float(numbers([entry.get("rot_degree")], 1, "rot_degree")[0])
    where = _UP @ numbers(entry.get("position"), 3, "position")
    return SceneObject(
        id=f"{label}_{place[-1]}",
        description=readable(label),
        world_from_object=pose(where, about_z(math.radians(degrees))),
        scale=np.ones(3),
        asset=label,
        category=label,
        anchor="center",
        fit=(x, y, z),
        box=(x, y, z),
        place=place,
    )


def _building(path: Path, room: dict[str, Any]) -> tuple[list[Loaded], list[SceneProblem]]:
    """Floor and doors in the scene's frame, and what of them couldn't be used."""
    problems: list[SceneProblem] = []
    floor = None
    file = _floor_plan(path)
    if file is not None:
        try:
            center = room.get("floor_center")
            floor = _floor(file, None if center is None else numbers(center, 3, "floor_center"))
        except (InputFileError, SceneObjectError) as error:
            problems.append(SceneProblem(file.name, f"floor plan: {error}"))
    solids = [] if floor is None else [floor]
    doors = room.get("door_box")
    for i, door in enumerate(doors if isinstance(doors, list) else ()):
        try:
            solids.append(_door(numbers(door, 7, "door_box"), floor))
        except SceneObjectError as error:
            problems.append(SceneProblem(f"door {i}", str(error)))
    return solids, problems


def _floor_plan(path: Path) -> Path | None:
    """``room_<n>.obj`` beside ``House_<m>_room_<n>_<type>_bbox.json``, as PhyScene copies it, in
    its house's folder, or ``room_<scene>.obj``."""
    house, room = re.search(r"House_\d+", path.stem), re.search(r"room_\d+", path.stem)
    names = [f"room_{path.stem}.obj"] + ([f"{room[0]}.obj"] if room else [])
    names += [f"{house[0]}/{room[0]}.obj"] if house and room else []
    return next((path.parent / n for n in names if (path.parent / n).is_file()), None)


def _floor(path: Path, center: FloatArray | None) -> Loaded:
    """The plan about the room's middle, +z up; its flat axis tells which way is up in the file:
    some versions of the public code have y and z exchanged."""
    plan = load_geometry(path, DEFAULT_MAX_BYTES)
    if not len(plan.faces) or not np.isfinite(plan.vertices).all():
        raise InputFileError(path, "is no floor plan", "triangles with finite corners are needed")
    low, high = plan.vertices.min(axis=0), plan.vertices.max(axis=0)
    middle = (low + high) / 2 if center is None else center
    order = [0, 2, 1] if np.argmin(high - low) == 2 else [0, 1, 2]
    return plan.moved(affine(_UP @ np.eye(3)[order]) @ affine(shift=-middle))


def _door(box: FloatArray, floor: Loaded | None) -> Loaded:
    """A panel in the middle of (7,) ``x, z, y, size along x, z, y, 0``."""
    x, z, y, wide, deep, high, _ = box
    sizes = np.array([wide, deep, high])
    if (sizes <= 0).any():
        raise SceneObjectError(f"its sizes {sizes.tolist()} must be above 0")
    middle = np.array([x, -z, y])
    if floor is not None:
        sizes[_across(floor, middle[:2])] = THICKNESS
    return box_solid(middle - sizes / 2, sizes, WALL_COLOR)


def _across(floor: Loaded, spot: FloatArray) -> int:
    """The horizontal axis (0 or 1) across the floor's edge that is nearest to (2,) ``spot``."""
    edges = np.sort(np.concatenate([floor.faces[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    edges, counts = np.unique(edges, axis=0, return_counts=True)
    a, b = np.moveaxis(floor.vertices[edges[counts == 1]][..., :2].astype(np.float64), 1, 0)
    along = b - a
    length = np.maximum((along**2).sum(axis=1), 1e-12)
    share = np.clip(((spot - a) * along).sum(axis=1) / length, 0, 1)
    nearest = np.linalg.norm(a + share[:, None] * along - spot, axis=1).argmin()
    return int(np.abs(along[nearest]).argmin())
